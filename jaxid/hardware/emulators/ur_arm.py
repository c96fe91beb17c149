"""The inside of an emulated UR10: joints with drives, the control script of ur_rtde 1.6, and what
RTDE shows of them.

A kinematic command follower in front of a simple drive: it proves pacing, clamps, stops and
recording. Speed scaling by the controller, path tolerance, force limits and the lag of a real
controller need URSim or a robot.
"""

from __future__ import annotations

import math
import random
import time
from collections.abc import Mapping, Sequence
from typing import Any

from jaxid.hardware.emulators.orders import EventLog
from jaxid.hardware.emulators.plant import EmulatedPlant


JOINTS = 6
STEP = 0.002  # s, 500 Hz
BANDWIDTH = 40.0  # rad/s, of the emulated joint controllers
LOOKAHEAD, ACCELERATION = 0.03, 40.0  # s, rad/s^2: of what is asked of them
#: Defaults of the plant: decoupled pendulums of about a UR10's size, gravity on the three joints
#: that lift.
PLANT: dict[str, tuple[float, ...]] = {
    "inertia": (2.5, 2.5, 1.2, 0.3, 0.3, 0.2),
    "gravity_torque": (0.0, 60.0, 25.0, 3.0, 0.0, 0.0),
    "viscous": (12.0, 12.0, 8.0, 2.0, 2.0, 2.0),
    "coulomb": (8.0, 8.0, 5.0, 1.5, 1.5, 1.5),
    "offset": (0.0,),
}
#: N m/A, of the size published for a UR10e by others (shamilmamedov/dynamic_calibration).
DRIVE_GAIN = (10.0, 10.7, 8.5, 9.0, 9.5, 10.1)
#: Of the sensors where no plant is given, rad and A: those of a UR10e at rest (recordings of
#: shamilmamedov/dynamic_calibration: 1.8e-5 rad, 0.013 to 0.055 A).
NOISE = {"q": 1.8e-5, "current": 0.03}
CURRENT_LIMIT = (30.0, 30.0, 20.0, 8.0, 8.0, 8.0)  # A

#: Numbers of the control script that ur_rtde 1.6 uploads (they belong to that version).
MOVE_J, SPEED_J, SERVO_J, SPEED_STOP, SERVO_STOP, SET_WATCHDOG, STOP_J, KICK, STOP_SCRIPT = (
    1,
    9,
    11,
    15,
    16,
    35,
    34,
    99,
    255,
)
NAMES = {
    0: "none",
    MOVE_J: "moveJ",
    SPEED_J: "speedJ",
    SERVO_J: "servoJ",
    SPEED_STOP: "speedStop",
    SERVO_STOP: "servoStop",
    STOP_J: "stopJ",
    SET_WATCHDOG: "setWatchdog",
    KICK: "kickWatchdog",
    STOP_SCRIPT: "stopScript",
}

_V6 = (
    "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current"
    " joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose"
    " target_TCP_speed joint_temperatures actual_joint_voltage actual_current_window"
    " joint_position_deviation_ratio ft_raw_wrench tcp_offset payload_inertia"
)
_DOUBLE = (
    "timestamp actual_execution_time target_speed_fraction speed_scaling actual_momentum"
    " actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0"
    " standard_analog_input1 standard_analog_output0 standard_analog_output1 payload"
    " tool_output_current tcp_force_scalar speed_slider_fraction standard_analog_output_0"
    " standard_analog_output_1"
)
_UINT32 = (
    "runtime_state robot_status_bits safety_status_bits output_bit_registers0_to_31"
    " output_bit_registers32_to_63 input_bit_registers0_to_31 input_bit_registers32_to_63"
    " speed_slider_mask"
)
_UINT8 = (
    "tool_output_mode standard_digital_output_mask standard_digital_output"
    " configurable_digital_output_mask configurable_digital_output tool_digital_output_mask"
    " tool_digital_output standard_analog_output_mask standard_analog_output_type"
)
VARIABLES: dict[str, str] = (
    dict.fromkeys(_V6.split(), "VECTOR6D")
    | dict.fromkeys(_DOUBLE.split(), "DOUBLE")
    | dict.fromkeys(_UINT32.split(), "UINT32")
    | dict.fromkeys(_UINT8.split(), "UINT8")
    | dict.fromkeys(("robot_mode", "safety_mode", "safety_status", "tool_output_voltage"), "INT32")
    | dict.fromkeys(("actual_digital_input_bits", "actual_digital_output_bits"), "UINT64")
    | dict.fromkeys(
        ("payload_cog", "actual_tool_accelerometer", "elbow_position", "elbow_velocity"), "VECTOR3D"
    )
    | {"joint_mode": "VECTOR6INT32"}
)
for _io in ("input", "output"):
    VARIABLES |= {f"{_io}_int_register_{i}": "INT32" for i in range(48)}
    VARIABLES |= {f"{_io}_double_register_{i}": "DOUBLE" for i in range(48)}
    VARIABLES |= {f"{_io}_bit_register_{i}": "BOOL" for i in range(64, 128)}
