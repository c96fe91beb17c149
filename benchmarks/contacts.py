"""Twins that touch the ground: a hopper and a trotter that differ from their file by one thing.

Both are planar, stand on a floor, and are driven by position goals at 100 Hz; MuJoCo makes three
runs of 4 s (`--seconds`), and encoders and the pose of the torso have noise. What is withheld: nothing, another
friction of the ground, late commands, a heavier torso or a weak motor, of a size that is drawn.
Asked is the whole diagnosis, over contacts (`[model] contacts = true`). Twins of seeds below 104
were read while rules were made.

    python benchmarks/contacts.py [--seed 104] [--twin hopper] [--case friction] [--results FILE]
    python benchmarks/contacts.py --sysid      # the same by mujoco.sysid: pip install mujoco[sysid]

mujoco.sysid asks for the numbers to fit: it gets the friction of floor and feet, the mass of the
torso and the gain of each motor, and begins the fit run where its first sample is, at rest.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

RESULTS = Path(__file__).with_name("results") / "contacts.jsonl"
#: First seed of twins that nothing was tuned on.
FRESH = 104
STEP, EVERY = 0.002, 5
RUNS = ("fit", "validation", "report")
CASES = ("nothing", "friction", "delay", "payload", "motor")

TEXT = (
    "A hopper and a trotter with four legs that MuJoCo makes, which differ from their file by one"
    " thing, of a size that is drawn (seeds that nothing was tuned on). jaxid is asked for the whole"
    " diagnosis over contacts. mujoco.sysid is told which numbers to fit to the fit run (friction,"
    " mass of the torso, gains) and knows no delay; its cell has the shares that it moved by more"
    " than 2 %. Seconds are of the processor, with what jaxid compiles; some programs were on"
    " disk. A heavier torso counts as found where the load on it is named. Each twin of seed 104"
    " was asked once, at revision 2b10fe6f, with 400 s of the processor at most; the trotter with a"
    " heavier torso was begun twice, as the first process was ended from outside, without an answer."
    " Delays that are drawn are whole steps of the simulator, and jaxid tries such sizes: one in"
    " between is harder. Twins of seed 103 were asked once, at revision c2de90e3, and were read since."
    " There late commands of the hopper (4 ms) had no answer after about 260 s, a heavier torso of the"
    " trotter none after 280 s, and its friction and delay were not asked. At revision 2b10fe6f the"
    " first is named in 43 s; friction of the trotter (0.324) came back within 0.5 % in 360 s."
)

HOPPER = """<mujoco model="hopper">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default>
    <geom friction="{friction} 0.005 0.0001"/><joint armature="0.01" damping="0.2"/>
    <default class="free"><joint armature="0" damping="0"/></default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="10 10 1"/>
    <body name="torso" pos="0 0 0.62">
      <joint name="rootx" class="free" type="slide" axis="1 0 0"/>
      <joint name="rootz" class="free" type="slide" axis="0 0 1" ref="0.62"/>
      <geom name="torso" type="capsule" fromto="-0.12 0 0.05 0.12 0 0.05" size="0.05"
        mass="{torso}"/>
      <body name="thigh">
        <joint name="hip" axis="0 1 0" range="-1.5 1.5"/>
        <geom name="thigh" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="0.6"/>
        <body name="shank" pos="0 0 -0.3">
          <joint name="knee" axis="0 1 0" range="-2 2"/>
          <geom name="shank" type="capsule" fromto="0 0 0 0 0 -0.28" size="0.025" mass="0.4"/>
          <body name="foot" pos="0 0 -0.28">
            <joint name="ankle" axis="0 1 0" range="-1 1"/>
            <geom name="foot" type="capsule" fromto="-0.09 0 -0.015 0.12 0 -0.015" size="0.03"
              mass="0.2"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hip" joint="hip" kp="200" kv="4" forcerange="-80 80"/>
    <position name="knee" joint="knee" kp="{motor}" kv="4" forcerange="-80 80"/>
    <position name="ankle" joint="ankle" kp="100" kv="2" forcerange="-40 40"/>
  </actuator>
