"""The force of a joint effect along a measured motion, by the effect's own equation: one column for
each of its strengths.

An effect is linear in its strengths (levels, coefficients, stiffnesses), which are zero where it is
neutral; what remains are numbers that shape it (a Stribeck speed, an exponent), which lie on a
grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.dynamics.effect import Command, JointEffect, neutral, Signals
from jaxid.dynamics.parameter import resolve, specs, TypicalMagnitudes, with_fields
from jaxid.numerics.precision import float64


#: Points of the grid of a number that shapes an effect, and how far beyond its probes it goes.
GRID, BEYOND = 7, 2.0


class EvenMotion(Protocol):
    """A motion at equal steps (s), and a length up to which programs pad it: `room` samples, made
    by `padded`.
    """

    @property
    def q(self) -> Float[np.ndarray, "time n"]: ...

    @property
    def qd(self) -> Float[np.ndarray, "time n"]: ...

    @property
    def room(self) -> int: ...

    @property
    def step(self) -> float: ...

    def padded(self, x: np.ndarray) -> np.ndarray: ...


class Load(NamedTuple):
    """Torque [time n] at the gears along a motion: what the drive makes, and what goes on to the
    links.
    """

    drive: Float[np.ndarray, "time n"]
    transmitted: Float[np.ndarray, "time n"]


def unloaded(run: EvenMotion) -> Load:
    return Load(0 * run.q, 0 * run.q)


def force(
    effect: JointEffect, run: EvenMotion, load: Load, turn: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "time n"]:
    """Opposing force [time n] of an effect whose numbers are [n], under a load; sign(qd) goes over
    smoothly within the speeds `turn` [n].
    """
    series = [run.padded(x) for x in (run.q, run.qd, *load)]
    with float64():
        return np.asarray(_force(effect, run.step, turn, *series))[: len(run.q)]


@jax.jit
def _force(
    effect: JointEffect,
    h: Any,
    turn: Float[Array, " n"],
    q: Float[Array, "time n"],
    qd: Float[Array, "time n"],
    drive: Float[Array, "time n"],
    transmitted: Float[Array, "time n"],
) -> Float[Array, "time n"]:
    u = jnp.zeros(q.shape[1])
    command = Command(jnp.zeros(()), h, u, u, lambda d: u)

    def at(z: Any, now: tuple[Any, ...]) -> tuple[Any, Any]:
        q, qd, load, on = now
        smooth, minus, plus, z = effect(
            Signals(command.t, q, qd, load, h, command, qd, transmitted=on), z
        )
        way = jnp.tanh(qd / turn)
        return z, smooth + jnp.where(way > 0, plus, minus) * way + 0 * q

    z = effect.start(q[0])
    if jax.tree.leaves(z):
        return jax.lax.scan(at, z, (q, qd, drive, transmitted))[1]
    return jax.vmap(lambda now: at(z, now)[1])((q, qd, drive, transmitted))


def with_numbers(effect: JointEffect, numbers: Mapping[str, Any], n: int) -> JointEffect:
    """The effect with these numbers, neutral in all others, each [n]."""
    own = {
        name: np.broadcast_to(np.asarray(numbers.get(name, spec.value), float), (n,))
        for name, spec in specs(effect).items()
    }
    return with_fields(effect, {k: np.array(v) for k, v in own.items()})


@lru_cache(maxsize=256)
def strengths(kind: type[JointEffect], n: int, room: int) -> tuple[str, ...]:
    """Names of the numbers in which the force of an effect is linear, each by itself, tried on a
    motion of n joints and this many samples: that of the runs, so that one program serves.
    """
    effect = neutral(kind)
    t = np.linspace(0.0, 0.15 * room, room)[:, None] * np.linspace(1.0, 0.7, n)
    q, qd = np.sin(t) + 0.3 * np.sin(0.3 * t), np.cos(t) + 0.09 * np.cos(0.3 * t)

    def of(name: str, value: float) -> np.ndarray:
        with float64():
            return np.asarray(
                _force(
                    with_numbers(effect, {name: value}, n),
                    0.15,
                    np.full(n, 0.01),
                    q,
                    qd,
                    np.abs(q),
                    np.abs(q),
                )
            )

    linear = []
    for name, spec in specs(effect).items():
        if (
            spec.value == 0
            and np.any(one := of(name, 0.1))
            and np.allclose(of(name, 0.2), 2 * one, rtol=1e-9, atol=1e-12)
        ):
            linear.append(name)
    return tuple(linear)


def shapes(
    kind: type[JointEffect], reference: TypicalMagnitudes, linear: Sequence[str]
) -> list[dict[str, float]]:
    """The grid of the numbers that shape an effect at a joint with these typical magnitudes, from
    its probes; `linear`: its strengths.
    """
    own = specs(kind)
    found: list[dict[str, float]] = []
    for probe in kind.probes:
        shaping = {k: resolve(v, reference) for k, v in sorted(probe.items()) if k not in linear}
        if shaping not in found:
            found.append(shaping)
    varied = set().union(*found)
    for name in varied:
        spec, values = own[name], [s[name] for s in found if name in s]
        if len(varied) == 1 and spec.log and len(values) < GRID:
            low, high = (resolve(b, reference) for b in (spec.lower, spec.upper))
            ends = np.clip([min(values) / BEYOND, max(values) * BEYOND], low, high)
            return [{name: float(v)} for v in np.geomspace(ends[0], ends[1], GRID)]
    return found or [{}]


def at_every_joint(
    kind: type[JointEffect],
    grids: Sequence[Sequence[Mapping[str, float]]],
    runs: Sequence[EvenMotion],
    load: Sequence[Load],
    turn: Float[np.ndarray, " n"],
) -> list[dict[str, list[Float[np.ndarray, "time n"]]]]:
    """For each point of the joints' grids and each strength: its force along each run, [time n] for
    each.
    """
    n, effect, out = len(turn), neutral(kind), []
    for k in range(max(map(len, grids))):
        point = [g[min(k, len(g) - 1)] for g in grids]
        shape = {}
        for name in set().union(*point):
            usual = specs(effect)[name].value
            shape[name] = np.array([p.get(name, usual) for p in point])
        made = {}
        for name in strengths(kind, n, runs[0].room):
            one = with_numbers(effect, {**shape, name: 1.0}, n)
            made[name] = [force(one, r, f, turn) for r, f in zip(runs, load, strict=True)]
        out.append(made)
    return out


def coupled(
    kind: type[JointEffect],
    shape: Mapping[str, float],
    place: int,
    run: EvenMotion,
    load: Load,
    turn: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "time n strengths"]:
    """[time n strengths] of an effect at one place that acts on several joints."""
    n, effect = len(turn), neutral(kind)
    names = strengths(kind, n, run.room)
    here = np.eye(n)[place]
    return np.stack(
        [force(with_numbers(effect, {**shape, name: here}, n), run, load, turn) for name in names],
        -1,
    )
