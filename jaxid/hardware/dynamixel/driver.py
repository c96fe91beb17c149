"""The driver process of Dynamixel servos: reads, and moves them, through ROBOTIS' own SDK. Run by
`jaxid.hardware.dynamixel.servo.Dynamixel`.

A cycle writes the command first and reads right after it. Every command is told with its own time,
so that what a servo was told between two samples is known however late or lost the answers are.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from jaxid.hardware.dynamixel import registers as x
from jaxid.hardware.dynamixel.bus import Bus, BusError, PROBES, tried
from jaxid.hardware.dynamixel.tick import TickClock
from jaxid.hardware.limits import Clamp, Refused
from jaxid.hardware.link import busy, farewell, in_driver, Leash, Link, StopRequest
from jaxid.hardware.transfer import PathTable


def main(fd: int) -> None:
    """Serves orders `open`, `begin`, `arm`, `play` and `quit` on this end of the line; after
    `begin` samples flow.
    """
    link = in_driver(fd)
    leash = Leash(link)
    session: Session | None = None
    try:
        order = leash.next_order()
        session = Session(link, leash, order)
        link.send("opened", **session.describe())
        session.run()
    except (
        BaseException
    ) as error:  # the SDK and pyserial raise what they like; each is a reason to stop, and is told
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
        self.table = PathTable()

    def _inspect(self, identity: int, baud: int) -> dict[str, Any]:
        model = self.bus.ping(identity)
        if model is None:
            raise BusError(
                f"servo {identity} does not answer on {self.where} at {baud}"
                f" baud{self._elsewhere(identity, baud)}"
            )
        if model not in x.MODELS:
            known = ", ".join(name for name, _ in x.MODELS.values())
            raise BusError(
                f"servo {identity} is of model {model}, whose registers are not known here (known:"
                f" {known})"
            )
        names = {
            "firmware": x.FIRMWARE,
            "return_delay": x.RETURN_DELAY,
            "operating_mode": x.OPERATING_MODE,
            "drive_mode": x.DRIVE_MODE,
            "temperature_limit": x.TEMPERATURE_LIMIT,
            "current_limit": x.CURRENT_LIMIT,
            "velocity_limit": x.VELOCITY_LIMIT,
            "max_position": x.MAX_POSITION,
            "min_position": x.MIN_POSITION,
            "torque_enable": x.TORQUE_ENABLE,
            "status_return": x.STATUS_RETURN,
            "hardware_error": x.HARDWARE_ERROR,
            "position_p": x.POSITION_P,
            "position": x.PRESENT_POSITION,
            "bus_watchdog": x.BUS_WATCHDOG,
        }
        return {"id": identity, "model": model} | {
            name: self.bus.get(identity, r) for name, r in names.items()
        }

    def _elsewhere(self, identity: int, baud: int) -> str:
        for other in (57600, 1_000_000, 115200, 2_000_000, 3_000_000, 4_000_000):
            if (
                other != baud
                and self.bus.port.setBaudRate(other)
                and self.bus.ping(identity) is not None
            ):
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
            raise BusError(
                f"{PROBES - len(taken)} of {PROBES} trial questions on {self.where} were not"
                " answered; check the line"
            )
        answer = sorted(taken)[int(0.9 * (len(taken) - 1))]
        self.bus.expect(answer)
        self.bus.lost.clear()
        return sorted(taken)[
            len(taken) // 5
        ]  # of the line itself: what is slower had to wait for this computer

    def describe(self) -> dict[str, Any]:
        return {"servos": self.found, "answer_s": self.answer_s}

    # ---- cycles

    def run(self) -> None:
        """Samples for as long as the supervisor is there; orders come in between."""
        while (order := self.leash.next_order())["kind"] != "begin":
            if order["kind"] == "quit":
                raise StopRequest("finished")
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
                    raise StopRequest("finished")
            if time.monotonic() < deadline:  # an order came before the next question was due
                continue
            self._cycle()
            deadline = max(deadline + self.period, time.monotonic())

    def _cycle(self) -> bool:
        """One question; whether it gave a sample. While torque is on, the goal is written before
        it.
        """
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
            raise BusError(
                f"servo {identity} reports a hardware error: {x.error_text(bits)}; it has switched"
                " its torque off"
            )
        if blocks is None:
            self._report()
            return False
        times = [
            c.fresh(x.decode(b, x.TICK, 120), sent, received)
            for c, b in zip(self.clocks, blocks, strict=True)
        ]
        if any(t is None for t in times):
            self.bus.lost["stale"] = sum(c.stale for c in self.clocks)
            self.bus.lost["repeated"] = sum(c.repeated for c in self.clocks)
            self.bus.settle()
            self._report()
            return False
        self.link.send(
            "sample",
            device=times[0],
            sent=sent,
            received=received,
            rows=[_measured(block) for block in blocks],
            goal=self.goal,
        )
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
                raise BusError(
                    f"servo {identity} has a hardware error ({x.error_text(bits)}): switch its"
                    " power off and on"
                )
            self._while_leashed(self.bus.put, identity, x.TORQUE_ENABLE, 0)
            self.restore[identity] = self.bus.get(identity, x.OPERATING_MODE)
            if self.restore[identity] != number:
                self._while_leashed(self.bus.put, identity, x.OPERATING_MODE, number)
            self._while_leashed(
                self.bus.put, identity, x.BUS_WATCHDOG, 0
            )  # clears one that has triggered
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
        """Plays the table (rounded to counts), a row a cycle; a late one delays the rest, so that
        nothing has to catch up.
        """
        clamp = Clamp(order["lower"], order["upper"], order["largest_step"], order["start"])
        marks = {int(row): name for row, name in order.get("marks", [])}
        deadline = last = time.monotonic()
        longest = late = 0.0
        for k, row in enumerate(self.table):
            self.leash.wait(deadline)
            wanted = [_whole(v) for v in row]
            try:
                self.goal = [int(v) for v in clamp(wanted)]
            except Refused as error:
                raise BusError(f"row {k + 1} of the path was refused: {error}") from None
            now = time.monotonic()
            if k in marks:
                self.link.send("mark", name=marks[k], at=now)
            if self._cycle():
                last = time.monotonic()
            elif (silence := time.monotonic() - last) > self.data_age:
                # Made of one long cycle it is this process that did not run; many questions without
                # an answer are the servo's.
                cycle = time.monotonic() - deadline
                why = f"; {busy(cycle)}" if cycle > 0.5 * silence else ""
                raise BusError(
                    f"no valid answer for {silence:.2f} s while it moved ({self._losses()}){why}"
                )
            overrun = time.monotonic() - deadline - self.period
            if overrun > 0:
                late, longest = late + overrun, max(longest, overrun)
            deadline = max(deadline + self.period, time.monotonic())
        return {"clamped": clamp.count, "late_s": late, "longest_s": longest}

    def _losses(self) -> str:
        return ", ".join(f"{n} {k}" for k, n in self.bus.lost.items() if n) or "none counted"

    def let_go(self) -> str:
        """Goal zero at once, then torque off and everything as it was; says what could not be
        done.
        """
        failed, mode = [], self.mode
        if mode is not None:
            if mode != "position":
                register = x.MODES[mode][1]
                failed += tried(lambda: self.bus.write(register, [0] * len(self.bus.ids)))
            for identity in self.bus.ids:
                failed += tried(lambda i=identity: self.bus.put(i, x.TORQUE_ENABLE, 0))
            for identity in self.bus.ids:
                failed += tried(lambda i=identity: self.bus.put(i, x.BUS_WATCHDOG, 0))
                if identity in self.restore:
                    failed += tried(
                        lambda i=identity: self.bus.put(i, x.OPERATING_MODE, self.restore[i])
                    )
        tried(self.bus.port.closePort)
        if not failed:
            return "torque is off" if self.mode is not None else ""
        return (
            f"the servo could not be told to stop ({failed[0]}); its bus watchdog stops it within"
            f" {1e3 * self.data_age:.0f} ms"
        )


def _measured(block: bytes) -> list[float]:
    """What a servo measured, of its block: position, velocity, current, voltage, temperature."""
    registers = (
        x.PRESENT_POSITION,
        x.PRESENT_VELOCITY,
        x.PRESENT_CURRENT,
        x.PRESENT_VOLTAGE,
        x.PRESENT_TEMPERATURE,
    )
    return [x.decode(block, register, 120) for register in registers]


def _whole(value: float) -> float:
    """Rounded to a count; what is no number stays so, for the clamp to refuse."""
    return float(round(value)) if value == value and abs(value) < 1e15 else value