</mujoco>"""

TROTTER = """<mujoco model="trotter">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default>
    <geom friction="{friction} 0.005 0.0001"/><joint armature="0.008" damping="0.1"/>
    <position kp="120" kv="3" forcerange="-40 40"/>
    <default class="free"><joint armature="0" damping="0"/></default>
    <default class="drawn"><geom contype="0" conaffinity="0"/></default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="10 10 1"/>
    <body name="torso" pos="0 0 0.36">
      <joint name="rootx" class="free" type="slide" axis="1 0 0"/>
      <joint name="rootz" class="free" type="slide" axis="0 0 1" ref="0.36"/>
      <joint name="pitch" class="free" axis="0 1 0"/>
      <geom class="drawn" type="box" size="0.2 0.08 0.04" mass="{torso}"/>{legs}
    </body>
  </worldbody>
  <actuator>{motors}
  </actuator>
</mujoco>"""
LEG = """
      <body name="{leg}_thigh" pos="{x} {y} 0">
        <joint name="{leg}_hip" axis="0 1 0"/>
        <geom class="drawn" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.4"/>
        <body name="{leg}_shank" pos="0 0 -0.2">
          <joint name="{leg}_knee" axis="0 1 0"/>
          <geom class="drawn" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.15"/>
          <geom name="{leg}_foot" type="sphere" pos="0 0 -0.2" size="0.02" mass="0.05"/>
        </body>
      </body>"""
#: Where the hips are, m.
LEGS = {"fl": (0.19, 0.1), "fr": (0.19, -0.1), "rl": (-0.19, 0.1), "rr": (-0.19, -0.1)}


def hopper(friction: float, torso: float, motor: float) -> str:
    return HOPPER.format(friction=friction, torso=torso, motor=motor)


def trotter(friction: float, torso: float, motor: float) -> str:
    legs = [LEG.format(leg=leg, x=x, y=y) for leg, (x, y) in LEGS.items()]
    motors = []
    for joint in (f"{leg}_{part}" for leg in LEGS for part in ("hip", "knee")):
        own = f' kp="{motor}"' if joint == "rr_knee" else ""
        motors.append(f'\n    <position name="{joint}" joint="{joint}"{own}/>')
    return TROTTER.format(
        friction=friction, torso=torso, legs="".join(legs), motors="".join(motors)
    )


def hops(t: np.ndarray, run: int) -> np.ndarray:
    """Goals of a leg that bends and stretches [time 3]; the foot stays level."""
    hops_per_s, slow = (1.4, 1.25, 1.5)[run], (0.7, 0.6, 0.8)[run]
    hop = np.clip(1.5 * np.sin(2 * np.pi * hops_per_s * t), -0.6, 1.0)
    knee = 0.8 + 0.45 * hop + 0.1 * np.sin(2 * np.pi * slow * t)
    hip = -0.5 * knee + 0.07 * np.sin(2 * np.pi * (0.45 + 0.1 * run) * t)
    ankle = -(hip + knee) + 0.05 * np.sin(2 * np.pi * 0.9 * t)
    return np.stack([hip, knee, ankle], 1)


def trots(t: np.ndarray, run: int) -> np.ndarray:
    """Goals of legs that step in diagonal pairs [time 8]."""
    steps_per_s = (1.6, 1.4, 1.8)[run]
    grown = np.clip(t / 0.5, 0.0, 1.0)
    slow = 0.03 * np.sin(2 * np.pi * 0.5 * (1 + 0.2 * run) * t)
    out = []
    for leg in LEGS:
        phase = 2 * np.pi * steps_per_s * t + (0.0 if leg in ("fl", "rr") else np.pi)
        lift = grown * np.maximum(0.0, np.cos(phase))
        out.append(0.5 + 0.18 * grown * np.sin(phase) + 0.15 * lift + slow)
        out.append(-1.0 - 0.35 * lift)
    return np.stack(out, 1)


@dataclass(frozen=True)
class Twin:
    """A robot on the ground: its file as text by its numbers, the numbers as stated, its goals
    [time driven] of a run, its joints and the standard deviation of what reads each (m, rad).
    """

    text: Callable[..., str]
    stated: dict[str, float]
    goals: Callable[[np.ndarray, int], np.ndarray]
    free: tuple[str, ...]
    driven: tuple[str, ...]
    noise: tuple[float, ...]
    feet: tuple[str, ...]
    weak: str
    settles: float = 0.0  # s, at the first goals, before a run begins

    @property
    def joints(self) -> tuple[str, ...]:
        return (*self.free, *self.driven)

    def begun(self, goal: np.ndarray) -> np.ndarray:
        """Positions at the beginning, with the feet on the floor."""
        if len(self.driven) == 3:
            height = 0.045 + 0.28 * np.cos(goal[0] + goal[1]) + 0.3 * np.cos(goal[0])
            return np.array([0.0, height, *goal])
        height = 0.02 + 0.2 * np.cos(goal[0]) + 0.2 * np.cos(goal[0] + goal[1])
        return np.array([0.0, height, 0.0, *goal])


TWINS = {
    "hopper": Twin(
        text=hopper,
        stated={"friction": 0.9, "torso": 3.0, "motor": 200.0},
        goals=hops,
        free=("rootx", "rootz"),
        driven=("hip", "knee", "ankle"),
        noise=(2e-4, 2e-4, 1e-4, 1e-4, 1e-4),
        feet=("foot",),
        weak="knee",
    ),
    "trotter": Twin(
        text=trotter,
        stated={"friction": 0.8, "torso": 6.0, "motor": 120.0},
        goals=trots,
        free=("rootx", "rootz", "pitch"),
        driven=tuple(f"{leg}_{part}" for leg in LEGS for part in ("hip", "knee")),
        noise=(2e-4,) * 11,
        feet=tuple(f"{leg}_foot" for leg in LEGS),
        weak="rr_knee",
        settles=2.0,
    ),
}


@dataclass(frozen=True)
class Truth:
    """What a twin has: its numbers, how late commands are (s), and what names that: an effect or a
    number, at any of some places, with the value there.
    """

    numbers: dict[str, float]
    delay: float
    called: str
    places: tuple[str, ...]
    value: float
    load: float = 0.0  # a heavier torso is also a payload of this mass
    carried_by: tuple[str, ...] = ()  # at one of these joints


def drawn(twin: Twin, case: str, seed: int) -> Truth:
    """A case in a size of its own."""
    rng = np.random.default_rng([seed, CASES.index(case)])
    own, share = dict(twin.stated), rng.uniform()
    if case == "friction":
        own["friction"] = round(own["friction"] * (0.4 + 0.3 * share), 3)
        return Truth(own, 0.0, "sliding_friction", twin.feet, own["friction"])
    if case == "delay":
        late = STEP * (2 + int(5 * share))
        return Truth(own, late, "input_delay", tuple(f"{j}_cmd" for j in twin.driven), late)
    if case == "payload":
        own["torso"] = round(own["torso"] * (1.1 + 0.2 * share), 3)
        load = own["torso"] - twin.stated["torso"]
        of_torso = tuple(j for j in twin.joints if j not in twin.driven)
        return Truth(own, 0.0, "mass", ("torso",), own["torso"], load=load, carried_by=of_torso)
    if case == "motor":
        own["motor"] = round(own["motor"] * (0.7 + 0.2 * share), 2)
        return Truth(own, 0.0, "kp", (twin.weak,), own["motor"])
    return Truth(own, 0.0, "", (), 0.0)


def recorded(
    twin: Twin, truth: Truth, run: int, seconds: float, noise: np.random.Generator
) -> np.ndarray:
    """Time, goals and noisy positions of a run [samples 1 + driven + joints]."""
    model = mujoco.MjModel.from_xml_string(twin.text(**truth.numbers))
    data = mujoco.MjData(model)
    t = np.arange(round(seconds / STEP)) * STEP
    goals = twin.goals(t, run)
    held = goals[np.arange(len(t)) // EVERY * EVERY]
    data.qpos[:] = twin.begun(goals[0])
    for _ in range(round(twin.settles / STEP)):
        data.ctrl[:] = goals[0]
        mujoco.mj_step(model, data)
    q = np.empty((len(t), len(twin.joints)))
    late = round(truth.delay / STEP)
    for k in range(len(t)):
        q[k] = data.qpos
        data.ctrl[:] = held[max(k - late, 0)]
        mujoco.mj_step(model, data)
    q += np.array(twin.noise) * noise.standard_normal(q.shape)
    return np.column_stack([t, goals, q])[::EVERY]


def write(folder: Path, twin: Twin, truth: Truth, seconds: float, seed: int) -> None:
    """The file as it is stated, and the runs of a twin, as a dataset."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(twin.text(**twin.stated))
    commands = [f"{joint}_cmd" for joint in twin.driven]
    lines = ['name = "data"', "[model]", 'robot = "model.xml"', "contacts = true"]
    for joint in commands:
        lines += [f"[channels.{joint}]", 'role = "input"', 'unit = "rad"']
    for joint, noise in zip(twin.joints, twin.noise, strict=True):
        unit = "m" if joint in ("rootx", "rootz") else "rad"
        lines += [f"[channels.{joint}]", 'role = "output"', f'unit = "{unit}"']
        lines += [f"noise_std = {noise}"]
    rng = np.random.default_rng([seed, 1000])
    head = ",".join(["t", *commands, *twin.joints])
    for run, split in enumerate(RUNS):
        rows = recorded(twin, truth, run, seconds, rng)
        np.savetxt(folder / f"{split}.csv", rows, delimiter=",", header=head, comments="")
        lines += ["[[experiments]]", f'file = "{split}.csv"', f'name = "{split}"']
        lines += [f'split = "{split}"']
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n")


