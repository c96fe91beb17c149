"""The computer that jaxid runs on."""

from __future__ import annotations

import os


def cores() -> int:
    """Its cores."""
    return os.cpu_count() or 1


def own_cores() -> int:
    """Those that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return cores()
