"""The wave numbers of laws that repeat with position, as the re-tuned model's rest shows them.

Two waves over a long travel are alike only where they come out of step by less than a radian from
end to end. A grid that misses none has a hundred points at each joint; the one that explains most
is looked for, and pays for all that were tried.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxid.diagnosis.torque.algebra import Weights
from jaxid.diagnosis.torque.library import laws, Unit
from jaxid.diagnosis.torque.plant import Plant
from jaxid.diagnosis.torque.rows import TorqueRun
from jaxid.dynamics.effect import Effect, JointEffect
from jaxid.dynamics.parameter import specs
from jaxid.force.effects import at_every_joint, shapes, strengths, unloaded


#: Unit of a number that says how often a law repeats with position.
PER_POSITION = "rad/{X}"
#: Points between one step of the grid and the next, where the best wave number is sought.
FINER = 10
#: A direction of the model's columns that has less than this share of the largest is none.
WEAK = 1e-8


def wave_number(kind: type[Effect]) -> str:
    """The number of a law at a joint that says how often it repeats with position; "" of others."""
    if not issubclass(kind, JointEffect) or kind.by_torque or kind.transmits:
        return ""
    names = [name for name, spec in specs(kind).items() if spec.unit == PER_POSITION]
    return names[0] if names else ""


@dataclass(frozen=True, eq=False)
class Rest:
    """What columns that every set has leave of one joint's rows: `own` spans them [rows p], `left`
    is the rest of the target [rows], both weighed by `weight` [rows].
    """

    own: np.ndarray
    left: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, rows: np.ndarray, weight: np.ndarray) -> Rest:
        """Of columns and, last, target [rows p + 1]."""
        weighed = rows * weight[:, None]
        columns = weighed[:, :-1]
        size = np.linalg.norm(columns, axis=0)
        alive = size > 0
        basis, strength, _ = np.linalg.svd(columns[:, alive] / size[alive], full_matrices=False)
        own = basis[:, strength > WEAK * strength.max(initial=0.0)]
        target = weighed[:, -1]
        return cls(own, target - own @ (own.T @ target), weight)

    def explained(self, columns: np.ndarray) -> float:
        """The sum of squares that further columns [rows k] take from what is left."""
        weighed = columns * self.weight[:, None]
        beside = weighed - self.own @ (self.own.T @ weighed)
        numbers = np.linalg.lstsq(beside, self.left, rcond=WEAK)[0]
        after = self.left - beside @ numbers
        return float(self.left @ self.left - after @ after)


def wave_units(
    plant: Plant,
    kinds: Sequence[type[Effect]],
    runs: Sequence[TorqueRun],
    fitted: Sequence[int],
    rests: Sequence[Rest],
) -> list[Unit]:
    """Each law that repeats with position at the wave number that explains most of what is left of
    each joint (`rests`, of the `fitted` runs alone).
    """
    out: list[Unit] = []
    for kind in kinds:
        if name := wave_number(kind):
            out += _of_kind(plant, kind, name, runs, [runs[k] for k in fitted], rests)
    return out


def _of_kind(
    plant: Plant,
    kind: Any,
    name: str,
    runs: Sequence[TorqueRun],
    fitted: Sequence[TorqueRun],
    rests: Sequence[Rest],
) -> list[Unit]:
    coarse, steps = _grid(plant, kind, name, fitted)
    gains = _gains(plant, kind, name, coarse, fitted, rests)
    about = coarse[np.argmax(gains, axis=0), np.arange(len(steps))]
    near = about + steps * np.linspace(-1.0, 1.0, 2 * FINER + 1)[:, None]
    fine = np.clip(near, coarse.min(0), coarse.max(0))
    gains = _gains(plant, kind, name, fine, fitted, rests)
    best = fine[np.argmax(gains, axis=0), np.arange(len(steps))]
    grids = [_shapes_of(name, [wave]) for wave in best]
    load = [unloaded(run) for run in runs]
    places = plant.binding.chain.offers(kind)
    return laws(plant, kind, places, runs, load, grids, tried=len(coarse))


def _grid(
    plant: Plant, kind: Any, name: str, runs: Sequence[TorqueRun]
) -> tuple[np.ndarray, np.ndarray]:
    """Wave numbers [points n] from the first to the last probe of each joint, and their steps [n],
    which bring two neighbours out of step by a radian at most along the travel.
    """
    b = plant.binding
    n = b.chain.nq
    linear = strengths(kind, n, runs[0].room)
    low, high = np.zeros(n), np.zeros(n)
    for j in range(n):
        probes = [shape[name] for shape in shapes(kind, b.references[j], linear)]
        low[j], high[j] = min(probes), max(probes)
    every = np.concatenate([run.q for run in runs])
    turns = (high - low) * np.ptp(every, axis=0)
    count = 1 + int(np.ceil(turns.max()))
    return np.linspace(low, high, count), (high - low) / (count - 1)


def _shapes_of(name: str, waves: Iterable[float]) -> list[dict[str, float]]:
    return [{name: float(wave)} for wave in waves]


def _gains(
    plant: Plant,
    kind: Any,
    name: str,
    waves: np.ndarray,
    runs: Sequence[TorqueRun],
    rests: Sequence[Rest],
) -> np.ndarray:
    """What the law takes from the rest of each joint at its own wave numbers [points n]."""
    grids = [_shapes_of(name, own) for own in waves.T]
    load = [unloaded(run) for run in runs]
    out = np.zeros(waves.shape)
    for point, made in enumerate(at_every_joint(kind, grids, runs, load, plant.turn)):
        each = []
        for i, run in enumerate(runs):
            each.append(np.stack([run.rows(forces[i]) for forces in made.values()], axis=-1))
        columns = np.concatenate(each)
        for j, rest in enumerate(rests):
            out[point, j] = rest.explained(columns[:, j])
    return out


def rests_of(
    rows: Sequence[np.ndarray],
    weights: Weights,
    moves: Sequence[np.ndarray],
    unsure: Sequence[np.ndarray],
    size: int,
) -> list[Rest]:
    """What the first `size` columns leave of each joint of some runs, whose rows hold columns and
    target [samples n p + 1].
    """
    shares = []
    for x, moving, known in zip(rows, moves, unsure, strict=True):
        shares.append(weights(np.ones((*x.shape[:2], 1)), moving, known)[:, :, 0])
    out = []
    for j in range(rows[0].shape[1]):
        own = [np.column_stack([x[:, j, :size], x[:, j, -1]]) for x in rows]
        share = np.concatenate([one[:, j] for one in shares])
        out.append(Rest.of(np.concatenate(own), share))
    return out