def diagnosed(folder: Path) -> dict[str, Any]:
    """What jaxid says of a twin: `found` as {effect or number: {place: value}}."""
    from jaxid.runtime import prepare

    prepare()
    import jaxid

    began, cpu = time.perf_counter(), time.process_time()
    found = jaxid.diagnose(None, jaxid.load_dataset(folder))
    names: dict[str, dict[str, float]] = {}
    for effect in found.which.effects:
        value = next(iter(effect.parameters.values())).value
        names.setdefault(effect.effect, {})[effect.location] = value
    if found.which.verdict == "none":
        for one in (number for number in found.final.stated if number.refuted):
            place = one.joint if one.parameter in ("kp", "kd") else one.link
            names.setdefault(one.parameter, {})[place] = one.fitted
    return {
        "verdict": found.which.verdict,
        "found": names,
        "gap": [found.how_far.gap_before, found.how_far.gap_after],
        "text": found.which.text,
        "clock_s": round(time.perf_counter() - began, 1),
        "cpu_s": round(time.process_time() - cpu, 1),
    }


def judged(truth: Truth, answer: dict[str, Any]) -> str:
    """`right`, `unknown` or `wrong`: a name counts where it is the true one, within a tenth, at one
    of its places at least, and nothing else is named. A heavier torso may be a payload on it.
    """
    if answer["verdict"] == "unknown":
        return "unknown"
    found = answer["found"]
    called, places, value = truth.called, truth.places, truth.value
    if truth.load and "payload" in found:
        called, places, value = "payload", truth.carried_by, truth.load
    if set(found) != ({called} if called else set()):
        return "wrong"
    for place, found_there in found.get(called, {}).items():
        if place not in places or abs(found_there / value - 1) > 0.1:
            return "wrong"
    return "right"


