"""Single changes of a robot by simulation: of its file where runs touch, of a model where columns
show nothing.

Columns along a motion know nothing of the forces of the ground. Every number is therefore simulated
at a few sizes, with all else as stated, and ranked by what it leaves once the starts of the runs
have moved, to first order, to where they leave least. An effect is simulated once, over a part of
the runs, and goes on in the size that leaves least there to first order.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxid.diagnosis.goals.changes import FIRST, StatedDifference
from jaxid.diagnosis.goals.gains import held_gains, known_loosely, with_room
from jaxid.diagnosis.goals.probes import is_level, probes_of
from jaxid.diagnosis.goals.propose import Proposal
from jaxid.diagnosis.hypothesis import Hypothesis
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.library import Unit
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.parameter import specs
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.secant import simulated
from jaxid.fitting.wide_slopes import WideDescent
from jaxid.problem.beginnings import TOUCHING
from jaxid.problem.binding import Binding
from jaxid.problem.residual import OutputError
from jaxid.simulation.sample_buffers import step_count


#: Sizes of a number that are tried, in its standard deviations or typical changes.
OF_NUMBERS = (-8.0, -2.0, -0.5, 0.5, 2.0, 8.0)
#: Share of an effect's probes at which runs that touch are simulated: further off they touch
#: elsewhere.
SMALL = 0.25
#: Effects whose aimed size is simulated over the whole of the runs.
AIMED_AT = 32
#: Shares of the best size of each change that are tried next.
NEARBY = (0.35, 0.5, 0.7, 0.85, 1.2, 1.5, 2.0, 3.0)
#: Changes whose sizes are tried more closely.
LOOKED_AT = 16
#: Which of the nested stretches of a run is its first half.
HALF = TOUCHING.index(2)
#: Simulations whose runs are kept at a time.
AT_ONCE = 256
#: Steps of all runs beyond which every effect is not simulated: minutes.
LONG = 1.2e7


@dataclass(frozen=True, eq=False)
class Trial:
    """A model with one change of one size. `theta` [wide layout]; `strengths` its numbers that are
    0 without the change, or moved from what is stated; `levels` those that are scaled themselves.
    """

    theta: np.ndarray
    stated: np.ndarray
    kind: str
    units: tuple[tuple[str, str, tuple[str, ...]], ...] = ()  # effect, place, fields
    strengths: tuple[int, ...] = ()
    levels: tuple[int, ...] = ()

    @property
    def place(self) -> tuple[object, ...]:
        return tuple(unit[:2] for unit in self.units) or self.strengths

    def scaled(self, share: float, lower: np.ndarray, upper: np.ndarray) -> Trial:
        """The same change of another size, within the bounds."""
        theta = self.theta.copy()
        moved, whole = list(self.strengths), list(self.levels)
        theta[moved] = self.stated[moved] + share * (theta[moved] - self.stated[moved])
        theta[whole] = share * theta[whole]
        index = [*moved, *whole]
        theta[index] = np.clip(theta[index], lower[index], upper[index])
        return replace(self, theta=theta)


def simulated_changes(
    bench: ProblemBuilder,
    wide: ProblemBuilder,
    plain: Binding,
    kinds: Sequence[type[Effect]],
) -> list[StatedDifference]:
    """The changes of the model `plain`, that of `bench`, which leave least by themselves, likeliest
    first; `wide` has the effects of these kinds as candidates.
    """
    stated = plain.theta
    starts = estimate_starts(bench, "fit", [stated])[0]
    own = _Judge(bench, stated, [], starts).nearest(list(_of_numbers(plain, stated)))
    theta = _in_wide(wide.binding, plain, stated)
    found = [*own, *_nearest_effects(wide, kinds, theta, [], starts)]
    near = _not_far(found)
    most = {"number": FIRST // 2, "law": FIRST // 2, "effect": FIRST, "effects": FIRST // 2}
    out = []
    for trial in near:
        most[trial.kind] -= 1
        if most[trial.kind] >= 0:
            out.append(_difference(wide.binding, plain, trial))
    return out


def _nearest_effects(
    wide: ProblemBuilder,
    kinds: Sequence[type[Effect]],
    theta: np.ndarray,
    free: Sequence[int] | np.ndarray,
    starts: np.ndarray,
) -> list[tuple[float, Trial]]:
    """What effects leave beside numbers theta, and those that leave least."""
    trials = list(_of_effects(wide.binding, kinds, theta, (SMALL,)))
    aimed = _Judge(wide, theta, free, starts, HALF).aimed(trials)
    return _Judge(wide, theta, free, starts).nearest(aimed[:AIMED_AT])


def _not_far(found: Sequence[tuple[float, Trial]]) -> list[Trial]:
    """Least left first, none that leaves far more than the best."""
    ordered = sorted(found, key=lambda pair: pair[0])
    return [trial for cost, trial in ordered if cost <= LIMITS.far * ordered[0][0]]


def simulated_effects(
    bench: ProblemBuilder, plain: Binding, kinds: Sequence[type[Effect]], nominal: Hypothesis
) -> list[Proposal]:
    """The effects that leave least beside numbers that are re-tuned, to first order, likeliest
    first: `nominal` is the model of the bench without effects.
    """
    wide, path = bench.binding, nominal.path
    starts = path.problem.starts(path.z)
    near = _not_far(_nearest_effects(bench, kinds, nominal.theta, path.problem.free, starts))
    theta = nominal.theta[[wide.layout.index(name) for name in plain.layout.names]]
    retuned = replace(plain, theta=theta)
    return [_difference(wide, retuned, trial).proposal for trial in near[:FIRST]]


def _in_wide(wide: Binding, plain: Binding, theta: np.ndarray) -> np.ndarray:
    """Numbers of a model in the layout that has candidates too."""
    out = wide.theta.copy()
    out[[wide.layout.index(name) for name in plain.layout.names]] = theta
    return out


def effects_by_runs(
    bench: ProblemBuilder,
    plain: Binding,
    kinds: Sequence[type[Effect]],
    theta: np.ndarray,
    free: Sequence[int],
    starts: np.ndarray,
    standing: Container[tuple[str, str]] = (),
) -> list[Proposal]:
    """The same of runs that do not touch, beside a model that stands: its numbers `theta` and those
    that are `free` in the bench, how its fit runs begin, and which effects are `standing` at places
    in it. Each other one is simulated at one size, and goes on in that which leaves least to first
    order. None where that takes too long.
    """
    wide = bench.binding
    every = _of_effects(wide, kinds, theta, (1.0,))
    trials = [trial for trial in every if not any(u[:2] in standing for u in trial.units)]
    steps = sum(step_count(e, bench.step) for e in wide.experiments("fit"))
    if steps * len(trials) > LONG:
        return []
    judge = _Judge(bench, theta, free, starts)
    near = _not_far(judge.nearest(judge.aimed(trials)[:LOOKED_AT]))
    own = theta[[wide.layout.index(name) for name in plain.layout.names]]
    retuned = replace(plain, theta=own)
    return [_difference(wide, retuned, trial).proposal for trial in near[:FIRST]]


class _Judge:
    """What changes leave of the fit runs, with starts and `free` numbers that move to first
    order.
    """

    def __init__(
        self,
        bench: ProblemBuilder,
        theta: np.ndarray,
        free: Sequence[int] | np.ndarray,
        starts: np.ndarray,
        stretch: int = 0,
    ):
        """`stretch`: which of the nested first stretches of the runs are simulated, by default the
        whole of them.
        """
        heads = None
        if stretch:
            heads = [nested[stretch] for nested in bench.runs(OutputError(), "fit").heads]
        p = bench.problem(OutputError(), "fit", free, theta, heads)
        self.bounds = bench.binding.lower, bench.binding.upper
        entries = bench.binding.layout.entries
        self.delays = {i for i, entry in enumerate(entries) if entry.field == "delay"}
        self.step = bench.step
        self.problem, self.starts = p, starts
        z = p.z(theta, starts)
        self.known = p.known_before(z)[0]
        descent = WideDescent(p, z)
        if p.size:
            descent.step(1.0)
        basis, sizes, _ = np.linalg.svd(descent.slopes, full_matrices=False)
        self.basis = basis[:, sizes > 1e-9 * sizes.max(initial=0.0)]

    def left(self, residual: np.ndarray) -> float:
        """The sum of squares that starts and numbers do not take away; infinite where a run
        diverged.
        """
        if not np.isfinite(residual).all():
            return np.inf
        rest = self._rest(np.concatenate([residual, self.known]))
        return float(rest @ rest)

    def _rest(self, every: np.ndarray) -> np.ndarray:
        """What starts and numbers do not take away."""
        return every - self.basis @ (self.basis.T @ every)

    def aimed(self, trials: Sequence[Trial]) -> list[Trial]:
        """Each change in the size that leaves least to first order in it, least left first."""
        (plain,) = simulated(self.problem, [trials[0].stated], [self.starts])
        known = np.zeros_like(self.known)
        before = self._rest(np.concatenate([plain, self.known]))
        lower, upper = self.bounds
        found: list[tuple[float, Trial]] = []
        for trial, residual in self._simulated(trials):
            if not np.isfinite(residual).all():
                continue
            moved = self._rest(np.concatenate([residual - plain, known]))
            share = 1.0
            if trial.strengths:
                share = float(-(moved @ before) / max(moved @ moved, 1e-300))
                two_sided = np.any(lower[list(trial.strengths)] < 0)
                share = share if two_sided else max(share, 0.0)
            after = before + share * moved
            found.append((float(after @ after), trial.scaled(share, lower, upper)))
        return [trial for _, trial in _least(found)]

    def nearest(self, trials: Sequence[Trial]) -> list[tuple[float, Trial]]:
        """Each change in its best size, and what it leaves; least first."""
        best = self._best(trials)
        nearer = []
        for _, trial in best[:LOOKED_AT]:
            nearer += [trial.scaled(share, *self.bounds) for share in NEARBY]
            nearer += self._in_whole_steps(trial)
        return _least([*best, *self._best(nearer)])

    def _in_whole_steps(self, trial: Trial) -> list[Trial]:
        """A change that is late, by whole steps: a simulator delays by no others."""
        late = [i for i in trial.strengths if i in self.delays]
        if not late:
            return []
        theta = trial.theta.copy()
        theta[late] = self.step * np.round(theta[late] / self.step)
        return [replace(trial, theta=theta)]

    def _best(self, trials: Sequence[Trial]) -> list[tuple[float, Trial]]:
        """The best size of each change, and what it leaves; least first."""
        every = self._simulated(trials)
        return _least([(self.left(residual), trial) for trial, residual in every])

    def _simulated(self, trials: Sequence[Trial]) -> Iterator[tuple[Trial, np.ndarray]]:
        """Each trial with its residual."""
        for begin in range(0, len(trials), AT_ONCE):
            part = trials[begin : begin + AT_ONCE]
            thetas = [trial.theta for trial in part]
            residuals = simulated(self.problem, thetas, [self.starts] * len(part))
            yield from zip(part, residuals, strict=True)


def _least(found: Sequence[tuple[float, Trial]]) -> list[tuple[float, Trial]]:
    """Of each change the size that leaves least; least first."""
    best: dict[tuple[object, ...], tuple[float, Trial]] = {}
    for cost, trial in found:
        if cost < best.get(trial.place, (np.inf,))[0]:
            best[trial.place] = cost, trial
    return sorted(best.values(), key=lambda pair: pair[0])


def _of_numbers(plain: Binding, stated: np.ndarray) -> Iterator[Trial]:
    """Each number of the file or its law by itself, and those of one kind at all of their
    places.
    """
    loose = known_loosely(with_room(plain))
    gains = set(held_gains(plain))
    alike: dict[str, list[Trial]] = {}
    for i in loose.free:
        size = loose.priors[i][1] if i in loose.priors else loose.scale[i]
        kind = "law" if i in gains else "number"
        theta = stated.copy()
        theta[i] += size
        one = Trial(theta=theta, stated=stated, kind=kind, strengths=(i,))
        alike.setdefault(loose.layout.names[i].partition("@")[0], []).append(one)
    for each in alike.values():
        together = [_at_all(each, stated)] if len(each) > 1 else []
        for one in (*each, *together):
            for share in OF_NUMBERS:
                yield one.scaled(share, plain.lower, plain.upper)


def _of_effects(
    wide: Binding,
    kinds: Sequence[type[Effect]],
    stated: np.ndarray,
    sizes: Sequence[float],
) -> Iterator[Trial]:
    """Each effect at each place, and at all of them at once, at its probes in some sizes."""
    for kind in kinds:
        places = wide.chain.offers(kind)
        at = wide.chain.places(kind).index
        each = [_at_place(wide, kind, at(place), place, stated, sizes) for place in places]
        for trials in each:
            yield from trials
        if len(places) > 1:
            for alike in zip(*each, strict=False):
                yield replace(_at_all(alike, stated), kind="effects")


def _at_place(
    wide: Binding,
    kind: type[Effect],
    k: int,
    place: str,
    stated: np.ndarray,
    sizes: Sequence[float],
) -> list[Trial]:
    out = []
    fields = specs(kind)
    numbers = {wide.layout.entries[i].field: i for i in wide.layout.of_effect(kind.name, place)}
    for probe in probes_of(wide, kind, k):
        theta = stated.copy()
        for field, value in probe.items():
            theta[numbers[field]] = value
        strong = [field for field in probe if fields[field].value == 0]
        two_sided = any(wide.lower[numbers[field]] < 0 for field in strong)
        one = Trial(
            theta=theta,
            stated=stated,
            kind="effect",
            units=((kind.name, place, tuple(probe)),),
            strengths=tuple(numbers[field] for field in strong),
            levels=tuple(numbers.values()) if is_level(kind) else (),
        )
        allowed = [size for size in sizes if size > 0 or two_sided]
        shares = (1.0,) if is_level(kind) else allowed
        out += [one.scaled(share, wide.lower, wide.upper) for share in shares]
    return out


def _at_all(alike: Sequence[Trial], stated: np.ndarray) -> Trial:
    """One change of the same size at several places."""
    theta = stated.copy()
    units: list[tuple[str, str, tuple[str, ...]]] = []
    strengths: list[int] = []
    levels: list[int] = []
    for trial in alike:
        changed = np.flatnonzero(trial.theta != stated)
        theta[changed] = trial.theta[changed]
        units += trial.units
        strengths += trial.strengths
        levels += trial.levels
    return Trial(
        theta=theta,
        stated=stated,
        kind=alike[0].kind,
        units=tuple(units),
        strengths=tuple(strengths),
        levels=tuple(levels),
    )


def _difference(wide: Binding, plain: Binding, trial: Trial) -> StatedDifference:
    """A trial as what is refitted."""
    theta = plain.theta.copy()
    if not trial.units:
        return StatedDifference(Proposal((), (), trial.theta), trial.strengths)
    units, numbers = [], []
    for effect, place, fields in trial.units:
        own = {wide.layout.entries[i].field: i for i in wide.layout.of_effect(effect, place)}
        values = np.array([trial.theta[own[field]] for field in fields])
        inf = np.full(len(fields), np.inf)
        units.append(
            Unit(
                effect=effect,
                location=place,
                fields=fields,
                least=-inf,
                most=inf,
                spread=inf,
                shape={},
                joints=(),
                columns=[],
            )
        )
        numbers.append(values)
    return StatedDifference(Proposal(tuple(units), tuple(numbers), theta))
