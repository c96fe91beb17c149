"""Held-out evidence: how well models predict runs that were not fitted, and what a difference between two of them is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.estimation import Bench, scored, starts_and_information
from jaxid.fitters import descend, Path
from jaxid.problem import Problem, rows
from jaxid.residual import OutputError, Residual


#: A start may be moved by so many of its own standard deviations to take its uncertainty out of a comparison.
PLAUSIBLE = 3.0
#: A model goes as far as the data of a split lead it in so many steps, while each promises so large a share of what is left, and
#: more than so many times the noise (mean square) is.
PASSES, WORTH, NEAR_FLOOR = 4, 0.2, 1.1


@dataclass(frozen=True)
class HeldOut:
    """Prediction of one split by one model.

    `residual` [samples columns] in multiples of the noise, of the free run started from its first samples; `loss` the mean
    square after the own uncertainty of starts and parameters is taken out (a start from 20 noisy samples would else count as a
    gap); `theta` the parameters that this split would have them be, within that uncertainty.
    """

    residual: list[np.ndarray]
    settled: list[np.ndarray]
    loss: float
    count: int
    theta: np.ndarray | None = None

    @property
    def gap(self) -> float:
        """Root mean square of the residual over the noise: 1 is the noise floor."""
        total = np.concatenate([r.ravel() for r in self.residual])
        return float(np.sqrt(np.mean(total**2))) if total.size else float("nan")


#: What the fit runs tell about the free numbers of a model: their positions, and J'J [size size] in search scale.
Knowledge = tuple[Sequence[int], np.ndarray]


def knowledge(path: Path) -> Knowledge | None:
    """What a descent's data tell about the parameters, whatever the starts of its runs were."""
    if path.hessian is None:
        return None
    n, H = path.problem.free.size, path.hessian
    inside = H[:n, :n] - H[:n, n:] @ np.linalg.pinv(H[n:, n:], hermitian=True) @ H[n:, :n]
    values, vectors = np.linalg.eigh((inside + inside.T) / 2)
    return list(path.problem.free), (vectors * np.maximum(values, 0.0)) @ vectors.T


def held_out(
    bench: Bench,
    split: str,
    thetas: Sequence[np.ndarray],
    residual: Residual | None = None,
    known: Sequence[Knowledge | None] | None = None,
    follow: Sequence[bool] | None = None,
) -> list[HeldOut]:
    """Each model on the runs of a split.

    Free run (default): starts from the first samples only, those samples left out of the score. Where `known` says how well the
    fit determines a model's numbers, what these uncertainties do to the prediction counts no more than they are likely (a free
    run that is sensitive to its numbers would else tell nothing); to first order, and where `follow` says so as far as it
    leads: what the fit leaves open may be far away. Windows: each window's start is fitted, and costs its degrees of freedom.
    """
    if residual is None or isinstance(residual, OutputError):
        return _free(bench, split, thetas, known or [None] * len(thetas), follow or [False] * len(thetas))
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


def _free(
    bench: Bench, split: str, thetas: Sequence[np.ndarray], known: Sequence[Knowledge | None], follow: Sequence[bool]
) -> list[HeldOut]:
    runs = bench.runs(OutputError(), split)
    starts, from_heads = starts_and_information(bench, split, thetas)
    keep = [scored(e, split) for e in runs.experiments]
    models = []
    for k, theta in enumerate(thetas):
        free, about = told if (told := known[k]) is not None else ([], np.zeros((0, 0)))
        problems = [bench.problem(OutputError(), split, free, theta, [record]) for record in runs.records]
        z = [np.clip(p.z(theta, starts[k, j][None]), p.lower, p.upper) for j, p in enumerate(problems)]
        models.append(_Model(problems, z, about, from_heads[k]))
    _look(models, keep)
    first = [m.residual for m in models]
    for _ in range(PASSES):
        ahead = [m for m, follows in zip(models, follow, strict=True) if follows and m.far()]
        _look(ahead, keep)
    return [m.held(r) for m, r in zip(models, first, strict=True)]


def _look(models: Sequence[_Model], keep: Sequence[np.ndarray]) -> None:
    """Residuals and slopes of the models where they are about to go."""
    parts = iter(list(rows([(p, z) for m in models for p, z in zip(m.problems, m.next(), strict=True)])) if models else ())
    for m in models:
        own = [next(parts) for _ in m.problems]
        m.seen(
            [_finite(part.r[inside]) for part, inside in zip(own, keep, strict=True)],
            [np.clip(np.nan_to_num(part.J[inside]), -1e12, 1e12) for part, inside in zip(own, keep, strict=True)],
        )