def identified(folder: Path, twin: Twin, truth: Truth) -> dict[str, Any]:
    """What mujoco.sysid makes of the fit run of a twin: a friction for all feet, the mass of the
    torso and every gain, at most two and a half times what is stated.
    """
    sysid: Any = importlib.import_module("mujoco.sysid")
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    rows = np.loadtxt(folder / "fit.csv", delimiter=",", skiprows=1)
    steps = np.arange((len(rows) - 1) * EVERY + 1)
    held = rows[steps // EVERY, 1 : 1 + len(twin.driven)]
    read = rows[:, 1 + len(twin.driven) :]
    model = spec.compile()
    at_rest = np.zeros(model.nv)
    positions = [f"{joint}_qpos" for joint in twin.joints]
    sequence = sysid.ModelSequences(
        name="twin",
        spec=spec,
        sequence_name="fit",
        initial_state=sysid.create_initial_state(model, read[0], at_rest),
        control=sysid.TimeSeries(steps * STEP, held),
        sensordata=sysid.TimeSeries.from_names(rows[:, 0], read, model, positions),
        allow_missing_sensors=True,  # MuJoCo's sensors read the state a step before
    )

    def rough(spec: Any, value: Any) -> None:
        for name in ("floor", *twin.feet):
            spec.geom(name).friction[0] = value.value[0]

    def heavy(spec: Any, value: Any) -> None:
        next(iter(spec.body("torso").geoms)).mass = value.value[0]

    def strong(joint: str) -> Callable[[Any, Any], None]:
        return lambda spec, value: sysid.apply_pgain(spec, joint, value.value[0])

    numbers: dict[str, Any] = {
        "friction": (twin.stated["friction"], rough),
        "torso": (twin.stated["torso"], heavy),
    }
    for joint in twin.driven:
        gain = -model.actuator(joint).biasprm[1]
        numbers[f"kp@{joint}"] = (gain, strong(joint))
    asked = sysid.ParameterDict()
    for name, (value, changed) in numbers.items():
        one = sysid.Parameter(
            name, nominal=value, min_value=0.1 * value, max_value=2.5 * value, modifier=changed
        )
        asked.add(one)
    began, cpu = time.perf_counter(), time.process_time()
    residual = sysid.build_residual_fn(models_sequences=[sequence])
    found, _ = sysid.optimize(asked, residual, verbose=False)
    values = {name: float(found[name].value[0]) for name in numbers}
    predicted = residual(found.as_vector(), found, return_pred_all=True)[1][0][0].data
    left = (predicted - read[1 : 1 + len(predicted)]) / np.array(twin.noise)
    return {
        "found": values,
        "shares": {name: round(values[name] / numbers[name][0], 3) for name in numbers},
        "left": float(np.sqrt(np.mean(left**2))),
        "clock_s": round(time.perf_counter() - began, 1),
        "cpu_s": round(time.process_time() - cpu, 1),
    }


def told(row: dict[str, Any]) -> str:
    """What one row found, in a cell."""
    if row["by"] == "mujoco.sysid":
        moved = {name: share for name, share in row["shares"].items() if abs(share - 1) > 0.02}
        shares = ", ".join(f"{name} x {share:.3g}" for name, share in moved.items())
        return f"{shares or 'nothing'}; {row['left']:.3g} times the noise left"
    named = []
    for name, places in row["found"].items():
        values = sorted(places.values())
        named.append(f"{name} at {' and '.join(places)}: {values[0]:.4g} to {values[-1]:.4g}")
    return f"{row['verdict']}: {', '.join(named) or 'nothing'}"


def main() -> dict[str, Any]:
    """What was asked and is kept, as rows of RESULTS.md; asks nothing."""
    kept = [json.loads(line) for line in RESULTS.read_text().splitlines()]
    by = {(r["by"], r["twin"], r["case"], r["seed"], r["seconds"]): r for r in kept}
    rows = []
    for key in dict.fromkeys(asked[1:] for asked in by):
        own, beside = by.get(("jaxid", *key)), by.get(("mujoco.sysid", *key))
        row = own or beside
        assert row is not None
        cells = {"twin": f"{row['twin']}, {row['seconds']:g} s", "withheld": row["case"]}
        cells |= {"seed": row["seed"], "true": f"{row['true']:.4g}", "score": ""}
        if own is not None:
            cells |= {"score": own["score"], "jaxid": told(own), "jaxid [s]": own["cpu_s"]}
        if beside is not None:
            cells |= {"mujoco.sysid": told(beside), "mujoco.sysid [s]": beside["cpu_s"]}
        rows.append(cells)
    return {"title": "Twins on the ground, beside mujoco.sysid", "text": TEXT, "rows": rows}


def ask() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=FRESH)
    parser.add_argument("--twin", nargs="+", choices=list(TWINS), default=list(TWINS))
    parser.add_argument("--case", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--sysid", action="store_true", help="by mujoco.sysid")
    parser.add_argument("--results", type=Path, default=RESULTS)
    asked = parser.parse_args()
    for name in asked.twin:
        twin = TWINS[name]
        for case in asked.case:
            truth = drawn(twin, case, asked.seed)
            with tempfile.TemporaryDirectory() as folder:
                write(Path(folder), twin, truth, asked.seconds, asked.seed)
                if asked.sysid:
                    answer = identified(Path(folder), twin, truth)
                else:
                    answer = diagnosed(Path(folder))
                    answer["score"] = judged(truth, answer)
            row = {"by": "mujoco.sysid" if asked.sysid else "jaxid", "twin": name, "case": case}
            row |= {"seed": asked.seed, "seconds": asked.seconds, "true": truth.value, **answer}
            print(json.dumps(row), flush=True)
            asked.results.parent.mkdir(exist_ok=True)
            with asked.results.open("a") as kept:
                kept.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    ask()
