"""Many lanes at once against `jax.vmap`, which lays them out otherwise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.models import (
    FlexibleArm,
    Joint,
    MODELS,
    Panda,
    PlanarArm,
    Robot,
    SerialArm,
    SpaceManipulator,
    Tracker,
    UR10e,
)
from jaxid.models.effects import Backlash, DeadZone, StribeckFriction
from jaxid.numerics import batch_loop as lanes
from jaxid.numerics.batch_loop import batched_vmap, laid_out, loop_over_time
from jaxid.numerics.precision import float64
from jaxid.numerics.program_form import scan_counts, UnknownForm, while_counts
from jaxid.simulation.rollout import EVEN, simulate_rollout
from jaxid.simulation.sample_buffers import Samples


def in_blocks(step, carry, steps, width):
    """What each step gives [64 width], by the loop that `loop_over_time` asks for."""

    def block(state):
        k, carry, out = state
        carry, y = jax.lax.scan(step, carry, k + jnp.arange(8))
        return k + 8, carry, jax.lax.dynamic_update_slice_in_dim(out, y, k, 0)

    state = jnp.zeros((), int), carry, jnp.zeros((64, width))
    return loop_over_time(lambda: jax.lax.while_loop(lambda s: s[0] < steps, block, state)[2])


def looped(A, x, table, steps):
    """A loop with what a step may contain: small matrices, a loop that each lane leaves at its own
    time, a table.
    """
    shift = jnp.sum(A, 0)

    def step(carry, k):
        x, total, seen = carry
        y = A @ x + jnp.tanh(shift) * table[k] + jnp.stack([x[1], x[0]])
        y = jnp.where(jnp.max(jnp.abs(y)) > 1, y / jnp.linalg.norm(y), y)
        y, count = jax.lax.while_loop(
            lambda s: jnp.sum(s[0] ** 2) > 0.3, lambda s: (0.7 * s[0], s[1] + 1), (y, 0)
        )
        B = jnp.concatenate([A, jnp.outer(y, y)], 1)[:, ::-1].T.reshape(2, 4)
        total = total + jnp.min(B) * jnp.prod(y) + jnp.any(y > 0.2) + count
        return (y, total, seen.at[1].set(y[0])), jnp.append(y, total)

    return in_blocks(step, (x, jnp.zeros(()), jnp.ones(2)), steps, 3)


def numbers(count: int = 6):
    rng = np.random.default_rng(0)
    return (
        rng.standard_normal((count, 2, 2)),
        rng.standard_normal((count, 2)),
        rng.standard_normal(64),
        43,
    )


AXES = (0, 0, None, None)


def test_lanes_equal_vmap_in_values_and_tangents():
    A, x, table, steps = numbers()

    def slope(A, x, table, steps):
        return jax.jvp(lambda A, x: looped(A, x, table, steps), (A, x), (jnp.ones_like(A), x))

    with float64():
        for f in (looped, slope):
            expected = jax.jit(jax.vmap(f, AXES))(A, x, table, steps)
            for name in ("jit", "plain"):
                run = batched_vmap(f, AXES)
                found = (jax.jit(run) if name == "jit" else run)(A, x, table, steps)
                jax.tree.map(
                    lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-12),
                    found,
                    expected,
                )
    assert (
        np.all(np.asarray(expected[0])[:, 48:] == 0) and np.ptp(np.asarray(expected[0])[:, :48]) > 1
    )


def test_a_lane_does_not_depend_on_its_neighbours():
    A, x, table, steps = numbers()
    with float64():
        run = jax.jit(batched_vmap(looped, AXES))
        before = np.asarray(run(A, x, table, steps))
        A[1:], x[1] = np.nan, 1e300
        assert np.array_equal(np.asarray(run(A, x, table, steps))[0], before[0])


def scalars(A, x, table, steps):
    """A loop whose steps work on single numbers."""

    def step(carry, k):
        a, b = carry
        for n in range(5):
            a, b = jnp.sin(a) + b * table[k], b - 0.1 * n * a * A[0, 0]
        return (a, b), jnp.stack([a, b])

    return in_blocks(step, (x[0], x[1]), steps, 2)


def test_a_large_step_is_left_to_vmap_where_its_matrices_would_be_taken_apart(monkeypatch):
    A, x, table, steps = numbers()

    def text(f):
        return str(jax.make_jaxpr(batched_vmap(f, AXES))(A, x, table, steps))

    with float64():
        apart, single = text(looped).count("f64[6] "), text(scalars)
        monkeypatch.setattr(lanes, "LARGEST_STEP", 10)
        monkeypatch.setattr(lanes, "MOST_TIMES", 1.5)
        assert text(looped).count("f64[6] ") < apart / 4
        assert text(scalars) == single and single.count("f64[6] ") > 20


@pytest.mark.parametrize(
    "mechanism, effects",
    [(Joint, (StribeckFriction(), Backlash())), (PlanarArm, (DeadZone(), StribeckFriction()))],
)
def test_models_move_alike(mechanism, effects):
    chain = Chain(mechanism()).with_effects(*effects)
    layout, n, rng = ParameterVector(chain), 400, np.random.default_rng(1)
    nu, nq = len(chain.signature.inputs), chain.nq
    theta = np.array([e.spec.value for e in layout.entries]) * rng.uniform(
        0.8, 1.2, (3, len(layout))
    )
    with float64():
        t = jnp.arange(n) * 5e-3
        u = jnp.asarray(3 * np.sin(np.arange(n)[:, None] / 40 + np.arange(nu)))
        samples = Samples(
            t=t,
            h=jnp.full(n, 5e-3),
            u=u,
            total=jnp.cumsum(u, 0),
            x=jnp.zeros((n, 3 * nq)),
            other=jnp.zeros((n, 0)),
            y=jnp.zeros((n, nq)),
            w=jnp.ones((n, nq)),
        )
        where = np.tile(np.array([0, 0, n - 1, 0], np.int32), (3, 1))

        def run(theta, start, where, samples, steps):
            return simulate_rollout(
                layout.model(theta), samples, where, start, steps, 512, EVEN, False
            )

        args = theta, np.zeros((3, 2 * nq)), where, samples, n
        found, expected = (
            jax.jit(f(run, (0, 0, 0, None, None)))(*args) for f in (batched_vmap, jax.vmap)
        )
    assert np.ptp(np.asarray(expected)) > 0.1
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


#: Minutes to compile, or another arm of two, six or seven joints, or a tree of bodies.
LONG = FlexibleArm, SerialArm, Panda, UR10e, Robot, SpaceManipulator, Tracker


@pytest.mark.parametrize(
    "mechanism",
    [pytest.param(m, marks=pytest.mark.slow if m in LONG else (), id=m.name) for m in MODELS],
)
def test_every_model_takes_the_quick_path_with_this_jax(mechanism):
    """Values and tangents as `jax.vmap` gives them; `laid_out` raises where it does not know the
    form of a program.
    """
    chain = Chain(mechanism())
    layout, n, rng = ParameterVector(chain), 24, np.random.default_rng(1)
    nu, ny, nq = len(chain.signature.inputs), len(chain.signature.outputs), chain.nq
    theta = np.array([e.spec.value for e in layout.entries]) * rng.uniform(
        0.9, 1.1, (2, len(layout))
    )
    with float64():
        u = jnp.asarray(3 * np.sin(np.arange(n)[:, None] / 5 + np.arange(nu)))
        samples = Samples(
            t=jnp.arange(n) * 5e-3,
            h=jnp.full(n, 5e-3),
            u=u,
            total=jnp.cumsum(u, 0),
            x=jnp.zeros((n, 3 * nq)),
            other=jnp.zeros((n, 0)),
            y=jnp.zeros((n, ny)),
            w=jnp.ones((n, ny)),
        )
        where = np.tile(np.array([0, 0, n - 1, 0], np.int32), (2, 1))

        def run(theta, start, where, samples):
            def lane(theta, start):
                return simulate_rollout(
                    layout.model(theta), samples, where, start, steps, 64, EVEN, False
                )

            if nq > 2:  # the step of a whole arm is mapped anyway
                return lane(theta, start), lane(theta, start + 0.1)
            return jax.jvp(lane, (theta, start), (0.1 * theta, start + 0.1))

        steps = jnp.asarray(n)
        options: Any = {"xla_backend_optimization_level": 0}
        args = theta, np.zeros((2, 2 * nq)), where, samples
        (found, slope), (expected, expected_slope) = (
            jax.jit(f(run, (0, 0, 0, None))).lower(*args).compile(options)(*args)
            for f in (laid_out, jax.vmap)
        )
    assert np.ptp(np.asarray(expected)) > 0 and np.ptp(np.asarray(expected_slope)) > 0
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(slope, expected_slope, rtol=1e-9, atol=1e-9)


def test_an_unknown_form_is_left_to_vmap_and_told_once(monkeypatch):
    A, x, table, steps = numbers()

    def of_tomorrow(eqn):
        raise KeyError("num_consts")

    monkeypatch.setattr(lanes, "scan_counts", of_tomorrow)
    monkeypatch.setattr(lanes, "_noted", [])
    with float64():
        expected = jax.jit(jax.vmap(looped, AXES))(A, x, table, steps)
        with pytest.warns(
            RuntimeWarning, match=r"JAX .* writes programs in a form .*num_consts"
        ) as said:
            for _ in range(2):
                np.testing.assert_allclose(
                    jax.jit(batched_vmap(looped, AXES))(A, x, table, steps),
                    expected,
                    rtol=1e-9,
                    atol=1e-9,
                )
    assert len([w for w in said if "form" in str(w.message)]) == 1


def test_errors_of_the_function_itself_are_those_of_vmap(monkeypatch):
    monkeypatch.setattr(lanes, "_noted", [])
    for f in (batched_vmap, jax.vmap):
        with pytest.raises(TypeError, match="contracting"):
            f(lambda x: x @ jnp.ones((3, 3)))(jnp.ones((4, 2)))
    assert lanes._noted == []


def test_an_equation_that_says_something_else_is_refused():
    def loops(x):
        x, _ = jax.lax.scan(lambda s, k: (s * x, k), x, jnp.arange(3))
        return jax.lax.while_loop(lambda s: jnp.sum(s) < x[0], lambda s: s + x, x)

    def like(e: Any, params: dict, invars: Any = None) -> Any:
        return SimpleNamespace(
            primitive=e.primitive, invars=invars or e.invars, outvars=e.outvars, params=params
        )

    found = {e.primitive.name: e for e in jax.make_jaxpr(loops)(jnp.ones(2)).eqns}
    for name, counts in (("scan", scan_counts), ("while", while_counts)):
        eqn = found[name]
        assert counts(eqn) == counts(like(eqn, dict(eqn.params))) == (1, 1)
        for key in eqn.params.keys() - {
            "length",
            "reverse",
            "unroll",
            "linear",
            "_split_transpose",
        }:
            renamed = {k if k != key else f"{k}_of_tomorrow": v for k, v in eqn.params.items()}
            with pytest.raises(UnknownForm, match=name):
                counts(like(eqn, renamed))
        with pytest.raises(UnknownForm):
            counts(like(eqn, eqn.params, eqn.invars[1:]))
