"""How far long work is: one line with a share, the time that is left, and what stands so far.

Whatever works long calls `(stage, done, total, text)`; `Bar` is such a callback, and so is any
function of the user's own. Code that has no callback at hand calls `tell`, which reaches the one
that `telling` has set.
"""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import TextIO

from jaxid.base.wording import one_line


Callback = Callable[[str, int, int, str], None]

#: The stages of a diagnosis, in order: the shares of its work between which each lies. How long a
#: search goes on is not known before: the shares are those of common recordings.
STAGES = {
    "nominal fit": (0.02, 0.15),
    "screen": (0.15, 0.8),
    "refit": (0.2, 0.85),
    "simulated": (0.15, 0.85),
    "how far": (0.85, 1.0),
}
#: Seconds between two drawings; before as many seconds, and below this share, no end is foretold.
DRAW_S, SOON_S, SOON = 0.5, 2.0, 0.04
#: Letters of the bar itself.
WIDTH = 20


class ShareOfWork:
    """What share of the work is done, as its stages come; it never falls while they go on."""

    def __init__(self) -> None:
        self.stage = ""
        self.value: float | None = None
        self._staged = False

    def tell(self, stage: str, done: int, total: int) -> None:
        """Takes in how far a stage is; of one without a `total` no share is known."""
        within = min(1.0, done / total) if total > 0 else None
        if stage in STAGES:
            low, high = STAGES[stage]
            now = low + (high - low) * (within or 0.0)
            before = self.value if self._staged else None
            self.value = now if before is None else max(before, now)
            self._staged = True
        else:
            same = stage == self.stage and self.value is not None and within is not None
            self.value = max(self.value or 0.0, within or 0.0) if same else within
            self._staged = False
        self.stage = stage


def duration(seconds: float) -> str:
    """`42 s`, `3:05`, `1:02:03`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def left(share: float | None, spent: float) -> float | None:
    """Seconds that are left if work goes on as before; None where it is too early to say."""
    if share is None or share < SOON or spent < SOON_S:
        return None
    return spent * (1 - share) / share


class Bar:
    """A line on a terminal or in a notebook that is drawn anew; call it, and `stop` it in the end.

    `seconds`: a limit that the work was given, beyond which no end is foretold.
    """

    def __init__(self, stream: TextIO | None = None, seconds: float | None = None):
        self._stream = sys.stderr if stream is None else stream
        self._seconds = seconds
        self._share, self._text = ShareOfWork(), ""
        self._began = time.monotonic()
        self._drawn = 0  # letters of the line as it stands
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._clock = threading.Thread(target=self._tick, name="jaxid-progress", daemon=True)
        self._clock.start()

    def __call__(self, stage: str, done: int, total: int, text: str) -> None:
        with self._lock:
            self._share.tell(one_line(stage), done, total)
            self._text = one_line(text)

    def line(self, spent: float, columns: int) -> str:
        """What stands there after so many seconds, on so many columns."""
        share = self._share.value
        head = f"{duration(spent)}"
        if share is not None:
            filled = round(WIDTH * share)
            head = f"[{'#' * filled}{'.' * (WIDTH - filled)}] {share:4.0%}  {head}"
        rest = left(share, spent)
        if self._seconds is not None:
            limit = max(0.0, self._seconds - spent)
            rest = limit if rest is None else min(rest, limit)
        if rest is not None:
            head += f", about {duration(rest)} left"
        said = ": ".join(filter(None, (self._share.stage, self._text)))
        return f"{head}  {said}"[: max(10, columns - 1)]

    def stop(self) -> None:
        """Takes the line away."""
        self._ended.set()
        self._clock.join(timeout=2 * DRAW_S)
        with self._lock:
            self._write("")

    def _tick(self) -> None:
        while not self._ended.wait(DRAW_S):
            with self._lock:
                if self._ended.is_set():
                    return
                columns = shutil.get_terminal_size().columns
                self._write(self.line(time.monotonic() - self._began, columns))

    def _write(self, line: str) -> None:
        padding = " " * max(0, self._drawn - len(line))
        back = "" if line else "\r"
        with suppress(OSError, ValueError):  # a terminal that has gone
            self._stream.write(f"\r{line}{padding}{back}")
            self._stream.flush()
        self._drawn = len(line)


_told: ContextVar[Callback | None] = ContextVar("progress", default=None)


@contextmanager
def telling(callback: Callback | None) -> Iterator[None]:
    """While this is open, `tell` reaches the callback."""
    token = _told.set(callback)
    try:
        yield
    finally:
        _told.reset(token)


def tell(stage: str, done: int, total: int, text: str = "") -> None:
    """Says how far a stage is, to whoever listens."""
    callback = _told.get()
    if callback is not None:
        callback(stage, done, total, text)


class RedrawnLines:
    """Lines on a terminal that are drawn anew in their place."""

    def __init__(self, stream: TextIO | None = None):
        self._stream = sys.stderr if stream is None else stream
        self._lines = 0

    def show(self, text: str) -> None:
        """The text in the place of the one before, cut to the terminal."""
        size = shutil.get_terminal_size()
        lines = [line[: size.columns - 1] for line in text.split("\n")][: size.lines - 1]
        self._clear()
        with suppress(OSError, ValueError):
            self._stream.write("".join(f"{line}\n" for line in lines))
            self._stream.flush()
        self._lines = len(lines)

    def stop(self) -> None:
        """Takes the lines away."""
        self._clear()
        self._lines = 0

    def _clear(self) -> None:
        if self._lines:
            with suppress(OSError, ValueError):
                self._stream.write(f"\x1b[{self._lines}A\x1b[J")
                self._stream.flush()
