"""What an effect looks like: the force that a model without it lacks, along a rich motion of the
model with it.

Nothing is drawn by hand. The model moves under its own rich command, each effect switched on at its
last probe strength; the missing force is computed from the simulated positions as a diagnosis does
it, without noise.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np


#: Models whose candidates are shown: the first that offers an effect shows it.
MODELS = ("pendulum", "planar_arm", "flexible_link", "space_manipulator")
#: What the missing force is computed by.
FORCE = (
    "dynamics/chain.py",
    "dynamics/effect.py",
    "dynamics/dry_friction.py",
    "force/drive.py",
    "force/torque_filter.py",
    "diagnosis/where.py",
)


def key(root: Path) -> str:
    """Changes whenever code changes that the pictures show."""
    used = (root / "jaxid" / name for name in FORCE)
    files = [Path(__file__), *sorted((root / "models").rglob("*.py")), *used]
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:16]


def draw(folder: Path, names: list[str]) -> None:
    """Writes NAME.svg for each effect that one of the models offers."""
    folder.mkdir(parents=True, exist_ok=True)
    left = list(names)
    for model in MODELS:
        if left:
            done = _draw(folder, model, left)
            left = [n for n in left if n not in done]


def _draw(folder: Path, model: str, names: list[str]) -> set[str]:
    from jaxid.diagnosis.equivalence import _rich_motion, _with_friction
    from jaxid.diagnosis.hypothesis import candidates
    from jaxid.dynamics import catalogue
    from jaxid.dynamics.chain import Chain
    from jaxid.fitting.effect_starts import probes
    from jaxid.fitting.problem_builder import ProblemBuilder
    from jaxid.problem.binding import bind
    from jaxid.problem.residual import OutputError

    owner = catalogue.model_class(model)()
    chain = Chain(owner)
    library = [
        k for n in names if n not in chain.contents and chain.offers(k := catalogue.effect_class(n))
    ]
    if not library:
        return set()
    data, _ = _rich_motion(chain, model, owner)
    binding = bind(model, data, candidates=library, splits=False)
    bench = ProblemBuilder(binding)
    theta = _with_friction(binding)
    pool = {
        c.effect: c for c in reversed(candidates(bench, [k.name for k in library]))
    }  # at its first location
    effects = {e.name: e for e in binding.chain.effects}
    shown = list(pool)
    thetas = [theta, *(probes(binding, effects[n], pool[n].location, theta)[-1] for n in shown)]
    problem = bench.problem(OutputError(), "fit", binding.free, theta)
    runs = problem.runs
    z = problem.z(theta)
    (number,) = problem.records
    start = np.tile(problem.starts(z), (len(thetas), 1))
    outputs = runs.engine.outputs(np.array(thetas), start, np.full(len(thetas), number))
    outputs = [runs.sample_prediction(number, row) for row in outputs]
    (e,) = binding.experiments("fit")
    forces = binding.motions and not binding.chain.mechanism.hidden_states
    for name, y in zip(shown, outputs[1:], strict=True):
        draw_one = _force if forces else _change
        draw_one(
            folder / f"{name}.svg",
            bench,
            e,
            theta,
            np.asarray(y),
            np.asarray(outputs[0]),
            pool[name].location,
        )
    return set(shown)


def _force(path: Path, bench, e, theta, y: np.ndarray, nominal: np.ndarray, location: str) -> None:
    """Missing force against velocity and over time."""
    from jaxid.diagnosis.missing import filtered, torque_along
    from jaxid.problem.residual import InverseDynamics
    from jaxid.report import plot

    b = bench.binding
    joints = b.chain.signature.joints
    places = (
        joints,
        [n for n, _ in b.chain.signature.inputs],
        [n for n, _ in b.chain.signature.outputs],
    )
    j = next((p.index(location) for p in map(list, places) if location in p), 0)
    j = min(j, len(joints) - 1)
    problem = bench.problem(InverseDynamics(decimate=1), "fit", [], theta)
    runs = problem.runs
    (record,) = (runs.record(r) for r in problem.records)
    keep = record.samples - record.first
    columns = b.chain.joint_outputs

    def missing(outputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        motion = filtered(runs, e, outputs[:, columns])
        return motion, -torque_along(problem, theta, [motion])[0][:, j]

    # Less what the filters alone leave where the command steps.
    (motion, force), (_, left) = missing(y), missing(nominal)
    force = force - left
    n = len(joints)
    t, q, qd = e.t[keep], motion[keep, j], motion[keep, n + j]
    unit, length = b.chain.signature.unit("{F}"), b.chain.signature.unit("{X}")

    def picture(figure):
        left, middle, right = figure.subplots(1, 3, width_ratios=[2, 2, 3], sharey=True)
        sign = qd >= 0
        for axes, x in ((left, qd), (middle, q)):
            for part, color in ((sign, plot.BLUE), (~sign, plot.VERMILLION)):
                plot.dots(axes, x[part], force[part], color, 2.2, 0.7)
        right.plot(t, force, color=plot.GREY, lw=0.6)
        for part, color in ((sign, plot.BLUE), (~sign, plot.VERMILLION)):
            plot.dots(right, t[part], force[part], color, 2.2, 0.8)
        for axes in (left, middle, right):
            axes.axhline(0, color=plot.BLACK, lw=0.6)
        left.set(xlabel=f"velocity ({length}/s)", ylabel=f"missing force ({unit})")
        middle.set(xlabel=f"position ({length})")
        right.set(xlabel="time (s)")
        if bounds := plot.limits(force, quantile=0.01):
            left.set_ylim(min(bounds[0], 0), max(bounds[1], 0))  # a constant looks constant

    path.write_text(plot.svg(path.stem, (8.6, 2.3), picture), encoding="utf-8")


def _change(path: Path, bench, e, theta, y: np.ndarray, nominal: np.ndarray, location: str) -> None:
    """Where not every state is measured: what the effect changes in each output."""
    from jaxid.report import plot

    outputs = bench.binding.chain.signature.outputs

    def picture(figure):
        row = figure.subplots(1, len(outputs), squeeze=False)[0]
        for c, (axes, (name, unit)) in enumerate(zip(row, outputs, strict=True)):
            axes.plot(*plot.thin(e.t, y[:, c] - nominal[:, c]), color=plot.BLUE, lw=1)
            axes.axhline(0, color=plot.BLACK, lw=0.6)
            axes.set(xlabel="time (s)", ylabel=f"change of {name}\n({unit})")

    path.write_text(plot.svg(path.stem, (8.6, 2.3), picture), encoding="utf-8")
