"""Entries of the public benchmark (docs/benchmark.md): jaxid, and simple programs beside it.

    python benchmarks/entries.py DIR/cases --entry stepwise --out DIR2

Writes DIR2/stepwise.json, case by case, and goes on where it stopped. No entry reads a key: DIR is
the published folder. What an entry cannot do (a file that it cannot read, a case without torque) it
leaves to what it holds likely beforehand.
"""

from __future__ import annotations

import argparse
import functools
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

import entry_jaxid  # noqa: E402
from entry_jaxid import Answer, BEFOREHAND, depends_on  # noqa: E402


#: Directions of less than this share of the largest are left open in least squares.
RCOND = 1e-5


def question(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "case.json").read_text())


def table(path: Path) -> dict[str, np.ndarray]:
    """A CSV file by its columns."""
    names = path.read_text().split("\n", 1)[0].split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    return dict(zip(names, rows.T, strict=True))


# ---- always friction


def always_friction(folder: Path) -> Answer:
    """Dry friction at the first joint, whatever the recording is."""
    joint = question(folder)["joints"][0]
    missing = {f"coulomb_friction@{joint}": 0.6}
    return {**BEFOREHAND, "missing": missing, "where": {"speed": 0.6}}


# ---- by inverse dynamics: stepwise, and a neural residual


def torque_rows(folder: Path) -> tuple[Any, list[dict[str, np.ndarray]]]:
    """The file of the model, and of each run motion, torque, regressor and the columns of all
    candidates, through one low-pass, at some rows.
    """
    import mujoco
    import pinocchio
    from scipy.signal import butter, sosfiltfilt

    pin: Any = pinocchio
    mj: Any = mujoco
    asked, path = question(folder), folder / "model.xml"
    if not path.is_file():
        raise FileNotFoundError("no file of the model")
    robot, file = pin.buildModelFromMJCF(str(path)), mj.MjModel.from_xml_path(str(path))
    data, runs = robot.createData(), []
    for csv in sorted(folder.glob("run_*.csv")):
        run = table(csv)
        h = float(np.median(np.diff(run["t"])))
        low = butter(4, min(2 * h * 12.0, 0.9), output="sos")

        def smooth(x: np.ndarray, low=low) -> np.ndarray:
            return sosfiltfilt(low, x, axis=0)

        inputs = [n for n in run if n not in ("t", *asked["joints"])]
        q = smooth(np.column_stack([run[j] for j in asked["joints"]]))
        v = np.gradient(q, h, axis=0)
        a = np.gradient(v, h, axis=0)
        u = np.column_stack([run[n] for n in inputs])
        if inputs[0].endswith("_cmd"):  # a position law: its torque
            gain, bias, most = (
                file.actuator_gainprm,
                file.actuator_biasprm,
                file.actuator_forcerange,
            )
            u = gain[:, 0] * u + bias[:, 1] * q + bias[:, 2] * v
            u = np.clip(u, most[:, 0], most[:, 1])
        rows = slice(20, len(q) - 20, 4)
        body = [
            pin.computeJointTorqueRegressor(robot, data, *state)
            for state in zip(q[rows], v[rows], a[rows], strict=True)
        ]
        run = {
            "t": run["t"][rows],
            "q": q[rows],
            "v": v[rows],
            "a": a[rows],
            "body": np.array(body),
        }
        run["tau"] = smooth(u)[rows]
        top = np.percentile(np.abs(v), 99, axis=0)
        run["friction"] = smooth(np.stack([v, np.tanh(v / (0.01 * top)), 1 + 0 * v], -1))[rows]
        units = [candidates(q[:, j], v[:, j], u[:, j], top[j]) for j in range(q.shape[1])]
        for name in units[0]:
            run[name] = np.stack([smooth(own[name])[rows] for own in units], 1)
        runs.append(run)
    return file, runs


def candidates(q: np.ndarray, v: np.ndarray, tau: np.ndarray, top: float) -> dict[str, np.ndarray]:
    """Columns of the effects at one joint, [rows k] each; those with shapes once a shape. A scale of
    the torque is none: its column is what is explained.
    """
    way = np.tanh(v / (0.01 * top))
    out = {
        "quadratic_drag": v * np.abs(v),
        "spring_torque": q,
        "load_dependent_friction": np.abs(tau) * way,
        "asymmetric_friction": np.abs(v),
        "input_delay": np.gradient(tau),
    }
    for share in (0.05, 0.1, 0.2):
        out[f"stribeck_friction {share}"] = way * np.exp(-((v / (share * top)) ** 2))
    for k in (1, 2, 3):
        out[f"position_dependent_friction {k}"] = np.stack(
            [way * np.sin(k * q), way * np.cos(k * q)]
        )
    for k in range(3, 13):
        out[f"torque_ripple {k}"] = np.stack([np.sin(k * q), np.cos(k * q)])
    return {name: np.atleast_2d(x).T for name, x in out.items()}


