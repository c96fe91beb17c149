"""Any minimiser or least-squares solver of optimistix on the same residual as everything else."""

from __future__ import annotations

import abc
import itertools
import time
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxid.base.errors import UsageError
from jaxid.fitting.ending import gain, MATERIAL
from jaxid.fitting.fitter import AbstractFitter, Log, sampling_box
from jaxid.fitting.least_squares import guesses, seed_of
from jaxid.fitting.settings import about, option
from jaxid.numerics.precision import float64
from jaxid.problem.gauss_newton import gauss_newton_model
from jaxid.problem.objective import AbstractProblem, CANDIDATES, penalised, PENALTY


#: Blocks of random points that are looked at for a first one at which the loss is a number.
BLOCKS = 16
#: Runs that begin where the last ended, at most; and steps in a row that are not accepted before a
#: line search has failed.
RUNS, REJECTED = 20, 50
#: Share of the budget and of the time that goes into starts of the fitter's own, the rest is for a
#: second look at the end.
SHARE = 0.5


class Bounded(NamedTuple):
    """z = lower + range (1 + sin(at + step x)) / 2, as MINUIT has it: for every solver alike, since
    few of them know bounds.
    """

    middle: Any
    half: Any
    at: Any
    step: Any  # [size size]

    @classmethod
    def around(
        cls, problem: AbstractProblem, z: np.ndarray, scale: float = 1.0, margin: float = 0.05
    ) -> Bounded:
        """`z` is x = 0; within `margin` typical steps of a bound, at which the slope is none, it
        moves inside. A unit of x is `scale` typical steps, inward.
        """
        lower, upper = problem.lower, problem.upper
        typical = np.maximum(np.abs(z), 5 * problem.scale)
        typical[: problem.free.size][problem.log] = 1.0
        typical = np.minimum(typical, (upper - lower) / 4)
        z = np.clip(z, lower + margin * typical, upper - margin * typical)
        middle, half = (lower + upper) / 2, (upper - lower) / 2

        def angle(z):
            return np.arcsin(np.clip((z - middle) / half, -1, 1))

        inward = np.where(z < middle, 1.0, -1.0) * min(1.0, abs(scale)) * typical
        step = np.abs(angle(z + inward) - angle(z)) * max(1.0, abs(scale)) * np.sign(scale)
        return cls(middle, half, angle(z), np.diag(step))

    def z(self, x: Any) -> Any:
        """Search vector of a solver's x."""
        return self.middle + self.half * jnp.sin(self.at + self.step @ x)

    def curved(self, problem: AbstractProblem) -> Bounded:
        """In units in which the loss at x = 0 curves alike in all directions, which is what a
        quasi-Newton method begins with. The curvature is that of the reweighted least-squares
        problem plus the length of the slope: a first step is then no longer than a typical one (Li,
        Fukushima, Qi, Yamashita, Regularized Newton methods, 2004).
        """
        at = gauss_newton_model([(problem, np.asarray(self.z(np.zeros(problem.size))))])[0]
        typical = self.half * np.cos(self.at) * np.diag(self.step)
        slope, bend = typical * at.gradient, typical[:, None] * at.hessian * typical
        length = np.linalg.norm(slope)
        if not np.isfinite(length) or not np.isfinite(bend).all() or length == 0:
            return self
        root = np.linalg.cholesky(bend + (length + 1e-12 * np.trace(bend)) * np.eye(problem.size))
        return self._replace(step=self.step @ np.linalg.inv(root).T)


class SolverRun(NamedTuple):
    """Where a run of a solver has ended: `done` by its own tolerance, `limited` by steps, budget or
    time.
    """

    loss: float
    z: np.ndarray
    because: str
    done: bool = False
    limited: bool = False


