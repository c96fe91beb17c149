"""Simulation of many candidates: lanes of one compiled program.

A lane is one candidate on one record, with one tangent direction. Candidates, parameters and records share ONE flat batch
axis in blocks of fixed size: the program never recompiles because a number changed, a lane's result does not depend on its
neighbours (bitwise), and a lane that diverges costs the others nothing.
"""

from __future__ import annotations

import os
import time
from collections import deque, OrderedDict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from threading import Lock
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxid.chain import Carry, Chain, Command
from jaxid.lanes import loop_over_time, over_lanes
from jaxid.layout import Layout
from jaxid.mechanism import Mechanism
from jaxid.precision import float64
from jaxid.samples import BLOCK, bucket, Record, Samples
from jaxid.traced import key_of, Traced


#: Lanes of one block: enough for vector code, few enough to stay in the cache; and of each block of a call that has few of them.
LANES, FEW = 32, 16
#: Upper bound of every delay parameter of the library.
LONGEST_DELAY_S = 0.1
#: `reach` of a run with equal steps: what depends on the step's length is worked out once.
EVEN = -1


#: (chain, samples, where, start, steps, length, reach, burn) -> prediction at every step of a record.
Lane = Callable[..., Array]


def command_at(samples: Samples, k: Array, first: Array, last: Array, reach: int) -> Command:
    """Command of buffer step k of the run that occupies first ... last; `reach` as of `reach_of`."""
    mean = (samples.t[last] - samples.t[first]) / jnp.maximum(last - first, 1)
    now, h = (samples.t[first] + (k - first) * mean, mean) if reach == EVEN else (samples.t[k], samples.h[k])

    def step_of(t: Array) -> Array:
        """Position of the step that holds each time [nu], none later than one step ahead."""
        if reach == EVEN:  # by arithmetic: where rounding takes a neighbour, the integral is the same
            return jnp.clip(first + jnp.floor((t - samples.t[first]) / mean).astype(k.dtype), first, last)
        if reach == 0:  # nearly so: one place to either side
            low = jnp.clip(k + jnp.floor((t - now) / h).astype(k.dtype), first, last)
            low = jnp.where(samples.t[low] > t, jnp.maximum(low - 1, first), low)
            up = jnp.minimum(low + 1, last)
            return jnp.where(samples.t[up] <= t, up, low)
        low, high = jnp.full(t.shape, jnp.maximum(k - reach, first)), jnp.full(t.shape, jnp.minimum(k + 1, last))
        for _ in range(reach.bit_length() + 1):
            middle = (low + high + 1) // 2
            down = samples.t[middle] > t
            low, high = jnp.where(down, low, middle), jnp.where(down, middle - 1, high)
        return low

    def integral(t: Array) -> Array:
        """Integral of the stated input from the run's beginning to times t [nu]; before the run the first input holds."""
        low = step_of(t)
        channel = jnp.arange(t.shape[0])
        begin = samples.t[first] + (low - first) * mean if reach == EVEN else samples.t[low]
        return samples.total[low, channel] + samples.u[low, channel] * (t - begin)

    delayed = lambda d: (integral(now + h - d) - integral(now - d)) / h
    return Command(now, h, samples.u[k], samples.other[k], delayed)


def simulate_lane(
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
) -> Float[Array, "length ny"]:
    """Outputs of one model on one record, at every step of the buffer (`steps` of them, then zeros).

    `where` holds the first step of the lane, the bounds of its run, and the burn-in: for so many steps the joints follow the
    measured motion, so that effects, springs and beams bring their states to the record's beginning; then they start from
    `start`, and sensors as if outputs had run straight up to it. The loop runs over blocks, their count is data: one program
    serves every length. `body` is the mechanism with its effects, prepared, where that has been done; of outputs that are not
    `wanted` zeros are returned.
    """
    nq = chain.nq
    begin, first, last, lead = where
    if body is None:
        body = chain.body().prepare(samples.h[begin] if reach == EVEN else None)
    initial = chain.start(start[:nq], start[nq:], samples.u[begin], body)

    def step(carry: Carry, k: Array) -> tuple[Carry, Array]:
        i = jnp.minimum(begin + k, last)
        if burn:
            q, qd = jnp.split(jnp.where(k < lead, samples.x[i], start), 2)
            x = jax.tree.map(lambda a, b: jnp.where(k == 0, a, b), body.start(q, qd), body.follow(carry.x, q, qd))
            z = chain.sensed_anew(carry.z, initial.z, k == lead)  # what was measured has gone through the sensors
            carry = carry._replace(x=jax.tree.map(lambda a, b: jnp.where(k <= lead, a, b), x, carry.x), z=z)
        command = command_at(samples, i, first, last, reach)
        carry, y = chain.step(body, carry, command)
        return carry, y if wanted is None else jnp.stack([y[i] if i in wanted else jnp.zeros(()) for i in range(len(y))])

    y = _blocks_of(step, initial, steps, length, len(chain.signature.outputs))
    k = jnp.arange(length)
    beyond = jnp.maximum(begin + k - last, 0) * samples.h[last]  # the loop goes on to the end of its block, and so does time
    times, even = samples.t[jnp.minimum(begin + k, last)] + beyond, samples.h[begin] if reach == EVEN else None
    rate = chain.begins(body, start[:nq], start[nq:])[1]
    y = jnp.where((k < lead)[:, None], y[lead] + rate * (times - times[lead])[:, None], y) if burn else y
    return chain.recorded(times, y, even, rate)