def stepwise(folder: Path) -> Answer:
    """Bodies and friction of each joint by least squares, then at most three effects, the one by
    which the Bayesian information criterion falls most first. Ten rows count as one, for they are
    not independent; later effects have the share of the first one's fall as probability.
    """
    joints = question(folder)["joints"]
    _, runs = torque_rows(folder)
    every = {k: np.concatenate([run[k] for run in runs]) for k in runs[0]}
    known = ("t", "q", "v", "a", "body", "tau", "friction")
    chosen: dict[str, np.ndarray] = {}
    units: dict[tuple[str, str], np.ndarray] = {}
    torque: dict[str, np.ndarray] = {}
    for j, joint in enumerate(joints):
        chosen[joint], torque[joint] = _own(every, j), every["tau"][:, j]
        for name in every:
            if name not in known:
                units[name, joint] = every[name][:, j]

    def bic(columns: np.ndarray, y: np.ndarray) -> float:
        theta = np.linalg.lstsq(columns, y, rcond=RCOND)[0]
        rank, count = np.linalg.matrix_rank(columns, tol=None), len(y) / 10
        return float(count * np.log(np.mean((y - columns @ theta) ** 2)) + rank * np.log(count))

    def falls(key: tuple[str, str]) -> float:
        own, y = chosen[key[1]], torque[key[1]]
        return bic(own, y) - bic(np.column_stack([own, units[key]]), y)

    missing: dict[str, float] = {}
    first = 0.0
    for _ in range(3):
        drops = {key: falls(key) for key in units}
        best = max(drops, key=lambda key: drops[key])
        if drops[best] <= 0:
            break
        first = first or drops[best]
        name = f"{best[0].partition(' ')[0]}@{best[1]}"
        sure = 0.99 / (1 + np.exp(-min(drops[best] / 2, 30.0)))
        missing[name] = max(missing.get(name, 0.0), float(sure * min(drops[best] / first, 1.0)))
        chosen[best[1]] = np.column_stack([chosen[best[1]], units.pop(best)])
    nothing = 1.0 - max(missing.values(), default=0.0)
    return {"missing": missing, "nothing": nothing, "where": depends_on(missing)}


def neural(folder: Path) -> Answer:
    """A small network on the force that the re-tuned bodies leave at each joint: what it says it
    depends on is by permutation. It names nothing; by torque it takes the exam.
    """
    asked = question(folder)
    file, runs = torque_rows(folder)
    every = {k: np.concatenate([run[k] for run in runs]) for k in runs[0]}
    words = ("position", "speed", "acceleration", "time")
    inputs = np.stack([every["q"], every["v"], every["a"]], -1)
    time_ = np.broadcast_to(every["t"][:, None, None], (*inputs.shape[:2], 1))
    x = np.concatenate([inputs, time_], -1)
    force, own = _left(every, every)
    nets = [_trained(x[:, j], force[:, j]) for j in range(len(asked["joints"]))]
    gains = np.zeros(len(words))
    rng = np.random.default_rng(0)
    for j, net in enumerate(nets):
        plain = np.mean((net(x[:, j]) - force[:, j]) ** 2)
        for k in range(len(words)):
            mixed = x[:, j].copy()
            mixed[:, k] = rng.permutation(mixed[:, k])
            worse = np.mean((net(mixed) - force[:, j]) ** 2)
            gains[k] += (worse - plain) / max(float(np.mean(force[:, j] ** 2)), 1e-12)
    share = np.maximum(gains, 0) / max(float(np.maximum(gains, 0).sum()), 1e-12)
    out: Answer = {**BEFOREHAND, "where": dict(zip(words, share.tolist(), strict=True))}
    if "exam" in asked and asked["exam"]["outputs"][0].endswith("_tau"):
        out["exam"] = _neural_exam(folder, asked, own, nets)
    return out


