"""Layouts of benches as twins: nothing is claimed where nothing is missing, and what is withheld is
among what is claimed.
"""

from __future__ import annotations

import pytest

from benchmarks.rig_layouts import CONVENTIONS, conventions, diagnosed, fitted, LAYOUTS


def test_every_convention_of_the_cylinder_is_found():
    row = conventions("pneumatic cylinder, two pressures", "", 2)
    assert (
        row["right"] == f"{len(CONVENTIONS['pneumatic cylinder, two pressures'])} found"
        and not row["wrong"]
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYOUTS)
def test_fits_with_nothing_missing_hold_the_truth(name):
    assert not fitted(name, range(2))["wrong"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "withheld"), [(n, w) for n in LAYOUTS for w in ("", *LAYOUTS[n].withheld)]
)
def test_what_is_withheld_is_named_and_nothing_else(name, withheld):
    assert diagnosed(name, withheld, 1)["right"]
