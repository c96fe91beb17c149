"""Linear estimators on the inverse-dynamics residual, which is linear in the parameters of rigid
models: W theta = b + error.

- `ls`: ordinary least squares. Biased in closed loop, where the disturbance is in the motion and hence in W.
- `wls`: the same, each joint of each run weighted by its own residual (Gautier 1997).
- `rls`: the same sample by sample, with a forgetting factor where the newest data are to count most.
- `iv`: instrumental variables, Z'W theta = Z'b, with Z the W of the motion that the model makes under the recording's
  controller: no noise in it, so no bias (Janot, Vandanjon, Gautier 2014).

All but `rls` are one bounded problem, min |Q'(W theta - b)| with Q a basis of the columns of Z (of
W itself without instruments).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.noise import noise_floor
from jaxid.dynamics.controller import law_of
from jaxid.fitting.covariance import CovarianceEstimate, one_sided
from jaxid.fitting.fitter import AbstractFitter, Minimum
from jaxid.fitting.recursive_least_squares import replay
from jaxid.fitting.settings import option
from jaxid.force.covariance import covariance_of_rows, of_scores
from jaxid.force.least_squares import Rows, solve
from jaxid.force.rows import ForceRows, Numbers
from jaxid.problem.objective import AbstractProblem, PENALTY, rows as rows_of
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import InverseDynamics, Runs


#: A residual counts as linear where it departs from its linearisation by less than this share of
#: itself.
LINEAR = 1e-6
#: Instruments have converged where the estimate moves by less than this share of its standard
#: deviation.
STILL = 0.05
#: The smallest residual that weighs, in units of the noise.
LEAST = 1e-12


@dataclass(frozen=True)
class LinearMinimum(Minimum):
    """A minimum that brings its own covariance, for weights and instruments are not part of the
    problem's loss.
    """

    covariance: CovarianceEstimate | None = None


def of_runs(problem: AbstractProblem, name: str) -> FitProblem:
    """The problem, if it is one of a model and its runs."""
    if not isinstance(problem, FitProblem):
        raise UsageError(
            f"{name} solves the torque residual of a model; a function needs lm or another search"
        )
    return problem


class LeastSquares(AbstractFitter):
    """Ordinary least squares on the inverse-dynamics residual; solved at once, no start values
    needed.
    """

    name: ClassVar[str] = "ls"
    source: ClassVar[str] = "textbook; standard deviations by the sandwich of Newey and West 1987"
    residual_name: ClassVar[str] = "inverse_dynamics"

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        problem = of_runs(problem, self.name)
        at, rows = linearised(problem, starts[0], self.name)
        return finish(problem, at, rows, solved(problem, at, rows), self.name, "solved directly")


class WeightedLeastSquares(AbstractFitter):
    """Least squares with each joint of each run weighted by the size of its own residual."""

    name: ClassVar[str] = "wls"
    source: ClassVar[str] = "Gautier, Dynamic identification of robots with power model, 1997"
    residual_name: ClassVar[str] = "inverse_dynamics"

    iterations: int = option(10, "most passes", 1)
    tolerance: float = option(1e-6, "relative change of the parameters below which it ends", 0)

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        problem = of_runs(problem, self.name)
        at, plain = linearised(problem, starts[0], self.name)
        weighted, theta = plain, solved(problem, at, plain)
        stopped = "iteration limit"
        for _ in range(self.iterations):
            weighted = plain.weighted([1 / np.maximum(rms, LEAST) for rms in plain.rms(theta)])
            old, theta = theta, solved(problem, at, weighted)
            if change(old, theta) < self.tolerance:
                stopped = "tolerance"
                break
        return finish(problem, at, weighted, theta, self.name, stopped)


class RecursiveLeastSquares(AbstractFitter):
    """Recursive least squares in the order of the samples; `forgetting` below 1 lets old samples
    count less.

    Without forgetting it ends where `ls` does. An estimate beyond its bounds is put on them.
    """

    name: ClassVar[str] = "rls"
    source: ClassVar[str] = (
        "textbook; paper 001, equations (8) to (11), from parameters of which nothing is known"
    )
    residual_name: ClassVar[str] = "inverse_dynamics"

    forgetting: float = option(1.0, "weight of the last but one sample against the last", 0, 1)
    prior_var: float = option(
        1e10, "variance of each parameter before the first sample, in squares of its unit", 0
    )

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        problem = of_runs(problem, self.name)
        at, rows = linearised(problem, starts[0], self.name)
        Y, b = np.concatenate(rows.columns), np.concatenate(rows.torque)
        size = np.linalg.norm(Y.reshape(-1, Y.shape[2]), axis=0)
        scale = np.where(size > 1e-10 * size.max(), size, np.inf)
        delta, _, _ = replay(
            Y / scale,
            b - Y @ at,
            np.zeros(at.size),
            noise_var=1.0,
            prior_var=self.prior_var,
            forgetting=self.forgetting,
        )
        if self.forgetting < 1:  # a sample counts by its age, also in the standard deviations
            rows = _aged(rows, self.forgetting)
        return finish(
            problem,
            at,
            rows,
            np.clip(at + delta / scale, *bounds(problem)),
            self.name,
            "all samples seen",
        )


def _aged(rows: ForceRows, forgetting: float) -> ForceRows:
    """Rows of runs that follow each other, each times the root of what its age lets it count."""
    count = sum(map(len, rows.torque))
    share = forgetting ** (0.5 * np.arange(count - 1, -1, -1.0))
    parts = np.split(share, np.cumsum([len(tau) for tau in rows.torque])[:-1])
    columns = [W * s[:, None, None] for W, s in zip(rows.columns, parts, strict=True)]
    torque = [tau * s[:, None] for tau, s in zip(rows.torque, parts, strict=True)]
    return ForceRows.of(columns, torque)


class InstrumentalVariables(AbstractFitter):
    """Instrumental variables: unbiased in closed loop. Needs `[controller]` and its reference.

    The instruments are the regressor along the motion that the current estimate makes under the
    controller, through the same filter and decimation as the data; repeated until the estimate
    stands still. What is left of the torque equation along that noise-free motion (sticking, held
    inputs, the filter: no noise, yet not zero) is subtracted from the data's own, so that it does
    not bias the estimate either (`corrected`).
    """

    name: ClassVar[str] = "iv"
    source: ClassVar[str] = (
        "Janot, Vandanjon, Gautier, IEEE Trans. Control Systems Technology 22 (2014), IDIM-IV;"
        " correction by indirect inference, Gourieroux, Monfort, Renault 1993"
    )
    residual_name: ClassVar[str] = "inverse_dynamics"

    iterations: int = option(10, "most passes", 1)
    tolerance: float = option(1e-6, "relative change of the parameters below which it ends", 0)
    corrected: bool = option(True, "whether the bias that is left in the instruments is taken off")

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        problem = of_runs(problem, self.name)
        runs = _torque_runs(problem, self.name)
        if runs.dataset is None or runs.dataset.controller is None:
            raise UsageError(
                "iv simulates the recording's controller, and the dataset states none: state it"
                " under [controller] with its reference q_cmd, or use fitter lm with the residual"
                " output_error"
            )
        law_of(runs.dataset, runs.layout.chain.signature)
        at, plain = linearised(problem, starts[0], self.name)
        rows, instruments = plain, plain
        theta, number = solved(problem, at, plain), 0
        stopped = "iteration limit"
        for number in range(self.iterations):
            made = _instruments(problem, theta)
            if made is None:
                why = (
                    "the closed-loop simulation diverges at the estimate; check [controller]"
                    " (gains, sample_time, gain)"
                )
                return Minimum(at, PENALTY, False, why, number + 1)
            instruments = made
            if self.corrected:
                errors = zip(plain.torque, made.errors(theta), strict=True)
                rows = ForceRows.of(plain.columns, [tau - e for tau, e in errors])
            old, theta = theta, solved(problem, at, rows, instruments)
            if progress:
                progress(self.name, number + 1, self.iterations, f"change {change(old, theta):.1e}")
            if change(old, theta) < self.tolerance:
                stopped = "tolerance"
                break
            # A joint that sticks one sample longer or shorter keeps the last digits moving.
            z = at_theta(problem, theta)
            std = sandwich(problem, z, rows, instruments, theta).std * problem.dtheta(z)
            if number >= 2 and np.all(
                np.abs(theta - old) < STILL * np.where(np.isfinite(std), std, np.inf)
            ):
                stopped = f"the estimate moves by less than {STILL:g} of its standard deviation"
                break
        return finish(
            problem=problem,
            at=at,
            rows=rows,
            instruments=instruments,
            theta=theta,
            name=self.name,
            stopped=stopped,
            evaluations=number + 2,
        )


def change(old: np.ndarray, new: np.ndarray) -> float:
    """Largest relative change of an estimate."""
    return float(
        np.max(np.abs(new - old) / np.maximum(np.abs(new), 1e-9 * np.max(np.abs(new)) + 1e-300))
    )


def bounds(problem: FitProblem) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the free parameters themselves (not of their search scale)."""
    return problem.theta(problem.lower)[problem.free], problem.theta(problem.upper)[problem.free]


