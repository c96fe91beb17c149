"""One recording under goals: rows of the free run to first order, and effects as columns of it."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import fields, replace
from itertools import chain
from typing import Any

import numpy as np

from jaxid.data.dataset import Experiment
from jaxid.diagnosis.goals.bodies import body_units, shifts_body
from jaxid.diagnosis.goals.loop import FINE, LoopRun, mean_input, RawRun, refined
from jaxid.diagnosis.goals.plant import Drive, LedPlant
from jaxid.diagnosis.goals.probes import at_levels, is_level, LEVELS, probes_of, scaled
from jaxid.diagnosis.torque.algebra import gram, Solution, solve, weighted, Weights
from jaxid.diagnosis.torque.library import Unit, units
from jaxid.diagnosis.torque.rows import read_runs, TorqueRun, turning_speeds
from jaxid.diagnosis.torque.study import SHARPER, STEPS, TorqueRows, TorqueStudy
from jaxid.dynamics.effect import Effect, InputEffect, OutputEffect
from jaxid.dynamics.joint_readings import joint_readings
from jaxid.dynamics.parameter import specs
from jaxid.numerics.pool import Pool
from jaxid.problem.binding import Binding
from jaxid.simulation.sample_buffers import columns


#: A shift of readings over which gravity's derivative is taken: what an encoder that is off does.
OFF = 1e-4
#: Damping of the descent to the nominal model (Marquardt's, a share of each number's own
#: curvature): at first, by how much less and more it is after a step that led down and one that did
#: not, and where it ends.
FIRST, EASIER, HARDER, LAST = 1e-2, 5.0, 4.0, 1e3
#: A step that gains less of the logarithm of the likelihood is the last one.
ENOUGH = 0.1

_EFFECTS = Pool("effects")


class LedStudy(TorqueStudy):
    """A study whose rows are positions of the free run, rad or m."""

    plant: LedPlant  # pyright: ignore

    def __init__(
        self,
        binding: Binding,
        kinds: Iterable[type[Effect]],
        cutoff_hz: float | None = None,
        begin: np.ndarray | None = None,
        standing: Container[tuple[str, str]] = (),
    ):
        """`begin`: numbers that the re-tuning begins with, those of the binding by default.
        `standing`: effects at places that the model has; at other places they are asked.
        """
        self.standing = standing
        self.begin = binding.theta if begin is None else begin
        #: By run, what was worked out of it last and at which numbers: its free run to first order,
        #: and its rows.
        self._taken: dict[str, tuple[bytes, TorqueRun, np.ndarray, TorqueRun]] = {}
        self._made: dict[str, tuple[bytes, np.ndarray, np.ndarray]] = {}
        super().__init__(binding, kinds, cutoff_hz, None, False)

    def weights(self, rows: TorqueRows) -> Weights:
        """Weights by what the re-tuned model leaves."""
        white = self._weights(rows, np.zeros(0, int), np.zeros(0))
        return self._weights(rows, *self.solved(rows, white))

    def weights_of(self, rows: TorqueRows, solution: Solution) -> Weights:
        """Weights by what a set of effects leaves."""
        return self._weights(rows, solution.at, solution.theta)

    def solved(self, rows: TorqueRows, white: Weights) -> tuple[np.ndarray, np.ndarray]:
        """Columns of the re-tuned model, with clocks that agree, and their numbers."""
        s = self._solution(
            rows, white, np.arange(self.size - self.binding.chain.nq), self.of("fit")
        )
        return s.at, s.theta

    # ---- what was measured

    def _read(self, cutoff_hz: float | None) -> list[TorqueRun]:
        b = self.binding
        iu, _ = columns(b.dataset, b.chain)
        every = np.array(
            [b.dataset.inputs[i].hold == "linear" for i in range(len(b.dataset.inputs))], bool
        )
        self.linear = every[iu]
        times = _times(b)
        self.sampling = float(
            np.median(np.concatenate([np.diff(e.t) for e in b.dataset.experiments]))
        )
        # A part of a recording is smoothed with what went before it, and the loop has settled when
        # it begins.
        known = [_settled(e) for e in b.dataset.experiments]
        fine = replace(b.dataset, experiments=tuple(refined(e.whole, times, every) for e in known))
        begins = {e.name: times * (0 if e.past is None else len(e.past.t)) for e in known}
        runs = read_runs(replace(b, dataset=fine), cutoff_hz)
        self.other = [mean_input(r.u, ~self.linear) for r in runs]
        return [_led(r, begins[r.experiment.name], self.linear) for r in runs]

    def _plant(self) -> LedPlant:
        return LedPlant(self.binding, turning_speeds(self.runs))

    def _begin(self) -> np.ndarray:
        return self.begin.copy()

    def _nominal(self) -> np.ndarray:
        """On the fit runs alone; where that is known already (`begin`), as it is."""
        if self.begin is not self.binding.theta:
            self.linearise(self.begin)
            return self.begin.copy()
        return self.tuned(self.begin.copy())

    def tuned(self, theta: np.ndarray) -> np.ndarray:
        """The nominal model's numbers, from where they are."""
        every = self.runs
        self.runs = [r for r in every if r.split == "fit"]
        self.theta = self._descended(theta)
        self.runs = every
        self.linearise(self.theta)
        return self.theta

    def _descended(self, theta: np.ndarray) -> np.ndarray:
        """Levenberg and Marquardt: delay, damping and inertia stand in for each other, and first
        order jumps between them. Every joint counts by what is left of it, which is the likelihood
        with its size unknown.
        """
        rows = self.made(theta, [])
        white = self._weights(rows, np.zeros(0, int), np.zeros(0))
        white = self._weights(rows, *self._solved(rows, white))
        here = self._judged(theta, white.memory)
        damping = FIRST
        for _ in range(STEPS):
            loss, theta, white = here
            trial = self._moved(theta, *self._damped(rows, white, damping))
            self.linearise(trial)
            there = self._judged(trial, white.memory)
            if there[0] < loss:
                here, damping = there, damping / EASIER
                if loss - there[0] < ENOUGH:
                    break
                rows = self._columns(trial, [])
            elif (damping := damping * HARDER) > LAST:
                break
        return here[1]

    def _judged(self, theta: np.ndarray, memory: np.ndarray) -> tuple[float, np.ndarray, Weights]:
        """Minus the logarithm of the likelihood of the numbers at which the free runs were taken,
        these, and weights.
        """
        left = np.concatenate([self.runs[k].sampled(self.apart[k]) for k in self.of("fit")])  # type: ignore[attr-defined]
        size = np.maximum(np.sqrt(np.mean(left**2, 0)), 1e-12)
        loss = float(np.sum(len(left) / memory * np.log(size)))
        for i in self.plant.free:
            if i in self.binding.priors:
                mean, std = self.binding.priors[i]
                loss += ((theta[i] - mean) / std) ** 2 / 2
        return loss, theta, Weights(size, memory)

    def _damped(
        self, rows: TorqueRows, white: Weights, damping: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Columns and their numbers, those of the model pulled to where they are by a share of what
        the data say of each.
        """
        size, p = rows.rows[0].shape[2] - 1, self.plant.size
        g = gram(*self.some(rows, self.of("fit")), white, 1).total
        known, pull = self.known(size, rows.theta), damping * np.diag(g)[:p]
        told = np.diag(known.information)[:p]
        mean = (told * known.mean[:p] + pull * rows.theta[self.plant.free]) / np.maximum(
            told + pull, 1e-300
        )
        known.information[np.arange(p), np.arange(p)] += pull
        known.mean[:p] = np.where(told + pull > 0, mean, known.mean[:p])
        start, low, high = self.bounds(rows)
        s = solve(g, np.arange(size), known, start, low, high)
        return s.at, s.theta

    # ---- rows

    def linearise(self, theta: np.ndarray) -> None:
        """Takes the free runs to first order at the numbers theta. What numbers and effects change
        is read along these free runs, not along the measured motion: noise is not in it, and
        nothing is gained by making all forces small.
        """
        now = theta.tobytes()
        for r in self.runs:
            if r.experiment.name not in self._taken or self._taken[r.experiment.name][0] != now:
                loop, force = self.plant.loop(r, theta)
                run: Any = replace(r, loop=loop)  # type: ignore[call-arg]
                apart = run.free_run(force)
                self._taken[r.experiment.name] = now, run, apart, _moved(run, apart)
        every = [self._taken[r.experiment.name] for r in self.runs]
        self.runs, self.apart, self.free = (
            [e[1] for e in every],
            [e[2] for e in every],
            [e[3] for e in every],
        )

    def made(self, theta: np.ndarray, found: list[Unit]) -> TorqueRows:
        if not found:  # else they were made for this free run
            self.linearise(theta)
        return self._columns(theta, found)

    def _columns(self, theta: np.ndarray, found: list[Unit]) -> TorqueRows:
        """Rows of the free runs as they were taken at theta."""
        rows = []
        for k in range(len(self.runs)):
            made, target = self._own_rows(k, theta)
            rows.append(
                np.concatenate([made, *(u.columns[k] for u in found), target[:, :, None]], 2)
            )
        return TorqueRows(theta, found, rows)

    def _own_rows(self, k: int, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns and target of a run without effects."""
        run: Any = self.runs[k]
        free, now, name = self.free[k], theta.tobytes(), run.experiment.name
        if name not in self._made or self._made[name][0] != now:
            own = np.concatenate(
                [
                    self.plant.columns(free, theta),
                    self._turning_columns(free),
                    self._late(free, theta),
                ],
                2,
            )
            made = run.rows(own)
            target = (
                run.sampled(self.apart[k]) + made[:, :, : self.plant.size] @ theta[self.plant.free]
            )
            self._made[name] = now, made, target
        return self._made[name][1:]

    def _unasked(self, run: TorqueRun) -> np.ndarray:
        return np.zeros(
            (0, run.q.shape[1], 3 * run.q.shape[1])
        )  # made anew along every free run: see `made`

    def free_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The clocks of a goal and of its reading agree to within half a sample: what so much delay
        does says nothing.
        """
        low, high = super().free_bounds()
        return (
            np.concatenate([low[: -self.binding.chain.nq], -high[-self.binding.chain.nq :]]),
            high,
        )

    def settle(self, theta: np.ndarray, found: Sequence[Any] = ()) -> None:
        """A joint that sticks stands still in the loop: its rows are known like all others."""
        self.unsure = [np.zeros((len(r.t), self.binding.chain.nq)) for r in self.runs]
        self.noise = self.measured

    def _late(self, run: TorqueRun, theta: np.ndarray) -> np.ndarray:
        """What a delay of each goal by one sample changes, [time n n]."""
        n, h = run.q.shape[1], run.step
        early, late = (
            self.plant.missing(replace(run, u=np.roll(run.u, k, 0)), theta) for k in (-1, 1)
        )
        made = ((early - late) / (2 * h) * self.sampling)[:, :, None] * np.eye(n)
        made[:2] = made[-2:] = 0.0
        return made

    def _turning_columns(self, run: TorqueRun) -> np.ndarray:
        turn = self.plant.turn
        apart = [
            np.tanh(run.qd / (turn * wide)) - np.tanh(run.qd / turn)
            for wide in (1 / SHARPER, SHARPER)
        ]
        return np.concatenate([x[:, :, None] * np.eye(x.shape[1]) for x in apart], 2)

    def rows_with_effects(
        self, theta: np.ndarray, chosen: bool = False
    ) -> tuple[TorqueRows, Weights]:
        """Rows with every unit, and the weights that the re-tuned model leaves: a free run with
        every law at once is no model.
        """
        self.linearise(theta)
        rows = self.made(theta, self.asked(self.kinds, theta))
        left = [
            rows.residual(k, np.arange(self.plant.size), theta[self.plant.free])
            for k in self.of("fit")
        ]
        which = [self.runs[k] for k in self.of("fit")]
        return rows, weighted(
            left,
            [r.moves for r in which],
            [np.zeros((len(r.t), self.binding.chain.nq)) for r in which],
        )

    def asked(self, kinds: Sequence[type[Effect]], theta: np.ndarray) -> list[Unit]:
        """The units of these effects; programs of several are compiled side by side."""
        raw = [RawRun(**{f.name: getattr(r, f.name) for f in fields(TorqueRun)}) for r in self.free]
        found = _EFFECTS.map(lambda kind: self._as_rows(self._lacking(kind, raw, theta)), kinds)
        return list(chain.from_iterable(found))

    def _lacking(
        self, kind: type[Effect], raw: Sequence[TorqueRun], theta: np.ndarray
    ) -> list[Unit]:
        """The units of an effect where the model does not have it."""
        every = self._of_kind(kind, raw, theta)
        return [u for u in every if u.owner not in self.standing]

    def _of_kind(
        self, kind: type[Effect], raw: Sequence[TorqueRun], theta: np.ndarray
    ) -> list[Unit]:
        if issubclass(kind, InputEffect):
            return self._driven(kind, theta)
        if issubclass(kind, OutputEffect):
            return self._off(kind, theta)
        if shifts_body(kind):
            return body_units(self.binding, self.free, kind, theta)
        return units(self.plant, [kind], raw, theta, False)

    def _as_rows(self, found: Sequence[Unit]) -> list[Unit]:
        """Units of forces at all samples as those of rows."""
        if not found:
            return []
        ends = np.cumsum([len(u.fields) for u in found])[:-1]
        parts = [
            np.split(r.rows(np.concatenate([u.columns[k] for u in found], 2)), ends, axis=2)
            for k, r in enumerate(self.runs)
        ]
        return [replace(u, columns=[p[i] for p in parts]) for i, u in enumerate(found)]

    def _driven(self, kind: type[Effect], theta: np.ndarray) -> list[Unit]:
        """What an effect on the way from the goal to the torque changes, at each of its probes: one
        unit for each.
        """
        b, n = self.binding, self.binding.chain.nq
        drive = Drive(self.plant, [kind])
        base = drive.theta(theta)
        before = [drive.torque(r, o, base) for r, o in zip(self.free, self.other, strict=True)]
        places = b.chain.places(kind)[:n]
        levels = (
            np.max([np.quantile(np.abs(x), LEVELS, axis=0) for x in before], 0)
            if is_level(kind)
            else None
        )
        probes = [
            probes_of(b, kind, j) if levels is None else at_levels(kind, levels[:, j])
            for j in range(len(places))
        ]
        out = []
        for k in range(max(map(len, probes), default=0)):  # a drive is its own joint's: all at once
            at = base.copy()
            for place, own in zip(places, probes, strict=True):
                for i in drive.layout.of_effect(kind.name, place) if k < len(own) else ():
                    at[i] = own[k].get(drive.layout.entries[i].field, at[i])
            change = [
                drive.torque(r, o, at) - x
                for r, o, x in zip(self.free, self.other, before, strict=True)
            ]
            for j, (place, own) in enumerate(zip(places, probes, strict=True)):
                if k < len(own) and any(np.any(c[:, j]) for c in change):
                    out.append(
                        scaled(
                            kind,
                            place,
                            own[k],
                            j,
                            [-(c * np.eye(n)[j])[:, :, None] for c in change],
                        )
                    )
        return out

    def _off(self, kind: type[OutputEffect], theta: np.ndarray) -> list[Unit]:
        """An encoder that is off within the loop: the law sees what it reads, gravity acts where
        the joint is.
        """
        b, n = self.binding, self.binding.chain.nq
        out = []
        for j, place in enumerate(b.chain.signature.joints):
            step = OFF * np.eye(n)[j]
            made = []
            for r in self.free:
                low, high = (
                    self.plant.rigid(replace(r, q=r.q + s * step), theta) for s in (-0.5, 0.5)
                )
                made.append(-((high - low) / OFF)[:, :, None])
            inf = np.full(1, np.inf)
            out.append(
                Unit(
                    effect=kind.name,
                    location=place,
                    fields=tuple(specs(kind)),
                    least=-inf,
                    most=inf,
                    spread=inf,
                    shape={},
                    joints=(j,),
                    columns=made,
                )
            )
        return out

    # ---- noise

    def _noise(self) -> np.ndarray:
        """That of the readings, as far as it passes the filter."""
        b, run = self.binding, self._longest()
        sigma = np.array(
            [b.sigma[r.q] if r.q is not None else 0.0 for r in joint_readings(b.chain)]
        )
        rate = min((len(e.t) - 1) / e.duration for e in b.dataset.experiments)
        return np.maximum(sigma * np.sqrt(min(1.0, 2 * run.cutoff_hz / rate)), 1e-12)


def _settled(e: Experiment) -> Experiment:
    """A run with no more of its past than it is long itself: in that the loop forgets how it
    began.
    """
    if e.past is None or len(e.past.t) <= len(e.t):
        return e
    return replace(
        e,
        past=e.past.piece(
            len(e.past.t) - len(e.t), len(e.past.t), name=e.past.name, split=e.past.split
        ),
    )


def _moved(run: TorqueRun, x: np.ndarray) -> TorqueRun:
    """A run whose motion is moved by x [time n]."""
    speed = np.gradient(x, run.step, axis=0)
    return replace(
        run, q=run.q + x, qd=run.qd + speed, qdd=run.qdd + np.gradient(speed, run.step, axis=0)
    )


def _led(r: TorqueRun, begins: int, linear: np.ndarray) -> LoopRun:
    """A run whose rows are those of the free run from sample `begins` on."""
    own = {f.name: getattr(r, f.name) for f in fields(TorqueRun)}
    kept = slice(max(r.kept.start, begins), r.kept.stop, r.kept.step)
    return LoopRun(**own | {"u": mean_input(r.u, linear), "kept": kept})


def _times(b: Binding) -> int:
    """By how much the recording is refined."""
    step = float(np.median(np.concatenate([np.diff(e.t) for e in b.dataset.experiments])))
    return int(np.clip(np.ceil(step / loop_step(b)), 1, 8))


def loop_step(b: Binding) -> float:
    """Steps in seconds that follow the loop through its quickest radian."""
    tree = b.chain.mechanism.tree.tree  # type: ignore[attr-defined]
    law = b.chain.mechanism.drive_law  # type: ignore[attr-defined]
    own = [tree.joints.index(j) for j in tree.leading]
    carried = np.maximum((tree.swung() + tree.armature)[own], 1e-9)
    kp = np.abs(
        np.array(law.kp) * np.array(law.gain) * (np.array(law.kd) if law.kind == "cascade" else 1.0)
    )
    return float(FINE / np.sqrt(max(np.max(kp / carried), 1e-12)))