def _left(
    every: dict[str, np.ndarray], fit: dict[str, np.ndarray]
) -> tuple[np.ndarray, list[np.ndarray]]:
    """The force that bodies and friction leave at each joint [rows joints], and their numbers."""
    left, numbers = np.zeros_like(every["tau"]), []
    for j in range(left.shape[1]):
        theta = np.linalg.lstsq(_own(fit, j), fit["tau"][:, j], rcond=RCOND)[0]
        left[:, j] = every["tau"][:, j] - _own(every, j) @ theta
        numbers.append(theta)
    return left, numbers


def _own(rows: dict[str, np.ndarray], j: int) -> np.ndarray:
    own = [rows["body"][:, j], rows["a"][:, j], rows["friction"][:, j]]
    return np.column_stack(own)


def _trained(x: np.ndarray, y: np.ndarray, width: int = 24) -> Callable[[np.ndarray], np.ndarray]:
    """A network of one hidden layer of random waves and tanh, its last layer by ridge regression:
    as good as a small trained one, and the same every time.
    """
    rng = np.random.default_rng(1)
    middle, scale = x.mean(0), x.std(0) + 1e-12
    weights = rng.normal(size=(x.shape[1], 12 * width)) * rng.choice([0.5, 1.0, 3.0], 12 * width)
    offset = rng.uniform(-np.pi, np.pi, 12 * width)

    def hidden(z: np.ndarray) -> np.ndarray:
        return np.tanh(((z - middle) / scale) @ weights + offset)

    h = hidden(x)
    ridge = 1e-2 * len(x) * np.eye(h.shape[1])
    last = np.linalg.solve(h.T @ h + ridge, h.T @ y)
    return lambda z: hidden(z) @ last


def _neural_exam(
    folder: Path, asked: dict[str, Any], own: list[np.ndarray], nets: list[Callable]
) -> dict[str, list[float]]:
    import pinocchio
    from scipy.signal import butter, sosfiltfilt

    pin: Any = pinocchio
    robot = pin.buildModelFromMJCF(str(folder / "model.xml"))
    data, given = robot.createData(), table(folder / "exam.csv")
    h = float(np.median(np.diff(given["t"])))
    q = np.column_stack([given[j] for j in asked["joints"]])
    q = sosfiltfilt(butter(4, min(2 * h * 12.0, 0.9), output="sos"), q, axis=0)
    v = np.gradient(q, h, axis=0)
    a = np.gradient(v, h, axis=0)
    at = asked["exam"]["rows"]
    states = zip(q[at], v[at], a[at], strict=True)
    body = np.array([pin.computeJointTorqueRegressor(robot, data, *s) for s in states])
    top = np.percentile(np.abs(v), 99, axis=0)
    friction = np.stack([v, np.tanh(v / (0.01 * top)), 1 + 0 * v], -1)[at]
    rows = {"a": a[at], "body": body, "friction": friction}
    out = {}
    for j, name in enumerate(asked["exam"]["outputs"]):
        x = np.stack([q[at, j], v[at, j], a[at, j], given["t"][at]], -1)
        out[name] = (_own(rows, j) @ own[j] + nets[j](x)).tolist()
    return out


# ---- mujoco.sysid: all its numbers, the largest change as its answer