def torque_lane(
    chain: Chain,
    samples: Samples,
    where: Int[Array, " 4"],
    start: Float[Array, " two_nq"],
    steps: Array,
    length: int,
    reach: int,
    burn: bool,
) -> Float[Array, "length nq"]:
    """Minus the missing torque of the measured motion, M qdd + bias + friction - drive(u), at every sample of one run."""
    nq = chain.nq
    begin, first, last, _ = where

    def step(z: tuple, k: Array) -> tuple[tuple, Array]:
        i = jnp.minimum(begin + k, last)
        command = command_at(samples, i, first, last, reach)
        q, qd, qdd = samples.x[i, :nq], samples.x[i, nq : 2 * nq], samples.x[i, 2 * nq :]
        missing, z = chain.inverse(command, z, q, qd, qdd)
        return z, -missing

    z = chain.start(samples.x[begin, :nq], samples.x[begin, nq : 2 * nq], samples.u[begin]).z
    return _blocks_of(step, z, steps, length, nq)


def _blocks_of(step: Callable, carry: Any, steps: Array, length: int, width: int) -> Array:
    def block(state):
        k, carry, out = state
        carry, y = jax.lax.scan(step, carry, k + jnp.arange(BLOCK, dtype=k.dtype))
        return k + BLOCK, carry, jax.lax.dynamic_update_slice_in_dim(out, y, k, 0)

    state = (jnp.zeros((), jnp.asarray(steps).dtype), carry, jnp.zeros((length, width)))
    return loop_over_time(lambda: jax.lax.while_loop(lambda s: s[0] < steps, block, state)[2])


def reach_of(samples: Samples, record: Record) -> int:
    """EVEN where a run has equal steps to rounding, 0 where to one percent, else how many steps the longest delay may reach
    back, as a power of two."""
    t, h = (np.asarray(a)[record.first : record.last] for a in (samples.t, samples.h))
    if not h.size or np.ptp(h) <= 1e-6 * np.median(h):
        return EVEN
    if np.ptp(h) <= 0.01 * np.median(h):
        return 0
    return bucket(int(np.max(np.arange(t.size) - np.searchsorted(t, t - LONGEST_DELAY_S))) + 2, 8)


#: Blocks of lanes run side by side, one per core; which thread runs a block changes nothing in its result.
_POOL = ThreadPoolExecutor(max_workers=os.cpu_count() or 1, thread_name_prefix="jaxid-lanes")

#: Programs that several groups of lanes need for the first time are compiled side by side.
_COMPILERS = ThreadPoolExecutor(max_workers=os.cpu_count() or 1, thread_name_prefix="jaxid-compile")


def in_float64(program: Callable, *args: Any) -> Any:
    """What a program answers in float64: the setting belongs to a thread, so each that calls one sets it."""
    with float64():
        return program(*args)


class Programs(NamedTuple):
    """The functions of one kind of model: pure prediction of one lane, and jitted outputs and tangents of many."""

    predict: Callable[..., Array]
    outputs: Traced
    tangents: Traced
    losses: dict[Any, Any]
    ready: dict[tuple[str, int], Future | None]  # which are there, by width; what another thread makes ready, as its task


#: So many kinds of programs are kept, those used last. A compiled one of the flexible link takes about 500 regions of memory, of
#: which Linux gives a process 65530: a process that diagnoses one recording after the other would die of them.
KEPT = 48
_PROGRAMS: OrderedDict[Any, Programs] = OrderedDict()
_LOCK = Lock()


