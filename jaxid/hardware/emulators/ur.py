"""A UR controller on this computer's loopback: RTDE, dashboard and script ports, and faults to
order.

Runs in a process of its own (`jaxid emulate ur10`): the constructors of ur_rtde hold Python's lock
while they wait, so a server in the same process would never answer. The ports are those of a robot,
because ur_rtde takes no others; several emulators need an address each (127.0.0.2, 127.0.0.3 …).
"""

from __future__ import annotations

import os
import selectors
import socket
import struct
import time
from collections import deque
from collections.abc import Callable

from jaxid.base.errors import UsageError
from jaxid.hardware.emulators.orders import EventLog, Orders
from jaxid.hardware.emulators.plant import read_plant
from jaxid.hardware.emulators.ur_arm import Arm, JOINTS, NOISE, PLANT, SIZES, STEP, VARIABLES
from jaxid.hardware.ur.rtde import (
    CONTROLLER,
    DATA,
    OUTPUTS,
    PAUSE,
    PORT,
    START,
    TEXT,
    TYPES,
    VERSION,
)


INPUTS = ord("I")
DASHBOARD, SCRIPTS = 29999, (30001, 30002, 30003)
CONTROLLER_VERSION = (5, 15, 0, 0)
MEMORY = 1 << 20  # bytes a client may leave unread before it is cut off, as a controller does
_ANSWERS = {
    "robotmode": "Robotmode: RUNNING",
    "is in remote control": "true",
    "programState": "STOPPED <unnamed>",
    "running": "Program running: false",
    "safetymode": "Safetymode: NORMAL",
    "safetystatus": "Safetystatus: NORMAL",
    "PolyscopeVersion": "URSoftware 5.15.0.0 (Jan 01 2024)",
    "get robot model": "UR10",
    "get serial number": "0",
    "play": "Starting program",
}


class Client:
    """One connection: bytes in, bytes out, and for RTDE what was agreed."""

    def __init__(self, line: socket.socket, kind: str):
        self.line, self.kind = line, kind
        self.inbox, self.outbox = bytearray(), bytearray()
        self.packages: deque[tuple[int, bytes]] = deque()
        self.share = 1.0  # of a package that may be taken
        self.names: list[str] = []
        self.layout = struct.Struct(">B")
        self.recipes: list[tuple[list[str], struct.Struct]] = []
        self.every = 1
        self.running = False

    @property
    def controls(self) -> bool:
        return bool(self.recipes)


