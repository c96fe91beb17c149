"""Levenberg-Marquardt on batches of starts, and the successive halving of many."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxid.fitting.fitter import Log, sampling_box
from jaxid.problem.objective import AbstractProblem, gauss_newton_model, Linear, linearise


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


#: (share of each record, iterations, paths kept) of the stages before the final descent.
STAGES = ((0.1, 6, 4), (0.4, 6, 3), (1.0, 6, 2))


def search(
    groups: Sequence[Sequence[tuple[AbstractProblem, np.ndarray]]],
    iterations: int,
    tolerance: float,
    logs: Sequence[Log] | None = None,
) -> tuple[list[Path], int]:
    """The best path of each group of (problem, start), all groups in one batch, and the number of
    linearisations.

    Starts first descend on growing shares of the records: a long oscillation has one basin per
    cycle that is gained or lost, and a short look finds the right one. The first start of a group
    also goes straight to the whole, and alone if the budget does not cover more. `logs` has the log
    of each group.
    """
    current = [list(g) for g in groups]
    tried = 0
    stages = STAGES if max(len(g) for g in groups) > 1 else ()
    if logs is not None:
        cost = sum(
            share * (steps + 1) * min(len(groups[0]), keep + 1) for share, steps, keep in STAGES
        )
        if logs[0].left < (cost + 10) * (1 + groups[0][0][0].size):
            current, stages = [[g[0]] for g in groups], ()

    def of(flat):
        return None if logs is None else [logs[k] for k, _ in flat]

    for share, steps, keep in stages:
        if share == 1.0:
            for g, original in zip(current, groups, strict=True):
                g += [original[0]]
        flat = [(k, job) for k, g in enumerate(current) for job in g]
        paths = levenberg_marquardt([job for _, job in flat], steps, 1e-4, share, of(flat))
        tried += sum(p.linearisations for p in paths)
        for k in range(len(groups)):
            own = sorted(
                (p for (n, _), p in zip(flat, paths, strict=True) if n == k), key=lambda p: p.cost
            )
            points = distinct([p.z for p in own if np.isfinite(p.cost)] or [own[0].z])[:keep]
            current[k] = [(own[0].problem if len(own) else groups[k][0][0], z) for z in points]
    flat = [(k, job) for k, g in enumerate(current) for job in g]
    paths = levenberg_marquardt(
        [job for _, job in flat], iterations, tolerance, 1.0, of(flat), material=True
    )
    tried += sum(p.linearisations for p in paths)
    best = []
    for k in range(len(groups)):
        best.append(
            min((p for (n, _), p in zip(flat, paths, strict=True) if n == k), key=lambda p: p.cost)
        )
    return best, tried


#: Stages of a race, as of `STAGES`, with the number of groups that take the whole stage; those
#: whose cost is within WITHIN of the best do so in any case.
HEATS = ((0.1, 5, 2, None), (0.4, 6, 2, None), (1.0, 5, 1, 8), (1.0, None, 1, 4))


WITHIN = 1.5


#: A start that after this many steps is this many times (cost) behind another one of its group is
#: given up, and so is a group so far behind one that leaves no more than AT_NOISE (mean square over
#: the noise).
PATIENCE, HOPELESS, AT_NOISE = 3, 100.0, 2.0


def successive_halving(
    groups: Sequence[Sequence[tuple[AbstractProblem, np.ndarray]]],
    iterations: int,
    tolerance: float,
    sure: Sequence[int] = (),
) -> list[Path]:
    """A path of each group of (problem, start) on the same data, as by `search` but for a choice
    among the groups: those that are clearly behind after the first steps stay where they are, and
    only the front ones, and those that are `sure`, descend to the end. Where one explains the data,
    only those go on with it that could yet do so.
    """
    current = [list(g) for g in groups]
    paths: list[Path] = []
    for heat, (share, steps, keep, front) in enumerate(HEATS):
        if (
            heat == 1
        ):  # a short look leaves much undetermined: the first two starts go on as they were, too
            current = [[*now, *g[:2]] for now, g in zip(current, groups, strict=True)]
        order = sorted(range(len(paths)), key=lambda k: paths[k].cost)
        ahead = [
            k
            for n, k in enumerate(order)
            if front is None or n < front or paths[k].cost <= WITHIN * paths[order[0]].cost
        ]
        lost: set[int] = set()
        if heat > 1 and paths[order[0]].loss <= AT_NOISE:
            lost = {k for k in order if paths[k].cost > HOPELESS * paths[order[0]].cost}
        over = (
            lost if steps is None else set()
        )  # until the last heat those that are sure have a chance all the same
        ahead = [k for k in ahead if k not in lost]
        ahead = (
            [*ahead, *(k for k in sure if k not in ahead and k not in over)]
            if order
            else list(range(len(groups)))
        )
        if (
            share == 1.0 and steps is not None
        ):  # the whole for the first time: for those behind one step, or a mere look
            behind = [k for k in range(len(groups)) if k not in ahead]
            for k in ahead:
                current[k] += [groups[k][0]]
            last = (
                levenberg_marquardt([current[k][0] for k in behind], 0 if lost else 1, 1e-4)
                if behind
                else []
            )
            paths = [Path(g[0][0], g[0][1]) for g in current]
            for k, path in zip(behind, last, strict=True):
                paths[k] = path
        flat = [(k, job) for k in ahead for job in current[k]]
        behind_others = functools.partial(_far_behind, [k for k, _ in flat])
        found = levenberg_marquardt(
            [job for _, job in flat],
            steps or iterations,
            1e-4 if steps else tolerance,
            share,
            hopeless=behind_others,
        )
        paths = paths or [Path(g[0][0], g[0][1]) for g in current]
        for k in ahead:
            own = sorted(
                (p for (n, _), p in zip(flat, found, strict=True) if n == k), key=lambda p: p.cost
            )
            points = distinct([p.z for p in own if np.isfinite(p.cost)] or [own[0].z])[:keep]
            current[k] = [(own[0].problem, z) for z in points]
            if steps is not None or own[0].cost <= paths[k].cost:
                paths[k] = own[0]
    return paths


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
    slight: int | None = (
        None  # how many steps in a row gained nothing material; None where that is not asked
    )

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
    if expansion is None:
        expansion = (
            linearise
            if all(p.loss_name == "sum_of_squares" for p, _ in jobs)
            else gauss_newton_model
        )
    paths = [
        Path(p, problem_clip(p, z), history=[], slight=0 if material and p.weighted else None)
        for p, z in jobs
    ]
    trials = [p.z for p in paths]
    active = list(range(len(paths)))
    each = share * (1 + paths[0].problem.size)
    own: dict[int, tuple[Log, list[int]]] = {}  # each log and its paths
    for i, one in enumerate(
        [] if log is None else [log] * len(paths) if isinstance(log, Log) else log
    ):
        own.setdefault(id(one), (one, []))[1].append(i)
    for iteration in range(iterations + 1):
        if own:
            active = [
                i
                for one, members in own.values()
                for i in _affordable(one, sorted(set(members) & set(active)), each)
            ]
            if not active:
                break
        results = expansion([(paths[i].problem, trials[i]) for i in active], share)
        for i, new in zip(active, results, strict=True):
            accept(paths[i], trials[i], new, tolerance, curvature)
        for one, members in own.values():
            if count := len(set(members) & set(active)):
                best = min((paths[i] for i in members), key=lambda p: p.cost)
                scale = 2 / max(1, best.count) if expansion is linearise else 1.0
                one.add(math.ceil(each * count), scale * best.cost if share == 1.0 else np.inf)
                one.show(iteration, iterations)
        active = [i for i in active if not paths[i].converged]
        if hopeless is not None and iteration == PATIENCE:
            lost = hopeless(paths)
            active = [i for i in active if not lost[i]]
        if enough is not None:
            active = [i for i in active if not enough(i, paths[i])]
        if not active or iteration == iterations:
            break
        for i in active:
            trials[i] = next_trial(paths[i])
    return paths


def _far_behind(groups: Sequence[int], paths: Sequence[Path]) -> list[bool]:
    """Which paths are far behind another one of their group."""
    best: dict[int, float] = {}
    for k, path in zip(groups, paths, strict=True):
        best[k] = min(best.get(k, np.inf), path.cost)
    return [path.cost > HOPELESS * best[k] for k, path in zip(groups, paths, strict=True)]


def _affordable(log: Log, active: list[int], each: float) -> list[int]:
    """The first of the paths, as many as the budget covers."""
    return [] if log.exhausted else active[: int(min(log.left / each, len(active)))]


def accept(
    path: Path, trial: np.ndarray, new: Linear, tolerance: float, curvature: Curvature
) -> None:
    """Takes a trial or leaves it, and sets the radius of the next one."""
    cost = new.cost / 2
    path.linearisations += 1
    path.count = new.count
    finite = (
        np.isfinite(cost) and np.isfinite(new.gradient).all() and np.isfinite(new.hessian).all()
    )
    if path.gradient is None:
        if not finite:
            path.converged, path.stopped = True, "the start diverges"
            return
        path.cost, path.gradient, path.hessian = cost, new.gradient, new.hessian
        path.scale = _scale(new.hessian)
        path.radius = float(np.linalg.norm(path.scale * _typical(path.problem, path.z)))
        assert path.history is not None
        path.history.append((path.linearisations, cost))
        return
    assert path.hessian is not None and path.history is not None and path.scale is not None
    dz = trial - path.z
    length = float(np.linalg.norm(path.scale * dz))
    predicted = -(path.gradient @ dz + dz @ path.hessian @ dz / 2)
    gained = path.cost - cost if finite else -np.inf
    rho = gained / max(predicted, 1e-300)
    if rho < 0.25:
        path.radius = length * (
            0.1
            if not finite
            else 0.25
            if gained > 0
            else _shorter(float(path.gradient @ dz), -gained)
        )
    elif rho > 0.75:
        path.radius = max(path.radius, 2 * length)
    if finite and gained > 0:
        small = cost == 0 or (
            gained <= tolerance * path.cost and predicted <= 100 * tolerance * path.cost
        )
        path.hessian = curvature(path, trial, new)
        path.z, path.cost, path.gradient = trial, cost, new.gradient
        path.scale = np.maximum(path.scale, _scale(path.hessian))
        if small:
            path.converged, path.stopped = True, "tolerance"
        elif path.slight is not None:
            path.slight = path.slight + 1 if 2 * gained <= SLIGHT * max(1.0, path.loss) else 0
            if path.slight == IN_A_ROW:
                path.converged, path.stopped = True, "steps gain nothing beside the noise"
    else:
        if predicted <= tolerance * path.cost:
            path.converged, path.stopped = True, "tolerance"
        if path.radius <= 1e-12 * np.linalg.norm(path.scale * _typical(path.problem, path.z)):
            path.converged, path.stopped = True, "no step lowers the loss any further"
    path.history.append((path.linearisations, path.cost))


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
    free = ~(((z <= lower) & (g > 0)) | ((z >= upper) & (g < 0))) & (
        np.diag(H) > 0
    )  # what nothing shows stays
    dz, bounded = np.zeros_like(z), False
    for _ in range(
        z.size + 1
    ):  # a variable that would leave its bounds goes to the bound, and the rest is solved again
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


def distinct(points: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Points without near repetitions, in order."""
    kept: list[np.ndarray] = []
    for z in points:
        if all(np.max(np.abs(z - k) / (np.abs(k) + 1e-9), initial=0.0) > 1e-3 for k in kept):
            kept.append(z)
    return kept


def problem_clip(problem: AbstractProblem, z: np.ndarray) -> np.ndarray:
    return np.clip(np.asarray(z, np.float64), problem.lower, problem.upper)


def seed_of(key) -> int:
    """A NumPy seed from a JAX key."""
    return int(np.asarray(jax.random.key_data(key)).ravel()[-1])
