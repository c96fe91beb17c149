"""Recordings whose conventions are broken: 15 kinds on three models, with and without an effect
that the model lacks as well.

    python benchmarks/conventions.py [--seed N] [--simulate] [--diagnose MODEL,...]

The motion is a multisine; the torque that it takes is worked out by the equations of
benchmarks/twins.py, so no simulation and no line of the product makes the data. Prints what
`jaxid.check` finds: of each kind the finding, its size, and what else was claimed. With --simulate
the findings are confirmed by simulation, as the command does; with --diagnose each recording of
these models is diagnosed, and counted is where an effect is named that only stands in for what is
broken.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.twins import NEUTRAL, Plant, PLANTS  # noqa: E402
from jaxid.data.dataset import Dataset
from jaxid.errors import DatasetError  # noqa: E402


MODELS = ("pendulum", "planar_arm", "tracker")
KINDS = (
    "sign",
    "zero",
    "scale",
    "row_shift",
    "swapped_channels",
    "wrapped",
    "glitch",
    "repeated_rows",
    "clock",
    "time_unit",
    "not_at_rest",
    "does_not_move",
    "unsigned",
    "filtered",
    "saturated",
)
SECONDS, SPLITS = 10.0, ("fit", "fit", "validation")


@dataclass
class Recording:
    """Runs of a plant as arrays: t [time], u and y [runs time channels]."""

    plant: Plant
    t: np.ndarray
    u: np.ndarray
    y: np.ndarray
    at_rest: bool = False
    made: tuple[int, str] = (0, "")  # seed, effect

    def dataset(self, **settings: Any) -> Dataset:
        """As a dataset of its model."""

        def names(ports):
            return [n for n, _ in ports]

        return Dataset.from_arrays(
            [self.t] * len(self.u),
            inputs={n: list(self.u[:, :, i]) for i, n in enumerate(names(self.plant.inputs))},
            outputs={n: list(self.y[:, :, i]) for i, n in enumerate(names(self.plant.outputs))},
            units=dict((*self.plant.inputs, *self.plant.outputs)),
            split=list(SPLITS[: len(self.u)]),
            at_rest=self.at_rest,
            model=self.plant.model,
            **settings,
        )


def recording(
    model: str, seed: int, effect: str = "", reach: float = 1.0, noise: float | None = None
) -> Recording:
    """A sound recording; `effect` is one that the model lacks: "" | "drag" | "spring"."""
    plant, rng = PLANTS[model], np.random.default_rng([seed, len(model)])
    t = np.arange(int(SECONDS * plant.rate)) / plant.rate
    h = t[1]
    runs = len(SPLITS)
    u, y = np.zeros((runs, len(t), plant.n)), np.zeros((runs, len(t), plant.n))
    for r in range(runs):
        waves = [_wave(rng, reach * (0.3 if model == "tracker" else 0.5)) for _ in range(plant.n)]
        y[r] = np.stack([w(t)[0] for w in waves], 1)
        # A held input acts by its mean over the step.
        q, v, a = (np.stack(x, 1) for x in zip(*(w(t + h / 2) for w in waves), strict=True))
        u[r] = torque(plant, q, v, a, effect)
    level = plant.noise if noise is None else noise
    return Recording(plant, t, u, y + level * rng.standard_normal(y.shape), made=(seed, effect))


def _wave(rng: np.random.Generator, reach: float):
    f, phase = rng.uniform(0.15, 1.6, 7), rng.uniform(0, 2 * pi, 7)
    a = reach * rng.uniform(0.4, 1.0, 7) / np.maximum(f, 0.4) / 3

    def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        w = 2 * pi * f
        x = w * t[:, None] + phase
        return (a * np.sin(x)).sum(1), (a * w * np.cos(x)).sum(1), -(a * w * w * np.sin(x)).sum(1)

    return motion


def torque(
    plant: Plant, q: np.ndarray, v: np.ndarray, acceleration: np.ndarray, effect: str
) -> np.ndarray:
    """What a motion [time n] takes, with friction and an effect that the model lacks."""

    def wide(x):
        return np.broadcast_to(np.asarray(x, float), (plant.n,))

    p = {
        k: wide(plant.nominal.get(k, NEUTRAL.get(k, 0.0)))[None] for k in (*plant.nominal, *NEUTRAL)
    }
    M, bias = plant.matrices(q, v, {k: np.repeat(x, len(q), 0) for k, x in p.items()})
    T, V = np.array(plant.torque), np.array(plant.speed)
    lacking = {"": 0 * v, "drag": 0.15 * T / V**2 * v * np.abs(v), "spring": 0.1 * T * q}[effect]
    friction = p["viscous"] * v + p["coulomb"] * np.sign(v) + p["offset"]
    return np.einsum("tij,tj->ti", M, acceleration) + bias + friction + lacking


def broken(
    kind: str, r: Recording, rng: np.random.Generator
) -> tuple[Recording, str, float | None]:
    """The recording with one convention broken, the channel at fault, and the size of the fault."""
    u, y, t = r.u.copy(), r.y.copy(), r.t
    j = r.plant.n - 1  # of joints; gravity acts on the last one
    out, tau = r.plant.outputs[j][0], r.plant.inputs[j][0]

    def new(u=u, y=y, t=t, rest=False):
        return Recording(r.plant, t, u, y, rest)

    if kind == "sign":
        u[:, :, j] *= -1
        return new(), tau, -1.0
    if kind == "zero":
        y[:, :, j] += pi / 2
        return new(), out, pi / 2
    if kind == "scale":
        y[:, :, j] *= 180 / pi
        return new(), out, 180 / pi
    if kind == "row_shift":
        return new(u[:, :-1], y[:, 1:], t[:-1]), tau, 1.0
    if kind == "swapped_channels":
        return new(u[:, :, ::-1].copy()), r.plant.inputs[0][0], 1.0
    if kind == "wrapped":  # a wider motion, for it has to go beyond half a turn
        wide = recording(r.plant.model, *r.made, reach=8.0)
        y = wide.y.copy()
        y[:, :, j] = (y[:, :, j] + pi) % (2 * pi) - pi
        return new(wide.u, y), out, 2 * pi
    if kind == "glitch":
        for run in range(len(y)):
            y[run, rng.choice(len(t) - 40, 5, replace=False) + 20, j] = rng.choice(
                [0.0, 2.5, -4.0], 5
            )
        return new(), out, None
    if kind == "repeated_rows":
        y[:, :, j] = y[:, np.arange(len(t)) // 4 * 4, j]
        return new(), out, 4.0
    if kind == "clock":
        ppm = float(rng.choice([800.0, -1500.0]))
        for run in range(len(u)):
            for k in range(r.plant.n):
                u[run, :, k] = np.interp(t / (1 + 1e-6 * ppm), t, u[run, :, k])
        return new(), tau, ppm
    if kind == "time_unit":
        return new(t=1000 * t), "t", None
    if kind == "not_at_rest":
        return new(rest=True), out, None
    if kind == "does_not_move":
        y[:, :, j] = 0.3 + r.plant.noise * rng.standard_normal(y[:, :, j].shape)
        return new(), out, 0.0
    if kind == "unsigned":
        return new(np.abs(u)), r.plant.inputs[0][0], None
    if kind == "filtered":
        from scipy.signal import butter, lfilter

        b, a = butter(3, 12.0, fs=r.plant.rate)  # pyright: ignore
        noisy = y[:, :, j] + 30 * r.plant.noise * rng.standard_normal(y[:, :, j].shape)
        y[:, :, j] = lfilter(b, a, noisy - noisy[:, :1], axis=1) + noisy[:, :1]
        return new(), out, 12.0
    assert kind == "saturated"
    end = np.percentile(np.abs(u[:, :, j]), 75)
    u[:, :, j] = np.clip(u[:, :, j], -end, end)
    return new(), tau, end


def found(r: Recording, simulate: bool = False) -> list[Any]:
    """What the check says of a recording."""
    from jaxid.conventions import checking, runs
    from jaxid.fitters.short_fit import left_by_short_fit

    try:
        data = r.dataset()
    except DatasetError as error:
        return runs.refused(error)
    return list(
        checking.run_check(
            r.plant.model, data, gap=left_by_short_fit if simulate else None
        ).findings
    )


#: Faults of a clock or of rows that all inputs share, and of a start that all outputs do: found at
#: any of them.
SHARED = {"row_shift": "input", "clock": "input", "not_at_rest": "output"}


def right(finding: Any, kind: str, channel: str, plant: Plant) -> bool:
    """Whether a finding says what was broken."""
    ports = {"input": plant.inputs, "output": plant.outputs}.get(SHARED.get(kind, ""), ())
    at = {channel, *(n for n, _ in ports)}
    return finding.kind == kind and bool(at & {finding.channel, *(c for _, c in finding.same_as)})


#: What a diagnosis is asked for: the usual stand-ins of signs, zeros and units. And what it may
#: name beside the drag of a recording that has it: the effect that is what the finding says.
FEW = ("spring_torque", "torque_ripple", "quadratic_drag")
MEANT = {"saturated": {"saturation"}, "filtered": {"sensor_lag", "sensor_delay"}}


def stand_ins(
    r: Recording, kind: str, effect: str, effects: Sequence[str] | None = FEW
) -> tuple[str, list[str]]:
    """The verdict of a diagnosis (of these effects, else the library), and what is named in place
    of the broken convention.
    """
    import jaxid

    try:
        d = jaxid.diagnose(None, r.dataset(), effects=effects)
    except (DatasetError, jaxid.UsageError) as error:
        return f"refused: {str(error).splitlines()[0][:60]}", []
    meant = MEANT.get(kind, set()) | ({"quadratic_drag"} if effect else set())
    named = [f"{e.effect}@{e.location}" for e in d.which.effects]
    wrong = [n for n in named if d.which.verdict == "named" and n.split("@")[0] not in meant]
    return f"{d.which.verdict} {' '.join(named)}".strip(), wrong


#: The seed of the kept result: taken once, for it alone.
FRESH = 88118


def main(
    seed: int = FRESH, simulate: bool = False, diagnose: Sequence[str] = ("pendulum",)
) -> dict[str, Any]:
    """Of each model how many were found, where they were not or something else was claimed, and
    what diagnoses named instead.
    """
    rows = []
    for model in MODELS:
        kept = ("found", "missed", "something else claimed", "diagnosed", "stands in")
        counted: dict[str, list[str]] = {k: [] for k in kept}
        for kind in KINDS:
            if kind == "swapped_channels" and PLANTS[model].n == 1:
                continue
            for effect in ("", "drag"):
                rng = np.random.default_rng([seed, KINDS.index(kind), len(model)])
                r, channel, value = broken(kind, recording(model, seed, effect), rng)
                findings = found(r, simulate)
                own = [f for f in findings if right(f, kind, channel, r.plant)]
                rest = [f for f in findings if f not in own and f.decisive]
                counted["found" if own else "missed"].append(kind)
                counted["something else claimed"] += [
                    f"{f.kind} of {f.channel}, where {kind} is broken" for f in rest
                ]
                size = (
                    ""
                    if not own
                    else f"{own[0].value} (true {value}) {'decisive' if own[0].decisive else 'question'}"
                )
                print(
                    f"{model:11} {kind:17} {effect or '-':5} {'found' if own else 'MISSED':6} {size}",
                    end="",
                )
                print(
                    "".join(f"  ALSO {f.kind} of {f.channel} {f.value}" for f in rest), flush=True
                )
                if model in diagnose:
                    verdict, wrong = stand_ins(r, kind, effect)
                    counted["diagnosed"].append(kind)
                    counted["stands in"] += [f"{', '.join(wrong)} for {kind}"] if wrong else []
                    print(
                        f"{'':18} diagnosed: {verdict}{'  STANDS IN' if wrong else ''}", flush=True
                    )
        hits, count = len(counted["found"]), len(counted["found"]) + len(counted["missed"])

        def listed(key, own=counted):
            return ", ".join(dict.fromkeys(own[key])) or "-"

        asked = len(counted["diagnosed"])
        rows.append(
            {"model": model, "found": f"{hits} of {count}"}
            | {k: listed(k) for k in ("missed", "something else claimed")}
            | {
                "an effect named in its place": f"{len(counted['stands in'])} of {asked}"
                if asked
                else "not asked"
            }
        )
    text = (
        "Recordings with one convention broken, 15 kinds on three models, with and without a drag that the model lacks; seed "
        f"{seed}, run once. What all inputs or outputs share (a clock, a row, a start in motion) is found at any of them."
    )
    if any(diagnose):
        text += " Recordings are diagnosed too, among a few effects: one that is named in place of what is broken is wrong."
    return {"title": "Broken conventions", "text": text, "rows": rows}


if __name__ == "__main__":
    from jaxid import runtime

    runtime.prepare()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--simulate", action="store_true")
    parser.add_argument("--diagnose", default="")
    arguments = parser.parse_args()
    print(
        *main(arguments.seed, arguments.simulate, arguments.diagnose.split(","))["rows"], sep="\n"
    )
