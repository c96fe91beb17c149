"""Any minimiser or least-squares solver of optimistix on the same residual as everything else."""

from __future__ import annotations

import abc
import time
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxid.errors import UsageError
from jaxid.fitting.fitter import AbstractFitter, Log
from jaxid.fitting.least_squares import guesses
from jaxid.fitting.settings import about, option
from jaxid.numerics.precision import float64
from jaxid.problem.objective import AbstractProblem, PENALTY


class Bounded(NamedTuple):
    """z = lower + range (1 + sin x) / 2, as MINUIT has it, with x in steps that are all alike at the start: the same for every
    solver, since few of them know bounds."""

    lower: Any
    middle: Any
    half: Any
    at: Any
    step: Any

    @classmethod
    def around(cls, problem: AbstractProblem, z: np.ndarray, scale: float = 1.0) -> Bounded:
        """`z` is x = 0; a little inside where it lies at a bound, at which the slope is none."""
        lower, upper = problem.lower, problem.upper
        typical = np.maximum(np.abs(z), 5 * problem.scale)
        typical[: problem.free.size][problem.log] = 1.0
        typical = np.minimum(typical, (upper - lower) / 4)
        z = np.clip(z, lower + 0.05 * typical, upper - 0.05 * typical)
        half = (upper - lower) / 2
        at = np.arcsin(np.clip((z - lower) / half - 1, -1, 1))
        return cls(lower, lower + half, half, at, scale * typical / (half * np.cos(at)))

    def z(self, x: Any) -> Any:
        """Search vector of a solver's x."""
        return self.middle + self.half * jnp.sin(self.at + self.step * x)


class AbstractOptimistix(AbstractFitter):
    """Abstract: `made` gives the solver of optimistix. Steps are taken one by one, so that budget, time and Ctrl-C count."""

    steps: int = eqx.field(default=256, kw_only=True, metadata=about("most steps of a run", 1))
    restarts: int = eqx.field(default=0, kw_only=True, metadata=about("random starts beside the best given one", 0))

    #: Scales of the search, one a run that begins where the last ended: a simplex collapses before its minimum.
    scales: ClassVar[tuple[float, ...]] = (1.0,)

    @abc.abstractmethod
    def made(self) -> Any:
        """The solver."""

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        log = Log(problem, self.name, budget, seconds, progress)
        best: tuple[float, np.ndarray, bool, str] = np.inf, np.asarray(starts[0]), False, ""
        every = guesses(problem, starts, self.restarts, key)
        given = len(every) - self.restarts
        losses = problem.losses(np.array(every[:given]))
        log.add(given, float(losses.min()))
        for z in [every[int(np.argmin(losses))], *every[given:]]:
            found = np.inf, z, False, ""
            for scale in self.scales:
                if not log.exhausted:
                    found = min(found, self._from(problem, found[1], log, scale), key=lambda run: run[0])
            best = min(best, found, key=lambda found: found[0])
        return log.minimum(best[1], best[2], log.exhausted or best[3] or "the budget of evaluations is used up")

    def _from(self, problem: AbstractProblem, start: np.ndarray, log: Log, scale: float) -> tuple[float, np.ndarray, bool, str]:
        """(loss, z, converged, why it stopped) of one run of the solver."""
        import optimistix as optx

        solver, bounded = self.made(), Bounded.around(problem, start, scale)
        square = isinstance(solver, optx.AbstractLeastSquaresSolver)
        if square and problem.loss_name != "sum_of_squares":
            raise UsageError(f"{self.name} minimises sums of squares, not {problem.loss_name}: take optimistix_bfgs")
        derivatives = not isinstance(solver, optx.NelderMead)
        each = 1 + problem.size if derivatives else 2  # with a look at its best point, which Nelder-Mead does not tell
        residual, data = problem.residual_function() if square else (None, problem.data)
        fn = _squares(residual) if residual is not None else _single(problem)
        args = bounded, data
        with float64():
            x = jnp.zeros(problem.size)
            f_struct, aux_struct = jax.eval_shape(fn, x, args)
            options, tags = {"autodiff_mode": "fwd", "jac": "fwd"}, frozenset()
            began, known = time.perf_counter(), len(problem.programs)
            init, step, over, look = _programs(problem, self, solver, fn, options, f_struct, aux_struct, tags)
            state = init(x, args)
            best, z = np.inf, start
            for count in range(self.steps):
                x, state, loss = step(x, args, state)
                value = float(loss if derivatives else look(x, args))
                if value < best:
                    best, z = value, np.asarray(bounded.z(x))
                if count == 0 and len(problem.programs) > known:
                    problem.add_compile_time(time.perf_counter() - began)
                log.add(each, value)
                log.show(count, self.steps)
                done, result = over(x, args, state)
                if bool(done) or not bool(result == optx.RESULTS.successful):
                    fine = bool(result == optx.RESULTS.successful)
                    return best, z, fine, "tolerance" if fine else _message(optx, result)
                if log.exhausted:
                    return best, z, False, log.exhausted
        return best, z, False, "step limit"


def _message(optx: Any, result: Any) -> str:
    """What optimistix says of a run that failed, in one line."""
    return " ".join(str(optx.RESULTS[result]).split()).split(". ")[0] or "the solver gave up"


