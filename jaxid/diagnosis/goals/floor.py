"""How near a simulation can come: what two simulators make of the same file.

A recording of a robot is compared with the file that states it, and what a file means is known only
as well as two programs that read it agree: MuJoCo's dry friction creeps, its steps are of first
order, jaxid's friction sticks. What lies below their difference is no gap of the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Experiment
from jaxid.diagnosis.goals.gains import gains_in
from jaxid.diagnosis.verdict import level
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.replay import in_mujoco
from jaxid.problem.binding import Binding
from jaxid.problem.residual import OutputError, run_up
from jaxid.robots import stops
from jaxid.robots.tree import Tree
from jaxid.robots.yardstick import as_it_stands


def file_of(binding: Binding) -> Path | None:
    tree: Tree = binding.chain.mechanism.tree.tree  # type: ignore[attr-defined]
    spec = binding.dataset.model
    stated = spec.geometry.path if spec is not None and spec.geometry is not None else ""
    found = [Path(p) for p in (stated, tree.file) if p and Path(p).is_file()]
    return found[0] if found else None


@dataclass(frozen=True)
class Between:
    """MuJoCo's free runs of the file as it stands in the runs of a split: what they differ by from
    jaxid's, [samples n] of each, and the root mean square [n] of what they leave of the readings.
    """

    apart: list[np.ndarray]
    left: np.ndarray
    theirs: list[np.ndarray] = field(default_factory=list)  # MuJoCo's runs themselves
    #: The same as `apart` in the samples before a run by which its start is told.
    before: list[np.ndarray] = field(default_factory=list)

    @property
    def size(self) -> np.ndarray:
        return rms(self.apart)

    def speeds(self, runs: Sequence[Experiment]) -> list[np.ndarray]:
        """Of MuJoCo's runs, [samples n] of each of `runs`."""
        return [np.gradient(x, e.t, axis=0) for e, x in zip(runs, self.theirs, strict=True)]

    def at_once(self, runs: Sequence[Experiment]) -> list[np.ndarray]:
        """What the two differ by but for the moment at which they see a motion."""
        speeds = self.speeds(runs)
        early = seen_early(self.apart, speeds)
        return [x - early * v for x, v in zip(self.apart, speeds, strict=True)]


def rms(series: Sequence[np.ndarray]) -> np.ndarray:
    return np.sqrt(np.mean(np.concatenate(series) ** 2, 0))


def seen_early(apart: Sequence[np.ndarray], speeds: Sequence[np.ndarray]) -> np.ndarray:
    """Seconds [n] by which one simulator sees each joint's motion before the other, from what they
    differ by and how fast joints are: steps of first order see a motion half a step early.
    """
    x, v = np.concatenate(apart), np.concatenate(speeds)
    return np.sum(v * x, 0) / np.maximum(np.sum(v * v, 0), 1e-300)


#: Numbers of joints that a file states, by joint: those that MuJoCo is asked to run with.
JointNumbers = Mapping[str, Mapping[str, float]]


def joint_numbers(binding: Binding, theta: np.ndarray, index: Sequence[int]) -> JointNumbers:
    """Those of the numbers `index` of theta that MuJoCo can be given in place of the file's."""
    found: dict[str, dict[str, float]] = {}
    for i in index:
        kind, _, joint = binding.layout.names[i].partition("@")
        if kind in ("armature", "damping", "frictionloss") and joint in (
            binding.chain.signature.joints
        ):
            found.setdefault(joint, {})[kind] = float(theta[i])
    return found


def between_simulators(
    bench: ProblemBuilder,
    split: str = "fit",
    theta: np.ndarray | None = None,
    numbers: JointNumbers | None = None,
) -> Between | None:
    """None where MuJoCo has no run of the file; `theta`: numbers of jaxid's run where not those of
    the file, `numbers`: those of MuJoCo's. Gains that are fitted are those of `theta` in both runs.
    """
    b, runs = bench.binding, bench.binding.experiments(split)
    if not runs or file_of(b) is None:
        return None
    theta = as_it_stands(b)[0] if theta is None else theta
    n = b.chain.nq
    starts = estimate_starts(bench, split, [theta])
    theirs = _their_runs(b, split, theta, starts[0], numbers)
    if theirs is None:
        return None
    for k, (e, y) in enumerate(zip(runs, theirs, strict=True)):
        if (
            e.past is not None
        ):  # jaxid's run begins a little before the cut, where MuJoCo's is by then
            starts[0][k] = np.concatenate(
                [y[run_up(e)], np.gradient(y, e.whole.t, axis=0)[run_up(e)]]
            )
    made = bench.runs(OutputError(), split)
    lanes = made.engine.outputs(
        np.repeat(theta[None], len(runs), 0), starts[0], np.array(made.records)
    )
    apart, before = [], []
    for k, (e, y, lane) in enumerate(zip(runs, theirs, lanes, strict=True)):
        own, first = made.record(made.records[k]), made.before(k)
        cut = len(y) - len(e.t)
        apart.append(y[cut:] - lane[own.samples - own.offset, :n])
        before.append(y[cut - len(first) : cut] - lane[first - own.offset, :n])
    theirs = [y[-len(e.t) :] for e, y in zip(runs, theirs, strict=True)]
    if not all(np.isfinite(x).all() for x in (*apart, *before)) or b.chain.joint_outputs != list(
        range(len(b.sigma))
    ):
        return None
    left = [e.y[:, b.chain.joint_outputs] - y for e, y in zip(runs, theirs, strict=True)]
    return Between(apart, rms(left), theirs, before)


