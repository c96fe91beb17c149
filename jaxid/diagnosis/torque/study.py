"""One recording by torque: rows, weights, noise, and the models that were chosen on them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.signals import zero_phase
from jaxid.diagnosis.torque.algebra import (
    BLOCKS,
    ColumnPrior,
    Departure,
    departure,
    gram,
    Solution,
    solve,
    weighted,
    Weights,
)
from jaxid.diagnosis.torque.choose import Chooser
from jaxid.diagnosis.torque.library import Unit, units
from jaxid.diagnosis.torque.plant import Beside, Plant, plant_of
from jaxid.diagnosis.torque.repeats import spread_between
from jaxid.diagnosis.torque.rows import read_runs, TorqueRun, turning_speeds
from jaxid.diagnosis.torque.waves import rests_of, wave_number, wave_units
from jaxid.dynamics.effect import Effect, JointEffect, neutral
from jaxid.dynamics.joint_readings import joint_motion, stated_positions
from jaxid.dynamics.parameter import specs
from jaxid.fitting.problem_builder import ProblemBuilder, start_values
from jaxid.fitting.scale_free import EXACT, no_scale
from jaxid.force.effects import force, Load, with_numbers
from jaxid.problem.binding import Binding
from jaxid.simulation.sample_buffers import columns


#: Steps of Gauss and Newton where a model is not linear in its numbers, and the change of the loss
#: at which they end.
STEPS, SETTLED = 12, 1e-6
#: Dry friction may turn about within so much less speed than it is taken to.
SHARPER = 4.0
#: By so much of a step a torque that is held from one sample to the next comes later than one that
#: is not.
HELD = 0.5
#: Samples of which the noise of the rows is made, and most in which waves are looked for.
SAMPLES, WAVE_SAMPLES = 4000, 20_000


@dataclass(frozen=True, eq=False)
class TorqueRows:
    """The rows of every run for one linearisation: nominal columns, then those of the units, then
    the target.
    """

    theta: np.ndarray  # of the whole layout, where the model was linearised
    units: list[Unit]
    rows: list[np.ndarray]  # per run [samples n p + 1]

    @property
    def size(self) -> int:
        return self.rows[0].shape[2] - 1 - sum(len(u.fields) for u in self.units)

    def beside(self, more: Sequence[Unit]) -> TorqueRows:
        """With the columns of further units."""
        every = []
        for k, x in enumerate(self.rows):
            columns = [u.columns[k] for u in more]
            every.append(np.concatenate([x[:, :, :-1], *columns, x[:, :, -1:]], axis=2))
        return TorqueRows(self.theta, [*self.units, *more], every)

    def residual(self, run: int, at: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """What the columns `at` with these numbers leave of a run, [samples n]."""
        x = self.rows[run]
        return x[:, :, -1] - x[:, :, at] @ numbers


class TorqueStudy:
    """Rows of a binding's recordings and everything that does not depend on which effects are
    chosen.
    """

    def __init__(
        self,
        binding: Binding,
        kinds: Iterable[type[Effect]],
        cutoff_hz: float | None,
        known: ColumnPrior | None,
        payloads: bool,
    ):
        self.binding, self.kinds = binding, list(kinds)
        self.runs: list[TorqueRun] = self._read(cutoff_hz)
        self.plant: Plant = self._plant()
        self.given, self.payloads = known, payloads
        self.unasked = [self._unasked(r) for r in self.runs]
        self._plain: tuple[TorqueRows, Weights, Solution] | None = None
        self.noise = np.ones(binding.chain.nq)
        self.unsure = [np.zeros((len(r.t), binding.chain.nq)) for r in self.runs]
        self.between: list[
            np.ndarray
        ] = []  # what repeats differ by at the rows of each run, where effects are asked for
        self.beside = [Beside(0 * r.q, np.zeros(binding.chain.nq)) for r in self.runs]
        self.theta = self._nominal()
        self.measured = np.hypot(self._noise(), self._asked_for())
        self.settle(self.theta)

    def _read(self, cutoff_hz: float | None) -> list[TorqueRun]:
        return read_runs(self.binding, cutoff_hz)

    def _plant(self) -> Plant:
        return plant_of(self.binding, turning_speeds(self.runs))

    def _begin(self) -> np.ndarray:
        """Numbers at which a model that is not linear in them is linearised first."""
        return start_values(ProblemBuilder(self.binding), self.plant.free, 0)[0]

    def asked(self, kinds: Sequence[type[Effect]], theta: np.ndarray) -> list[Unit]:
        """All units of these effects, along what the model takes with the numbers theta."""
        return units(self.plant, kinds, self.runs, theta, self.payloads, self.beside)

    def _unasked(self, run: TorqueRun) -> np.ndarray:
        """Columns of which nothing is asked [samples n 3n]: how else dry friction may turn about
        with a joint's motion, and that a torque may be held from one sample to the next or not, in
        steps of it. What would pass for them says nothing.
        """
        n, turn = run.q.shape[1], self.plant.turn
        apart = [
            np.tanh(run.qd / (turn * wide)) - np.tanh(run.qd / turn)
            for wide in (1 / SHARPER, SHARPER)
        ]
        late = np.gradient(self.plant.drive(run, self.binding.theta), axis=0)
        rows = [run.rows(x) for x in (*apart, late)]
        return np.concatenate([x[:, :, None] * np.eye(n) for x in rows], 2)

    @property
    def size(self) -> int:
        """Columns that come before those of effects."""
        return self.plant.size + 3 * self.binding.chain.nq

    def free_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the columns of which nothing is asked: a held torque is half a step late."""
        n = self.binding.chain.nq
        free = np.full(2 * n, np.inf)
        return np.concatenate([-free, np.zeros(n)]), np.concatenate([free, np.full(n, HELD)])

    # ---- the nominal model

    def of(self, *splits: str) -> list[int]:
        """Which runs belong to some splits."""
        return [k for k, r in enumerate(self.runs) if r.split in splits]

    @property
    def lower(self) -> np.ndarray:
        return self.binding.lower[self.plant.free]

    @property
    def upper(self) -> np.ndarray:
        return self.binding.upper[self.plant.free]

    def known(self, size: int, theta: np.ndarray, found: Sequence[Unit] = ()) -> ColumnPrior:
        """What is known of all columns beforehand: stated priors, and how large effects may be. A
        reference counts where models are compared; weights are those of numbers that are free to
        take in what differs.
        """
        p = self.plant.size
        information, mean = np.zeros((size, size)), np.zeros(size)
        mean[:p] = theta[self.plant.free]
        for i, (m, std) in self.binding.priors.items():
            if i in self.plant.free:
                k = self.plant.free.index(i)
                information[k, k], mean[k] = std**-2, m
        n = self.binding.chain.nq
        spread = np.concatenate(
            [np.full(2 * n, np.inf), np.full(n, HELD), *(u.spread for u in found)]
        )
        diagonal = np.arange(p, size)
        information[diagonal, diagonal] = np.where(np.isfinite(spread), spread, np.inf) ** -2.0
        return ColumnPrior(information, mean)

    def made(self, theta: np.ndarray, found: list[Unit]) -> TorqueRows:
        """Rows with the model linearised at theta."""
        rows = []
        for k, run in enumerate(self.runs):
            target, own = self.plant.linearised(run, theta)
            both = run.rows(np.concatenate([own, target[:, :, None]], 2))
            rows.append(
                np.concatenate(
                    [
                        both[:, :, :-1],
                        self.unasked[k],
                        *(u.columns[k] for u in found),
                        both[:, :, -1:],
                    ],
                    2,
                )
            )
        return TorqueRows(theta, found, rows)

    def _nominal(self) -> np.ndarray:
        """The nominal model fitted to the fit runs, each joint weighted by what is left of it."""
        theta, weights = self.binding.theta.copy(), None
        if not self.plant.exact():
            theta = self._begin()
        best, end = np.inf, theta
        for step in range(1 if self.plant.exact() else STEPS):
            rows = self.made(theta, [])
            if weights is None:
                self._refuse_scale_free(rows)
                weights = self._weights(rows, np.zeros(0, int), np.zeros(0))
                weights = self._weights(rows, *self._solved(rows, weights))
            own = np.arange(self.plant.size)
            loss = gram(*self.some(rows, self.of("fit")), weights, 1).losses(
                own, theta[self.plant.free]
            )[0]
            if not loss < best * (1 - SETTLED) and step:
                if loss <= best or np.allclose(theta, end, rtol=1e-9):
                    break
                theta = (theta + end) / 2  # too far
                continue
            best, end = min(best, loss), theta
            theta = self._moved(theta, *self._solved(rows, weights))
        return theta if self.plant.exact() else end

    def _refuse_scale_free(self, rows: TorqueRows) -> None:
        """Raises `UsageError` where zero numbers meet every torque, as of a machine that coasts,
        and nothing is known of any number: only their ratios are told.
        """
        free = self.plant.free
        if self.given is not None or not free or any(i in self.binding.priors for i in free):
            return
        numbers = rows.theta[free]
        target = max(float(np.abs(x[:, :, -1]).max()) for x in rows.rows)
        load = max(float(np.abs(x[:, :, : len(free)] @ numbers).max()) for x in rows.rows)
        if target <= EXACT * load:
            raise UsageError(no_scale([self.binding.layout.names[i] for i in free]))

    def _moved(self, theta: np.ndarray, at: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        out = theta.copy()
        out[self.plant.free] = np.clip(numbers[: self.plant.size], self.lower, self.upper)
        return out

    def some(
        self, rows: TorqueRows, which: Sequence[int]
    ) -> tuple[list[TorqueRun], list[np.ndarray], list[np.ndarray]]:
        """Some runs, their rows, and to within what these are known."""
        return (
            [self.runs[k] for k in which],
            [rows.rows[k] for k in which],
            [self.unsure[k] for k in which],
        )

    def _solved(
        self, rows: TorqueRows, weights: Weights, which: Sequence[int] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        at = np.arange(rows.rows[0].shape[2] - 1)
        s = self._solution(rows, weights, at, self.of("fit") if which is None else which)
        return s.at, s.theta

    def _solution(
        self, rows: TorqueRows, weights: Weights, at: np.ndarray, which: Sequence[int]
    ) -> Solution:
        size = rows.rows[0].shape[2] - 1
        g = gram(*self.some(rows, which), weights, 1).total
        start, low, high = self.bounds(rows)
        return solve(g, at, self.known(size, rows.theta, rows.units), start, low, high)

    def bounds(self, rows: TorqueRows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Start, lower and upper bound of every column."""
        below, above = self.free_bounds()
        low = np.concatenate([self.lower, below, *(u.least for u in rows.units)])
        high = np.concatenate([self.upper, above, *(u.most for u in rows.units)])
        start = np.zeros(len(low))
        start[: self.plant.size] = rows.theta[self.plant.free]
        return start, low, high

    def _weights(self, rows: TorqueRows, at: np.ndarray, numbers: np.ndarray) -> Weights:
        which = self.of("fit")
        left = [rows.residual(k, at, numbers) for k in which]
        return weighted(left, [self.runs[k].moves for k in which], [self.unsure[k] for k in which])

    # ---- effects

    def rows_with_effects(
        self, theta: np.ndarray, chosen: bool = False
    ) -> tuple[TorqueRows, Weights]:
        """Rows with every unit, and the weights that the richest model of the fit runs leaves. Its
        numbers also tell the torques that effects depend on; `chosen`: theta is that of a model
        with effects and tells them better.
        """
        if self._plain is None or not self.plant.exact():
            self._plain = self._without_torque(theta)
        rows, weights, s = self._plain
        self.between = [
            np.linalg.norm(x[:, :, : len(weights.spread)] @ weights.spread, axis=2)
            for x in rows.rows
        ]
        if loaded := [k for k in self.kinds if k.by_torque]:
            at = theta if chosen else self._moved(theta, s.at, s.theta)
            rows = replace(rows.beside(self.asked(loaded, at)), theta=theta)
        return rows, weights

    def _waves(self, rows: TorqueRows, weights: Weights) -> list[Unit]:
        """Laws that repeat with position, at the wave numbers that the fit runs show."""
        which = self._first(self.of("fit"))
        if not any(map(wave_number, self.kinds)) or not which:
            return []
        runs, own, unsure = self.some(rows, which)
        rests = rests_of(own, weights, [run.moves for run in runs], unsure, rows.size)
        return wave_units(self.plant, self.kinds, self.runs, which, rests)

    def _first(self, which: Sequence[int]) -> list[int]:
        """The first of some runs, whose samples are enough to look for a wave."""
        ends = np.cumsum([len(self.runs[k].q) for k in which])
        return [k for k, end in zip(which, ends, strict=True) if end <= WAVE_SAMPLES] or [
            *which[:1]
        ]

    def _without_torque(self, theta: np.ndarray) -> tuple[TorqueRows, Weights, Solution]:
        """Rows with the units that depend on the motion alone, weights, and the richest model."""
        plain = [k for k in self.kinds if not k.by_torque]
        rows = self.made(theta, self.asked(plain, theta))
        rich = self._rich(rows)
        weights = self._weights(rows, rich, np.zeros(len(rich)))
        for _ in range(2):
            s = self._solution(rows, weights, rich, self.of("fit"))
            weights = self._weights(rows, s.at, s.theta)
        s = self._solution(rows, weights, rich, self.of("fit"))
        spread = spread_between(self, rows, weights, s)
        more = self._waves(rows, weights)
        return rows.beside(more), replace(weights, spread=spread), s

    def _rich(self, rows: TorqueRows) -> np.ndarray:
        """Columns of the nominal model and of every law at every joint at one of its shapes."""
        shapes: dict[tuple[str, str], list[np.ndarray]] = {}
        ends = rows.size + np.cumsum([0, *(len(u.fields) for u in rows.units)])
        for u, a, b in zip(rows.units, ends, ends[1:], strict=False):
            if np.all(np.isinf(u.spread)):
                shapes.setdefault(u.place, []).append(np.arange(a, b))
        return np.concatenate([np.arange(rows.size), *(s[len(s) // 2] for s in shapes.values())])

    @cached_property
    def departs(self) -> Departure | None:
        """What the reference told of the bodies; friction may drift from recording to recording."""
        if self.given is None:
            return None
        entries = self.binding.layout.entries
        bodies = np.array([entries[i].owner < 0 for i in self.plant.free], bool)
        return departure(self.given, bodies)

    def chooser(
        self,
        rows: TorqueRows,
        weights: Weights,
        fit: Sequence[int],
        held: Sequence[int],
    ) -> Chooser:
        """Sets of effects by some runs, judged on others."""
        start, low, high = self.bounds(rows)
        told = self.known(rows.rows[0].shape[2] - 1, rows.theta, rows.units)
        if self.given is not None:
            p = self.plant.size
            told.information[:p, :p] += self.given.information
            told.mean[:p] = np.where(
                np.diag(self.given.information) > 0, self.given.mean, told.mean[:p]
            )

        def g(which):
            return gram(*self.some(rows, which), weights, BLOCKS)

        return Chooser(
            units=rows.units,
            size=rows.size,
            fit=g(fit),
            held=g(held),
            known=told,
            start=start,
            lower=low,
            upper=high,
            departs=self.departs,
        )

    # ---- noise

    def settle(self, theta: np.ndarray, found: Sequence[tuple[Unit, np.ndarray]] = ()) -> None:
        """Sets to within what rows are known, their noise, and the friction, that of the numbers
        theta and of units with theirs: a joint that stands still, or turns about, holds anything up
        to what is dry of it.
        """
        effects = [
            e for e in self.binding.layout.model(theta).effects if isinstance(e, JointEffect)
        ]
        laws = {k.name: k for k in self.kinds if issubclass(k, JointEffect)}
        rotor = self.beside[0].rotor.copy()
        for u, numbers in found:
            if u.effect not in laws:
                continue
            effects.append(self._with_its_numbers(laws[u.effect], u, numbers))
            if "rotor" in u.hidden and numbers[0] > 0:
                rotor[u.joints[0]] += numbers[u.fields.index("rotor")] / numbers[0]
        turn, transmits = self.plant.turn, any(k.transmits for k in laws.values())
        self.unsure, beside = [], []
        for r, b in zip(self.runs, self.beside, strict=True):
            load = self.plant.load(r, theta, b)
            self.unsure.append(r.rows(self._dry(effects, r, load) * r.still(turn)).clip(0))
            if transmits:
                forces = [force(e, r, load, turn) for e in effects]
                beside.append(Beside(sum(forces, 0 * r.q), rotor))
        self.beside = beside or self.beside
        fit = [self.unsure[k] for k in self.of("fit") or range(len(self.runs))]
        self.noise = np.hypot(self.measured, np.sqrt(np.mean(np.concatenate(fit) ** 2, axis=0)))

    def _with_its_numbers(
        self, kind: type[JointEffect], unit: Unit, numbers: np.ndarray
    ) -> JointEffect:
        """A law at the joint of a unit, with the unit's shape and numbers."""
        n = self.binding.chain.nq
        at = np.eye(n)[unit.joints[0]]
        own = {}
        for field, value in zip(unit.fields, numbers, strict=True):
            if field in specs(kind):
                own[field] = value * at
        return with_numbers(neutral(kind), {**unit.shape, **own}, n)

    def _dry(self, effects: Sequence[JointEffect], run: TorqueRun, load: Load) -> np.ndarray:
        """Dry friction [time n] at the speed nothing along a run."""
        creep = 1e-3 * self.plant.turn
        ways = [replace(run, qd=np.broadcast_to(way * creep, run.qd.shape)) for way in (1.0, -1.0)]
        forth, back = ways
        total = np.zeros_like(run.q)
        for e in effects:
            total += force(e, forth, load, 1e-3 * creep) - force(e, back, load, 1e-3 * creep)
        return np.abs(total) / 2

    def noise_of(self, run: int) -> np.ndarray:
        """Standard deviation of each row of a run that a perfect model would leave, N m [samples
        n].
        """
        return np.hypot(self.scatter_of(run), self.unsure[run])

    def scatter_of(self, run: int) -> np.ndarray:
        """The same without what dry friction may hold where a joint turns about."""
        between = self.between[run] if self.between else np.zeros_like(self.unsure[run])
        return np.hypot(self.measured, between)

    def typical(self, which: Sequence[int], joint: int) -> float:
        """The noise of a joint's rows in some runs as one number, N m: mean of 1 / variance, so
        that where a joint turns about, and little is known of its friction, counts little.
        """
        known = np.concatenate([self.noise_of(k)[:, joint] for k in which])
        return float(1 / np.sqrt(np.mean(1 / known**2)))

    def _longest(self) -> TorqueRun:
        return max(
            (self.runs[k] for k in self.of("fit") or range(len(self.runs))), key=lambda r: len(r.q)
        )

    def _asked_for(self) -> np.ndarray:
        """How near the torque of each joint has to be followed [n], N m: to nothing by default."""
        asked = self.binding.dataset.accuracy
        return np.array([asked.get(name, 0.0) for name, _ in self.binding.chain.torque_channels])

    def _noise(self) -> np.ndarray:
        """Standard deviation of the rows of each joint [n] that the noise of readings and torques
        makes of a perfect model.
        """
        rng, b = np.random.default_rng(0), self.binding
        run = self._longest()
        e = run.experiment
        part = slice(0, min(len(e.t), SAMPLES))
        cut = replace(
            e,
            t=e.t[part],
            u=e.u[part],
            y=e.y[part],
            auxiliary={},
            past=None,
            scatter=None,
            left_out=None,
        )
        _, iy = columns(b.dataset, b.chain)
        noisy = cut.y[:, iy] + b.readings * rng.standard_normal((len(cut.t), len(iy)))
        hz = [min(2 * run.cutoff_hz, 0.4 / run.step)] * b.chain.nq
        motion = [
            joint_motion(b.chain, cut.t, y, hz, stated_positions(e, b.chain.signature))[:3]
            for y in (cut.y[:, iy], noisy)
        ]
        here = [
            replace(run, experiment=cut, q=q, qd=qd, qdd=qdd, u=run.u[part])
            for q, qd, qdd in motion
        ]
        needed = [self.plant.rigid(r, self.theta) for r in here]
        drive = self.plant.drive(here[0], self.theta)
        white = 1.4826 * np.median(np.abs(np.diff(drive, 3, axis=0)), axis=0) / np.sqrt(20.0)
        shaken = needed[1] - needed[0] + white * rng.standard_normal(drive.shape)
        ends = run.kept.start
        left = zero_phase(cut.t, shaken, run.cutoff_hz)[ends : len(cut.t) - ends]
        span = np.percentile(np.abs(drive), 99, axis=0)
        return np.maximum(np.std(left, axis=0), np.maximum(1e-4 * span, 1e-12))