class Emulator:
    """See the module. `run` serves until `quit` is ordered or the process is ended."""

    def __init__(self, host: str = "127.0.0.1", plant: str | None = None, log: str | None = None):
        if not host.startswith("127."):
            raise UsageError(
                f"an emulator listens on loopback only (127.0.0.1, 127.0.0.2 …), not on {host}"
            )
        self.log = EventLog(log)
        body, settings = read_plant(plant, JOINTS, PLANT)
        if plant is None:
            settings = {"noise": NOISE}
        self.arm = Arm(body, settings, self.log)
        self.arm.tick()
        self.host = host
        self.selector = selectors.DefaultSelector()
        self.clients: set[Client] = set()
        self.quiet_until, self.mute = 0.0, False
        kinds = {PORT: "rtde", DASHBOARD: "dashboard"} | dict.fromkeys(SCRIPTS, "script")
        for port, kind in kinds.items():
            server = socket.socket()
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                server.bind((host, port))
            except OSError as error:
                raise UsageError(
                    f"{host}:{port} is taken ({error.strerror}); use another address: --host"
                    " 127.0.0.2"
                ) from error
            server.listen(8)
            server.setblocking(False)
            self.selector.register(server, selectors.EVENT_READ, kind)
        self.orders = Orders(self._orders(), self.log)
        if self.orders.open:
            try:
                self.selector.register(self.orders, selectors.EVENT_READ, "orders")
            except OSError:  # a closed standard input, or a plain file
                self.orders.open = False

    def _orders(self) -> dict[str, Callable[[list[str]], None]]:
        def to_clients(action: Callable[[Client], None]) -> Callable[[list[str]], None]:
            def order(words: list[str]) -> None:
                which = words[0] if words else "all"
                if which not in ("all", "control", "record"):
                    raise ValueError("say all, control or record")
                for c in [c for c in self.clients if c.kind == "rtde"]:
                    if which == "all" or c.controls == (which == "control"):
                        action(c)

            return order

        def set_(name: str, convert: Callable[[str], float]) -> Callable[[list[str]], None]:
            return lambda words: setattr(self.arm, name, convert(words[0]))

        return {
            "drop": to_clients(self._drop),
            "malformed": to_clients(
                lambda c: self._send(c, b"\x00\x02\xff" + b"\xde\xad\xbe\xef" * 8)
            ),
            "truncated": to_clients(self._truncate),
            "short": to_clients(lambda c: self._send(c, _package(DATA, self._data(c)[:40]))),
            "wrong_id": to_clients(
                lambda c: self._send(c, _package(DATA, b"\x63" + self._data(c)[1:]))
            ),
            "text": to_clients(lambda c: self._send(c, _package(TEXT, b"\x05hello\x03emu\x01"))),
            "stall": lambda words: setattr(self, "quiet_until", time.monotonic() + float(words[0])),
            "mute": lambda words: setattr(self, "mute", words[:1] != ["0"]),
            "speed": set_("slider", float),
            "protective_stop": lambda words: self.arm.protective_stop(),
            "clear": lambda words: setattr(self.arm, "safety", 1),
        }

    def run(self) -> None:
        """Serves; every step of the controller is made, late or not, so that no sample is ever
        missing at the source.

        What clients wrote while this process was not run is taken step by step with the steps that
        it missed, as a controller that is never late would have; taken at once, it would be a jump
        of the arm.
        """
        began, made = time.monotonic(), 0
        while True:
            due = began + (made + 1) * STEP
            for key, _ in self.selector.select(max(0.0, due - time.monotonic())):
                if key.data == "orders":
                    if not self.orders.read():
                        return
                    if not self.orders.open:
                        self.selector.unregister(self.orders)
                elif isinstance(key.data, Client):
                    self._receive(key.data)
                else:
                    self._accept(key.fileobj, key.data)
            behind = 0
            if time.monotonic() < due:
                self._take(1)
            while (late := time.monotonic() - due) >= 0 and behind < 50:
                self._take(1 + int(late / STEP))
                self.arm.tick()
                made, behind = made + 1, behind + 1
                due = began + (made + 1) * STEP
                self._publish()

    def _accept(self, server, kind: str) -> None:
        line, _ = server.accept()
        line.setblocking(False)
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = Client(line, kind)
        self.clients.add(client)
        self.selector.register(line, selectors.EVENT_READ, client)
        if kind == "dashboard":
            self._send(client, b"Connected: Universal Robots Dashboard Server\n")

    def _drop(self, client: Client) -> None:
        if client in self.clients:
            self.clients.discard(client)
            self.selector.unregister(client.line)
            client.line.close()
            if client.controls:
                self.log("control client gone")

    def _truncate(self, client: Client) -> None:
        whole = _package(DATA, self._data(client))
        self._send(client, whole[: len(whole) // 2])
        self._drop(client)

    def _send(self, client: Client, content: bytes) -> None:
        client.outbox += content
        try:
            while client.outbox:
                del client.outbox[: client.line.send(client.outbox)]
        except BlockingIOError:
            if len(client.outbox) > MEMORY:
                self.log("slow client cut off")
                self._drop(client)
        except OSError:
            self._drop(client)

    def _receive(self, client: Client) -> None:
        try:
            block = client.line.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            block = b""
        if not block:
            if client.kind == "script" and client.inbox:
                self.arm.script(bytes(client.inbox))
            self._drop(client)
            return
        client.inbox += block
        if self.mute:
            client.inbox.clear()
        elif client.kind == "dashboard":
            self._dashboard(client)
        elif client.kind == "script":
            if client.inbox.rstrip().endswith(b"end"):
                self.arm.script(bytes(client.inbox))
                client.inbox.clear()
        else:
            while len(client.inbox) >= 3:
                size, kind = struct.unpack_from(">HB", client.inbox)
                if size < 3:
                    return self._drop(client)
                if len(client.inbox) < size:
                    return
                client.packages.append((kind, bytes(client.inbox[3:size])))
                del client.inbox[:size]

    def _take(self, steps: int) -> None:
        """The packages that belong to the first of this many `steps` that are to be made now."""
        for client in [c for c in self.clients if c.packages]:
            client.share = (
                client.share + len(client.packages) / steps if steps > 1 else len(client.packages)
            )
            count = min(int(client.share), len(client.packages))
            client.share = (
                client.share - count if steps > 1 else 1.0
            )  # the first one at once: it shows that the client lives
            for _ in range(count):
                kind, payload = client.packages.popleft()
                try:
                    self._rtde(client, kind, payload)
                except (struct.error, IndexError, UnicodeDecodeError):
                    self._drop(client)
                    break

    def _dashboard(self, client: Client) -> None:
        while b"\n" in client.inbox:
            line, _, rest = bytes(client.inbox).partition(b"\n")
            client.inbox[:] = rest
            word = line.decode(errors="replace").strip()
            self.log("dashboard", text=word)
            if word == "stop":
                self.arm.halt("dashboard stop")
            self._send(
                client, (_ANSWERS.get(word, "Stopped" if word == "stop" else "OK") + "\n").encode()
            )

    def _rtde(self, client: Client, kind: int, payload: bytes) -> None:
        if kind == VERSION:
            self._send(client, _package(VERSION, b"\1"))
        elif kind == CONTROLLER:
            self._send(client, _package(CONTROLLER, struct.pack(">4I", *CONTROLLER_VERSION)))
        elif kind == OUTPUTS:
            self._outputs(client, payload)
        elif kind == INPUTS:
            self._inputs(client, payload)
        elif kind in (START, PAUSE):
            client.running = kind == START
            self._send(client, _package(kind, b"\1"))
        elif kind == DATA:
            names, layout = client.recipes[payload[0] - 1]
            values, written, k = layout.unpack_from(payload, 1), {}, 0
            for name in names:
                size = SIZES.get(VARIABLES[name], 1)
                written[name] = values[k] if size == 1 else list(values[k : k + size])
                k += size
            self.arm.inputs(written)

    def _outputs(self, client: Client, payload: bytes) -> None:
        """A client says how often it wants which variables."""
        rate = struct.unpack_from(">d", payload)[0]
        asked = _names(payload[8:])
        client.every = max(1, round(1 / STEP / min(max(rate, 1.0), 1 / STEP)))
        client.names = [n for n in asked if n in VARIABLES]
        client.layout = struct.Struct(">B" + "".join(TYPES[VARIABLES[n]] for n in client.names))
        types = ",".join(VARIABLES.get(n, "NOT_FOUND") for n in asked)
        self.log("outputs", rate=rate, names=asked)
        self._send(client, _package(OUTPUTS, b"\1" + types.encode()))

    def _inputs(self, client: Client, payload: bytes) -> None:
        """A client says which variables it will write; none where one of them is unknown."""
        names = _names(payload)
        types = ",".join(VARIABLES.get(n, "NOT_FOUND") for n in names)
        if not all(n in VARIABLES for n in names):
            names = []
        layout = struct.Struct(">" + "".join(TYPES[VARIABLES[n]] for n in names))
        client.recipes.append((names, layout))
        self._send(client, _package(INPUTS, bytes([len(client.recipes)]) + types.encode()))

    def _data(self, client: Client) -> bytes:
        return client.layout.pack(1, *self.arm.values(client.names))

    def _publish(self) -> None:
        if self.mute or time.monotonic() < self.quiet_until:
            return
        for client in [c for c in self.clients if c.running]:
            if self.arm.count % client.every == 0:
                self._send(client, _package(DATA, self._data(client)))


def _names(payload: bytes) -> list[str]:
    """The names of variables that a client lists; ur_rtde ends its list with a comma."""
    return [name for name in payload.decode().split(",") if name]


def _package(kind: int, payload: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(payload), kind) + payload


def serve(
    host: str, plant: str | os.PathLike[str] | None, log: str | os.PathLike[str] | None
) -> None:
    """Serves until told to quit; prints the address once it answers."""
    emulator = Emulator(
        host, None if plant is None else str(plant), None if log is None else str(log)
    )
    print(host, flush=True)
    emulator.run()
