"""Free runs that say little: those that diverge, that turn over and forget how they began, and long
decays. What is compared in their place, and why, in a sentence.

A difference at the start of a chaotic run grows exponentially: beyond a few of its time constants the loss has a minimum at every
corner and its curvature none of the meaning that a standard deviation needs. Windows with a start each (multiple shooting, Bock
1983) do not know that trouble. In a long decay the phase that is lost in the first swings hides what the last ones say.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxid.base.wording import percent
from jaxid.fitting.fitter import AbstractFitter
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.result import Fit
from jaxid.fitting.scores import free_runs
from jaxid.problem.binding import Binding
from jaxid.problem.residual import InverseDynamics, MultipleShooting, Residual


#: Free runs in which a difference at the start (rad, m) grows by more than this forget how they
#: began.
SENSITIVE, DIFFERENCE = 50.0, 1e-7
#: A free run follows what was measured with an error of so much of the signal's standard deviation;
#: beyond the other it does not, and a search that ended there is not trusted to have found the best
#: one.
FOLLOWS, ASTRAY = 0.05, 0.3
#: Joints from which on torques are asked at once where a free run does not follow: fewer joints'
#: runs are compared over windows.
AN_ARM = 3
#: Mean square over the noise that a free run which has nothing wrong with it may leave.
AT_NOISE = 2.0
#: A decay of at least this many turning points is one of several amplitudes.
TURNS = 8

#: Said where the torque equation stands in for a free run.
DIVERGES = (
    "the free run diverges at every candidate, as that of an arm does which was recorded under"
    " position control: the torque that the measured motion needs is compared instead"
    " (inverse_dynamics)"
)

LOST = (
    "no numbers were found with which the free run follows the recording (off by {} of the motion's"
    " standard deviation), as for an arm recorded under position control: the torque that the"
    " measured motion needs is compared instead (inverse_dynamics)"
)

#: (residual, None for the free run; numbers to begin with, None for guesses; evaluations spent
#: before) -> fit
Fitting = Callable[[Residual | None, np.ndarray | None, int], Fit]


def by_torque(binding: Binding) -> bool:
    """Whether a measured motion under measured torques can be compared without being simulated."""
    chain = binding.chain
    return (
        bool(binding.motions)
        and chain.direct
        and not chain.mechanism.hidden_states
        and bool(binding.experiments("fit"))
    )


def by_windows(binding: Binding, fitter: AbstractFitter | None = None) -> bool:
    """Whether runs can be compared over windows, and a fitter can find the many starts that these
    bring.
    """
    chain = binding.chain
    led = (
        getattr(chain.mechanism, "drive_law", None) is not None
    )  # by its goals: it does not get lost
    able = (
        not led
        and not chain.mechanism.hidden_states
        and (bool(binding.motions) or not chain.has_states())
    )
    return (
        able
        and bool(binding.experiments("fit"))
        and (fitter is None or fitter.name in ("lm", "bfgs", "optimistix_lm"))
    )


def growth(bench: ProblemBuilder, theta: np.ndarray) -> float:
    """How much a small difference of the joints' positions at the start of a free run has grown
    where it is largest, over the runs that are fitted and those that choose; 0 where joints are not
    measured, or have inner states.
    """
    b = bench.binding
    names = b.chain.signature.output_names
    seen = [names.index(j) for j in b.chain.signature.joints if j in names]
    if not b.motions or b.chain.mechanism.hidden_states or not seen:
        return 0.0
    largest, n = 0.0, b.chain.nq
    for split in ("fit", "validation"):
        if not b.experiments(split):
            continue
        start = estimate_starts(bench, split, [theta])[0]
        starts = np.repeat(start[None], n + 1, 0)
        starts[np.arange(n) + 1, :, np.arange(n)] += DIFFERENCE
        base, *moved = free_runs(bench, split, [theta] * (n + 1), starts)
        apart = []
        for run in moved:
            for y, y0 in zip(run, base, strict=True):
                apart.append(np.abs(y[:, seen] - y0[:, seen]).max())
        if not np.isfinite(apart).all():  # one that diverges has no end
            return float("inf")
        largest = max(largest, float(np.max(apart)) / DIFFERENCE)
    return largest


def decays(binding: Binding) -> bool:
    """Whether every run that is fitted is a free swing of several amplitudes: nothing drives it,
    and it turns often.
    """
    runs = binding.experiments("fit")
    if not runs or not all(
        e.name in binding.motions and not np.ptp(e.u, axis=0).any() for e in runs
    ):
        return False
    turns = [
        int(np.max(np.count_nonzero(np.diff(np.sign(_moving(binding, e.name)), axis=0), axis=0)))
        for e in runs
    ]
    return min(turns) >= TURNS


def _moving(binding: Binding, name: str) -> np.ndarray:
    """The smoothed speeds of a run, without what is too slow to be told from standing still."""
    qd = binding.motions[name].qd
    kept = (np.abs(qd) > 0.02 * np.abs(qd).max(0)).any(1)
    return qd[kept]


def believed(bench: ProblemBuilder, fit: Fit, fitter: AbstractFitter, fitted: Fitting) -> Fit:
    """A free run's fit, or what takes its place: the torque equation or windows where it diverges;
    windows where it forgets its start or is a long decay that the model does not follow; a free run
    from where windows ended, if that ends lower.
    """
    binding = bench.binding
    diverged = fit.failed and not fit.parameters
    if diverged and by_torque(binding):
        again = fitted(InverseDynamics(), None, fit.evaluations)
        return fit if again.failed else _together(again, fit, DIVERGES)
    if not by_windows(binding, fitter) or not (diverged or _doubtful(bench, fit)):
        return fit
    windows = fitted(MultipleShooting(), None, fit.evaluations)
    if windows.failed:
        return fit
    said = "the free run diverges at every candidate" if diverged else _lost(bench, fit, windows)
    if said:
        return _together(
            windows,
            fit,
            f"{said}: models are compared over windows, each with its own start; free_run stands"
            " beside",
        )
    again = fitted(None, windows.theta, fit.evaluations + windows.evaluations)
    better = not again.failed and (fit.failed or again.loss < fit.loss)
    spent = {"evaluations": fit.evaluations + windows.evaluations + again.evaluations}
    return replace(again, **spent) if better else replace(fit, **spent)


def _doubtful(bench: ProblemBuilder, fit: Fit) -> bool:
    """Whether windows could say more than this free run does."""
    if not fit.failed and fit.loss <= AT_NOISE:
        return False
    off = _off(fit)
    return (
        off > ASTRAY
        or decays(bench.binding)
        or (off > FOLLOWS and growth(bench, fit.theta) > SENSITIVE)
    )


def _off(fit: Fit) -> float:
    every = [s.nrmse for s in fit.scores.get("fit", {}).values()]
    known = np.isfinite(every).all()
    return float(np.max(every, initial=0.0)) if known else float("inf")


def _lost(bench: ProblemBuilder, fit: Fit, windows: Fit) -> str:
    """Why the free run is not what is compared, nothing where it may be."""
    grown = max(growth(bench, theta) for theta in (fit.theta, windows.theta))
    if not np.isfinite(grown):
        return "a free run diverges from a start beside its own"
    if grown > SENSITIVE:
        return (
            f"a difference at the start of a run grows {grown:.2g} times within it, and the free"
            f" run could be followed to {percent(_off(fit))} of the motion only"
        )
    if decays(bench.binding):
        return (
            "a free swing through several amplitudes, which one free run follows to"
            f" {percent(_off(fit))} of the motion"
        )
    return ""


def _together(taken: Fit, first: Fit, note: str) -> Fit:
    """A fit that takes the place of another one, with what both cost."""
    return replace(
        taken,
        notes=(*taken.notes, note),
        evaluations=first.evaluations + taken.evaluations,
        wall_time_s=first.wall_time_s + taken.wall_time_s,
        compile_time_s=first.compile_time_s + taken.compile_time_s,
    )