def at_theta(problem: FitProblem, theta: np.ndarray) -> np.ndarray:
    """Search vector of free parameters `theta`."""
    full = problem.base.copy()
    full[problem.free] = theta
    return problem.z(full)


def _torque_runs(problem: FitProblem, name: str) -> Runs:
    if problem.loss_name != "sum_of_squares":
        raise UsageError(
            f"{name} minimises sums of squares; the loss {problem.loss_name!r} needs a population"
            " (fitter de)"
        )
    if problem.runs.setting is None or problem.start_rows.size:
        raise UsageError(
            f"{name} is linear: it needs the residual inverse_dynamics; for the others use"
            " fitter lm"
        )
    return problem.runs


def linearised(problem: FitProblem, guess: np.ndarray, name: str) -> tuple[Numbers, ForceRows]:
    """Free numbers and rows at an interior point near the guess. Raises `UsageError` where the
    residual is not linear.
    """
    _torque_runs(problem, name)
    lower, upper = bounds(problem)
    # A dry level at its bound 0 has half a derivative: step a little inside.
    inside = 0.01 * np.minimum(
        upper - lower,
        np.maximum(np.abs(problem.theta(guess)[problem.free]), 0.01 * (upper - lower)),
    )
    theta = np.clip(problem.theta(guess)[problem.free], lower + inside, upper - inside)
    rows = _rows(problem, theta)
    away = np.where(theta + 2 * inside < upper, theta + 2 * inside, theta - inside)
    bent = np.zeros(theta.size, bool)
    for W, V in zip(rows.columns, _rows(problem, away).columns, strict=True):
        bent |= np.abs(W - V).max((0, 1)) > LINEAR * (np.abs(V).max((0, 1)) + 1e-300)
    if bent.any():
        names = ", ".join(problem.runs.layout.names[i] for i in problem.free[bent])
        raise UsageError(
            f"{name} needs a model that is linear in its parameters; this one is not in {names}."
            " Use fitter lm, or fix what makes it nonlinear under [model.constants]"
        )
    return theta, rows


