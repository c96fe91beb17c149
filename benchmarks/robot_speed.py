"""Robots under goals: how long a diagnosis takes, and `mujoco.sysid` beside it, fitting the same
numbers to the same log.

Arms of `jaxid/benchmark/goal_arms.py` with Stribeck friction withheld at one joint, three joints for 20
s at 500 Hz and seven for 60 s at 250 Hz, and two real recordings. Each diagnosis runs in a process
of its own: with no compiled programs on disk, with them, and as the whole command with its page.
`mujoco.sysid` gets the file's numbers that jaxid re-tunes (centres of mass, armature, damping, dry
friction, and the law's gains where they are asked for), jaxid's bounds, the fit runs and those
validation runs that are recordings of their own, and no effect; times of the log one step later,
for its rollout gives what a sensor reads as a step begins the time at which the step ends.

    python benchmarks/robot_speed.py [NAME ...]
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jaxid  # noqa: E402


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
#: Joints, seconds, rate in Hz.
ARMS = {"arm of 3 joints": (3, 20.0, 500.0), "arm of 7 joints": (7, 60.0, 250.0)}
REAL = {"go2_chirp": "12 joints, 23.5 s at 200 Hz", "so101_chirps": "6 joints, 120 s at 50 Hz"}
LONGEST_S = 600.0


def twin(name: str, folder: Path) -> tuple[Path, Path]:
    """Dataset and file of an arm that lacks Stribeck friction at one joint."""
    from jaxid.benchmark import goal_arms as arms

    n, seconds, rate = ARMS[name]
    rng = np.random.default_rng([7, n])
    arm = arms.GoalArm.drawn(rng, n)
    real, j, beside = arms.withheld(arm, "stribeck_friction", rng)
    u = arms.goals(n, seconds, rng, rate)
    q = arms.recorded(real, "stribeck_friction", j, beside, u, rng, rate)
    jaxid.save_dataset(arms.dataset({"arm": arm, "u": u, "q": q, "rate": rate}), folder / "log")
    (folder / "arm.xml").write_text(arm.xml())
    return folder / "log", folder / "arm.xml"


def diagnosed(dataset: str, model: str | None) -> None:
    """Prints what a diagnosis in this process finds, and how long it takes once the data are
    loaded.
    """
    data = jaxid.load_dataset(dataset)
    began = time.perf_counter()
    found = jaxid.diagnose(model, data)
    seconds = time.perf_counter() - began
    joints = [j for j in found.to_dict()["how_far"]["per_joint"] if j["split"] == "report"]
    rms = {
        key: float(np.sqrt(np.mean([j[key] ** 2 for j in joints])))
        for key in ("retuned", "with_effects")
        if joints[0][key]
    }
    runs = next(
        int(re.split(r"\D", note)[0]) for note in found.notes if "free runs were simulated" in note
    )
    named = f"{found.which.verdict}: {', '.join(map(str, found.which.effects)) or 'no effect'}"
    part = next(
        (m[1] for note in found.notes if (m := re.search(r"rows in all \(([\d.]+) %\)", note))),
        "100",
    )
    print(json.dumps({"seconds": seconds, "said": named, "runs": runs, "part": part, **rms}))


def _changes(robot: Any, tree: Any) -> dict[str, Any]:
    """By the first part of a number's name how `mujoco.sysid` sets it: (spec, joint or link,
    value).
    """

    def body(spec: Any, link: str) -> Any:
        return (
            spec.body(f"body of {tree.joints[tree.links.index(link)]}")
            if tree.file.endswith(".urdf")
            else spec.body(link)
        )

    def actuator(spec: Any, joint: str) -> Any:
        return spec.actuators[robot.actuator(joint)]

    def com(axis: int) -> Any:
        def change(spec: Any, link: str, value: float) -> None:
            place = np.array(body(spec, link).ipos)
            place[axis] = value
            body(spec, link).ipos = place

        return change

    def gain(spec: Any, joint: str, value: float) -> None:
        actuator(spec, joint).gainprm[0], actuator(spec, joint).biasprm[1] = value, -value

    def rate_gain(spec: Any, joint: str, value: float) -> None:
        actuator(spec, joint).biasprm[2] = -value

    return {
        "armature": lambda spec, joint, value: setattr(spec.joint(joint), "armature", value),
        "damping": lambda spec, joint, value: setattr(
            spec.joint(joint), "damping", np.array([[value], [0.0], [0.0]])
        ),
        "frictionloss": lambda spec, joint, value: setattr(
            spec.joint(joint), "frictionloss", value
        ),
        "com_x": com(0),
        "com_y": com(1),
        "com_z": com(2),
        "kp": gain,
        "kd": rate_gain,
    }


def _held(t: np.ndarray, u: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Goals that are held between their samples, at every step of the simulation: the tool draws
    lines through what it gets.
    """
    fine = np.arange(round((t[-1] - t[0]) / step) + 1) * step
    return fine, u[np.clip(np.searchsorted(t - t[0], fine + 1e-9, side="right") - 1, 0, len(t) - 1)]


