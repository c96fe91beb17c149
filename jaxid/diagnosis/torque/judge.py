"""What is claimed of what a search by torque found, on runs that chose and on runs that did not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxid.base.wording import listed
from jaxid.diagnosis.budget import closed
from jaxid.diagnosis.reasons import (
    NothingSure,
    NotMostHeldOut,
    Reason,
    Remark,
    TorqueAtTheNoise,
    TorqueHeldOut,
    Undetermined,
)
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.against_reference import verdict_against
from jaxid.diagnosis.torque.answer import Answer, scores
from jaxid.diagnosis.torque.claims import believed
from jaxid.diagnosis.torque.found import Found
from jaxid.diagnosis.torque.library import Unit
from jaxid.diagnosis.torque.study import TorqueStudy
from jaxid.diagnosis.verdict import possible, Verdict
from jaxid.fitting.scores import lost


def judged_by_torque(study: TorqueStudy, found: Found) -> Verdict:
    """What is named comes down to the noise on runs that chose and on runs that did not."""
    nominal, final = found.nominal, found.final
    lost_at = astray(study, final)
    if lost_at:
        return Verdict("unknown", (Undetermined(lost_at[0]),))
    sets = [which for which in (found.choose, found.judge) if which] or [found.fit]
    if not final.units:
        return _nothing_claimed(found)
    names = tuple(map(_said, final.units))
    fitted = nominal.gap(found.fit)
    if found.as_before is not None:
        return verdict_against(names, found.as_before, final, sets, max(1.0, fitted))
    before = np.array([nominal.gap(which) for which in sets])
    after = np.array([final.gap(which) for which in sets])
    worst = max(after.tolist())
    share = min(closed(b**2, a**2) for b, a in zip(before.tolist(), after.tolist(), strict=True))
    if not (after < before).all():
        return Verdict("unknown", (NotMostHeldOut(names, share, worst),))
    # Where the question is what differs, what the model leaves of the runs that it was fitted to is
    # what repeats would differ by.
    least = max(1.0, fitted) if found.different and np.isfinite(fitted) else 1.0
    told = least if least > LIMITS.near else 0.0
    held = TorqueHeldOut(names, share, worst, found.different, fitted=told)
    inside = closed(fitted**2, final.gap(found.fit) ** 2)
    most = np.isfinite(before).all() and min(share, inside) >= LIMITS.named
    if worst <= LIMITS.left * least or most:
        return Verdict("named", (*_in_all_runs(found), held, *_families(found)))
    held = replace(held, whole=False)
    return Verdict("partly", (*_in_all_runs(found), held, *_families(found), *_over(found)))


def _in_all_runs(found: Found) -> list[Remark]:
    """What the model lacks in all runs, where the question is what differs in some."""
    if found.base is None or not found.base.final.units:
        return []
    return [Remark(f"The model lacks {listed(map(_said, found.base.final.units))}.")]


def _nothing_claimed(found: Found) -> Verdict:
    """By what the re-tuned model leaves of the runs of each kind."""
    runs = {"fit": found.fit, "validation": found.choose, "report": found.judge}
    gaps = {data: found.nominal.gap(which) for data, which in runs.items() if which}
    measured = {data: gap for data, gap in gaps.items() if not np.isnan(gap)}  # of what moves
    worst = max(measured, key=lambda data: measured[data], default="report")
    largest = measured.get(worst, float("nan"))
    if largest <= LIMITS.near:
        return Verdict("none", (TorqueAtTheNoise(),))
    return Verdict("unknown", (NothingSure(largest, worst), *_possible(found)))


def _families(found: Found) -> list[Remark]:
    """What each effect stands for that is not sure by itself."""
    units, out = found.weighed.scales.units, []
    for claim in found.claims:
        if claim.instead:
            own = units[claim.unit]
            either = " or ".join(units[u].effect for u in claim.instead)
            out.append(Remark(f"In the place of {own} it may be {either}."))
    return out


def _possible(found: Found) -> list[Reason]:
    """What is not sure enough to be claimed."""
    return [*possible(believed(found.weighed, ())), *_over(found)]


def _over(found: Found) -> list[Remark]:
    """What a law of no name depends on, where it is probable."""
    law = believed(found.weighed, ()).free_law
    if law is None or law.probability < found.weighed.scales.rule.sure:
        return []
    return [Remark(law.sentence)]


def astray(study: TorqueStudy, answer: Answer) -> tuple[str, ...]:
    """A sentence where a model predicts held-out torque worse than none would."""
    noise = {
        c: s for (c, _), s in zip(study.binding.chain.torque_channels, study.noise, strict=True)
    }
    return lost(scores(answer), noise)


def _said(unit: Unit) -> str:
    return (
        f"payload at link {unit.joints[-1] + 1} ({unit.location})"
        if unit.effect == "payload"
        else str(unit)
    )
