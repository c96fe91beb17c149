"""Draws from a density over a box by the no-U-turn sampler of blackjax, several chains at once.

A number between its bounds is z = lower + s (softplus(u) - softplus(u - (upper - lower) / s)): a
straight line but for the last s to either bound, s being about its standard deviation. Its
log |dz / du| joins the density, so that z itself is flat between its bounds. The chains move in w,
with u = centre + L w and L from the curvature at the fit: what the data say is then about a
standard normal distribution.

Hoffman and Gelman 2014 (NUTS); Stan's warm-up in windows (step and mass matrix).
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, FIRST_EXCEPTION, wait
from dataclasses import dataclass
from threading import Lock
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import UsageError
from jaxid.base.extras import needed
from jaxid.fitting.fitter import Progress
from jaxid.numerics.pool import Pool
from jaxid.numerics.precision import float64
from jaxid.problem.pure_problem import log_density_of, Problem


#: Draws that a chain makes before it tells how far it is.
BLOCK = 50
#: A bound that is further away is none, in units of the edge.
FAR = 1e8
#: Mean acceptance that the step is set for: shorter steps than the usual 0.8 do not diverge where a
#: number stands at its bound.
ACCEPTED = 0.9
#: Seconds between two words on how far the chains are.
TELL_S = 0.3
#: How often a chain's first point is drawn nearer to the fit before it is given up.
NEARER = 30


@dataclass(frozen=True)
class Sampling:
    """How much is drawn: `chains` of `draws` that are kept each, after `warmup` that are not."""

    chains: int = 4
    draws: int = 500
    warmup: int = 200

    def __post_init__(self):
        if self.chains < 2:
            raise UsageError("one chain cannot show that it has converged; sample with 2 or more")
        if self.draws < 2 * BLOCK or self.warmup < 2 * BLOCK:
            raise UsageError(f"a chain needs at least {2 * BLOCK} draws and as many to warm up")


class Draws(NamedTuple):
    """Of every chain and draw: z [chains draws size], the log-density there, whether the step
    diverged, the acceptance rate and the number of leapfrog steps [chains draws].
    """

    z: np.ndarray
    log_density: np.ndarray
    diverging: np.ndarray
    acceptance: np.ndarray
    steps: np.ndarray


class Box(eqx.Module):
    """Numbers within bounds as w of the whole space: see the module."""

    lower: Float[Array, " size"]
    edge: Float[Array, " size"]
    room: Float[Array, " size"]  # (upper - lower) / edge
    centre: Float[Array, " size"]
    spread: Float[Array, "size size"]  # L

    @classmethod
    def about(
        cls,
        lower: Float[np.ndarray, " size"],
        upper: Float[np.ndarray, " size"],
        z: Float[np.ndarray, " size"],
        curvature: Float[np.ndarray, "size size"],
    ) -> Box:
        """The space about z, where -log density has this curvature in z."""
        std = 1 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
        edge = np.minimum(std, (upper - lower) / 4)
        low = np.maximum(lower, z - FAR * edge)
        high = np.minimum(upper, z + FAR * edge)
        room = (high - low) / edge
        # A fit at its bound begins a standard deviation inside of it.
        inside = np.clip((z - low) / edge, 1.0, room - 1.0)
        u = inside + np.log(-np.expm1(-inside)) - np.log(-np.expm1(inside - room))
        slope = edge * _sigmoid(u) * _sigmoid(room - u)
        precision = curvature * slope * slope[:, None] + np.diag(12 / room**2)
        spread = np.linalg.inv(np.linalg.cholesky(precision)).T
        return cls(*(jnp.asarray(a) for a in (low, edge, room, u, spread)))

    def z(self, w: Float[Array, " size"]) -> Float[Array, " size"]:
        """The numbers of w."""
        u = self.centre + self.spread @ w
        inside = jax.nn.softplus(u) - jax.nn.softplus(u - self.room)
        return self.lower + self.edge * inside

    def log_slope(self, w: Float[Array, " size"]) -> Float[Array, ""]:
        """log |dz / dw| but for a constant."""
        u = self.centre + self.spread @ w
        return jnp.sum(jax.nn.log_sigmoid(u) + jax.nn.log_sigmoid(self.room - u))


def _sigmoid(u: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-u))


def density_in_box(w: Array, box: Box, problem: Problem) -> Float[Array, ""]:
    """The problem's log-density of w."""
    return log_density_of(box.z(w), problem) + box.log_slope(w)


Density = Callable[[Array, Box, Any], Array]


