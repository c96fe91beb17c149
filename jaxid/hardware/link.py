"""Between the process that records and the process that moves a device: messages, a heartbeat, and
what ends a motion.

The client libraries of devices may abort, crash or hang their process (a malformed packet ends one
that uses ur_rtde), so each lives in a process of its own. The tie is a heartbeat: a driver whose
supervisor is silent, stopped or dead stops its device.
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
#: How long a driver that has let go of its device waits for its last words to be taken (s).
FAREWELL_S = 1.0
#: Bytes that an end keeps for one that does not read: minutes of samples, for a line is not what
#: ends a motion, silence is.
UNREAD = 64 << 20


class Closed(EOFError):
    """The other end is gone, or has not read for so long that nothing more is kept for it."""


class Link:
    """One end of a line of JSON messages, `{"kind": …}` each. Neither sending nor reading waits for
    the other end.
    """

    def __init__(self, line: socket.socket):
        self.line = line
        line.setblocking(False)
        self._buffer = b""
        self._waiting: list[dict[str, Any]] = []
        self._unsent = bytearray()

    def fileno(self) -> int:
        return self.line.fileno()

    def send(self, kind: str, **content: Any) -> None:
        """What the line does not take now goes with a later call. Raises `Closed` where the other
        end is gone.
        """
        self._unsent += json.dumps({"kind": kind, **content}).encode() + b"\n"
        self._flush()
        if len(self._unsent) > UNREAD:
            raise Closed(f"the other end has left {len(self._unsent) >> 20} MiB unread")

    def finish(self, timeout: float) -> None:
        """Waits at most `timeout` s until everything is sent; raises `Closed` where the other end
        is gone.
        """
        until = time.monotonic() + timeout
        while self._unsent and (left := until - time.monotonic()) > 0:
            select.select([], [self.line], [], left)
            self._flush()

    def _flush(self) -> None:
        try:
            while self._unsent:
                with memoryview(self._unsent) as rest:
                    sent = self.line.send(rest[: 1 << 16])
                del self._unsent[:sent]
        except BlockingIOError:
            pass
        except OSError as error:
            raise Closed(error.strerror or str(error)) from None

    def messages(self, timeout: float = 0.0) -> list[dict[str, Any]]:
        """All that arrived, after waiting at most `timeout` s for a first one; raises `Closed` once
        all was read.
        """
        until = time.monotonic() + timeout
        ready = bool(self._waiting)
        while not ready:
            left = max(until - time.monotonic(), 0.0)
            found, free, _ = select.select(
                [self.line], [self.line] if self._unsent else [], [], left
            )
            ready = bool(found)
            if free and not ready:
                try:
                    self._flush()
                except Closed:
                    ready = True  # reading tells what was said before the end
            elif not ready:
                break
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


class StopRequest(Exception):
    """The motion has to end; the text says why."""


#: What a driver says when it ends by itself -> how the sentence begins that gives its reason.
ENDS = {"stopping": "{}: the driver stopped by itself: ", "failed": ""}


def busy(seconds: float) -> str:
    """The sentence for a process that was not run."""
    return (
        f"this computer was busy for {seconds:.1f} s"
        if seconds >= 0.095
        else f"this computer was busy for {seconds:.2f} s"
    )


class Leash:
    """In the driver: waits, and raises `StopRequest` as soon as the supervisor says so, is silent or is
    gone.
    """

    def __init__(self, link: Link, longest_s: float = HEARTBEAT_S):
        self.link, self.longest_s = link, longest_s
        self.tight = False  # while something moves
        self.inbox: list[dict[str, Any]] = []
        self._heard = self._looked = time.monotonic()

    def tighten(self, tight: bool) -> None:
        self.tight, self._heard = tight, time.monotonic()

    def wait(self, until: float) -> None:
        """Returns at `until` (monotonic s), never later than needed to notice; looks at the line at
        least once.
        """
        while True:
            began = time.monotonic()
            deadline = min(until, self._heard + self.longest_s) if self.tight else until
            try:
                arrived = self.link.messages(deadline - began)
            except Closed:
                raise StopRequest("the recording process is gone") from None
            now = time.monotonic()
            if arrived:
                self._heard = now
            for message in arrived:
                if message["kind"] == "stop":
                    raise StopRequest(message.get("reason", "stopped"))
                if message["kind"] != "beat":
                    self.inbox.append(message)
            if self.tight and now - self._heard > self.longest_s:
                own, silence = (
                    max(now - max(began, deadline), began - self._looked),
                    now - self._heard,
                )
                if (
                    own > 0.5 * silence
                ):  # it was this process that did not run: the other one may have spoken
                    raise StopRequest(busy(own))
                raise StopRequest(f"the recording process was silent for {silence:.2f} s")
            self._looked = now
            if now >= until or self.inbox:
                return

    def next_order(self) -> dict[str, Any]:
        """The next order of the supervisor; waits for it."""
        while not self.inbox:
            self.wait(time.monotonic() + 1.0)
        return self.inbox.pop(0)


class Driver:
    """In the recording process: a driver module in a process of its own, told what to do through a
    `Link`.

    `module` is run with the number of its end of the line. Its output goes to a file whose end is
    quoted when it dies.
    """

    def __init__(self, module: str, name: str):
        self.name = name
        here, there = socket.socketpair()
        self._output = tempfile.TemporaryFile()
        code = f"from {module} import main; main({there.fileno()})"
        # A session of its own: a Ctrl-C in the terminal reaches the recording process only, which
        # then ends the motion.
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
        """Raises `HardwareError` with what is known of its end where the driver is gone and has
        left no word.
        """
        try:
            self.link.send(kind, **content)
        except Closed:
            try:
                self.inbox += self.link.messages()
            except Closed:
                if not self.inbox:
                    raise self.died() from None
            # What it said before its end says why: `messages` gives it.

    def messages(self, timeout: float = 0.0) -> list[dict[str, Any]]:
        """What the driver said. A reason to end (`stopping`, `failed`, its death) is raised as
        `HardwareError`, after all that it said before.
        """
        try:
            self.inbox += self.link.messages(0.0 if self.inbox else timeout)
        except Closed:
            if not self.inbox:
                raise self.died() from None
        last = next((k for k, m in enumerate(self.inbox) if m["kind"] in ENDS), len(self.inbox))
        if last == 0 and self.inbox:
            raise HardwareError(
                ENDS[self.inbox[0]["kind"]].format(self.name) + self.inbox[0]["reason"]
            )
        out, self.inbox = self.inbox[:last], self.inbox[last:]
        return out

    def ask(self, kind: str, answer: str, timeout: float, **content: Any) -> dict[str, Any]:
        """Sends an order and waits for its answer; other messages stay for `messages`. Raises
        `HardwareError`.
        """
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
            return HardwareError(
                f"{self.name}: the driver closed its line without ending{self._last_words()}"
            )
        how = f"by signal {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        return HardwareError(f"{self.name}: the driver process ended {how}{self._last_words()}")

    def _last_words(self) -> str:
        try:
            size = self._output.seek(0, os.SEEK_END)
            self._output.seek(max(0, size - 2000))
            lines = [
                t for t in self._output.read().decode(errors="replace").splitlines() if t.strip()
            ]
        except (OSError, ValueError):
            return ""
        return f" ({lines[-1].strip()[:200]})" if lines else ""

    def stop(self, reason: str, timeout: float) -> bool:
        """Tells the driver to stop its device and end; whether it confirmed. One that does not
        within `timeout` is killed.
        """
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
    """The driver's end of the line; signals of the terminal are the recording process's
    business.
    """
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    return Link(socket.socket(fileno=fd))


def farewell(
    link: Link, error: BaseException | None = None, prefix: str = "", **content: Any
) -> None:
    """The last words of a driver: why it stops, or without an `error` that it has stopped. Where
    nobody is left to hear them they stand in its output.
    """
    if error is None:
        kind = "stopped"
    elif isinstance(error, StopRequest):
        kind, content = "stopping", {"reason": str(error)}
    elif isinstance(error, Closed):
        kind, content = (
            "stopping",
            {"reason": f"the line to the recording process is closed ({error})"},
        )
    else:
        kind, content = "failed", {"reason": prefix + first_line(error)}
    try:
        link.send(kind, **content)
        if error is None:
            link.finish(FAREWELL_S)
    except Closed:
        if error is not None:
            print(content["reason"], flush=True)


def first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
