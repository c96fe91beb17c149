"""Held-out evidence: how well models predict runs that were not fitted, and what a difference
between two of them is worth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.least_squares import levenberg_marquardt, Path
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder, touches
from jaxid.fitting.scores import scored
from jaxid.fitting.wide_slopes import CHANCE, descend_widely
from jaxid.problem.problem import FitProblem, NumberPrior, rows
from jaxid.problem.residual import OutputError, Residual


#: Iterations of a refit to the fit runs and those of a split at once.
TOGETHER = 12


@dataclass(frozen=True)
class HeldOut:
    """Prediction of one split by one model.

    `residual` [samples columns] in multiples of the noise, of the free run started from its first
    samples; `loss` the mean square after the own uncertainty of starts and parameters is taken out
    (a start from 20 noisy samples would else count as a gap); `theta` its parameters where they
    were refitted to this split and the fit runs together.
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

    @property
    def gap_settled(self) -> float:
        """The same after the own uncertainty of starts and parameters is taken out."""
        return float(np.sqrt(max(self.loss, 0.0)))


#: What the fit runs tell about the free numbers of a model: their positions, and J'J [size size] in
#: search scale.
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
    bench: ProblemBuilder,
    split: str,
    thetas: Sequence[np.ndarray],
    residual: Residual | None = None,
    known: Sequence[Knowledge | None] | None = None,
    follow: Sequence[Path | None] | None = None,
) -> list[HeldOut]:
    """Each model on the runs of a split.

    Free run (default): starts from the first samples only, those samples left out of the score.
    Where `known` says how well the fit determines a model's numbers, what these uncertainties do to
    the prediction counts no more than they are likely (a free run that is sensitive to its numbers
    would else tell nothing), to first order. What the fit leaves open may be far away: models whose
    fits are given to `follow` are refitted to both where they leave more than the noise. Windows:
    each window's start is fitted, and costs its degrees of freedom.
    """
    if residual is None or residual.free_run:
        about = known or [None] * len(thetas)
        if touches(bench.binding):
            return [_touching(bench, split, *one) for one in zip(thetas, about, strict=True)]
        return _free(bench, split, thetas, about, follow or [None] * len(thetas))
    return _windows(bench, split, thetas, residual)


def _windows(
    bench: ProblemBuilder, split: str, thetas: Sequence[np.ndarray], residual: Residual
) -> list[HeldOut]:
    problems = [bench.problem(residual, split, [], theta) for theta in thetas]
    paths = levenberg_marquardt(
        [(p, p.z(t)) for p, t in zip(problems, thetas, strict=True)], 8, 1e-8
    )
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


def _touching(
    bench: ProblemBuilder, split: str, theta: np.ndarray, told: Knowledge | None
) -> HeldOut:
    """Free runs that touch: where they do depends on how they began, which is fitted to the whole
    of each and costs its degrees of freedom. A touch that comes one step of the simulator later
    moves a run more than its noise: numbers move within what the fit leaves open, at that price.
    """
    starts = estimate_starts(bench, split, [theta])[0]
    p = bench.problem(OutputError(), split, [], theta)
    z, free = p.z(theta, starts), p.size
    if told is not None and len(told[0]):
        p = _knowing(bench, split, theta, told)
        path, _ = descend_widely(p, p.z(theta, starts), TOGETHER)
        z = path.z
    residual = [_finite(r) for r in p.residuals(z)]
    count = sum(r.size for r in residual)
    price = float(np.sum(p.known_before(z)[0] ** 2))
    loss = (_squares(residual) + price) / max(count - free, 1)
    return HeldOut(residual, residual, loss, count)


def _knowing(bench: ProblemBuilder, split: str, theta: np.ndarray, told: Knowledge) -> FitProblem:
    """The runs of a split with the numbers of a fit, as it knows them."""
    index, information = told
    p = bench.problem(OutputError(), split, index, theta)
    slopes = np.maximum(np.abs(p.dtheta(p.z(theta))), 1e-300)
    values, vectors = np.linalg.eigh(information / slopes / slopes[:, None])
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    return p.knowing(NumberPrior(theta[p.free], root, np.zeros(len(root))))


def _free(
    bench: ProblemBuilder,
    split: str,
    thetas: Sequence[np.ndarray],
    known: Sequence[Knowledge | None],
    follow: Sequence[Path | None],
) -> list[HeldOut]:
    runs = bench.runs(OutputError(), split)
    begun = bench.begun(split, thetas)
    starts = np.array([b.starts for b in begun])
    jobs = []
    for k, theta in enumerate(thetas):
        free = [] if (told := known[k]) is None else told[0]
        for j, record in enumerate(runs.records):
            p = bench.problem(OutputError(), split, free, theta, [record])
            jobs.append((p, np.clip(p.z(theta, starts[k, j][None]), p.lower, p.upper)))
    out = []
    parts = list(rows(jobs))
    keep = [scored(e, split) for e in runs.experiments]
    per = len(runs.records)
    for k in range(len(thetas)):
        about = np.zeros((0, 0)) if (told := known[k]) is None else told[1]
        own = parts[k * per : (k + 1) * per]
        residual = [_finite(part.r[inside]) for part, inside in zip(own, keep, strict=True)]
        slopes = [
            np.clip(np.nan_to_num(part.J[inside]), -1e12, 1e12)
            for part, inside in zip(own, keep, strict=True)
        ]
        settled, price = shifted(residual, slopes, about, begun[k].information)
        total = price + _squares(settled)
        count = sum(r.size for r in residual)
        out.append(HeldOut(residual, settled, total / max(count, 1), count))
    far = {
        k: path
        for k, path in enumerate(follow)
        if path is not None and out[k].loss > level(out[k].count)
    }
    for (k, path), end in zip(
        far.items(), together(bench, split, list(far.values()), starts[list(far)]), strict=True
    ):
        residual = end.problem.residuals(end.z)
        n = len(path.problem.records)
        settled = [_finite(r[inside]) for r, inside in zip(residual[n:], keep, strict=True)]
        price = max(0.0, _squares(residual[:n]) - 2 * path.cost)
        loss = (price + _squares(settled)) / max(out[k].count, 1)
        if loss < out[k].loss:
            out[k] = HeldOut(out[k].residual, settled, loss, out[k].count, end.problem.theta(end.z))
    return out


