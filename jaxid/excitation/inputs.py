"""Exciting input signals for models that are driven in open loop or by commands: chosen by the
information that they bring.

A signal is, one after the other: rest, a multisine, rest, steps with holds, a slow ramp to either
side (slow speeds and breakaway), rest. Its amplitudes and phases are found by a population whose
members are simulated together with their derivatives by every parameter; a member is worth log det
of the Fisher information of the parameters, or the condition number of that matrix, and nothing
where it leaves the limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.drive_torque import drive_gains
from jaxid.dynamics.parameter import TypicalMagnitudes
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.excitation.bounds import Bounds
from jaxid.excitation.trajectories import required
from jaxid.numerics.precision import float64
from jaxid.simulation.batch import BatchSimulator
from jaxid.simulation.rollout import simulate_rollout
from jaxid.simulation.sample_buffers import build, Record


#: Where each part of a signal begins and ends, as a share of the whole.
SINES, STEPS, RAMPS = (0.03, 0.58), (0.61, 0.83), (0.84, 0.97)
LEVELS = 4
POPULATION, ROUNDS = 24, 10
DARK = 1e-12  # share of the largest eigenvalue below which a direction counts as not shown
EXCESS = 100.0  # what leaving a limit by its own size costs


@dataclass(frozen=True)
class Family:
    """All signals of one kind: `size` numbers each to inputs `[time nu]`. `top` [nu] is the largest
    input.
    """

    t: np.ndarray
    harmonics: int
    omega: float
    top: np.ndarray
    center: np.ndarray
    slew: (
        tuple[np.ndarray, np.ndarray] | None
    )  # (speed, acceleration) [nu] of inputs that are positions
    lines: np.ndarray | None = None  # [harmonics] multiples of omega; None: 1, 2, 3 ...

    @property
    def each(self) -> int:
        return 2 * self.harmonics + 2 + LEVELS

    @property
    def size(self) -> int:
        return self.each * len(self.top)

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Random members [count size]."""
        x = rng.normal(size=(count, len(self.top), self.each))
        x[..., 0] = rng.uniform(-3.0, 0.5, (count, len(self.top)))  # log of the size
        return x.reshape(count, -1)

    def inputs(self, x: np.ndarray) -> np.ndarray:
        """Inputs [members time nu] of numbers [members size]."""
        x = x.reshape(len(x), len(self.top), self.each)
        t, T = self.t, self.t[-1]
        H = self.harmonics
        gain, ramp = np.exp(np.minimum(x[..., 0], 0.0)), np.tanh(x[..., 1])
        a, b, levels = x[..., 2 : 2 + H], x[..., 2 + H : 2 + 2 * H], np.tanh(x[..., 2 + 2 * H :])
        angle = (
            self.omega * (np.arange(1, H + 1) if self.lines is None else self.lines) * t[:, None]
        )
        window = _window(t, SINES[0] * T, SINES[1] * T, 0.03 * T)
        sines = a @ np.sin(angle).T + b @ np.cos(angle).T
        sines = sines * window
        sines /= np.maximum(np.abs(sines).max(-1, keepdims=True), 1e-12)
        hold = np.floor((t / T - STEPS[0]) / (STEPS[1] - STEPS[0]) * 2 * LEVELS).astype(int)
        inside = (hold >= 0) & (hold < 2 * LEVELS) & (hold % 2 == 0)  # a rest after each level
        steps = np.where(inside, levels[..., np.clip(hold // 2, 0, LEVELS - 1)], 0.0)
        s = np.clip((t / T - RAMPS[0]) / (RAMPS[1] - RAMPS[0]), 0.0, 1.0)
        triangle = np.interp(s, [0, 0.25, 0.75, 1], [0, 1, -1, 0])
        u = gain[..., None] * (sines + steps + ramp[..., None] * triangle)
        u = np.moveaxis(np.clip(u, -1, 1), 1, 2) * self.top
        return self.center + (u if self.slew is None else _followed(u, t, *self.slew))


def _window(t: np.ndarray, begin: float, end: float, fade: float) -> np.ndarray:
    s = np.clip(np.minimum(t - begin, end - t) / fade, 0.0, 1.0)
    return s * s * (3 - 2 * s)


def _followed(
    u: np.ndarray, t: np.ndarray, speed: np.ndarray, acceleration: np.ndarray
) -> np.ndarray:
    """A path that follows wishes [members time nu] within speed and acceleration."""
    h = float(t[1] - t[0])
    out, place, rate = np.empty_like(u), u[:, 0].copy(), np.zeros_like(u[:, 0])
    for k in range(u.shape[1]):
        away = u[:, k] - place
        wish = np.clip(
            np.sign(away) * np.sqrt(2 * 0.7 * acceleration * np.abs(away)), -speed, speed
        )
        wish = np.clip(wish, -np.abs(away) / h, np.abs(away) / h)
        rate = rate + np.clip(wish - rate, -acceleration * h, acceleration * h)
        place = place + h * rate
        out[:, k] = place
    return out


def settled(chain: Chain, home: np.ndarray) -> np.ndarray:
    """The pose near `home` that the mechanism keeps without drive: downhill from there."""
    zero = jnp.zeros(chain.nq)

    @jax.jit
    def step(q):
        body = chain.body()
        pull = body.inverse(q, zero, zero)
        own = (
            jnp.stack([body.inverse(q, zero, e)[i] for i, e in enumerate(jnp.eye(chain.nq))]) - pull
        )
        return q - jnp.clip(0.02 * pull / jnp.maximum(jnp.abs(own), 1e-12), -0.2, 0.2), jnp.max(
            jnp.abs(pull)
        )

    with float64():
        zero = jnp.zeros(chain.nq)
        q = jnp.asarray(home, float)
        for _ in range(1000):
            q, pull = step(q)
            if float(pull) < 1e-9:
                break
        return np.asarray(q)


def by_goals(chain: Chain) -> bool:
    """Whether a chain is driven by where its joints are to be."""
    return all(unit in ("rad", "m") for _, unit in chain.signature.inputs)


def begun(chain: Chain, bounds: Bounds) -> tuple[np.ndarray, Bounds]:
    """The pose [n] in which an experiment begins, and its bounds.

    Goals hold the pose `home`. Without them a mechanism begins where it rests, and a range that
    nobody states goes with it. Raises `UsageError` where it rests outside a range that is stated.
    """
    if by_goals(chain):
        return bounds.home, bounds
    rest = settled(chain, bounds.home)
    outside = (rest < bounds.lower) | (rest > bounds.upper)
    for j in np.flatnonzero(outside & bounds.stated):
        raise UsageError(
            f"without drive {chain.signature.joints[j]} rests at {rest[j]:.4g}, outside its limits"
            f" {bounds.lower[j]:.4g} to {bounds.upper[j]:.4g}: no input in open loop keeps them."
            " Drive it by goals, or state limits about that pose (--limits)"
        )
    if not outside.any():
        return rest, bounds
    moved = rest - bounds.home
    return rest, bounds._replace(home=rest, lower=bounds.lower + moved, upper=bounds.upper + moved)


def largest_inputs(chain: Chain, bounds: Bounds) -> np.ndarray:
    """Largest input [nu] by default: what a sine over the whole range at the speed limit needs;
    half the range for positions.
    """
    half = (bounds.upper - bounds.lower) / 2
    if by_goals(chain):
        return 0.9 * half
    if not chain.direct:
        raise UsageError(
            f"{chain.mechanism.name} takes"
            f" {', '.join(f'{n} ({u})' for n, u in chain.signature.inputs)}: state how large they"
            " may be with --amplitude"
        )
    phase = np.linspace(0, 2 * np.pi, 65)[:, None]
    q, qd = bounds.home + half * np.sin(phase), bounds.speed * np.cos(phase)
    qdd = -np.minimum(bounds.speed**2 / half, bounds.acceleration) * np.sin(phase)
    with float64():
        run = jax.jit(jax.vmap(lambda *x: required(chain, *x)))
        tau = np.asarray(run(*(jnp.asarray(x) for x in (q, qd, qdd))))
    return np.abs(tau).max(0) / np.asarray(drive_gains(chain))


class InputDesign:
    """Simulates members of a family on a model, with derivatives by its free parameters."""

    def __init__(
        self, chain: Chain, start: np.ndarray, family: Family, bounds: Bounds, noise: np.ndarray
    ):
        self.chain, self.start, self.family = chain, start, family
        self.bounds, self.noise = bounds, noise
        self.layout = ParameterVector(chain)
        inputs, outputs = chain.signature.inputs, chain.signature.outputs
        self.channels = (
            *(Channel(name, "input", unit) for name, unit in inputs),
            *(Channel(name, "output", unit) for name, unit in outputs),
        )
        self.free = [
            i
            for i, e in enumerate(self.layout.entries)
            if not e.spec.fixed and e.name not in chain.mechanism.held()
        ]
        reach = float(np.max(bounds.upper - bounds.lower))
        top = float(np.max(family.top))
        typical = TypicalMagnitudes(
            top, float(np.max(bounds.speed)), reach, float(family.t[-1]), float(family.t[1])
        )
        scale = self.layout.boxes([typical] * chain.nq)[2]
        log = self.layout.log & (self.layout.values > 0)
        self.unit = np.where(
            log, np.abs(self.layout.values), scale
        )  # what one unit of the search scale is
        self.log = log

    @property
    def names(self) -> list[str]:
        return [self.layout.names[i] for i in self.free]

    def run(self, u: np.ndarray, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Outputs [members time ny] and derivatives [members time ny parameters] by one unit of
        each parameter.
        """
        k = len(self.free) if slopes else 1
        directions = np.zeros((k, len(self.layout)))
        if slopes:
            directions[np.arange(k), self.free] = self.unit[self.free]
        y, dy = self.simulated(u, np.tile(self.layout.values, (k, 1)), directions, slopes)
        return y[:, 0], np.moveaxis(dy, 1, 3) if slopes else np.zeros((*y[:, 0].shape, 0))

    def simulated(
        self, u: np.ndarray, theta: np.ndarray, directions: np.ndarray, slopes: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Outputs and their derivatives along `directions`, both [members variants time ny], under
        inputs [members time nu] with each of the parameter vectors `theta` [variants size].
        """
        t, count, k = self.family.t, len(u), len(theta)
        ny = len(self.chain.signature.outputs)
        experiments = [
            Experiment(f"run_{i + 1}", "fit", t, row, np.zeros((len(t), ny)), at_rest=True)
            for i, row in enumerate(u)
        ]
        dataset = Dataset("excitation", self.channels, tuple(experiments))
        samples, positions = build(dataset, experiments, self.chain, self.noise)
        nq = self.chain.nq
        known = np.zeros(2 * nq, bool)
        records = [
            Record(
                experiment=i,
                offset=int(p[0]),
                count=int(p[-1] - p[0] + 1),
                first=int(p[0]),
                last=int(p[-1]),
                lead=0,
                q0=self.start,
                qd0=np.zeros(nq),
                free=known,
                samples=p,
            )
            for i, p in enumerate(positions)
        ]
        engine = BatchSimulator(
            self.layout,
            samples,
            records,
            np.full((count, len(self.layout)), np.nan),
            simulate_rollout,
        )
        lanes = np.repeat(np.arange(count), k)
        values, starts = (
            np.tile(theta, (count, 1)),
            np.tile(np.concatenate([self.start, np.zeros(nq)]), (len(lanes), 1)),
        )
        pick = positions[0] - positions[0][0]

        def shaped(x):
            return x[:, pick].reshape(count, k, len(t), ny)

        if not slopes:
            y = shaped(engine.outputs(values, starts, lanes))
            return y, np.zeros_like(y)
        y, dy = engine.tangents(
            values, starts, np.tile(directions, (count, 1)), np.zeros_like(starts), lanes
        )
        return shaped(y), shaped(dy)

    def excess(self, y: np.ndarray) -> np.ndarray:
        """By which share of itself the worst limit is passed, [members]; 0 inside."""
        used = self.used(y)
        return np.max(np.maximum(np.where(np.isfinite(used), used, 1e3) - 1.0, 0.0), axis=(1, 2))

    def used(self, y: np.ndarray) -> np.ndarray:
        """Share of range and of speed that each joint uses at most, [members 2 n]."""
        joints = self.chain.joint_outputs
        q = y[:, :, joints]
        h = float(self.family.t[1] - self.family.t[0])
        qd = np.gradient(q, h, axis=1)
        middle, half = (
            (self.bounds.upper + self.bounds.lower) / 2,
            (self.bounds.upper - self.bounds.lower) / 2,
        )
        return np.stack(
            [np.abs(q - middle).max(1) / half, np.abs(qd).max(1) / self.bounds.speed], 1
        )

    def fisher(self, dy: np.ndarray) -> np.ndarray:
        """Information matrices [members k k] in the search scale, white noise of every sample."""
        J = dy / self.noise[:, None]
        return np.einsum("mtyk,mtyl->mkl", J, J)

    def worth(self, dy: np.ndarray, criterion: str) -> np.ndarray:
        """What is minimised, [members]."""
        F = self.fisher(dy)
        bad = np.asarray(~np.isfinite(F).all((1, 2)))
        e = np.linalg.eigvalsh(np.where(bad[:, None, None], np.eye(F.shape[1]), F))
        logs = 0.5 * np.log(np.maximum(e, DARK * np.maximum(e[:, -1:], 1e-300)))
        value = logs[:, -1] - logs[:, 0] if criterion == "condition" else -logs.mean(1)
        return np.where(bad, np.inf, value)


def determined(F: np.ndarray) -> tuple[float, int]:
    """Condition number of the directions that an information matrix with unit diagonal shows, and
    how many it does not.
    """
    size = np.sqrt(np.diag(F))
    size = np.where(size > 0, size, 1.0)
    e = np.linalg.eigvalsh(F / size / size[:, None]).tolist()
    shown = [v for v in e if v > DARK * e[-1]]
    return float(np.sqrt(shown[-1] / shown[0])), len(e) - len(shown)


def choose(
    bench: InputDesign,
    criterion: str,
    starts: int,
    seed: int,
    progress: Callable[[str, int, int, str], None] | None = None,
) -> tuple[np.ndarray, float]:
    """The best signal [time nu] and what it reaches. Raises `UsageError` where no signal keeps the
    limits.
    """
    rng, family = np.random.default_rng(seed), bench.family

    def rated(x: np.ndarray) -> np.ndarray:
        y, dy = bench.run(family.inputs(x))
        return bench.worth(dy, criterion) + EXCESS * bench.excess(y)

    count = max(POPULATION, 4 * starts)
    x = family.draw(rng, count)
    values = rated(x)
    for k in range(ROUNDS):
        order = np.argsort(values)[: max(4, count // 4)]
        x, values = x[order], values[order]
        if progress:
            progress("excite", k, ROUNDS, f"{values[0]:.3f}")
        parents = rng.integers(0, len(x), (count, 2))
        mix = rng.random((count, family.size)) < 0.3
        width = 0.5 * 0.8**k
        young = np.where(mix, x[parents[:, 1]], x[parents[:, 0]]) + width * rng.normal(
            size=(count, family.size)
        )
        x, values = np.concatenate([x, young]), np.concatenate([values, rated(young)])
    i = int(np.argmin(values))
    best = x[i : i + 1].copy()
    gain = np.arange(0, family.size, family.each)
    for _ in range(25):
        y, dy = bench.run(family.inputs(best))
        if bench.excess(y)[0] == 0 and np.isfinite(bench.worth(dy, criterion)[0]):
            return family.inputs(best)[0], float(bench.worth(dy, criterion)[0])
        best[:, gain] = np.minimum(best[:, gain], 0.0) + np.log(0.8)
    raise UsageError(
        "no input was found that keeps the limits: widen them (--limits), or allow less input"
        " (--amplitude)"
    )
