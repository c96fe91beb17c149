"""The samples of a measured motion at which the missing force is looked at, under any reading of its
channels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True)
class FilteredInput:
    """The inputs of a run, filtered: `t [time]`, `u [time nu]`, and the times [rows] at which the
    motion is looked at.
    """

    t: Float[np.ndarray, " time"]
    u: Float[np.ndarray, "time nu"]
    at: Float[np.ndarray, " rows"]


@dataclass(frozen=True)
class SampledMotion:
    """Samples of all runs that are looked at: [samples n], SI, `each` neighbours in a row for one
    row, over which both sides of the equation are averaged. `since [rows]` is the time since the
    run began, `weight [rows nq]` 0 where a joint stands still, `held [rows]` marks what is kept for
    judging. Input j is the sources' columns times `mix [nu nu]`, taken `rows [nu]` later, and the
    later the longer the run by `drift [nu]` s/s.
    """

    q: Float[np.ndarray, "samples nq"]
    qd: Float[np.ndarray, "samples nq"]
    qdd: Float[np.ndarray, "samples nq"]
    since: Float[np.ndarray, " rows"]
    weight: Float[np.ndarray, "rows nq"]
    held: Bool[np.ndarray, " rows"]
    block: Int[np.ndarray, " rows"]
    step: float
    sources: tuple[FilteredInput, ...]
    mix: Float[np.ndarray, "nu nu"]
    rows: Float[np.ndarray, " nu"]
    drift: Float[np.ndarray, " nu"]
    each: int = 1

    def mean(self, x: Float[np.ndarray, "samples ..."]) -> Float[np.ndarray, "rows ..."]:
        """A series at the samples [samples ...] as rows [rows ...]."""
        return x if self.each == 1 else x.reshape(-1, self.each, *x.shape[1:]).mean(1)

    @cached_property
    def u(self) -> Float[np.ndarray, "samples nu"]:
        """Inputs at the samples, [samples nu]."""
        out = np.zeros((len(self.q), len(self.mix)))
        first = 0
        for s in self.sources:
            part = slice(first, first := first + len(s.at))
            for j in range(len(self.mix)):
                at = s.at + self.rows[j] * self.step + self.drift[j] * (s.at - s.t[0])
                for i in np.flatnonzero(self.mix[:, j]):
                    out[part, j] += self.mix[i, j] * np.interp(at, s.t, s.u[:, i])
        return out

    def thinned(self, count: int) -> SampledMotion:
        """Every n-th row, so that about `count` are left."""
        rows = np.arange(0, len(self.held), max(1, -(-len(self.held) // count)))
        samples = (rows[:, None] * self.each + np.arange(self.each)).ravel()
        sources, first = [], 0
        for s in self.sources:
            own = samples[(samples >= first) & (samples < first + len(s.at))] - first
            sources.append(replace(s, at=s.at[own]))
            first += len(s.at)

        return replace(
            self,
            q=self.q[samples],
            qd=self.qd[samples],
            qdd=self.qdd[samples],
            since=self.since[rows],
            weight=self.weight[rows],
            held=self.held[rows],
            block=self.block[rows],
            sources=tuple(sources),
        )
