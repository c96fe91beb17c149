"""Residuals: what a fit makes small. Each turns runs into records of one lane program, divided by
the noise, so that a mean square of 1.0 means "down to the noise".

- `OutputError`: the free run over the whole experiment against the measured outputs.
- `MultipleShooting`: the same over short windows, each with its own unknown start (an integrating joint drifts; after a
  minute a gap of metres says nothing).
- `InverseDynamics`: the torque that the measured motion lacks, drive(u) - (M qdd + bias + friction).
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, pairwise
from typing import ClassVar, Literal

import jax.numpy as jnp
import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.base.lazy import at
from jaxid.data.dataset import Dataset, Experiment
from jaxid.data.noise import edges, Window
from jaxid.dynamics.catalogue import RESIDUALS
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.joint_readings import joint_readings, position_matters, start_of, stated_start
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.force.torque_filter import decimated_torque_lane, evenly, torque_setting, TorqueSetting
from jaxid.numerics.precision import float64
from jaxid.problem import measured_motion
from jaxid.problem.beginnings import head_samples, nested_heads, run_up
from jaxid.problem.measured_motion import Motion
from jaxid.simulation import sample_buffers as recorded
from jaxid.simulation.batch import BatchSimulator
from jaxid.simulation.rollout import inverse_dynamics_rollout, Lane, simulate_rollout
from jaxid.simulation.sample_buffers import Record, Samples


#: What a residual's runs are.
Simulation = Literal[
    "free_run", "windows", "closed_loop", "inverse_dynamics", "momentum", "frequency_response"
]

#: Up to this many samples before a window tell the states of effects.
WINDOW_PAST = 1000


def _of_the_engine() -> np.ndarray:
    """Stands for the weights or targets of the engine's samples."""
    return np.empty((0, 0))


@dataclass(frozen=True)
class Runs:
    """Some experiments made ready for one residual: records on a compiled engine.

    `heads` are, per experiment, records of its first moments, longest first, from which a run that
    is not fitted estimates its start. `weights` and `targets` are of the samples in the engine's
    buffers, [samples columns]; `dataclasses.replace` gives the same runs with others. What has the
    weight 0 does not count.
    """

    experiments: tuple[Experiment, ...]
    layout: ParameterVector
    channels: tuple[tuple[str, str], ...]  # (name, unit) of the residual's columns
    noise: np.ndarray  # [columns]
    engine: BatchSimulator
    records: tuple[int, ...]
    heads: tuple[tuple[int, ...], ...]
    statement: str
    dataset: Dataset | None = (
        None  # where the residual was made from, and with which filter: for instruments
    )
    setting: TorqueSetting | None = None
    weights: np.ndarray = field(default_factory=_of_the_engine)
    targets: np.ndarray = field(default_factory=_of_the_engine)

    def __post_init__(self):
        if not self.weights.size:
            object.__setattr__(self, "weights", np.asarray(self.engine.samples.w))
        if not self.targets.size:
            object.__setattr__(self, "targets", np.asarray(self.engine.samples.y))

    @cached_property
    def samples(self) -> Samples:
        """The engine's buffers with the weights and targets of these runs."""
        with float64():
            return self.engine.samples._replace(
                w=jnp.asarray(self.weights), y=jnp.asarray(self.targets)
            )

    def record(self, number: int) -> Record:
        return self.engine.records[number]

    def before(self, k: int) -> np.ndarray:
        """Buffer positions of the samples before the k-th experiment by which its start is told,
        where it was cut from a longer one.
        """
        first = self.record(self.records[k]).samples[0]
        known = self.record(self.heads[k][0]).samples
        return known[known < first]

    def residual(self, number: int, prediction: np.ndarray) -> np.ndarray:
        """Weighted residual [samples columns] of one record from a lane's prediction [length
        columns].
        """
        at = self.record(number).samples
        return self.weights[at] * (self.sample_prediction(number, prediction) - self.targets[at])

    def sample_prediction(self, number: int, prediction: np.ndarray) -> np.ndarray:
        """Predictions at the samples of a record [samples columns]."""
        r = self.record(number)
        return prediction[r.samples - r.offset]


