"""What the emulators share: orders on standard input, a log of everything that moves, and their
end.
"""

from __future__ import annotations

import json
import os
import signal
import stat
import sys
import time
from collections.abc import Callable
from typing import Any, TextIO

from jaxid.base.errors import nearest


class EventLog:
    """One JSON line for each thing that happened, with the time `at` (monotonic s); to a file, or
    nowhere.
    """

    def __init__(self, path: str | os.PathLike[str] | None):
        self._file: TextIO | None = (
            None if path is None else open(path, "a", buffering=1, encoding="utf-8")
        )

    def __call__(self, what: str, **more: Any) -> None:
        if self._file is not None:
            self._file.write(json.dumps({"at": time.monotonic(), "what": what, **more}) + "\n")


class Orders:
    """Lines on standard input, without waiting; each is answered by one line.

    Where the input is a pipe, its end ends the emulator, so that none outlives the program that
    started it.
    """

    def __init__(self, table: dict[str, Callable[[list[str]], None]], log: EventLog):
        self.table, self.log = table, log
        self._buffer = b""
        self.open = True
        self._piped = False
        # In the background of a terminal, reading what is typed there would suspend the emulator;
        # ignored, it is an error.
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
        try:
            self._piped = stat.S_ISFIFO(os.fstat(sys.stdin.fileno()).st_mode)
            os.set_blocking(sys.stdin.fileno(), False)
        except (OSError, ValueError):
            self.open = False

    def fileno(self) -> int:
        return sys.stdin.fileno()

    def read(self) -> bool:
        """Carries out what was typed; False once `quit` was."""
        try:
            block = os.read(self.fileno(), 4096)
        except BlockingIOError:
            return True
        except OSError:
            block = b""
        if not block:
            self.open = False
            return not self._piped
        *lines, self._buffer = (self._buffer + block).split(b"\n")
        for line in lines:
            words = line.decode(errors="replace").split()
            if not words:
                continue
            if words[0] == "quit":
                return False
            if words[0] not in self.table:
                print(
                    f"? no order {words[0]!r}{nearest(words[0], [*self.table, 'quit'])}", flush=True
                )
                continue
            self.log("order", text=" ".join(words))
            try:
                self.table[words[0]](words[1:])
                print("ok", flush=True)
            except (ValueError, IndexError) as error:
                print(f"? {words[0]}: {error}", flush=True)
        return True
