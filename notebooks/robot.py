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
# # From a robot's file to a robot's file
#
# An arm is driven by position goals; its simulator is an MJCF file, and the two do not move alike. What does the file lack, where,
# and what has to be written into it? This notebook goes the whole way: a log of goals and encoders, a diagnosis, a patched file,
# and that file in MuJoCo on the same log.
#
# The arm is simulated by MuJoCo with something that its file does not say. Put your own file and log in its place.

# %%
from jaxid.runtime import prepare


prepare()  # keeps compiled programs between sessions; call it before anything imports JAX

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from budget import ROBOT_CANDIDATES

import jaxid


FOLDER = Path(tempfile.mkdtemp())

# %% [markdown]
# ## The file
#
# Two joints under MuJoCo's position actuators. Meshes, sites and keyframes may be there too; names are the file's own. MuJoCo's
# dry friction is a soft constraint, which creeps by default: here it is set to hold, as that of a machine does.

# %%
MJCF = """<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="implicitfast"/>
  <default>
    <joint solreffriction="0.004 1" solimpfriction="0.99 0.9999"/>
  </default>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" armature="0.02" damping="0.3" frictionloss="0.2"/>
      <inertial pos="0 0 -0.15" mass="1.2" diaginertia="0.01 0.01 0.001"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" armature="0.01" damping="0.1" frictionloss="0.1"/>
        <inertial pos="0 0 -0.12" mass="0.6" diaginertia="0.004 0.004 0.0005"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="60" kv="2"/>
    <position name="elbow" joint="elbow" kp="30" kv="1"/>
  </actuator>
</mujoco>
"""
(FOLDER / "robot.xml").write_text(MJCF)

# %% [markdown]
# ## The recording
#
# Goals of several sines, encoders at 500 Hz with their noise. The machine is the file and **one thing more**: the elbow's motor
# takes each goal 12 ms late. The diagnosis is not told.


# %%
def goals(t, seed):
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.1, 1.2, (2, 5, 1)), rng.uniform(0, 2 * np.pi, (2, 5, 1))
    wave = np.sin(2 * np.pi * frequency * t + phase).sum(1) / 5
    return (np.array([[0.8], [0.9]]) * wave * np.minimum(1, t)).T


def recorded(seed, seconds, late=0.012, noise=2e-4):
    model = mujoco.MjModel.from_xml_string(MJCF)
    data = mujoco.MjData(model)
    step, every = model.opt.timestep, 4
    t = np.arange(int(seconds / (step * every))) * step * every
    command, read = goals(t, seed), []
    for k in range(len(t)):
        read.append(data.qpos.copy())
        for n in range(every):
            at = (
                k + n / every - np.array([0.0, late]) / (step * every)
            )  # a goal is held until the next is there
            data.ctrl[:] = command[np.maximum(0, np.floor(at + 1e-6)).astype(int), [0, 1]]
            mujoco.mj_step(model, data)
    q = np.array(read) + noise * np.random.default_rng(seed + 100).standard_normal((len(t), 2))
    return np.column_stack([t, command, q])


def written(path, rows):
    np.savetxt(
        path,
        rows,
        delimiter=",",
        header="t,shoulder_cmd,elbow_cmd,shoulder,elbow",
        comments="",
        fmt="%.9g",
    )


runs = {"first": "fit", "second": "validation", "third": "report"}
for k, name in enumerate(runs):
    written(FOLDER / f"{name}.csv", recorded(k, 8.0))

channels = "".join(
    f'[channels.{n}]\nrole = "output"\nunit = "rad"\n[channels.{n}_cmd]\nrole = "input"\nunit = "rad"\n'
    for n in ("shoulder", "elbow")
)
experiments = "".join(
    f'[[experiments]]\nfile = "{n}.csv"\nsplit = "{s}"\nat_rest = true\n' for n, s in runs.items()
)
(FOLDER / "dataset.toml").write_text(
    f'name = "arm"\n[model]\nrobot = "robot.xml"\n{channels}{experiments}'
)
dataset = jaxid.load_dataset(FOLDER)
dataset

# %% [markdown]
# ## What is missing
#
# The first lines compare the file with the data: which of its numbers the recording contradicts. Then where, which, how far. Errors
# count in multiples of the noise. 1 is the noise as it was stated; less means that it is smaller than stated.

# %%
diagnosis = jaxid.diagnose(None, dataset, effects=ROBOT_CANDIDATES)
print(diagnosis)

# %%
diagnosis

# %%
trace = next(t for t in diagnosis.traces if t.channel == "elbow" and t.split == "report")
trace.plot()

# %% [markdown]
# ## The fix, back in the file
#
# `export` patches the user's own text: comments and everything that it does not touch stay as they are. What MJCF has no field for
# comes as code beside it, and the summary says so.

# %%
exported = diagnosis.export("mjcf", robot=FOLDER / "robot.xml", out=FOLDER / "fixed")
print(exported)

# %% [markdown]
# ## Does the patched file move as the machine does?
#
# `replay` runs a file in MuJoCo on the same log: jaxid's own simulation has no part in these numbers.

# %%
before = jaxid.replay(dataset, FOLDER / "robot.xml")
after = jaxid.replay(dataset, FOLDER / "fixed" / "robot.xml")
print(before)
print(after)

# %%
errors = {
    label: [
        1e3 * np.sqrt(np.mean([r["mujoco"] ** 2 for r in found.rows if r["joint"] == j]))
        for j in ("shoulder", "elbow")
    ]
    for label, found in (("the file as it was", before), ("the patched file", after))
}
axes = plt.figure(figsize=(7.5, 2.6), layout="constrained").add_subplot()
for k, (label, values) in enumerate(errors.items()):
    axes.barh(
        np.arange(2) + 0.38 * k, values, height=0.36, label=label, color=("#d55e00", "#0072b2")[k]
    )
axes.set(
    yticks=np.arange(2) + 0.19,
    yticklabels=("shoulder", "elbow"),
    xlabel="rms error in MuJoCo (mrad)",
    xscale="log",
)
axes.axvline(0.2, color="k", ls="--", lw=1, label="the encoders' noise")
axes.legend(frameon=False, loc="lower left", bbox_to_anchor=(0, 1), ncols=3)

# %% [markdown]
# The same on the command line:
#
# ```sh
# jaxid diagnose recording --out out
# jaxid export out/diagnosis.json --to mjcf --robot recording/robot.xml --out fixed
# jaxid replay recording --robot fixed/robot.xml --out replayed
# ```
#
# With `--ranges` the export states what the data leave open as ranges for domain randomisation; `--to mjlab`, `isaaclab`, `urdf`,
# `sdf`, `drake`, `ros2_control` and `genesis` write the same fix in other terms.
