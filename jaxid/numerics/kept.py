"""Programs that are kept for the next model of their structure: of all kinds together those used
last.

A compiled program of a robot takes some ten megabytes. A process that looks at one robot after the
other would keep what no other will ever use; one that is needed again is made anew, from the folder
of compiled programs where there is one.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import RLock
from typing import Any, TypeVar


T = TypeVar("T")

#: This many are kept. A compiled one of the flexible link takes about 500 regions of memory, of
#: which Linux gives a process 65530.
MOST = 64
_KEPT: OrderedDict[tuple[str, Hashable], Any] = OrderedDict()
_LOCK = RLock()


def shared(kind: str, key: Hashable, make: Callable[[], T]) -> T:
    """The program of a kind that is found by a key, made where it is not there."""
    with _LOCK:
        if (kind, key) not in _KEPT:
            _KEPT[kind, key] = make()
        _KEPT.move_to_end((kind, key))
        while len(_KEPT) > MOST:
            _KEPT.popitem(last=False)
        return _KEPT[kind, key]
