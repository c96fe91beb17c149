"""Rows of a study with the columns of effects and of free laws, ready to be weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxid.diagnosis.torque.algebra import ColumnPrior, memory_of, Weights
from jaxid.diagnosis.torque.choose import Chooser
from jaxid.diagnosis.torque.free_laws import free_units
from jaxid.diagnosis.torque.held_out import HeldOutRows, JudgedRun
from jaxid.diagnosis.torque.library import Unit
from jaxid.diagnosis.torque.rows import TorqueRun
from jaxid.diagnosis.torque.study import TorqueRows, TorqueStudy
from jaxid.diagnosis.torque.weigh import Scales


#: Rows that a block has at least: those within share their noise.
SHORTEST = 4.0


def scales(
    study: TorqueStudy,
    rows: TorqueRows,
    weights: Weights,
    chooser: Chooser,
    which: Sequence[int],
    acting: np.ndarray | None = None,
) -> Scales:
    """Of the runs `which`; the `chooser` has what is known of the columns, and the model without
    effects. Free laws act in runs where `acting` [runs] is one (default: all).
    """
    runs = [study.runs[k] for k in which]
    free = free_units(runs, study.binding.chain.signature.joints, study.plant.turn)
    if acting is not None:
        free = [only_in(u, acting[list(which)]) for u in free]
    judged = []
    for place, k in enumerate(which):
        x, moves = rows.rows[k], study.runs[k].moves
        more = [u.columns[place] for u in free]
        every = np.concatenate([x[:, :, :-1], *more, x[:, :, -1:]], axis=2)
        weight = weights(np.ones((*x.shape[:2], 1)), moves, study.unsure[k])[:, :, 0]
        judged.append(JudgedRun(every, weight, study.noise_of(k), moves))
    size = judged[0].rows.shape[2] - 1
    nominal = chooser.nominal.solution
    left = [rows.residual(k, nominal.at, nominal.theta) for k in which]
    data = HeldOutRows(judged, _wider(chooser.known, size), _longest(left, runs))
    return Scales(data, [*rows.units, *free], rows.size)


def only_in(unit: Unit, acting: np.ndarray) -> Unit:
    """A unit that acts in runs where `acting` [runs] is one, and not where it is nothing."""
    columns = [x * one for x, one in zip(unit.columns, acting, strict=True)]
    return replace(unit, columns=columns)


def _wider(known: ColumnPrior, size: int) -> ColumnPrior:
    """With columns of free laws, of which nothing is known."""
    p = len(known.mean)
    information, mean = np.zeros((size, size)), np.zeros(size)
    information[:p, :p], mean[:p] = known.information, known.mean
    return ColumnPrior(information, mean)


def _longest(left: Sequence[np.ndarray], runs: Sequence[TorqueRun]) -> float:
    """Over how many rows residuals [samples n] of some runs are alike, at the joint where that is
    longest.
    """
    found = [SHORTEST]
    for j in range(left[0].shape[1]):
        own = [r[:, j] for r, run in zip(left, runs, strict=True) if run.moves[j]]
        if own:
            found.append(memory_of(own))
    return max(found)