SIZES = {"VECTOR6D": 6, "VECTOR3D": 3, "VECTOR6INT32": 6, "VECTOR6UINT32": 6}

RUNNING_BITS, IDLE_BITS = 3, 1  # robot_status_bits: powered on, and program running


class Arm:
    """The controller: call `tick` every `STEP` s; `inputs` takes what RTDE clients write, `values`
    what they read.
    """

    def __init__(self, plant: EmulatedPlant, settings: Mapping[str, Any], log: EventLog):
        self.plant, self.log = plant, log
        self.gain = _six(settings.get("drive_gain", DRIVE_GAIN))
        inertia = _six(settings.get("parameters", {}).get("inertia", PLANT["inertia"]))
        self._kp = [i * BANDWIDTH**2 for i in inertia]
        self._kd = [2 * i * BANDWIDTH for i in inertia]
        noise = settings.get("noise", {})
        self._noise = {k: float(noise.get(k, 0.0)) for k in ("q", "qd", "current")}
        self._random = random.Random(settings.get("seed", 0))
        self.count = 0
        self.target, self.target_qd = list(plant.q), [0.0] * JOINTS
        self.goal: list[float] | None = None
        self.mode = "idle"  # servoJ | speedJ | moveJ | idle
        self.current = [0.0] * JOINTS
        self.registers: dict[str, float] = {}
        self.running = False
        self.slider, self.safety = 1.0, 1
        self._watchdog: float | None = None
        self._fed = 0.0
        self._last = 0

    @property
    def time(self) -> float:
        return self.count * STEP

    # ---- the control script

    def script(self, text: bytes) -> None:
        """A program arrived; ur_rtde's answers through registers, everything else is only noted."""
        name = text.lstrip().split(b"\n", 1)[0][:40].decode(errors="replace")
        self.log("script", name=name, bytes=len(text))
        if b"read_input_integer_reg" in text:
            self.running, self._watchdog = True, None
            self.registers["output_int_register_0"] = 1
            self.mode, self.goal, self.target = "idle", None, list(self.plant.q)

    def halt(self, why: str) -> None:
        """Stops the program and the motion."""
        if self.running or self.mode != "idle":
            self.log("halt", why=why)
        self.running, self.mode, self.goal, self._watchdog = False, "idle", None, None
        self.registers["output_int_register_0"] = 0

    def inputs(self, values: Mapping[str, float]) -> None:
        """Registers written by a client; `input_int_register_0` is the command of ur_rtde."""
        self.registers.update(values)
        self._fed = time.monotonic()
        if "input_int_register_0" not in values:
            return
        code = int(values["input_int_register_0"])
        numbers = [self.registers.get(f"input_double_register_{i}", 0.0) for i in range(11)]
        fresh, self._last = code != self._last, code
        if code != 0 and (fresh or code in (SERVO_J, SPEED_J, KICK)):
            name = NAMES.get(code, "unknown")
            self.log("command", code=code, name=name, values=numbers[:6], t=self.time)
            if name == "unknown":
                print(f"emulator: command {code} of ur_rtde is not known here", flush=True)
        if code == 0:
            self.registers["output_int_register_0"] = 1 if self.running else 0
        elif self.running:
            self._command(code, numbers, fresh)

    def _command(self, code: int, numbers: list[float], fresh: bool) -> None:
        """What a command of ur_rtde makes of the motion; a command that stands for a while is
        `fresh` once.
        """
        if code in (SERVO_J, SPEED_J):
            self.mode = "servoJ" if code == SERVO_J else "speedJ"
            self.goal = numbers[:6]
            return
        if not fresh:
            return
        if code == MOVE_J:
            self.mode, self.goal = "moveJ", numbers[:6]
            return
        if code in (SERVO_STOP, SPEED_STOP, STOP_J):
            self.mode, self.goal = "idle", None
        if code == SET_WATCHDOG:
            self._watchdog = 1 / max(numbers[0], 1e-3)
        if code == STOP_SCRIPT:
            self.halt("stopScript")
        self.registers["output_int_register_0"] = 2

    # ---- time

    def tick(self) -> None:
        """One step: what is told, what the drive does, what the joints do."""
        if self.running and self._watchdog is not None:
            if time.monotonic() - self._fed > self._watchdog:
                self.halt("watchdog")
        ahead = []
        for j in range(JOINTS):
            self.target_qd[j] = min(max(self._speed(j), -math.pi), math.pi)
            ahead.append(self.target[j] + STEP * self.slider * self.target_qd[j])
        if self.mode == "moveJ" and self.goal:
            distances = [abs(a - b) for a, b in zip(ahead, self.goal, strict=True)]
            if max(distances) < 1e-3:
                self.registers["output_int_register_0"] = 2
        self.target = ahead
        for j in range(JOINTS):
            torque = self._kp[j] * (ahead[j] - self.plant.q[j])
            torque += self._kd[j] * (self.target_qd[j] - self.plant.qd[j])
            self.current[j] = min(max(torque / self.gain[j], -CURRENT_LIMIT[j]), CURRENT_LIMIT[j])
        self._show = self._state()
        self.plant.advance(STEP, [c * g for c, g in zip(self.current, self.gain, strict=True)])
        self.count += 1

    def _speed(self, j: int) -> float:
        """The speed that a joint is told next, rad/s."""
        speed = self.target_qd[j]
        wish = 0.0  # a held program decelerates, it does not jump
        if self.safety == 1 and self.goal is not None:
            if self.mode == "servoJ":  # smoothed as by a lookahead time
                distance = self.goal[j] - self.target[j]
                pull = distance / LOOKAHEAD**2 - 2 * speed / LOOKAHEAD
                return speed + STEP * min(max(pull, -ACCELERATION), ACCELERATION)
            wish = self.goal[j]
            if self.mode == "moveJ":
                wish = min(max((wish - self.target[j]) / 0.05, -1.0), 1.0)
        return speed + min(max(wish - speed, -ACCELERATION * STEP), ACCELERATION * STEP)

    def _state(self) -> dict[str, Any]:
        """What the sensors read at the beginning of a step; the current is the one that acts until
        the next.
        """

        def noisy(name, values):
            return [v + self._noise[name] * self._random.gauss(0, 1) for v in values]

        program = self.running
        return {
            "timestamp": self.time,
            "actual_q": noisy("q", self.plant.q),
            "actual_qd": noisy("qd", self.plant.qd),
            "actual_current": noisy("current", self.current),
            "target_q": list(self.target),
            "target_qd": list(self.target_qd),
            "target_current": list(self.current),
            "target_moment": [c * g for c, g in zip(self.current, self.gain, strict=True)],
            "joint_temperatures": [30.0] * JOINTS,
            "joint_mode": [253] * JOINTS,
            "speed_scaling": 1.0,
            "target_speed_fraction": self.slider,
            "robot_mode": 7,
            "safety_mode": self.safety,
            "safety_status": self.safety,
            "safety_status_bits": 1 if self.safety == 1 else 4,
            "runtime_state": 2 if program else 1,
            "robot_status_bits": RUNNING_BITS if program else IDLE_BITS,
            "actual_main_voltage": 48.0,
            "actual_robot_voltage": 48.0,
        }

    def values(self, names: Sequence[str]) -> list[float]:
        """What a recipe shows of the last tick, flat."""
        out: list[float] = []
        for name in names:
            size = SIZES.get(VARIABLES[name], 1)
            value = self._show.get(name, self.registers.get(name, 0))
            out += value if isinstance(value, list) else [value] * size
        return out

    def protective_stop(self) -> None:
        self.safety = 3
        self.halt("protective stop")


def _six(values: Any) -> list[float]:
    values = list(values) if isinstance(values, list | tuple) else [values]
    return [float(values[j % len(values)]) for j in range(JOINTS)]