def sample(
    density: Density,
    box: Box,
    data: Any,
    sampling: Sampling,
    seed: int = 0,
    progress: Progress | None = None,
) -> Draws:
    """Draws of z from `density(w, box, data)`, a log-density of w; chains begin about the centre
    of the box. Raises `UsageError` where the density is no number about there, and where blackjax
    is not installed.
    """
    blackjax = needed("blackjax")
    size = int(box.centre.shape[0])

    def count_step(*_: Any) -> None:
        jax.debug.callback(counter.stepped)

    def warm(key: Array, begin: Array, box: Box, data: Any) -> Any:
        adaptation = blackjax.window_adaptation(
            blackjax.nuts,
            lambda w: density(w, box, data),
            is_mass_matrix_diagonal=False,
            target_acceptance_rate=ACCEPTED,
            adaptation_info_fn=count_step,
        )
        (state, tuned), _ = adaptation.run(key, begin, sampling.warmup)
        return state, tuned["step_size"], tuned["inverse_mass_matrix"]

    def drawn(key: Array, state: Any, tuned: Any, box: Box, data: Any) -> Any:
        kernel = blackjax.nuts(
            lambda w: density(w, box, data), step_size=tuned[0], inverse_mass_matrix=tuned[1]
        )

        def one(state: Any, key: Array) -> Any:
            state, info = kernel.step(key, state)
            kept = (
                box.z(state.position),
                state.logdensity - box.log_slope(state.position),
                info.is_divergent,
                info.acceptance_rate,
                info.num_integration_steps,
            )
            return state, kept

        return jax.lax.scan(one, state, jax.random.split(key, BLOCK))

    blocks = -(-sampling.draws // BLOCK)
    counter = _Counter(progress, sampling, blocks)
    counter.tell()
    with float64():
        keys = jax.random.split(jax.random.key(seed), sampling.chains)
        start = jnp.zeros(size)
        warming = jax.jit(warm).lower(keys[0], start, box, data).compile()
        shape = jax.eval_shape(warm, keys[0], start, box, data)
        drawing = jax.jit(drawn).lower(keys[0], shape[0], shape[1:], box, data).compile()
        value = jax.jit(density)

        def chain(key: Array) -> list[Any]:
            begin, key_warm, key = jax.random.split(key, 3)
            at = _first(value, box, data, begin, size)
            state, *tuned = warming(key_warm, at, box, data)
            jax.block_until_ready(state)
            counter.warmed()
            parts = []
            for _ in range(blocks):
                key, now = jax.random.split(key)
                state, part = drawing(now, state, tuple(tuned), box, data)
                parts.append(jax.tree.map(np.asarray, part))
                counter.drew()
            return [np.concatenate(column)[: sampling.draws] for column in zip(*parts, strict=True)]

        found = _side_by_side(chain, list(keys), counter)
    return Draws(*(np.stack(column) for column in zip(*found, strict=True)))


def _first(value: Any, box: Box, data: Any, key: Array, size: int) -> Array:
    """A point about the fit, wider than what is to be drawn, where the density is a number."""
    away = 1.5 * jax.random.normal(key, (size,))
    for k in range(NEARER):
        point = away * 0.7**k
        if np.isfinite(value(point, box, data)):
            return point
    raise UsageError("the density is not a number about the fit: there is nothing to sample from")


def _side_by_side(
    chain: Callable[[Array], list[Any]], keys: list[Array], counter: _Counter
) -> list[list[Any]]:
    """What each chain draws; how far they are is told from this thread."""
    pool = Pool("chains")
    begun = [pool.submit(chain, key) for key in keys]
    try:
        while wait(begun, timeout=TELL_S, return_when=FIRST_EXCEPTION).not_done:
            if any(b.done() and b.exception() for b in begun):
                break
            counter.tell()
        counter.tell()
        return [b.result() for b in begun]
    finally:
        counter.stopped = True
        pool.close()


class _Counter:
    """How far all chains are, counted in draws, those of the warm-up too; a chain that finds it
    stopped ends with its block.
    """

    def __init__(self, progress: Progress | None, sampling: Sampling, blocks: int):
        self._progress, self._chains = progress, sampling.chains
        self._total = sampling.chains * (sampling.warmup + blocks * BLOCK)
        self._warm, self._made = 0, 0
        self._lock = Lock()
        self.stopped = False

    def stepped(self) -> None:
        """Counts a draw of a warm-up."""
        with self._lock:
            self._made += 1

    def warmed(self) -> None:
        with self._lock:
            self._warm += 1
        self._go_on()

    def drew(self) -> None:
        with self._lock:
            self._made += BLOCK
        self._go_on()

    def _go_on(self) -> None:
        if self.stopped:
            raise CancelledError

    def tell(self) -> None:
        if self._progress is None:
            return
        self._progress("posterior", self._made, self._total, self._doing())

    def _doing(self) -> str:
        if self._made == 0:
            return "compiling, and finding where each chain begins"
        if self._warm < self._chains:
            warming = f"{self._warm} of {self._chains} chains have warmed up"
            return f"{warming} (their first draws are not kept)"
        return f"{self._made} of {self._total} draws"
