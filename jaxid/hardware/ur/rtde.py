"""Real-Time Data Exchange with a Universal Robots controller: a reader that loses no packet.

TCP keeps every packet until it is read, so nothing is lost here however late this process is; the
controller's own `timestamp` is the clock. Protocol version 2: Universal Robots, "Real-Time Data
Exchange (RTDE) Guide". Only the standard library is needed.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Sequence

from jaxid.base.errors import UsageError
from jaxid.hardware.errors import HardwareError


PORT = 30004
TYPES = {
    "VECTOR6D": "6d",
    "VECTOR3D": "3d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
    "DOUBLE": "d",
    "UINT64": "Q",
    "UINT32": "I",
    "INT32": "i",
    "UINT8": "B",
    "BOOL": "?",
}
#: Package types, by their letter in the protocol.
VERSION, CONTROLLER, OUTPUTS, START, PAUSE, DATA, TEXT = (ord(c) for c in "VvOSPUM")


class RTDEReader:
    """A connection to port 30004 that delivers every data package after `start`.

    `variables` must exist on the controller, those in `optional` may lack; `names` and `sizes` then
    say what a row holds. Each row of `read` is (host time, values). Raises `UsageError` where
    nobody listens or a variable is unknown, `HardwareError` for whatever goes wrong later.
    """

    def __init__(
        self,
        host: str,
        variables: Sequence[str],
        rate: float,
        *,
        optional: Sequence[str] = (),
        timeout: float = 0.5,
        port: int = PORT,
    ):
        self.where = f"{host}:{port}"
        try:
            self.socket = socket.create_connection((host, port), 2.0)
        except OSError as error:
            reason = error.strerror or str(error) or "no answer"
            raise UsageError(
                f"{self.where}: no connection ({reason}); check the address, the cable and that the"
                " robot is switched on"
            ) from None
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._buffer = bytearray()
        self._timeout = timeout
        self._fault: HardwareError | None = None
        self.notes: list[str] = []
        try:
            self._negotiate(list(variables), list(optional), rate)
        except BaseException:
            self.socket.close()
            raise

    def _negotiate(self, variables: list[str], optional: list[str], rate: float) -> None:
        self._send(VERSION, struct.pack(">H", 2))
        if self._answer(VERSION) != b"\1":
            raise HardwareError(
                f"{self.where}: the controller does not speak RTDE protocol 2; its software is too"
                " old (3.4 needed)"
            )
        self._send(CONTROLLER)
        version = self._answer(CONTROLLER)
        self.version = struct.unpack(">4I", version[:16]) if len(version) >= 16 else ()
        recipe, types = self._recipe(variables + optional, rate)
        lacking = [n for n, t in zip(variables + optional, types, strict=True) if t not in TYPES]
        if lost := [n for n in lacking if n in variables]:
            number = ".".join(map(str, self.version))
            raise UsageError(
                f"{self.where}: the controller (version {number}) has no variable {', '.join(lost)}"
            )
        names = [n for n in variables + optional if n not in lacking]
        if lacking:
            recipe, types = self._recipe(names, rate)
        self.names, self.recipe = tuple(names), recipe
        self.sizes = tuple(int(TYPES[t][:-1] or 1) for t in types)
        self._layout = struct.Struct(">" + "".join(TYPES[t] for t in types))

    def start(self) -> None:
        """Lets the controller send; from now on `read` has to be called, for a controller cuts off
        who does not read.
        """
        self._send(START)
        if self._answer(START) != b"\1":
            raise HardwareError(f"{self.where}: the controller refuses to send data")
        self.socket.setblocking(False)

    def _recipe(self, names: list[str], rate: float) -> tuple[int, list[str]]:
        self._send(OUTPUTS, struct.pack(">d", rate) + ",".join(names).encode())
        answer = self._answer(OUTPUTS)
        types = answer[1:].decode("ascii", "replace").split(",") if answer else []
        if len(types) != len(names):
            raise HardwareError(
                f"{self.where}: the controller answered {len(types)} types to {len(names)}"
                " variables"
            )
        return answer[0], types

    def fileno(self) -> int:
        return self.socket.fileno()

    def read(self) -> list[tuple[float, tuple[float, ...]]]:
        """Every data package that has arrived; never waits. Rows that came before a fault are
        delivered before it is raised.
        """
        if self._fault is not None:
            raise self._fault
        rows: list[tuple[float, tuple[float, ...]]] = []
        try:
            self._receive(rows)
        except HardwareError as error:
            if not rows:
                raise
            self._fault = error
        return rows

    def _receive(self, rows: list) -> None:
        block = b""
        try:
            while block := self.socket.recv(1 << 16):
                self._buffer += block
            closed = True
        except BlockingIOError:
            closed = False
        except OSError as error:
            raise HardwareError(
                f"{self.where}: the connection broke ({error.strerror or error})"
            ) from None
        now = time.monotonic()
        while (package := self._package()) is not None:
            kind, payload = package
            if kind == TEXT:
                self.notes.append(_message(payload))
            elif kind == DATA:
                agreed = 1 + self._layout.size
                if len(payload) != agreed:
                    raise HardwareError(
                        f"{self.where}: a data package of {len(payload)} bytes where {agreed} were"
                        " agreed"
                    )
                if payload[0] != self.recipe:
                    raise HardwareError(
                        f"{self.where}: a data package of recipe {payload[0]} where {self.recipe}"
                        " was agreed"
                    )
                rows.append((now, tuple(map(float, self._layout.unpack_from(payload, 1)))))
        if closed:
            rest = (
                f"; {len(self._buffer)} bytes of an unfinished package were left"
                if self._buffer
                else ""
            )
            raise HardwareError(f"{self.where}: the controller closed the connection{rest}")

    def close(self) -> None:
        self.socket.close()

    def _send(self, kind: int, payload: bytes = b"") -> None:
        try:
            self.socket.sendall(struct.pack(">HB", 3 + len(payload), kind) + payload)
        except OSError as error:
            raise HardwareError(
                f"{self.where}: the connection broke ({error.strerror or error})"
            ) from None

    def _package(self) -> tuple[int, bytes] | None:
        if len(self._buffer) < 3:
            return None
        size, kind = struct.unpack_from(">HB", self._buffer)
        if size < 3:
            raise HardwareError(
                f"{self.where}: a malformed package that claims a length of {size} bytes"
            )
        if len(self._buffer) < size:
            return None
        payload = bytes(self._buffer[3:size])
        del self._buffer[:size]
        return kind, payload

    def _answer(self, kind: int) -> bytes:
        until = time.monotonic() + self._timeout
        while True:
            while (package := self._package()) is not None:
                if package[0] == kind:
                    return package[1]
                if package[0] == TEXT:
                    self.notes.append(_message(package[1]))
            self.socket.settimeout(max(until - time.monotonic(), 1e-3))
            try:
                block = self.socket.recv(1 << 16)
            except TimeoutError:
                raise HardwareError(
                    f"{self.where}: somebody accepts connections there but does not answer within"
                    f" {self._timeout:g} s; is it a robot, and is its controller up?"
                ) from None
            except OSError as error:
                raise HardwareError(
                    f"{self.where}: the connection broke ({error.strerror or error})"
                ) from None
            if not block:
                raise HardwareError(
                    f"{self.where}: the controller closed the connection while it was set up"
                )
            self._buffer += block


def _message(payload: bytes) -> str:
    """The text of a message package: length, text, length, source, level."""
    length = payload[0] if payload else 0
    return payload[1 : 1 + length].decode("utf-8", "replace")
