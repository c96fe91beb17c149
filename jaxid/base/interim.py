"""Results before the end: what is known while work goes on."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any


#: Making and passing on interim results takes at most about this share of the time.
SHARE = 0.1


_listener: ContextVar[Callable[[Any], None] | None] = ContextVar("listener", default=None)


@contextmanager
def listening(heard: Callable[[Any], None]) -> Iterator[None]:
    """Inside, `heard` is called with what `jaxid.fit`, `jaxid.diagnose` and `jaxid.compare` know
    before their end: a `Fit` that is to be refined, a `Diagnosis` that says where the gap lies, a
    `Comparison` of the runs that are finished.
    """
    token = _listener.set(heard)
    try:
        yield
    finally:
        _listener.reset(token)


class Interim:
    """Passes interim results on to whoever listens, the first after `after` seconds, later ones as
    `SHARE` allows; `silent` ones to nobody.
    """

    def __init__(self, silent: bool = False, after: float = 0.0):
        self._heard = None if silent else _listener.get()
        self._make: Callable[[], Any] | None = None
        self._told: Any = None
        self._next = time.perf_counter() + after

    def offer(self, make: Callable[[], Any]) -> None:
        """`make` gives what is known now; it is called here, or by `latest`, or not at all."""
        self._make, began = make, time.perf_counter()
        if self._heard is None or began < self._next:
            return
        self._told = make()
        self._heard(self._told)
        now = time.perf_counter()
        self._next = now + (now - began) / SHARE

    def tell(self, result: Any) -> None:
        """Passes on a result that is there already."""
        self._told = result
        if self._heard is not None:
            self._heard(result)

    def latest(self) -> Any:
        """What was passed on last, which takes no time; where nothing was, what is known now; None
        if nothing is.
        """
        if self._told is not None or self._make is None:
            return self._told
        return self._make()