def by_mujoco(
    dataset: Path, file: Path | None, longest_s: float = LONGEST_S
) -> dict[str, Any] | None:
    """The same fit by `mujoco.sysid`, stopped after `longest_s`: seconds, how many numbers, rms
    that its best model leaves on the report runs; None where it is not installed.
    """
    from mujoco import sysid

    if not hasattr(sysid, "optimize"):
        return None
    from jaxid.fitting.replay import _gravity, _law, _own_actuators
    from jaxid.problem.binding import bind
    from jaxid.robots.match import recorded
    from jaxid.simulation.mujoco_run import Driven, MujocoRobot

    data = jaxid.load_dataset(dataset)
    b = bind(str(file) if file else None, data)
    mechanism: Any = b.chain.mechanism
    tree, data = mechanism.tree.tree, b.dataset
    geometry = None if data.model is None else data.model.geometry
    path = Path((geometry.path if geometry is not None else "") or tree.file)
    free, inputs = recorded(tree, data)[0], [c.name for c in b.dataset.inputs]
    joints = free.leading
    law = None if _own_actuators(tree, joints) else _law(data, joints, None, path)
    robot = MujocoRobot(path, tree, free.held, _gravity(tree, data), joints, law)
    spec, columns = robot.spec, [inputs.index(f"{j}_cmd") for j in joints]
    linear = [data.inputs[c].hold == "linear" for c in columns]
    for j in joints:
        spec.add_sensor(
            name=j,
            type=robot.mj.mjtSensor.mjSENS_JOINTPOS,
            objtype=robot.mj.mjtObj.mjOBJ_JOINT,
            objname=j,
        )
    spec.option.gravity = _gravity(tree, data)
    model = spec.compile()
    acts = [robot.actuator(j) for j in joints]

    def series(e: Any) -> tuple[Any, Any, Any]:
        state = robot.mj.MjData(model)
        y = e.y[:, b.chain.joint_outputs]
        first = slice(0, 5)
        at, dof = map(np.array, zip(*(robot.address(j) for j in joints), strict=True))
        state.qpos[at], state.qvel[dof] = (
            y[0],
            0.0 if e.at_rest else np.polyfit(e.t[first], y[first], 1)[0],
        )
        u = np.zeros((len(e.t), model.nu))
        u[:, acts] = e.u[:, columns]
        t, u = (e.t - e.t[0], u) if any(linear) else _held(e.t, u, model.opt.timestep)
        begin = sysid.create_initial_state(model, state.qpos, state.qvel, state.act)
        read = (
            e.t - e.t[0] + model.opt.timestep
        )  # what it reads as a step begins it gives the time at which that ends
        return (
            begin,
            sysid.TimeSeries(t, u),
            sysid.TimeSeries.from_names(read, y, model, list(joints)),
        )

    change, parameters, told = _changes(robot, tree), sysid.ParameterDict(), []
    for i in b.free:
        name = b.layout.names[i]
        kind, place = name.split("@")
        if kind not in change:
            continue
        low, high = np.clip([b.lower[i], b.upper[i]], -1e3, 1e3)

        def modifier(spec, p, kind=kind, place=place):
            return change[kind](spec, place, float(p.value[0]))

        start = float(np.clip(b.theta[i], low, high))
        parameters.add(
            sysid.Parameter(name, nominal=start, min_value=low, max_value=high, modifier=modifier)
        )
        told.append(name)
    parameters.move_off_bounds()
    fitted = [*b.experiments("fit"), *(e for e in b.experiments("validation") if e.past is None)]
    begins, controls, seen = zip(*(series(e) for e in fitted), strict=True)
    names = [f"run {k}" for k in range(len(fitted))]
    sequences = sysid.ModelSequences(
        "robot", spec, names, list(begins), list(controls), list(seen), allow_missing_sensors=True
    )
    plain = sysid.build_residual_fn(models_sequences=[sequences])
    best: list[Any] = [np.inf, None]
    began = time.perf_counter()

    def residual(x: np.ndarray, p: Any, **more: Any) -> Any:
        found = plain(x, p, **more)
        points = np.asarray(x).reshape(len(told), -1)
        cost = np.sum(
            [np.sum(np.asarray(r).reshape(-1, points.shape[1]) ** 2, 0) for r in found[0]], axis=0
        )
        k = int(np.argmin(np.where(np.isfinite(cost), cost, np.inf)))
        if cost[k] < best[0]:
            best[:] = cost[k], points[:, k].copy()
        if time.perf_counter() - began > longest_s:
            raise TimeoutError
        return found

    stopped = ""
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            sysid.optimize(
                initial_params=parameters, residual_fn=residual, optimizer="mujoco", verbose=False
            )
        except TimeoutError:
            stopped = ", stopped"
    seconds = time.perf_counter() - began
    for name, value in zip(told, best[1], strict=True):
        kind, place = name.split("@")
        change[kind](spec, place, float(value))
    robot.model = spec.compile()
    drive, left = Driven("goal" if law is None else "law", law, robot), []
    for cut, e in (
        (len(e.t), e.whole) for e in b.experiments("report")
    ):  # from where a recording begins, at rest if it can be
        begin, _, _ = series(e)
        state = robot.mj.MjData(robot.model)
        state.qpos[:], state.qvel[:] = (
            begin[1 : 1 + robot.model.nq],
            begin[1 + robot.model.nq :][: robot.model.nv],
        )
        at, dof = map(np.array, zip(*(robot.address(j) for j in joints), strict=True))
        y = robot.run(joints, e.t, e.u[:, columns], linear, drive, state.qpos[at], state.qvel[dof])
        left.append((e.y[:, b.chain.joint_outputs] - y)[-cut:])
    rms = float(np.sqrt(np.mean(np.concatenate(left) ** 2)))
    return {"seconds": seconds, "numbers": len(told), "rms": rms, "stopped": stopped}