def _their_runs(
    b: Binding,
    split: str,
    theta: np.ndarray,
    starts: np.ndarray,
    numbers: JointNumbers | None = None,
    finer: int = 1,
) -> list[np.ndarray] | None:
    """MuJoCo's free runs of the file from `starts` [runs 2 n], [samples n] of each, in steps this
    many times finer than the file's; None where MuJoCo does not take it.
    """
    path, runs = file_of(b), b.experiments(split)
    assert path is not None
    tree: Tree = b.chain.mechanism.tree.tree  # type: ignore[attr-defined]
    data = replace(b.dataset, experiments=tuple(e.whole for e in runs))
    begun = [
        s if e.past is None else _measured(e.whole, b) for e, s in zip(runs, starts, strict=True)
    ]
    try:
        return in_mujoco(
            data=data,
            path=path,
            tree=tree,
            source=None,
            starts=[np.asarray(s) for s in begun],
            notes=[],
            gains=gains_in(b, theta),
            numbers=numbers,
            finer=finer,
        )
    except UsageError:
        return None


def made_by_steps(bench: ProblemBuilder) -> list[np.ndarray] | None:
    """What the file's steps make of MuJoCo's free runs of it in the fit runs, [samples n] of each:
    these less runs in steps of no length, which are extrapolated from half the step (steps of first
    order, Richardson 1911). None where MuJoCo has no run of the file.
    """
    b = bench.binding
    if not b.experiments("fit") or file_of(b) is None:
        return None
    theta = as_it_stands(b)[0]
    starts = estimate_starts(bench, "fit", [theta])[0]
    whole = _their_runs(b, "fit", theta, starts)
    halved = _their_runs(b, "fit", theta, starts, finer=2)
    if whole is None or halved is None:
        return None
    runs = b.experiments("fit")
    made = [2 * (y - z)[-len(e.t) :] for e, y, z in zip(runs, whole, halved, strict=True)]
    return made if all(np.isfinite(x).all() for x in made) else None


def _measured(e: Experiment, b: Binding) -> np.ndarray:
    """Positions and speeds at the first sample of a run."""
    joints = e.motion()[:, b.chain.joint_outputs]
    first = slice(0, max(2, len(joints) // 100))
    return np.concatenate([joints[0], np.polyfit(e.t[first], joints[first], 1)[0]])


def with_floor(
    binding: Binding, apart: np.ndarray | None, numbers: Mapping[str, float] | None = None
) -> Binding:
    """The binding with noise that counts what two simulators of its file differ by, rms `apart`
    [ny], and with what this makes of its `numbers` as a standard deviation of theirs: a number is
    known only as well as its meaning.
    """
    if apart is None:
        return binding
    sigma, noise = np.hypot(binding.sigma, apart), {}
    for (name, _), old, new, own in zip(
        binding.chain.signature.outputs, binding.sigma, sigma, apart, strict=True
    ):
        told = binding.noise[name]
        text = (
            f"{told.text}; MuJoCo and jaxid differ by {own:.2g} {told.unit} on the same file:"
            " nearer"
        )
        text += f" than {new:.2g} says nothing"
        noise[name] = replace(told, std=float(new), text=text) if new > 1.2 * old else told
    return replace(
        binding, sigma=sigma, noise={**binding.noise, **noise}, doubts=dict(numbers or {})
    )


def not_this_file(binding: Binding, between: Between | None, apart: np.ndarray | None) -> str:
    """Where jaxid's run of the file is further from MuJoCo's, whatever the numbers (`apart`, rms
    [n]), than MuJoCo's is from the recording, and that is above the noise: what is left then is
    jaxid's own, and no model of it tells of the robot. Empty where it tells.
    """
    if between is None or apart is None:
        return ""
    ours, theirs = (float(np.mean((x / binding.sigma) ** 2)) for x in (apart, between.left))
    if not ours > theirs > level(sum(len(e.t) for e in binding.experiments("fit")) * len(apart)):
        return ""
    worst = int(np.argmax(apart / binding.sigma))
    names = binding.chain.signature.output_names
    unit = binding.noise[names[worst]].unit
    text = (
        f"MuJoCo's run of the file leaves {between.left[worst]:.2g} {unit} of {names[worst]}, and"
        f" jaxid's run of the same file lies {apart[worst]:.2g} {unit} from that one, whatever its"
        " numbers: something that the file says and jaxid does not simulate acts in this"
        " recording, and what is left says nothing of the robot."
    )
    return " ".join(
        (text, *(f"{s}." for s in stops.sentences_of(binding.chain.mechanism, binding.dataset)))
    )
