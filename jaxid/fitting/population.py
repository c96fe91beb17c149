"""Fitters that move a population, all of it in parallel."""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxid.fitting.ask_tell import answered, answered_together, Searching
from jaxid.fitting.fitter import AbstractFitter, Log, Minimum, sampling_box
from jaxid.fitting.settings import about
from jaxid.numerics.precision import float64
from jaxid.problem.objective import AbstractProblem
from jaxid.problem.problem import PENALTY


class SearchState(NamedTuple):
    """A population search between generations: the method's own state, the best candidate that each
    slot has had, the loss of the best start (infinite without one), and the lowest loss that the
    search found itself at its last gain, with the generations since. A start is no gain: beside a
    good one all that a population finds is worse for long, and it is on its way all the same.
    """

    state: Any
    points: Any  # [pop dim]
    losses: Any  # [pop]
    given: Any
    mark: Any
    since: Any

    @property
    def best(self) -> tuple[np.ndarray, float]:
        i = int(np.argmin(np.asarray(self.losses)))
        return np.asarray(self.points)[i], float(np.asarray(self.losses)[i])

    @property
    def contracted(self) -> bool:
        """Whether at least half of the population has come to the same loss."""
        return same(float(np.median(np.asarray(self.losses))), self.best[1])

    @property
    def improved(self) -> bool:
        """Whether the search found anything that is better than its starts."""
        return self.best[1] < float(self.given)


def same(loss: float, other: float) -> bool:
    """Whether two losses are those of one minimum."""
    return abs(loss - other) <= SAME * abs(other) + 1e-300


class Ended(NamedTuple):
    """How a run of a population method ended."""

    course: SearchState
    converged: bool
    stopped: str
    stalled: bool


#: A population has collapsed where it extends over less than this share of the narrowest bounds.
COLLAPSED = 1e-9


#: Two losses that differ by less than this share are those of one minimum.
SAME = 1e-6


#: Simulated steps of a generation above which its blocks of candidates run on all cores, one call a
#: generation; below, a second of generations is one program.
LARGE = 30_000


#: Most generations of one compiled call.
CHUNK = 256


