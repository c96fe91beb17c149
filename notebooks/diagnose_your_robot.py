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
# # Diagnose your own robot: from a CSV to a named effect
#
# A bench logs time, motor current and encoder to a CSV file in its own units. This notebook makes such a file (a pendulum on a
# gear motor, in twenty lines of NumPy), and then does what you would do with yours.

# %%
from jaxid.runtime import prepare


prepare()

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from budget import CANDIDATES

import jaxid


folder = Path(tempfile.mkdtemp()) / "bench"
folder.mkdir()


# %%
def bench(seed: int, seconds: float = 10.0) -> tuple[np.ndarray, ...]:
    """t (s), current (A) and angle (rad) of the bench; a fan blade on the shaft drags with the square of the speed."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 200) + 1) / 200
    f, phase = np.geomspace(0.2, 2.5, 8), rng.uniform(0, 2 * np.pi, 8)
    current = np.round(
        0.15 * np.sin(2 * np.pi * np.outer(t, f) + phase).sum(1) * np.clip((t - 0.3) / 0.5, 0, 1), 3
    )

    def field(x, u):
        return np.array(
            [x[1], (1.6 * u - 0.9 * np.sin(x[0]) - 0.05 * x[1] - 0.012 * abs(x[1]) * x[1]) / 0.045]
        )

    x, h, angle = np.zeros(2), 1 / 400, []
    for u in current:  # Runge and Kutta, two steps a sample, current held between samples
        angle.append(x[0])
        for _ in range(2):
            k1 = field(x, u)
            k2 = field(x + h / 2 * k1, u)
            k3 = field(x + h / 2 * k2, u)
            k4 = field(x + h * k3, u)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return t, current, np.array(angle) + 5e-4 * rng.standard_normal(len(t))


for name, seed in (("monday", 1), ("tuesday", 2)):
    t, current, angle = bench(seed)
    rows = np.column_stack([t, 1e3 * current, np.rad2deg(angle)])
    np.savetxt(
        folder / f"{name}.csv",
        rows,
        fmt=["%.3f", "%.0f", "%.4f"],
        delimiter=",",
        header="time_s,motor_mA,enc_deg",
        comments="",
    )

print((folder / "monday.csv").read_text()[:90])

# %% [markdown]
# ## Describe the file, do not rewrite it
#
# Columns keep their names and units. The torque constant (1.6 N m/A, from the data sheet) is a `scale` that stays visible: the
# torque is only as true as that number. Time has to be in seconds.

# %%
(folder / "dataset.toml").write_text("""
name = "bench"
description = "pendulum on a gear motor"
time = "time_s"

[model]
name = "pendulum"
without = ["coulomb_friction"]     # ball bearings; if that is wrong, the diagnosis will say so

[channels.tau]
role = "input"
column = "motor_mA"
scale = 1.6e-3                     # N m per mA
unit = "N m"

[channels.q]
role = "output"
column = "enc_deg"
unit = "deg"
noise_std = 0.03

[[experiments]]
file = "monday.csv"
at_rest = true

[[experiments]]
file = "tuesday.csv"
split = "validation"
at_rest = true
""")
data = jaxid.load_dataset(folder)
data

# %% [markdown]
# Look at the data before anything else: a dead channel, a wrong sign or a wrong unit is seen here, and nowhere so cheaply.

# %%
figure, (top, bottom) = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
data.plot("tau", ax=top).set_xlabel("")
ax = data.plot("q", ax=bottom)

# %% [markdown]
# ## What a broken file looks like
#
# Nothing is repaired silently. All faults are reported at once, each with its place and a remedy.

# %%
lines = (folder / "monday.csv").read_text().splitlines()
lines[40], lines[90] = lines[40].replace(",", ",oops", 1), lines[89]
(folder / "broken.csv").write_text("\n".join(lines))
toml = (
    (folder / "dataset.toml")
    .read_text()
    .replace("monday.csv", "broken.csv")
    .replace('"deg"', '"degs"')
)
(folder / "broken").mkdir()
(folder / "broken" / "dataset.toml").write_text(toml)
for file in ("broken.csv", "tuesday.csv"):
    (folder / "broken" / file).write_text((folder / file).read_text())
try:
    jaxid.load_dataset(folder / "broken")
except jaxid.DatasetError as error:
    print(error)

# %% [markdown]
# ## Diagnose

# %%
diagnosis = jaxid.diagnose(None, data, effects=CANDIDATES)
diagnosis

# %%
assert [e.effect for e in diagnosis.which.effects] == ["quadratic_drag"]

# %% [markdown]
# The missing force against velocity, before and after. It grows with the square of the speed and changes its sign with it:

# %%
force = diagnosis.missing_force[0]
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8), sharey=True, layout="constrained")
force.plot(ax=left)
ax = force.plot(after=True, ax=right)

# %% [markdown]
# ## The better model
#
# `diagnosis.final` is the fit with the named effects; it simulates, and its parameters carry unit and uncertainty.

# %%
diagnosis.final

# %% [markdown]
# The bench was made with inertia 0.045, gravity torque 0.9, viscous friction 0.05 and drag 0.012. If your verdict is `partly` or
# `unknown`, read *what to record next* at the end of the report: often the excitation, not the library, is what is missing.

# %%
report = diagnosis.report(folder / "report.html")
print(report.stat().st_size // 1000, "kB in one file")