def programs_for(layout: Layout, lane: Lane, length: int, reach: int, burn: bool) -> Programs:
    """Programs shared by all engines of the same structure: numbers, data and lengths up to the bucket are arguments."""
    key = (jax.tree.structure(layout.chain), lane, length, reach, burn)
    with _LOCK:
        if key not in _PROGRAMS:
            _PROGRAMS[key] = _programs(layout, lane, length, reach, burn)
        _PROGRAMS.move_to_end(key)
        if len(_PROGRAMS) > KEPT:
            _PROGRAMS.popitem(last=False)
        return _PROGRAMS[key]


def _programs(layout: Layout, lane: Lane, length: int, reach: int, burn: bool) -> Programs:
    def predict(theta, start, where, samples, steps):
        return lane(layout.model(theta), samples, where, start, steps, length, reach, burn)

    def tangent(theta, start, dtheta, dstart, where, samples, steps):
        f = lambda theta, start: predict(theta, start, where, samples, steps)
        return jax.jvp(f, (theta, start), (dtheta, dstart))

    batch = over_lanes(predict, (0, 0, 0, None, None))
    tangents = over_lanes(tangent, (0, 0, 0, 0, 0, None, None))
    about = key_of(lane, layout.model(np.zeros(len(layout))), layout.names, length, reach, burn)
    traced = lambda f, name: Traced(f, about and f"{name}\n{about}")
    return Programs(predict, traced(batch, "outputs"), traced(tangents, "tangents"), {}, {})


def families(layout: Layout) -> dict[str, np.ndarray]:
    """Family of effects -> positions of its numbers, for effects that are no part of the mechanism by default. A family is the
    module that defines its effects."""
    builtin = {kind.name for kind, _ in layout.chain.mechanism.builtin}
    out: dict[str, list[int]] = {}
    for i, e in enumerate(layout.entries):
        if e.owner >= 0 and (effect := layout.chain.effects[e.owner]).name not in builtin:
            out.setdefault(type(effect).__module__, []).append(i)
    return {name: np.array(index) for name, index in out.items()}


def restricted(layout: Layout, kept: frozenset[str]) -> tuple[Layout, np.ndarray]:
    """The layout without the families that are not kept, and the positions of its numbers in the whole."""
    own = families(layout)
    gone = {layout.entries[i].owner for name, index in own.items() if name not in kept for i in index}
    names = [layout.chain.effects[k].name for k in gone]
    small = Layout(layout.chain.without(*names))
    return small, np.array([layout.index(n) for n in small.names])


