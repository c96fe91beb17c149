"""The inside of emulated XM430-W350 servos: control tables, modes, limits, watchdog, and the joints
they drive.

Current mode is exact (a torque in proportion to the goal current, rounded as the register is);
velocity and position modes are simple laws of our own, not the firmware's.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from jaxid.hardware.dynamixel import registers as x
from jaxid.hardware.emulators import protocol2 as p2
from jaxid.hardware.emulators.orders import EventLog
from jaxid.hardware.emulators.plant import EmulatedPlant


MODEL = 1020
CURRENT = x.MODELS[MODEL][1]
#: Defaults of the plant: a servo with a rod and a weight.
PLANT: dict[str, tuple[float, ...]] = {
    "inertia": (0.030,),
    "gravity_torque": (0.80,),
    "viscous": (0.060,),
    "coulomb": (0.080,),
    "offset": (0.0,),
}
TORQUE_CONSTANT = 1.77  # N m/A
LOOP_S = 1e-3  # of the velocity and position controllers
EEPROM, READ_ONLY, END = 64, (*range(0, 7), *range(120, 147)), 147
FREE = range(168, 256)  # indirect addresses, memory like any other here


class EmulatedServo:
    """One servo's memory; `drive` is its current in A at the moment."""

    def __init__(self, identity: int, joint: int, plant: EmulatedPlant):
        self.identity, self.joint, self.plant = identity, joint, plant
        self.memory = bytearray(256)
        self.pending: tuple[int, bytes] | None = None
        self.fed = 0.0
        self.drive = 0.0
        self.shift = 0.0  # s, of the counter against the clock
        self.noise: Callable[[], float] = lambda: 0.0  # rad, of the encoder before it rounds
        self.triggered: Callable[[int], None] = lambda identity: None
        for register, value in (
            (x.MODEL_NUMBER, MODEL),
            (x.FIRMWARE, 46),
            (x.ID, identity),
            (x.BAUD_RATE, 3),
            (x.RETURN_DELAY, 250),
            (x.OPERATING_MODE, 3),
            (x.PROTOCOL, 2),
            (x.TEMPERATURE_LIMIT, 80),
            (x.CURRENT_LIMIT, 1193),
            (x.VELOCITY_LIMIT, 200),
            (x.MAX_POSITION, 4095),
            (x.MIN_POSITION, 0),
        ):
            self.set(register, value)
        self.restart()

    def restart(self) -> None:
        """What a reboot does: the memory above the EEPROM starts anew."""
        self.memory[EEPROM:] = bytes(256 - EEPROM)
        for register, value in (
            (x.STATUS_RETURN, 2),
            (x.POSITION_P, 800),
            (x.GOAL_CURRENT, 1193),
            (x.GOAL_POSITION, x.CENTER),
            (x.PRESENT_VOLTAGE, 120),
            (x.PRESENT_TEMPERATURE, 35),
        ):
            self.set(register, value)
        self.drive = 0.0

    def get(self, register: x.Register) -> int:
        return x.decode(self.memory, register)

    def set(self, register: x.Register, value: int) -> None:
        self.memory[register.address : register.address + register.size] = value.to_bytes(
            register.size, "little", signed=register.signed
        )

    def control(self, now: float) -> None:
        """The current of the next millisecond."""
        if not self.get(x.TORQUE_ENABLE) or self.get(x.HARDWARE_ERROR):
            self.drive = 0.0
            return
        watchdog = self.get(x.BUS_WATCHDOG)
        if watchdog > 0 and now - self.fed > watchdog * x.WATCHDOG_S:
            self.set(x.BUS_WATCHDOG, -1)
            self.triggered(self.identity)
            self.set(x.GOAL_CURRENT, 0)
            self.set(x.GOAL_VELOCITY, 0)
        mode, limit = self.get(x.OPERATING_MODE), self.get(x.CURRENT_LIMIT) * CURRENT
        q, qd = self.plant.q[self.joint], self.plant.qd[self.joint]
        if mode == 0:
            wish = self.get(x.GOAL_CURRENT) * CURRENT
        elif mode == 1 or self.get(x.BUS_WATCHDOG) < 0:
            wish = 0.8 * (self.get(x.GOAL_VELOCITY) * x.VELOCITY - qd)
        else:
            wish = (
                self.get(x.POSITION_P)
                / 100
                * ((self.get(x.GOAL_POSITION) - x.CENTER) * x.POSITION - q)
                - 0.25 * qd
            )
        self.drive = min(max(wish, -limit), limit)

    def show(self, now: float) -> None:
        """Brings the readable values up to date."""
        q, qd = self.plant.q[self.joint] + self.noise(), self.plant.qd[self.joint]
        self.set(x.TICK, int((now + self.shift) * 1000) % x.TICK_WRAP)
        self.set(x.PRESENT_CURRENT, round(self.drive / CURRENT))
        self.set(x.PRESENT_VELOCITY, round(qd / x.VELOCITY))
        self.set(x.PRESENT_POSITION, round(q / x.POSITION) + x.CENTER)

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        if address + size > END and not (address in FREE and address + size <= 256):
            return p2.RANGE, b""
        return 0, bytes(self.memory[address : address + size])

    def write(self, address: int, content: bytes) -> int:
        """The error code, 0 for none."""
        code = self._refusal(address, content)
        if code:
            return code
        self.memory[address : address + len(content)] = content
        if address == x.OPERATING_MODE.address:
            self.set(x.GOAL_CURRENT, 0 if content[0] == 0 else self.get(x.CURRENT_LIMIT))
        if address == x.TORQUE_ENABLE.address and content[0] and self.get(x.OPERATING_MODE) == 3:
            self.set(x.GOAL_POSITION, round(self.plant.q[self.joint] / x.POSITION) + x.CENTER)
        return 0

    def _refusal(self, address: int, content: bytes) -> int:
        """Why a write is not taken, 0 where it is."""
        touched = range(address, address + len(content))
        free = address in FREE and touched.stop <= 256
        if not content or (touched.stop > END and not free):
            return p2.RANGE
        if any(a in READ_ONLY for a in touched):
            return p2.ACCESS
        if address < EEPROM and self.get(x.TORQUE_ENABLE):
            return p2.ACCESS
        is_goal = touched.start < 120 and touched.stop > 100
        if is_goal and self.get(x.BUS_WATCHDOG) < 0:
            return p2.RANGE
        if address == x.TORQUE_ENABLE.address and content[0] and self.get(x.HARDWARE_ERROR):
            return p2.RESULT_FAIL
        return 0 if self._within_limit(address, content) else p2.LIMIT

    def _within_limit(self, address: int, content: bytes) -> bool:
        """Whether a goal is within the limit that the servo's own registers hold."""

        def value(register):
            return int.from_bytes(content[: register.size], "little", signed=register.signed)

        if address == x.GOAL_CURRENT.address:
            return abs(value(x.GOAL_CURRENT)) <= self.get(x.CURRENT_LIMIT)
        if address == x.GOAL_VELOCITY.address:
            return abs(value(x.GOAL_VELOCITY)) <= self.get(x.VELOCITY_LIMIT)
        if address == x.GOAL_POSITION.address and self.get(x.OPERATING_MODE) == 3:
            low, high = self.get(x.MIN_POSITION), self.get(x.MAX_POSITION)
            return low <= value(x.GOAL_POSITION) <= high
        return True


