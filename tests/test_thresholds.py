"""The numbers that the diagnosis decides by stand in one place, each with its unit, its reason and
its case.
"""

from __future__ import annotations

import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

from jaxid.diagnosis.thresholds import LIMITS, Thresholds


SOURCES = Path(__file__).parents[1] / "jaxid" / "diagnosis"


def test_each_has_a_unit_a_reason_and_a_case_and_none_can_be_moved():
    for name, value, unit, reason, case in LIMITS.table():
        assert isinstance(value, float) and unit and len(reason) > 20 and case, name
    reasons = [reason for *_, reason, _ in LIMITS.table()]
    assert len(set(reasons)) == len(reasons)
    with pytest.raises(FrozenInstanceError):
        LIMITS.named = 0.5  # pyright: ignore[reportAttributeAccessIssue]


def test_each_decides_something():
    text = "".join(p.read_text() for p in SOURCES.rglob("*.py"))
    text += "".join(p.read_text() for p in (SOURCES.parent / "report").rglob("*.py"))
    unused = [f for f, *_ in Thresholds().table() if not re.search(rf"LIMITS\.{f}\b", text)]
    assert not unused


def test_there_are_few_and_each_has_a_recorded_case():
    rows = LIMITS.table()
    assert len(rows) <= 15
    assert not [name for name, *_, case in rows if case == "not recorded"]
