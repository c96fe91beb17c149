"""What kept a loop from coming round: measured, so that the end of a motion can name it."""

from __future__ import annotations

import time
from pathlib import Path

from jaxid.hardware.link import busy


RECENT_S = 1.0


class Pauses:
    """The longest pause of the last second or so. Call `lap` at every change of what the loop
    does.
    """

    def __init__(self):
        self._at = time.monotonic()
        self._worst, self._ended, self._doing = 0.0, self._at, ""

    def lap(self, planned: float = 0.0, doing: str = "") -> None:
        """What passed since the last lap beyond `planned` s was a pause; `doing` names work of
        others, nothing our own.
        """
        now = time.monotonic()
        pause = now - self._at - planned
        if pause > self._worst or now - self._ended > RECENT_S:
            self._worst, self._ended, self._doing = pause, now, doing
        self._at = now

    def said(self, allowed: float) -> str:
        """A sentence on a pause that matters where `allowed` s are, or nothing."""
        if self._worst < 0.5 * allowed or time.monotonic() - self._ended > RECENT_S:
            return ""
        if self._doing:
            return f"{self._doing} took {self._worst:.2f} s"
        return f"{busy(self._worst)}, or the recording process was suspended"


def waited(process: int) -> float:
    """For how long (s) the threads of a process were ready and got no processor, so far; 0 where
    the system does not tell.
    """
    total = 0.0
    for thread in Path(f"/proc/{process}/task").glob("*"):
        try:
            total += 1e-9 * int((thread / "schedstat").read_text(encoding="ascii").split()[1])
        except (OSError, ValueError, IndexError):
            continue
    return total


def kept_from_running(silence: float, kept: float) -> str:
    """What is known of why a driver was silent for so long, of which its threads were `kept`
    waiting for a processor.
    """
    if kept > 0.5 * silence:
        return f": {busy(min(kept, silence))}"
    return "; it hangs, or this computer was too busy to run it"


def progress_said(seconds: float, total: float, samples: int) -> tuple[str, int, int, str]:
    """What progress says of a recording: in whole seconds, and never beyond its end. A path whose
    commands were late takes longer than planned.
    """
    done = min(int(seconds), int(total))
    late = f", {seconds - total:.0f} s behind its plan" if seconds >= total + 1 else ""
    return "recording, seconds", done, int(total), f"{samples} samples{late}"
