"""What a command says while it works and when it ends."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from jaxid.cli import terminal
from jaxid.diagnosis.selection import in_lead


def refitted(fit: float, validation: float, *effects: str) -> Any:
    return SimpleNamespace(
        effects=effects,
        fit_loss=fit,
        path=SimpleNamespace(count=100),
        validation=SimpleNamespace(loss=validation, count=100),
    )


def test_the_leader_and_its_gap_stand_in_the_line_of_progress():
    known = [
        refitted(400.0, 400.0),
        refitted(9.0, 9.0, "dead_zone at tau"),
        refitted(100.0, 1.0, "backlash at q"),
    ]
    assert in_lead(known) == "so far dead_zone at tau: 3.0 times the noise left"
    assert in_lead(known[:1]) == "", "nothing was refitted yet"


def test_the_time_is_that_of_the_command(capsys, monkeypatch):
    monkeypatch.setattr(terminal.time, "monotonic", lambda: 100.0)
    terminal.begin()
    monkeypatch.setattr(terminal.time, "monotonic", lambda: 153.0)
    terminal.say_time()
    assert capsys.readouterr().out == "The command took 53.0 s\n"
