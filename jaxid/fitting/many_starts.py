"""Many starts on the same data: descents on growing shares of it, and the successive halving of
groups of them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from jaxid.fitting.fitter import Log
from jaxid.fitting.least_squares import levenberg_marquardt, Path
from jaxid.problem.objective import AbstractProblem


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
    stages = STAGES if max(map(len, groups)) > 1 else ()
    if logs is not None and not _affords_stages(logs[0], groups[0]):
        current, stages = [[g[0]] for g in groups], ()
    tried = 0
    for share, steps, keep in stages:
        if share == 1.0:
            _ask_again(current, groups, range(len(groups)), 1)
        found = _descended(current, steps, 1e-4, share, logs)
        tried += _linearisations(found)
        current = [_best_starts(own, keep) for own in found]
    found = _descended(current, iterations, tolerance, 1.0, logs, material=True)
    return [own[0] for own in found], tried + _linearisations(found)


def _affords_stages(log: Log, group: Sequence[tuple[AbstractProblem, np.ndarray]]) -> bool:
    """Whether the budget covers the descents on shares of the records, and a bit of the last."""
    cost = 0.0
    for share, steps, keep in STAGES:
        cost += share * (steps + 1) * min(len(group), keep + 1)
    return log.left >= (cost + 10) * (1 + group[0][0].size)


def _descended(
    groups: Sequence[Sequence[tuple[AbstractProblem, np.ndarray]]],
    iterations: int,
    tolerance: float,
    share: float,
    logs: Sequence[Log] | None = None,
    material: bool = False,
    hopeless: Callable[[Sequence[int], Sequence[Path]], list[bool]] | None = None,
) -> list[list[Path]]:
    """The paths of each group, the best first, all in one batch. `hopeless` is asked with the group
    of each path, and the paths.
    """
    number_of: list[int] = []
    jobs: list[tuple[AbstractProblem, np.ndarray]] = []
    for number, group in enumerate(groups):
        number_of += [number] * len(group)
        jobs += group
    paths = levenberg_marquardt(
        jobs,
        iterations,
        tolerance,
        share,
        None if logs is None else [logs[number] for number in number_of],
        hopeless=None if hopeless is None else functools.partial(hopeless, number_of),
        material=material,
    )
    found: list[list[Path]] = [[] for _ in groups]
    for number, path in zip(number_of, paths, strict=True):
        found[number].append(path)
    return [sorted(own, key=lambda path: path.cost) for own in found]


def _linearisations(found: Sequence[Sequence[Path]]) -> int:
    total = 0
    for own in found:
        total += sum(path.linearisations for path in own)
    return total


def _best_starts(own: Sequence[Path], keep: int) -> list[tuple[AbstractProblem, np.ndarray]]:
    """The best distinct ends of a group, as starts of the next descent."""
    finite = [path.z for path in own if np.isfinite(path.cost)]
    points = distinct(finite or [own[0].z])[:keep]
    return [(own[0].problem, z) for z in points]


#: Stages of a race, as of `STAGES`, with the number of groups that take the whole stage; those
#: whose cost is within WITHIN of the best do so in any case.
HEATS = ((0.1, 5, 2, None), (0.4, 6, 2, None), (1.0, 5, 1, 8), (1.0, None, 1, 4))


WITHIN = 1.5


#: A start that is this many times (cost) behind another one of its group is given up, and so is a
#: group so far behind one that leaves no more than AT_NOISE (mean square over the noise).
HOPELESS, AT_NOISE = 100.0, 2.0


def successive_halving(
    groups: Sequence[Sequence[tuple[AbstractProblem, np.ndarray]]],
    iterations: int,
    tolerance: float,
) -> list[Path]:
    """A path of each group of (problem, start) on the same data, as by `search` but for a choice
    among the groups: those that are clearly behind after the first steps stay where they are, and
    only the front ones descend to the end. Where one explains the data, only those go on with it
    that could yet do so.
    """
    current = [list(g) for g in groups]
    paths = [Path(*g[0]) for g in current]
    for heat, (share, steps, keep, front) in enumerate(HEATS):
        last = steps is None
        if heat == 1:
            # A short look leaves much undetermined: the first two starts go on as they were, too.
            _ask_again(current, groups, range(len(groups)), 2)
        lost = _lost(paths) if heat > 1 else set()
        ahead = _ahead(paths, front, lost) if heat > 0 else list(range(len(groups)))
        if share == 1.0 and not last:
            _ask_again(current, groups, ahead, 1)
            paths = _first_on_the_whole(current, ahead, mere_look=bool(lost))
        descent = (iterations, tolerance) if last else (steps, 1e-4)
        starts = [current[k] for k in ahead]
        found = _descended(starts, *descent, share, hopeless=_far_behind)
        for k, own in zip(ahead, found, strict=True):
            current[k] = _best_starts(own, keep)
            if not last or own[0].cost <= paths[k].cost:
                paths[k] = own[0]
    return paths


def _ask_again(
    current: list[list[tuple[AbstractProblem, np.ndarray]]],
    groups: Sequence[Sequence[tuple[AbstractProblem, np.ndarray]]],
    which: Iterable[int],
    count: int,
) -> None:
    """Adds the first starts of some groups to what is left of these."""
    for k in which:
        current[k] += groups[k][:count]


def _lost(paths: Sequence[Path]) -> set[int]:
    """Those that are hopelessly behind one that explains the data."""
    best = min(paths, key=lambda path: path.cost)
    if best.loss > AT_NOISE:
        return set()
    return {k for k, path in enumerate(paths) if path.cost > HOPELESS * best.cost}


def _ahead(paths: Sequence[Path], front: int | None, lost: set[int]) -> list[int]:
    """The first ones (`front`: how many, None for all) and those that are near the best."""
    order = sorted(range(len(paths)), key=lambda k: paths[k].cost)
    near = WITHIN * paths[order[0]].cost
    ahead = []
    for place, k in enumerate(order):
        chosen = front is None or place < front or paths[k].cost <= near
        if chosen and k not in lost:
            ahead.append(k)
    return ahead


def _first_on_the_whole(
    current: Sequence[Sequence[tuple[AbstractProblem, np.ndarray]]],
    ahead: Sequence[int],
    mere_look: bool,
) -> list[Path]:
    """The whole of the data for the first time: for those behind one step, or a mere look."""
    paths = [Path(*group[0]) for group in current]
    behind = [k for k in range(len(current)) if k not in ahead]
    if behind:
        starts = [current[k][0] for k in behind]
        last = levenberg_marquardt(starts, 0 if mere_look else 1, 1e-4)
        for k, path in zip(behind, last, strict=True):
            paths[k] = path
    return paths


def _far_behind(groups: Sequence[int], paths: Sequence[Path]) -> list[bool]:
    """Which paths are far behind another one of their group."""
    best: dict[int, float] = {}
    for k, path in zip(groups, paths, strict=True):
        best[k] = min(best.get(k, np.inf), path.cost)
    return [path.cost > HOPELESS * best[k] for k, path in zip(groups, paths, strict=True)]


def distinct(points: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Points without near repetitions, in order."""
    kept: list[np.ndarray] = []
    for z in points:
        if all(np.max(np.abs(z - k) / (np.abs(k) + 1e-9), initial=0.0) > 1e-3 for k in kept):
            kept.append(z)
    return kept
