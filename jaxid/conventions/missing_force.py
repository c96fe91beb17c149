"""The force that a model lacks along a measured motion, under any reading of the channels: fast,
without a simulation.

The measured joints are filtered without phase and differentiated, the inputs pass the same filter,
and the model's numbers are fitted to what is missing, drive(u) - (M qdd + bias + friction), beside
laws of the joint's own motion that a model may lack (an offset, a spring, friction that brakes). A
reading changes the channels (negated, offset, scaled, exchanged, late); the program is the same for
all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from jaxid.data.signals import filter_ends, zero_phase
from jaxid.dynamics.effect import JointEffect, neutral, Signals
from jaxid.dynamics.joint_readings import cutoffs, joint_motion, stated_positions
from jaxid.dynamics.parameter import specs, with_fields
from jaxid.force.columns import FEW, Forces, ROWS
from jaxid.force.drive import drive_torque
from jaxid.force.gauss_newton import descend, Room
from jaxid.force.sampled_motion import FilteredInput, SampledMotion
from jaxid.models.effects import (
    ConstantTorque,
    CoulombFriction,
    QuadraticDrag,
    SpringTorque,
    ViscousFriction,
)
from jaxid.numerics.precision import float64
from jaxid.problem.binding import Binding
from jaxid.problem.trust import trusting
from jaxid.simulation.sample_buffers import columns


#: The longest part of a run that is filtered.
LONGEST = 200_000
#: Samples of a row, and the width of what they lie in in periods of the highest frequency of the
#: motion.
NEIGHBOURS, WIDTH = 5, 0.5
#: Share of the usual speed below which a joint counts as standing still: its friction may take any
#: value.
STILL = 0.08
BLOCKS, EDGE = 10, 4
#: The first step of a model that is not linear moves no number by more than this many times its
#: size.
REACH = 3.0
#: Units of inputs that are goals of a law and not what drives.
GOALS = "rad", "m", "rad/s", "m/s"
#: Laws of each joint's own motion that a model may lack, of one number each; all but the first one
#: brake or hold.
LAWS = (ConstantTorque, SpringTorque, ViscousFriction, CoulombFriction, QuadraticDrag)


def measured(binding: Binding, each: int = 1) -> SampledMotion | None:
    """The motion of the runs to fit and to choose by, `each` samples a row; None where the model's
    joints are not all measured or hidden states move beside them. Where a row is one sample, dry
    friction is off while its step is filtered in the drive alone; the mean over several is the same
    for both sides.
    """
    chain = binding.chain
    if not binding.motions or chain.mechanism.hidden_states:
        return None
    runs = binding.dataset.seen
    share = max(1, ROWS // max(1, len(runs)))
    parts = [p for k, e in enumerate(runs) if (p := _part(binding, e, share, k, each)) is not None]
    if not parts:
        return None

    def join(name):
        return np.concatenate([getattr(p, name) for p in parts])

    qd, held = join("qd"), join("held")
    speed = np.abs(parts[0].mean(np.abs(qd)))
    weight = 1.0 * (speed > STILL * np.percentile(speed, 95, axis=0))
    if held.all() or not weight[held].any():
        held = np.zeros(len(held), bool)
    step = float(np.median([p.step for p in parts]))
    sources = tuple(s for p in parts for s in p.sources)
    return replace(
        parts[0],
        q=join("q"),
        qd=qd,
        qdd=join("qdd"),
        since=join("since"),
        weight=weight,
        held=held,
        block=join("block"),
        step=step,
        sources=sources,
    )


def _part(binding: Binding, e: Any, count: int, number: int, each: int) -> SampledMotion | None:
    chain = binding.chain
    iu, iy = columns(binding.dataset, chain)
    part = slice(0, LONGEST)
    t, y = e.t[part], e.motion()[part]
    if len(t) < 60:
        return None
    cutoff = max(cutoffs(chain, t, y[:, iy], e.noise_rms(binding.readings, iy)))
    q, qd, qdd, _ = joint_motion(
        chain, t, y[:, iy], [cutoff] * chain.nq, stated_positions(e, chain.signature)
    )
    nu = len(iu)
    u = e.u[part][:, iu] if nu else np.zeros((len(t), 0))
    linear = np.array([binding.dataset.inputs[i].hold == "linear" for i in iu], bool)
    # An input that is held from its sample on acts, as a mean over both sides of a sample, half a
    # row later.
    acting = np.where(linear, u, (u + np.concatenate([u[:1], u[:-1]])) / 2) if nu else u
    step = float(np.median(np.diff(t)))
    # The neighbours of a row lie `every` steps apart, and the drive is filtered as far as they do
    # not see.
    every = max(1, round(WIDTH / (cutoff * step * each))) if each > 1 else 1
    smooth = zero_phase(t, acting, cutoff if each == 1 else 0.4 / (every * step)) if nu else u
    aside = every * (np.arange(each) - each // 2)
    ends = filter_ends(t, cutoff) + EDGE + every * (each // 2)
    if len(t) - 2 * ends < 30:
        return None
    rows = np.unique(
        np.linspace(ends, len(t) - ends - 1, min(count, len(t) - 2 * ends)).astype(int)
    )
    count, at = len(rows), (rows[:, None] + aside).ravel()
    return SampledMotion(
        q=q[at],
        qd=qd[at],
        qdd=qdd[at],
        since=t[rows] - t[0],
        weight=np.ones((count, chain.nq)),
        held=np.full(count, e.split != "fit"),
        block=number * BLOCKS + np.arange(count) * BLOCKS // count,
        step=step,
        sources=(FilteredInput(t, smooth, t[at]),),
        mix=np.eye(nu),
        rows=np.zeros(nu),
        drift=np.zeros(nu),
        each=each,
    )


@dataclass(frozen=True)
class ReadingFit:
    """Numbers fitted under one reading: what is left of the drive (rms, share) on fitted and on
    held-out samples, and the residual [rows nq] with its slopes by all numbers [rows nq numbers].
    """

    x: np.ndarray
    left: float
    held: float
    residual: np.ndarray
    slopes: np.ndarray

    @property
    def worst(self) -> float:
        return max(self.left, self.held)


class ForceFit:
    """Fits of a bound model to the missing force under readings of a motion."""

    def __init__(self, binding: Binding, motion: SampledMotion):
        self.binding, self.motion = binding, motion
        # Gains make the torque: where they are free, the smaller all numbers are, the less is left.
        self.free = [
            i for i in binding.free if np.isfinite(binding.theta[i]) and i not in binding.gains
        ]
        self.nq = binding.chain.nq
        self.driven = motion.u.shape[1] > 0 and bool(np.any(motion.u))
        if not self.driven and self.free:
            # Without a drive nothing says how large the inertia is: one number is held.
            self.free = self.free[1:]
        few = motion.thinned(FEW)
        self.forces = Forces(binding.layout, binding.theta, binding.scale, self.free, few)

    @property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the free numbers. Where a box reaches to nothing its end comes from how fast and far
        the recording moves, which a reading may change: there only the sign is kept.
        """
        lower, upper = self.binding.lower[self.free], self.binding.upper[self.free]
        return np.where(lower < 0, -np.inf, lower), np.where(lower <= 0, np.inf, upper)

    def missing(self, theta: np.ndarray, m: SampledMotion) -> np.ndarray:
        """Missing force [rows nq] at these numbers."""
        return m.mean(self.forces.missing(theta, m))

    def slopes(self, theta: np.ndarray, h: np.ndarray, m: SampledMotion) -> np.ndarray:
        """The force [rows nq free] by each free number, by differences h unless the model is linear
        in its numbers.
        """
        if self.forces.linear:
            return m.mean(self.forces.columns(m)[1])
        thetas = np.repeat(theta[None], 1 + len(h), 0)
        thetas[1 + np.arange(len(h)), self.free] += h
        found = self.forces.at(thetas, m)
        return m.mean(np.moveaxis((found[1:] - found[0]) / h[:, None, None], 0, -1))

    def norm(self, m: SampledMotion, theta: np.ndarray | None = None) -> np.ndarray:
        """What the force is measured by, [nq]: the drive where the inputs tell it, else what the
        motion takes at these numbers (those of the start). Under another scale of a channel a
        motion takes more, and as much as it takes remains more.
        """
        theta = self.binding.theta if theta is None else theta
        size = self._driven(m, theta)
        if not self.binding.chain.direct and not np.all(size > 1e-9 * np.max(size)):
            size = np.where(size > 1e-9 * np.max(size), size, self._taken(m, theta))
        return np.where(size > 1e-9 * np.max(size), size, np.max(size) + 1e-300)

    def _driven(self, m: SampledMotion, theta: np.ndarray) -> np.ndarray:
        """How much the inputs drive each joint [nq], as rms about its mean; 0 where they are goals,
        which say no force.
        """
        chain = self.binding.chain
        if not self.driven or any(unit in GOALS for _, unit in chain.signature.commands):
            return np.zeros(self.nq)
        u = m.mean(self._torque(m, theta)) if chain.direct else self.pushed(m, theta)
        return np.sqrt(np.mean((u - (u.mean(0) if len(u) else 0)) ** 2, axis=0))

    def _torque(self, m: SampledMotion, theta: np.ndarray) -> np.ndarray:
        """Joint torque [samples nq] of inputs that make it by themselves."""
        return drive_torque(self.binding.layout, theta, m.u, np.concatenate([m.q, m.qd], 1))

    def pushed(self, m: SampledMotion, theta: np.ndarray) -> np.ndarray:
        """Force of the inputs [rows nq] at these numbers, beside what the drive makes of the motion
        alone.
        """
        return self.missing(theta, m) - self.missing(theta, replace(m, mix=0 * m.mix))

    def _taken(self, m: SampledMotion, theta: np.ndarray) -> np.ndarray:
        """What a motion takes [nq], accelerations and the rest apart: at a joint without a drive
        they add up to nothing.
        """
        still = replace(m, mix=0 * m.mix)
        whole, slow = (
            m.mean(self.forces.at(theta[None], x)[0])
            for x in (still, replace(still, qdd=0 * m.qdd))
        )
        return np.sqrt(np.mean((whole - slow) ** 2 + slow**2, axis=0))

    def laws(self, m: SampledMotion) -> np.ndarray:
        """Forces [rows nq laws] of `LAWS`, of unit size; those that brake or hold come negative."""
        first, *others = [_unit_force(kind, m.q, m.qd) for kind in LAWS]
        sizes = [first, *(-force for force in others)]
        scaled = [a / max(1e-300, float(np.sqrt(np.mean(a**2)))) for a in map(m.mean, sizes)]
        return np.stack(scaled, -1)

    def fit(
        self,
        m: SampledMotion,
        laws: bool = True,
        more: Callable[[np.ndarray], SampledMotion] | None = None,
        size: int = 0,
        hopeless: float = np.inf,
        begin: np.ndarray | None = None,
    ) -> ReadingFit:
        """Gauss-Newton between the bounds of all numbers, from those of `begin`, a fit without
        `more`. `more` gives the motion by `size` further numbers of the reading; what after three
        steps still leaves more than `hopeless` of the drive is given up.
        """
        free, train, norm = len(self.free), ~m.held, self.norm(m)
        weight = m.weight / norm
        columns: np.ndarray = np.zeros((*weight.shape, 0))
        if laws:
            columns = self._law_columns(m, weight, norm)
        if more is None and len(m.held) > 2 * FEW and not self.forces.linear:
            # Most of the steps at few rows.
            begin = self.fit(m.thinned(FEW), laws, hopeless=hopeless).x
        room = self._room(size, columns.shape[2])
        start = np.zeros(len(room.scale))
        start[:free] = self.binding.theta[self.free]
        if begin is not None:
            start = np.concatenate([begin[:free], np.zeros(size), begin[free:]])

        def at(x: np.ndarray) -> tuple[np.ndarray, SampledMotion]:
            theta = self.binding.theta.copy()
            theta[self.free] = x[:free]
            return theta, m if more is None else more(x[free : free + size])

        def by_drive(moved: SampledMotion) -> np.ndarray:
            """Weights over the drive of the motion as it would be: a smaller one leaves less."""
            return weight if more is None else moved.weight / self.norm(moved)

        def residual(x: np.ndarray) -> np.ndarray:
            own, moved = at(x)
            return self.missing(own, moved) * by_drive(moved) + columns @ x[free + size :]

        def slopes(x: np.ndarray, left: np.ndarray) -> np.ndarray:
            h = 1e-6 * room.scale * np.where(x + 1e-6 * room.scale <= room.upper, 1, -1)
            J = np.concatenate([np.zeros((*weight.shape, free + size)), columns], axis=-1)
            if free:
                own, moved = at(x)
                J[..., :free] = self.slopes(own, h[:free], moved) * by_drive(moved)[..., None]
            for i in range(free, free + size):
                J[..., i] = (residual(x + h[i] * (np.arange(x.size) == i)) - left) / h[i]
            return J

        limit = np.inf
        if self.binding.chain.direct:
            limit = hopeless**2 * max(1, np.count_nonzero(m.weight[train]))
        x, left, J = descend(residual, slopes, start, room, train, limit)
        own, moved = at(x)
        measured = norm if more is None else self.norm(moved)
        share = left * (measured / self.norm(moved, own))
        return reading_fit(m, x, left, J, share)

    def _law_columns(self, m: SampledMotion, weight: np.ndarray, norm: np.ndarray) -> np.ndarray:
        """Columns of `LAWS` at each joint, [rows nq nq laws]: a number of a law acts on its own
        joint alone.
        """
        law = self.laws(m) * weight[..., None] * norm[None, :, None]
        count = len(LAWS)
        out = np.zeros((*weight.shape, self.nq * count))
        for j in range(self.nq):
            out[:, j, j * count : (j + 1) * count] = law[:, j]
        return out

    def _room(self, size: int, laws: int) -> Room:
        """Of the free numbers, then `size` ones of a reading, then those of `laws` columns, of
        which all but the first of each joint brake or hold.
        """
        low, high = self._bounds
        least = np.tile([-np.inf, 0, 0, 0, 0], self.nq)[:laws]
        theta, scale = self.binding.theta[self.free], self.binding.scale[self.free]
        return Room(
            lower=np.concatenate([low, np.full(size, -np.inf), least]),
            upper=np.concatenate([high, np.full(size + laws, np.inf)]),
            scale=np.concatenate([np.maximum(np.abs(theta), scale), np.ones(size + laws)]),
            limited=np.arange(len(low) + size + laws) < len(low) + size,
            reach=np.inf if self.forces.linear else REACH,
        )

    @cached_property
    def _stated(self) -> tuple[list[int], np.ndarray, np.ndarray]:
        """Places among the free numbers of those that a file or the dataset states, what it states,
        and the standard deviation of that by `[model] trust`.
        """
        known = trusting(self.binding).priors
        places = [k for k, i in enumerate(self.free) if i in known]
        told = np.array([known[self.free[k]] for k in places]).reshape(-1, 2)
        return places, told[:, 0], told[:, 1]

    def off_stated(self, fitted: ReadingFit) -> float:
        """How far a fit takes a number from what is stated of it, at most, in standard deviations
        of that.
        """
        places, mean, std = self._stated
        return float(np.max(np.abs(fitted.x[places] - mean) / std, initial=0.0))

    def apart(self, one: ReadingFit, other: ReadingFit) -> float:
        """The same between two fits."""
        places, _, std = self._stated
        return float(np.max(np.abs(one.x[places] - other.x[places]) / std, initial=0.0))

    def noise(self, fitted: ReadingFit, binding: Binding, m: SampledMotion) -> float:
        """What the sensors' noise alone leaves of a fit, as a share of the drive, at the samples of
        a motion.
        """
        return self._noise_at(fitted.x[: len(self.free)], binding, m)

    def least_noise(self, fitted: ReadingFit, binding: Binding, m: SampledMotion) -> float:
        """The same, or with the numbers that the fit started from where that is less: along a wrong
        reading numbers run away, and noise with them.
        """
        start = self.binding.theta[self.free]
        return float(np.fmin(self.noise(fitted, binding, m), self._noise_at(start, binding, m)))

    def _noise_at(self, numbers: np.ndarray, binding: Binding, m: SampledMotion) -> float:
        rng = np.random.default_rng(0)
        theta = binding.theta.copy()
        theta[self.free] = numbers
        norm = self.norm(m, theta)
        runs = binding.dataset.seen
        noisy = _noise_motion(binding, runs, rng, m)
        moved = replace(m, q=m.q + noisy[0], qd=m.qd + noisy[1], qdd=m.qdd + noisy[2])
        # Signs of slow velocities flip: no more than any reading would show, so only smooth parts
        # are compared.
        change = (self.missing(theta, moved) - self.missing(theta, m)) * m.weight / norm
        with np.errstate(over="ignore"):  # a fit that has run away
            return float(np.sqrt(np.mean(change**2)))

    def spread(self, fitted: ReadingFit, m: SampledMotion, at: int) -> tuple[float, float]:
        """A number's change from the fit, and its standard deviation: by leaving parts of the
        recording out, since what a model lacks is no noise.
        """
        J = fitted.slopes.reshape(-1, fitted.slopes.shape[-1])
        r = fitted.residual.ravel()
        block = np.repeat(m.block, self.nq)
        size = np.sqrt(np.mean(J**2, axis=0)) + 1e-300
        others = [i for i in range(J.shape[1]) if i != at]
        U, s, _ = np.linalg.svd(J[:, others] / size[others], full_matrices=False)
        U = U[:, s > 1e-6 * s[0]]
        c = J[:, at] - U @ (U.T @ J[:, at])
        total = float(c @ c)
        if total < 1e-8 * float(J[:, at] @ J[:, at]) or total == 0:
            return 0.0, np.inf
        names = np.unique(block)
        parts = np.array(
            [(c[block == n] @ r[block == n], c[block == n] @ c[block == n]) for n in names]
        )
        whole = -parts[:, 0].sum() / total
        rest = [
            -(parts[:, 0].sum() - a) / (total - d) for a, d in parts if total - d > 1e-3 * total
        ]
        n = len(rest)
        return whole, (
            float(np.sqrt((n - 1) / n * np.sum((np.array(rest) - np.mean(rest)) ** 2)))
            if n > 2
            else np.inf
        )


