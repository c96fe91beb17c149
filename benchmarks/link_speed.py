"""What a candidate of the flexible link's study costs: this library, SciPy, diffrax, and a loop
written by hand in C++.

2 s at 1 kHz and 250 lines of a frequency response, candidates drawn from the whole box of paper
002. CPU time of one thread. SciPy (LSODA) and diffrax (Kvaerno5, vmapped) integrate all nine
degrees of freedom with friction smoothed at 0.01 rad/s, rtol 1e-6; the hand-written loop
(link_loop.cpp, compiled here with -O3 -march=native) takes the same modal step and has nothing
general in it.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np


sys.path[:0] = [
    str(Path(__file__).resolve().parents[1]),
    str(Path(__file__).resolve().parents[1] / "tests"),
]

from jaxid.runtime import prepare  # noqa: E402


prepare()

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402

from jaxid.dynamics.chain import Chain  # noqa: E402
from jaxid.dynamics.parameter_vector import ParameterVector  # noqa: E402
from jaxid.models import FlexibleLink  # noqa: E402
from jaxid.numerics.precision import float64  # noqa: E402
from jaxid.problem.problem import FitProblem  # noqa: E402
from jaxid.simulation.transfer import transfer  # noqa: E402
from jaxid.study.papers import flexible_link  # noqa: E402
from tests import test_flexible_link as link  # noqa: E402
from tests.simulated import Simulator  # noqa: E402


NAMES = tuple(flexible_link.BOUNDS)
T, U = np.arange(2000) * 1e-3, np.where(np.arange(2000) < 300, 0.241, 0.0)
SMOOTH = 1e-2


def candidates(count: int) -> np.ndarray:
    """[count 6] from the box, in logarithms."""
    low, high = np.log(np.array(list(flexible_link.BOUNDS.values()))).T
    return np.exp(np.random.default_rng(5).uniform(low, high, (count, len(NAMES))))


def own(problem: FitProblem, x: np.ndarray, repeats: int = 25) -> tuple[float, np.ndarray]:
    """CPU seconds of a candidate, and the losses."""
    theta = np.tile(problem.base, (len(x), 1))
    for k, name in enumerate(NAMES):
        theta[:, problem.runs.layout.index(name)] = x[:, k]
    z = np.array([problem.z(t) for t in theta])
    data, spent = problem.data, []
    with float64():
        program = problem.compiled("population", problem.pure, z, data)
        losses = np.asarray(program(z, data))
        for _ in range(repeats):
            began = time.process_time()
            jax.block_until_ready(program(z, data))
            spent.append(time.process_time() - began)
    return float(np.median(spent)) / len(x), losses


def by_scipy(x: np.ndarray) -> float:
    """CPU seconds of a candidate by LSODA over the pieces of constant torque."""
    began = time.process_time()
    for E, I_m, v, tau_c, alpha, beta in x:
        M, C, K = link.full(E, I_m, alpha, beta)
        C[0, 0] += v
        W = np.linalg.inv(M)
        n = len(M)

        def field(t, y, torque, W=W, C=C, K=K, tau_c=tau_c, n=n):
            pull = -C @ y[n:] - K @ y[:n]
            pull[0] += torque - tau_c * np.tanh(y[n] / SMOOTH)
            return np.concatenate([y[n:], W @ pull])

        y = np.zeros(2 * n)
        for a, b, torque in ((0, 300, 0.241), (300, 1999, 0.0)):
            part = solve_ivp(
                field,
                (T[a], T[b]),
                y,
                "LSODA",
                T[a : b + 1],
                args=(torque,),
                rtol=1e-6,
                atol=1e-9,
                max_step=0.05,
            )
            y = part.y[:, -1]
    return (time.process_time() - began) / len(x)


def by_diffrax(x: np.ndarray) -> float:
    """CPU seconds of a candidate: all lanes vmapped, compiling left out."""

    def simulate(x):
        body = FlexibleLink(E=x[0], I_m=x[1], alpha=x[4], beta=x[5]).prepare(None)

        def field(t, y, args):
            w = y[1][0]
            torque = jnp.where(t < 0.3, 0.241, 0.0) - x[2] * w - x[3] * jnp.tanh(w / SMOOTH)
            return body.vector_field(t, y, torque[None])

        start = body.start(jnp.zeros(1), jnp.zeros(1))
        controller = diffrax.ClipStepSizeController(
            diffrax.PIDController(rtol=1e-6, atol=1e-9), jump_ts=jnp.array([0.3])
        )
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Kvaerno5(),
            0.0,
            T[-1],
            1e-4,
            start,
            saveat=diffrax.SaveAt(ts=jnp.asarray(T)),
            stepsize_controller=controller,
            max_steps=100_000,
            throw=False,
        )
        assert found.ys is not None
        return found.ys[0]

    with float64():
        program = jax.jit(jax.vmap(simulate)).lower(jnp.asarray(x)).compile()
        began = time.process_time()
        jax.block_until_ready(program(jnp.asarray(x)))
    return (time.process_time() - began) / len(x)


def by_hand(x: np.ndarray, modes: int) -> tuple[float, np.ndarray]:
    """Seconds of a candidate in the compiled loop, and its losses."""
    data = flexible_link.data(linear=False)
    run, lines = data.experiments[0], data.responses[0]
    rows = []
    with float64():
        for E, I_m, v, tau_c, alpha, beta in x:
            body = FlexibleLink(E=E, I_m=I_m, alpha=alpha, beta=beta, n_modes=modes).prepare(1e-3)
            kept, damping, inertia, step = body.prepared
            columns = (*step[:6], kept.participation, kept.tip, kept.squares, damping)
            rest = [inertia, step.borne, v, tau_c, body.L, 1e-3]
            rows.append(
                np.concatenate(
                    [*(np.asarray(c) for c in columns), np.array([float(r) for r in rest])]
                )
            )
    with tempfile.TemporaryDirectory() as folder:
        program, given, found = (str(Path(folder) / n) for n in ("loop", "in", "out"))
        source = str(Path(__file__).with_name("link_loop.cpp"))
        subprocess.run(
            ["g++", "-O3", "-march=native", "-ffast-math", "-Wno-psabi", source, "-o", program],
            check=True,
        )
        numbers = [U, run.y[:, 0], lines.omega**2, np.abs(lines.response), *rows]
        Path(given).write_bytes(np.concatenate(numbers).astype(np.float64).tobytes())
        arguments = [len(x), len(U), modes, len(lines.omega), 41, given, found]
        done = subprocess.run(
            [program, *map(str, arguments)], check=True, capture_output=True, text=True
        )
        return float(done.stdout) / len(x), np.frombuffer(Path(found).read_bytes())


def hub_angle_errors(x: np.ndarray) -> list[float]:
    """Relative L2 error of phi against exponentials of the whole system with 32 parts a step."""
    simulator = Simulator(Chain(FlexibleLink(n_modes=4)), T, U[:, None], 1e-3, size=2048)
    out = []
    for E, I_m, v, tau_c, alpha, beta in x:
        phi = simulator.outputs([dict(zip(NAMES, (E, I_m, v, tau_c, alpha, beta), strict=True))])[
            0
        ][:, 0]
        fine = link.zero_order_hold(U, 1e-3, 32, v, tau_c, E, I_m, alpha, beta)[:, 0]
        out.append(float(np.linalg.norm(phi - fine) / np.linalg.norm(fine)))
    return out


def responses(x: np.ndarray, modes: int) -> tuple[float, float, float]:
    """CPU seconds of a candidate's response by the modal sum and by batched complex solves, and
    their relative difference.
    """
    omega = 2 * np.pi * np.arange(0.2, 50.01, 0.2)
    matrices = [link.full(E, I_m, alpha, beta) for E, I_m, _, _, alpha, beta in x]
    M, C, K = (np.array(m) for m in zip(*matrices, strict=True))

    def solve(M, C, K, v):
        Z = -(omega[:, None, None] ** 2) * M + 1j * omega[:, None, None] * C.at[0, 0].add(v) + K
        force = jnp.zeros((len(omega), len(M), 1), Z.dtype).at[:, 0].set(1.0)
        q = jnp.linalg.solve(Z, force)[..., 0]
        return -(omega**2) * (link.L * q[:, 0] + q[:, -2])

    layout = ParameterVector(Chain(FlexibleLink(n_modes=modes)))
    place = {layout.index(n): k for k, n in enumerate(NAMES)}

    def modal(x):
        numbers = [x[place[i]] if i in place else value for i, value in enumerate(layout.values)]
        re, im = transfer(layout.model(numbers), jnp.asarray(omega))
        return re[:, 1, 0] + 1j * im[:, 1, 0]

    out = []
    with float64():
        for f, args in ((jax.vmap(modal), (x,)), (jax.vmap(solve), (M, C, K, x[:, 2]))):
            program = jax.jit(f).lower(*args).compile()
            response, spent = np.asarray(program(*args)), []
            for _ in range(5):
                began = time.process_time()
                jax.block_until_ready(program(*args))
                spent.append(time.process_time() - began)
            out.append((float(np.median(spent)) / len(x), response))
    (summed, a), (solved, b) = out
    return summed, solved, float(np.max(np.linalg.norm(a - b, axis=1) / np.linalg.norm(b, axis=1)))


def main() -> dict:
    x = candidates(100)
    moves = x[
        (x[:, 3] < 0.15) & (x[:, 1] < 0.1)
    ]  # dry friction below the torque, so that there is a motion to err in
    costs = {}
    rows: list[dict] = []
    for modes in (4, 8):
        problem = flexible_link.problem(modes, linear=False)
        costs[modes], losses = own(problem, x)
        rows.append(
            {
                "what": f"this library, {modes} modes, a population of 100",
                "us a candidate": round(1e6 * costs[modes], 1),
            }
        )
        if shutil.which("g++"):
            hand, found = by_hand(x, modes)
            off = float(np.median(np.abs(found / losses - 1)))
            label = f"C++ by hand, {modes} modes (losses differ by {off:.1g}, median)"
            share = round(hand / costs[modes], 3)
            rows.append(
                {
                    "what": label,
                    "us a candidate": round(1e6 * hand, 2),
                    "times this library's": share,
                }
            )
    few = x[:6]
    for label, cost in (
        ("SciPy LSODA, 6 candidates", by_scipy(few)),
        ("diffrax Kvaerno5, 8 lanes", by_diffrax(x[:8])),
    ):
        rows.append(
            {
                "what": label,
                "us a candidate": round(1e6 * cost),
                "times this library's": round(cost / costs[4]),
            }
        )
    for modes in (4, 8):
        summed, solved, difference = responses(x, modes)
        rows.append(
            {
                "what": f"response by {modes} modes; batched 9 x 9 solves in the last column (they differ by {difference:.1g})",
                "us a candidate": round(1e6 * summed, 2),
                "times this library's": round(solved / summed),
            }
        )
    errors = hub_angle_errors(moves[:12])
    text = (
        f"{(__doc__ or '').split(chr(10), 2)[2].strip()}\n\nHub angle of four modes at steps of 1 ms against the whole system in "
        f"steps of 1/32 ms, 12 candidates: relative L2 error {np.median(errors):.1e} (median), {max(errors):.1e} (largest)."
    )
    return {"title": "Flexible link: what a candidate costs", "text": text, "rows": rows}


if __name__ == "__main__":
    found = main()
    print(found["text"], *found["rows"], sep="\n")