def _finite(r: Any) -> Any:
    """A residual that no solver takes for a number it may go on with, where the simulation diverges."""
    return jnp.clip(jnp.where(jnp.isfinite(r), r, 1e12), -1e12, 1e12)


def _squares(residual: Callable[[Any, Any], Any]) -> Callable[[Any, Any], tuple[Any, Any]]:
    def fn(x, args):
        bounded, data = args
        r = _finite(residual(bounded.z(x), data))
        return r, jnp.minimum(jnp.mean(r * r), PENALTY)

    return fn


def _single(problem: AbstractProblem) -> Callable[[Any, Any], tuple[Any, Any]]:
    pure = problem.pure

    def fn(x, args):
        bounded, data = args
        value = pure(bounded.z(x)[None], data)[0]
        return value, value

    return fn


def _mended(x: Any, state: Any, aux: Any) -> tuple[Any, Any, Any]:
    """A step's answer; the simplex of optimistix 0.1 takes best and worst corner from before the step: they are put right."""
    if not hasattr(state, "simplex"):
        return x, state, aux
    (_, _, best), (_, _, worst) = state.best, state.worst
    corners = state.simplex[best], state.simplex[worst]
    return corners[0], eqx.tree_at(lambda s: (s.best[1], s.worst[1]), state, corners), aux


def _programs(problem, fitter, solver, fn, options, f_struct, aux_struct, tags) -> tuple[Callable, ...]:
    """init, step and terminate of a solver, and the loss itself, compiled once for all starts of problems of one structure."""
    key = "optimistix", repr(fitter), problem.loss_name, problem.size, str(f_struct)
    if key not in problem.programs:
        rest = {"options": options, "tags": tags}
        init = lambda x, args: solver.init(fn, x, args, options, f_struct, aux_struct, tags)
        step = lambda x, args, state: _mended(*solver.step(fn, x, args, state=state, **rest))
        over = lambda x, args, state: solver.terminate(fn, x, args, state=state, **rest)
        look = lambda x, args: fn(x, args)[1]
        functions: Any = (init, step, over, look)
        problem.programs[key] = tuple(eqx.filter_jit(f) for f in functions)
    return problem.programs[key]


class Optimistix(AbstractOptimistix):
    """Any minimiser or least-squares solver of optimistix: `Optimistix(optimistix.Dogleg(rtol=1e-8, atol=1e-8))`.

    Bounds are kept by the transform that all of them share; a least-squares solver gets the residual, a minimiser the loss.
    """

    name: ClassVar[str] = "optimistix"
    source: ClassVar[str] = "Rader, Lyons, Kidger, Optimistix: modular optimisation in JAX and Equinox, arXiv 2402.09983, 2024"

    solver: Any = option(None, "a solver of optimistix, given in Python")

    def made(self):
        if self.solver is None:
            raise UsageError("Optimistix needs a solver: Optimistix(optimistix.Dogleg(rtol=1e-8, atol=1e-8))")
        return self.solver


class OptimistixLM(AbstractOptimistix):
    """Levenberg-Marquardt of optimistix on the residual; bounds by a sine transform."""

    name: ClassVar[str] = "optimistix_lm"
    source: ClassVar[str] = Optimistix.source

    rtol: float = option(1e-8, "relative tolerance", 0)
    atol: float = option(1e-8, "absolute tolerance, of the search vector in typical steps and of the sum of squares", 0)

    def made(self):
        import optimistix

        return optimistix.LevenbergMarquardt(self.rtol, self.atol)


class OptimistixDogleg(AbstractOptimistix):
    """Powell's dogleg of optimistix on the residual; bounds by a sine transform."""

    name: ClassVar[str] = "optimistix_dogleg"
    source: ClassVar[str] = Optimistix.source

    rtol: float = option(1e-8, "relative tolerance", 0)
    atol: float = option(1e-8, "absolute tolerance, of the search vector in typical steps and of the sum of squares", 0)

    def made(self):
        import optimistix

        return optimistix.Dogleg(self.rtol, self.atol)


class OptimistixBFGS(AbstractOptimistix):
    """BFGS of optimistix, for every loss; bounds by a sine transform."""

    name: ClassVar[str] = "optimistix_bfgs"
    source: ClassVar[str] = Optimistix.source

    rtol: float = option(1e-7, "relative tolerance", 0)
    atol: float = option(1e-7, "absolute tolerance, of the search vector in typical steps and of the loss", 0)

    def made(self):
        import optimistix

        return optimistix.BFGS(self.rtol, self.atol)


class OptimistixNelderMead(AbstractOptimistix):
    """Nelder and Mead's simplex of optimistix, for every loss, without derivatives; bounds by a sine transform.

    It begins anew where it ends, with smaller and mirrored simplices.
    """

    name: ClassVar[str] = "optimistix_nelder_mead"
    scales: ClassVar[tuple[float, ...]] = (1.0, -0.5, 0.25, -0.1, 0.05, -0.02, 0.01, -0.005)
    source: ClassVar[str] = Optimistix.source

    rtol: float = option(1e-6, "relative tolerance", 0)
    atol: float = option(1e-6, "absolute tolerance, of the search vector in typical steps and of the loss", 0)
    steps: int = eqx.field(default=4000, kw_only=True, metadata=about("most steps of a run", 1))

    def made(self):
        import optimistix

        return optimistix.NelderMead(self.rtol, self.atol, adelta=0.5)
