"""Laws of no name that compete with effects: any force over position, over position against the
motion, over speed, and slowly over time, at each joint.

They are asked like effects and never named. What one of them wins is not known, and what it depends
on is said.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.diagnosis.torque.library import Unit
from jaxid.diagnosis.torque.rows import TorqueRun


#: What a free law is called, and what it depends on.
OVER = {
    "any_force_over_position": "position",
    "any_friction_over_position": "position, against the motion",
    "any_force_over_speed": "speed",
    "any_slow_force": "time",
}
#: Bumps over the travel of a joint, and against its motion there.
POSITIONS, AGAINST = 10, 10
#: Knots over speed, shares of the top speed either way.
SPEEDS = np.array([0.03, 0.1, 0.3, 0.6, 1.0])
#: Slow cosines of one run at most, of all runs at least, and of one run at least.
SLOW, SLOW_IN_ALL, SLOW_LEAST = 6, 18, 2
#: Percentiles of a motion beyond which a law goes on as it ends there.
TRAVEL, TOP = (0.5, 99.5), 99.0


def free_units(runs: Sequence[TorqueRun], joints: Sequence[str], turn: np.ndarray) -> list[Unit]:
    """Free laws at every one of these joints that moves, along some runs; dry friction turns about
    within the speeds `turn` [n].
    """
    out: list[Unit] = []
    for j, joint in enumerate(joints):
        if not any(run.moves[j] for run in runs):
            continue
        series = _series(runs, j, float(turn[j]))
        for name, made in series.items():
            columns = [run.at_joint(x, j) for run, x in zip(runs, made, strict=True)]
            out.append(_unit(name, joint, j, columns))
    return out


def _series(runs: Sequence[TorqueRun], joint: int, turn: float) -> dict[str, list[np.ndarray]]:
    """Columns [time k] of each law along each run."""
    q = [run.q[:, joint] for run in runs]
    qd = [run.qd[:, joint] for run in runs]
    low, high = np.percentile(np.concatenate(q), TRAVEL)
    top = max(float(np.percentile(np.abs(np.concatenate(qd)), TOP)), 1e-12)
    over = np.linspace(low, high, POSITIONS)
    against = np.linspace(low, high, AGAINST)
    speeds = top * np.concatenate([-SPEEDS[::-1], [0.0], SPEEDS])
    # All bumps together are a constant, or dry friction: the first is left out where the law is to
    # depend on something.
    return {
        "any_force_over_position": [hats(x, over)[:, 1:] for x in q],
        "any_friction_over_position": [
            np.tanh(v / turn)[:, None] * hats(x, against) for x, v in zip(q, qd, strict=True)
        ],
        "any_force_over_speed": [hats(v, speeds)[:, 1:] for v in qd],
        "any_slow_force": _slow([len(x) for x in q]),
    }


def _slow(lengths: Sequence[int]) -> list[np.ndarray]:
    """Slow cosines of each run by itself [time k], nothing in the others."""
    each = int(np.clip(SLOW_IN_ALL // len(lengths), SLOW_LEAST, SLOW))
    out = []
    for run, length in enumerate(lengths):
        phase = np.pi * (np.arange(length) + 0.5) / length
        own = np.cos(phase[:, None] * np.arange(1, each + 1))
        columns = np.zeros((length, each * len(lengths)))
        columns[:, run * each : (run + 1) * each] = own
        out.append(columns)
    return out


def _unit(name: str, place: str, joint: int, columns: list[np.ndarray]) -> Unit:
    count = columns[0].shape[2]
    open_ = np.full(count, np.inf)
    return Unit(
        effect=name,
        location=place,
        fields=tuple(f"value_{k}" for k in range(count)),
        least=-open_,
        most=open_,
        spread=open_,
        shape={},
        joints=(joint,),
        columns=columns,
    )


def hats(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Piecewise linear hats [time knots], constant beyond the ends."""
    if np.ptp(knots) <= 0:
        return np.ones((len(x), 1)) * np.eye(len(knots))[:1]
    return np.stack([np.interp(x, knots, row) for row in np.eye(len(knots))], -1)
