"""What a residual does not show: effects that the model's own numbers take in, on twins of the
papers' rigs.

The withheld effect hides in a wrong parameter, shows only in motions that were not fitted, or in
none that was recorded. Asked is whether it is named, else whether the answer says what these
recordings would not show. Twins are separately written equations.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


sys.path[:0] = [
    str(Path(__file__).resolve().parents[1]),
    str(Path(__file__).resolve().parents[1] / "tests"),
]

from benchmarks import space_manipulator as arm  # noqa: E402
from jaxid.benchmark import numpy_twin, plants  # noqa: E402
from jaxid.runtime import prepare  # noqa: E402


prepare()

from jaxid.api import diagnose  # noqa: E402
from jaxid.data.dataset import Dataset, ModelSpec, ParameterPrior  # noqa: E402
from jaxid.diagnosis.result import Diagnosis  # noqa: E402
from tests import test_models  # noqa: E402


SPLITS = ("fit", "fit", "validation", "report")


# ---- tracker: tests A and B of paper 003 (steps at one axis, then at the other), or both axes at once


def steps(axis: int, first: float, second: float) -> np.ndarray:
    t = np.arange(1000) / 100
    u = np.zeros((1000, 2))
    u[:, axis] = np.where((t >= 1) & (t < 4), first, np.where((t >= 4) & (t < 7), second, 0.0))
    return u


def both(seed: int) -> np.ndarray:
    t, rng = np.arange(1000) / 100, np.random.default_rng(seed)
    u = np.zeros((1000, 2))
    for j in (0, 1):
        for f in (0.3, 0.7, 1.3, 2.1):
            u[:, j] += 0.5 * np.sin(2 * np.pi * (f * rng.uniform(0.8, 1.2) * t + rng.uniform()))
    return u + [0.0, 0.15]


def tracker(commands: list[np.ndarray], **numbers: tuple[float, float]) -> Dataset:
    """Driven by torque, 0.1 degree noise; published numbers but for those given."""
    plant = dataclasses.replace(plants.PLANTS["tracker"], noise=np.deg2rad(0.1), resolution=0.0)
    known = {"J": (0.117, 0.1), "viscous": (1.9, 1.495)} | numbers
    lanes = {k: np.tile(x, (len(commands), 1)) for k, x in known.items()}
    y = numpy_twin.recorded(plant, np.array(commands), lanes, np.random.default_rng(0))
    return Dataset.from_arrays(
        [np.arange(1000) / 100] * len(commands),
        inputs={n: [u[:, i] for u in commands] for i, (n, _) in enumerate(plant.inputs)},
        outputs={n: list(y[:, :, i]) for i, (n, _) in enumerate(plant.outputs)},
        units=dict((*plant.inputs, *plant.outputs)),
        split=SPLITS,
        at_rest=True,
        noise_std={n: plant.noise for n, _ in plant.outputs},
        model="tracker",
    )


PAPER = [steps(0, 0.192, 0.072), steps(1, 0.192, 0.072), steps(0, 0.15, 0.05), steps(1, 0.15, 0.05)]
RICHER = [*PAPER[:2], both(1), both(2)]
SPLIT: dict[str, Any] = {"J": (0.117, 0.0011), "reflected": (0.0, 0.0989)}


# ---- space manipulator: torques of the full five-coordinate system at zero momentum, 1 % noise


def space(base: tuple[float, float], payload: float = 1.0, noise: float = 0.01) -> Dataset:
    """On a base of this mass and inertia; with `payload` < 1 a part of the last body is lost at
    half of each run.
    """
    rng, runs = np.random.default_rng(0), []
    known = test_models.SPACE | {"base_mass": base[0], "base_inertia": base[1]}
    friction = {k: np.array(x) for k, x in arm.FRICTION.items()}
    systems = {share: floating(known, share) for share in {1.0, payload}}
    for seed in range(1, 5):
        t, q, qd, qdd = arm.path(seed, 10.0)
        tau = np.array(
            [
                systems[payload if 2 * k >= len(t) else 1.0](*row)
                for k, row in enumerate(zip(q, qd, qdd, strict=True))
            ]
        )
        dry = friction["F_c"] + (friction["F_s"] - friction["F_c"]) * np.exp(
            -((qd / friction["v_s"]) ** 2)
        )
        tau = tau + dry * np.sign(qd) + friction["F_v"] * qd
        tau = tau + noise * np.sqrt(np.mean(tau**2, 0)) * rng.standard_normal(tau.shape)
        runs.append((t, q + 1e-6 * rng.standard_normal(q.shape), tau))
    priors = {
        k + j: ParameterPrior(None, *b)
        for k, b in arm.BOUNDS.items()
        for j in (("",) if k in arm.BODY else "12")
    }
    constants = {
        k: known[k]
        for k in ("l1", "I1", "m1", "c1", "base_mass", "base_inertia", "base_x", "base_y")
    }
    return Dataset.from_arrays(
        [t for t, *_ in runs],
        {f"tau{j + 1}": [tau[:, j] for *_, tau in runs] for j in (0, 1)},
        {f"q{j + 1}": [q[:, j] for _, q, _ in runs] for j in (0, 1)},
        split=SPLITS,
        noise_std={"q1": 1e-6, "q2": 1e-6},
        model=ModelSpec("space_manipulator", constants=constants, parameters=priors),
    )


def floating(known: dict[str, float], share: float):
    """Torques of the joints by (q, qd, qdd), the base free at zero momentum."""
    before = dict(test_models.SPACE)
    try:
        test_models.SPACE.update(known)
        equations, mass = test_models.space.__wrapped__(
            True, share
        )  # not the cached one of other constants
    finally:
        test_models.SPACE.update(before)

    def tau(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        where, still = np.array([0, 0, 0, *q]), np.zeros(5)
        M = mass(where)
        speed = np.append(-np.linalg.solve(M[:3, :3], M[:3, 3:] @ qd), qd)
        bias = np.array(equations(where, speed, still), float)
        base = np.linalg.solve(M[:3, :3], -(bias[:3] + M[:3, 3:] @ qdd))
        return (bias + M @ np.append(base, qdd))[3:]

    return tau


def cases() -> list[tuple[str, str, str, Dataset, dict[str, Any], dict[str, float]]]:
    """Rig, what is withheld, its effect, recordings, settings of the diagnosis, and true numbers to
    compare with.
    """
    body = {k: test_models.SPACE[k] for k in ("m2", "hx", "hy", "I2")}
    inertia = {"J_theta": 0.117}
    torque = {"residual": "inverse_dynamics"}
    return [
        (
            "tracker, paper's steps",
            "rotor inertia only in the tilt",
            "reflected_inertia",
            tracker(PAPER, **SPLIT),
            {},
            inertia,
        ),
        (
            "tracker, chosen on both axes at once",
            "rotor inertia only in the tilt",
            "reflected_inertia",
            tracker(RICHER, **SPLIT),
            {},
            inertia,
        ),
        (
            "tracker, paper's steps",
            "dry friction of 0.03 N m at both axes",
            "coulomb_friction",
            tracker(PAPER, coulomb=(0.03, 0.03)),
            {},
            inertia,
        ),
        (
            "tracker, paper's steps",
            "drives that saturate at 0.12 N m",
            "saturation",
            tracker(PAPER, limit=(0.12, 0.12)),
            {},
            inertia,
        ),
        ("tracker, paper's steps", "nothing", "", tracker(PAPER), {}, inertia),
        (
            "space manipulator",
            "a floating base of 2.5 t",
            "base_motion",
            space((2500.0, 2000.0)),
            torque,
            body,
        ),
        (
            "space manipulator",
            "a floating base of 25 t",
            "base_motion",
            space((25000.0, 20000.0)),
            torque,
            body,
        ),
        (
            "space manipulator",
            "a floating base of 250 t",
            "base_motion",
            space((250000.0, 200000.0)),
            torque,
            body,
        ),
        (
            "space manipulator",
            "40 % of the payload, lost half-way",
            "",
            space((1e9, 1e9), 0.6),
            torque,
            body,
        ),
    ]


def row(
    rig: str, withheld: str, effect: str, found: Diagnosis, truth: dict[str, float]
) -> dict[str, Any]:
    wrong = {
        k: 100 * (p.value / truth[k] - 1) for k, p in found.nominal.parameters.items() if k in truth
    }
    after = {
        k: 100 * (p.value / truth[k] - 1) for k, p in found.final.parameters.items() if k in truth
    }
    worst = max(wrong, key=lambda k: abs(wrong[k]))

    def numbers(e):
        return ", ".join(f"{k} {p.value:.3g}" for k, p in e.parameters.items())

    hidden = [u for u in found.unseen if not u.absorbed and u.moved]
    return {
        "rig": rig,
        "withheld": withheld,
        "gap, re-tuned": round(found.how_far.gap_retuned, 3),
        "worst number, re-tuned": f"{worst} {wrong[worst]:+.3g} %",
        "verdict": found.which.verdict,
        "named": " and ".join(f"{e} ({numbers(e)})" for e in found.which.effects),
        "gap after": round(found.how_far.gap_after, 3),
        "the same number after": f"{after[worst]:+.3g} %",
        "said not to show": f"{len(hidden)} effects" if hidden else "",
        "the withheld one among them": "; ".join(
            f"{u} of {', '.join(f'{x:.3g} {unit}' for x, unit in u.parameters.values())}: {u.moved[0].name} "
            f"{u.moved[0].without:.3g} -> {u.moved[0].beside:.3g}"
            for u in hidden
            if u.effect == effect
        ),
        "in words": "" if found.which.effects else found.which.text,
    }


def main() -> dict[str, Any]:
    rows = []
    for rig, withheld, effect, data, settings, truth in cases():
        began = time.perf_counter()
        found = diagnose(None, data, seed=0, **settings)
        rows.append(
            row(rig, withheld, effect, found, truth) | {"s": round(time.perf_counter() - began, 1)}
        )
        print(rows[-1], flush=True)
    about = (__doc__ or "").split("\n", 2)[2].strip()
    return {"title": "What a residual does not show", "text": about, "rows": rows}


if __name__ == "__main__":
    main()
