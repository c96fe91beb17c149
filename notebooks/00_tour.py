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
# # A tour in ten minutes
#
# A simulator is a claim about a machine. This notebook takes a recording and a model that does not reproduce it, and asks three
# questions: **where** is the model wrong, **which** effect does it lack, **how far** does the gap shrink once that effect is
# added?
#
# The recording is shipped with jaxid: a pendulum driven by a servo, simulated by MuJoCo with something in its drive that the
# model does not know. What it is stands only in the script that made it.

# %%
from jaxid.runtime import prepare


prepare()  # keeps compiled programs between sessions; call it before anything imports JAX

import matplotlib.pyplot as plt
from budget import CANDIDATES, EXAMPLE, FRAMES
from IPython.display import HTML

import jaxid


# %% [markdown]
# ## The data
#
# A folder with recordings and a `dataset.toml` that names channels and units. Everything is checked on loading; what is broken
# is refused with file, row, column and remedy.

# %%
data = jaxid.load_dataset(EXAMPLE)
data

# %%
ax = data.plot("q")

# %% [markdown]
# `fit` runs are fitted, `validation` runs choose between effects, `report` runs are touched once, for the final figure.
#
# ## A fit
#
# The model is named in the dataset: `pendulum`, one joint with gravity, viscous and Coulomb friction. `None` means that one.

# %%
fit = jaxid.fit(None, data)
fit

# %% [markdown]
# The loss is in multiples of the noise: 1.0 would be down to the noise. It is nowhere near, so these standard deviations describe
# a model that is wrong; that is what the next section is for.

# %%
ax = fit.plot()

# %% [markdown]
# ## The diagnosis
#
# Every effect of the library is a candidate. Each is added, everything is refitted, and the choice is made on data that was
# not fitted.

# %%
diagnosis = jaxid.diagnose(None, data, effects=CANDIDATES)
diagnosis

# %% [markdown]
# The same as numbers. `confusable_with` is part of the claim: what these data cannot tell from the effect that was named.

# %%
print(diagnosis.which.verdict, [str(e) for e in diagnosis.which.effects])
print("cannot be told from:", [str(e) for e in diagnosis.which.confusable_with])
print("gap:", diagnosis.how_far.gap_before, "→", diagnosis.how_far.gap_after, "times the noise")

# %%
assert diagnosis.which.verdict == "named" and "dead_zone" in [
    e.effect for e in diagnosis.which.effects
]

# %% [markdown]
# ## What was missing, in the plane of position and velocity
#
# The force that the model lacked, along the motion: left before, right with the named effect, in the same colours. A dead zone
# takes away the same torque wherever the drive pushes, so the sign of the missing force is that of the command, not of the
# velocity: no friction law does that.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8), sharey=True, layout="constrained")
longest = max(diagnosis.missing_force, key=lambda m: len(m.t))
longest.plot(ax=left)
ax = longest.plot(after=True, ax=right)

# %% [markdown]
# And over time, on the recording that was never fitted nor chosen on:

# %%
reported = next(t for t in diagnosis.traces if t.split == "report")
figure, (top, bottom) = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
reported.plot(ax=top).set_xlabel("")
final = list(reported.simulated)[-1]
ax = type(reported)(**{**vars(reported), "simulated": {final: reported.simulated[final]}}).plot(
    ax=bottom
)

# %% [markdown]
# ## The mechanism in motion
#
# `simulate` runs a model with given parameters; a result knows how its mechanism looks.

# %%
better = jaxid.simulate(None, data, diagnosis.final)
motion = better.motion(0)
ax = motion.strip(count=8)

# %%
HTML(motion.animate(seconds=6, frames=FRAMES).to_jshtml(default_mode="loop"))

# %% [markdown]
# ## On your own robot
#
# `diagnosis.report("report.html")` writes all of this into one page that opens offline, `jaxid diagnose FOLDER --out DIR` does
# the whole from the command line, and the notebook *Diagnose your own robot* begins with a CSV file.
