"""When the bodies of a robot on a free base change, by its angular momentum: a target is caught, a
load is let go.

At a moment s the last body changes and the whole gains the momentum that was brought: L(theta_0) is
constant before s, L(theta_1) after it, at values of their own. For each s both sides together are
least squares, linear about (theta_0, theta_1):

    SS(s) = min over d theta_0, d theta_1, c_0, c_1 of  sum_{t < s} |L(theta_0) - c_0|^2 + sum_{t >= s} |L(theta_1) - c_1|^2

Its smallest value gives s, a fit with each side filtered by itself the numbers, and so in turn
until s stays. What is caught jumps in speed, which a low-pass smears over about a period of its
cutoff: finer than a quarter of that no moment is claimed.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.base.errors import UsageError
from jaxid.dynamics.effect import NumberEffect
from jaxid.fitting.assemble import assemble
from jaxid.fitting.fitter import AbstractFitter, Progress
from jaxid.fitting.lost_runs import AT_NOISE
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.result import Fit
from jaxid.fitting.scale_free import refuse_scale_free
from jaxid.fitting.settings import label_of
from jaxid.force.torque_filter import evenly
from jaxid.numerics.precision import float64
from jaxid.problem.binding import Binding
from jaxid.problem.momentum import filtered, Momentum, momentum, noise_of, of_a_body
from jaxid.problem.problem import FitProblem
from jaxid.robots.bodies import BODY


#: Rounds of finding the moment and fitting both sides of it.
ROUNDS = 5
#: A change that nobody asked for is spoken of where chance would show it so rarely, and where it is
#: this share of the gap.
CHANCE, SHARE = 1e-6, 0.5
#: Step of a difference, as a share of a typical change of the number.
DIFFERENCE = 1e-3
#: Half the width of an interval of 95 % in standard deviations, and the chi-square that it stands
#: for.
HALF, DROP = 1.96, 3.84


@dataclass
class Series:
    """Momentum along the measured motion of all fit runs, at every sample between a run's first row
    and its last.

    `t` [n], `run` [n], `x` [n 2 nq]; `rows` those that count as independent; `level` [3] their
    noise.
    """

    binding: Binding
    residual: Momentum
    t: np.ndarray
    run: np.ndarray
    x: np.ndarray
    rows: np.ndarray
    every: int
    level: np.ndarray
    _program: Any = None

    @classmethod
    def of(cls, binding: Binding, residual: Momentum) -> Series:
        """The series of a binding's fit runs, the whole of each filtered at once."""
        b = binding
        rate, cutoff, every = residual.rates(b.dataset, b.chain, b.readings)
        t, run, x, rows, measured = [], [], [], [], []
        for number, e in enumerate(map(evenly, residual.select(b.dataset, "fit"))):
            whole, end, _ = filtered(b.dataset, e, b.chain, cutoff)
            at = slice(end, len(e.t) - end)
            rows.append(sum(map(len, t)) + np.arange(0, len(e.t[at]), every))
            t.append(e.t[at])
            x.append(whole[at, : 2 * b.chain.nq])
            run.append(np.full(len(e.t[at]), number))
            measured.append(whole)
        level = noise_of(b.chain, measured, b.readings[: b.chain.nq], rate, cutoff)
        own = replace(residual, cutoff_hz=cutoff, decimate=every)
        return cls(
            b,
            own,
            np.concatenate(t),
            np.concatenate(run),
            np.concatenate(x),
            np.concatenate(rows),
            every,
            level,
        )

    @property
    def resolution(self) -> float:
        """How far from the truth a smeared jump may put a moment, s."""
        return 1 / (4 * float(self.residual.cutoff_hz or np.inf))

    def carried(self, theta: np.ndarray, numbers: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """L over its noise [n 3] and its derivative by some numbers of the layout [n 3 numbers],
        nothing changing in time; by central differences, good to about 1e-9 and without a program
        of their own.
        """
        J = np.zeros((len(self.t), 3, len(numbers)))
        for k, i in enumerate(numbers):
            h = np.zeros(theta.size)
            h[i] = DIFFERENCE * max(self.binding.scale[i], 1e-6)
            J[:, :, k] = (self._along(theta + h) - self._along(theta - h)) / (2 * h[i])
        return self._along(theta), J

    def _along(self, theta: np.ndarray) -> np.ndarray:
        nq, layout = self.binding.chain.nq, self.binding.layout
        if self._program is None:

            def own(theta: Any, x: Any) -> Any:
                body = layout.model(theta).body().prepare(None)
                return jax.vmap(lambda x, body: momentum(body, x[:nq], x[nq:]), (0, None))(x, body)

            self._program = jax.jit(own)
        with float64():
            return np.asarray(self._program(jnp.asarray(theta), jnp.asarray(self.x))) / self.level

    def later(self, theta: np.ndarray, cutoff: float) -> tuple[float, ...]:
        """Noise of the momentum of a body with other numbers, at a cutoff, N m s."""
        chain, rate = (
            self.binding.layout.model(theta),
            1 / float(np.median(np.diff(self.t[self.run == 0]))),
        )
        return tuple(noise_of(chain, [self.x], self.binding.readings[: chain.nq], rate, cutoff))

    def moments(self, unknown: int) -> np.ndarray:
        """Times of rows between which a change may be looked for: what is unknown is told on both
        sides of it in one run.
        """
        least = max(6, unknown) * self.every
        inside = [self.t[self.run == run][least:-least] for run in np.unique(self.run)]
        return np.unique(np.concatenate(inside))[:: self.every]

    def squares(self, sides: Sides, moments: np.ndarray) -> np.ndarray:
        """SS of each moment; of infinity: without a change."""
        return np.array([self._least(sides, s)[0] for s in moments])

    def _least(self, sides: Sides, s: float) -> tuple[float, np.ndarray]:
        k = self.rows
        late = self.t[k] >= s
        r = np.where(late[:, None], sides.L1[k], sides.L0[k])
        J = np.where(
            late[:, None, None],
            np.concatenate([sides.J1[k], sides.J1s[k]], 2),
            np.concatenate([sides.J0[k], 0 * sides.J1s[k]], 2),
        )
        groups = 2 * self.run[k] + late
        for g in np.unique(groups):  # each side of each run has a momentum of its own
            own = groups == g
            r[own] -= r[own].mean(0)
            J[own] -= J[own].mean(0)
        J, r = J.reshape(r.size, -1), r.ravel()
        size = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
        d = np.linalg.lstsq(J / size, -r, rcond=1e-9)[0]
        return float(np.sum((r + J / size @ d) ** 2)), d / size

    def step(self, sides: Sides, s: float) -> np.ndarray:
        """What to add to the numbers (those of before, sizes of the change) at a moment."""
        return self._least(sides, s)[1]

    def finely(self, L0: np.ndarray, L1: np.ndarray, s: float, loss: float) -> tuple[float, float]:
        """(moment, standard deviation) at the samples about s, numbers as they are."""
        near = np.unique(self.t[np.abs(self.t - s) <= 12 * self.resolution])
        left = []
        for at in near:
            left.append(sum(scatter(L0[a]) + scatter(L1[b]) for a, b in self._split(at)))
        total = np.array(left) / self.every
        close = near[total <= total.min() + DROP * max(1.0, loss)]
        return float(near[np.argmin(total)]), ((close[-1] - close[0]) / 2 + self.resolution) / HALF

    def _split(self, s: float) -> list[tuple[np.ndarray, np.ndarray]]:
        return [
            ((self.run == r) & (self.t < s), (self.run == r) & (self.t >= s))
            for r in np.unique(self.run)
        ]

    def gained(self, L0: np.ndarray, L1: np.ndarray, s: float) -> np.ndarray:
        """Angular momentum that the whole gains at s, [3], N m s, in the run that shows most of
        both of its sides.
        """
        clear = 4 * self.resolution
        pairs = [(a & (self.t < s - clear), b & (self.t > s + clear)) for a, b in self._split(s)]
        a, b = max(pairs, key=lambda p: min(p[0].sum(), p[1].sum()))
        return (L1[b].mean(0) - L0[a].mean(0)) * self.level


@dataclass(frozen=True)
class Sides:
    """L [n 3] before and after, its derivatives by the numbers that both sides share (J0, J1) and
    by those that change (J1s).
    """

    L0: np.ndarray
    L1: np.ndarray
    J0: np.ndarray
    J1: np.ndarray
    J1s: np.ndarray


def scatter(L: np.ndarray) -> float:
    """Sum of squares about the mean."""
    return float(np.sum((L - L.mean(0)) ** 2)) if len(L) else 0.0


@dataclass(frozen=True)
class ParameterChange:
    """What changes: `sizes` and `times` of the layout, the numbers `own` that they act on, and
    those fitted on both sides.
    """

    own: list[int]
    sizes: list[int]
    times: list[int]
    shared: list[int]

    @classmethod
    def of(cls, binding: Binding) -> ParameterChange:
        """Raises `UsageError` for a change of a number that is none of a body."""
        layout, free = binding.layout, set(binding.free)
        effect = next(e for e in layout.chain.effects if isinstance(e, NumberEffect))
        own, sizes, times = [], [], []
        for place in layout.chain.places(effect):
            found = {layout.entries[i].field: i for i in layout.of_effect(effect.name, place)}
            if not free & set(found.values()):
                continue
            if not of_a_body(layout, found["size"]):
                raise UsageError(
                    f"momentum tells of bodies, and {effect.name}@{place} changes no number of one:"
                    " take it out"
                )
            own.append(layout.index(place))
            sizes.append(found["size"])
            times.append(found["time"])
        shared = [i for i in binding.free if i not in (*sizes, *times) and of_a_body(layout, i)]
        return cls(own, sizes, times, shared)

    def after(self, theta: np.ndarray) -> np.ndarray:
        """The numbers after the change."""
        out = theta.copy()
        out[self.own] += theta[self.sizes]
        return out

    def at(self, theta: np.ndarray, s: float) -> np.ndarray:
        out = theta.copy()
        out[self.times] = s
        return out

    def sides(self, series: Series, theta: np.ndarray) -> Sides:
        every = [*self.shared, *self.own]
        (L0, J0), (L1, J1) = series.carried(theta, every), series.carried(self.after(theta), every)
        n = len(self.shared)
        return Sides(L0, L1, J0[:, :, :n], J1[:, :, :n], J1[:, :, n:])


def fit_change(
    binding: Binding,
    fitter: AbstractFitter,
    residual: Momentum,
    loss: str,
    seed: int,
    budget: int | None,
    progress: Progress | None,
) -> Fit:
    """A fit of bodies that change at a moment, which is looked for."""
    began = time.perf_counter()
    change = ParameterChange.of(binding)
    binding = within(binding, change)
    series, bench = Series.of(binding, residual), ProblemBuilder(binding)
    theta, free = binding.theta.copy(), [*change.shared, *change.sizes]
    moments = series.moments(len(free))
    if not len(moments):
        raise UsageError(
            f"no run is long enough for {len(free)} numbers on both sides of a change: record more,"
            " or fit fewer"
        )
    sides = change.sides(series, theta)
    s = float(moments[np.argmin(series.squares(sides, moments))])
    ahead = theta.copy()
    ahead[free] = np.clip(
        theta[free] + series.step(sides, s), binding.lower[free], binding.upper[free]
    )
    begins, spent, fine, std = [theta, ahead], 0, s, 0.0
    number = 0
    while True:  # noise of what is held now is known from the second round on
        cut = replace(residual, moment=s)
        _, cutoff, every = cut.rates(binding.dataset, binding.chain, binding.readings)
        cut = replace(
            cut,
            cutoff_hz=cutoff,
            decimate=every,
            later=series.later(change.after(begins[0]), cutoff),
        )
        problem = bench.problem(cut, "fit", free, change.at(begins[0], s), loss=loss)
        refuse_scale_free(problem, problem.z(begins[-1]))
        left = None if budget is None else max(1, budget - spent)
        result = fitter.minimise(
            problem, [problem.z(b) for b in begins], jax.random.key(seed), left, progress
        )
        spent += result.evaluations
        theta = problem.theta(result.z)
        number += 1
        if result.failed:
            break
        sides = change.sides(series, theta)
        new = float(moments[np.argmin(series.squares(sides, moments))])
        fine, std = series.finely(sides.L0, sides.L1, new, mean_square(problem, result.z))
        if number == ROUNDS or (number > 1 and abs(fine - s) <= series.resolution):
            break
        s, begins = fine, [theta]
    found = {} if result.failed else dict.fromkeys(change.times, std)
    s = s if result.failed else fine
    bench.binding = replace(binding, read=binding.read | found)
    problem = bench.problem(cut, "fit", free, change.at(theta, s), loss=loss)
    notes = [] if result.failed else said(binding, change, series, sides, theta, s, std)
    fit = assemble(
        bench=bench,
        problem=problem,
        result=replace(result, evaluations=spent),
        residual=cut,
        fitter=label_of(fitter),
        seed=seed,
        compile_time=bench.compile_time(),
        wall_time=time.perf_counter() - began,
        notes=notes,
    )
    left = 0.0 if result.failed else mean_square(problem, result.z)
    if left <= AT_NOISE:
        return fit
    text = unexplained(binding, change, left)
    return replace(
        fit, converged=False, stalled=True, stopped_because=text, notes=(text, *fit.notes)
    )


def unexplained(binding: Binding, change: ParameterChange, left: float) -> str:
    """The sentence about a change that leaves more than noise."""
    named = {binding.layout.names[i] for i in change.own}
    bodies = dict.fromkeys(name.partition("@")[2] for name in named)
    others = [f"{number}@{body}" for body, number in product(bodies, BODY)]
    unnamed = [f"step_change@{name}" for name in others if name not in named]
    more = ""
    if unnamed:
        more = f"; what was not named is taken as unchanged: {', '.join(unnamed)}"
    return (
        f"the change leaves {left:.3g} times the noise (mean square): these numbers are not the"
        f" whole of it, their intervals and that of the moment do not hold{more}"
    )


def within(binding: Binding, change: ParameterChange) -> Binding:
    """The binding whose sizes leave every number within its own bounds; a centre of mass, which may
    be that of something large, within the robot's reach.
    """
    lower, upper = binding.lower.copy(), binding.upper.copy()
    for i, size in zip(change.own, change.sizes, strict=True):
        name = binding.layout.names[i]
        reach = (
            binding.upper[binding.layout.index(f"gyration_xx@{name.partition('@')[2]}")]
            if name.startswith("com_")
            else 0.0
        )
        lower[size] = (
            min(lower[i] - binding.theta[i], -reach) if reach else lower[i] - binding.theta[i]
        )
        upper[size] = max(upper[i] - binding.theta[i], reach)
    theta = binding.theta.copy()
    theta[change.sizes] = 0.0
    return replace(binding, lower=lower, upper=upper, theta=theta)


def mean_square(problem: FitProblem, z: np.ndarray) -> float:
    """Of the residuals over the noise."""
    rows = np.concatenate([r.ravel() for r in problem.residuals(z)])
    return float(rows @ rows) / max(1, rows.size - problem.size)


def said(
    binding: Binding,
    change: ParameterChange,
    series: Series,
    sides: Sides,
    theta: np.ndarray,
    s: float,
    std: float,
) -> list[str]:
    """The sentences about a change."""
    now, entries = change.after(theta), binding.layout.entries
    values = [
        f"{entries[i].name} {theta[i]:.4g} before and {now[i]:.4g} {entries[i].unit} after"
        for i in change.own
    ]
    gained = ", ".join(f"{v:.3g}" for v in series.gained(sides.L0, sides.L1, s))
    return [
        f"changed at {s:.3f} ± {HALF * std:.3f} s (95 %): {'; '.join(values)}",
        (
            f"with it the angular momentum of the whole gained ({gained}) N m s: each side of the"
            " moment keeps its own"
        ),
    ]


def suspected(series: Series, own: list[int], theta: np.ndarray) -> tuple[float, float] | None:
    """(moment, share of what is left that a change then explains), where the momentum of numbers
    `own` at `theta` is that of other bodies, or another one, from some moment on; None where
    nothing speaks for it.
    """
    moments = series.moments(2 * len(own))
    if not len(moments):
        return None
    L, J = series.carried(theta, own)
    sides = Sides(L, L, J, J, J)
    without, each = (
        float(series.squares(sides, np.array([np.inf]))[0]),
        series.squares(sides, moments),
    )
    least, more = float(each.min()), 3 + len(own)
    count = max(1, 3 * len(series.rows) - 2 * len(own) - 6 * len(np.unique(series.run)))
    before, after = without / (count + more), least / count
    from scipy.special import (
        chdtri,
    )  # its import changes the warnings' filters, which is no business of `import jaxid`

    chance = chdtri(more, CHANCE / len(moments))
    if (without - least) / max(1.0, after) < chance or before - after < SHARE * (before - 1):
        return None
    return float(moments[np.argmin(each)]), 1 - least / without


def noticed(binding: Binding, residual: Momentum, fit: Fit) -> Fit:
    """The fit, no longer called converged where something changed at a moment."""
    own = [i for i in binding.free if of_a_body(binding.layout, i)]
    found = None if fit.failed else suspected(Series.of(binding, residual), own, fit.theta)
    if found is None:
        return fit
    places = " ".join(f"--effect step_change@{binding.layout.names[i]}" for i in own)
    text = (
        f"at about {found[0]:.2f} s something changed: with bodies and momentum of their own, the"
        f" parts before and after explain {100 * found[1]:.3g} % of what is left. Something was"
        f" caught, let go or touched, and these numbers are those of neither part: {places} finds"
        " both, or cut the run there (window_s)"
    )
    return replace(
        fit, converged=False, stalled=True, stopped_because=text, notes=(text, *fit.notes)
    )
