"""A limit to the time of an answer: it is kept, nothing is left of it, and what is known is said."""

from __future__ import annotations

import json
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from jaxid.base.deadline import (
    answered_in_time,
    Deadline,
    deadline,
    search_is_over,
    share_of_time,
)
from jaxid.base.errors import UsageError
from jaxid.base.stopping import Interrupted
from jaxid.cli.app import main
from jaxid.diagnosis.search import Searcher


EXAMPLE = Path(__file__).parents[1] / "examples" / "servo_pendulum"


@dataclass(frozen=True)
class Answer:
    number: int
    notes: tuple[str, ...] = ()
    complete: bool = True


def busy(seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass


def test_what_is_inside_is_interrupted_where_it_runs_python():
    began = time.monotonic()
    ends = Deadline(0.1)
    with pytest.raises(KeyboardInterrupt), deadline(ends):
        busy(20.0)
    assert ends.passed
    assert time.monotonic() - began < 10.0


def test_in_another_thread_that_thread_alone_is_interrupted():
    heard = []

    def work():
        try:
            with deadline(Deadline(0.1)):
                busy(20.0)
        except KeyboardInterrupt:
            heard.append(threading.current_thread())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(15.0)
    assert heard == [thread]


@pytest.mark.parametrize("length", [0.0, 0.01, 0.02, 0.03])
def test_no_interruption_comes_after_the_end(length):
    for _ in range(5):
        try:
            with deadline(Deadline(0.02)):
                busy(length)
        except KeyboardInterrupt:
            pass
        busy(0.03)


def test_a_search_has_its_share_of_the_time():
    assert not search_is_over()
    ends = Deadline(1.0)
    with deadline(ends):
        assert not search_is_over() and not ends.search_was_cut
        ends.began -= 0.9
        assert search_is_over() and ends.search_was_cut
    assert not search_is_over()


def test_a_search_asks_nothing_more_then():
    problem = SimpleNamespace(work=1)
    fits = SimpleNamespace(
        benches=[SimpleNamespace(simulated=lambda: 0)],
        nominal=SimpleNamespace(path=SimpleNamespace(problem=problem)),
    )
    searcher = SimpleNamespace(fits=fits, tried={}, _cut_short=False)
    goes_on = cast(Any, Searcher._goes_on)
    ends = Deadline(1.0)
    with deadline(ends):
        assert goes_on(searcher)
        ends.began -= 0.9
        assert goes_on(searcher)  # the first effects are asked in any case
        searcher.tried = {"an effect": "its fit"}
        assert not goes_on(searcher) and ends.search_was_cut


def test_what_is_known_by_then_is_the_answer():
    def slow() -> Answer:
        try:
            busy(20.0)
        except KeyboardInterrupt as stop:
            raise Interrupted(Answer(1)) from stop
        return Answer(2)

    found = answered_in_time(0.1, slow)
    assert found.number == 1 and not found.complete and "0.1 s" in found.notes[-1]
    assert answered_in_time(20.0, lambda: Answer(3)) == Answer(3)
    assert answered_in_time(None, lambda: Answer(3)) == Answer(3)
    with pytest.raises(UsageError, match="nothing was known yet"):
        answered_in_time(0.1, lambda: busy(20.0))
    with pytest.raises(UsageError, match="above 0"):
        answered_in_time(0.0, lambda: Answer(3))


def test_ctrl_c_within_the_time_is_ctrl_c():
    def stopped() -> Answer:
        raise Interrupted(Answer(1))

    with pytest.raises(Interrupted):
        answered_in_time(20.0, stopped)


def test_jobs_share_the_cores(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert [share_of_time(jobs) for jobs in (1, 2, 4)] == [1.0, 1.0, 0.5]


def test_the_command_keeps_to_its_time(tmp_path, capsys):
    arguments = ["diagnose", str(EXAMPLE), "--out", str(tmp_path), "--quiet", "--json"]
    assert main([*arguments, "--seconds", "0.01"]) == 2
    assert "after 0.01 s nothing was known yet" in capsys.readouterr().err
    few = ["--effects", "input_delay", "--max-effects", "1", "--seconds", "3600"]
    assert main([*arguments, *few]) == 0
    assert json.loads(capsys.readouterr().out)["complete"] is True


def test_time_that_is_over_before_the_work_begins_interrupts_the_work_alone(monkeypatch):
    """A busy machine may take longer to begin than the time that was given."""

    class Late(threading.Timer):
        def start(self):
            super().start()
            time.sleep(0.05)

    def work():
        while True:
            time.sleep(0.001)

    monkeypatch.setattr("jaxid.base.deadline.threading.Timer", Late)
    with pytest.raises(UsageError, match="nothing was known yet"):
        answered_in_time(1e-3, work)
