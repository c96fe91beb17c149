"""How fast: online updates at 500 Hz in real time, inverse dynamics, regressor and forward dynamics
against loops in Python.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.dynamics.rigid_body import chain_of, regressor, still
from jaxid.identification.online import OnlineIdentification
from jaxid.models import UR10
from jaxid.numerics.precision import float64


SAMPLES = 30_000


def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    w = 2 * np.pi * np.array([0.1, 0.2, 0.3, 0.4, 0.5])[:, None] * np.ones(6)
    rng = np.random.default_rng(0)
    a, phase = rng.uniform(0.1, 0.3, (5, 6)), rng.uniform(0, 6, (5, 6))
    angle = w * t[:, None, None] + phase
    return (
        (a * np.sin(angle)).sum(1),
        (a * w * np.cos(angle)).sum(1),
        -(a * w * w * np.sin(angle)).sum(1),
    )


#: How long before a sample its update is rehearsed, s.
AHEAD = 0.6e-3


def streamed(seconds: float, rehearsed: bool, rate: float = 500.0) -> dict[str, Any]:
    """Updates in real time; each is waited for."""
    t = np.arange(round(seconds * rate)) / rate
    q, qd, qdd = motion(t)
    tau = np.random.default_rng(1).normal(size=q.shape)
    online = OnlineIdentification(UR10())
    online.update(q[0], qd[0], qdd[0], tau[0])
    update: Any = online._update
    programs, spent, late = update._cache_size(), [], 0
    cpu, began = time.process_time(), time.perf_counter()
    for k in range(1, len(t)):
        due = began + k / rate
        asleep_until(due - AHEAD * rehearsed)
        if rehearsed:
            online.rehearse()
            while time.perf_counter() < due:
                pass
        start = time.perf_counter()
        online.update(q[k], qd[k], qdd[k], tau[k])
        online.state  # waits for the update
        now = time.perf_counter()
        spent.append(now - start)
        late += now > began + (k + 1) / rate
    return {
        "what": f"online update, {len(online.names)} parameters, {seconds:g} s at {rate:g} Hz in real time"
        + f", rehearsed {1e3 * AHEAD:g} ms before each sample" * rehearsed,
        "jaxid": f"median {1e3 * np.median(spent):.3f} ms, 99 % {1e3 * np.percentile(spent, 99):.2f} ms",
        "beside it": f"CPU {1e3 * (time.process_time() - cpu) / len(spent):.3f} ms a sample with the waiting; "
        f"{late} of {len(spent)} finished after the next one was due",
        "ratio": f"{update._cache_size() - programs} compilations while streaming",
    }


def asleep_until(moment: float) -> None:
    wait = moment - time.perf_counter()
    if wait > 0:
        time.sleep(wait)


def empty(seconds: float, rate: float = 500.0) -> dict[str, Any]:
    """What this computer takes for a compiled program that adds one number, called at the same
    pace.
    """
    with float64():
        add = jax.jit(lambda P, x: P + x[0, 0])
        P, spent, began = jnp.zeros((58, 58)), [], time.perf_counter()
        for k in range(round(seconds * rate)):
            asleep_until(began + k / rate)
            start = time.perf_counter()
            P = jax.block_until_ready(add(P, np.zeros((4, 6))))
            spent.append(time.perf_counter() - start)
    return {
        "what": f"a compiled program that adds one number, {seconds:g} s at {rate:g} Hz in real time",
        "jaxid": f"median {1e3 * np.median(spent):.3f} ms, 99 % {1e3 * np.percentile(spent, 99):.2f} ms",
        "beside it": "what the pace and the computer cost by themselves",
        "ratio": "",
    }


def best(run: Callable[[], Any], repeats: int = 5) -> float:
    """Least CPU time of some runs, s."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        run()
        times.append(time.process_time() - began)
    return min(times)