def _rows(problem: FitProblem, theta: Numbers) -> ForceRows:
    """Rows of the problem, over the noise, linearised at free parameters theta."""
    z = at_theta(problem, theta)
    slope, columns, torque = problem.dtheta(z), [], []
    for part in rows_of([(problem, z)]):
        columns.append(part.J / slope)
        torque.append(columns[-1] @ theta - part.r)
    return ForceRows.of(columns, torque)


def solved(
    problem: FitProblem, at: Numbers, rows: ForceRows, instruments: ForceRows | None = None
) -> Numbers:
    """min |Q'(W theta - b)| within the bounds, Q a basis of the instruments (without any, of W
    itself); a direction that the data do not determine stays where `at` is.
    """
    if instruments is None:
        few = rows.triangles()
        equations = Rows(*few.stacked(few.plain_weights()))
    else:
        Z, _ = instruments.stacked(instruments.plain_weights())
        equations = Rows.projected(*rows.stacked(rows.plain_weights()), Z)
    theta, _ = solve(equations, at, *bounds(problem))
    return theta


def _instruments(problem: FitProblem, theta: Numbers) -> ForceRows | None:
    """Rows along the closed-loop motion of the estimate, filtered and decimated as the data;
    None if it diverges.
    """
    runs = problem.runs
    assert runs.dataset is not None and runs.setting is not None
    full = problem.theta(at_theta(problem, theta))
    floors = noise_floor(runs.dataset)
    noise = np.array([floors[name].std for name, _ in runs.layout.chain.signature.outputs])
    from jaxid.fitting.controlled_motion import simulate_closed_loop

    motions = simulate_closed_loop(runs.dataset, runs.experiments, runs.layout, full, noise)
    if not all(np.isfinite(q).all() and np.isfinite(u).all() for q, u in motions):
        return None
    iu, iy = runs.setting.inputs, runs.setting.outputs
    experiments = []
    for e, (q, u) in zip(runs.experiments, motions, strict=True):
        y, drive = e.y.copy(), e.u.copy()
        y[:, iy], drive[:, iu] = q, u
        experiments.append(replace(e, y=y, u=drive))
    same = InverseDynamics(runs.setting.cutoff_hz, runs.setting.decimate)
    size = len(runs.weights), runs.engine.length
    made = same.runs(
        runs.dataset, experiments, runs.layout, np.ones(len(runs.channels)), None, shape=size
    )
    twin = FitProblem(made, problem.base, problem.free, *_boxes(problem), records=problem.records)
    back = made.noise / runs.noise  # weighted as the data are
    return _rows(twin, theta).weighted([back] * len(experiments))


