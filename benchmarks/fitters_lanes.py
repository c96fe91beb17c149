"""What a step of a population costs: the loss of `Problem` against the same scheme written out by
hand in one scan.

The hand-written joint and pendulum step 64 candidates side by side with the same Runge-Kutta scheme
and exact dry friction, held command, and accumulate the weighted square error in the scan; nothing
in them is general. CPU time, interleaved, one thread.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

import jaxid  # noqa: E402
from jaxid.fitting.problem_builder import ProblemBuilder  # noqa: E402
from jaxid.numerics.fast_math import sin  # noqa: E402
from jaxid.numerics.precision import float64  # noqa: E402
from jaxid.problem.binding import bind  # noqa: E402
from jaxid.problem.residual import OutputError  # noqa: E402
from tests import reference as ref  # noqa: E402


LANES = 64


def recording(model: str) -> jaxid.Dataset:
    t = np.arange(401) * 0.01
    u = ref.multisine(t, [1.0], 0, periods=2)
    u[:20] = 0.0
    plant = ref.pendulum(0.06, 1.3) if model == "pendulum" else ref.joint(0.12)
    q, _ = ref.simulate(plant, ref.Truth(viscous=0.04, coulomb=0.12, offset=-0.03), t, u)
    settings = {
        "at_rest": True,
        "noise_std": {"q": 1e-3},
        "check_model": False,
        "model": model,
        "split": ["fit"],
    }
    return jaxid.Dataset.from_arrays(
        [t], {"tau": [u[:, 0]]}, {"q": [ref.measured(q[:, 0], 1e-3, 1)]}, **settings
    )


def by_hand(theta, q0, gravity: bool, u, h, y, w):
    """Sums of squares [lanes]; theta rows: inertia, (gravity torque,) viscous, coulomb, offset."""
    if gravity:
        inertia, torque, viscous, coulomb, offset = theta
    else:
        inertia, viscous, coulomb, offset = theta
        torque = jnp.zeros_like(inertia)
    inverse = 1 / inertia
    bias = (lambda q: torque * sin(q)) if gravity else (lambda q: 0.0)

    def step(carry, now):
        q, v, lam, acc, total = carry
        u, h, y, w = now
        total = total + (w * (q - y)) ** 2
        smooth = viscous * (v + h / 2 * acc) + offset
        lam = jnp.where(
            v > 0, coulomb, jnp.where(v < 0, -coulomb, jnp.clip(lam, -coulomb, coulomb))
        )
        tau = u - smooth - lam
        a1 = inverse * (tau - bias(q))
        a2 = inverse * (tau - bias(q + h / 2 * v))
        a3 = inverse * (tau - bias(q + h / 2 * v + h * h / 4 * a1))
        a4 = inverse * (tau - bias(q + h * v + h * h / 2 * a2))
        free = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        B = 1 / (1 + h * inverse * viscous / 2)
        A = B * h * inverse
        w_free = B * (free + h * inverse * viscous * (v / 2 + h / 2 * acc)) + A * lam
        level = A * coulomb
        slid = w_free - jnp.where(v > 0, level, jnp.where(v < 0, -level, 0.0))
        slides = slid * jnp.sign(v) > 0
        part = v / jnp.where(v == slid, 1.0, v - slid)
        rest = w_free - v
        end = jnp.where(slides, slid, (1 - part) * (rest - jnp.clip(rest, -level, level)))
        bend = jnp.where(slides, 0.0, -((1 - part) * v + part * end) / 2)
        q = q + h * v + h * h / 6 * (a1 + a2 + a3) + h / 2 * (end - free) + h * bend
        return (q, end, (w_free - end) / A, (end - v) / h, total), None

    zero = jnp.zeros_like(inertia)
    return jax.lax.scan(step, (q0, zero, zero, zero, zero), (u, h, y, w))[0][4]


def main(repeats: int = 9) -> dict:
    table = []
    for model in ("joint", "pendulum"):
        binding = bind(None, recording(model))
        problem = ProblemBuilder(binding).problem(OutputError(), "fit", binding.free, binding.theta)
        rng = np.random.default_rng(0)
        theta = np.tile(problem.base, (LANES, 1))
        names = problem.runs.layout.names
        wanted = ["inertia", "gravity_torque", "viscous", "coulomb", "offset"]
        index = [names.index(n) for n in wanted if n in names]
        theta[:, index] = np.array(
            [
                0.06 if model == "pendulum" else 0.12,
                *([1.3] if model == "pendulum" else []),
                0.04,
                0.12,
                -0.03,
            ]
        )
        theta[:, index] *= 1 + 0.02 * rng.normal(size=(LANES, len(index)))
        z = np.array([problem.z(t) for t in theta])
        record = problem.runs.record(problem.records[0])
        part = slice(record.offset, record.offset + record.count)
        samples = problem.runs.engine.samples
        u, h, y, w = (
            np.asarray(a)[part]
            for a in (samples.u[:, 0], samples.h, samples.y[:, 0], samples.w[:, 0])
        )
        q0 = np.array([problem.starts(x)[0, 0] for x in z])
        data = problem.data
        with float64():
            ours = problem.compiled("population", problem.pure, z, data)
            args = np.array(theta[:, index].T), q0, u, h, y, w
            theirs = (
                jax.jit(by_hand, static_argnums=2)
                .lower(args[0], q0, model == "pendulum", *args[2:])
                .compile()
            )
            a, b = np.asarray(ours(z, data)), np.asarray(theirs(*args)) / (np.asarray(w) > 0).sum()
            times = {"ours": [], "hand": []}
            for _ in range(repeats):
                for label, run in (
                    ("ours", lambda: ours(z, data)),
                    ("hand", lambda: theirs(*args)),
                ):
                    began = time.process_time()
                    jax.block_until_ready(run())
                    times[label].append(time.process_time() - began)
        ours_ns, hand_ns = (
            float(np.median(t)) / LANES / record.count * 1e9 for t in times.values()
        )
        table.append(
            {
                "model": model,
                "Problem, ns a candidate and step": round(ours_ns, 1),
                "by hand, ns": round(hand_ns, 1),
                "ratio": round(ours_ns / hand_ns, 2),
                "largest relative difference of the losses": float(np.max(np.abs(a / b - 1))),
            }
        )
    return {
        "title": "Cost of a population's step",
        "text": (__doc__ or "").split("\n\n")[1].replace("\n", " "),
        "rows": table,
    }


if __name__ == "__main__":
    import json

    print(json.dumps(main(), indent=1))