def batches() -> list[dict[str, Any]]:
    import mujoco
    import pinocchio as pin

    from tests.test_serial_arm import table_of, twin

    table, arm = table_of(UR10()), UR10()
    model: Any = twin(table)
    model.armature = table.drive_inertia
    data = model.createData()
    q, qd, qdd = motion(np.arange(SAMPLES) / 500.0)
    tau = np.random.default_rng(0).normal(size=q.shape)

    mj = mujoco.MjModel.from_xml_string(mjcf(arm))  # pyright: ignore[reportAttributeAccessIssue]
    md = mujoco.MjData(mj)  # pyright: ignore[reportAttributeAccessIssue]

    def mujoco_forward() -> None:
        for a, b, u in zip(q, qd, tau, strict=True):
            md.qpos[:], md.qvel[:], md.qfrc_applied[:] = a, b, u
            mujoco.mj_forward(mj, md)  # pyright: ignore[reportAttributeAccessIssue]

    with float64():
        inverse = jax.jit(lambda q, qd, x: arm.inverse(q, qd, x))
        columns = jax.jit(
            lambda q, qd, x: regressor(
                arm.placements(q), chain_of(arm.prismatic, 1), still(arm.free_fall()), qd, x
            )
        )
        forward = jax.jit(
            lambda q, qd, u: jax.lax.map(
                lambda s: arm.vector_field(0.0, (s[0], s[1]), s[2])[1], (q, qd, u), batch_size=128
            )
        )
        Q, V, X = (jnp.asarray(np.ascontiguousarray(x.T)) for x in (q, qd, qdd))
        rows = [jnp.asarray(x) for x in (q, qd, tau)]
        small = [x[:, :3000] for x in (Q, V, X)]

        def run(f, *x):
            return lambda: jax.block_until_ready(f(*x))

        for f, x in ((inverse, (Q, V, X)), (columns, small), (forward, rows)):
            run(f, *x)()
        table_rows = []
        count = 3000

        def loop(f: Callable[..., Any], *args: np.ndarray) -> float:
            return best(lambda: [f(model, data, *s) for s in zip(*args, strict=True)], 3) / len(
                args[0]
            )

        P: Any = pin
        inverse_s, forward_s = (
            best(run(inverse, Q, V, X)) / SAMPLES,
            best(run(forward, *rows)) / SAMPLES,
        )
        columns_s = best(run(columns, *small)) / count
        short = [x[:count] for x in (q, qd, qdd)]
        for what, own, other, name in (
            ("inverse dynamics", inverse_s, loop(P.rnea, q, qd, qdd), "Pinocchio rnea"),
            (
                "torque regressor",
                columns_s,
                loop(P.computeJointTorqueRegressor, *short),
                "Pinocchio's joint torque regressor",
            ),
            ("forward dynamics", forward_s, best(mujoco_forward, 3) / SAMPLES, "MuJoCo mj_forward"),
            ("forward dynamics", forward_s, loop(P.aba, q, qd, tau), "Pinocchio aba"),
        ):
            table_rows.append(
                {
                    "what": f"{what}, CPU time a sample",
                    "jaxid": f"{1e6 * own:.2f} us",
                    "beside it": f"{1e6 * other:.2f} us ({name}, loop in Python)",
                    "ratio": f"{other / own:.2f} times as fast",
                }
            )
    return table_rows


def mjcf(arm: Any) -> str:
    """A six-joint chain of the same lengths for MuJoCo (its bodies are rods: the time does not
    depend on the numbers).
    """
    parts, ends = [], []
    for j in range(6):
        a, d = float(np.asarray(arm.a)[j]), float(np.asarray(arm.d)[j])
        turn = float(np.asarray(arm.alpha)[j])
        parts.append(
            f'<body pos="{a} 0 {d}" euler="{turn} 0 0"><joint type="hinge" axis="0 0 1" armature="0.1"/>'
            f'<inertial pos="0.1 0 0.05" mass="3" diaginertia="0.05 0.05 0.02"/>'
        )
        ends.append("</body>")
    return f'<mujoco><compiler angle="radian"/><worldbody>{"".join(parts)}{"".join(ends)}</worldbody></mujoco>'


def main() -> dict:
    """Latency of the stream, in a process prepared for it, then batches."""
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    rows = [*json.loads(done.stdout.splitlines()[-1]), *batches()]
    text = (
        "UR10, float64. The stream runs in a process prepared with `streaming=True`; rehearsed: the last update is computed once "
        f"more while the next sample is waited for. Batches of {SAMPLES} samples (regressor 3000), best of several, CPU time of "
        "the whole process."
    )
    return {"title": "Speed of arm dynamics and of the recursion", "text": text, "rows": rows}


if __name__ == "__main__":
    from jaxid.runtime import prepare

    prepare(streaming=True)
    print(json.dumps([streamed(60.0, False), streamed(60.0, True), empty(10.0)]))
