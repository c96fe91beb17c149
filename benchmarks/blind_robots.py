"""Blind robots: arms of random MJCF files, driven by goals, simulated by MuJoCo with one withheld effect; diagnosed, scored.

The diagnosis gets the file as it was before the effect, goals and encoders. Every arm is drawn anew (two or three joints, axes,
masses, gains, goals of several sines); the encoder reads with noise. What is asked: the effect at its joint, or one that looks
the same under such a law; no name where nothing is missing or where the re-tuned file accounts for it, with the number that
differs in `stated`.

    python benchmarks/blind_robots.py [--seed N] [--cases 24] [--seconds 20] [--only saturation,none] [--off 0.1]

Cases that were done are kept in results/blind_robots.jsonl; a seed goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jaxid  # noqa: E402
from benchmarks.blind_summary import share  # noqa: E402


RESULTS = Path(__file__).with_name("results") / "blind_robots.jsonl"
RATE, STEP = 500, 1e-3
#: What looks the same under one law and pose: see `docs/limits.md`, or ask `jaxid effects --model`.
ALIKE = {
    "input_delay": {"input_delay", "input_hold", "actuator_lag"},
    "constant_torque": {"constant_torque", "sensor_bias", "gravity_offset"},
    "sensor_bias": {"sensor_bias", "constant_torque", "gravity_offset"},
    "gravity_offset": {"gravity_offset", "constant_torque", "sensor_bias"},
}
#: Numbers of the file that a fit re-tunes: the answer is `none` with one of these stated.
RETUNED = {"frictionloss": ("frictionloss",), "armature": ("armature",), "payload": ("com_x", "com_y", "com_z", "armature"),
           "torque_scale": ("armature", "damping", "frictionloss"), "input_delay": ("armature", "damping")}  # fmt: skip
#: What acts by a motion of its own is no candidate on this road: `unknown` and `partly` without its name are right.
OUTSIDE = ("backlash",)
KINDS = (
    "none", "frictionloss", "armature", "input_delay", "torque_scale", "stribeck_friction", "payload", "sensor_bias",
    "constant_torque", "saturation", "gravity_offset", "backlash",
)  # fmt: skip


@dataclass
class Arm:
    """An arm as its file states it: one row for each joint."""

    axes: list[str]
    length: np.ndarray
    mass: np.ndarray
    armature: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    kp: np.ndarray
    kv: np.ndarray
    limit: np.ndarray
    more: dict[str, Any] = field(default_factory=dict)  # what the recorded arm has beyond its file

    @classmethod
    def drawn(cls, rng: np.random.Generator, n: int | None = None) -> Arm:
        n = n or int(rng.integers(2, 4))
        axes = [str(rng.choice(["0 1 0", "0 1 0", "1 0 0", "0 0 1"])) for _ in range(n)]
        axes[0], axes[1] = "0 1 0", axes[1] if n > 2 else "0 1 0"
        between = lambda low, high: rng.uniform(low, high, n)
        outer = np.arange(n)[::-1] + 1.0
        kp = between(20, 40) * outer
        return cls(axes, between(0.15, 0.3), between(0.2, 0.6), between(0.01, 0.04) * outer, between(0.3, 0.8) * outer,
                   between(0.03, 0.1) * outer, kp, 0.02 * kp, 0.8 * kp)  # fmt: skip

    @property
    def n(self) -> int:
        return len(self.axes)

    def xml(self, play: int | None = None) -> str:
        """`play`: the joint that has a second hinge with play."""
        tilt = self.more.get("tilt", (0.0, 0.0))
        open_, close = "", ""
        for k in range(self.n):
            m, c = self.mass[k], np.array([self.length[k] / 2, 0.0, 0.0])
            load, at = self.more.get("payload", {}).get(k, (0.0, np.zeros(3)))
            total = m + load
            com = (m * c + load * np.asarray(at)) / total
            I = m * self.length[k] ** 2 / 12
            apart = [(m, c - com), (load, np.asarray(at) - com)]
            inertia = np.diag([0.1 * I + 1e-5, I, I]) + sum(w * (d @ d * np.eye(3) - np.outer(d, d)) for w, d in apart)
            full = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
            place = f"{self.length[k - 1]} 0 0" if k else "0 0 0.2"
            numbers = " ".join(f"{v:.9g}" for v in full)
            own = (f'<joint name="j{k + 1}" axis="{self.axes[k]}" armature="{self.armature[k]}" damping="{self.damping[k]}" '
                   f'frictionloss="{self.frictionloss[k]}"/>')  # fmt: skip
            body = f'<inertial pos="{" ".join(f"{v:.9g}" for v in com)}" mass="{total}" fullinertia="{numbers}"/>'
            if play == k:
                open_ += (f'<body name="r{k + 1}" pos="{place}">{own}'
                          '<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-6 1e-6 1e-6"/>'
                          f'<body name="l{k + 1}"><joint name="play" axis="{self.axes[k]}" limited="true" '
                          f'range="-{self.more["play"]} {self.more["play"]}" damping="0.01" armature="1e-4"/>{body}')  # fmt: skip
                close = "</body></body>" + close
            else:
                open_ += f'<body name="l{k + 1}" pos="{place}">{own}{body}'
                close = "</body>" + close
        acts = "".join(f'<position name="a{k + 1}" joint="j{k + 1}" kp="{self.kp[k]}" kv="{self.kv[k]}" '
                       f'forcerange="-{self.limit[k]} {self.limit[k]}"/>' for k in range(self.n))  # fmt: skip
        g = 9.81 * np.array([np.sin(tilt[1]), -np.sin(tilt[0]) * np.cos(tilt[1]), -np.cos(tilt[0]) * np.cos(tilt[1])])
        option = f'<option timestep="{STEP}" integrator="implicitfast" gravity="{" ".join(f"{v:.9g}" for v in g)}"/>'
        firm = f'<default><joint solreffriction="{2 * STEP} 1" solimpfriction=".99 .9999 .001"/></default>'
        return (f'<mujoco model="arm"><compiler angle="radian"/>{option}{firm}<worldbody>{open_}{close}</worldbody>'
                f"<actuator>{acts}</actuator></mujoco>")  # fmt: skip


def withheld(arm: Arm, kind: str, rng: np.random.Generator) -> tuple[Arm, int, dict[str, Any]]:
    """The arm that is recorded, the joint of the effect, and what acts beside MuJoCo's own model."""
    from copy import deepcopy

    real, j = deepcopy(arm), int(rng.integers(arm.n))
    beside: dict[str, Any] = {}
    if kind == "frictionloss":
        real.frictionloss[j] *= 2
    elif kind == "armature":
        real.armature[j] *= 2
    elif kind == "torque_scale":
        real.kp[j] *= 0.85
        real.kv[j] *= 0.85
        real.limit[j] *= 0.85
    elif kind == "saturation":
        beside["clip"] = rng.uniform(0.5, 0.7)
    elif kind == "payload":
        j = arm.n - 1
        real.more["payload"] = {j: (0.5 * arm.mass[j], np.array([arm.length[j], 0.0, 0.0]))}
    elif kind == "gravity_offset":
        j = 0
        real.more["tilt"] = (0.0, float(rng.choice([-1, 1]) * rng.uniform(0.04, 0.08)))
    elif kind == "input_delay":
        beside["delay"] = rng.uniform(0.006, 0.015)
    elif kind == "stribeck_friction":
        beside["extra"], beside["speed"] = float(2 * arm.frictionloss[j]), rng.uniform(0.1, 0.3)
    elif kind == "sensor_bias":
        beside["bias"] = float(rng.choice([-1, 1]) * rng.uniform(0.04, 0.08))
    elif kind == "constant_torque":
        beside["torque"] = float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.0) * 0.03 * arm.kp[j])
    elif kind == "backlash":
        real.more["play"] = 0.01
    return real, j, beside