def mujoco_sysid(folder: Path) -> Answer:
    """Damping, dry friction, armature and mass of every link by `mujoco.sysid`, on the first two
    seconds of the first run; the number that changes most, by its share, is the answer.
    """
    import mujoco as mj
    from mujoco import sysid as peer

    mujoco: Any = mj
    sysid: Any = peer
    if not hasattr(peer, "ParameterDict"):  # it hides what it could not import
        raise ModuleNotFoundError("mujoco.sysid lacks a package: pip install 'mujoco[sysid]'")
    asked, run = question(folder), table(folder / "run_1.csv")
    path = folder / "model.xml"
    if not path.is_file() or not all(f"{j}_cmd" in run for j in asked["joints"]):
        raise FileNotFoundError("no position goals and file")
    spec = mujoco.MjSpec.from_file(str(path))
    for joint in asked["joints"]:
        sensor = spec.add_sensor()
        sensor.name, sensor.type = f"s_{joint}", mujoco.mjtSensor.mjSENS_JOINTPOS
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_JOINT, joint
    model, numbers = spec.compile(), sysid.ParameterDict()
    setters = {"damping": _set_damping, "frictionloss": _set_friction, "armature": _set_armature}
    for joint in asked["joints"]:
        for name, setter in setters.items():
            stated = float(np.ravel(getattr(spec.joint(joint), name))[0])
            numbers.add(
                sysid.Parameter(
                    f"{name}@{joint}",
                    nominal=stated,
                    min_value=1e-6,
                    max_value=5 * stated + 1e-3,
                    modifier=lambda s, p, setter=setter, joint=joint: setter(s, joint, p.value[0]),
                )
            )
    count = int(2.0 / float(np.median(np.diff(run["t"]))))
    t = run["t"][:count]
    u = np.column_stack([run[f"{j}_cmd"][:count] for j in asked["joints"]])
    y = np.column_stack([run[j][:count] for j in asked["joints"]])
    control = sysid.TimeSeries.from_control_names(t, u, model)
    read = sysid.TimeSeries.from_names(t, np.concatenate([y[:1], y[:-1]]), model)
    still = sysid.create_initial_state(model, y[0], np.zeros(model.nv), np.zeros(model.na))
    sequence = sysid.ModelSequences(
        name="run",
        spec=spec,
        sequence_name="one",
        control=control,
        sensordata=read,
        initial_state=still,
    )
    residual = sysid.build_residual_fn(models_sequences=[sequence])
    fit, _ = sysid.optimize(
        initial_params=numbers, residual_fn=residual, optimizer="mujoco", verbose=False
    )
    words = {
        "damping": "viscous_friction",
        "frictionloss": "coulomb_friction",
        "armature": "reflected_inertia",
    }
    changes = {
        n: abs(float(fit[n].value[0]) / float(numbers[n].nominal[0]) - 1) for n in fit.keys()
    }
    largest = max(changes, key=lambda n: changes[n])
    kind, _, joint = largest.partition("@")
    sure = float(np.clip(changes[largest], 0.0, 0.9))
    missing = {f"{words[kind]}@{joint}": sure}
    return {"missing": missing, "nothing": 1 - sure, "where": depends_on(missing)}


def _set_damping(spec: Any, joint: str, value: float) -> None:
    spec.joint(joint).damping = np.array([value, 0.0, 0.0])


def _set_friction(spec: Any, joint: str, value: float) -> None:
    spec.joint(joint).frictionloss = value


def _set_armature(spec: Any, joint: str, value: float) -> None:
    spec.joint(joint).armature = value


# ---- running them

ENTRIES: dict[str, Callable[[Path], Answer]] = {
    "jaxid": entry_jaxid.answer,
    "stepwise": stepwise,
    "mujoco_sysid": mujoco_sysid,
    "neural": neural,
    "always_friction": always_friction,
}


def run(cases: Path, name: str, out: Path, only: tuple[str, ...] = ()) -> Path:
    """Answers what is not answered yet; returns the file of the answers."""
    path = out / f"{name}.json"
    out.mkdir(parents=True, exist_ok=True)
    entry = json.loads(path.read_text()) if path.is_file() else {"entry": name, "answers": {}}
    for case in only or json.loads((cases / "benchmark.json").read_text())["cases"]:
        if case in entry["answers"]:
            continue
        began = time.process_time()
        try:
            answer = ENTRIES[name](cases / case)
        except ModuleNotFoundError:  # of this machine, not of the case
            raise
        except FileNotFoundError as reason:
            answer = dict(BEFOREHAND)
            print(f"{name} {case}: {reason}", flush=True)
        except Exception as error:  # a case that fails is one of which little is said
            answer = dict(BEFOREHAND)
            print(f"{name} {case} failed: {error!r}"[:300], flush=True)
        answer["seconds"] = round(time.process_time() - began, 3)
        entry["answers"][case] = answer
        path.write_text(json.dumps(entry, default=float))
    return path


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("cases", type=Path)
    parser.add_argument("--entry", choices=ENTRIES, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", default="", help="cases, with commas")
    parser.add_argument(
        "--seconds", type=float, default=entry_jaxid.BUDGET_S, help="budget of jaxid for a case"
    )
    chosen = parser.parse_args()
    if chosen.entry == "jaxid":
        from jaxid.runtime import prepare

        prepare()
        ENTRIES["jaxid"] = functools.partial(entry_jaxid.answer, budget_s=chosen.seconds)
    wanted = tuple(name for name in chosen.only.split(",") if name)
    print(run(chosen.cases, chosen.entry, chosen.out, wanted))
