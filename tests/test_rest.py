"""Joints that come to rest: derivatives there, and the numbers of a coast-down."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxid
from jaxid.dynamics.dry_friction import solve_dry
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.numerics.precision import float64
from jaxid.problem.binding import bind


FORCES = (0.0, 1e-300, 1e-164, 1e-30, 1e-9, 0.3, 5.0)


@pytest.fixture(scope="module")
def end_velocities():
    """End velocities of a step of joints by (start velocities, velocity changes of the force, dry
    level): value and tangent.
    """

    def programs(nq: int):
        A = jnp.eye(nq) * 0.5 + 0.1 * jnp.ones((nq, nq))

        def end(v0, push, level):
            levels = jnp.broadcast_to(level, (nq,))
            return solve_dry(v0, v0 + push, A, levels, levels, jnp.zeros(nq), 0.0)[1]

        return jax.jit(end), jax.jit(lambda p, dp: jax.jvp(end, p, dp)[1])

    with float64():
        yield {nq: programs(nq) for nq in (1, 2)}


@pytest.mark.parametrize("nq", [1, 2])
@pytest.mark.parametrize("force", FORCES)
@pytest.mark.parametrize("speed", [0.0, 1e-200, 1e-12, 0.05, 2.0])
def test_tangents_agree_with_differences_at_and_near_rest(end_velocities, nq, force, speed):
    value, tangent = end_velocities[nq]
    with float64():
        v0, push, level = jnp.full(nq, speed), jnp.full(nq, -force), jnp.asarray(0.7)
        for way in (
            (jnp.zeros(nq), jnp.zeros(nq), jnp.asarray(1.0)),
            (jnp.ones(nq), jnp.zeros(nq), jnp.asarray(0.0)),
        ):
            d = np.asarray(tangent((v0, push, level), way))
            assert np.isfinite(d).all()
            h = 1e-7
            ends = [
                np.asarray(
                    value(*(a + s * h * b for a, b in zip((v0, push, level), way, strict=True)))
                )
                for s in (1, 0, -1)
            ]
            sides = (ends[0] - ends[1]) / h, (ends[1] - ends[2]) / h
            low, high = (
                np.minimum(*sides),
                np.maximum(*sides),
            )  # at a kink any slope between those of its sides is one
            assert (d >= low - 1e-5).all() and (d <= high + 1e-5).all()


def coast_down(seed: int, inertia=0.01, viscous=0.005, coulomb=0.02, noise=1e-3):
    """Two pulses of torque, after each of which the joint coasts to rest and stands; by the closed
    form of each stretch.
    """
    t = np.arange(0, 6, 0.01)
    tau = np.where(t < 0.5, 0.1, np.where((t >= 3) & (t < 3.5), -0.12, 0.0))
    q, v, out = 0.0, 0.0, []
    for u in tau:
        out.append(q)
        left = 0.01
        while left > 0:
            direction = np.sign(v) or (np.sign(u) if abs(u) > coulomb else 0.0)
            if direction == 0:
                break
            w = (u - direction * coulomb) / viscous  # where the speed would settle
            k = viscous / inertia
            stop = np.log((v - w) / -w) / k if (v - w) / -w > 1 else np.inf
            s = min(left, stop)
            q += w * s + (v - w) * (1 - np.exp(-k * s)) / k
            v = 0.0 if s == stop else w + (v - w) * np.exp(-k * s)
            left -= s
    y = np.array(out) + noise * np.random.default_rng(seed).standard_normal(len(t))
    return jaxid.Dataset.from_arrays(
        t, {"tau": tau}, {"q": y}, noise_std={"q": noise}, at_rest=True
    )


TRUE = {"inertia": 0.01, "viscous": 0.005, "coulomb": 0.02}


def deviations(fit) -> dict[str, float]:
    """How many standard deviations each number lies from the truth."""
    return {
        name: (fit.parameters[name].value - value) / fit.parameters[name].std
        for name, value in TRUE.items()
    }


@pytest.mark.slow
def test_a_coast_to_rest_without_any_force_is_recovered():
    off = []
    for seed in range(20):
        fit = jaxid.fit("joint", coast_down(seed), without=("constant_torque",))
        assert fit.state == "converged" and fit.loss < 1.3
        off += deviations(fit).values()
    assert np.mean(np.abs(off) < 1.96) > 0.85 and max(map(abs, off)) < 4.5


def test_where_a_joint_stands_within_a_step_of_its_encoder_is_told_by_the_steps_that_follow():
    step, stands = 2e-3, 60
    clean = coast_down(0, noise=1e-12).experiments[0]
    tau, q = (np.concatenate([np.zeros(stands), x[:, 0]]) for x in (clean.u, clean.y))
    data = jaxid.Dataset.from_arrays(
        0.01 * np.arange(len(q)),
        {"tau": tau},
        {"q": step * np.round(q / step + 0.45)},
        resolution={"q": step},
        at_rest=True,
    )
    with float64():
        b = bind("joint", data, without=("constant_torque",))
        theta = np.array([TRUE[name] for name in b.layout.names])
        start = estimate_starts(ProblemBuilder(b), "fit", [theta])
    assert abs(start[0, 0, 0] - 0.45 * step) < 0.1 * step