def _squares(residual: Sequence[np.ndarray]) -> float:
    return float(sum(np.sum(r**2) for r in residual))


def together(
    bench: ProblemBuilder, split: str, paths: Sequence[Path], starts: np.ndarray
) -> list[Path]:
    """Models refitted to the free runs that they were fitted to and of a split at once, from where
    their fits ended; `starts` of the latter.
    """
    jobs = []
    for path, own in zip(paths, starts, strict=True):
        theta = path.problem.theta(path.z)
        before = dict.fromkeys(e.split for e in path.problem.runs.experiments)
        p = bench.problem(OutputError(), "+".join((*before, split)), path.problem.free, theta)
        jobs.append((p, p.z(theta, np.concatenate([path.problem.starts(path.z), own]))))
    return levenberg_marquardt(jobs, TOGETHER, 1e-6) if jobs else []


def shifted(
    residual: list[np.ndarray],
    slopes: list[np.ndarray],
    about: np.ndarray,
    starts: list[np.ndarray],
) -> tuple[list[np.ndarray], float]:
    """Residuals after the shift of parameters (common) and starts (of each run) that is likeliest
    by these residuals and by what was known before (J'J of the parameters and of each start), and
    what the shift costs as a sum of squares.
    """
    n = len(about)
    ends = n + np.cumsum([0, *(len(s) for s in starts)])
    prior = np.zeros((ends[-1], ends[-1]))
    prior[:n, :n] = about
    G, g = np.zeros_like(prior), np.zeros(ends[-1])
    places = []
    for r, S, start, end, information in zip(
        residual, slopes, ends, ends[1:], starts, strict=False
    ):
        at = np.r_[0:n, start:end]
        places.append(at)
        prior[start:end, start:end] = information
        S = S.reshape(r.size, at.size)
        G[np.ix_(at, at)] += S.T @ S
        g[at] += S.T @ r.ravel()
    if not g.size or not np.isfinite(G + prior).all():  # nothing is known of a run that diverges
        return residual, 0.0
    size = np.sqrt(np.maximum(np.diag(G + prior), 1e-300))
    shift = -np.linalg.lstsq((G + prior) / size / size[:, None], g / size, rcond=1e-12)[0] / size
    price = float(shift @ prior @ shift)
    share = min(
        1.0, LIMITS.three_sigma * np.sqrt(g.size / max(price, 1e-300))
    )  # nothing beyond what was measured
    moved = [
        r + (S @ (share * shift[at])).reshape(r.shape)
        for r, S, at in zip(residual, slopes, places, strict=True)
    ]
    return moved, share**2 * price


def _finite(r: np.ndarray) -> np.ndarray:
    return np.clip(np.nan_to_num(r, nan=1e12, posinf=1e12, neginf=-1e12), -1e12, 1e12)


def correlation(r: np.ndarray) -> np.ndarray:
    """Autocorrelation of a series at lags 0 ... n / 2."""
    n = len(r)
    r = r - r.mean()
    f = np.fft.rfft(r, 2 * n)
    return np.fft.irfft(f * np.conj(f))[: n // 2] / max(float(r @ r), 1e-300)


def level(count: int) -> float:
    """Mean square up to which residuals are noise: what chance makes of it, and how well the noise
    itself is known.
    """
    return 1 + CHANCE * np.sqrt(2 / max(1, count)) + LIMITS.noise_known


def memory(series: Sequence[np.ndarray]) -> int:
    """Samples over which a residual remembers itself: the integrated correlation time 1 + 2 sum rho
    up to the first lag whose correlation is lost in the noise; the mean over runs, the longest over
    columns. 1 for white residuals.
    """
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
                below = np.flatnonzero(rho < LIMITS.two_sigma / np.sqrt(len(r)))
                times[k, c] = 1 + 2 * float(np.sum(rho[1 : below[0] if below.size else len(rho)]))
    return max(1, round(float(np.max(weight @ times / weight.sum()))))


def inflation(held: HeldOut) -> float:
    """Factor by which a difference of sums of squares is worth less than for white residuals at the
    noise: the residual's own level times its memory (1 for a perfect model).
    """
    return max(1.0, held.loss) * memory(held.settled)


def worth(better: HeldOut, other: HeldOut, factor: float) -> float:
    """Difference of the sums of squares of two models on the same data, in units of a chi-square
    with one degree.
    """
    return (other.loss - better.loss) * better.count / factor
