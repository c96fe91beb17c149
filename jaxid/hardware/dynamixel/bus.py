"""The bus of Dynamixel servos: registers read and written over one port."""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Sequence
from typing import Any, Literal

from jaxid.base.extras import needed
from jaxid.hardware.dynamixel import registers as x
from jaxid.hardware.link import first_line
from jaxid.hardware.port import opened


PROBES = 25  # questions that measure how long an answer takes


TRIES = 5


HEADER = 9  # bytes before the content of an answer


LATE_S = 0.02  # an answer that is not there by then comes no more, but for a broken line


FORMS = ("sync", "bulk", "fast")


class BusError(RuntimeError):
    """Something on the bus that ends the recording."""


class Bus:
    """A port and the servos on it. `read` gives blocks of registers, or None with `lost` counted by
    reason.
    """

    def __init__(self, port: str, baud: int, ids: Sequence[int], form: str):
        dynamixel_sdk = needed("dynamixel_sdk")
        handler = needed("dynamixel_sdk.port_handler")
        self.sdk: Any = dynamixel_sdk
        self.ids, self.form, self._handler = list(ids), form, handler

        class Port(dynamixel_sdk.PortHandler):
            """Opened for this process alone, and waiting for bytes in the kernel; the SDK shares a
            port with whoever opens it too, and keeps a core busy asking for bytes.
            """

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

        class PacketHandler(dynamixel_sdk.Protocol2PacketHandler):
            """Leaves the checksum out of an answer, and keeps its size. The SDK alone takes the
            checksum for the content of an answer that has none, and cuts one that is too long.
            """

            size = 0  # bytes of content of the last answer

            def rxPacket(self, port: Any, fast_option: bool) -> Any:
                packet, result = super().rxPacket(port, fast_option)
                if result == dynamixel_sdk.COMM_SUCCESS and not fast_option:
                    packet = packet[: 5 + (packet[5] | packet[6] << 8)]
                    self.size = len(packet) - HEADER
                return packet, result

        self.port = Port(port)
        self.packets: Any = PacketHandler()
        self.lost: dict[str, int] = {}
        self.alerts: set[int] = set()
        if not self.port.setBaudRate(baud):
            raise BusError(
                f"ROBOTIS' SDK has no baud rate {baud}; use 57600, 115200, 1000000, 2000000,"
                " 3000000 or 4000000"
            )

    # ---- single registers

    def get(self, identity: int, register: x.Register) -> int:
        """Raises `BusError` after `TRIES` failures."""
        what = ""
        for _ in range(TRIES):
            content, result, error = self.packets.readTxRx(
                self.port, identity, register.address, register.size
            )
            if self._answers(result, error, register.size):
                return x.decode(content, register, register.address)
            what = self._what(result, error)
            self.settle(quiet_s=LATE_S)
        raise BusError(f"servo {identity}: register {register.address} cannot be read ({what})")

    def put(self, identity: int, register: x.Register, value: int) -> None:
        """Raises `BusError` after `TRIES` failures."""
        content = list(value.to_bytes(register.size, "little", signed=register.signed))
        what = ""
        for _ in range(TRIES):
            result, error = self.packets.writeTxRx(
                self.port, identity, register.address, register.size, content
            )
            if self._answers(result, error, 0):
                return
            what = self._what(result, error)
            self.settle(quiet_s=LATE_S)
        raise BusError(
            f"servo {identity}: register {register.address} cannot be set to {value} ({what})"
        )

    def _answers(self, result: int, error: int, size: int) -> bool:
        """Whether the last packet answers the question: a late one of another question differs in
        its size.
        """
        return result == self.sdk.COMM_SUCCESS and not error & 0x7F and self.packets.size == size

    def _what(self, result: int, error: int) -> str:
        text = (
            self.packets.getTxRxResult(result)
            if result != 0
            else self.packets.getRxPacketError(error & 0x7F)
        )
        return text.split("] ", 1)[-1].rstrip("!") or "an answer of the wrong length"

    def ping(self, identity: int) -> int | None:
        """The model number, or None."""
        for _ in range(2):
            try:
                model, result, error = self.packets.ping(self.port, identity)
                if self._answers(result, error, size=3):  # model number and firmware
                    return model
            except IndexError:  # an empty answer, of another question
                pass
            self.settle(quiet_s=LATE_S)
        return None

    # ---- samples

    def read(self) -> list[bytes] | None:
        """The block of every servo, all fresh from one question; None where any is missing or
        broken.
        """
        address, size = x.BLOCK.address, x.BLOCK.size
        if self.form == "bulk":
            block = [address & 0xFF, address >> 8, size & 0xFF, size >> 8]
            asked: list[int] = []
            for identity in self.ids:
                asked += [identity, *block]
            result = self.packets.bulkReadTx(self.port, asked, len(asked), False)
        else:
            result = self.packets.syncReadTx(
                self.port, address, size, self.ids, len(self.ids), self.form == "fast"
            )
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
            if not self._answers(result, error, size):
                return self._missed("of another question")
            self._note(identity, error)
            blocks.append(bytes(content))
        return blocks

    def _fast(self, size: int) -> list[bytes] | None:
        each = size + 4  # error, id, data, checksum
        content, result, _ = self.packets.fastSyncReadRx(
            self.port, self.sdk.BROADCAST_ID, each * len(self.ids)
        )
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

    def settle(self, quiet_s: float = 0.002) -> None:
        """After a failure: waits until the line has been quiet, so that no late answer is taken for
        the next one.
        """
        self.port.is_using = False
        until = time.monotonic() + 10 * quiet_s
        quiet = time.monotonic() + quiet_s
        while (now := time.monotonic()) < min(until, quiet):
            if self.port.getBytesAvailable():
                self.port.clearPort()
                quiet = now + quiet_s
            time.sleep(2e-4)

    def write(self, register: x.Register, values: Sequence[int]) -> None:
        """One goal a servo in one packet that nobody answers."""
        content = []
        for identity, value in zip(self.ids, values, strict=True):
            content += [identity, *value.to_bytes(register.size, "little", signed=register.signed)]
        result = self.packets.syncWriteTxOnly(
            self.port, register.address, register.size, content, len(content)
        )
        self.port.is_using = False
        if result != 0:
            raise BusError(f"a command could not be sent ({self._what(result, 0)})")

    def expect(self, answer_s: float) -> None:
        """Sets the SDK's time-out after how long an answer takes (its own, 34 ms, is that of a slow
        adapter).
        """
        latency_ms = min(
            16.0, max(4.0, 2e3 * answer_s)
        )  # the SDK waits twice as long, and 2 ms more
        self._handler.LATENCY_TIMER = latency_ms  # pyright: ignore[reportAttributeAccessIssue]


def tried(action: Callable[[], Any]) -> list[str]:
    try:
        action()
    except Exception as error:
        return [first_line(error)]
    return []
