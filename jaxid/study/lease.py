"""Who holds a study's store: a process of this machine, or one elsewhere by its last word."""

from __future__ import annotations

import socket
import time
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxid.base.extras import needed


#: A process on another machine that has not renewed its lease for so long is taken for dead.
LEASE_S = 60.0


def machine() -> str:
    """This machine since its last start, and, in a container, this one: a process id means nothing
    elsewhere.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        boot = f"{uuid.getnode():x}"
    return f"{socket.gethostname()}/{boot}"


def process_start(pid: int) -> float:
    """When a process began; 0 if there is none."""
    psutil = needed("psutil")
    try:
        return psutil.Process(pid).create_time()
    except psutil.Error:
        return 0.0


def alive(held: Sequence[Any]) -> bool:
    """Whether the holder of a lease (host, pid, started, renewed) lives: here by its process,
    elsewhere by its last word.
    """
    host, pid, started, renewed = held[:4]
    if host == machine():
        return abs(process_start(pid) - started) < 1.0
    return abs(time.time() - renewed) < LEASE_S
