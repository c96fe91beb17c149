"""A limit to the time that a call may take: what is known by then is its answer."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from typing import Any, TypeVar

from jaxid.base.computer import cores
from jaxid.base.errors import UsageError
from jaxid.base.stopping import Interrupted


T = TypeVar("T", bound=Any)

#: The share of the time after which a search asks nothing more, so that what it has found is still
#: judged, and its place said.
SEARCH = 0.6

#: How long the calling thread is given to hear of an interruption that was sent at the very end, s.
DELIVERY_S = 0.05


class Deadline:
    """Seconds that a call may take; `passed` once it was interrupted for them, `search_was_cut`
    once a search has asked less for them.
    """

    def __init__(self, seconds: float):
        """Raises `UsageError` for a time that is not above 0."""
        if not seconds > 0:
            raise UsageError(f"{seconds:g} seconds are none; give a time above 0, such as 60")
        self.seconds = seconds
        self.began = time.monotonic()
        self.passed = False
        self.search_was_cut = False

    def search_is_over(self) -> bool:
        """Whether what is left of the time belongs to the judgement of what was found."""
        over = time.monotonic() - self.began > SEARCH * self.seconds
        self.search_was_cut |= over
        return over


_deadline: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


def search_is_over() -> bool:
    """Whether a search inside `deadline` has had its share of the time."""
    ends = _deadline.get()
    return ends is not None and ends.search_is_over()


@contextmanager
def deadline(ends: Deadline | None) -> Iterator[None]:
    """Interrupts what is inside after its seconds, as Ctrl-C would: by a `KeyboardInterrupt` in the
    thread that entered, as soon as it runs Python. A program that is being compiled or run is
    waited for. None: no limit.
    """
    if ends is None:
        yield
        return
    entered, inside = threading.Event(), threading.Event()
    inside.set()
    lock = threading.Lock()
    thread = ctypes.c_ulong(threading.get_ident())

    def interrupt() -> None:
        entered.wait()  # or it would be raised where nobody expects it
        with lock:
            if inside.is_set():
                ends.passed = True
                interruption = ctypes.py_object(KeyboardInterrupt)
                ctypes.pythonapi.PyThreadState_SetAsyncExc(thread, interruption)

    timer = threading.Timer(ends.seconds, interrupt)
    timer.daemon = True
    timer.start()
    token = _deadline.set(ends)
    heard = False
    try:
        entered.set()
        yield
    except KeyboardInterrupt:
        heard = True
        raise
    finally:
        timer.cancel()
        with lock:
            inside.clear()
        _deadline.reset(token)
        if ends.passed and not heard:
            _take_delivery()


def _take_delivery() -> None:
    """Waits for an interruption that is on its way to this thread, which has ended its work."""
    end = time.monotonic() + DELIVERY_S
    try:
        while time.monotonic() < end:
            time.sleep(0.001)
    except KeyboardInterrupt:
        return


def answered_in_time(seconds: float | None, answer: Callable[[], T]) -> T:
    """The answer, a dataclass with `complete` and `notes`; after this many seconds what is known by
    then, with `complete` false. Raises `UsageError` where nothing is known yet.
    """
    ends = None if seconds is None else Deadline(seconds)
    try:
        with deadline(ends):
            found = answer()
    except KeyboardInterrupt as stop:
        if ends is None or not ends.passed:
            raise
        partial = stop.partial if isinstance(stop, Interrupted) else None
        if partial is None:
            raise UsageError(
                f"after {seconds:g} s nothing was known yet: give more seconds, fewer effects or"
                " shorter recordings"
            ) from stop
        note = f"this is what was known after {seconds:g} s: the search had not come to its end"
        return replace(partial, complete=False, notes=(*partial.notes, note))
    if ends is None or not ends.search_was_cut:
        return found
    note = f"within {seconds:g} s not all was compared that the data call for"
    return replace(found, complete=False, notes=(*found.notes, note))


def share_of_time(jobs: int) -> float:
    """The share of the time that each of several jobs may take, which run one per core."""
    return min(jobs, cores()) / jobs
