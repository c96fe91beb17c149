"""What any law could close: bumps over each joint's position and speed, and what goes with its
load, in the place of a law.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.diagnosis.budget import closed
from jaxid.diagnosis.torque.algebra import ColumnPrior, gram, solve, Weights
from jaxid.diagnosis.torque.answer import Answer
from jaxid.diagnosis.torque.free_laws import hats
from jaxid.diagnosis.torque.rows import TorqueRun
from jaxid.diagnosis.torque.study import TorqueRows, TorqueStudy


#: Bumps over the travel and over the speeds of a joint.
POSITIONS, SPEEDS = 5, 7
#: How firmly bumps are held at nothing, relative to what the data say: the value that predicts the
#: validation runs best counts.
FIRM = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)


def ceiling(
    study: TorqueStudy,
    rows: TorqueRows,
    weights: Weights,
    base: Answer,
    fit: Sequence[int],
    choose: Sequence[int],
    judge: Sequence[int],
) -> float:
    """Share of the gap of `base` on the runs `judge` that free laws close, fitted to `fit`, as firm
    as suits `choose`.
    """
    edges = _edges(study)
    load = [np.abs(study.plant.load(r, rows.theta).transmitted) for r in study.runs]
    needed = {*fit, *choose, *judge}
    made = {
        k: r.rows(_bumps(r, f, edges, study.plant.turn))
        for k, (r, f) in enumerate(zip(study.runs, load, strict=True))
        if k in needed
    }
    n, each = next(iter(made.values())).shape[1:]
    p = len(base.at)
    blocks = {}
    for k, x in made.items():
        wide = np.zeros((len(x), n, p + n * each + 1))
        wide[:, :, :p], wide[:, :, -1] = rows.rows[k][:, :, base.at], rows.rows[k][:, :, -1]
        for j in range(n):
            wide[:, j, p + j * each : p + (j + 1) * each] = x[:, j]
        blocks[k] = wide
    size = p + n * each
    g = gram(
        [study.runs[k] for k in fit],
        [blocks[k] for k in fit],
        [study.unsure[k] for k in fit],
        weights,
        1,
    ).total
    at, bounds = np.arange(size), np.full(size, np.inf)
    start = np.concatenate([base.numbers, np.zeros(n * each)])

    def gap(numbers: np.ndarray, which: Sequence[int]) -> float:
        rest = {
            k: (blocks[k][:, :, -1] - blocks[k][:, :, :-1] @ numbers) / study.noise_of(k)
            for k in which
        }
        left = [x[:, study.runs[k].moves] for k, x in rest.items()]
        return float(np.sqrt(np.mean(np.concatenate([x.ravel() for x in left]) ** 2)))

    found = []
    for firm in FIRM:
        told = np.zeros(size)
        told[p:] = firm * np.mean(np.diag(g)[p:-1]) + 1e-300
        s = solve(g, at, ColumnPrior(np.diag(told), np.zeros(size)), start, -bounds, bounds)
        found.append((gap(s.theta, choose), s.theta))
    best = min(found, key=lambda f: f[0])[1]
    return closed(base.gap(judge) ** 2, gap(best, judge) ** 2)


def _edges(study: TorqueStudy) -> list[tuple[np.ndarray, np.ndarray]]:
    fit = [study.runs[k] for k in study.of("fit")]
    q, qd = np.concatenate([r.q for r in fit]), np.concatenate([r.qd for r in fit])
    out = []
    for j in range(q.shape[1]):
        low, high = np.percentile(q[:, j], [1, 99])
        top = np.percentile(np.abs(qd[:, j]), 99)
        half = np.array([0.03, 0.2, 1.0])[: SPEEDS // 2]
        out.append(
            (np.linspace(low, high, POSITIONS), top * np.concatenate([-half[::-1], [0.0], half]))
        )
    return out


def _bumps(
    run: TorqueRun,
    load: np.ndarray,
    edges: Sequence[tuple[np.ndarray, np.ndarray]],
    turn: np.ndarray,
) -> np.ndarray:
    """[time n k]: hats over position times hats over speed, and the load against the motion."""
    out = []
    for j, (q, qd) in enumerate(edges):
        a, b = hats(run.q[:, j], q), hats(run.qd[:, j], qd)
        both = (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)
        out.append(np.column_stack([both, load[:, j] * np.tanh(run.qd[:, j] / turn[j])]))
    return np.stack(out, 1)
