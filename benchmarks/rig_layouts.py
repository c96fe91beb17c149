"""Layouts that people build on benches, as twins of their own equations, with the model that a user
would write for each.

    python benchmarks/rig_layouts.py [--seeds N] [--layouts NAME,...] [--questions fit,none,withheld,check]

A cart-pole and a rotary pendulum driven by volts (back EMF, encoders on both joints), a pneumatic
cylinder driven by two pressures, a rack on a pinion with Stribeck friction, a wheel that spins
down. Every twin (SciPy's `solve_ivp`, standstill by its events) is written apart from the model,
which follows the recipe of the README; encoders are quantised. Asked are fits with nothing missing
(shares of the 95 % intervals that hold the truth), diagnoses with nothing missing and with one
effect withheld, and `jaxid.check` where a convention of the bench is broken, alone and beside a
withheld effect.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import pi
from pathlib import Path
from typing import Any

from jaxid.runtime import prepare


prepare()
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402

import jaxid  # noqa: E402
from benchmarks.rig_twins import (  # noqa: E402
    Cylinder,
    Furuta,
    FurutaTwin,
    multisine,
    Rack,
    SlideTwin,
    Wheel,
)
from jaxid.benchmark.cart_pole import CartPole  # noqa: E402
from jaxid.benchmark.scipy_twin import CartPoleTwin, motion  # noqa: E402
from jaxid.data.dataset import ModelSpec  # noqa: E402


# ---- layouts


@dataclass(frozen=True)
class Layout:
    """A twin and its model: what is withheld by effect and place (settings of the twin), true
    numbers, encoders' steps.
    """

    model: type
    twin: Callable[..., Any]
    truth: Mapping[str, float]
    steps: Mapping[str, float]
    inputs: Callable[[np.random.Generator, np.ndarray], np.ndarray]
    withheld: Mapping[str, Mapping[str, float]]
    rate: float = 100.0
    seconds: float = 8.0
    constants: Mapping[str, float] = field(default_factory=dict)
    without: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    spins: tuple[float, ...] = ()


def one_input(size: float, low: float, high: float):
    return lambda rng, t: multisine(rng, t, size, low, high)[:, None]


def pressures(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Both chambers, about pressures that hold the piston where it is; one fills while the other
    empties, each in its own way.
    """
    filling, own = multisine(rng, t, 35e3, 0.3, 2.0), multisine(rng, t, 15e3, 0.3, 2.0)
    return np.stack([3e5 + filling, 3e5 * 0.025**2 / (0.025**2 - 0.010**2) - filling + own], 1)


