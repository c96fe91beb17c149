"""Levenberg-Marquardt on batches of starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxid.fitting.fitter import Log, sampling_box
from jaxid.problem.gauss_newton import gauss_newton_model
from jaxid.problem.objective import AbstractProblem, Linear, linearise


Expansion = Callable[[Sequence[tuple[AbstractProblem, np.ndarray]], float], list[Linear]]


def guesses(
    problem: AbstractProblem, starts: Sequence[np.ndarray], restarts: int, key
) -> list[np.ndarray]:
    """The starts within the bounds, and random ones; unknown starts of runs stay as the first guess
    has them.
    """
    given = [problem_clip(problem, z) for z in starts]
    if not restarts:
        return given
    lower, upper = sampling_box(problem, given[0])
    draw = np.random.default_rng(seed_of(key)).uniform(size=(restarts, problem.size))
    random = lower + draw * (upper - lower)
    random[:, problem.free.size :] = given[0][problem.free.size :]
    return given + list(random)


#: After this many steps the paths that are hopeless are given up.
PATIENCE = 3


Curvature = Callable[["Path", np.ndarray, Linear], np.ndarray]

#: A step that lowers a sum of squares over the noise by less than this many variances moves no
#: number by more than about a thirtieth of its standard deviation. This many in a row, and the rest
#: of a valley is of no account either.
SLIGHT, IN_A_ROW = 1e-3, 3


@dataclass
class Path:
    """One descent: where it stands and how it got there."""

    problem: Any  # AbstractProblem
    z: np.ndarray
    cost: float = np.inf
    gradient: np.ndarray | None = None
    hessian: np.ndarray | None = None
    radius: float = np.inf
    scale: np.ndarray | None = None
    count: int = 0
    linearisations: int = 0
    converged: bool = False
    stopped: str = "iteration limit"
    history: list[tuple[int, float]] | None = None
    #: How many steps in a row gained nothing material; None where that is not asked.
    slight: int | None = None

    @property
    def loss(self) -> float:
        """Mean square of the weighted residual."""
        return 2 * self.cost / max(1, self.count)


def levenberg_marquardt(
    jobs: Sequence[tuple[AbstractProblem, np.ndarray]],
    iterations: int,
    tolerance: float,
    share: float = 1.0,
    log: Log | Sequence[Log] | None = None,
    expansion: Expansion | None = None,
    curvature: Curvature = lambda path, trial, new: new.hessian,
    hopeless: Callable[[Sequence[Path]], Sequence[bool]] | None = None,
    enough: Callable[[int, Path], bool] | None = None,
    material: bool = False,
) -> list[Path]:
    """Levenberg-Marquardt on many (problem, start) on the same runs at once; each linearisation of
    all is one batch.

    `expansion` gives twice the loss with gradient and curvature, by default `linearise` for sums of
    squares and `gauss_newton_model` for other losses; `curvature` may put another matrix in the
    place of that of an accepted trial. A `log`, of all jobs or of each, counts evaluations (a share
    of the records as that share of one) and ends the descent when the budget is used up. Paths that
    are `hopeless` after the first few steps are given up, and a path (its number, itself) of which
    `enough` is known at any. With `material` a path also ends where its steps gain nothing beside
    the noise.
    """
    expansion = expansion or _expansion_of(jobs)
    paths = [_path(problem, z, material) for problem, z in jobs]
    trials = [path.z for path in paths]
    active = list(range(len(paths)))
    each = share * (1 + paths[0].problem.size)
    logs = _members(log, len(paths))
    for iteration in range(iterations + 1):
        if logs:
            active = _affordable(logs, active, each)
        if not active:
            break
        results = expansion([(paths[i].problem, trials[i]) for i in active], share)
        for i, new in zip(active, results, strict=True):
            accept(paths[i], trials[i], new, tolerance, curvature)
        for one, members in logs:
            count = len(set(members) & set(active))
            if count:
                best = min((paths[i] for i in members), key=lambda path: path.cost)
                loss = best.loss if expansion is linearise else best.cost
                one.add(math.ceil(each * count), loss if share == 1.0 else np.inf)
                one.show(iteration, iterations)
        lost = np.array([path.converged for path in paths])
        if hopeless is not None and iteration == PATIENCE:
            lost |= np.asarray(hopeless(paths), bool)
        active = [i for i in active if not lost[i]]
        if enough is not None:
            active = [i for i in active if not enough(i, paths[i])]
        if iteration < iterations:
            for i in active:
                trials[i] = next_trial(paths[i])
    return paths


def _expansion_of(jobs: Sequence[tuple[AbstractProblem, np.ndarray]]) -> Expansion:
    squares = all(problem.loss_name == "sum_of_squares" for problem, _ in jobs)
    return linearise if squares else gauss_newton_model


def _path(problem: AbstractProblem, z: np.ndarray, material: bool) -> Path:
    slight = 0 if material and problem.weighted else None
    return Path(problem, problem_clip(problem, z), history=[], slight=slight)


def _members(log: Log | Sequence[Log] | None, count: int) -> list[tuple[Log, list[int]]]:
    """Each log and the numbers of its paths."""
    if log is None:
        return []
    if isinstance(log, Log):
        return [(log, list(range(count)))]
    members: dict[int, tuple[Log, list[int]]] = {}
    for i, one in enumerate(log):
        members.setdefault(id(one), (one, []))[1].append(i)
    return list(members.values())


def _affordable(
    logs: Sequence[tuple[Log, list[int]]], active: Sequence[int], each: float
) -> list[int]:
    """The first of the paths of each log, as many as its budget covers."""
    affordable: list[int] = []
    for log, members in logs:
        if log.exhausted:
            continue
        own = sorted(set(members) & set(active))
        affordable += own[: int(min(log.left / each, len(own)))]
    return affordable


def accept(
    path: Path, trial: np.ndarray, new: Linear, tolerance: float, curvature: Curvature
) -> None:
    """Takes a trial or leaves it, and sets the radius of the next one."""
    cost = new.cost / 2
    path.linearisations += 1
    path.count = new.count
    finite = all(np.isfinite(x).all() for x in (cost, new.gradient, new.hessian))
    if path.gradient is None:
        _begin(path, new, finite)
        return
    assert path.hessian is not None and path.history is not None and path.scale is not None
    dz = trial - path.z
    length = float(np.linalg.norm(path.scale * dz))
    predicted = -(path.gradient @ dz + dz @ path.hessian @ dz / 2)
    gained = path.cost - cost if finite else -np.inf
    rho = gained / max(predicted, 1e-300)
    if rho < 0.25:
        path.radius = length * _shrunk(finite, gained, float(path.gradient @ dz))
    elif rho > 0.75:
        path.radius = max(path.radius, 2 * length)
    if finite and gained > 0:
        small = gained <= tolerance * path.cost and predicted <= 100 * tolerance * path.cost
        path.hessian = curvature(path, trial, new)
        path.z, path.cost, path.gradient = trial, cost, new.gradient
        path.scale = np.maximum(path.scale, _scale(path.hessian))
        _judge(path, gained, bool(small or cost == 0))
    else:
        if predicted <= tolerance * path.cost:
            path.converged, path.stopped = True, "tolerance"
        if path.radius <= 1e-12 * np.linalg.norm(path.scale * _typical(path.problem, path.z)):
            path.converged, path.stopped = True, "no step lowers the loss any further"
    path.history.append((path.linearisations, path.cost))


def _judge(path: Path, gained: float, small: bool) -> None:
    """Whether a descent ends with the step that it took."""
    if small:
        path.converged, path.stopped = True, "tolerance"
    elif path.slight is not None:
        path.slight = path.slight + 1 if 2 * gained <= SLIGHT * max(1.0, path.loss) else 0
        if path.slight == IN_A_ROW:
            path.converged, path.stopped = True, "steps gain nothing beside the noise"


def _begin(path: Path, new: Linear, finite: bool) -> None:
    """The first linearisation of a path, at its start."""
    if not finite:
        path.converged, path.stopped = True, "the start diverges"
        return
    path.cost, path.gradient, path.hessian = new.cost / 2, new.gradient, new.hessian
    path.scale = _scale(new.hessian)
    path.radius = float(np.linalg.norm(path.scale * _typical(path.problem, path.z)))
    assert path.history is not None
    path.history.append((path.linearisations, path.cost))


def _shrunk(finite: bool, gained: float, slope: float) -> float:
    """The share of a step that gained too little, to which the next one is held."""
    if not finite:
        return 0.1
    return 0.25 if gained > 0 else _shorter(slope, -gained)


def _shorter(slope: float, rise: float) -> float:
    """By how much to shorten a step that led uphill: to the minimum of the parabola through both
    ends, by its slope at the first, within reason.
    """
    return float(np.clip(-slope / (2 * max(rise - slope, 1e-300)), 0.02, 0.5))


def _scale(hessian: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(np.diag(hessian), 0.0) + 1e-300)


def _typical(problem: AbstractProblem, z: np.ndarray) -> np.ndarray:
    """How far a first step may go: a factor of e, or the size of the variable, and never more than
    half its range.
    """
    log = np.zeros(problem.size, bool)
    log[: problem.free.size] = problem.log
    return np.minimum(
        np.where(log, 1.0, np.maximum(np.abs(z), 5 * problem.scale)),
        (problem.upper - problem.lower) / 2,
    )


#: This many quarterings of the radius are tried where a step comes to bounds.
RADII = 12
#: A radius that bounds no step, for which there is a finite number.
FAR = 1e150


def next_trial(path: Path) -> np.ndarray:
    """The next trial: the model's minimum within radius and bounds.

    Variables that come to a bound are held there one after the other, which is no minimum where
    many do: of smaller radii, down to one at which none does, that is taken which lowers the model
    most.
    """
    assert path.gradient is not None and path.hessian is not None
    z, g, H = path.z, path.gradient, path.hessian

    def gain(dz):
        return -(g @ dz + dz @ H @ dz / 2)

    dz, bounded = _bounded(path, path.radius)
    radius = path.radius
    for _ in range(RADII if bounded else 0):
        radius /= 4
        less, bounded = _bounded(path, radius)
        if gain(less) > gain(dz):
            dz, path.radius = less, radius
        if not bounded:
            break
    return np.clip(z + dz, path.problem.lower, path.problem.upper)


def model_gain(path: Path) -> float:
    """By how much the sum of squares is lower where the quadratic model of a path is least within
    the bounds.
    """
    assert path.gradient is not None and path.hessian is not None
    dz = _bounded(path, FAR)[0]
    return -float(2 * path.gradient @ dz + dz @ path.hessian @ dz)


def _bounded(path: Path, radius: float) -> tuple[np.ndarray, bool]:
    """A step within radius and bounds, and whether it came to a bound."""
    assert path.gradient is not None and path.hessian is not None and path.scale is not None
    z, g, H, scale = path.z, path.gradient, path.hessian, path.scale
    lower, upper = path.problem.lower, path.problem.upper
    outward = ((z <= lower) & (g > 0)) | ((z >= upper) & (g < 0))
    free = ~outward & (np.diag(H) > 0)  # what nothing shows stays
    dz, bounded = np.zeros_like(z), False
    # A variable that would leave its bounds goes to the bound, and the rest is solved again.
    for _ in range(z.size + 1):
        index = np.flatnonzero(free)
        if not index.size:
            break
        pull = (g + H @ np.where(free, 0.0, dz))[index] / scale[index]
        held = _norm(scale * np.where(free, 0.0, dz)) / max(radius, 1e-300)
        left = radius * np.sqrt(max(1.0 - held**2, 0.01))
        dz[index] = (
            _within(H[np.ix_(index, index)] / scale[index] / scale[index][:, None], pull, left)
            / scale[index]
        )
        out = free & ((z + dz < lower) | (z + dz > upper))
        if not out.any():
            break
        bounded = True
        dz = np.where(out, np.clip(z + dz, lower, upper) - z, dz)
        free &= ~out
    return np.clip(z + dz, lower, upper) - z, bounded


def _within(A: np.ndarray, b: np.ndarray, radius: float) -> np.ndarray:
    """The x with |x| <= radius that minimises b'x + x'Ax / 2, A positive semidefinite."""
    values, vectors = np.linalg.eigh(A)
    values = np.maximum(values, 1e-14)
    c = vectors.T @ b
    mu, x = max(0.0, _norm(c) / radius - values[-1]), c  # no less will do
    for _ in range(30):  # Newton on 1 / |x| - 1 / radius, which is nearly linear in mu
        x = c / (values + mu)
        size = _norm(x)
        if size <= 1.1 * radius:
            break
        mu += (size - radius) / radius / np.sum((x / size) ** 2 / (values + mu))
    return -vectors @ x


def _norm(x: np.ndarray) -> float:
    """The length of a vector whose squares may overflow, as where a model has all but diverged."""
    largest = max(float(np.max(np.abs(x), initial=0.0)), 1e-300)
    return largest * float(np.linalg.norm(x / largest))


def problem_clip(problem: AbstractProblem, z: np.ndarray) -> np.ndarray:
    return np.clip(np.asarray(z, np.float64), problem.lower, problem.upper)


def seed_of(key) -> int:
    """A NumPy seed from a JAX key."""
    return int(np.asarray(jax.random.key_data(key)).ravel()[-1])
