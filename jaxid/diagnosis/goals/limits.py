"""Limits of drives, read off the measured motion.

Where a drive gives less than its law asks for, a model without that limit goes elsewhere whatever
its numbers, and no first order about it is near. Along the measured motion the torque that the law
asks for is known, and so is what the file's numbers take.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxid.diagnosis.goals.plant import Drive
from jaxid.diagnosis.goals.probes import at_levels, is_level, LEVELS, scaled
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.library import Unit
from jaxid.dynamics.effect import Effect


#: Levels that are looked at between two of those that the torque stays below for a share of the
#: time.
BETWEEN = 9


def limits_shown(study: Any) -> list[Unit]:
    """Limits that leave little of the force that the file as it stands lacks at their joints, and
    less than the re-tuned model does, the one that leaves least first; each with the level that
    does.
    """
    found = [pair for kind in study.kinds if is_level(kind) for pair in _shown(study, kind)]
    return [unit for _, unit in sorted(found, key=lambda pair: pair[0])]


def _shown(study: Any, kind: type[Effect]) -> list[tuple[float, Unit]]:
    b, plant = study.binding, study.plant
    n, drive = b.chain.nq, Drive(plant, [kind])
    base, places = drive.theta(b.theta), b.chain.places(kind)[:n]
    known = [plant.balance(run, b.theta) for run in study.runs]

    def torque(theta):
        return [
            drive.torque(run, other, theta)
            for run, other in zip(study.runs, study.other, strict=True)
        ]

    asked = torque(base)
    splits = [which for which in (study.of("fit"), study.of("validation")) if which]

    def changed(level: np.ndarray) -> list[np.ndarray]:
        """What limits [n], one at each joint, take of the torque of each run."""
        at = base.copy()
        for place, value in zip(places, level, strict=True):
            shape = at_levels(kind, np.array([value]))[0] if value > 0 else {}
            for i in drive.layout.of_effect(kind.name, place):
                at[i] = shape.get(drive.layout.entries[i].field, at[i])
        return [x - before for x, before in zip(torque(at), asked, strict=True)]

    def left(change: Sequence[Any], which: Sequence[int]) -> np.ndarray:
        """Root mean square force [n] that the file lacks in some runs."""
        own = []
        for k in which:
            force, minus, plus = known[k]
            force, taken = plant.taken(study.runs[k], force + change[k], minus, plus)
            own.append(study.runs[k].sampled(force - taken))
        return np.sqrt(np.mean(np.concatenate(own) ** 2, 0))

    retuned = [plant.missing(run, study.theta) for run in study.runs]

    def rms(which):
        return np.sqrt(
            np.mean(np.concatenate([study.runs[k].sampled(retuned[k]) for k in which]) ** 2, 0)
        )

    whole = [np.maximum(left([0.0] * len(study.runs), which), 1e-300) for which in splits]
    levels = np.max([np.quantile(np.abs(x), LEVELS, axis=0) for x in asked], 0)

    def shares(levels):
        return np.array(
            [
                [left(changed(x), w) / size for w, size in zip(splits, whole, strict=True)]
                for x in levels
            ]
        )

    # [levels splits n]: each joint's best on what is fitted, then between its neighbours
    at = np.argmin(shares(levels)[:, 0], 0)
    low, high = (levels[np.clip(at + step, 0, len(levels) - 1), range(n)] for step in (-1, 1))
    levels = np.linspace(low, high, BETWEEN)
    share = shares(levels)
    at, out = np.argmin(share[:, 0], 0), []
    for j, place in enumerate(places):
        level = levels[at[j], j]
        beyond = all(
            s * w[j] < rms(which)[j]
            for s, w, which in zip(share[at[j], :, j], whole, splits, strict=True)
        )
        if share[at[j], :, j].max() < LIMITS.limit_leaves and beyond and level > 0:
            made = [(c[:, j, None] * np.eye(n)[j])[:, :, None] for c in changed(levels[at[j]])]
            out.append(
                (
                    float(share[at[j], 0, j]),
                    scaled(kind, place, at_levels(kind, np.array([level]))[0], j, made),
                )
            )
    return out
