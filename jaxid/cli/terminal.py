"""What commands write to a terminal: text without control characters, errors, progress."""

from __future__ import annotations

import logging
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from jaxid.base.errors import DatasetWarning
from jaxid.base.progress import Bar
from jaxid.base.wording import clean, complain as complain, number, one_line


def say(text: object) -> None:
    print(clean(text))


@contextmanager
def warnings_said_once() -> Iterator[None]:
    """Warnings on the user's own data as sentences, each once, whichever line of ours reads the
    same file again.
    """
    with warnings.catch_warnings():
        show, said = warnings.showwarning, set()

        def say_once(message, category, *where: Any, **more: Any) -> None:
            if of_arithmetic(message, category):
                logging.getLogger("jaxid").debug("%s", message)
            elif not issubclass(category, DatasetWarning):
                show(message, category, *where, **more)
            elif str(message) not in said:
                said.add(str(message))
                complain(message)

        warnings.showwarning = say_once
        yield


_BEGAN = [time.monotonic()]  # the command; one process may run several, one after the other


def begin() -> None:
    """A command begins."""
    _BEGAN[0] = time.monotonic()


def say_time() -> None:
    """How long the command took, reading, checking, compiling and its page included."""
    say(f"The command took {number(time.monotonic() - _BEGAN[0])} s")


def give_back() -> None:
    """Takes a line of progress away, for a process that ends at once."""
    with suppress(OSError):
        if sys.stderr.isatty():
            sys.stderr.write("\r\x1b[K")


def interrupted() -> None:
    """The last words of a process that does not end in time and has nothing to keep."""
    give_back()
    complain("interrupted")


#: What NumPy's warnings of single operations begin with.
ARITHMETIC = (
    "divide by zero",
    "invalid value",
    "overflow encountered",
    "underflow encountered",
    "Degrees of",
    "Mean of empty",
)


def of_arithmetic(message: Any, category: type[Warning]) -> bool:
    """Whether a warning is one of an operation on arrays, which tells a user nothing; they go to
    the log `jaxid`, as debug.
    """
    return issubclass(category, RuntimeWarning) and str(message).startswith(ARITHMETIC)


#: Seconds between two lines of progress where standard error is no terminal.
LINE_S = 30.0


class Progress:
    """A line of progress on standard error while work goes on; one every half minute where that is
    no terminal. `seconds`: the limit that the work was given.
    """

    def __init__(self, quiet: bool, seconds: float | None = None):
        self.callback: Callable[[str, int, int, str], None] | None = None
        self._bar: Bar | None = None
        self._seconds = seconds
        if quiet:
            return
        if sys.stderr.isatty():
            self.callback = self._drawn
            return
        self._began = self._told = time.monotonic()
        self.callback = self._line

    def _drawn(self, stage: str, done: int, total: int, text: str) -> None:
        if self._bar is not None:
            self._bar(stage, done, total, text)

    def _line(self, stage: str, done: int, total: int, text: str) -> None:
        now = time.monotonic()
        if now - self._told >= LINE_S:
            self._told = now
            part = f" {done} of {total}" if total else ""
            complain(
                f"{one_line(stage)}{part}{', ' if text else ''}{one_line(text)}"
                f" ({now - self._began:.0f} s)"
            )

    def __enter__(self) -> Progress:
        if self.callback == self._drawn:
            self._bar = Bar(seconds=self._seconds)
        return self

    def stop(self) -> None:
        """Takes the line away; what is written afterwards stands by itself."""
        if self._bar is not None:
            self._bar.stop()
        self._bar = self.callback = None

    def __exit__(self, *exception) -> None:
        self.stop()