BORE, RING = pi / 4 * 0.025**2, pi / 4 * (0.025**2 - 0.010**2)
LAYOUTS = {
    "cart-pole, volts": Layout(
        CartPole, CartPoleTwin,
        {"cart": 0.82, "J": 0.0335, "viscous_x": 3.0, "viscous_theta": 0.0024, "coulomb_x": 0.6},
        {"x": 2.275e-5, "theta": 2 * pi / 4096}, one_input(4.0, 0.3, 2.0),
        {"dead_zone@u": {"dead_zone": 0.4}, "input_delay@u": {"delay": 0.018}}, constants={"coulomb_theta": 0.0},
    ),
    "rotary pendulum, volts": Layout(
        Furuta, FurutaTwin,
        {"J_arm": 2.3e-4, "J_pendulum": 1.33e-4, "viscous_theta": 1.2e-4, "viscous_alpha": 4e-5, "coulomb_theta": 6e-4},
        {"theta": 2 * pi / 2048, "alpha": 2 * pi / 2048}, one_input(2.0, 0.4, 2.5),
        {"spring_torque@theta": {"cable": 0.003}, "input_delay@u": {"delay": 0.014}}, constants={"coulomb_alpha": 0.0},
    ),
    "pneumatic cylinder, two pressures": Layout(
        Cylinder, lambda **more: SlideTwin((BORE, -RING), 2.5, 80.0, 8.0, **more),
        {"mass": 2.5, "viscous": 80.0, "coulomb": 8.0}, {"position": 1e-5}, pressures,
        {"stribeck_friction@position": {"more": 6.0, "at": 0.02}, "constant_torque@position": {"load": 4.0}},
    ),
    "rack and pinion, current": Layout(
        Rack, lambda more=1.5, at=0.02, **other: SlideTwin((0.0467 / 0.0127,), 1.2, 6.0, 2.0, more, at, **other),
        {"mass": 1.2, "viscous": 6.0, "coulomb": 2.0, "stribeck_friction.extra@position": 1.5,
         "stribeck_friction.speed@position": 0.02},
        {"position": 2e-5}, one_input(1.3, 0.3, 2.0),
        {"stribeck_friction@position": {}, "input_delay@i": {"delay": 0.013}},
        without={"stribeck_friction@position": ("stribeck_friction",)},
    ),
    "wheel, spin-down": Layout(
        Wheel, lambda **more: SlideTwin((), 0.012, 2e-4, 0.01, **more), {"viscous": 2e-4, "coulomb": 0.01},
        {"qd": 2 * pi / 60}, lambda rng, t: np.zeros((len(t), 1)), {"quadratic_drag@q": {"drag": 1.5e-6}},
        rate=20.0, seconds=90.0, spins=(150.0, 90.0, 120.0, 60.0),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Recording:
    """Runs of a layout as arrays [runs] of [time channels]: time, inputs, readings."""

    layout: Layout
    t: np.ndarray
    u: list[np.ndarray]
    y: list[np.ndarray]

    def dataset(self, **settings: Any) -> jaxid.Dataset:
        own = self.layout.model.signatures[0]
        data = jaxid.Dataset.from_arrays(
            [self.t] * len(self.y),
            {name: [u[:, k] for u in self.u] for k, (name, _) in enumerate(own.inputs)},
            {name: [y[:, k] for y in self.y] for k, (name, _) in enumerate(own.outputs)},
            units=dict((*own.inputs, *own.outputs)),
            resolution=dict(self.layout.steps),
            split=["fit", "fit", "validation", "report"][: len(self.y)],
            at_rest=not self.layout.spins,
            check_model=False,
            **settings,
        )
        return replace(
            data, model=ModelSpec(constants=dict(self.layout.constants), free=not own.inputs)
        )


def record(name: str, seed: int, withheld: str = "", runs: int = 4) -> Recording:
    """Runs of a twin; of the effect the model then lacks, or of what the model has."""
    layout = LAYOUTS[name]
    rng = np.random.default_rng([seed, len(name)])
    more = dict(layout.withheld.get(withheld, {}))
    delay = more.pop("delay", 0.0)
    plant = layout.twin(**more)
    own = layout.model.signatures[0]
    t = np.arange(int(layout.seconds * layout.rate)) / layout.rate
    inputs, readings = [], []
    for run in range(runs):
        u = layout.inputs(rng, t)
        n = len(own.joints)
        start = (
            np.array([layout.spins[run] * rng.uniform(0.9, 1.1)]) if layout.spins else np.zeros(n)
        )
        q, v = motion(plant, t, u, np.zeros(n), start, delay)
        exact = v if own.speeds else q
        step = np.array([layout.steps[c] for c, _ in own.outputs])
        inputs.append(u)
        phase = (
            0.0 if own.speeds else rng.uniform(-0.5, 0.5, step.size)
        )  # of an encoder's first edge
        readings.append(np.round(exact / step + phase) * step)
    return Recording(layout, t, inputs, readings)


# ---- broken conventions of a bench


@dataclass(frozen=True)
class Broken:
    """A convention broken: how, and the findings (kind, channels of which one is named) that say
    it; none where nobody can.
    """

    change: Callable[
        [list[np.ndarray], list[np.ndarray]], tuple[list[np.ndarray], list[np.ndarray]]
    ]
    found: tuple[str, tuple[str, ...]] | None


def times(which: str, column: int, factor: float, offset: float = 0.0):
    """An input's or a reading's column times a factor, plus an offset."""

    def change(u, y):
        own = [x.copy() for x in (u if which == "u" else y)]
        for x in own:
            x[:, column] = factor * x[:, column] + offset
        return (own, y) if which == "u" else (u, own)

    return change


def LATE(u, y):
    return ([x[:-1] for x in u], [x[1:] for x in y])


def SIZE(u, y):
    return ([np.abs(x) for x in u], y)


def SWAPPED(u, y):
    return ([x[:, ::-1].copy() for x in u], y)


def drifting(u, y):
    """Inputs by a clock that is 1500 ppm fast, at 100 Hz."""
    t = np.arange(len(u[0])) / 100
    return [
        np.stack([np.interp(t / 1.0015, t, x[:, k]) for k in range(x.shape[1])], 1) for x in u
    ], y


def two_joints(first: str, second: str) -> dict[str, Broken]:
    """What may be wrong with a cart or an arm that carries a pendulum."""
    return {
        "sign of u": Broken(times("u", 0, -1.0), ("sign", ("u",))),
        f"sign of {second}": Broken(times("y", 1, -1.0), ("sign", (second,))),
        f"{second} is 0 upright": Broken(times("y", 1, 1.0, pi), ("zero", (second,))),
        f"{second} is 0 horizontal": Broken(times("y", 1, 1.0, pi / 2), ("zero", (second,))),
        f"{second} in degrees": Broken(times("y", 1, 180 / pi), ("scale", (second,))),
        "one row late": Broken(LATE, ("row_shift", ("u", first, second))),
        "clock": Broken(drifting, ("clock", ("u", first, second))),
        "size of u alone": Broken(SIZE, ("unsigned", ("u",))),
    }


CONVENTIONS = {
    "cart-pole, volts": two_joints("x", "theta"),
    "rotary pendulum, volts": two_joints("theta", "alpha"),
    "pneumatic cylinder, two pressures": {
        "sign of position": Broken(times("y", 0, -1.0), ("sign", ("position", "p_a", "p_b"))),
        "chambers exchanged": Broken(SWAPPED, ("swapped_channels", ("p_a", "p_b"))),
        "one row late": Broken(LATE, ("row_shift", ("p_a", "p_b", "position"))),
        "clock": Broken(drifting, ("clock", ("p_a", "p_b", "position"))),
    },
    "rack and pinion, current": {
        "sign of i": Broken(times("u", 0, -1.0), ("sign", ("i", "position"))),
        "one row late": Broken(LATE, ("row_shift", ("i", "position"))),
        "clock": Broken(drifting, ("clock", ("i", "position"))),
        "size of i alone": Broken(SIZE, ("unsigned", ("i",))),
        "i in mA": Broken(times("u", 0, 1000.0), None),  # mass and friction take it up
    },
    "wheel, spin-down": {
        "speed in rpm": Broken(times("y", 0, 30 / pi), None)
    },  # friction takes it up
}


# ---- questions


def fitted(name: str, seeds: Sequence[int]) -> dict[str, Any]:
    """Fits with nothing missing: how many converge, and the share of 95 % intervals that hold the
    truth.
    """
    layout, off, states = LAYOUTS[name], [], []
    for seed in seeds:
        fit = jaxid.fit(layout.model(), record(name, seed, runs=3).dataset(), seed=seed)
        own = {k: fit.parameters[k] for k in layout.truth}
        off += [abs(p.value - layout.truth[k]) / p.std for k, p in own.items() if p.std]
        states.append(fit.state)
        print(
            f"{name}, seed {seed}: {fit.state}, loss {fit.loss:.3g}, off by {max(off[-len(own) :]):.2g}",
            file=sys.stderr,
        )
    return {
        "question": "fit, nothing missing",
        "asked": f"{len(states)} fits",
        "right": f"{states.count('converged')} converged, {sum(d < 1.96 for d in off)} of {len(off)} intervals hold the truth",
        "wrong": sum(d > 4 for d in off),
    }


def diagnosed(name: str, withheld: str, seed: int) -> dict[str, Any]:
    """A diagnosis with one effect withheld ("": none): right where it is named or in the set that
    the data leave open.
    """
    layout = LAYOUTS[name]
    data = record(name, seed, withheld).dataset()
    which = jaxid.diagnose(layout.model(), data, without=layout.without.get(withheld, ())).which
    told = [f"{e.effect}@{e.location}" for e in which.effects]
    others = [f"{e.effect}@{e.location}" for e in which.confusable_with]
    claims = which.verdict in ("named", "partly")
    right = which.verdict == "none" if not withheld else claims and withheld in (*told, *others)
    said = ", ".join((which.verdict, *told)) + (f" (or {', '.join(others)})" if others else "")
    return {
        "question": f"diagnose, {withheld or 'nothing'} withheld",
        "asked": "1 diagnosis",
        "right": said if right else "",
        "wrong": said if not right and which.verdict != "unknown" else 0,
        "not said": "" if right else said,
    }


def conventions(name: str, withheld: str, seed: int) -> dict[str, Any]:
    """Every convention broken, by the measured motion alone: which are found, and what else is
    claimed.
    """
    from jaxid.conventions.checking import run_check

    layout, tally, missed = LAYOUTS[name], Counter[str](), []
    whole = record(name, seed, withheld)
    sound = Broken(lambda u, y: (u, y), ("", ()))
    for what, broken in {"sound": sound, **CONVENTIONS[name]}.items():
        if "input_delay" in withheld and broken.change is LATE:  # which makes up for the delay
            continue
        u, y = broken.change(whole.u, whole.y)
        own = replace(whole, t=whole.t[: len(y[0])], u=u, y=y)
        findings = run_check(
            layout.model(), own.dataset(), layout.without.get(withheld, ())
        ).findings
        kind, channels = broken.found or ("", ())
        # A run whose first row was lost does begin in motion; what is but asked claims nothing.
        hit = [f for f in findings if f.kind == kind and f.channel in channels]
        rest = [f for f in findings if f not in hit and f.decisive and f.kind != "not_at_rest"]
        tally["asked"] += bool(kind)
        tally["found"] += bool(hit)
        tally["claimed wrongly"] += bool(rest)
        missed += [what] if kind and not hit else []
        missed += [f"{what}: claims {f.kind} of {f.channel}" for f in rest]
    return {
        "question": f"check, {withheld or 'nothing'} withheld",
        "asked": f"{tally['asked']} conventions broken, 1 sound",
        "right": f"{tally['found']} found",
        "wrong": tally["claimed wrongly"],
        "not said": ", ".join(missed),
    }


QUESTIONS = "fit", "none", "withheld", "check"


def main(
    seeds: int = 8, layouts: Sequence[str] = (), questions: Sequence[str] = QUESTIONS
) -> dict[str, Any]:
    rows = []
    for name in (n for n in LAYOUTS if not layouts or any(part in n for part in layouts)):
        asked: list[Callable[[], dict[str, Any]]] = []
        if "fit" in questions:
            asked.append(lambda n=name: fitted(n, range(seeds)))
        if "none" in questions:
            asked.append(lambda n=name: diagnosed(n, "", 1))
        effects = tuple(LAYOUTS[name].withheld)
        if "withheld" in questions:
            asked += [lambda n=name, e=e: diagnosed(n, e, 1) for e in effects]
        if "check" in questions:
            asked += [lambda n=name, e=e: conventions(n, e, 2) for e in ("", *effects)]
        for ask in asked:
            rows.append({"layout": name, **ask()})
            print(rows[-1], file=sys.stderr, flush=True)
    text = " ".join((__doc__ or "").split("\n\n")[-1].split())
    return {"title": "Layouts of benches, rebuilt", "text": text, "rows": rows}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--layouts", type=lambda x: x.split(","), default=())
    parser.add_argument("--questions", type=lambda x: x.split(","), default=QUESTIONS)
    print(json.dumps(main(**vars(parser.parse_args())), indent=1))