class ServoBus:
    """All servos of a bus and what they move. `answer` takes a packet and gives the bytes of the
    answers.
    """

    def __init__(
        self,
        identities: list[int],
        plant: EmulatedPlant,
        settings: Mapping[str, Any],
        log: EventLog,
        clock: Callable[[], float],
    ):
        self.plant, self.log, self.clock = plant, log, clock
        self.torque_constant = float(settings.get("torque_constant", TORQUE_CONSTANT))
        self._random = random.Random(settings.get("seed", 0))
        self._noise = float(settings.get("noise", {}).get("q", 0.0))
        self.servos = {i: EmulatedServo(i, j, plant) for j, i in enumerate(identities)}
        for s in self.servos.values():
            s.noise = lambda: self._random.gauss(0.0, self._noise)
            s.triggered = lambda identity: self.log("watchdog", id=identity)
        self.now = clock()

    def advance(self, now: float | None = None) -> None:
        """Moves everything on to a time, or to the present, in steps of the servos' own
        controllers.
        """
        now = self.clock() if now is None else now
        while now - self.now > 1e-9:
            step = min(LOOP_S, now - self.now)
            before = []
            for s in self.servos.values():
                s.control(self.now)
                before.append(s.drive)
            if all(
                s.get(x.OPERATING_MODE) == 0 or not s.get(x.TORQUE_ENABLE)
                for s in self.servos.values()
            ):
                step = min(0.02, now - self.now)  # nothing to control: the goal current holds
            self.plant.advance(step, [c * self.torque_constant for c in before])
            self.now += step
        for s in self.servos.values():
            s.show(self.now)

    def wrap_in(self, seconds: float) -> None:
        """Sets all counters so that they start again from 0 after so long."""
        for s in self.servos.values():
            s.shift = x.TICK_WRAP * x.TICK_S - (self.clock() + seconds) % (x.TICK_WRAP * x.TICK_S)

    def overload(self, identity: int) -> None:
        servo = self.servos[identity]
        servo.set(x.HARDWARE_ERROR, 0x20)
        servo.set(x.TORQUE_ENABLE, 0)

    def answer(self, identity: int, instruction: int, body: bytes, when: float) -> list[bytes]:
        """Status packets for one instruction packet that arrived at `when`, in the order in which
        they go out.
        """
        self.advance(when)
        for s in self.servos.values():
            s.fed = self.now  # "communication is defined as all the instruction packets"
        if instruction in (p2.SYNC_READ, p2.BULK_READ):
            return self._each(self._asked(instruction, body))
        if instruction in (p2.FAST_SYNC_READ, p2.FAST_BULK_READ):
            return self._together(self._asked(instruction, body))
        if instruction in (p2.SYNC_WRITE, p2.BULK_WRITE):
            for i, address, content in _contents(instruction, body):
                if i in self.servos:
                    self._write(self.servos[i], address, content)
            return []
        to_all = identity == p2.BROADCAST
        named = [s for i, s in self.servos.items() if to_all or i == identity]
        answers = [self._alone(s, instruction, body) for s in named]
        if to_all and instruction not in (p2.PING, p2.READ):
            return []
        return answers

    def _asked(self, instruction: int, body: bytes) -> list[tuple[EmulatedServo, int, int]]:
        """(servo, address, size) of what a read of several servos asks for."""
        if instruction in (p2.SYNC_READ, p2.FAST_SYNC_READ):
            address, size = struct.unpack("<HH", body[:4])
            asked = [(i, address, size) for i in body[4:]]
        else:
            asked = [struct.unpack_from("<BHH", body, k) for k in range(0, len(body) - 4, 5)]
        return [(self.servos[i], a, n) for i, a, n in asked if i in self.servos]

    def _alone(self, s: EmulatedServo, instruction: int, body: bytes) -> bytes:
        """What one servo does on an instruction, and the status packet with which it answers."""
        if instruction == p2.PING:
            about = struct.pack("<HB", s.get(x.MODEL_NUMBER), s.get(x.FIRMWARE))
            return self._status(s, 0, about)
        if instruction == p2.READ:
            return self._status(s, *self._read(s, *struct.unpack("<HH", body[:4])))
        if instruction == p2.WRITE:
            return self._status(s, self._write(s, struct.unpack_from("<H", body)[0], body[2:]))
        if instruction == p2.REG_WRITE:
            s.pending = (struct.unpack_from("<H", body)[0], body[2:])
        elif instruction == p2.ACTION:
            if s.pending is not None:
                self._write(s, *s.pending)
                s.pending = None
        elif instruction == p2.REBOOT:
            self.log("reboot", id=s.identity)
            s.restart()
        else:
            return self._status(s, p2.INSTRUCTION)
        return self._status(s)

    def _each(self, asked) -> list[bytes]:
        return [self._status(s, *self._read(s, a, n)) for s, a, n in asked]

    def _together(self, asked) -> list[bytes]:
        """The fast reads: one packet, in it error, id, data and a checksum a servo (the last is the
        packet's own).
        """
        size = 1 + sum(n + 4 for _, _, n in asked)
        out = p2.HEADER + bytes([p2.BROADCAST]) + struct.pack("<HB", size, p2.STATUS)
        for s, a, n in asked:
            code, content = self._read(s, a, n)
            out += bytes([code | self._alert(s), s.identity]) + content.ljust(n, b"\0")
            out += struct.pack("<H", p2.crc16(out))
        return [out] if asked else []

    def _alert(self, servo: EmulatedServo) -> int:
        return p2.ALERT if servo.get(x.HARDWARE_ERROR) else 0

    def _status(self, servo: EmulatedServo, code: int = 0, content: bytes = b"") -> bytes:
        return p2.packet(servo.identity, bytes([p2.STATUS, code | self._alert(servo)]) + content)

    def _read(self, servo: EmulatedServo, address: int, size: int) -> tuple[int, bytes]:
        code, content = servo.read(address, size)
        if address == x.BLOCK.address and code == 0:
            names = {
                "tick": x.TICK,
                "current": x.PRESENT_CURRENT,
                "velocity": x.PRESENT_VELOCITY,
                "position": x.PRESENT_POSITION,
            }
            self.log(
                "read",
                id=servo.identity,
                time=self.now,
                **{k: servo.get(r) for k, r in names.items()},
            )
        return code, content

    def _write(self, servo: EmulatedServo, address: int, content: bytes) -> int:
        code = servo.write(address, content)
        self.log("write", id=servo.identity, address=address, data=list(content), error=code)
        return code


def _contents(instruction: int, body: bytes) -> Iterator[tuple[int, int, bytes]]:
    """(id, address, content) of what a write to several servos holds."""
    if instruction == p2.SYNC_WRITE:
        address, size = struct.unpack("<HH", body[:4])
        for k in range(4, len(body) - size, size + 1):
            yield body[k], address, body[k + 1 : k + 1 + size]
        return
    k = 0
    while k + 5 <= len(body):
        identity, address, size = struct.unpack_from("<BHH", body, k)
        yield identity, address, body[k + 5 : k + 5 + size]
        k += 5 + size
