"""How a fit has ended: whether its end is a minimum, and whether a search from somewhere else ends
lower.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxid.fitting.covariance import CovarianceEstimate
from jaxid.fitting.fitter import AbstractFitter, Log, Minimum, Progress
from jaxid.fitting.least_squares import levenberg_marquardt, model_gain, Path, PATIENCE
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.result import Trace
from jaxid.problem.objective import AbstractProblem
from jaxid.problem.problem import FitProblem


#: A loss is lower, or could be, where its sum of squares is so by more than this share of a
#: residual's variance: the numbers then lie about a third of a standard deviation apart.
MATERIAL = 0.1
#: A number at a bound wants beyond it where the sum of squares would fall by more than this many
#: variances.
PUSHES = 4.0
#: Looks from elsewhere without a budget, and iterations of each; with one as many as it allows.
LOOKS, STEPS = 2, 40
#: A look is worth its name with at least this many linearisations.
LEAST = 4
#: By so much of what a look lacks its model may promise too much.
NEARLY = 0.1
#: A channel that the model moves by less than this share of what was measured stands still in it.
STILL = 0.01
#: What [controller] calls the gain on the speed, by kind of law, where it is not kd.
LAW_KD = {"cascade": "kv"}
#: A loss beyond which data that determine no number have not been fitted at all.
LOST = 1000.0


class Ending(NamedTuple):
    """`converged`, `stalled`, `failed` or `budget`, and why."""

    state: str
    because: str


def gain(problem: AbstractProblem, before: float, after: float) -> float:
    """By how many variances of a residual the sum of squares is lower; for other losses a share of
    a thousandth counts as one.
    """
    if problem.loss_name != "sum_of_squares":
        return 1000 * (before - after) / max(before, 1e-300)
    return float(np.sum(problem.data.count)) * (before - after) / max(1.0, after)


def looked_again(
    jobs: Sequence[tuple[AbstractProblem, Any, Any]],
    found: Sequence[Minimum],
    fitter: AbstractFitter,
    budget: int | None,
    progress: Progress | None = None,
) -> list[Minimum]:
    """The ends after a second look at each: a descent from a point beside it, and on from there
    while that ends lower. Where a search diverged or ran out of iterations, what the budget leaves
    goes into new starts. Evaluations count; a look ends where it is clearly on the way to what is
    known already, or to something higher, and costs no more than the search did.

    A population stays where it ended: if a descent ends lower, it has stalled.
    """
    out, rngs = list(found), [np.random.default_rng(k) for k in range(len(found))]
    waiting = [k for k, m in enumerate(found) if getattr(m, "covariance", None) is None]
    looks = LOOKS if budget is None else 10 * LOOKS
    for number in range(looks):
        logs: dict[int, Log] = {}
        affordable = []
        for k in waiting:
            problem = jobs[k][0]
            logs[k] = _log(problem, out[k], fitter, _allowed(problem, out[k], budget), progress)
            if logs[k].left >= LEAST * (1 + problem.size):
                affordable.append(k)
            elif number == 0:
                because = _unlooked(out[k])
                out[k] = dataclasses.replace(out[k], converged=False, stopped_because=because)
        waiting = affordable
        if not waiting:
            break
        starts = [_elsewhere(jobs[k][0], out[k], rngs[k], number) for k in waiting]
        paths = levenberg_marquardt(
            [(jobs[k][0], z) for k, z in zip(waiting, starts, strict=True)],
            STEPS,
            1e-10,
            1.0,
            [logs[k] for k in waiting],
            enough=_known([out[k] for k in waiting]),
            material=True,
        )
        again = []
        for k, path in zip(waiting, paths, strict=True):
            looked = _SecondLook(jobs[k][0], out[k], path, logs[k])
            out[k], unsettled = looked.end(isinstance(fitter, AbstractPopulation), budget)
            if unsettled:
                again.append(k)
        waiting = again
    for k in waiting:  # still falling, or never finite
        out[k] = dataclasses.replace(out[k], converged=False, stalled=False)
    return out


@dataclasses.dataclass(frozen=True)
class _SecondLook:
    """A descent from beside the end `old` of a search."""

    problem: AbstractProblem
    old: Minimum
    path: Path
    log: Log

    def end(self, population: bool, budget: int | None) -> tuple[Minimum, bool]:
        """What it makes of the end, and whether that is to be looked at again."""
        old, new = self.old, self._new()
        spent: dict[str, Any] = {
            "evaluations": self.log.evaluations,
            "history": self.log.history,
            "seconds": self.log.seconds,
        }
        lower = new is not None and (
            old.failed or gain(self.problem, old.loss, new.loss) > MATERIAL
        )
        if new is None or not (lower or new.loss < old.loss):
            unfinished = budget is not None and not old.converged
            return dataclasses.replace(old, **spent), old.failed or unfinished
        if lower and population and not old.failed:
            said = (
                f"a descent from beside it ends lower, at loss {new.loss:.4g}: try hybrid or lm"
                f" ({old.stopped_because})"
            )
            stalled = not _limited(old)
            end = dataclasses.replace(
                old, converged=False, stalled=stalled, stopped_because=said, **spent
            )
            return end, False
        end = dataclasses.replace(
            new,
            stopped_because=new.stopped_because if lower or new.converged else old.stopped_because,
            converged=new.converged or (old.converged and not lower),
        )
        return dataclasses.replace(end, stalled=False, **spent), lower

    def _new(self) -> Minimum | None:
        """Where the descent ended, if it holds."""
        if not np.isfinite(self.path.cost):
            return None
        new = self.log.minimum(self.path.z, self.path.converged, self.path.stopped)
        return None if new.failed else new


def _allowed(problem: AbstractProblem, found: Minimum, budget: int | None) -> int | None:
    """The budget of a search and of the look at its end: where it has converged, no more than twice
    what it took.
    """
    if not found.converged:
        return budget
    most = found.evaluations + max(found.evaluations, LEAST * (1 + problem.size))
    return most if budget is None else min(budget, most)


def _known(ends: Sequence[Minimum]) -> Callable[[int, Path], bool]:
    """Whether a look is clearly on its way to the end of its search, or to a higher one: for the
    second time in a row the model of its loss promises no lower one.
    """
    streak = [0] * len(ends)

    def known(i: int, path: Path) -> bool:
        end = ends[i]
        if path.gradient is None or not end.converged or path.linearisations <= PATIENCE:
            return False
        squares = path.problem.loss_name == "sum_of_squares"
        left = 2 * path.cost - end.loss * (path.count if squares else 2)
        slack = MATERIAL * max(1.0, end.loss) if squares else 0.0
        streak[i] = streak[i] + 1 if model_gain(path) <= (1 + NEARLY) * left + slack else 0
        return streak[i] > 1

    return known


def _limited(found: Minimum) -> bool:
    return not (found.converged or found.stalled or found.failed)


def _unlooked(found: Minimum) -> str:
    if not found.converged:
        return found.stopped_because
    return f"the budget of evaluations leaves no second look ({found.stopped_because})"


def _log(
    problem: AbstractProblem,
    found: Minimum,
    fitter: AbstractFitter,
    budget: int | None,
    progress: Progress | None,
) -> Log:
    log = Log(problem, fitter.name, budget, None, progress)
    log.evaluations, log.best = found.evaluations, found.loss
    log.history, log.seconds = list(found.history), list(found.seconds)
    return log


def _elsewhere(
    problem: AbstractProblem, found: Minimum, rng: np.random.Generator, number: int
) -> np.ndarray:
    """A point beside the end, about a factor of two away in logarithms and half of itself in other
    numbers, at a bound inside of it; the end itself where a search ran out of iterations, and any
    point for one that has diverged.
    """
    z, lower, upper = found.z, problem.lower, problem.upper
    if found.failed:
        return lower + (upper - lower) * rng.uniform(size=z.size)
    if number == 0 and _limited(found):
        return z
    log = np.zeros(z.size, bool)
    log[: problem.free.size] = problem.log
    step = np.where(log, 0.7, np.maximum(0.5 * np.abs(z), 5 * problem.scale))
    step[problem.free.size :] = problem.scale[problem.free.size :]
    step = np.minimum(step, 0.3 * (upper - lower))
    step = step * rng.choice([-1.0, 1.0], z.size) * rng.uniform(0.5, 1.0, z.size)
    outside = (z + step < lower) | (z + step > upper)
    return np.clip(np.where(outside, z - step, z + step), lower, upper)


def ending(
    problem: FitProblem, found: Minimum, cov: CovarianceEstimate, traces: Sequence[Trace] = ()
) -> Ending:
    """How a search has ended that gave finite numbers; `traces` are free runs on the data that were
    fitted.
    """
    failure = _failure(problem, found, cov, traces)
    if failure is not None:
        return Ending("failed", failure)
    state = _state(found)
    plain = Ending(state, found.stopped_because)
    if cov.gradient is None or cov.hessian is None or problem.loss_name != "sum_of_squares":
        return plain
    g, H, size = cov.gradient, cov.hessian, max(1.0, found.loss)
    at_lower = problem.lower >= found.z - 1e-9 * problem.scale
    out = np.where(at_lower, g > 0, cov.at_bound & (g < 0)) & cov.at_bound
    bound = []
    for i in np.flatnonzero(out):
        if _bends(problem, found, int(i)) and g[i] ** 2 > PUSHES * size * H[i, i]:
            bound.append(problem.names[i])
    left = _newton_gain(g, H, ~out) / size
    stopped = f"({found.stopped_because})"
    if not np.isfinite(left):
        return Ending("stalled", f"the derivatives at the end are not numbers {stopped}")
    if left > MATERIAL and found.converged:
        slopes = np.where(out, 0.0, np.abs(g) / np.sqrt(np.maximum(np.diag(H), 1e-300)))
        which = problem.names[int(np.argmax(slopes))]
        return Ending("stalled", f"no minimum: the loss still slopes along {which} {stopped}")
    if bound and state == "converged":
        names = ", ".join(bound)
        return Ending(
            "stalled", f"at the bound of {names}, beyond which the loss falls: state wider bounds"
        )
    if left <= MATERIAL / 10 and state == "budget" and not _unconfirmed(found):
        return Ending("converged", f"nothing is left to gain {stopped}")
    return plain


def _failure(
    problem: FitProblem, found: Minimum, cov: CovarianceEstimate, traces: Sequence[Trace]
) -> str | None:
    """Why the numbers at the end are no answer, if they are none."""
    for trace in traces:
        if _stands_still(trace):
            return (
                f"{trace.channel} moves by {np.ptp(trace.measured):.3g} {trace.unit} and the fitted"
                " model keeps it still"
            )
    own = np.arange(problem.size) < problem.free.size
    if problem.free.size > 1 and cov.at_bound[own].all():
        return f"all numbers ended at their bounds ({found.stopped_because}): {_wider(problem)}"
    if not np.isfinite(found.loss):
        return f"the loss is not a number ({found.stopped_because})"
    if not found.loss <= LOST and not cov.identifiable[own].any():
        return f"the loss is {found.loss:.3g} and no number is determined ({found.stopped_because})"
    return None


def _wider(problem: FitProblem) -> str:
    """What else may be wrong where bounds hold every number: of a law, the gains that were held."""
    law = getattr(problem.runs.layout.chain.mechanism, "drive_law", None)
    if law is None:
        return "state wider ones"
    gains = ("kp", LAW_KD.get(law.kind, "kd"))
    asked = ", ".join(f'"{gain}"' for gain in gains if gain not in law.fit)
    if not asked:
        return "state wider ones"
    return f"state wider ones, or fit the law's gains, too: [controller] fit = [{asked}]"


def _unconfirmed(found: Minimum) -> bool:
    return "budget" in found.stopped_because or "time is up" in found.stopped_because


def _state(found: Minimum) -> str:
    if found.failed:
        return "failed"
    if found.converged:
        return "converged"
    return "stalled" if found.stalled else "budget"


def _stands_still(t: Trace) -> bool:
    moved = np.ptp(t.measured)
    if not moved > 20 * t.noise:
        return False
    return all(np.ptp(y) < STILL * moved for y in t.simulated.values())


def _bends(problem: FitProblem, found: Minimum, i: int) -> bool:
    """Whether the bound at which a number stands is one that data were thought to reach: zero is
    where physics ends.
    """
    if i >= problem.free.size:
        return True
    value = float(problem.theta(found.z)[problem.free[i]])
    return value != 0.0


def _newton_gain(g: np.ndarray, H: np.ndarray, inside: np.ndarray) -> float:
    """By how much a Gauss-Newton step would lower the sum of squares, over the numbers `inside`."""
    if not np.isfinite(g[inside]).all() or not np.isfinite(H).all():
        return float("nan")
    scale = np.sqrt(np.maximum(np.diag(H), 0.0))
    kept = np.flatnonzero(inside & (scale > 1e-150))
    if not kept.size:
        return 0.0
    values, vectors = np.linalg.eigh(H[np.ix_(kept, kept)] / scale[kept] / scale[kept][:, None])
    good = values > 1e-12 * values[-1]
    along = vectors.T @ (g[kept] / scale[kept])
    return float(np.sum(along[good] ** 2 / values[good]))