def goals(n: int, seconds: float, rng: np.random.Generator, rate: float = RATE) -> np.ndarray:
    """[time n] sums of sines up to 2 Hz that begin at 0."""
    t = np.arange(round(seconds * rate)) / rate
    out = np.zeros((len(t), n))
    for k in range(n):
        f = rng.uniform(0.1, 2.0, 5)
        out[:, k] = sum(a * (np.sin(2 * np.pi * x * t + p) - np.sin(p))
                        for x, a, p in zip(f, 0.25 / np.sqrt(1 + (2 * f) ** 2), rng.uniform(0, 6.3, 5), strict=True))  # fmt: skip
    return out * np.minimum(1.0, t[:, None])


def recorded(
    arm: Arm, kind: str, j: int, beside: dict[str, Any], u: np.ndarray, rng: np.random.Generator, rate: float = RATE
) -> np.ndarray:
    """What the encoders read [time n] under goals [time n]."""
    import mujoco

    mj: Any = mujoco
    m = mj.MjModel.from_xml_string(arm.xml(j if kind == "backlash" else None))
    d = mj.MjData(m)
    adr = [int(m.joint(f"j{k + 1}").qposadr[0]) for k in range(arm.n)]
    dof = [int(m.joint(f"j{k + 1}").dofadr[0]) for k in range(arm.n)]
    bias = np.zeros(arm.n)
    bias[j] = beside.get("bias", 0.0)
    if "clip" in beside:  # the drive gives less than the file says: a share of what this motion asks for
        free = recorded(arm, "none", j, {}, u, rng, rate)
        asked = arm.kp[j] * (u[:, j] - free[:, j]) - arm.kv[j] * np.gradient(free[:, j], 1 / rate)
        top = beside["clip"] * float(np.abs(asked).max())
        m.actuator_forcerange[j] = -top, top
    late = beside.get("delay", 0.0)
    t = np.arange(len(u)) / rate
    per, out = round(1 / rate / STEP), np.empty_like(u)
    for k in range(len(u)):
        for part in range(per):
            goal = u[k].copy()
            if late:
                now = t[k] + part * STEP - late
                goal[j] = u[max(0, int(np.floor(now * rate + 1e-9))), j] if now >= 0 else u[0, j]
            d.ctrl[:] = goal - bias  # the law sees what the encoder reads
            if "torque" in beside:
                d.qfrc_applied[dof[j]] = beside["torque"]
            if "extra" in beside:
                v = d.qvel[dof[j]] / beside["speed"]
                m.dof_frictionloss[dof[j]] = arm.frictionloss[j] + beside["extra"] * np.exp(-(v**2))
            if part == 0:
                out[k] = d.qpos[adr] + bias
            mj.mj_step(m, d)
    return out + 1e-4 * rng.standard_normal(out.shape)