class _Model:
    """One model on the runs of a split, and how far it has gone from where its fit left it."""

    def __init__(self, problems: list[Problem], z: list[np.ndarray], about: np.ndarray, starts: list[np.ndarray]):
        self.problems, self.z, self.about, self.starts = problems, z, about, starts
        self.gone = np.zeros(len(about) + sum(len(s) for s in starts))  # of `residual`
        self.way, self.price, self.settled = self.gone, 0.0, []  # to first order from there
        self.cost, self.ended = np.inf, False

    def next(self) -> list[np.ndarray]:
        n = len(self.about)
        ends = n + np.cumsum([0, *(len(s) for s in self.starts)])
        moved = [z + self.way[np.r_[0:n, a:b]] for z, a, b in zip(self.z, ends, ends[1:], strict=False)]
        return [np.clip(z, p.lower, p.upper) for z, p in zip(moved, self.problems, strict=True)]

    def seen(self, residual: list[np.ndarray], slopes: list[np.ndarray]) -> None:
        """What was found there: taken if it is better."""
        cost = self.price + sum(float(np.sum(r**2)) for r in residual)
        if not cost < self.cost:
            self.ended = self.cost < np.inf
            if self.ended:
                return
        self.residual, self.gone, self.cost = residual, self.way, cost
        self.settled, self.price, self.way = shifted(residual, slopes, self.about, self.starts, self.gone)

    def total(self) -> float:
        return self.price + sum(float(np.sum(r**2)) for r in self.settled)

    def far(self) -> bool:
        """Whether the first-order way is worth going, and something is left to gain."""
        count, total = sum(r.size for r in self.residual), self.total()
        return bool(len(self.about) and not self.ended and total > NEAR_FLOOR * count and self.cost - total > WORTH * total)

    def held(self, residual: list[np.ndarray]) -> HeldOut:
        count, p = sum(r.size for r in self.residual), self.problems[0]
        return HeldOut(residual, self.settled, self.total() / max(count, 1), count, p.theta(self.next()[0]))


def shifted(
    residual: list[np.ndarray],
    slopes: list[np.ndarray],
    about: np.ndarray,
    starts: list[np.ndarray],
    gone: np.ndarray | None = None,
) -> tuple[list[np.ndarray], float, np.ndarray]:
    """Residuals after the shift of parameters (common) and starts (of each run) that is likeliest by these residuals and by what
    was known before (J'J of the parameters and of each start), what the shift costs as a sum of squares, and the shift itself:
    with what has `gone` before."""
    n = len(about)
    ends = n + np.cumsum([0, *(len(s) for s in starts)])
    prior = np.zeros((ends[-1], ends[-1]))
    prior[:n, :n] = about
    gone = np.zeros(ends[-1]) if gone is None else gone
    G, g = np.zeros_like(prior), np.zeros(ends[-1])
    places = []
    for r, S, start, end, information in zip(residual, slopes, ends, ends[1:], starts, strict=False):
        at = np.r_[0:n, start:end]
        places.append(at)
        prior[start:end, start:end] = information
        S = S.reshape(r.size, at.size)
        G[np.ix_(at, at)] += S.T @ S
        g[at] += S.T @ r.ravel()
    if not g.size or not np.isfinite(G + prior).all():  # nothing is known of a run that diverges
        return residual, 0.0, gone
    size = np.sqrt(np.maximum(np.diag(G + prior), 1e-300))
    shift = -np.linalg.lstsq((G + prior) / size / size[:, None], (g + prior @ gone) / size, rcond=1e-12)[0] / size
    price = float((gone + shift) @ prior @ (gone + shift))
    share = min(1.0, PLAUSIBLE * np.sqrt(g.size / max(price, 1e-300)))  # nothing beyond what was measured
    moved = [r + (S @ (share * shift[at])).reshape(r.shape) for r, S, at in zip(residual, slopes, places, strict=True)]
    way = gone + share * shift
    return moved, float(way @ prior @ way), way


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
            if not np.all(np.abs(r) < 1e150):  # a run that diverged
                times[k, c] = len(r)
            elif len(r) >= 8 and np.ptp(r) > 0:
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
