"""Dynamixel servos on a pseudo terminal of this computer, paced like a wire, with faults to order.

Runs in a process of its own (`jaxid emulate dynamixel`). A pseudo terminal knows no bit rate, so
every packet takes the time it would take on the wire: ten bits a byte each way, the servo's return
delay, and the delay of a USB adapter.
"""

from __future__ import annotations

import heapq
import os
import random
import select
import termios
import time
import tty
from collections.abc import Callable

from jaxid.base.errors import UsageError
from jaxid.hardware.dynamixel import registers as x
from jaxid.hardware.emulators.dynamixel_servo import PLANT, ServoBus
from jaxid.hardware.emulators.orders import EventLog, Orders
from jaxid.hardware.emulators.plant import read_plant
from jaxid.hardware.emulators.protocol2 import Packets


class EmulatedBus:
    """See the module. `run` serves until `quit` is ordered, the port is unplugged, or the process
    is ended.
    """

    def __init__(
        self,
        identities: list[int],
        plant: str | None = None,
        log: str | None = None,
        *,
        latency: float = 0.001,
        return_delay: int = 250,
        baud: int = 1_000_000,
        seed: int = 0,
    ):
        if (
            not identities
            or len(set(identities)) < len(identities)
            or not all(0 <= i <= 252 for i in identities)
        ):
            raise UsageError(f"ids {identities} are not different numbers from 0 to 252")
        codes = {v: k for k, v in x.BAUDS.items()}
        if baud not in codes:
            raise UsageError(
                f"a servo has no baud rate {baud}; it has {', '.join(map(str, codes))}"
            )
        self.log = EventLog(log)
        body, settings = read_plant(plant, len(identities), PLANT)
        self.bench = ServoBus(identities, body, settings, self.log, time.monotonic)
        for servo in self.bench.servos.values():
            servo.set(x.BAUD_RATE, codes[baud])
            servo.set(x.RETURN_DELAY, return_delay)
        self.baud, self.latency = baud, latency
        self.random = random.Random(seed)
        self.chance = {"silent": 0.0, "crc": 0.0, "drop_byte": 0.0, "late": 0.0}
        self.late_s, self.noise = 0.0, b""
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.slave: int | None = slave  # kept open, so that a client may come and go
        self.path = os.ttyname(slave)
        self.packets = Packets()
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        self._free = 0.0  # until when the wire is busy
        self.orders = Orders(self._orders(), self.log)

    def _orders(self) -> dict[str, Callable[[list[str]], None]]:
        def chance(name: str) -> Callable[[list[str]], None]:
            return lambda words: self.chance.__setitem__(name, float(words[0]))

        def late(words: list[str]) -> None:
            self.late_s = float(words[0])
            self.chance["late"] = float(words[1]) if len(words) > 1 else 1.0

        def first(words: list[str]) -> int:
            return int(words[0]) if words else next(iter(self.bench.servos))

        return {
            "silent": chance("silent"),
            "crc": chance("crc"),
            "drop_byte": chance("drop_byte"),
            "late": late,
            "noise": lambda words: setattr(
                self, "noise", bytes.fromhex(words[0]) if words else b""
            ),
            "latency": lambda words: setattr(self, "latency", float(words[0])),
            "overload": lambda words: self.bench.overload(first(words)),
            "wrap_in": lambda words: self.bench.wrap_in(float(words[0])),
            "unplug": lambda words: self._unplug(),
        }

    def _unplug(self) -> None:
        if self.slave is not None:
            os.close(self.slave)
            os.close(self.master)
            self.slave = None

    def _at(self, when: float, action: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._queue, (when, self._count, action))

    def run(self) -> None:
        """Serves; time goes on for the plant also while nobody asks."""
        while True:
            lines = ([self.master] if self.slave is not None else []) + (
                [self.orders] if self.orders.open else []
            )
            if not lines:
                return
            due = self._queue[0][0] if self._queue else time.monotonic() + 0.01
            ready = select.select(lines, [], [], max(0.0, due - time.monotonic()))[0]
            if self.orders in ready and not self.orders.read():
                return
            if self.slave is not None and self.master in ready:
                self._receive()
            while self._queue and self._queue[0][0] <= time.monotonic():
                heapq.heappop(self._queue)[2]()
            if not self._queue:
                self.bench.advance()

    def _receive(self) -> None:
        now = time.monotonic()
        block = os.read(self.master, 4096)
        if not self._same_baud():
            self.log("wrong baud")
            return
        for identity, instruction, body, size in self.packets.feed(block):
            # The packet is whole on the wire when its last bit is; what the host wrote together
            # goes one after the other.
            self._free = max(self._free, now) + 10 * size / self.baud
            self._at(
                self._free,
                lambda i=identity, c=instruction, b=body, t=self._free: self._handle(i, c, b, t),
            )

    def _same_baud(self) -> bool:
        speed = termios.tcgetattr(self.master)[4]
        known = {
            getattr(termios, f"B{b}"): b for b in x.BAUDS.values() if hasattr(termios, f"B{b}")
        }
        return known.get(speed, self.baud) == self.baud

    def _handle(self, identity: int, instruction: int, body: bytes, when: float) -> None:
        # The servo acts when the packet is whole on the wire, even where this process comes to it
        # later.
        for answer in self.bench.answer(identity, instruction, body, when):
            servo = self.bench.servos.get(answer[4])
            delay = 2e-6 * (servo.get(x.RETURN_DELAY) if servo is not None else 0)
            self._free = when = max(self._free, when) + delay + 10 * len(answer) / self.baud
            self._send(answer, when + self.latency)

    def _send(self, answer: bytes, when: float) -> None:
        def lucky(name):
            return self.random.random() < self.chance[name]

        if lucky("silent"):
            self.log("silenced")
            return
        if lucky("crc"):
            k = self.random.randrange(8, len(answer))
            answer = (
                answer[:k] + bytes([answer[k] ^ (1 << self.random.randrange(8))]) + answer[k + 1 :]
            )
            self.log("corrupted")
        if lucky("drop_byte"):
            k = self.random.randrange(len(answer))
            answer = answer[:k] + answer[k + 1 :]
            self.log("byte dropped")
        if lucky("late"):
            when += self.late_s
            self.log("late")
        self._at(when, lambda: self._write(self.noise + answer))

    def _write(self, content: bytes) -> None:
        if self.slave is not None:
            os.write(self.master, content)


def serve(
    identities: list[int],
    plant: str | os.PathLike[str] | None,
    log: str | os.PathLike[str] | None,
    *,
    latency: float = 0.001,
    return_delay: int = 250,
    baud: int = 1_000_000,
    seed: int = 0,
) -> None:
    """Serves until told to quit; prints the name of the port once it is there."""
    files = (None if plant is None else str(plant), None if log is None else str(log))
    bus = EmulatedBus(
        identities, *files, latency=latency, return_delay=return_delay, baud=baud, seed=seed
    )
    print(bus.path, flush=True)
    bus.run()
