"""Packets of the Dynamixel protocol 2.0, as the emulator needs them: framing, byte stuffing,
checksum.

Source: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0". The recording side does not use this: it uses
ROBOTIS' own SDK.
"""

from __future__ import annotations

import struct


HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
PING, READ, WRITE, REG_WRITE, ACTION, RESET, REBOOT, CLEAR = (
    0x01,
    0x02,
    0x03,
    0x04,
    0x05,
    0x06,
    0x08,
    0x10,
)
STATUS, SYNC_READ, SYNC_WRITE, FAST_SYNC_READ, BULK_READ, BULK_WRITE, FAST_BULK_READ = (
    0x55,
    0x82,
    0x83,
    0x8A,
    0x92,
    0x93,
    0x9A,
)
RESULT_FAIL, INSTRUCTION, CRC, RANGE, LENGTH, LIMIT, ACCESS = range(1, 8)
ALERT = 0x80


def _table() -> list[int]:
    out = []
    for value in range(256):
        crc = value << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
        out.append(crc)
    return out


_CRC = _table()


def crc16(content: bytes) -> int:
    """CRC-16 with the polynomial 0x8005, from 0."""
    crc = 0
    for byte in content:
        crc = ((crc << 8) & 0xFFFF) ^ _CRC[((crc >> 8) ^ byte) & 0xFF]
    return crc


def packet(identity: int, body: bytes, stuff: bool = True) -> bytes:
    """A whole packet around instruction or status `body`."""
    body = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd") if stuff else body
    head = HEADER + bytes([identity]) + struct.pack("<H", len(body) + 2) + body
    return head + struct.pack("<H", crc16(head))


class Packets:
    """Cuts a stream of bytes into (id, instruction, parameters); `broken` counts packets with a
    wrong checksum.
    """

    def __init__(self):
        self._buffer = b""
        self.broken = 0

    def feed(self, block: bytes) -> list[tuple[int, int, bytes, int]]:
        """Whole packets so far, each with its length on the wire."""
        self._buffer += block
        out = []
        while True:
            start = self._buffer.find(HEADER)
            if start < 0:
                self._buffer = self._buffer[-3:]
                return out
            self._buffer = self._buffer[start:]
            if len(self._buffer) < 7:
                return out
            size = 7 + struct.unpack_from("<H", self._buffer, 5)[0]
            if size > 1100:  # no packet is so long: a header inside of noise
                self._buffer = self._buffer[4:]
                continue
            if len(self._buffer) < size:
                return out
            whole, self._buffer = self._buffer[:size], self._buffer[size:]
            if size < 10 or crc16(whole[:-2]) != struct.unpack("<H", whole[-2:])[0]:
                self.broken += 1
                continue
            body = whole[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            out.append((whole[4], body[0], body[1:], size))
