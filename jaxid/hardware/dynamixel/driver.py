"""The driver process of Dynamixel servos: reads, and moves them, through ROBOTIS' own SDK. Run by
`jaxid.hardware.dynamixel.servo.Dynamixel`.

A cycle writes the command first and reads right after it. Every command is told with its own time, so that what a servo was
told between two samples is known however late or lost the answers are.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Sequence
from typing import Any, Literal

from jaxid.hardware.dynamixel import registers as x
from jaxid.hardware.dynamixel.tick import TickClock
from jaxid.hardware.limits import Clamp, Refused
from jaxid.hardware.link import busy, farewell, first_line, in_driver, Leash, Link, Stop
from jaxid.hardware.port import opened
from jaxid.hardware.transfer import Table


PROBES = 25  # questions that measure how long an answer takes
TRIES = 5
FORMS = ("sync", "bulk", "fast")


class BusError(RuntimeError):
    """Something on the bus that ends the recording."""


class Bus:
    """A port and the servos on it. `read` gives blocks of registers, or None with `lost` counted by reason."""

    def __init__(self, port: str, baud: int, ids: Sequence[int], form: str):
        import dynamixel_sdk
        import dynamixel_sdk.port_handler as handler

        self.sdk: Any = dynamixel_sdk
        self.ids, self.form, self._handler = list(ids), form, handler

        class Port(dynamixel_sdk.PortHandler):
            """Opened for this process alone, and waiting for bytes in the kernel; the SDK shares a port with whoever opens it
            too, and keeps a core busy asking for bytes."""

            def setupPort(self, cflag_baud: int) -> Literal[True]:
                if self.is_open:
                    self.closePort()
                self.ser = opened(self.port_name, self.baudrate)
                self.is_open = True
                self.tx_time_per_byte = 1e4 / self.baudrate
                return True

            def readPort(self, length: int) -> bytes:
                if length > 0 and self.ser is not None:
                    select.select([self.ser], [], [], 1e-3)
                return super().readPort(length)

        class Packets(dynamixel_sdk.Protocol2PacketHandler):
            """Leaves the checksum out of an answer; the SDK alone takes it for the content of one that has none."""

            def rxPacket(self, port: Any, fast_option: bool) -> Any:
                packet, result = super().rxPacket(port, fast_option)
                if result == dynamixel_sdk.COMM_SUCCESS and not fast_option:
                    packet = packet[: 5 + (packet[5] | packet[6] << 8)]
                return packet, result

        self.port = Port(port)
        self.packets: Any = Packets()
        self.lost: dict[str, int] = {}
        self.alerts: set[int] = set()
        if not self.port.setBaudRate(baud):
            raise BusError(f"ROBOTIS' SDK has no baud rate {baud}; use 57600, 115200, 1000000, 2000000, 3000000 or 4000000")

    # ---- single registers

    def get(self, identity: int, register: x.Register) -> int:
        """Raises `BusError` after `TRIES` failures."""
        what = ""
        for _ in range(TRIES):
            content, result, error = self.packets.readTxRx(self.port, identity, register.address, register.size)
            if result == 0 and len(content) == register.size and not error & 0x7F:
                return x.decode(content, register, register.address)
            what = self._what(result, error)
            self.settle()
        raise BusError(f"servo {identity}: register {register.address} cannot be read ({what})")

    def put(self, identity: int, register: x.Register, value: int) -> None:
        """Writes and reads back; raises `BusError` after `TRIES` failures."""
        content = list(value.to_bytes(register.size, "little", signed=register.signed))
        what = ""
        for _ in range(TRIES):
            result, error = self.packets.writeTxRx(self.port, identity, register.address, register.size, content)
            if result == 0 and not error & 0x7F:
                return
            what = self._what(result, error)
            self.settle()
        raise BusError(f"servo {identity}: register {register.address} cannot be set to {value} ({what})")

    def _what(self, result: int, error: int) -> str:
        text = self.packets.getTxRxResult(result) if result != 0 else self.packets.getRxPacketError(error & 0x7F)
        return text.split("] ", 1)[-1].rstrip("!") or "an answer of the wrong length"

    def ping(self, identity: int) -> int | None:
        """The model number, or None."""
        for _ in range(2):
            try:
                model, result, _ = self.packets.ping(self.port, identity)
                if result == 0:
                    return model
            except IndexError:  # an empty answer, of another question
                pass
            self.settle()
        return None

    # ---- samples

    def read(self) -> list[bytes] | None:
        """The block of every servo, all fresh from one question; None where any is missing or broken."""
        address, size = x.BLOCK.address, x.BLOCK.size
        if self.form == "bulk":
            asked = [b for i in self.ids for b in (i, address & 0xFF, address >> 8, size & 0xFF, size >> 8)]
            result = self.packets.bulkReadTx(self.port, asked, len(asked), False)
        else:
            result = self.packets.syncReadTx(self.port, address, size, self.ids, len(self.ids), self.form == "fast")
        if result != 0:
            return self._missed("not sent")
        blocks = self._fast(size) if self.form == "fast" else self._one_by_one(size)
        return blocks

    def _one_by_one(self, size: int) -> list[bytes] | None:
        blocks = []
        for identity in self.ids:
            content, result, error = self.packets.readRx(self.port, identity, size)
            if result != 0:
                return self._missed("silent" if result == self.sdk.COMM_RX_TIMEOUT else "corrupt")
            if len(content) != size or error & 0x7F:
                return self._missed("of another question")
            self._note(identity, error)
            blocks.append(bytes(content))
        return blocks

    def _fast(self, size: int) -> list[bytes] | None:
        each = size + 4  # error, id, data, checksum
        content, result, _ = self.packets.fastSyncReadRx(self.port, self.sdk.BROADCAST_ID, each * len(self.ids))
        if result != 0:
            return self._missed("silent" if result == self.sdk.COMM_RX_TIMEOUT else "corrupt")
        found = {}
        for k in range(0, len(content) - each + 1, each):
            found[content[k + 1]] = (content[k], bytes(content[k + 2 : k + 2 + size]))
        if set(found) != set(self.ids) or any(error & 0x7F for error, _ in found.values()):
            return self._missed("of another question")
        for identity, (error, _) in found.items():
            self._note(identity, error)
        return [found[i][1] for i in self.ids]

    def _note(self, identity: int, error: int) -> None:
        if error & 0x80:
            self.alerts.add(identity)

    def _missed(self, why: str) -> None:
        self.lost[why] = self.lost.get(why, 0) + 1
        self.settle()

    def settle(self) -> None:
        """After a failure: waits until the line has been quiet, so that no late answer is taken for the next one."""
        self.port.is_using = False
        until = time.monotonic() + 0.02
        quiet = time.monotonic() + 0.002
        while (now := time.monotonic()) < min(until, quiet):
            if self.port.getBytesAvailable():
                self.port.clearPort()
                quiet = now + 0.002
            time.sleep(2e-4)

    def write(self, register: x.Register, values: Sequence[int]) -> None:
        """One goal a servo in one packet that nobody answers."""
        content = []
        for identity, value in zip(self.ids, values, strict=True):
            content += [identity, *value.to_bytes(register.size, "little", signed=register.signed)]
        result = self.packets.syncWriteTxOnly(self.port, register.address, register.size, content, len(content))
        self.port.is_using = False
        if result != 0:
            raise BusError(f"a command could not be sent ({self._what(result, 0)})")

    def expect(self, answer_s: float) -> None:
        """Sets the SDK's time-out after how long an answer takes (its own, 34 ms, is that of a slow adapter)."""
        latency_ms = min(16.0, max(4.0, 2e3 * answer_s))  # the SDK waits twice as long, and 2 ms more
        self._handler.LATENCY_TIMER = latency_ms  # pyright: ignore[reportAttributeAccessIssue]