class AbstractOptimistix(AbstractFitter):
    """Abstract: `made` gives the solver of optimistix. Steps are taken one by one, so that budget,
    time and Ctrl-C count.

    A solver begins anew where it ended until that gains nothing: only then has it converged. Half
    of what is then left of a budget or of a limit of time goes into new starts, each the best of
    some random points; one that ends its first run above the best is given up. Where no start has a
    finite loss, random points of the box are tried until one has.
    """

    steps: int = eqx.field(default=256, kw_only=True, metadata=about("most steps of a run", 1))
    restarts: int = eqx.field(
        default=0, kw_only=True, metadata=about("random starts beside the best given one", 0)
    )

    #: Scales of runs in turn, each of which begins where the last ended.
    scales: ClassVar[tuple[float, ...]] = (1.0,)

    @abc.abstractmethod
    def made(self) -> Any:
        """The solver."""

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        log, rng = (
            Log(problem, self.name, budget, seconds, progress),
            np.random.default_rng(seed_of(key)),
        )
        best = _first(problem, starts, log, rng)
        if best.loss >= PENALTY:
            return log.minimum(best.z, False, best.because)
        first = best.z
        best = self._descent(problem, best, log, np.inf)
        for z in guesses(problem, [first], self.restarts, key)[1:] if self.restarts else []:
            if not log.exhausted:
                best = self._better(problem, best, z, log)
        if np.isfinite(log.left) or seconds is not None:
            with log.shared(SHARE):
                while not log.exhausted and log.left > 4 * (1 + problem.size) + 10 * problem.size:
                    best = self._better(problem, best, _drawn(problem, first, log, rng).z, log)
        return log.minimum(
            best.z, best.done, best.because, stalled=not best.done and not best.limited
        )

    def _better(
        self, problem: AbstractProblem, best: SolverRun, z: np.ndarray, log: Log
    ) -> SolverRun:
        """The lower one of the best so far and of a descent from z."""
        found = self._descent(problem, SolverRun(np.inf, z, ""), log, best.loss)
        if (
            found.loss < best.loss
            and best.done
            and gain(problem, best.loss, found.loss) <= MATERIAL / 100
        ):
            return best._replace(loss=found.loss, z=found.z)  # the same minimum once more
        return found if found.loss < best.loss else best

    def _descent(
        self, problem: AbstractProblem, best: SolverRun, log: Log, rival: float
    ) -> SolverRun:
        """Runs of the solver, each from where the last ended, until none gains; given up after one
        that ends above `rival`.
        """
        for scale in itertools.islice(itertools.cycle(self.scales), RUNS):
            new = self._from(problem, best.z, log, scale)
            gained = (
                new.loss < best.loss
                and gain(problem, min(best.loss, PENALTY), new.loss) > MATERIAL / 100
            )
            best = new if new.loss < best.loss else new._replace(loss=best.loss, z=best.z)
            if new.limited or not gained or not best.loss < rival:
                return best
        return best._replace(
            because="begun anew again and again it still falls", done=False, limited=True
        )

    def _from(
        self, problem: AbstractProblem, start: np.ndarray, log: Log, scale: float
    ) -> SolverRun:
        """One run of the solver."""
        import optimistix as optx

        solver = self.made()
        square = isinstance(solver, optx.AbstractLeastSquaresSolver)
        if square and problem.loss_name != "sum_of_squares":
            raise UsageError(
                f"{self.name} minimises sums of squares, not {problem.loss_name}: take"
                " optimistix_bfgs"
            )
        simplex, slope = isinstance(solver, optx.NelderMead), 1 + problem.size
        bounded = Bounded.around(problem, start, scale, 0.0 if simplex else 0.05)
        if isinstance(solver, optx.AbstractQuasiNewton) and log.left >= 2 * slope:
            bounded = bounded.curved(problem)
            log.add(slope, np.inf)
        residual, data = problem.residual_function() if square else (None, problem.data)
        fn = _squares(residual) if residual is not None else _single(problem)
        args = bounded, data, float(np.sum(problem.data.count))
        with float64():
            x = jnp.zeros(problem.size)
            f_struct, aux_struct = jax.eval_shape(fn, x, args)
            options, tags = {"autodiff_mode": "fwd", "jac": "fwd"}, frozenset()
            began, known = time.perf_counter(), len(problem.programs)
            init, step, over = _programs(
                problem=problem,
                fitter=self,
                solver=solver,
                fn=fn,
                options=options,
                f_struct=f_struct,
                aux_struct=aux_struct,
                tags=tags,
            )
            state = init(x, args)
            best, z, rejected = np.inf, start, 0
            for count in range(self.steps):
                if log.exhausted or log.left < slope + 2 * simplex:
                    return SolverRun(
                        best,
                        z,
                        log.exhausted or "the budget of evaluations is used up",
                        limited=True,
                    )
                before, last = x, state
                x, state, loss = step(x, args, state)
                value = float(state.best[0] if simplex else loss)
                if value < best:
                    best, z = value, np.asarray(bounded.z(x))
                if count == 0 and len(problem.programs) > known:
                    problem.add_compile_time(time.perf_counter() - began)
                same = not simplex and count > 0 and np.array_equal(before, x)
                rejected = rejected + 1 if same else 0
                log.add(
                    _evaluations(last, state, slope) if simplex else 1 if same else slope, value
                )
                log.show(count, self.steps)
                done, result = over(x, args, state)
                fine = bool(result == optx.RESULTS.successful)
                if bool(done) or not fine:
                    return SolverRun(
                        best, z, "tolerance" if fine else _message(optx, result), done=fine
                    )
                if rejected == REJECTED:
                    return SolverRun(best, z, "no step from here lowers the loss")
        return SolverRun(best, z, "step limit", limited=True)


