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
# # Gradient against population
#
# Levenberg-Marquardt follows derivatives from many starts; differential evolution, swarms and genetic algorithms need none. Which is
# better? `jaxid.compare` runs all of them on the *same compiled loss*, from the same random starts, with the same budget of
# evaluations, several seeds each. (A residual with its derivatives counts as one evaluation more than there are parameters.)
#
# Here that is five seeds of 3,000 evaluations, so that the notebook takes minutes. For a claim of your own take the 10,000 evaluations
# that `jaxid compare` gives each run, and as many seeds as your patience allows: `notebooks/budget.py` holds both numbers. Most
# populations are still on their way down when this budget ends: read their curves, not only their counts.

# %%
from jaxid.runtime import prepare


prepare()

from budget import COMPARED, EVALUATIONS, EXAMPLE, SEEDS

import jaxid


data = jaxid.load_dataset(EXAMPLE)

# %% [markdown]
# ## A problem where the free run forgives little
#
# The shipped pendulum with its dead zone: six parameters, twenty seconds of free run. Wrong parameters swing over another way, so
# the loss has more than one valley.

# %%
comparison = jaxid.compare(
    None, data, fitters=COMPARED, seeds=SEEDS, budget=EVALUATIONS, effects=["dead_zone"]
)
comparison

# %% [markdown]
# A single picture on axes of your own, by evaluations or by seconds:

# %%
ax = comparison.plot(by="evaluations")

# %%
ax = comparison.plot(by="seconds")

# %%
for row in comparison.table:
    low, high = row.success_interval_95
    print(
        f"{row.fitter:7} {row.successes:2} of {row.runs} ({100 * low:.0f} to {100 * high:.0f} %), median loss {row.loss.median:.4g}"
    )

# %% [markdown]
# ## The same loss without derivatives that help
#
# The sum of absolute errors is not smooth where errors vanish. `lm` needs squares and does not take part; `bfgs` and the
# populations do.

# %%
rough = jaxid.compare(
    None, data, fitters=[f for f in COMPARED if f not in ("lm", "hybrid")] + ["bfgs"], seeds=SEEDS, budget=EVALUATIONS,
    effects=["dead_zone"], loss="sum_of_abs",
)  # fmt: skip
ax = rough.plot()

# %% [markdown]
# ## How to read it
#
# - Count *successes*, not averages: a mean over runs of which some failed says nothing. Intervals belong to every rate, and five
#   seeds give very wide ones: 5 of 5 says no more than "above 57 %". A run that the budget ended might have arrived later.
# - Look at both axes. A population evaluates its members side by side, so it does better by seconds than by evaluations.
# - `hybrid` (a population, then Levenberg-Marquardt from its best points) is what to take where nothing is known of the start.
