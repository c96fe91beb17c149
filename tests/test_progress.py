"""What a command says while it works and when it ends."""

from __future__ import annotations

import io
import sys
import time
from types import SimpleNamespace
from typing import Any

import jaxid
from jaxid.base import progress
from jaxid.base.progress import Bar, duration, left, RedrawnLines, ShareOfWork
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


def told(share: ShareOfWork, *stages: tuple[str, int, int]) -> list[float]:
    """Shares after each stage; one that nobody knows is below all."""
    seen: list[float] = []
    for stage in stages:
        share.tell(*stage)
        seen.append(-1.0 if share.value is None else share.value)
    return seen


def test_the_share_of_a_diagnosis_never_falls():
    seen = told(
        ShareOfWork(),
        ("nominal fit", 0, 1),
        ("screen", 0, 3),
        ("refit", 0, 3),
        ("screen", 1, 3),
        ("refit", 1, 3),
        ("screen", 0, 3),
        ("how far", 0, 1),
    )
    assert seen == sorted(seen) and seen[0] < 0.1 < 0.8 < seen[-1] < 1


def test_the_share_of_a_counted_stage_is_what_is_counted():
    assert told(ShareOfWork(), ("de", 1, 4), ("de", 3, 4), ("posterior", 0, 8)) == [0.25, 0.75, 0.0]
    assert told(ShareOfWork(), ("unknown length", 3, 0)) == [-1.0]


def test_the_time_that_is_left_is_told_once_it_is_known():
    assert left(0.25, 30.0) == 90.0
    assert left(None, 30.0) is None and left(0.01, 30.0) is None and left(0.5, 0.1) is None
    assert [duration(s) for s in (4.4, 185.0, 3723.0)] == ["4 s", "3:05", "1:02:03"]


def test_a_line_says_share_time_and_what_stands_so_far():
    stream = io.StringIO()
    bar = Bar(stream)
    bar("refit", 1, 3, "so far dead_zone at tau\x1b[31m: 1.02 times the noise left")
    line = bar.line(60.0, 200)
    assert line.startswith("[########") and "42%  1:00, about 1:24 left" in line
    assert line.endswith("refit: so far dead_zone at tau?[31m: 1.02 times the noise left")
    assert len(bar.line(60.0, 40)) == 39
    bar.stop()
    assert "\x1b" not in stream.getvalue()


def test_a_limit_of_time_bounds_what_is_foretold():
    bar = Bar(io.StringIO(), seconds=70.0)
    bar("refit", 0, 3, "")
    assert "about 10 s left" in bar.line(60.0, 200)
    bar.stop()


def test_a_script_gets_the_same_line(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    with jaxid.runtime.progress_bar() as tell_bar:
        tell_bar("compare", 1, 2, "de, seed 0")
        deadline = time.monotonic() + 30
        while "compare: de, seed 0" not in stream.getvalue() and time.monotonic() < deadline:
            time.sleep(0.05)
    assert "50%" in stream.getvalue() and stream.getvalue().endswith(" \r")


def test_code_without_a_callback_reaches_the_one_that_listens():
    seen = []
    progress.tell("nobody", 0, 1)
    with progress.telling(lambda *what: seen.append(what)):
        progress.tell("friction law", 1, 4, "linear")
    progress.tell("nobody", 0, 1)
    assert seen == [("friction law", 1, 4, "linear")]


def test_lines_are_drawn_in_their_place():
    stream = io.StringIO()
    table = RedrawnLines(stream)
    table.show("one\ntwo")
    table.show("three")
    table.stop()
    assert stream.getvalue() == "one\ntwo\n\x1b[2A\x1b[Jthree\n\x1b[1A\x1b[J"