def _first(problem: AbstractProblem, starts: Any, log: Log, rng: np.random.Generator) -> SolverRun:
    """The best start; a random point of the box where none has a finite loss."""
    z = np.clip(
        np.array(starts[: None if log.budget is None else log.budget]), problem.lower, problem.upper
    )
    losses = problem.losses(z)
    log.add(len(z), float(losses.min()))
    best = SolverRun(float(losses.min()), z[int(np.argmin(losses))], "the simulation diverges")
    for number in range(BLOCKS):
        if best.loss < PENALTY or log.exhausted:
            break
        best = _drawn(problem, z[0], log, rng, wide=number % 2 == 1)
    return best


def _drawn(
    problem: AbstractProblem,
    guess: np.ndarray,
    log: Log,
    rng: np.random.Generator,
    wide: bool = False,
) -> SolverRun:
    """The best of some random points around the guess or, `wide`, of all the box; unknown starts of
    runs stay as guessed.
    """
    lower, upper = (problem.lower, problem.upper) if wide else sampling_box(problem, guess)
    z = lower + (upper - lower) * rng.uniform(
        size=(int(min(CANDIDATES, 10 * problem.size, log.left)), problem.size)
    )
    z[:, problem.free.size :] = guess[problem.free.size :]
    losses = problem.losses(z)
    log.add(len(z), float(losses.min()))
    return SolverRun(float(losses.min()), z[int(np.argmin(losses))], "the simulation diverges")


def _evaluations(before: Any, state: Any, corners: int) -> int:
    """Of a step of the simplex: two points, but for the first step, and all corners where it
    shrinks.
    """
    return 2 * (not bool(before.first_pass)) + corners * int(
        state.stats.n_shrink - before.stats.n_shrink
    )


def _message(optx: Any, result: Any) -> str:
    """What optimistix says of a run that failed, in one line."""
    return " ".join(str(optx.RESULTS[result]).split()).split(". ")[0] or "the solver gave up"


def _finite(r: Any) -> Any:
    """A residual that no solver takes for a number it may go on with, where the simulation
    diverges.
    """
    return jnp.clip(jnp.where(jnp.isfinite(r), r, 1e12), -1e12, 1e12)


def _squares(residual: Callable[[Any, Any], Any]) -> Callable[[Any, Any], tuple[Any, Any]]:
    def fn(x, args):
        bounded, data, count = args
        r = residual(bounded.z(x), data)
        return _finite(r), penalised(jnp.sum(r * r) / count)

    return fn


def _single(problem: AbstractProblem) -> Callable[[Any, Any], tuple[Any, Any]]:
    pure = problem.pure

    def fn(x, args):
        bounded, data, _ = args
        value = pure(bounded.z(x)[None], data)[0]
        return value, value

    return fn


def _spanned(solver: Any, x: Any, state: Any) -> Any:
    """A first state; the simplex of optimistix 0.1 for more than two numbers lies in a plane, since
    its corners go to wrong rows: here each goes along one axis.
    """
    if not hasattr(state, "simplex"):
        return state
    return eqx.tree_at(
        lambda s: s.simplex,
        state,
        x + jnp.eye(x.size + 1, x.size, -1) * (solver.adelta + solver.rdelta * x),
    )


def _mended(x: Any, state: Any, aux: Any) -> tuple[Any, Any, Any]:
    """A step's answer; the simplex of optimistix 0.1 takes best and worst corner from before the
    step: they are put right.
    """
    if not hasattr(state, "simplex"):
        return x, state, aux
    (_, _, best), (_, _, worst) = state.best, state.worst
    corners = state.simplex[best], state.simplex[worst]
    return corners[0], eqx.tree_at(lambda s: (s.best[1], s.worst[1]), state, corners), aux