class Residual(abc.ABC):
    """Abstract: how experiments become records.

    `simulation` says what its runs are, and everything that fits, scores and diagnoses asks that
    alone; a residual of one's own that states it takes part like the others.
    """

    name: ClassVar[str]
    simulation: ClassVar[Simulation] = "free_run"

    @property
    def free_run(self) -> bool:
        """Whether one run from one start stands for the whole experiment."""
        return self.simulation == "free_run"

    @property
    def windows(self) -> bool:
        """Whether an experiment is many short runs, each with a start of its own."""
        return self.simulation == "windows"

    @property
    def torques(self) -> bool:
        """Whether forces or momenta along the measured motion are compared: nothing is simulated,
        no start is unknown.
        """
        return self.simulation in ("inverse_dynamics", "momentum")

    @property
    def momenta(self) -> bool:
        """Whether a momentum along the measured motion is compared, which no torque tells of."""
        return self.simulation == "momentum"

    @property
    def window(self) -> Window | None:
        """Length, s, of the windows of an experiment, where there are any."""
        return None

    def select(self, dataset: Dataset, split: str) -> tuple[Experiment, ...]:
        """The runs of a split, or of several ("fit+validation"), that it looks at."""
        return tuple(chain.from_iterable(map(dataset.split, split.split("+"))))

    @abc.abstractmethod
    def runs(
        self,
        dataset: Dataset,
        experiments: Sequence[Experiment],
        layout: ParameterVector,
        noise: np.ndarray,
        motions: Sequence[Motion] | None,
        step: float = recorded.STEP,
        shape: tuple[int, int] = (0, 0),
    ) -> Runs:
        """`noise` [ny] per output; `motions` the smoothed measured motion per experiment, where the
        model has one; `shape` the least size of the buffers and of a lane's output.
        """


@dataclass(frozen=True)
class OutputError(Residual):
    """Free run of the whole experiment.

    Where it was cut from a longer one, effects follow the measured motion in what is known before
    it; the run starts a little before the cut, and its samples up to there tell how: a start from
    the first ones after the cut alone would drift away.
    """

    name: ClassVar[str] = "output_error"

    def runs(self, dataset, experiments, layout, noise, motions, step=recorded.STEP, shape=(0, 0)):
        chain = layout.chain
        every = [e.whole for e in experiments]
        remembers = (
            motions is not None and any(e.past for e in dataset.experiments) and chain.has_states()
        )
        smooth = []
        if remembers and motions:
            for e, own, m in zip(every, experiments, motions, strict=True):
                whole = measured_motion.motion(dataset, e, chain, noise) if own.past else m
                smooth.append(whole)
        samples, positions = recorded.build(
            dataset, every, chain, noise, step, _states(smooth), shape[0]
        )
        records, heads = [], []
        for number, (e, own) in enumerate(zip(every, experiments, strict=True)):

            def part(a, b, c, number=number, e=e):
                """The record from sample `a` to `b`, of which those from `c` on count."""
                p = positions[number]
                burn = len(e) if remembers else 0
                record = record_of(
                    number=number, e=e, p=p, a=a, b=b, dataset=dataset, chain=chain, burn=burn
                )
                return replace(record, samples=p[c:b])

            records.append(part(run_up(own), len(e), len(e) - len(own)))
            heads.append(nested_heads(e, own, part, layout.chain.mechanism.touches))
        lanes = [*records]
        ends = [len(lanes)]
        for own in heads:
            lanes += own
            ends.append(len(lanes))
        engine = BatchSimulator(
            layout,
            samples,
            lanes,
            overrides(layout, every, lanes),
            lane_of(layout),
            shape[1],
            burn=remembers,
        )
        return Runs(
            experiments=tuple(experiments),
            layout=layout,
            channels=layout.chain.signature.outputs,
            noise=noise,
            engine=engine,
            records=tuple(range(len(records))),
            heads=tuple(tuple(range(a, b)) for a, b in pairwise(ends)),
            statement="free run over the whole experiment",
        )


