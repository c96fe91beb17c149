# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     name: python3
# ---

# %% [markdown]
# # Recording a servo and an arm, without hardware
#
# An emulator stands in for the machine: it speaks the device's own protocol, and behind it a model moves with parameters and
# an effect that the recording does not know. Everything else is what a real run does: an experiment designed by `jaxid.excite`,
# ROBOTIS' SDK, ur_rtde, limits, dry run, `live=True`. At the end the diagnosis has to name what was hidden. The same works with
# the commands `jaxid excite`, `jaxid record --live` and `jaxid diagnose`.

# %%
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import jaxid
from jaxid.hardware import Dynamixel, Limits, record, Trajectory, UR


folder = Path(tempfile.mkdtemp(prefix="jaxid_recording_"))
candidates = ("dead_zone", "quadratic_drag", "stribeck_friction", "load_dependent_friction")

#: On a robot leave this at its default of 0.1 s; a laptop that emulates the robot too may be late.
limits = Limits(data_age=0.8)


def emulate(*arguments: str) -> tuple[subprocess.Popen, str]:
    """Starts `jaxid emulate …` and returns its process and its address."""
    command = [sys.executable, "-m", "jaxid.cli", "emulate", *arguments]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    address = process.stdout.readline().strip()
    assert address, "the emulator did not start: its reason stands above"
    return process, address


def leave(process: subprocess.Popen) -> None:
    """The end of its input ends an emulator."""
    assert process.stdin is not None
    process.stdin.close()
    process.wait(5)


# %% [markdown]
# ## A servo that swings a weight
#
# The plant: a pendulum whose drive has a dead zone of 0.12 N m.

# %%
(folder / "servo.toml").write_text("""
model = "pendulum"
torque_constant = 1.77
[parameters]
inertia = 0.034
gravity_torque = 0.92
viscous = 0.05
coulomb = 0.07
offset = 0.015
[noise]
q = 7.0e-4  # rad, before the encoder rounds to 1.5e-3
[[effects]]
effect = "dead_zone"
parameters = { width = 0.12 }
""")
emulator, port = emulate(
    "dynamixel", "--plant", str(folder / "servo.toml"), "--return-delay", "0", "--latency", "0.0005"
)

# %% [markdown]
# The experiment: `excite` chooses the torque over time that shows most of a pendulum's parameters, for what is known of this
# one beforehand (a guess from its mass and length) and within gentle speeds: the servo's clock ticks in milliseconds, and at
# 5 rad/s one of them is more than a step of its encoder. The torque constant turns it into a current.

# %%
guess = {"parameters": {"inertia": 0.03, "gravity_torque": 0.8, "viscous": 0.06, "coulomb": 0.08}}
reach = Limits(lower=(-1.0,), upper=(1.0,), speed=(2.5,))
design = jaxid.excite(
    "pendulum", duration_s=12.0, rate_hz=100.0, parameters=guess, limits=reach, gain=[1.77]
)
design.save(folder / "servo_excitation")
excitation = Trajectory.read(folder / "servo_excitation", kind="current")
print(f"condition number {design.condition_number:.3g}")

# %%
servo = {"rate": 100.0, "mode": "current"}
print(record(Dynamixel(port, **servo), folder / "servo", play=excitation).text)

# %% [markdown]
# That was a dry run: the path was checked, nothing moved. A current stays a current; the torque constant is stated as an
# assumption (`gain`), and stays visible in `dataset.toml`.

# %%
recording = record(
    Dynamixel(port, **servo),
    folder / "servo",
    play=excitation,
    live=True,
    limits=limits,
    model="pendulum",
    gain=1.77,
)
leave(emulator)
print(recording.text)

# %%
data = jaxid.load_dataset(folder / "servo")
run = data.experiments[0]
figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(8, 4), layout="constrained")
top.plot(run.t, run.u[:, 0])
top.set_ylabel("torque asked for (N m)")
bottom.plot(run.t, run.y[:, 0], color="C1")
_ = bottom.set(xlabel="time (s)", ylabel="angle (rad)")

# %%
servo_diagnosis = jaxid.diagnose(None, data, effects=candidates)
servo_diagnosis

# %% [markdown]
# ## A joint of an arm
#
# Joint 3 has a drag that the model `pendulum` does not know. `excite` makes a motion of all six joints that starts and ends at
# rest and keeps the arm's limits; the robot is moved along it by servoJ and recorded packet by packet. (Few starts and steps
# here: leave them out for the best motion that can be found.)

# %%
(folder / "arm.toml").write_text("""
model = "pendulum"
seed = 3
[parameters]
inertia = [2.5, 2.5, 1.3, 0.3, 0.3, 0.2]
gravity_torque = [0.0, 60.0, 21.0, 3.0, 0.0, 0.0]
viscous = [12.0, 12.0, 6.5, 2.0, 2.0, 2.0]
coulomb = [8.0, 8.0, 4.0, 1.5, 1.5, 1.5]
[noise]
q = 1.0e-4
[[effects]]
effect = "quadratic_drag"
joint = 3
parameters = { coefficient = 5.0 }
""")
emulator, host = emulate("ur10", "--host", "127.0.0.40", "--plant", str(folder / "arm.toml"))

gentle = Limits(
    speed=(1.5, 1.5, 2.2, 2.2, 2.2, 2.2)
)  # below the arm's own limits: what is late here catches up in leaps
motion = jaxid.excite("ur10", starts=4, iterations=50, limits=gentle)
motion.save(folder / "arm_excitation")
path = Trajectory.read(folder / "arm_excitation", joints=6)
print(f"condition number {motion.condition_number:.3g}")
recording = record(
    UR(host),
    folder / "arm",
    play=path,
    live=True,
    limits=limits,
    model="pendulum",
    joint=3,
    gain=8.5,
)
leave(emulator)
print(recording.text)

# %%
arm_diagnosis = jaxid.diagnose(None, jaxid.load_dataset(folder / "arm"), effects=candidates)
arm_diagnosis
