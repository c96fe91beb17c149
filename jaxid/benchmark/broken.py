"""Recordings whose conventions are broken, of motions whose torque is worked out by the twins'
equations: no simulation and no line of the product makes the data.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi
from typing import Any

import numpy as np
from scipy.signal import butter, lfilter

from jaxid.benchmark.plants import NEUTRAL, PLANTS, TwinPlant
from jaxid.data.dataset import Dataset


MODELS = ("pendulum", "planar_arm", "tracker")
SECONDS, SPLITS = 10.0, ("fit", "fit", "validation")


@dataclass
class SoundRecording:
    """Runs of a plant as arrays: t [time], u and y [runs time channels]."""

    plant: TwinPlant
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
) -> SoundRecording:
    """A sound recording; `effect` is one that the model lacks: "" | "drag" | "spring"."""
    plant, rng = PLANTS[model], np.random.default_rng([seed, len(model)])
    t = np.arange(int(SECONDS * plant.rate)) / plant.rate
    h = t[1]
    runs = len(SPLITS)
    u, y = np.zeros((runs, len(t), plant.n)), np.zeros((runs, len(t), plant.n))
    for r in range(runs):
        size = 0.3 if model == "tracker" else 0.5
        waves = [_wave(rng, reach * size) for _ in range(plant.n)]
        y[r] = np.stack([w(t)[0] for w in waves], 1)
        # A held input acts by its mean over the step.
        middle = [w(t + h / 2) for w in waves]
        q, v, a = (np.stack(x, 1) for x in zip(*middle, strict=True))
        u[r] = torque(plant, q, v, a, effect)
    level = plant.noise if noise is None else noise
    return SoundRecording(
        plant, t, u, y + level * rng.standard_normal(y.shape), made=(seed, effect)
    )


def _wave(rng: np.random.Generator, reach: float):
    f, phase = rng.uniform(0.15, 1.6, 7), rng.uniform(0, 2 * pi, 7)
    a = reach * rng.uniform(0.4, 1.0, 7) / np.maximum(f, 0.4) / 3

    def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        w = 2 * pi * f
        x = w * t[:, None] + phase
        return (a * np.sin(x)).sum(1), (a * w * np.cos(x)).sum(1), -(a * w * w * np.sin(x)).sum(1)

    return motion


def torque(
    plant: TwinPlant, q: np.ndarray, v: np.ndarray, acceleration: np.ndarray, effect: str
) -> np.ndarray:
    """What a motion [time n] takes, with friction and an effect that the model lacks."""

    def wide(x):
        return np.broadcast_to(np.asarray(x, float), (plant.n,))

    p = {k: wide(x)[None] for k, x in (NEUTRAL | plant.nominal).items()}
    M, bias = plant.matrices(q, v, {k: np.repeat(x, len(q), 0) for k, x in p.items()})
    T, V = np.array(plant.torque), np.array(plant.speed)
    lacking = {"": 0 * v, "drag": 0.15 * T / V**2 * v * np.abs(v), "spring": 0.1 * T * q}[effect]
    friction = p["viscous"] * v + p["coulomb"] * np.sign(v) + p["offset"]
    return np.einsum("tij,tj->ti", M, acceleration) + bias + friction + lacking


Fault = tuple[SoundRecording, str, float | None]


def broken(kind: str, r: SoundRecording, rng: np.random.Generator) -> Fault:
    """The recording with one convention broken, the channel at fault, and the size of the fault."""
    return _FAULTS[kind](r, rng)


def _last(r: SoundRecording) -> tuple[int, str, str]:
    """The last joint, for gravity acts on it; its output and its input."""
    j = r.plant.n - 1
    return j, r.plant.outputs[j][0], r.plant.inputs[j][0]


def _sign(r: SoundRecording, rng: np.random.Generator) -> Fault:
    (j, _, tau), u = _last(r), r.u.copy()
    u[:, :, j] *= -1
    return replace(r, u=u), tau, -1.0


def _zero(r: SoundRecording, rng: np.random.Generator) -> Fault:
    (j, out, _), y = _last(r), r.y.copy()
    y[:, :, j] += pi / 2
    return replace(r, y=y), out, pi / 2


def _scale(r: SoundRecording, rng: np.random.Generator) -> Fault:
    (j, out, _), y = _last(r), r.y.copy()
    y[:, :, j] *= 180 / pi
    return replace(r, y=y), out, 180 / pi


def _row_shift(r: SoundRecording, rng: np.random.Generator) -> Fault:
    return replace(r, u=r.u[:, :-1], y=r.y[:, 1:], t=r.t[:-1]), _last(r)[2], 1.0


def _swapped(r: SoundRecording, rng: np.random.Generator) -> Fault:
    return replace(r, u=r.u[:, :, ::-1].copy()), r.plant.inputs[0][0], 1.0


def _wrapped(r: SoundRecording, rng: np.random.Generator) -> Fault:
    """Of a wider motion, for it has to go beyond half a turn."""
    wide = recording(r.plant.model, *r.made, reach=8.0)
    (j, out, _), y = _last(r), wide.y.copy()
    y[:, :, j] = (y[:, :, j] + pi) % (2 * pi) - pi
    return replace(r, u=wide.u, y=y), out, 2 * pi


def _glitch(r: SoundRecording, rng: np.random.Generator) -> Fault:
    (j, out, _), y = _last(r), r.y.copy()
    for run in range(len(y)):
        readings = rng.choice([0.0, 2.5, -4.0], 5)
        at = rng.choice(len(r.t) - 40, 5, replace=False) + 20
        y[run, at, j] = readings
    return replace(r, y=y), out, None


def _repeated_rows(r: SoundRecording, rng: np.random.Generator) -> Fault:
    (j, out, _), y = _last(r), r.y.copy()
    y[:, :, j] = y[:, np.arange(len(r.t)) // 4 * 4, j]
    return replace(r, y=y), out, 4.0


def _clock(r: SoundRecording, rng: np.random.Generator) -> Fault:
    u, ppm = r.u.copy(), float(rng.choice([800.0, -1500.0]))
    for run in range(len(u)):
        for k in range(r.plant.n):
            u[run, :, k] = np.interp(r.t / (1 + 1e-6 * ppm), r.t, u[run, :, k])
    return replace(r, u=u), _last(r)[2], ppm


def _time_unit(r: SoundRecording, rng: np.random.Generator) -> Fault:
    return replace(r, t=1000 * r.t), "t", None


def _not_at_rest(r: SoundRecording, rng: np.random.Generator) -> Fault:
    return replace(r, at_rest=True), _last(r)[1], None


def _does_not_move(r: SoundRecording, rng: np.random.Generator) -> Fault:
    (j, out, _), y = _last(r), r.y.copy()
    y[:, :, j] = 0.3 + r.plant.noise * rng.standard_normal(y[:, :, j].shape)
    return replace(r, y=y), out, 0.0


def _unsigned(r: SoundRecording, rng: np.random.Generator) -> Fault:
    return replace(r, u=np.abs(r.u)), r.plant.inputs[0][0], None


def _filtered(r: SoundRecording, rng: np.random.Generator) -> Fault:
    (j, out, _), y = _last(r), r.y.copy()
    b, a = butter(3, 12.0, fs=r.plant.rate)  # pyright: ignore
    noisy = y[:, :, j] + 30 * r.plant.noise * rng.standard_normal(y[:, :, j].shape)
    y[:, :, j] = lfilter(b, a, noisy - noisy[:, :1], axis=1) + noisy[:, :1]
    return replace(r, y=y), out, 12.0


def _saturated(r: SoundRecording, rng: np.random.Generator) -> Fault:
    (j, _, tau), u = _last(r), r.u.copy()
    end = np.percentile(np.abs(u[:, :, j]), 75)
    u[:, :, j] = np.clip(u[:, :, j], -end, end)
    return replace(r, u=u), tau, end


_FAULTS = {
    "sign": _sign,
    "zero": _zero,
    "scale": _scale,
    "row_shift": _row_shift,
    "swapped_channels": _swapped,
    "wrapped": _wrapped,
    "glitch": _glitch,
    "repeated_rows": _repeated_rows,
    "clock": _clock,
    "time_unit": _time_unit,
    "not_at_rest": _not_at_rest,
    "does_not_move": _does_not_move,
    "unsigned": _unsigned,
    "filtered": _filtered,
    "saturated": _saturated,
}
KINDS = tuple(_FAULTS)