@dataclass(frozen=True)
class MultipleShooting(Residual):
    """Free runs over windows of `window_s` seconds, each start estimated; windows are not forced to
    meet.
    """

    name: ClassVar[str] = "multiple_shooting"
    simulation: ClassVar[Simulation] = "windows"
    window_s: float | None = None

    @property
    def window(self) -> Window:
        return lambda e: self.window_s or default_window(e)

    def runs(self, dataset, experiments, layout, noise, motions, step=recorded.STEP, shape=(0, 0)):
        states = layout.chain.has_states()
        memory = WINDOW_PAST if states else 0
        if layout.chain.mechanism.hidden_states:
            raise UsageError(
                f"windows cannot start inside a run of {layout.chain.mechanism.name}: its inner"
                " state is not measured; use the residual output_error"
            )
        if states and motions is None:
            raise UsageError(
                "windows need measured joint positions when an effect has states; use the residual"
                " output_error"
            )
        measured = _states(motions if states else None)
        samples, positions = recorded.build(
            dataset, experiments, layout.chain, noise, step, measured, shape[0]
        )
        records, length = [], 0.0
        for number, e in enumerate(experiments):
            length = self.window(e)
            begins = edges(e, length)
            for a, b in zip(begins, [*begins[1:], len(e.t)], strict=True):
                records.append(
                    record_of(
                        number=number,
                        e=e,
                        p=positions[number],
                        a=int(a),
                        b=int(b),
                        dataset=dataset,
                        chain=layout.chain,
                        burn=memory,
                    )
                )
        engine = BatchSimulator(
            layout, samples, records, overrides(layout, experiments, records), lane_of(layout)
        )
        every = tuple(range(len(records)))
        return Runs(
            experiments=tuple(experiments),
            layout=layout,
            channels=layout.chain.signature.outputs,
            noise=noise,
            engine=engine,
            records=every,
            heads=(),
            statement=f"windows of {length:.3g} s, each with its own start",
        )


@dataclass(frozen=True)
class InverseDynamics(Residual):
    """Torque residual of the measured motion.

    With `cutoff_hz` the residual is low-passed there and taken at a few samples of that period
    (both sides of the equation pass the same filter, which keeps the estimate unbiased by it);
    positions are filtered without phase at twice that and differentiated. With `decimate` it is
    taken at every n-th sample, and `cutoff_hz` is that of the positions.
    """

    name: ClassVar[str] = "inverse_dynamics"
    simulation: ClassVar[Simulation] = "inverse_dynamics"
    cutoff_hz: float | None = None
    decimate: int | None = None

    def runs(self, dataset, experiments, layout, noise, motions, step=recorded.STEP, shape=(0, 0)):
        chain = layout.chain
        experiments = [evenly(e) for e in experiments]
        setting = torque_setting(dataset, experiments, chain, noise, self.cutoff_hz, self.decimate)
        samples, positions = recorded.build(
            dataset, experiments, chain, np.ones(len(setting.noise)), 1e9, setting.motion, shape[0]
        )
        w = np.zeros_like(samples.w)
        records = []
        for number, e in enumerate(experiments):
            p, ends = positions[number], setting.ends[number]
            told = chain.mechanism.told_by_torque(setting.motion[number][:, : chain.nq], ends)
            at = np.arange(ends, len(p) - ends, setting.decimate)
            w[p[at[told[at]]]] = 1 / setting.noise
            record = record_of(
                number=number, e=e, p=p, a=0, b=len(e.t), dataset=dataset, chain=chain, burn=0
            )
            records.append(
                Record(**{**record.__dict__, "samples": p[at], "free": np.zeros_like(record.free)})
            )
        samples = samples._replace(y=np.zeros_like(samples.y), w=w)
        lane: Lane = (
            decimated_torque_lane(setting.taps)
            if setting.decimate > 1
            else inverse_dynamics_rollout
        )
        engine = BatchSimulator(
            layout, samples, records, overrides(layout, experiments, records), lane, shape[1]
        )
        every = tuple(range(len(records)))
        return Runs(
            experiments=tuple(experiments),
            layout=layout,
            channels=chain.torque_channels,
            noise=setting.noise,
            engine=engine,
            records=every,
            heads=(),
            statement=setting.statement,
            dataset=dataset,
            setting=setting,
        )