def case(seed: int, number: int, seconds: float, off: float = 0.0) -> dict[str, Any]:
    """A case with its key: file, goals, readings. `off`: the share by which armature, damping and dry friction of the file are
    wrong at most."""
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    arm = Arm.drawn(rng)
    real, j, beside = withheld(arm, kind, rng)
    wrong = np.random.default_rng([seed, number, 1])
    for numbers in (real.armature, real.damping, real.frictionloss):
        numbers *= 1 + off * wrong.uniform(-1, 1, arm.n)
    u = goals(arm.n, seconds, rng)
    return {"kind": kind, "joint": f"j{j + 1}", "beside": beside, "arm": arm, "u": u,
            "q": recorded(real, kind, j, beside, u, rng)}  # fmt: skip


def dataset(c: dict[str, Any]) -> jaxid.Dataset:
    n = c["arm"].n
    t = np.arange(len(c["u"])) / c.get("rate", RATE)
    joints = [f"j{k + 1}" for k in range(n)]
    return jaxid.Dataset.from_arrays(
        t, {f"{j}_cmd": c["u"][:, k] for k, j in enumerate(joints)}, {j: c["q"][:, k] for k, j in enumerate(joints)},
        units={x: "rad" for j in joints for x in (j, f"{j}_cmd")}, check_model=False,
    )  # fmt: skip


def score(c: dict[str, Any], found: Any) -> dict[str, Any]:
    """What was claimed against the key."""
    kind, joint, verdict = c["kind"], c["joint"], found.which.verdict
    claimed = found.which.effects if verdict in ("named", "partly") else ()
    every = [(e.effect, e.location.split("_")[0]) for e in claimed]
    mates = [(e.effect, e.location.split("_")[0]) for e in found.which.confusable_with] if claimed else []
    told = {(r.parameter, r.joint) for r in found.nominal.stated if r.deviation and abs(r.deviation) > 3}
    alike = ALIKE.get(kind, {kind})
    hit = any(e in alike and (j == joint or e == "gravity_offset" or kind == "gravity_offset") for e, j in (*every, *mates))
    there = lambda j: j == joint or kind == "payload"  # a load moves the first moments of the links before it, too
    retuned = verdict == "none" and any(p in RETUNED.get(kind, ()) and there(j) for p, j in told)
    if kind == "none":
        right = verdict == "none"
    elif kind in RETUNED:
        right = retuned or hit
    elif kind in OUTSIDE:
        right = not every
    else:
        right = hit
    wrong = bool(every) and not hit
    far = found.how_far
    return {
        "kind": kind, "joint": joint, "verdict": verdict, "named": [f"{e} at {j}" for e, j in every],
        "mates": [f"{e} at {j}" for e, j in mates], "told": sorted(f"{p} of {j}" for p, j in told),
        "right": right, "by": "numbers" if retuned else "name" if hit else "", "wrong": wrong,
        "gaps": [far.gap_before, far.gap_retuned, far.gap_after], "shrinkage": far.shrinkage,
        "interval": far.shrinkage_interval_95,
    }  # fmt: skip