def main(fd: int) -> None:
    """Serves orders `open`, `begin`, `arm`, `play` and `quit` on this end of the line; after `begin` samples flow."""
    link = in_driver(fd)
    leash = Leash(link)
    session: Session | None = None
    try:
        order = leash.next_order()
        session = Session(link, leash, order)
        link.send("opened", **session.describe())
        session.run()
    except BaseException as error:  # the SDK and pyserial raise what they like; each is a reason to stop, and is told
        gone = type(error).__name__ in ("SerialException", "OSError", "error")
        farewell(link, error, "the port is gone: " if gone else "")
    finally:
        farewell(link, said=session.let_go() if session is not None else "")


class Session:
    """Everything between opening the port and letting go of the servos."""

    def __init__(self, link: Link, leash: Leash, order: dict[str, Any]):
        self.link, self.leash = link, leash
        self.where, self.period = order["port"], 1 / order["rate"]
        self.bus = Bus(order["port"], order["baud"], order["ids"], order["form"])
        self.clocks = [TickClock() for _ in self.bus.ids]
        self.found = [self._inspect(i, order["baud"]) for i in self.bus.ids]
        self.answer_s = self._measure()
        self.mode: str | None = None
        self.data_age = 0.0
        self.goal: list[int] | None = None
        self.told: list[int] | None = None
        self.restore: dict[int, int] = {}
        self.table = Table()

    def _inspect(self, identity: int, baud: int) -> dict[str, Any]:
        model = self.bus.ping(identity)
        if model is None:
            raise BusError(f"servo {identity} does not answer on {self.where} at {baud} baud{self._elsewhere(identity, baud)}")
        if model not in x.MODELS:
            known = ", ".join(name for name, _ in x.MODELS.values())
            raise BusError(f"servo {identity} is of model {model}, whose registers are not known here (known: {known})")
        names = {
            "firmware": x.FIRMWARE, "return_delay": x.RETURN_DELAY, "operating_mode": x.OPERATING_MODE,
            "drive_mode": x.DRIVE_MODE, "temperature_limit": x.TEMPERATURE_LIMIT, "current_limit": x.CURRENT_LIMIT,
            "velocity_limit": x.VELOCITY_LIMIT, "max_position": x.MAX_POSITION, "min_position": x.MIN_POSITION,
            "torque_enable": x.TORQUE_ENABLE, "status_return": x.STATUS_RETURN, "hardware_error": x.HARDWARE_ERROR,
            "position_p": x.POSITION_P, "position": x.PRESENT_POSITION, "bus_watchdog": x.BUS_WATCHDOG,
        }  # fmt: skip
        return {"id": identity, "model": model} | {name: self.bus.get(identity, r) for name, r in names.items()}

    def _elsewhere(self, identity: int, baud: int) -> str:
        for other in (57600, 1_000_000, 115200, 2_000_000, 3_000_000, 4_000_000):
            if other != baud and self.bus.port.setBaudRate(other) and self.bus.ping(identity) is not None:
                return f"; it does at {other} baud: use --baud {other}"
        return "; check its id, its power and the cable"

    def _measure(self) -> float:
        """How long a question takes to its answer (s): reads only, nothing changes."""
        taken = []
        for _ in range(PROBES):
            began = time.monotonic()
            if self.bus.read() is not None:
                taken.append(time.monotonic() - began)
        if len(taken) < PROBES // 2:
            raise BusError(f"{PROBES - len(taken)} of {PROBES} trial questions on {self.where} were not answered; check the line")
        answer = sorted(taken)[int(0.9 * (len(taken) - 1))]
        self.bus.expect(answer)
        self.bus.lost.clear()
        return sorted(taken)[len(taken) // 5]  # of the line itself: what is slower had to wait for this computer

    def describe(self) -> dict[str, Any]:
        return {"servos": self.found, "answer_s": self.answer_s}

    # ---- cycles

    def run(self) -> None:
        """Samples for as long as the supervisor is there; orders come in between."""
        while (order := self.leash.next_order())["kind"] != "begin":
            if order["kind"] == "quit":
                raise Stop("finished")
        deadline = time.monotonic()
        while True:
            self.leash.wait(deadline)
            while self.leash.inbox:
                order = self.leash.inbox.pop(0)
                if order["kind"] in ("path", "rows"):
                    kind, content = self.table.take(order)
                    self.link.send(kind, **content)
                elif order["kind"] == "arm":
                    self._arm(order)
                    self.link.send("armed")
                    deadline = time.monotonic()
                elif order["kind"] == "play":
                    self.link.send("done", **self._play(order))
                    deadline = time.monotonic()
                elif order["kind"] == "quit":
                    raise Stop("finished")
            if time.monotonic() < deadline:  # an order came before the next question was due
                continue
            self._cycle()
            deadline = max(deadline + self.period, time.monotonic())

    def _cycle(self) -> bool:
        """One question; whether it gave a sample. While torque is on, the goal is written before it."""
        if self.goal is not None and self.mode is not None:
            at = time.monotonic()
            self.bus.write(x.MODES[self.mode][1], self.goal)
            if self.goal != self.told:
                self.told = self.goal
                self.link.send("command", at=at, goal=self.goal)
        sent = time.monotonic()
        blocks = self.bus.read()
        received = time.monotonic()
        if self.bus.alerts:
            identity = min(self.bus.alerts)
            bits = self.bus.get(identity, x.HARDWARE_ERROR)
            raise BusError(f"servo {identity} reports a hardware error: {x.error_text(bits)}; it has switched its torque off")
        if blocks is None:
            self._report()
            return False
        times = [c.fresh(x.decode(b, x.TICK, 120), sent, received) for c, b in zip(self.clocks, blocks, strict=True)]
        if any(t is None for t in times):
            self.bus.lost["stale"] = sum(c.stale for c in self.clocks)
            self.bus.lost["repeated"] = sum(c.repeated for c in self.clocks)
            self.bus.settle()
            self._report()
            return False
        registers = (x.PRESENT_POSITION, x.PRESENT_VELOCITY, x.PRESENT_CURRENT, x.PRESENT_VOLTAGE, x.PRESENT_TEMPERATURE)
        rows = [[x.decode(b, r, 120) for r in registers] for b in blocks]
        self.link.send("sample", device=times[0], sent=sent, received=received, rows=rows, goal=self.goal)
        return True

    def _report(self) -> None:
        self.link.send("lost", **{k.replace(" ", "_"): v for k, v in self.bus.lost.items() if v})

    def _arm(self, order: dict[str, Any]) -> None:
        """Mode, watchdog, a goal that changes nothing, torque, in this order."""
        self.leash.longest_s = self.data_age = order["data_age"]
        self.leash.tighten(True)
        watchdog = min(127, max(1, round(self.data_age / x.WATCHDOG_S)))
        self.mode = str(order["mode"])
        number, register = x.MODES[self.mode]
        for f in self.found:
            identity = f["id"]
            bits = self.bus.get(identity, x.HARDWARE_ERROR)
            if bits:
                raise BusError(f"servo {identity} has a hardware error ({x.error_text(bits)}): switch its power off and on")
            self._while_leashed(self.bus.put, identity, x.TORQUE_ENABLE, 0)
            self.restore[identity] = self.bus.get(identity, x.OPERATING_MODE)
            if self.restore[identity] != number:
                self._while_leashed(self.bus.put, identity, x.OPERATING_MODE, number)
            self._while_leashed(self.bus.put, identity, x.BUS_WATCHDOG, 0)  # clears one that has triggered
            self._while_leashed(self.bus.put, identity, x.BUS_WATCHDOG, watchdog)
        here = [self.bus.get(i, x.PRESENT_POSITION) for i in self.bus.ids]
        self.goal = here if self.mode == "position" else [0] * len(here)
        self.bus.write(register, self.goal)
        for identity in self.bus.ids:
            self._while_leashed(self.bus.put, identity, x.TORQUE_ENABLE, 1)

    def _while_leashed(self, action: Callable[..., None], *arguments: Any) -> None:
        self.leash.wait(time.monotonic())
        action(*arguments)

    def _play(self, order: dict[str, Any]) -> dict[str, Any]:
        """Plays the table (rounded to counts), a row a cycle; a late one delays the rest, so that nothing has to catch up."""
        clamp = Clamp(order["lower"], order["upper"], order["largest_step"], order["start"])
        marks = {int(row): name for row, name in order.get("marks", [])}
        deadline = last = time.monotonic()
        longest = late = 0.0
        for k, row in enumerate(self.table):
            self.leash.wait(deadline)
            try:
                self.goal = [int(v) for v in clamp([_whole(v) for v in row])]
            except Refused as error:
                raise BusError(f"row {k + 1} of the path was refused: {error}") from None
            now = time.monotonic()
            if k in marks:
                self.link.send("mark", name=marks[k], at=now)
            if self._cycle():
                last = time.monotonic()
            elif (silence := time.monotonic() - last) > self.data_age:
                # Made of one long cycle it is this process that did not run; many questions without an answer are the servo's.
                why = f"; {busy(time.monotonic() - deadline)}" if time.monotonic() - deadline > 0.5 * silence else ""
                raise BusError(f"no valid answer for {silence:.2f} s while it moved ({self._losses()}){why}")
            overrun = time.monotonic() - deadline - self.period
            if overrun > 0:
                late, longest = late + overrun, max(longest, overrun)
            deadline = max(deadline + self.period, time.monotonic())
        return {"clamped": clamp.count, "late_s": late, "longest_s": longest}

    def _losses(self) -> str:
        return ", ".join(f"{n} {k}" for k, n in self.bus.lost.items() if n) or "none counted"

    def let_go(self) -> str:
        """Goal zero at once, then torque off and everything as it was; says what could not be done."""
        failed, mode = [], self.mode
        if mode is not None:
            if mode != "position":
                register = x.MODES[mode][1]
                failed += _tried(lambda: self.bus.write(register, [0] * len(self.bus.ids)))
            for identity in self.bus.ids:
                failed += _tried(lambda i=identity: self.bus.put(i, x.TORQUE_ENABLE, 0))
            for identity in self.bus.ids:
                failed += _tried(lambda i=identity: self.bus.put(i, x.BUS_WATCHDOG, 0))
                if identity in self.restore:
                    failed += _tried(lambda i=identity: self.bus.put(i, x.OPERATING_MODE, self.restore[i]))
        _tried(self.bus.port.closePort)
        if not failed:
            return "torque is off" if self.mode is not None else ""
        return f"the servo could not be told to stop ({failed[0]}); its bus watchdog stops it within {1e3 * self.data_age:.0f} ms"


def _tried(action: Callable[[], Any]) -> list[str]:
    try:
        action()
    except Exception as error:
        return [first_line(error)]
    return []


def _whole(value: float) -> float:
    """Rounded to a count; what is no number stays so, for the clamp to refuse."""
    return float(round(value)) if value == value and abs(value) < 1e15 else value
