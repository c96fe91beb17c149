"""Makes examples/servo_pendulum: a servo-driven pendulum, simulated by MuJoCo and recorded by a
noisy encoder.

    python examples/make_servo_pendulum.py

Needs the package `mujoco`; the same files come out every time. What the drive does that the model
`pendulum` does not know stands here only: the recordings and their dataset.toml do not name it.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np


FOLDER = Path(__file__).parent / "servo_pendulum"
RATE = 250  # samples a second
STEPS = 100  # of the simulator, each sample
NOISE = 2.0e-4  # rad, of the encoder before it rounds
RESOLUTION = 2 * np.pi / 2**14  # rad

# The machine.
INERTIA, GRAVITY_TORQUE, DAMPING, DRY, OFFSET = 0.052, 1.21, 0.045, 0.09, 0.03
DEAD_ZONE = 0.10  # N m, about 6 % of the largest torque: the drive gives nothing below and lacks this much above

# What somebody who read the data sheets believes of it: about 10 % off.
BELIEVED = {
    "inertia": (0.058, 0.01, 0.3),
    "gravity_torque": (1.10, 0.2, 5.0),
    "viscous": (0.040, 0.0, 1.0),
    "coulomb": (0.10, 0.0, 1.0),
    "offset": (0.0, -0.5, 0.5),
}

MACHINE = f"""
<mujoco>
  <option timestep="{1 / RATE / STEPS}" integrator="RK4" gravity="0 0 -9.81" solver="Newton" tolerance="1e-14" iterations="50"/>
  <worldbody>
    <body>
      <joint name="q" type="hinge" axis="0 1 0" damping="{DAMPING}" frictionloss="{DRY}"
             solreffriction="0.0001 1" solimpfriction="0.999 0.999 0.001"/>
      <inertial pos="0 0 -0.2" mass="{GRAVITY_TORQUE / 9.81 / 0.2}"
                diaginertia="0.02 {INERTIA - GRAVITY_TORQUE / 9.81 * 0.2} 0.02"/>
    </body>
  </worldbody>
  <actuator><motor joint="q"/></actuator>
</mujoco>
"""


def motion(command: np.ndarray) -> np.ndarray:
    """Angle at each sample for a held command [time], from rest."""
    model = mujoco.MjModel.from_xml_string(MACHINE)  # pyright: ignore[reportAttributeAccessIssue]
    data = mujoco.MjData(model)  # pyright: ignore[reportAttributeAccessIssue]
    angle = np.empty(len(command))
    for k, u in enumerate(command):
        angle[k] = data.qpos[0]
        data.ctrl[0] = np.sign(u) * max(abs(u) - DEAD_ZONE, 0.0) - OFFSET
        mujoco.mj_step(model, data, STEPS)  # pyright: ignore[reportAttributeAccessIssue]
    return angle


# ---- excitations [N m]


def fade(t: np.ndarray, still_s: float = 0.4) -> np.ndarray:
    """0 at the beginning, then 1 within half a second."""
    return np.clip((t - still_s) / 0.5, 0.0, 1.0)


def multisine(
    t: np.ndarray, rng: np.random.Generator, peak: float, lowest: float = 0.15, highest: float = 3.0
):
    f = np.geomspace(lowest, highest, 9) * rng.uniform(0.93, 1.07, 9)
    u = sum(np.sin(2 * np.pi * f_k * t + rng.uniform(0, 2 * np.pi)) / f_k**0.3 for f_k in f)
    return peak * u / np.max(np.abs(u)) * fade(t)


def steps(t: np.ndarray, rng: np.random.Generator, peak: float) -> np.ndarray:
    """Held torques of both signs, each 0.25 to 0.8 s, with rests between."""
    u, begin = np.zeros(len(t)), 0.4
    while begin < t[-1]:
        length = rng.uniform(0.25, 0.8)
        level = (
            0.0 if rng.uniform() < 0.25 else rng.choice([-1.0, 1.0]) * rng.uniform(0.15, 1.0) * peak
        )
        u[(t >= begin) & (t < begin + length)] = level
        begin += length
    return u


def chirp(t: np.ndarray, peak: float) -> np.ndarray:
    """0.2 to 2.5 Hz and back, with a rest in the middle; the amplitude grows."""
    half = t[-1] / 2
    x = np.where(t < half, t, 2 * half - t)
    phase = 2 * np.pi * (0.2 * x + (2.5 - 0.2) * x**2 / (2 * half))
    rest = np.abs(t - half) < 0.5
    return np.where(rest, 0.0, peak * (0.35 + 0.65 * t / t[-1]) * np.sin(phase)) * fade(t)


def excitations() -> dict[str, tuple[str, np.ndarray, np.ndarray]]:
    """Recording -> (split, t, command)."""
    rng = np.random.default_rng(20)

    def time(seconds):
        return np.arange(round(seconds * RATE) + 1) / RATE

    t10, t9 = time(10), time(9)
    mixed = 0.6 * multisine(t10, rng, 1.6, 0.3, 2.0) + 0.5 * steps(t10, rng, 1.2)
    return {
        "multisine": ("fit", t10, multisine(t10, rng, 1.6)),
        "steps": ("fit", t10, steps(t10, rng, 0.9)),
        "chirp": ("validation", t9, chirp(t9, 1.0)),
        "mixed": ("report", t10, mixed),
    }


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    text = """name = "servo_pendulum"
description = "A pendulum driven by a servo, torque command and encoder at 250 Hz"
source = "Simulated by MuJoCo: examples/make_servo_pendulum.py"

[model]
name = "pendulum"
"""
    for name, (value, lower, upper) in BELIEVED.items():
        text += f"\n[model.parameters.{name}]\nvalue = {value}\nlower = {lower}\nupper = {upper}\n"
    text += f"""
[channels.tau]
role = "input"
unit = "N m"

[channels.q]
role = "output"
unit = "rad"
noise_std = {np.hypot(NOISE, RESOLUTION / np.sqrt(12)):.2g}
resolution = {RESOLUTION:.9g}
"""
    rng = np.random.default_rng(7)
    for name, (split, t, command) in excitations().items():
        tau = np.round(command, 4) + 0.0
        angle = motion(tau)
        q = np.round((angle + NOISE * rng.standard_normal(len(t))) / RESOLUTION) * RESOLUTION + 0.0
        lines = [f"{a:.3f},{b:.4f},{c:.6f}\n" for a, b, c in zip(t, tau, q, strict=True)]
        (FOLDER / f"{name}.csv").write_text("t,tau,q\n" + "".join(lines))
        text += f'\n[[experiments]]\nfile = "{name}.csv"\nsplit = "{split}"\nat_rest = true\n'
    (FOLDER / "dataset.toml").write_text(text)


if __name__ == "__main__":
    main()
