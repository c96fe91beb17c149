"""What a recording tells of the numbers of a drive law, and which of them it tells only together
with dry friction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.base.wording import listed
from jaxid.fitting.result import Fit


NUMBERS = ("kp", "kd", "delay")
#: Two numbers whose correlation is at least so large are known together and not each.
TOGETHER = 0.95


def law_told(fit: Fit, joints: Sequence[str]) -> list[str]:
    """A sentence for each number of the law that was fitted: its values with standard deviations,
    joint by joint, and whether dry friction passes for it.
    """
    out = []
    for number in NUMBERS:
        own = [j for j in joints if f"{number}@{j}" in fit.parameters]
        if not own:
            continue
        with_friction = {j: correlation(fit, f"{number}@{j}", f"frictionloss@{j}") for j in own}
        known = {j: r for j, r in with_friction.items() if r is not None}
        text = f"{number} of the law: " + listed([_value(fit, number, j) for j in own])
        together = [j for j, r in known.items() if abs(r) >= TOGETHER]
        apart = {j: r for j, r in known.items() if j not in together}
        if together:
            text += (
                f"; known only together with its dry friction at {listed(together)} (correlation"
                f" {TOGETHER:g} or more)"
            )
        if apart:
            largest = max(apart.values(), key=abs)
            text += (
                f"; told apart from dry friction at {listed(list(apart))} (correlation"
                f" {largest:+.2f} at most)"
            )
        out.append(text)
    return out


def correlation(fit: Fit, a: str, b: str) -> float | None:
    """Correlation of two numbers of a fit; None where either is not determined."""
    c = fit.covariance
    if c is None or not all(
        n in c.names and n in fit.parameters and fit.parameters[n].std is not None for n in (a, b)
    ):
        return None
    i, j = (list(c.names).index(n) for n in (a, b))
    M = np.asarray(c.matrix)
    with np.errstate(all="ignore"):
        r = float(M[i, j] / np.sqrt(M[i, i] * M[j, j]))
    return r if abs(r) <= 1 + 1e-6 else None


def _value(fit: Fit, number: str, joint: str) -> str:
    e = fit.parameters[f"{number}@{joint}"]
    return (
        f"{joint} not determined"
        if e.std is None
        else f"{joint} {e.value:.3g} ± {e.std:.2g} {e.unit}"
    )