def in_processes(
    dataset: Path, file: Path | None, cache: Path
) -> tuple[dict[str, Any], dict[str, Any], float]:
    """What a diagnosis says and takes with no compiled programs on disk and with them, and seconds
    of the whole command.
    """
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"} | {
        "JAXID_CACHE_DIR": str(cache)
    }
    one = [sys.executable, __file__, "one", str(dataset), *([str(file)] if file else [])]
    runs = [
        subprocess.run(one, env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    cold, warm = (json.loads(r.stdout.splitlines()[-1]) for r in runs)
    command = [
        sys.executable,
        "-m",
        "jaxid",
        "diagnose",
        str(dataset),
        *(["--model", str(file)] if file else []),
    ]
    began = time.perf_counter()
    subprocess.run(
        [*command, "--out", str(cache / "page")], env=environment, capture_output=True, check=True
    )
    return cold, warm, time.perf_counter() - began


def row(name: str, folder: Path) -> dict[str, Any]:
    dataset, file = twin(name, folder) if name in ARMS else (DATA / name, None)
    about = f"{ARMS[name][1]:g} s at {ARMS[name][2]:g} Hz" if name in ARMS else REAL[name]
    cold, warm, command = in_processes(dataset, file, folder / "cache")
    peer = by_mujoco(dataset, file)
    left = [f"{1e3 * warm[k]:.3g}" for k in ("retuned", "with_effects") if k in warm]
    return {
        "recording": f"{name}, {about}"
        + (f" (jaxid looks at {warm['part']} % of it)" if warm["part"] != "100" else ""),
        "jaxid cold / warm / command [s]": f"{cold['seconds']:.0f} / {warm['seconds']:.0f} / {command:.0f}",
        "free runs": warm["runs"],
        "answer": warm["said"],
        "left on held-out runs, re-tuned / with effects [mrad]": " / ".join(left),
        "mujoco.sysid [s]": "not installed"
        if peer is None
        else f"{peer['seconds']:.0f}{peer['stopped']}",
        "its numbers": "" if peer is None else peer["numbers"],
        "left by it [mrad]": "" if peer is None else f"{1e3 * peer['rms']:.3g}",
    }


def main(*names: str) -> dict[str, Any]:
    asked = names or [*ARMS, *(name for name in REAL if (DATA / name).is_dir())]
    rows = []
    for name in asked:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(row(name, Path(folder)))
            print(rows[-1], file=sys.stderr, flush=True)
    text = (__doc__ or "").split("\n\n")
    return {
        "title": "Robots under goals: time, beside mujoco.sysid",
        "text": " ".join(text[1].split()),
        "rows": rows,
    }


if __name__ == "__main__":
    if sys.argv[1:2] == ["one"]:
        diagnosed(sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else None)
    else:
        print(json.dumps(main(*sys.argv[1:]), indent=1))