class AbstractPopulation(AbstractFitter):
    """Abstract: a population method in four pure functions over the search vectors z; bounds are
    kept by the base.

    `popsize` and `generations` are fields of every final class. A search ends when its own
    candidates have not gained a relative `tolerance` for `stall` generations (0: never) or the
    population has collapsed to one point, and starts anew at most `restarts` times, until two in a
    row end in the same minimum. It has converged if the population has contracted to a loss below
    that of every start.
    """

    popsize: eqx.AbstractVar[int]
    generations: eqx.AbstractVar[int]
    stall: int = eqx.field(
        default=60,
        kw_only=True,
        metadata=about("generations without gain after which it ends; 0: never", 0),
    )
    tolerance: float = eqx.field(
        default=1e-9, kw_only=True, metadata=about("relative gain that counts as one", 0)
    )
    restarts: int = eqx.field(
        default=0,
        kw_only=True,
        metadata=about("most new beginnings, until two in a row end in the same minimum", 0),
    )

    @abc.abstractmethod
    def init(
        self, key: PRNGKeyArray, population: Float[Array, "pop dim"], losses: Float[Array, " pop"]
    ) -> Any:
        """State from a first, evaluated population."""

    @abc.abstractmethod
    def ask(
        self,
        key: PRNGKeyArray,
        state: Any,
        lower: Float[Array, " dim"],
        upper: Float[Array, " dim"],
    ) -> Float[Array, "offspring dim"]:
        """Candidates of the next generation; what leaves the bounds is brought back by the base."""

    @abc.abstractmethod
    def tell(
        self,
        state: Any,
        candidates: Float[Array, "offspring dim"],
        losses: Float[Array, " offspring"],
    ) -> Any:
        """State after the candidates have been evaluated."""

    @abc.abstractmethod
    def spread(self, state: Any) -> Float[Array, ""]:
        """Largest extent of the population; zero once it has collapsed."""

    @property
    def _settings(self) -> tuple:
        """What tells the programs of this method and settings apart."""
        return type(self), *(repr(getattr(self, f.name)) for f in fields(self))

    #: Whether `informed` is called before every generation.
    guided: ClassVar[bool] = False

    def informed(self, problem: AbstractProblem, state: Any, log: Log) -> Any:
        """State with what a guided method wants to know of the problem before it asks, such as a
        Gauss-Newton step; its evaluations are added to the log.
        """
        return state

    @property
    def offspring(self) -> int:
        """Candidates of a generation."""
        return self.popsize

    def cost(self, problem: AbstractProblem) -> int:
        """Evaluations of a generation."""
        return self.offspring

    def again(self) -> AbstractPopulation:
        """The fitter of a restart: itself, or one with a larger population."""
        return self

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        return answered(
            self._minimising(
                problem, starts, key, Log(problem, self.name, budget, seconds, progress)
            ),
            problem,
        )

    def minimise_each(self, jobs, budget=None, progress=None):
        """`minimise` of each (problem, starts, key), with the same results; searches on one problem
        evaluate their generations together, which fills all cores.
        """
        searches = [
            self._minimising(p, starts, key, Log(p, self.name, budget, None, progress))
            for p, starts, key in jobs
        ]
        return answered_together(searches, [p for p, _, _ in jobs])

    def _minimising(
        self, problem: AbstractProblem, starts: Sequence[np.ndarray], key: PRNGKeyArray, log: Log
    ) -> Searching[Minimum]:
        found: Ended | None = None
        fitter: AbstractPopulation = self
        for attempt in range(self.restarts + 1):
            if log.exhausted or (attempt and log.left < 2 * fitter.popsize):
                break
            own = starts if attempt == 0 else starts[:1]
            ended = yield from fitter.searching(problem, own, jax.random.fold_in(key, attempt), log)
            agree = (
                found is not None
                and same(ended.course.best[1], found.course.best[1])
                and ended.converged
            )
            if found is None or ended.course.best[1] < found.course.best[1] or agree:
                found = ended
            if agree:
                found = ended._replace(
                    stopped=f"restarts end in the same minimum ({ended.stopped})"
                )
                break
            fitter = fitter.again()
        if found is None:
            middle = (problem.lower + problem.upper) / 2
            return log.minimum(
                np.clip(starts[0] if starts else middle, problem.lower, problem.upper),
                False,
                log.exhausted,
            )
        return log.minimum(found.course.best[0], found.converged, found.stopped, found.stalled)

    def searching(
        self,
        problem: AbstractProblem,
        starts: Sequence[np.ndarray],
        key: PRNGKeyArray,
        log: Log,
        course: SearchState | None = None,
        most: int | None = None,
    ) -> Searching[Ended]:
        """One run of the method until a stopping rule holds. With a `course` it goes on from there;
        `most` generations, if that is less than the method's own. Every evaluation is counted in
        the log. `answered` takes it to its end.
        """
        now = (yield from self._begin(problem, starts, key, log)) if course is None else course
        wanted = self.generations if most is None else min(self.generations, most)
        generations = int(min(wanted, log.left // self.cost(problem)))
        whole = not self.guided and problem.work * self.offspring < LARGE
        done, chunk, programs = 0, 1, _Programs(self, problem, key)
        while done < generations and not log.exhausted:
            if whole:
                count = min(chunk, generations - done)
                now, spread, count, chunk = self._several(problem, now, key, done + 1, count, log)
            else:
                now, spread = yield from self._generation(programs, now, done + 1, log)
                count = 1
            done += count
            log.show(done, generations)
            if self.stall and int(now.since) >= self.stall:
                return _ended(now, now.contracted, f"no gain in {self.stall} generations")
            if spread <= COLLAPSED * float(np.min(problem.upper - problem.lower)):
                return _ended(now, True, "the population has collapsed to one point")
        full = generations < wanted
        why = log.exhausted or (
            "the budget of evaluations is used up" if full else "all generations done"
        )
        return Ended(now, False, why if now.improved else f"{why}; {UNIMPROVED}", False)

    def _begin(
        self, problem: AbstractProblem, starts: Sequence[np.ndarray], key: PRNGKeyArray, log: Log
    ) -> Searching[SearchState]:
        """First population: the starts, and random points of the sampling box; without starts, of
        the bounds. With less budget than that, the rest of it is not evaluated.
        """
        low, high = sampling_box(problem, starts[0]) if starts else (problem.lower, problem.upper)
        guesses = np.clip(
            np.reshape(starts[: max(1, self.popsize // 4)], (-1, low.size)),
            problem.lower,
            problem.upper,
        )
        with float64():
            k0, k1 = jax.random.split(jax.random.fold_in(key, 0))
            points = low + (high - low) * np.asarray(
                jax.random.uniform(k0, (self.popsize, low.size))
            )
        points[: len(guesses)] = guesses
        losses = np.full(self.popsize, PENALTY)
        count = int(min(self.popsize, log.left))
        losses[:count] = yield points[:count]
        log.add(count, float(losses.min()))
        return self.course(problem, k1, points, losses, len(guesses))

    def course(
        self,
        problem: AbstractProblem,
        key: PRNGKeyArray,
        points: np.ndarray,
        losses: np.ndarray,
        starts: int = 0,
    ) -> SearchState:
        """A course that begins with this evaluated population, of which this many at the front are
        starts.
        """
        with float64():
            program = problem.compiled(
                (*self._settings, "init"), self.init, key, points, losses, own=False
            )
            given, own = losses[:starts].min(initial=np.inf), losses[starts:].min(initial=np.inf)
            return SearchState(
                program(key, points, losses),
                points,
                losses,
                np.float64(given),
                np.float64(own),
                np.int32(0),
            )

    def _several(
        self,
        problem: AbstractProblem,
        course: SearchState,
        key: PRNGKeyArray,
        first: int,
        count: int,
        log: Log,
    ) -> tuple[SearchState, float, int, int]:
        """At most `count` generations as one program: (course, spread, generations done, how many
        to ask for next).
        """
        with float64():
            args = (
                course,
                jnp.asarray(key),
                np.int32(first),
                np.int32(count),
                problem.lower,
                problem.upper,
                problem.data,
            )
            program = problem.compiled(
                (*self._settings, "advance"), _advance(self, problem.pure), *args
            )
            began = log.elapsed
            course, series, done, spread = program(*args)
            done, series, spread = int(done), np.asarray(series), float(spread)
        spent = log.elapsed - began
        for i in range(done):
            log.add(self.offspring, float(series[i]), began + spent * (i + 1) / done)
        limit = 0.7 if log.limit is None else min(0.7, 0.3 * max(log.limit - log.elapsed, 1e-3))
        return (
            course,
            spread,
            done,
            int(np.clip(done * min(8.0, limit / max(spent, 1e-6)), 1, CHUNK)),
        )

    def _generation(
        self, programs: _Programs, course: SearchState, number: int, log: Log
    ) -> Searching[tuple[SearchState, float]]:
        """One generation, its candidates handed out."""
        with float64():
            course = course._replace(state=self.informed(programs.problem, course.state, log))
            candidates = programs(
                "ask", _proposal, programs.key, np.int32(number), course.state, *programs.bounds
            )
        losses = yield np.asarray(candidates)
        with float64():
            course, spread = programs("tell", _selection, course, candidates, losses)
        log.add(self.offspring, float(np.min(losses)))
        return course, float(spread)


UNIMPROVED = "never improved on its start"


def _ended(course: SearchState, contracted: bool, why: str) -> Ended:
    """A search that ended by a rule of its own; it converged where the population contracted to
    what it found itself.
    """
    if not course.improved:
        return Ended(course, False, f"{UNIMPROVED} ({why})", True)
    return Ended(
        course,
        contracted,
        why if contracted else f"{why}, but the population has not contracted",
        not contracted,
    )


class _Programs:
    """What a search runs in every generation, looked up once, and what it always reads."""

    def __init__(self, fitter: AbstractPopulation, problem: AbstractProblem, key: PRNGKeyArray):
        self.fitter, self.problem = fitter, problem
        with float64():
            self.key, self.bounds = (
                jnp.asarray(key),
                (jnp.asarray(problem.lower), jnp.asarray(problem.upper)),
            )
        self._programs: dict[str, Callable] = {}

    def __call__(
        self, name: str, maker: Callable[[AbstractPopulation], Callable], *args: Any
    ) -> Any:
        if name not in self._programs:
            settings = (*self.fitter._settings, name)
            self._programs[name] = self.problem.compiled(
                settings, maker(self.fitter), *args, own=False
            )
        return self._programs[name](*args)


def _proposal(fitter: AbstractPopulation) -> Callable[..., Array]:
    def propose(key, number, state, lower, upper):
        k0, k1 = jax.random.split(jax.random.fold_in(key, number))
        return reflected(k1, fitter.ask(k0, state, lower, upper), lower, upper)

    return propose


def _selection(fitter: AbstractPopulation) -> Callable[..., tuple[SearchState, Array]]:
    def select(course: SearchState, candidates, losses):
        state = fitter.tell(course.state, candidates, losses)
        n = fitter.offspring
        better = losses < course.losses[:n]
        points = course.points.at[:n].set(jnp.where(better[:, None], candidates, course.points[:n]))
        lowest = course.losses.at[:n].min(losses)
        best = jnp.min(losses)
        gained = best < course.mark - fitter.tolerance * jnp.abs(course.mark)
        course = SearchState(
            state,
            points,
            lowest,
            course.given,
            jnp.where(gained, best, course.mark),
            jnp.where(gained, 0, course.since + 1).astype(course.since.dtype),
        )
        return course, fitter.spread(state)

    return select


def _advance(
    fitter: AbstractPopulation, losses: Callable[[Array, Any], Array]
) -> Callable[..., tuple]:
    """`count` generations as one program, fewer if a stopping rule holds: (course, best loss of
    each, how many, spread).
    """
    propose, select = _proposal(fitter), _selection(fitter)

    def advance(course: SearchState, key, first, count, lower, upper, data):
        def go_on(carry):
            i, course, _, spread = carry
            fresh = course.since < fitter.stall if fitter.stall else True
            return (i < count) & fresh & (spread > COLLAPSED * jnp.min(upper - lower))

        def generation(carry):
            i, course, series, _ = carry
            candidates = propose(key, first + i, course.state, lower, upper)
            value = losses(candidates, data)
            course, spread = select(course, candidates, value)
            return i + 1, course, series.at[i].set(jnp.min(value)), spread

        begin = jnp.zeros_like(count), course, jnp.zeros(CHUNK), jnp.full((), jnp.inf)
        i, course, series, spread = jax.lax.while_loop(go_on, generation, begin)
        return course, series, i, spread

    return advance


#: Fractional part of the golden ratio: multiples of it spread evenly over the unit interval.
_GOLDEN = 0.6180339887498949


def reflected(key: PRNGKeyArray, z: Array, lower: Array, upper: Array) -> Array:
    """What lies outside the bounds goes to a random place inside; nan too. One random number a
    candidate.
    """
    draw = jax.random.uniform(key, (z.shape[0], 1)) + _GOLDEN * jnp.arange(z.shape[1])
    inside = (z >= lower) & (z <= upper)
    return jnp.where(
        inside, z, jnp.clip(lower + (upper - lower) * (draw - jnp.floor(draw)), lower, upper)
    )
