"""Between the process that records and the process that moves a device: messages, a heartbeat, and what ends a motion.

The client libraries of devices may abort, crash or hang their process (a malformed packet ends one that uses ur_rtde), so each
lives in a process of its own. The tie is a heartbeat: a driver whose supervisor is silent, stopped or dead stops its device.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from typing import Any

from jaxid.hardware.errors import HardwareError


#: A driver stops its device after this long without a word from its supervisor (s).
HEARTBEAT_S = 0.1
#: Who leaves messages unread for so long is lost (s).
UNREAD_S = 0.05


class Closed(EOFError):
    """The other end is gone, or does not read any more."""


class Link:
    """One end of a line of JSON messages, `{"kind": …}` each."""

    def __init__(self, line: socket.socket):
        self.line = line
        line.setblocking(False)
        self._buffer = b""
        self._waiting: list[dict[str, Any]] = []

    def fileno(self) -> int:
        return self.line.fileno()

    def send(self, kind: str, **content: Any) -> None:
        """Raises `Closed` where the other end is gone or its buffer stays full."""
        rest = memoryview(json.dumps({"kind": kind, **content}).encode() + b"\n")
        try:
            while rest:
                if not select.select([], [self.line], [], UNREAD_S)[1]:
                    raise Closed("the other end does not read any more")
                rest = rest[self.line.send(rest) :]
        except OSError as error:
            raise Closed(str(error)) from None

    def messages(self, timeout: float = 0.0) -> list[dict[str, Any]]:
        """All that arrived, after waiting at most `timeout` s for a first one; raises `Closed` once all was read."""
        ready = bool(self._waiting) or bool(select.select([self.line], [], [], max(timeout, 0.0))[0])
        while ready:
            try:
                block = self.line.recv(1 << 16)
            except BlockingIOError:
                break
            except OSError:
                block = b""
            if not block:
                if self._waiting:
                    break
                raise Closed("the other end closed the line")
            *lines, self._buffer = (self._buffer + block).split(b"\n")
            self._waiting += [json.loads(line) for line in lines]
        out, self._waiting = self._waiting, []
        return out

    def close(self) -> None:
        self.line.close()


class Stop(Exception):
    """The motion has to end; the text says why."""


class Leash:
    """In the driver: waits, and raises `Stop` as soon as the supervisor says so, is silent or is gone."""

    def __init__(self, link: Link, longest_s: float = HEARTBEAT_S):
        self.link, self.longest_s = link, longest_s
        self.tight = False  # while something moves
        self.inbox: list[dict[str, Any]] = []
        self._heard = time.monotonic()

    def tighten(self, tight: bool) -> None:
        self.tight, self._heard = tight, time.monotonic()

    def wait(self, until: float) -> None:
        """Returns at `until` (monotonic s), never later than needed to notice; looks at the line at least once."""
        while True:
            now = time.monotonic()
            deadline = min(until, self._heard + self.longest_s) if self.tight else until
            try:
                arrived = self.link.messages(deadline - now)
            except Closed:
                raise Stop("the recording process is gone") from None
            now = time.monotonic()
            if arrived:
                self._heard = now
            for message in arrived:
                if message["kind"] == "stop":
                    raise Stop(message.get("reason", "stopped"))
                if message["kind"] != "beat":
                    self.inbox.append(message)
            if self.tight and now - self._heard > self.longest_s:
                raise Stop(f"the recording process was silent for {1e3 * (now - self._heard):.0f} ms")
            if now >= until or self.inbox:
                return

    def next_order(self) -> dict[str, Any]:
        """The next order of the supervisor; waits for it."""
        while not self.inbox:
            self.wait(time.monotonic() + 1.0)
        return self.inbox.pop(0)


class Driver:
    """In the recording process: a driver module in a process of its own, told what to do through a `Link`.

    `module` is run with the number of its end of the line. Its output goes to a file whose end is quoted when it dies.
    """

    def __init__(self, module: str, name: str):
        self.name = name
        here, there = socket.socketpair()
        self._output = tempfile.TemporaryFile()
        code = f"from {module} import main; main({there.fileno()})"
        # A session of its own: a Ctrl-C in the terminal reaches the recording process only, which then ends the motion.
        self.process = subprocess.Popen(
            [sys.executable, "-c", code],
            pass_fds=(there.fileno(),),
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        there.close()
        self.link = Link(here)
        self.inbox: list[dict[str, Any]] = []

    def fileno(self) -> int:
        return self.link.fileno()

    def send(self, kind: str, **content: Any) -> None:
        """Raises `HardwareError` with what is known of its end where the driver is gone."""
        try:
            self.link.send(kind, **content)
        except Closed:
            raise self.died() from None

    def messages(self, timeout: float = 0.0) -> list[dict[str, Any]]:
        """What the driver said; a message `failed` and the driver's end are raised as `HardwareError`."""
        try:
            self.inbox += self.link.messages(0.0 if self.inbox else timeout)
        except Closed:
            raise self.died() from None
        for message in self.inbox:
            if message["kind"] == "failed":
                raise HardwareError(message["reason"])
        out, self.inbox = self.inbox, []
        return out

    def ask(self, kind: str, answer: str, timeout: float, **content: Any) -> dict[str, Any]:
        """Sends an order and waits for its answer; other messages stay for `messages`. Raises `HardwareError`."""
        self.send(kind, **content)
        until, kept = time.monotonic() + timeout, []
        try:
            while True:
                for message in (arrived := self.messages(min(0.02, until - time.monotonic()))):
                    if message["kind"] == answer:
                        kept += arrived[arrived.index(message) + 1 :]
                        return message
                    kept.append(message)
                if time.monotonic() > until:
                    raise HardwareError(f"{self.name}: no answer to {kind!r} within {timeout:g} s")
                self.send("beat")
        finally:
            self.inbox = kept + self.inbox

    def died(self) -> HardwareError:
        """What ended the driver, in a sentence."""
        try:
            code = self.process.wait(0.3)
        except subprocess.TimeoutExpired:
            return HardwareError(f"{self.name}: the driver closed its line")
        how = f"by signal {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        return HardwareError(f"{self.name}: the driver process ended {how}{self._last_words()}")

    def _last_words(self) -> str:
        try:
            size = self._output.seek(0, os.SEEK_END)
            self._output.seek(max(0, size - 2000))
            lines = [t for t in self._output.read().decode(errors="replace").splitlines() if t.strip()]
        except (OSError, ValueError):
            return ""
        return f" ({lines[-1].strip()[:200]})" if lines else ""

    def stop(self, reason: str, timeout: float) -> bool:
        """Tells the driver to stop its device and end; whether it confirmed. One that does not within `timeout` is killed."""
        try:
            self.link.send("stop", reason=reason)
            until = time.monotonic() + timeout
            while time.monotonic() < until:
                for message in self.link.messages(until - time.monotonic()):
                    if message["kind"] == "stopped":
                        return True
                    self.inbox.append(message)
        except Closed:
            pass
        return False

    def close(self) -> None:
        """Ends the process: it leaves by itself once its line is closed, or is killed."""
        self.link.close()
        try:
            self.process.wait(1.0)
        except subprocess.TimeoutExpired:
            self.kill()
        self._output.close()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


def in_driver(fd: int) -> Link:
    """The driver's end of the line; signals of the terminal are the recording process's business."""
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    return Link(socket.socket(fileno=fd))