def _boxes(problem: FitProblem) -> tuple[np.ndarray, np.ndarray]:
    """Bounds over the whole layout."""
    lower, upper = problem.base.copy(), problem.base.copy()
    lower[problem.free], upper[problem.free] = bounds(problem)
    return lower, upper


def finish(
    problem: FitProblem,
    at: np.ndarray,
    rows: ForceRows,
    theta: Numbers,
    name: str,
    stopped: str,
    evaluations: int = 1,
    instruments: ForceRows | None = None,
) -> Minimum:
    """The result at theta, after checking that the residual there is what the linear problem
    says.
    """
    z = at_theta(problem, theta)
    loss = problem.loss(z)
    if not np.isfinite(loss) or loss >= PENALTY:
        return Minimum(
            z,
            loss,
            False,
            "the torque residual is not finite; check the recorded motion",
            evaluations,
        )
    plain = np.concatenate([part.r.ravel() for part in rows_of([(problem, z)])])
    left = np.concatenate([e.ravel() for e in _rows(problem, at).errors(theta)])
    if np.linalg.norm(plain + left) > LINEAR * max(np.linalg.norm(plain), 1e-300):
        raise UsageError(
            f"{name} needs a model that is linear in its parameters over their whole range: use"
            " fitter lm"
        )
    found = sandwich(problem, z, rows, instruments, theta)
    return LinearMinimum(
        z,
        loss,
        stopped != "iteration limit",
        stopped,
        evaluations,
        [(evaluations, loss)],
        covariance=found,
    )


def sandwich(
    problem: FitProblem,
    z: np.ndarray,
    rows: ForceRows,
    instruments: ForceRows | None,
    theta: Numbers,
) -> CovarianceEstimate:
    """Covariance in the search scale: of the rows, each joint of each run by its own residual; cut
    off at the bounds.
    """
    plain, slope = rows.plain_weights(), problem.dtheta(z)
    found = covariance_of_rows(rows, plain, theta, of_scores, instruments=instruments)
    spread = found.matrix / slope / slope[:, None]
    span = problem.upper - problem.lower
    at_bound = (z - problem.lower <= 1e-7 * span) | (problem.upper - z <= 1e-7 * span)
    A, _ = rows.triangles().stacked(plain)
    curvature = (A * slope).T @ (A * slope)
    errors = np.concatenate([e.ravel() for e in rows.errors(theta)])
    descent = rows.stacked(plain)[0].T @ errors * slope
    least = np.diag(np.linalg.pinv(curvature, hermitian=True))
    at = np.flatnonzero(at_bound & found.identifiable)
    matrix = one_sided(problem, z, spread, least, -descent, at)
    std = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    std[~found.identifiable] = np.nan
    how = "white" if found.white else f"coloured (memory {found.memory} samples)"
    statement = (
        f"residuals are {how}: standard deviations from the sandwich covariance of the estimator"
    )
    return CovarianceEstimate(
        matrix=matrix,
        std=std,
        identifiable=found.identifiable,
        at_bound=at_bound,
        groups=found.groups,
        white=found.white,
        statement=statement,
    )