def lane_of(layout: ParameterVector) -> Lane:
    """What simulates: the stepping of chains, or the solver of the layout."""
    if layout.solver is None:
        return simulate_rollout
    from jaxid.simulation.diffrax_solver import diffrax_lane

    return diffrax_lane(layout.solver)


def _states(motions: Sequence[Motion] | None) -> list[np.ndarray] | None:
    """Positions and velocities of smoothed motions, each [time 2 nq]."""
    return [np.concatenate([m.q, m.qd], 1) for m in motions] if motions else None


def default_window(e: Experiment) -> float:
    """Window length, s: an eighth of the run, at least 50 samples: long against the joint's time
    constant (a short window cannot see a wrong friction law), short against the drift of a free
    run.
    """
    step = float(np.median(np.diff(e.t)))
    return max(float(e.t[-1] - e.t[0]) / 8, 50 * step)


def overrides(
    layout: ParameterVector, experiments: Sequence[Experiment], records: Sequence[Record]
) -> np.ndarray:
    """Constants that experiments state themselves, [records size], nan elsewhere."""
    out = np.full((len(records), len(layout)), np.nan)
    for row, record in zip(out, records, strict=True):
        for name, value in experiments[record.experiment].constants.items():
            row[layout.index(name)] = value
    return out


def record_of(
    number: int,
    e: Experiment,
    p: np.ndarray,
    a: int,
    b: int,
    dataset: Dataset,
    chain: Chain,
    burn: int,
) -> Record:
    """Samples a ... b of an experiment as a record; its start from the statement of the experiment
    or its first samples. Up to `burn` samples before it effects follow the measured motion.
    """
    nq = chain.nq
    free = np.ones(2 * nq, bool)
    _, iy = recorded.columns(dataset, chain)
    q0, qd0 = start_of(chain, e, e.motion()[:, iy], a, min(len(e.t), a + head_samples(e)))
    if any(
        r.q is None and r.qd is not None for r in joint_readings(chain)
    ) and not position_matters(chain):
        free[:nq] = [
            r.q is not None for r in joint_readings(chain)
        ]  # counted from where the run starts
    if a == 0 and e.at_rest:
        qd0[:], free[nq:] = 0.0, False
    if a == 0 and e.initial is not None:
        for j in range(nq):
            for target, known, value in zip(
                (q0, qd0), (free[:nq], free[nq:]), stated_start(e, chain.signature, j), strict=True
            ):
                if value is not None:
                    target[j], known[j] = value, False
    lead = 0
    if burn and a > 0:
        lead = int(p[a] - p[max(0, a - burn)])
    return Record(
        experiment=number,
        offset=int(p[a]),
        count=int(p[b - 1] - p[a] + 1),
        first=int(p[0]),
        last=int(p[-1]),
        lead=lead,
        q0=q0,
        qd0=qd0,
        free=free,
        samples=p[a:b],
    )


def residual_class(name: str) -> type[Residual]:
    """The residual of a name. Raises `UsageError` for one that does not exist."""
    if name not in RESIDUALS:
        raise UsageError(f"there is no residual {name!r}{nearest(name, RESIDUALS)}")
    return at(RESIDUALS[name])


def resolve_residual(
    residual: Residual | str | None, cutoff_hz: float | None = None
) -> Residual | None:
    """The residual that is meant; `cutoff_hz` is that of `inverse_dynamics` and `momentum`. Raises
    `UsageError` for one that does not exist.
    """
    kind = residual_class(residual) if isinstance(residual, str) else type(residual)
    if cutoff_hz is not None:
        if "cutoff_hz" not in getattr(kind, "__dataclass_fields__", ()):
            raise UsageError(
                "a cutoff is the low-pass of inverse_dynamics and momentum: give"
                " residual='inverse_dynamics' (--residual) with it"
            )
        if not cutoff_hz > 0:
            raise UsageError(f"a cutoff of {cutoff_hz:g} Hz is none; give one above 0")
        return kind(cutoff_hz=cutoff_hz)  # type: ignore[call-arg]
    return kind() if isinstance(residual, str) else residual  # type: ignore[return-value]