class Engine:
    """Compiled predictions of a layout on records, with tangents and without, for any number of lanes.

    An effect at its neutral value is the identity, bitwise. So a lane runs in the program of the mechanism and of those families
    of effects that are at work in it, and a chain that holds the whole library at its neutral values costs what it uses.
    """

    def __init__(
        self,
        layout: Layout,
        samples: Samples,
        records: Sequence[Record],
        overrides: np.ndarray,
        lane: Lane,
        length: int = 0,
        whole: bool = False,
        burn: bool = False,
    ):
        """`overrides` [records size]: numbers that a record's experiment states itself, nan elsewhere. `length` is the least
        size of a lane's output, so that engines on other records share one program. `whole` runs every lane in the program of
        all effects, also those that do nothing; `burn` takes the program for records with a lead even if none has one."""
        self.layout, self.records, self.overrides, self.lane = layout, list(records), overrides, lane
        self.length = bucket(max(length, *(r.count + r.lead for r in records)), BLOCK)
        self.compile_time_s = 0.0
        with float64():
            self.samples = Samples(*(jnp.asarray(a) for a in samples))
        reach = max(reach_of(samples, r) for r in self.records)
        self._kind = lane, self.length, reach, burn or any(r.lead for r in self.records)
        self._families = {} if whole else families(layout)
        self._neutral = np.array([e.spec.value for e in layout.entries])
        self._restricted: dict[frozenset[str], tuple[Layout, np.ndarray]] = {}
        self.where = np.array([[r.offset - r.lead, r.first, r.last, r.lead] for r in self.records], np.int32)
        self.steps = np.array([r.count + r.lead for r in self.records], np.int32)

    def theta_of(self, theta: np.ndarray, record: np.ndarray) -> np.ndarray:
        """The numbers in force on each lane's record."""
        stated = self.overrides[record]
        return np.where(np.isnan(stated), theta, stated)

    def outputs(self, theta: np.ndarray, start: np.ndarray, record: np.ndarray, share: float = 1.0) -> np.ndarray:
        """Predictions [lanes length ny]; theta [lanes size], start [lanes 2 nq], record [lanes]; only the first `share`."""
        return self._call("outputs", (self.theta_of(theta, record),), (start,), record, share)[0]

    def output_blocks(
        self, theta: np.ndarray, start: np.ndarray, record: np.ndarray, share: float = 1.0
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """(lanes, predictions) of some lanes at a time, as of `tangent_blocks`."""
        for lanes, (y,) in self._blocks("outputs", (self.theta_of(theta, record),), (start,), record, share):
            yield lanes, y

    def tangents(
        self,
        theta: np.ndarray,
        start: np.ndarray,
        dtheta: np.ndarray,
        dstart: np.ndarray,
        record: np.ndarray,
        share: float = 1.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Predictions and their derivative along (dtheta, dstart), each [lanes length ny]."""
        dtheta = np.where(np.isnan(self.overrides[record]), dtheta, 0.0)
        y, dy = self._call("tangents", (self.theta_of(theta, record), dtheta), (start, dstart), record, share)
        return y, dy

    def tangent_blocks(
        self,
        theta: np.ndarray,
        start: np.ndarray,
        dtheta: np.ndarray,
        dstart: np.ndarray,
        record: np.ndarray,
        share: float = 1.0,
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """(lanes, predictions, derivatives) of some lanes at a time, lanes of one record and candidate one after the other:
        thousands of lanes need not be in memory at once. The arrays may be longer than `lanes`."""
        dtheta = np.where(np.isnan(self.overrides[record]), dtheta, 0.0)
        numbers = self.theta_of(theta, record), dtheta
        for lanes, (y, dy) in self._blocks("tangents", numbers, (start, dstart), record, share):
            yield lanes, y, dy

    def _at_work(self, numbers: tuple[np.ndarray, ...], record: np.ndarray) -> dict[frozenset[str], np.ndarray]:
        """Families at work -> lanes. All lanes of one record and one candidate meet in one program, so that their predictions are
        the same bits."""
        busy = {}
        for name, index in self._families.items():
            theta = np.any(numbers[0][:, index] != self._neutral[index], 1)
            busy[name] = theta | np.any([np.any(d[:, index] != 0, 1) for d in numbers[1:]], 0) if numbers[1:] else theta
        table = np.array(list(busy.values()), bool).reshape(len(busy), len(record)).T
        names = list(busy)
        groups: dict[frozenset[str], list[int]] = {}
        for k, row in enumerate(table):
            groups.setdefault(frozenset(n for n, b in zip(names, row, strict=True) if b), []).append(k)
        return {kept: np.array(lanes) for kept, lanes in groups.items()}

    def _programs_of(self, kept: frozenset[str]) -> tuple[Programs, np.ndarray]:
        if kept not in self._restricted:
            everything = self.layout, np.arange(len(self.layout))
            small, index = restricted(self.layout, kept) if len(kept) < len(self._families) else everything
            self._restricted[kept] = small, index
        small, index = self._restricted[kept]
        return programs_for(small, *self._kind), index

    def _could_work(self, theta: np.ndarray, free: Sequence[int] | np.ndarray) -> frozenset[str]:
        """Families that can be at work where numbers equal theta but in `free`."""
        could = np.zeros(len(theta), bool)
        could[free] = True
        could |= (theta != self._neutral) | np.any(~np.isnan(self.overrides), 0)
        return frozenset(name for name, index in self._families.items() if could[index].any())

    def predictor(self, theta: np.ndarray, free: np.ndarray) -> tuple[Callable[..., Array], dict[Any, Any]]:
        """How one lane runs whose numbers equal theta but in `free`, and the compiled losses made of it.

        (values of the free numbers, which of them the record leaves open, all numbers fixed on the record, start, where,
        samples, steps) -> prediction. Only effects that can then be at work take part, and what the fixed numbers determine
        does not depend on the candidate.
        """
        programs, index = self._programs_of(self._could_work(theta, free))
        place = {int(i): k for k, i in enumerate(free)}

        def predict(values, still_open, fixed, start, where, samples, steps):
            own = lambda i: jnp.where(still_open[place[i]], values[place[i]], fixed[i]) if i in place else fixed[i]
            return programs.predict([own(int(i)) for i in index], start, where, samples, steps)

        return predict, programs.losses.setdefault((tuple(index), tuple(place)), {})

    def read_ahead(self) -> None:
        """Begins to read the programs that predict each family of effects by itself, where they lie on disk."""
        for family in self._families:
            self._begin("outputs", frozenset([family]), also_compile=False)

    def compile_ahead(self, name: str, theta: np.ndarray, free: Sequence[int] | np.ndarray) -> None:
        """Begins to compile `outputs` or `tangents` of where numbers equal theta but in `free`."""
        self._begin(name, self._could_work(theta, free), also_compile=True)
        self._begin(name, self._could_work(theta, free), also_compile=False, width=FEW)

    def _begin(self, name: str, kept: frozenset[str], also_compile: bool, width: int = LANES) -> None:
        """Has a program made ready by another thread, which runs it for no step; one that does not lie on disk only where
        `also_compile`."""
        programs, index = self._programs_of(kept)
        if (name, width) in programs.ready:
            return
        point = np.repeat(self._neutral[None, index], width, 0), np.zeros((width, 2 * self.layout.chain.nq))
        along = (np.zeros_like(point[0]), point[1]) if name == "tangents" else ()
        args = *point, *along, np.repeat(self.where[:1], width, 0), self.samples, np.int32(0)
        program = getattr(programs, name)
        if also_compile or program.kept(*args):
            programs.ready[name, width] = _COMPILERS.submit(in_float64, program, *args)

    def _call(self, name: str, numbers, states, record: np.ndarray, share: float) -> list[np.ndarray]:
        results: list[np.ndarray] = []
        for lanes, out in self._blocks(name, numbers, states, record, share):
            if not results:
                results = [np.empty((record.size, *o.shape[1:])) for o in out]
            for r, o in zip(results, out, strict=True):
                r[lanes] = o[: lanes.size]
        return results

    def _blocks(self, name: str, numbers, states, record: np.ndarray, share: float) -> Iterator[tuple[np.ndarray, tuple]]:
        """(lanes, their outputs and padding) block by block, a few blocks ahead of who takes them."""
        steps = np.ceil(self.steps[record] * share).astype(np.int32)
        width = FEW if record.size <= FEW * min(2, os.cpu_count() or 1) else LANES  # the same bits, as measured
        jobs: list[Callable[[], tuple[np.ndarray, tuple]]] = []
        first: list[Callable[[], tuple[np.ndarray, tuple]]] = []
        for kept, lanes in self._at_work(numbers, record).items():
            programs, index = self._programs_of(kept)
            program, own = getattr(programs, name), [a[:, index] for a in numbers]
            lanes = lanes[np.argsort(-steps[lanes], kind="stable")]  # longest first, so that a block holds lanes of like length
            blocks = [
                partial(self._block, program, own, states, record, lanes[k : k + width], steps[lanes[k]], width)
                for k in range(0, lanes.size, width)
            ]
            if (name, width) not in programs.ready:
                first.append(blocks.pop(0))
            elif (begun := programs.ready[name, width]) is not None:
                waited = time.perf_counter()
                begun.result()
                self.compile_time_s += time.perf_counter() - waited
            programs.ready[name, width] = None
            jobs += blocks
        if first:  # the first call of a program compiles it
            began = time.perf_counter()
            done = list(_COMPILERS.map(lambda job: job(), first))
            self.compile_time_s += time.perf_counter() - began
            yield from done
        yield from ahead(jobs)

    def _block(self, program: Callable, numbers, states, record: np.ndarray, lanes: np.ndarray, steps: Any, width: int):
        padded = np.concatenate([lanes, np.repeat(lanes[-1:], width - lanes.size)])
        arrays = [a[padded] for pair in zip(numbers, states, strict=True) for a in pair]
        out = in_float64(program, *arrays, self.where[record[padded]], self.samples, steps)
        return lanes, tuple(np.asarray(o) for o in (out if isinstance(out, tuple) else (out,)))


def ahead(jobs: Sequence[Callable[[], Any]]) -> Iterator[Any]:
    """Results of jobs in their order, computed side by side no more than a few ahead: what is taken need not be kept."""
    if len(jobs) < 2:
        yield from (job() for job in jobs)
        return
    waiting: deque[Future] = deque()
    for job in jobs:
        waiting.append(_POOL.submit(job))
        if len(waiting) > 2 * (os.cpu_count() or 1):
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
