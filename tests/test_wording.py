"""Names of the program's own as a person says them."""

from __future__ import annotations

import pytest

from jaxid.base.wording import run_words


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Fahrt3", "Fahrt3"),
        ("Fahrt3#fit", "Fahrt3 (fit data)"),
        ("run_1#2", "run_1, part 2"),
        ("run_1#2#report", "run_1, part 2 (report data)"),
        ("lap #2b", "lap #2b"),
        ("#fit", "#fit"),
    ],
)
def test_runs_are_said_without_marks(name, said):
    assert run_words(name) == said
