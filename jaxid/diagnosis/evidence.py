"""Held-out evidence: how well models predict runs that were not fitted, and what a difference between two of them is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.estimation import Bench, scored, starts_and_information
from jaxid.fitters import descend
from jaxid.problem import rows
from jaxid.residual import OutputError, Residual


#: A start may be moved by so many of its own standard deviations to take its uncertainty out of a comparison.
PLAUSIBLE = 3.0


@dataclass(frozen=True)
class HeldOut:
    """Prediction of one split by one model.

    `residual` [samples columns] in multiples of the noise, of the free run started from its first samples; `loss` the mean
    square after the start's own uncertainty is taken out (a start from 20 noisy samples would otherwise count as a gap).
    """

    residual: list[np.ndarray]
    settled: list[np.ndarray]
    loss: float
    count: int

    @property
    def gap(self) -> float:
        """Root mean square of the residual over the noise: 1 is the noise floor."""
        total = np.concatenate([r.ravel() for r in self.residual])
        return float(np.sqrt(np.mean(total**2))) if total.size else float("nan")


def held_out(bench: Bench, split: str, thetas: Sequence[np.ndarray], residual: Residual | None = None) -> list[HeldOut]:
    """Each model on the runs of a split.

    Free run (default): starts from the first samples only, those samples left out of the score. Windows: each window's
    start is fitted, and costs its degrees of freedom.
    """
    if residual is None or isinstance(residual, OutputError):
        return _free(bench, split, thetas)
    return _windows(bench, split, thetas, residual)


def _windows(bench: Bench, split: str, thetas: Sequence[np.ndarray], residual: Residual) -> list[HeldOut]:
    problems = [bench.problem(residual, split, [], theta) for theta in thetas]
    paths = descend([(p, p.z(t)) for p, t in zip(problems, thetas, strict=True)], 8, 1e-8)
    out: list[HeldOut] = [HeldOut([], [], 0.0, 0) for _ in thetas]
    for part in rows([(p, path.z) for p, path in zip(problems, paths, strict=True)]):
        held = out[part.job]
        held.residual.append(_finite(part.r))
    for k, p in enumerate(problems):
        r = out[k].residual
        count = sum(x.size for x in r)
        total = float(sum(np.sum(x**2) for x in r))
        out[k] = HeldOut(r, r, total / max(count - p.size, 1), count)
    return out


def _free(bench: Bench, split: str, thetas: Sequence[np.ndarray]) -> list[HeldOut]:
    runs = bench.runs(OutputError(), split)
    starts, known = starts_and_information(bench, split, thetas)
    jobs, information = [], []
    per = len(runs.records)
    for k, theta in enumerate(thetas):
        for j, record in enumerate(runs.records):
            p = bench.problem(OutputError(), split, [], theta, [record])
            jobs.append((p, np.clip(starts[k, j][p.start_columns], p.lower, p.upper)))
            information.append(known[k][j])
    out = []
    parts = list(rows(jobs))
    for k in range(len(thetas)):
        residual, settled, total, count = [], [], 0.0, 0
        for i in range(per):
            part, job = parts[k * per + i], k * per + i
            keep = scored(runs.experiments[i], split)
            r, S = part.r[keep], part.J[keep]
            residual.append(_finite(r))
            r, S = _finite(r), np.nan_to_num(S).reshape(r.size, -1)
            if S.shape[1]:
                G = S.T @ S + information[job]
                shift = -np.linalg.lstsq(G, S.T @ r.ravel(), rcond=None)[0]
                price = float(shift @ information[job] @ shift)
                share = min(1.0, PLAUSIBLE * np.sqrt(S.shape[1] / max(price, 1e-300)))  # no start beyond what was measured
                r = r + (S @ (share * shift)).reshape(r.shape)
                total += share**2 * price
            settled.append(r)
            total += float(np.sum(r**2))
            count += r.size
        out.append(HeldOut(residual, settled, total / max(count, 1), count))
    return out


def _finite(r: np.ndarray) -> np.ndarray:
    return np.clip(np.nan_to_num(r, nan=1e12, posinf=1e12, neginf=-1e12), -1e12, 1e12)


def correlation(r: np.ndarray) -> np.ndarray:
    """Autocorrelation of a series at lags 0 ... n / 2."""
    n = len(r)
    r = r - r.mean()
    f = np.fft.rfft(r, 2 * n)
    return np.fft.irfft(f * np.conj(f))[: n // 2] / max(float(r @ r), 1e-300)


def memory(series: Sequence[np.ndarray]) -> int:
    """Samples over which a residual remembers itself: the integrated correlation time 1 + 2 sum rho up to the first lag
    whose correlation is lost in the noise; the mean over runs, the longest over columns. 1 for white residuals."""
    if not series:
        return 1
    times = np.ones((len(series), series[0].shape[1]))
    weight = np.array([len(block) for block in series], float)
    for k, block in enumerate(series):
        for c, r in enumerate(block.T):
            if len(r) >= 8 and np.ptp(r) > 0:
                rho = correlation(r)
                below = np.flatnonzero(rho < max(0.05, 2 / np.sqrt(len(r))))
                times[k, c] = 1 + 2 * float(np.sum(rho[1 : below[0] if below.size else len(rho)]))
    return max(1, round(float(np.max(weight @ times / weight.sum()))))


def inflation(held: HeldOut) -> float:
    """Factor by which a difference of sums of squares is worth less than for white residuals at the noise: the residual's
    own level times its memory (1 for a perfect model)."""
    return max(1.0, held.loss) * memory(held.settled)


def worth(better: HeldOut, other: HeldOut, factor: float) -> float:
    """Difference of the sums of squares of two models on the same data, in units of a chi-square with one degree."""
    return (other.loss - better.loss) * better.count / factor