def reading_fit(
    m: SampledMotion, x: np.ndarray, residual: np.ndarray, slopes: np.ndarray, share: np.ndarray
) -> ReadingFit:
    """A fit of numbers x with what is left as a share of the drive, `share` [rows nq]."""
    left = held = _rms(share, m.weight, ~m.held)
    if m.held.any():
        held = _rms(share, m.weight, m.held)
    return ReadingFit(x, left, held, residual, slopes)


def _rms(left: np.ndarray, weight: np.ndarray, rows: np.ndarray) -> float:
    """Root mean square of what is left [rows nq] of some rows, of those joints that count there."""
    return float(np.sqrt(np.sum(left[rows] ** 2) / max(1, np.count_nonzero(weight[rows]))))


def _unit_force(kind: type[JointEffect], q: Any, qd: Any) -> np.ndarray:
    """Force of a law of one number, where that is 1, along positions and speeds [... nq]."""
    (number,) = specs(kind)
    effect: Any = with_fields(neutral(kind), {number: np.float64(1.0)})
    nothing: Any = None
    s = Signals(t=nothing, q=q, qd=qd, load=nothing, h=nothing, command=nothing, qd0=nothing)
    with float64():
        force, backwards, forwards, _ = effect(s, effect.start(q))
        dry = np.where(qd > 0, forwards, np.where(qd < 0, -backwards, 0.0))
        return np.asarray(force + dry)


def _noise_motion(
    binding: Binding, runs: Sequence[Any], rng: Any, m: SampledMotion
) -> list[np.ndarray]:
    """Position, velocity and acceleration [samples nq] of white noise as the sensors', through the
    filters of the motion: the same over a row.
    """
    chain = binding.chain
    _, iy = columns(binding.dataset, chain)
    e = max(runs, key=len)
    t = e.t[: max(200, min(len(e), 4 * len(m.held)))]
    sigma = np.asarray(binding.readings)
    cutoff = max(cutoffs(chain, t, e.motion()[: len(t), iy], sigma))
    white = joint_motion(
        chain, t, sigma * rng.standard_normal((len(t), len(iy))), [cutoff] * chain.nq
    )[:3]
    pick = np.repeat(np.linspace(0, len(t) - 1, len(m.held)).astype(int), m.each)
    return [a[pick] for a in white]