def _programs(
    problem, fitter, solver, fn, options, f_struct, aux_struct, tags
) -> tuple[Callable, ...]:
    """init, step and terminate of a solver, compiled once for all starts of problems of one
    structure.
    """
    key = "optimistix", type(fitter), repr(fitter), problem.loss_name, problem.size, str(f_struct)
    if key not in problem.programs:
        rest = {"options": options, "tags": tags}

        def init(x, args):
            return _spanned(
                solver, x, solver.init(fn, x, args, options, f_struct, aux_struct, tags)
            )

        def step(x, args, state):
            return _mended(*solver.step(fn, x, args, state=state, **rest))

        def over(x, args, state):
            return solver.terminate(fn, x, args, state=state, **rest)

        functions: Any = (init, step, over)
        problem.programs[key] = tuple(eqx.filter_jit(f) for f in functions)
    return problem.programs[key]


class Optimistix(AbstractOptimistix):
    """Any minimiser or least-squares solver of optimistix: `Optimistix(optimistix.Dogleg(rtol=1e-8,
    atol=1e-8))`.

    Bounds are kept by the transform that all of them share; a least-squares solver gets the
    residual, a minimiser the loss.
    """

    name: ClassVar[str] = "optimistix"
    source: ClassVar[str] = (
        "Rader, Lyons, Kidger, Optimistix: modular optimisation in JAX and Equinox, arXiv"
        " 2402.09983, 2024"
    )

    solver: Any = option(None, "a solver of optimistix, given in Python")

    def made(self):
        if self.solver is None:
            raise UsageError(
                "Optimistix needs a solver: Optimistix(optimistix.Dogleg(rtol=1e-8, atol=1e-8))"
            )
        return self.solver


class OptimistixLM(AbstractOptimistix):
    """Levenberg-Marquardt of optimistix on the residual; bounds by a sine transform."""

    name: ClassVar[str] = "optimistix_lm"
    source: ClassVar[str] = Optimistix.source

    rtol: float = option(1e-8, "relative tolerance", 0)
    atol: float = option(
        1e-8,
        "absolute tolerance, of the search vector in typical steps and of the sum of squares",
        0,
    )

    def made(self):
        import optimistix

        return optimistix.LevenbergMarquardt(self.rtol, self.atol)


class OptimistixDogleg(AbstractOptimistix):
    """Powell's dogleg of optimistix on the residual; bounds by a sine transform."""

    name: ClassVar[str] = "optimistix_dogleg"
    source: ClassVar[str] = Optimistix.source

    rtol: float = option(1e-8, "relative tolerance", 0)
    atol: float = option(
        1e-8,
        "absolute tolerance, of the search vector in typical steps and of the sum of squares",
        0,
    )

    def made(self):
        import optimistix

        return optimistix.Dogleg(self.rtol, self.atol)


class OptimistixBFGS(AbstractOptimistix):
    """BFGS of optimistix, for every loss; bounds by a sine transform."""

    name: ClassVar[str] = "optimistix_bfgs"
    source: ClassVar[str] = Optimistix.source

    rtol: float = option(1e-7, "relative tolerance", 0)
    atol: float = option(
        1e-7, "absolute tolerance, of the search vector in typical steps and of the loss", 0
    )

    def made(self):
        import optimistix

        return optimistix.BFGS(self.rtol, self.atol)


class OptimistixNelderMead(AbstractOptimistix):
    """Nelder and Mead's simplex of optimistix, for every loss, without derivatives; bounds by a
    sine transform.

    It begins anew where it ends, with a large simplex and a small mirrored one in turn.
    """

    name: ClassVar[str] = "optimistix_nelder_mead"
    scales: ClassVar[tuple[float, ...]] = (1.0, -0.3)
    source: ClassVar[str] = Optimistix.source

    rtol: float = option(1e-6, "relative tolerance", 0)
    atol: float = option(
        1e-6, "absolute tolerance, of the search vector in typical steps and of the loss", 0
    )
    steps: int = eqx.field(default=4000, kw_only=True, metadata=about("most steps of a run", 1))

    def made(self):
        import optimistix

        return optimistix.NelderMead(self.rtol, self.atol, adelta=0.5)
