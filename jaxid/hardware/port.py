"""A serial port for one process alone."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.base.extras import needed


def opened(port: str, baud: int) -> Any:
    """pyserial's `Serial` at `baud` bits a second, empty, not waiting for bytes, and locked:
    whoever opens it likewise is refused before anything on the line changes, for two readers take
    each other's bytes.

    Raises `UsageError` that says what is in the way.
    """
    serial = needed("serial")
    try:
        line = serial.Serial(port, baud, timeout=0, exclusive=True)
        line.reset_input_buffer()
    except Exception as error:  # SerialException, OSError, ValueError, termios.error
        if getattr(error, "errno", None) in (errno.EAGAIN, errno.EBUSY):
            raise UsageError(
                f"port {port} is in use by another program{_holder(port)}: wait until that has"
                " ended, or end it"
            ) from None
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise UsageError(
            f"port {port} cannot be opened ({reason}); check cable, name and rights"
        ) from None
    return line


def _holder(port: str) -> str:
    """The process that has the lock, as far as Linux tells."""
    try:
        node = os.stat(port).st_ino
        for lock in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            fields = lock.split()
            if (
                fields[1] == "FLOCK"
                and fields[5].rpartition(":")[2] == str(node)
                and int(fields[4]) > 0
            ):
                return (
                    f" (process {fields[4]}, {Path(f'/proc/{fields[4]}/comm').read_text().strip()})"
                )
    except (OSError, ValueError, IndexError):
        pass
    return ""
