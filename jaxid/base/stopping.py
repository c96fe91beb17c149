"""Ctrl-C, SIGTERM (a batch system, a caller's time-out) and SIGHUP (a closed terminal) end work
alike, and at once.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


INTERRUPTED = 130
#: Seconds from a signal to the end of the process: compiled code does not hear of it, a compilation
#: can take minutes, and so can what is made of what was finished.
PATIENCE_S = 1.0


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a fit or a diagnosis; `partial` is the result finished so far, which a command
    saves.
    """

    def __init__(self, partial: Any = None):
        super().__init__("interrupted")
        self.partial = partial


def ending() -> list[int]:
    """The signals that end work. One that is ignored is none of them: `nohup` means SIGHUP so."""
    known = [getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")]
    return [n for n in known if n is not None and signal.getsignal(n) is not signal.SIG_IGN]


@contextmanager
def stoppable(last_words: Callable[[], None]) -> Iterator[None]:
    """Inside, the first signal raises `KeyboardInterrupt`. Where what is inside has not ended in
    time all the same, and at a second signal, the process ends after its `last_words`. Everything
    worth keeping must be on the disk by then.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ends, heard, over = ending(), threading.Event(), threading.Event()

    def stop(number: int, frame: Any) -> None:
        if heard.is_set():
            os._exit(INTERRUPTED)
        heard.set()
        raise KeyboardInterrupt

    def watch() -> None:
        while got := os.read(reader, 1):
            if got[0] in ends and not over.wait(PATIENCE_S):
                last_words()
                os._exit(INTERRUPTED)
        os.close(reader)

    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    woken = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    before = {n: signal.signal(n, stop) for n in ends}
    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(woken)
        os.close(writer)
        for number, handler in before.items():
            signal.signal(number, handler)
