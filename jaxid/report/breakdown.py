"""How far the gap shrinks in each held-out run, and in each situation the machine was in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxid.base import wording
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.diagnosis.result import Diagnosis


def section(diagnosis: Diagnosis) -> Section | None:
    far = diagnosis.how_far
    if not diagnosis.which.effects or not (far.per_regime or len(far.per_run) > 1):
        return None
    joints = {s.joint for s in far.per_regime}

    def name(s):
        return (
            f"{s.joint}, {wording.regime_words(s.part)}"
            if len(joints) > 1
            else wording.regime_words(s.part)
        )

    rows = [(s.part, s) for s in far.per_run] if len(far.per_run) > 1 else []
    rows += [(name(s), s) for s in sorted(far.per_regime, key=lambda s: -s.after)]
    return Section("breakdown.html", {"rows": rows, "split": far.split, "joints": len(joints) > 1})
