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
# an effect that the recording does not know. Everything else is what a real run does: ROBOTIS' SDK, ur_rtde, limits, dry run,
# `live=True`. At the end the diagnosis has to name what was hidden.

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
    return process, process.stdout.readline().strip()


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
emulator, port = emulate("dynamixel", "--plant", str(folder / "servo.toml"), "--return-delay", "0", "--latency", "0.0005")

excitation = Trajectory.multisine(0.5, 10.0, frequencies=(0.15, 2.5), lines=9, kind="current")
servo = {"rate": 100.0, "mode": "current"}
print(record(Dynamixel(port, **servo), folder / "servo", play=excitation).text)

# %% [markdown]
# That was a dry run: the path was checked, nothing moved. A current stays a current; the torque constant is stated as an
# assumption (`gain`), and stays visible in `dataset.toml`.

# %%
recording = record(
    Dynamixel(port, **servo), folder / "servo", play=excitation, live=True, limits=limits, model="pendulum", gain=1.77
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
bottom.set(xlabel="time (s)", ylabel="angle (rad)")

# %%
servo_diagnosis = jaxid.diagnose(None, data, effects=candidates)
servo_diagnosis

# %% [markdown]
# ## A joint of an arm
#
# Joint 3 has a drag that the model `pendulum` does not know. The robot is moved by servoJ and recorded packet by packet.

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

path = Trajectory.multisine([0, 0, 0.5, 0, 0, 0], 9.0, center=[0, 0, 0.3, 0, 0, 0], frequencies=(0.1, 0.7), lines=7)
recording = record(UR(host), folder / "arm", play=path, live=True, limits=limits, model="pendulum", joint=3, gain=8.5)
leave(emulator)
print(recording.text)

# %%
arm_diagnosis = jaxid.diagnose(None, jaxid.load_dataset(folder / "arm"), effects=candidates)
arm_diagnosis
