"""Simulation of many candidates: lanes of one compiled program.

A lane is one candidate on one record, with one tangent direction. Candidates, parameters and
records share ONE flat batch axis in blocks of one size: the program never recompiles because a
number changed, a lane's result does not depend on its neighbours (bitwise), and a lane that
diverges costs the others nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import chain
from threading import Lock
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxid.dynamics.effect import RecordEffect
from jaxid.dynamics.parameter_vector import ChainForm, ParameterVector
from jaxid.numerics.batch_loop import batched_vmap
from jaxid.numerics.export_cache import ExportedFunction, key_of
from jaxid.numerics.kept import shared
from jaxid.numerics.pool import Pool
from jaxid.numerics.precision import float64
from jaxid.simulation.families import families, restricted, with_states
from jaxid.simulation.rollout import Lane, reach_of, WINDOWED
from jaxid.simulation.sample_buffers import BLOCK, bucket, LONG, Record, Samples
from jaxid.simulation.windows import windowed, Windows


T = TypeVar("T")

#: Lanes of one block: enough for vector code, few enough that a call of a few of them does not wait
#: for many that nobody asked.
LANES = 16

#: A call that does not come again takes the program of all effects, up to this many steps, where it
#: would need several that hold several families each: compiling those takes longer.
ONCE = 4_000_000

#: Blocks of lanes run side by side, one per core; which thread runs a block changes nothing in its
#: result.
_POOL = Pool("lanes")

#: Programs that several groups of lanes need for the first time are compiled side by side.
_COMPILERS = Pool("compile")


def in_float64(program: Callable, *args: Any) -> Any:
    """What a program answers in float64: the setting belongs to a thread, so each that calls one
    sets it.
    """
    with float64():
        return program(*args)


class Programs(NamedTuple):
    """The functions of one kind of model: pure prediction of one lane, and jitted outputs and
    tangents of many.
    """

    predict: Callable[..., Array]
    outputs: ExportedFunction
    tangents: ExportedFunction
    output_windows: (
        ExportedFunction  # the same of a window of steps: see `jaxid.simulation.windows`
    )
    tangent_windows: ExportedFunction
    begins: Callable[..., Any]
    losses: dict[Any, Any]
    ready: set[str]  # names of those that can be called
    making: dict[str, Lock]

    @contextmanager
    def first_call(self, name: str) -> Iterator[None]:
        """Around a call that may be the first of a program, and so compiles it: others wait for its
        end.
        """
        with self.making.setdefault(name, Lock()):
            yield
            self.ready.add(name)

    def in_hand(self, name: str) -> bool:
        """Whether some thread compiles a program just now."""
        return (lock := self.making.get(name)) is not None and lock.locked()


def programs_for(
    layout: ParameterVector, lane: Lane, length: int, reach: int, burn: bool
) -> Programs:
    """Programs shared by all engines of the same structure: numbers, data and lengths up to the
    bucket are arguments.
    """
    form = layout.form
    return shared(
        "lanes",
        (form, lane, length, reach, burn),
        lambda: _programs(form, lane, length, reach, burn),
    )


def _programs(form: ChainForm, lane: Lane, length: int, reach: int, burn: bool) -> Programs:
    def predict(theta, start, where, samples, steps):
        return lane(form.model(theta), samples, where, start, steps, length, reach, burn)

    def tangent(theta, start, dtheta, dstart, where, samples, steps):
        def f(theta, start):
            return predict(theta, start, where, samples, steps)

        return jax.jvp(f, (theta, start), (dtheta, dstart))

    batch = batched_vmap(predict, (0, 0, 0, None, None))
    tangents = batched_vmap(tangent, (0, 0, 0, 0, 0, None, None))
    about = key_of(lane, form.bare, length, reach, burn)

    def traced(f, name):
        return ExportedFunction(f, about and f"{name}\n{about}")

    whole = traced(batch, "outputs"), traced(tangents, "tangents")
    parts = windowed(form, lane, reach, burn)
    part = traced(parts.outputs, "output windows"), traced(parts.tangents, "tangent windows")
    return Programs(predict, *whole, *part, parts.begins, {}, set(), {})


class BatchSimulator:
    """Compiled predictions of a layout on records, with tangents and without, for any number of
    lanes.

    An effect at its neutral value is the identity, bitwise. So a lane runs in the program of the
    mechanism and of those families of effects that are at work in it, and a chain that holds the
    whole library at its neutral values costs what it uses.
    """

    def __init__(
        self,
        layout: ParameterVector,
        samples: Samples,
        records: Sequence[Record],
        overrides: np.ndarray,
        lane: Lane,
        length: int = 0,
        whole: bool = False,
        burn: bool = False,
    ):
        """`overrides` [records size]: numbers that a record's experiment states itself, nan
        elsewhere. `length` is the least size of a lane's output, so that engines on other records
        share one program. `whole` runs every lane in the program of all effects, also those that do
        nothing; `burn` takes the program for records with a lead even if none has one.
        """
        self.layout, self.records = layout, list(records)
        self.overrides, self.lane = overrides, lane
        self.length = bucket(max(length, *(r.count + r.lead for r in records)), BLOCK)
        self.compile_time_s, self.simulated = 0.0, 0  # steps of all lanes so far
        self.long = self.length > LONG and lane in WINDOWED
        with float64():
            self.samples = Samples(*(jnp.asarray(a) for a in samples))
        reach = max(reach_of(samples, r) for r in self.records)
        self.reach = reach
        self._kind = (lane, self.length, reach)
        self._burn = burn or any(r.lead for r in self.records)
        self._families = {} if whole else families(layout)
        self._neutral = np.array([e.spec.value for e in layout.entries])
        self._restricted: dict[frozenset[str], tuple[ParameterVector, np.ndarray, bool]] = {}
        self.where = np.array([[r.offset, r.first, r.last, r.lead] for r in self.records], np.int32)
        self.steps = np.array([r.count for r in self.records], np.int32)
        memory = with_states(layout) if self._burn else []
        self._memory = np.array(memory, int)
        optional = set(chain.from_iterable(self._families.values()))
        self._always = layout.chain.mechanism.hidden_states or not set(memory) <= optional

    def keep_together(self, apart: bool = False) -> None:
        """From now on every lane runs in the program of all effects: one compilation, where few
        effects are asked. `apart`: lanes without any stay in the program without.
        """
        every = list(self._families.values())
        self._families = {"every effect": np.concatenate(every)} if apart and every else {}

    def theta_of(self, theta: np.ndarray, record: np.ndarray) -> np.ndarray:
        """The numbers in force on each lane's record."""
        stated = self.overrides[record]
        return np.where(np.isnan(stated), theta, stated)

    def outputs(
        self,
        theta: np.ndarray,
        start: np.ndarray,
        record: np.ndarray,
        share: float = 1.0,
        once: bool = False,
    ) -> np.ndarray:
        """Predictions [lanes length ny]; theta [lanes size], start [lanes 2 nq], record [lanes];
        only the first `share`. `once`: such a call does not come again.
        """
        if self.long and (own := self.windows(theta, start, record, share)):
            return own.together(self.length)
        return self._call(
            "outputs", (self.theta_of(theta, record),), (start,), record, share, once
        )[0]

    def output_blocks(
        self, theta: np.ndarray, start: np.ndarray, record: np.ndarray, share: float = 1.0
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """(lanes, predictions) of some lanes at a time, as of `tangent_blocks`."""
        for lanes, (y,) in self._blocks(
            "outputs", (self.theta_of(theta, record),), (start,), record, share
        ):
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
        y, dy = self._call(
            "tangents", (self.theta_of(theta, record), dtheta), (start, dstart), record, share
        )
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
        """(lanes, predictions, derivatives) of some lanes at a time, lanes of one record and
        candidate one after the other: thousands of lanes need not be in memory at once. The arrays
        may be longer than `lanes`.
        """
        dtheta = np.where(np.isnan(self.overrides[record]), dtheta, 0.0)
        numbers = self.theta_of(theta, record), dtheta
        for lanes, (y, dy) in self._blocks("tangents", numbers, (start, dstart), record, share):
            yield lanes, y, dy

    def windows(
        self,
        theta: np.ndarray,
        start: np.ndarray,
        record: np.ndarray,
        share: float = 1.0,
        along: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> Windows | None:
        """The lanes of `outputs`, or with `along` (dtheta, dstart) of `tangents`, window by window,
        all in one program.

        None where records are short, or where their series is made of the whole.
        """
        if not self.long:
            return None
        numbers, states = [self.theta_of(theta, record)], [start]
        if along is not None:
            numbers, states = (
                [*numbers, np.where(np.isnan(self.overrides[record]), along[0], 0.0)],
                [*states, along[1]],
            )
        busy = np.any([numbers[0] != self._neutral, *(d != 0 for d in numbers[1:])], 0)
        kept = self._families_of(np.any(busy, 0))
        programs, index = self._programs_of(kept)
        chain = self._restricted[kept][0].chain
        if any(True for _ in chain.at(RecordEffect)):
            return None
        where = self._where(np.broadcast_to(np.any(busy, 0), busy.shape), record)
        steps = np.ceil(self.steps[record] * share).astype(np.int32) + where[:, 3]
        self.simulated += int(steps.sum())
        return Windows(self, programs, index, numbers, states, where, steps)

    def _at_work(self, busy: np.ndarray) -> dict[frozenset[str], np.ndarray]:
        """Families at work -> lanes, of which numbers at work [lanes size]. An effect at its
        neutral value is the identity, so that a lane predicts the same in each of these programs,
        but for rounding where XLA fuses them differently.
        """
        names = list(self._families)
        table = (
            np.array([np.any(busy[:, index], 1) for index in self._families.values()], bool)
            .reshape(len(names), len(busy))
            .T
        )
        groups: dict[frozenset[str], list[int]] = {}
        for k, row in enumerate(table):
            groups.setdefault(
                frozenset(n for n, b in zip(names, row, strict=True) if b), []
            ).append(k)
        return {kept: np.array(lanes) for kept, lanes in groups.items()}

    def _merged(
        self, groups: dict[frozenset[str], np.ndarray], steps: np.ndarray
    ) -> dict[frozenset[str], np.ndarray]:
        """The lanes of a call that does not come again, by the programs in which they run: see
        `ONCE`.
        """
        mixed = [kept for kept in groups if len(kept) > 1]
        lanes = (
            np.sort(np.concatenate([groups[kept] for kept in mixed]))
            if len(mixed) > 1
            else np.zeros(0, int)
        )
        if not lanes.size or steps[lanes].sum() > ONCE:
            return groups
        return {kept: own for kept, own in groups.items() if kept not in mixed} | {
            frozenset(self._families): lanes
        }

    def _programs_of(self, kept: frozenset[str]) -> tuple[Programs, np.ndarray]:
        if kept not in self._restricted:
            everything = self.layout, np.arange(len(self.layout))
            small, index = (
                restricted(self.layout, kept) if len(kept) < len(self._families) else everything
            )
            self._restricted[kept] = small, index, self.burns(small)
        small, index, burns = self._restricted[kept]
        return programs_for(small, *self._kind, burns), index

    def _could_work(self, theta: np.ndarray, free: Sequence[int] | np.ndarray) -> np.ndarray:
        """Which numbers can be off their neutral values [size] where they equal theta but in
        `free`.
        """
        could = (theta != self._neutral) | np.any(~np.isnan(self.overrides), 0)
        could[np.asarray(free, int)] = True
        return could

    def _families_of(self, could: np.ndarray) -> frozenset[str]:
        return frozenset(name for name, index in self._families.items() if could[index].any())

    def bounds(
        self, theta: np.ndarray, free: np.ndarray, record: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """`where` [records 4] and `steps` [records] for lanes of the program that `predictor` makes
        of theta and `free`.
        """
        busy = np.broadcast_to(self._could_work(theta, free), (len(record), len(theta)))
        where = self._where(busy, np.asarray(record, int))
        return where, self.steps[record] + where[:, 3]

    def _where(self, busy: np.ndarray, record: np.ndarray) -> np.ndarray:
        """`where` of lanes whose numbers are at work where `busy` [lanes size]: nothing follows the
        measured motion before a record if nothing would remember it.
        """
        where = self.where[record]
        if self._burn and not self._always:
            where[~np.any(busy[:, self._memory], 1), 3] = 0
        return where

    def predictor(
        self, theta: np.ndarray, free: np.ndarray
    ) -> tuple[Callable[..., Array], dict[Any, Any]]:
        """How one lane runs whose numbers equal theta but in `free`, and the compiled losses made
        of it.

        (values of the free numbers, which of them the record leaves open, all numbers fixed on the
        record, start, where, samples, steps) -> prediction. Only effects that can then be at work
        take part, and what the fixed numbers determine does not depend on the candidate.
        """
        programs, index = self._programs_of(self._families_of(self._could_work(theta, free)))
        place = {int(i): k for k, i in enumerate(free)}

        def predict(values, still_open, fixed, start, where, samples, steps):
            def own(i):
                return (
                    jnp.where(still_open[place[i]], values[place[i]], fixed[i])
                    if i in place
                    else fixed[i]
                )

            return programs.predict([own(int(i)) for i in index], start, where, samples, steps)

        return predict, programs.losses.setdefault((tuple(index), tuple(place)), {})

    def free_layout(
        self, theta: np.ndarray, free: np.ndarray
    ) -> tuple[ParameterVector, np.ndarray]:
        """The layout of the effects that can be at work where numbers equal theta but in `free`,
        and the positions of its numbers in the whole.
        """
        kept = self._families_of(self._could_work(theta, free))
        self._programs_of(kept)
        return self._restricted[kept][:2]

    def burns(self, layout: ParameterVector) -> bool:
        """Whether lanes of a layout know a lead, in which effects follow the measured motion."""
        return self._burn and layout.chain.has_states()

    def read_ahead(self) -> None:
        """Begins to read the programs that predict each family of effects by itself, where they lie
        on disk.
        """
        for family in self._families:
            self._begin("outputs", frozenset([family]), also_compile=False)

    def compile_ahead(self, name: str, theta: np.ndarray, free: Sequence[int] | np.ndarray) -> None:
        """Begins to compile `outputs` or `tangents` of where numbers equal theta but in `free`."""
        self._begin(name, self._families_of(self._could_work(theta, free)), also_compile=True)

    def _begin(self, name: str, kept: frozenset[str], also_compile: bool) -> None:
        """Has a program made ready by another thread, which runs it for no step; one that does not
        lie on disk only where `also_compile`. Long records have programs of their own.
        """
        if self.long:
            return
        programs, index = self._programs_of(kept)
        if name in programs.making:
            return
        point = (
            np.repeat(self._neutral[None, index], LANES, 0),
            np.zeros((LANES, 2 * self.layout.chain.nq)),
        )
        along = (np.zeros_like(point[0]), point[1]) if name == "tangents" else ()
        args = *point, *along, np.repeat(self.where[:1], LANES, 0), self.samples, np.int32(0)
        program = getattr(programs, name)
        if also_compile or program.kept(*args):
            _COMPILERS.submit(self._first, programs, name, partial(program, *args))

    @staticmethod
    def _first(programs: Programs, name: str, call: Callable[[], T]) -> T:
        with programs.first_call(name):
            return call()

    def _call(
        self, name: str, numbers, states, record: np.ndarray, share: float, once: bool = False
    ) -> list[np.ndarray]:
        results: list[np.ndarray] = []
        for lanes, out in self._blocks(name, numbers, states, record, share, once):
            if not results:
                results = [np.empty((record.size, *o.shape[1:])) for o in out]
            for r, o in zip(results, out, strict=True):
                r[lanes] = o[: lanes.size]
        return results

    def _blocks(
        self, name: str, numbers, states, record: np.ndarray, share: float, once: bool = False
    ) -> Iterator[tuple[np.ndarray, tuple]]:
        """(lanes, their outputs and padding) block by block, a few blocks ahead of who takes
        them.
        """
        busy = np.any([numbers[0] != self._neutral, *(d != 0 for d in numbers[1:])], 0)
        where = self._where(busy, record)
        steps = np.ceil(self.steps[record] * share).astype(np.int32) + where[:, 3]
        self.simulated += int(steps.sum())
        jobs: list[Callable[[], tuple[np.ndarray, tuple]]] = []
        first: list[Callable[[], tuple[np.ndarray, tuple]]] = []
        awaited: list[Callable[[], tuple[np.ndarray, tuple]]] = []
        groups = self._at_work(busy)
        for kept, lanes in (self._merged(groups, steps) if once else groups).items():
            programs, index = self._programs_of(kept)
            program, own = getattr(programs, name), [a[:, index] for a in numbers]
            lanes = lanes[
                np.argsort(-steps[lanes], kind="stable")
            ]  # longest first, so that a block holds lanes of like length
            blocks = [
                partial(
                    self._block, program, own, states, where, lanes[k : k + LANES], steps[lanes[k]]
                )
                for k in range(0, lanes.size, LANES)
            ]
            if name not in programs.ready:
                calls = awaited if programs.in_hand(name) else first
                calls.append(partial(self._first, programs, name, blocks.pop(0)))
            jobs += blocks
        if first or awaited:  # the first call of a program compiles it
            began = time.perf_counter()
            done = [*_COMPILERS.map(lambda call: call(), first), *(call() for call in awaited)]
            self.compile_time_s += time.perf_counter() - began
            yield from done
        yield from _POOL.ahead(jobs)

    def _block(
        self, program: Callable, numbers, states, where: np.ndarray, lanes: np.ndarray, steps: Any
    ):
        padded = np.concatenate([lanes, np.repeat(lanes[-1:], LANES - lanes.size)])
        pairs = zip(numbers, states, strict=True)
        arrays = [a[padded] for a in chain.from_iterable(pairs)]
        out = in_float64(program, *arrays, where[padded], self.samples, steps)
        found = out if isinstance(out, tuple) else (out,)
        return lanes, tuple(map(np.asarray, found))
