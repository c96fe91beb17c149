"""What is different from a reference: its bodies in the place of re-tuned ones, and how far what
was found goes from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxid.diagnosis.budget import closed
from jaxid.diagnosis.reasons import NotMostHeldOut, TorqueHeldOut
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.algebra import solve
from jaxid.diagnosis.torque.answer import Answer
from jaxid.diagnosis.torque.choose import Chooser
from jaxid.diagnosis.verdict import Verdict


def as_before(
    chooser: Chooser, nominal: Answer, held: Sequence[Sequence[int]], fit: Sequence[int]
) -> Answer | None:
    """The model with the bodies of the reference and all else fitted to the `fit` runs.

    None without a reference, and where it predicts the `held` runs as well as the re-tuned
    `nominal` does those that it was fitted to: then no body is different.
    """
    if chooser.departs is None:
        return None
    bodies, mean = chooser.departs.at, chooser.departs.mean
    others = np.setdiff1d(np.arange(chooser.size), bodies)
    left = chooser.fit.total.copy()
    left[:, -1] -= left[:, bodies] @ mean
    found = solve(left, others, chooser.known, chooser.start, chooser.lower, chooser.upper)
    numbers = nominal.numbers.copy()
    numbers[bodies] = mean
    numbers[others] = found.theta
    answer = replace(nominal, numbers=numbers)
    usual = LIMITS.left * max(1.0, nominal.gap(fit))
    differs = any(answer.gap(which) > usual for which in held if which)
    return answer if differs else None


def verdict_against(
    names: tuple[str, ...],
    before: Answer,
    after: Answer,
    sets: Sequence[Sequence[int]],
    usual: float,
) -> Verdict:
    """What is named goes from the model of the reference, `before`, to what a re-tuned one leaves
    of the runs that it was fitted to (`usual`, times the noise): in every one of the `sets` of runs
    that were not.
    """
    was, left = [before.gap(w) for w in sets], [after.gap(w) for w in sets]
    pairs = list(zip(was, left, strict=True))
    share = min(closed((b / usual) ** 2, (a / usual) ** 2) for b, a in pairs)
    if not np.isfinite([*was, *left, usual]).all():
        return Verdict("unknown", (NotMostHeldOut(names, 0.0, max(left)),))
    if not all(a < b for b, a in pairs) or share < LIMITS.half:
        return Verdict("unknown", (NotMostHeldOut(names, share, max(left)),))
    fitted = usual if usual > LIMITS.near else 0.0
    whole = max(left) <= LIMITS.left * usual
    reason = TorqueHeldOut(names, share, max(left), whole=whole, fitted=fitted, reference=True)
    return Verdict("named" if whole else "partly", (reason,))