def answered(c: dict[str, Any], progress: Callable | None = None) -> tuple[Any, float]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(c["arm"].xml())
        began = time.perf_counter()
        found = jaxid.diagnose(str(path), dataset(c), progress=progress)
        return found, time.perf_counter() - began


def asked(seed: int, cases: int, seconds: float, only: Sequence[str] = KINDS, off: float = 0.0) -> None:
    """Makes and diagnoses what is not done yet; of some kinds `only`."""
    done = {(r["seed"], r["number"]) for r in kept() if r.get("off", 0.0) == off}
    for number in range(cases):
        if (seed, number) in done or KINDS[number % len(KINDS)] not in only:
            continue
        c = case(seed, number, seconds, off)
        try:
            found, spent = answered(c)
            row = score(c, found)
        except Exception as error:  # a case that cannot be diagnosed is one that is not right
            row, spent = {"kind": c["kind"], "joint": c["joint"], "verdict": f"failed: {error}"[:200], "named": [], "mates": [],
                          "told": [], "right": False, "wrong": False, "gaps": [], "shrinkage": None,
                          "interval": None}, 0.0  # fmt: skip
        row |= {"seed": seed, "number": number, "off": off, "joints": c["arm"].n, "seconds": round(spent, 1)}
        RESULTS.parent.mkdir(exist_ok=True)
        with RESULTS.open("a") as f:
            f.write(json.dumps(row) + "\n")
        print(number, row["kind"], row["joint"], row["verdict"], row["named"], "right" if row["right"] else "", row["seconds"],
              flush=True)  # fmt: skip


def kept() -> list[dict[str, Any]]:
    return [json.loads(line) for line in RESULTS.read_text().splitlines()] if RESULTS.exists() else []


def main() -> dict[str, Any]:
    """The cases of the last seed by what was withheld; of those before how many were right."""
    if not (every := kept()):
        raise FileNotFoundError("no blind robots were diagnosed: run benchmarks/blind_robots.py first")
    exact, worn = ([r for r in every if bool(r.get("off")) == off] for off in (False, True))
    rows = [r for r in exact if r["seed"] == exact[-1]["seed"]]
    groups = {kind: [r for r in rows if kind in (r["kind"], "all")] for kind in (*KINDS, "all")}
    for off in sorted({r["off"] for r in worn}):
        groups[f"all, numbers of the file off by up to {100 * off:.0f} %"] = [r for r in worn if r["off"] == off]
    out = []
    for kind, own in groups.items():
        if not own:
            continue
        said = sorted({f"{r['verdict'].partition(':')[0]}{': ' if r['named'] else ''}{', '.join(r['named'])}" for r in own})
        out.append({
            "withheld": kind, "cases": len(own), "right": share([r["right"] for r in own]),
            "wrong name": sum(r["wrong"] for r in own),
            "verdicts": "" if kind.startswith("all") else "; ".join(said),
            "seconds, median (longest)": f"{np.median([r['seconds'] for r in own]):.0f} ({max(r['seconds'] for r in own):.0f})",
        })  # fmt: skip
    seed = exact[-1]["seed"]
    before = list(dict.fromkeys(r["seed"] for r in exact if r["seed"] != seed))
    own = lambda seed: [r for r in exact if r["seed"] == seed]
    count = lambda seed, what: sum(r[what] for r in own(seed))
    by_seed = ", ".join(f"{count(s, 'right')} of {len(own(s))} ({count(s, 'wrong')} wrong; seed {s})" for s in before)
    text = (
        "Arms of two and three joints under MuJoCo's position actuators, 20 s at 500 Hz, encoders with noise of 1e-4 rad, "
        f"simulated by MuJoCo with one effect that the file, else exact, has not (seed {seed}, run once). Right: the effect "
        "at its joint, or one of those that look the same under one law (constant torque, encoder bias and tilt; delay, lag and "
        "hold); nothing named where nothing is missing; where re-tuned numbers of the file account for it (dry friction, "
        "armature, load; a scale of the torque or a delay by armature and damping of that joint) those stated. Play "
        "acts by a motion of its own and is not asked: no name is right. 95 % intervals by Wilson."
        f" Earlier seeds, each asked of the program as it then was: {by_seed}."
    )
    return {"title": "Blind robots driven by goals", "text": text, "rows": out}


if __name__ == "__main__":
    p = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--cases", type=int, default=24)
    p.add_argument("--seconds", type=float, default=20.0)
    p.add_argument("--only", type=lambda text: text.split(","), default=KINDS)
    p.add_argument("--off", type=float, default=0.0, help="share by which numbers of the file are wrong as well")
    a = p.parse_args()
    asked(a.seed, a.cases, a.seconds, a.only, a.off)
