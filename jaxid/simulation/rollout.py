"""What one lane computes: the prediction of one model on one record."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxid.dynamics.carry import Carry
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Command, LONGEST_DELAY_S
from jaxid.dynamics.mechanism import Mechanism
from jaxid.numerics.batch_loop import loop_over_time
from jaxid.numerics.reverse import reversible
from jaxid.simulation.sample_buffers import BLOCK, bucket, Record, Samples


#: `reach` of a run with equal steps: what depends on the step's length is worked out once.
EVEN = -1


#: (chain, samples, where, start, steps, length, reach, burn) -> prediction at every step of a
#: record.
Lane = Callable[..., Array]
#: (chain, body, carry, command) -> carry, outputs: one step, as `Chain.step`.
Advance = Callable[[Chain, Mechanism, Carry, Command], tuple[Carry, Array]]


def command_at(samples: Samples, k: Array, first: Array, last: Array, reach: int) -> Command:
    """Command of buffer step k of the run that occupies first ... last; `reach` as of
    `reach_of`.
    """
    mean = (samples.t[last] - samples.t[first]) / jnp.maximum(last - first, 1)
    now, h = (
        (samples.t[first] + (k - first) * mean, mean)
        if reach == EVEN
        else (samples.t[k], samples.h[k])
    )

    def step_of(t: Array) -> Array:
        """Position of the step that holds each time [nu], none later than one step ahead."""
        if (
            reach == EVEN
        ):  # by arithmetic: where rounding takes a neighbour, the integral is the same
            return jnp.clip(
                first + jnp.floor((t - samples.t[first]) / mean).astype(k.dtype), first, last
            )
        if reach == 0:  # nearly so: one place to either side
            low = jnp.clip(k + jnp.floor((t - now) / h).astype(k.dtype), first, last)
            low = jnp.where(samples.t[low] > t, jnp.maximum(low - 1, first), low)
            up = jnp.minimum(low + 1, last)
            return jnp.where(samples.t[up] <= t, up, low)
        low, high = (
            jnp.full(t.shape, jnp.maximum(k - reach, first)),
            jnp.full(t.shape, jnp.minimum(k + 1, last)),
        )
        for _ in range(reach.bit_length() + 1):
            middle = (low + high + 1) // 2
            down = samples.t[middle] > t
            low, high = jnp.where(down, low, middle), jnp.where(down, middle - 1, high)
        return low

    def integral(t: Array) -> Array:
        """Integral of the stated input from the run's beginning to times t [nu]; before the run the
        first input holds.
        """
        low = step_of(t)
        channel = jnp.arange(t.shape[0])
        begin = samples.t[first] + (low - first) * mean if reach == EVEN else samples.t[low]
        return samples.total[low, channel] + samples.u[low, channel] * (t - begin)

    def delayed(d):
        return (integral(now + h - d) - integral(now - d)) / h

    return Command(now, h, samples.u[k], samples.other[k], delayed)


def simulate_rollout(
    chain: Chain,
    samples: Samples,
    where: Int[Array, " 4"],
    start: Float[Array, " two_nq"],
    steps: Array,
    length: int,
    reach: int,
    burn: bool,
    body: Mechanism | None = None,
    wanted: tuple[int, ...] | None = None,
    advance: Advance | None = None,
) -> Float[Array, "length ny"]:
    """Outputs of one model on one record from its first step on.

    `where` holds that step, the bounds of its run, and a lead, which only a program with `burn`
    knows: for this many steps before the record the joints follow the measured motion, so that
    effects, springs and beams bring their states to its beginning; then they start from `start`,
    and sensors as if outputs had run straight up to it. `steps` counts those of the lead, too; what
    comes after them is no prediction. The loop runs over blocks, their count is data: one program
    serves every length. `body` is the mechanism with its effects, prepared, where that has been
    done; of outputs that are not `wanted` zeros are returned. `advance` takes a step in place of
    the chain's own.
    """
    nq = chain.nq
    offset, _, last, lead = where
    prepared, initial, step = _stepping(
        chain=chain,
        samples=samples,
        where=where,
        start=start,
        reach=reach,
        burn=burn,
        body=body,
        wanted=wanted,
        advance=advance,
    )
    y = over_time(
        step, initial, steps, length, len(chain.signature.outputs), marked=advance is None
    )
    k = jnp.arange(length)
    beyond = (
        jnp.maximum(offset + k - last, 0) * samples.h[last]
    )  # the loop goes on to the end of its block, and so does time
    times, even = (
        samples.t[jnp.minimum(offset + k, last)] + beyond,
        samples.h[offset] if reach == EVEN else None,
    )
    y = y[jnp.minimum(lead + k, length - 1)] if burn else y
    return chain.recorded(times, y, even, chain.begins(prepared, start[:nq], start[nq:])[1])


def _stepping(
    chain, samples, where, start, reach, burn, body=None, wanted=None, advance=None
) -> tuple[Mechanism, Carry, Callable]:
    """(mechanism with its effects, how a record begins, one step of it) of `simulate_rollout`."""
    nq = chain.nq
    offset, first, last, lead = where
    begin = offset - lead if burn else offset
    if body is None:
        body = chain.body().prepare(samples.h[begin] if reach == EVEN else None)
    initial = chain.start(start[:nq], start[nq:], samples.u[begin], body)

    def step(carry: Carry, k: Array) -> tuple[Carry, Array]:
        i = jnp.minimum(begin + k, last)
        if burn:
            q, qd = jnp.split(jnp.where(k < lead, samples.x[i], start), 2)
            x = jax.tree.map(
                lambda a, b: jnp.where(k == 0, a, b), body.start(q, qd), body.follow(carry.x, q, qd)
            )
            z = chain.sensed_anew(
                carry.z, initial.z, k == lead
            )  # what was measured has gone through the sensors
            x = jax.tree.map(lambda a, b: jnp.where(k <= lead, a, b), x, carry.x)

            def anew(a, b):
                return jnp.where(k == lead, a, b)

            predictors = (
                (initial.lam, initial.acc, initial.net),
                (carry.lam, carry.acc, carry.net),
            )
            carry = Carry(x, z, *jax.tree.map(anew, *predictors))
        command = command_at(samples, i, first, last, reach)
        if advance is None:
            carry, y = chain.step(body, carry, command)
        else:
            carry, y = advance(chain, body, carry, command)
        if wanted is not None:
            outputs = [jnp.zeros(())] * len(y)
            for i in wanted:
                outputs[i] = y[i]
            y = jnp.stack(outputs)
        return carry, y

    return body, initial, step


def simulate_window(
    chain: Chain,
    samples: Samples,
    where: Array,
    start: Array,
    at: Array,
    carry: Any,
    steps: Array,
    size: int,
    reach: int,
    burn: bool,
) -> tuple[Any, Float[Array, "size ny"]]:
    """The steps `at` ... `at + size` of what `simulate_rollout` does (those of the lead count), and
    the state that they leave, from the state that the window before them left; `steps` of them are
    wanted. No record effects.
    """
    _, initial, step = _stepping(chain, samples, where, start, reach, burn)
    return _window(step, initial, at, carry, steps, size, len(chain.signature.outputs))


def torque_window(
    chain: Chain,
    samples: Samples,
    where: Array,
    start: Array,
    at: Array,
    carry: Any,
    steps: Array,
    size: int,
    reach: int,
    burn: bool,
) -> tuple[Any, Float[Array, "size nq"]]:
    """The same of `inverse_dynamics_rollout`."""
    initial, step = _torques(chain, samples, where, reach)
    return _window(step, initial, at, carry, steps, size, chain.nq)


def simulate_begin(
    chain: Chain, samples: Samples, where: Array, start: Array, reach: int, burn: bool
) -> Any:
    """The state with which `simulate_window` begins."""
    return _stepping(chain, samples, where, start, reach, burn)[1]


def torque_begin(
    chain: Chain, samples: Samples, where: Array, start: Array, reach: int, burn: bool
) -> Any:
    """The same of `torque_window`."""
    return _torques(chain, samples, where, reach)[0]


def _window(
    step: Callable, initial: Any, at: Array, carry: Any, steps: Array, size: int, width: int
) -> tuple[Any, Array]:
    carry = jax.tree.map(lambda a, b: jnp.where(at == 0, a, b), initial, carry)
    state = _blocks(lambda c, k: step(c, k + at), carry, steps, size, width)
    return loop_over_time(lambda: state()[1:])


def inverse_dynamics_rollout(
    chain: Chain,
    samples: Samples,
    where: Int[Array, " 4"],
    start: Float[Array, " two_nq"],
    steps: Array,
    length: int,
    reach: int,
    burn: bool,
) -> Float[Array, "length nq"]:
    """Minus the missing torque of the measured motion, M qdd + bias + friction - drive(u), at every
    sample of one run.
    """
    z, step = _torques(chain, samples, where, reach)
    return over_time(step, z, steps, length, chain.nq)


def _torques(chain: Chain, samples: Samples, where: Array, reach: int) -> tuple[tuple, Callable]:
    """(how a run begins, one step of it) of `inverse_dynamics_rollout`."""
    nq = chain.nq
    begin, first, last, _ = where

    def step(z: tuple, k: Array) -> tuple[tuple, Array]:
        i = jnp.minimum(begin + k, last)
        command = command_at(samples, i, first, last, reach)
        if not chain.direct:
            command = _about(command, samples, jnp.maximum(i - 1, first))
        q, qd, qdd = samples.x[i, :nq], samples.x[i, nq : 2 * nq], samples.x[i, 2 * nq :]
        missing, z = chain.inverse(command, z, q, qd, qdd)
        return z, -missing

    z = chain.start(samples.x[begin, :nq], samples.x[begin, nq : 2 * nq], samples.u[begin]).z
    return z, step


def _about(command: Command, samples: Samples, before: Array) -> Command:
    """The command as a mean over a step about its moment, not from it on: what a law makes of a
    goal is then in phase with the motion. `before` is the step before it.
    """
    half = command.h / 2

    def mean(a, now):
        return (a[before] + now) / 2

    return command._replace(
        u=mean(samples.u, command.u),
        other=mean(samples.other, command.other),
        delayed=lambda d: command.delayed(d + half),
    )


def over_time(
    step: Callable, carry: Any, steps: Array, length: int, width: int, marked: bool = True
) -> Array:
    """What `step(carry, k) -> carry, y [width]` gives at each of this many steps, [length width];
    after them it is no result. `marked`: lanes are laid out for vector code, which a step with a
    solver of its own inside is not for.
    """
    if reversible():
        return _over_static_time(step, carry, steps, length)
    loop = _blocks(step, carry, steps, length, width)

    def outputs():
        return loop()[2]

    return loop_over_time(outputs) if marked else outputs()


def _blocks(
    step: Callable, carry: Any, steps: Array, length: int, width: int
) -> Callable[[], tuple[Array, Any, Array]]:
    """The loop over blocks of steps: (steps done, state, what each step gave [length width])."""

    def block(state):
        k, carry, out = state
        carry, y = jax.lax.scan(step, carry, k + jnp.arange(BLOCK, dtype=k.dtype))
        return k + BLOCK, carry, jax.lax.dynamic_update_slice_in_dim(out, y, k, 0)

    state = (jnp.zeros((), jnp.asarray(steps).dtype), carry, jnp.zeros((length, width)))
    return lambda: jax.lax.while_loop(lambda s: s[0] < steps, block, state)


#: Lanes that can be taken window by window: (their windows, how the first one begins).
WINDOWED: dict[Lane, tuple[Callable, Callable]] = {
    simulate_rollout: (simulate_window, simulate_begin),
    inverse_dynamics_rollout: (torque_window, torque_begin),
}


def _over_static_time(step: Callable, carry: Any, steps: Array, length: int) -> Array:
    """The same in reverse: all of `length`, the state standing still after the last step. Only the
    states between blocks are kept, what lies between them is worked out again on the way back.
    """

    def held(carry: Any, k: Array) -> tuple[Any, Array]:
        new, y = step(carry, k)
        return jax.tree.map(lambda a, b: jnp.where(k < steps, a, b), new, carry), y

    block = jax.checkpoint(lambda carry, k: jax.lax.scan(held, carry, k))  # pyright: ignore[reportPrivateImportUsage]
    blocks = -(-length // BLOCK)
    k = jnp.arange(blocks * BLOCK, dtype=jnp.asarray(steps).dtype).reshape(blocks, BLOCK)
    _, y = jax.lax.scan(block, carry, k)
    return y.reshape(blocks * BLOCK, -1)[:length]


def reach_of(samples: Samples, record: Record) -> int:
    """EVEN where a run has equal steps to rounding, 0 where to one percent, else how many steps the
    longest delay may reach back, as a power of two.
    """
    t, h = (np.asarray(a)[record.first : record.last] for a in (samples.t, samples.h))
    if not h.size or np.ptp(h) <= 1e-6 * np.median(h):
        return EVEN
    if np.ptp(h) <= 0.01 * np.median(h):
        return 0
    return bucket(int(np.max(np.arange(t.size) - np.searchsorted(t, t - LONGEST_DELAY_S))) + 2, 8)
