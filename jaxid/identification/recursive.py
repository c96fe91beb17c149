"""Weighted least squares of an arm sample by sample, and after which time its payload has
converged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from jaxid.dynamics.base_parameters import BaseParameters
from jaxid.identification.estimators import SEEN
from jaxid.identification.regression import every_row, FrictionLaw, RegressionRun, spacing
from jaxid.identification.result import Identification


#: Variance of a parameter that nothing is known of, in units of the square of what one unit of
#: noise in every row makes of it.
UNKNOWN = 1e10
#: Sampling rate for which paper 001 states its stopping rule.
PAPER_HZ = 125.0


def recursive(
    fit: Sequence[RegressionRun],
    law: FrictionLaw,
    exponent: np.ndarray,
    weights: Sequence[np.ndarray],
    prior: np.ndarray,
) -> np.ndarray:
    """Weighted least squares sample by sample: the recursion over all rows of the fit runs, one run
    after the other, from the model's own values, of which next to nothing is trusted.
    """
    from jaxid.fitting.recursive_least_squares import replay_stretches

    size = np.zeros(len(prior))
    for r, w in zip(fit, weights, strict=True):
        for _, W, _ in every_row(r, law, exponent):
            size = np.hypot(size, np.linalg.norm((W * w[:, None]).reshape(-1, len(prior)), axis=0))
    seen = size > SEEN * size.max()
    scale = np.where(
        seen, size, np.inf
    )  # a column that shows nothing leaves its parameter where it is

    def stretches() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for r, w in zip(fit, weights, strict=True):
            for at, W, _ in every_row(r, law, exponent):
                Y = W * w[:, None]
                yield Y / scale, r.tau[at] * w - Y @ prior

    found = replay_stretches(stretches(), np.zeros_like(prior), noise_var=1.0, prior_var=UNKNOWN)[0]
    return prior + found / scale


def converged_after(
    runs: Sequence[RegressionRun],
    law: FrictionLaw,
    exponent: np.ndarray,
    loaded: Identification,
    before: Mapping[str, Any],
    base: BaseParameters,
    weights: Sequence[np.ndarray],
) -> float | None:
    """Seconds of the first fit run after which the paper's stopping rule holds for the last link's
    parameters, from the unloaded arm's parameters with the paper's P0 = 10; None: never within the
    run.
    """
    from jaxid.fitting.recursive_least_squares import replay_stretches, Rule
    from jaxid.identification.online import watched_of

    first = next(r for r in runs if r.split == "fit")
    known = {e["name"]: e["value"] for e in before["base_parameters"]}
    for entry in before["friction"]:
        joint = entry["joint"][1:]
        known |= {f"{k}{joint}": v["value"] for k, v in entry.items() if k != "joint"}
    prior = np.array(
        [known.get(name, value) for name, value in zip(loaded.names, loaded.theta, strict=True)],
        float,
    )
    step = float(np.median(np.diff(first.t)))
    # Rows between those that say something new hold the same noise: each counts with that much more
    # variance.
    noise = np.asarray(weights[0]) ** -2.0 * spacing(first)
    rule = Rule(samples=round(Rule().samples / PAPER_HZ / step))
    _, _, met = replay_stretches(
        ((W, first.tau[at]) for at, W, _ in every_row(first, law, exponent)),
        prior,
        noise_var=noise,
        prior_var=10.0,
        watched=watched_of(base, loaded.joints),
        rule=rule,
    )
    return None if met is None else met * step
