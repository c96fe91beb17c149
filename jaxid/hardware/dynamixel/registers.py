"""Dynamixel X series: addresses, units and models. Source: ROBOTIS e-Manual, control tables of
XM430-W350 and XL330-M288.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Register(NamedTuple):
    address: int
    size: int
    signed: bool = False


MODEL_NUMBER = Register(0, 2)
FIRMWARE = Register(6, 1)
ID = Register(7, 1)
BAUD_RATE = Register(8, 1)
RETURN_DELAY = Register(9, 1)  # 2 us
DRIVE_MODE = Register(10, 1)
OPERATING_MODE = Register(11, 1)
PROTOCOL = Register(13, 1)
TEMPERATURE_LIMIT = Register(31, 1)  # degC
CURRENT_LIMIT = Register(38, 2)
VELOCITY_LIMIT = Register(44, 4)
MAX_POSITION = Register(48, 4)
MIN_POSITION = Register(52, 4)
TORQUE_ENABLE = Register(64, 1)
STATUS_RETURN = Register(68, 1)
HARDWARE_ERROR = Register(70, 1)
POSITION_P = Register(84, 2)
BUS_WATCHDOG = Register(98, 1, True)  # 20 ms
GOAL_CURRENT = Register(102, 2, True)
GOAL_VELOCITY = Register(104, 4, True)
GOAL_POSITION = Register(116, 4, True)
TICK = Register(120, 2)  # ms
PRESENT_CURRENT = Register(126, 2, True)
PRESENT_VELOCITY = Register(128, 4, True)
PRESENT_POSITION = Register(132, 4, True)
PRESENT_VOLTAGE = Register(144, 2)  # 0.1 V
PRESENT_TEMPERATURE = Register(146, 1)  # degC
#: What is read for every sample: from the tick to the temperature.
BLOCK = Register(120, 27)

TICK_S, TICK_WRAP = 1e-3, 32768
WATCHDOG_S = 0.02
COUNTS = 4096
POSITION = 2 * math.pi / COUNTS  # rad
VELOCITY = 0.229 * 2 * math.pi / 60  # rad/s
VOLTAGE = 0.1  # V
CENTER = 2048
#: Kind of command -> (operating mode, goal register).
MODES = {
    "current": (0, GOAL_CURRENT),
    "velocity": (1, GOAL_VELOCITY),
    "position": (3, GOAL_POSITION),
}
BAUDS = {
    0: 9600,
    1: 57600,
    2: 115200,
    3: 1_000_000,
    4: 2_000_000,
    5: 3_000_000,
    6: 4_000_000,
    7: 4_500_000,
}
ERRORS = {
    0: "input voltage",
    2: "overheating",
    3: "motor encoder",
    4: "electrical shock",
    5: "overload",
}

#: Model number -> (name, current of one count in A).
MODELS = {
    1000: ("XH430-W350", 2.69e-3),
    1010: ("XH430-W210", 2.69e-3),
    1040: ("XH430-V350", 1.34e-3),
    1050: ("XH430-V210", 1.34e-3),
    1020: ("XM430-W350", 2.69e-3),
    1030: ("XM430-W210", 2.69e-3),
    1100: ("XH540-W270", 2.69e-3),
    1110: ("XH540-W150", 2.69e-3),
    1120: ("XM540-W270", 2.69e-3),
    1130: ("XM540-W150", 2.69e-3),
    1190: ("XL330-M077", 1.0e-3),
    1200: ("XL330-M288", 1.0e-3),
}


def decode(content: bytes | bytearray | list[int], register: Register, base: int = 0) -> int:
    """The value of a register in a block that begins at address `base`."""
    start = register.address - base
    return int.from_bytes(
        bytes(content[start : start + register.size]), "little", signed=register.signed
    )


def error_text(bits: int) -> str:
    """Hardware error status in words."""
    return ", ".join(name for bit, name in ERRORS.items() if bits >> bit & 1) or f"code {bits}"
