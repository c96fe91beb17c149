"""A Universal Robots arm: recorded by packet, moved through ur_rtde in a driver process."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Sequence

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.limits import Limits
from jaxid.hardware.device import approach, DeviceReading, News, PathPlan, Sample
from jaxid.hardware.errors import HardwareError
from jaxid.hardware.link import Driver, ENDS
from jaxid.hardware.pauses import kept_from_running, waited
from jaxid.hardware.recorder import Column, Stream
from jaxid.hardware.trajectory import Trajectory
from jaxid.hardware.transfer import Sender
from jaxid.hardware.ur.rtde import RTDEReader


JOINTS = 6
VECTORS = {
    "q": ("actual_q", "rad", "output"),
    "qd": ("actual_qd", "rad/s", "auxiliary"),
    "current": ("actual_current", "A", "input"),
    "q_cmd": ("target_q", "rad", "auxiliary"),
    "qd_cmd": ("target_qd", "rad/s", "auxiliary"),
    "qdd_cmd": ("target_qdd", "rad/s^2", "auxiliary"),
    "current_cmd": ("target_current", "A", "auxiliary"),
    "tau_cmd": ("target_moment", "N m", "auxiliary"),
    "temperature": ("joint_temperatures", "K", "auxiliary"),
}
SCALARS = ("speed_scaling", "target_speed_fraction", "runtime_state", "robot_mode", "safety_mode")
OPTIONAL = ("actual_main_voltage", "actual_tool_accelerometer")
#: From the data sheets of UR10 and UR10e: range of every joint, speeds of base, shoulder and the
#: others.
LIMITS = Limits(
    lower=(-2 * math.pi,),
    upper=(2 * math.pi,),
    speed=(2.09, 2.09, 3.14, 3.14, 3.14, 3.14),
    acceleration=(40.0,),
    temperature=(273.15 + 80.0,),
    tracking=(0.2,),
)
SAFETY = {
    2: "reduced mode",
    3: "a protective stop",
    4: "recovery",
    5: "a safeguard stop",
    6: "an emergency stop of the system",
    7: "an emergency stop",
    8: "a violation",
    9: "a fault",
}
#: Longest time from the order to stop until the driver confirms that it has begun, and until the
#: arm has stopped (s).
ACKNOWLEDGE_S, STOPPED_S = 0.05, 2.0
ARM_S = 10.0


class UR:
    """A UR10, or another six-joint UR, at an address. Motion needs the package ur_rtde (Python up
    to 3.12); recording does not.

    `rate` Hz: 500 (e-series) or 125 at most. Commands go out at `command_rate` through servoJ with
    `lookahead` s and `gain`. The controller's time is the clock.
    """

    kinds: tuple[str, ...] = ("position",)
    joints: int = JOINTS

    def __init__(
        self,
        host: str,
        *,
        rate: float = 500.0,
        name: str = "ur10",
        command_rate: float = 125.0,
        lookahead: float = 0.1,
        gain: float = 300.0,
    ):
        if not 1 <= rate <= 500:
            raise UsageError(f"a rate of {rate:g} Hz is not one a UR sends; choose 1 to 500")
        if not (0.03 <= lookahead <= 0.2 and 100 <= gain <= 2000):
            raise UsageError("servoJ takes a lookahead of 0.03 to 0.2 s and a gain of 100 to 2000")
        self.host, self.rate, self.name = host, float(rate), name
        if not 1 <= command_rate <= 500:
            raise UsageError(
                f"{command_rate:g} commands a second are none that a UR takes; choose 1 to 500"
            )
        self.command_rate, self.lookahead, self.gain = command_rate, lookahead, gain
        self.command_step = 1 / command_rate
        self.where, self.local = host, host.startswith("127.") or host == "localhost"
        self._reader: RTDEReader | None = None
        self._driver: Driver | None = None
        self._path: Sender | None = None
        self._heard, self._waited, self._patience = 0.0, 0.0, 0.4
        self._playing = False

    def open(self) -> None:
        names = ["timestamp", *(v for v, _, _ in VECTORS.values()), *SCALARS]
        self._reader = RTDEReader(self.host, names, self.rate, optional=OPTIONAL)

    @property
    def reader(self) -> RTDEReader:
        if self._reader is None:
            raise HardwareError(f"{self.host}: not connected")
        return self._reader

    def streams(self) -> list[Stream]:
        columns: list[Column] = []
        for stem, (_, unit, role) in VECTORS.items():
            columns += [Column(_numbered(stem, j + 1), unit, role) for j in range(JOINTS)]
        columns += [Column(name, "1") for name in SCALARS]
        if "actual_main_voltage" in self.reader.names:
            columns.append(Column("voltage", "V"))
        if "actual_tool_accelerometer" in self.reader.names:
            columns += [Column(f"tool_acceleration_{axis}", "m/s^2") for axis in "xyz"]
        info = {
            "host": self.host,
            "controller_version": list(self.reader.version),
            "variables": list(self.reader.names),
        }
        return [
            Stream(
                self.name, tuple(columns), "controller time, RTDE `timestamp`", 1 / self.rate, info
            )
        ]

    def limits(self) -> Limits:
        return LIMITS

    def begin(self) -> None:
        self.reader.start()

    def filenos(self) -> list[int]:
        return [
            self.reader.fileno(),
            *([self._driver.fileno()] if self._driver is not None else []),
        ]

    def news(self) -> News:
        first = 1 + JOINTS * list(VECTORS).index("temperature")
        samples = []
        for host, row in self.reader.read():
            kelvin = [v + 273.15 for v in row[first : first + JOINTS]]
            samples.append(Sample(host, row[0], [*row[1:first], *kelvin, *row[first + JOINTS :]]))
        news = News(
            samples,
            messages=[
                {"kind": "note", "text": f"the controller says: {t}"} for t in self.reader.notes
            ],
        )
        self.reader.notes.clear()
        if self._driver is not None:
            messages = self._driver.messages()
            news.messages += messages
            now = time.monotonic()
            if messages:
                self._heard, self._waited = now, waited(self._driver.process.pid)
            for message in messages:
                if message["kind"] == "want" and self._path is not None:
                    self._path.answer(message)
                self._playing &= message["kind"] != "done"
            if self._playing and now - self._heard > self._patience:
                silence, kept = now - self._heard, waited(self._driver.process.pid) - self._waited
                why = kept_from_running(silence, kept)
                raise HardwareError(
                    f"{self.host}: the motion driver was silent for {silence:.2f} s{why}"
                )
        return news

    def measured(self, values: Sequence[float]) -> DeviceReading:
        return DeviceReading(values[:6], values[6:12], values[12:18], values[48:54])

    def alarm(self, values: Sequence[float], moving: bool) -> str | None:
        scaling, fraction, _, mode, safety = (
            values[JOINTS * len(VECTORS) + k] for k in range(len(SCALARS))
        )
        if safety >= 3 and int(safety) in SAFETY:
            return f"the robot is in {SAFETY[int(safety)]}"
        if not moving:
            return None
        if mode != 7:
            return (
                f"the robot is not running (robot mode {mode:g}); switch it on and release the"
                " brakes"
            )
        if fraction < 0.999 or scaling < 0.999:
            return (
                f"the robot runs slowed down (speed slider {100 * fraction:.0f} %, speed scaling"
                f" {100 * scaling:.0f} %): servoJ then skips parts of the path; set the slider to"
                " 100 %"
            )
        return None

    def tracking(self, values: Sequence[float]) -> float:
        """The largest distance (rad) between a joint and where the controller wants it."""
        return max(abs(a - b) for a, b in zip(values[:6], values[18:24], strict=True))

    def plan(self, trajectory: Trajectory, limits: Limits, values: Sequence[float]) -> PathPlan:
        step = self.command_step
        program = values[JOINTS * len(VECTORS) + SCALARS.index("runtime_state")]
        if program == 2:
            raise UsageError(
                f"{self.host}: a program is running on the robot; stop it, or wait for its end, and"
                " try again"
            )
        here = np.asarray(values[:6])
        path = trajectory.sampled(step)
        lead = approach(here, path[0], limits, step)
        rest = np.repeat(path[:1], round(0.3 / step), axis=0)
        end = np.repeat(path[-1:], round(0.3 / step), axis=0)
        assert limits.speed is not None and limits.lower is not None and limits.upper is not None
        largest = [1.05 * s * step for s in limits.speed]
        if limits.step is not None:
            largest = [min(a, b) for a, b in zip(largest, limits.step, strict=True)]
        begin = len(lead) + len(rest)
        marks = [(begin, "play_start"), (begin + len(path) - 1, "play_end")]
        table = np.concatenate([lead, rest, path, end])
        return PathPlan(
            kind="position",
            table=table,
            step=step,
            lower=limits.lower,
            upper=limits.upper,
            largest_step=largest,
            start=here.tolist(),
            marks=marks,
        )

    def load(self, plan: PathPlan) -> None:
        self._driver = Driver("jaxid.hardware.ur.driver", f"UR at {self.host}")
        self._path = Sender(plan.table, self._driver.send)

    @property
    def _loaded(self) -> Driver:
        """The driver of a path that is loaded."""
        assert self._driver is not None
        return self._driver

    def arm(self, plan: PathPlan, data_age: float) -> None:
        self._path = None
        self._loaded.send("arm", host=self.host, frequency=self.rate, data_age=data_age)
        self._patience = max(0.4, 1.5 * data_age)

    def play(self, plan: PathPlan) -> None:
        self._playing, self._heard, self._waited = (
            True,
            time.monotonic(),
            waited(self._loaded.process.pid),
        )
        self._loaded.send("play", lookahead=self.lookahead, gain=self.gain, **plan.order())

    def beat(self) -> None:
        if self._driver is not None:
            self._driver.send("beat")

    def losses(self) -> dict[str, int]:
        return {}

    def stop(self, reason: str) -> str:
        """servoStop and end of the program by the driver; one that does not confirm is killed, and
        the dashboard asked.
        """
        driver, self._driver, self._playing = self._driver, None, False
        if driver is None:
            return "nothing was moving"
        try:
            if _confirmed(driver, reason):
                driver.close()
                return "the driver stopped the arm"
            driver.kill()
            said = dashboard_stop(self.host)
            driver.close()
            return f"the driver did not answer and was ended; {said}"
        except BaseException:
            driver.kill()
            raise

    def close(self) -> None:
        if self._driver is not None:
            self.stop("closed")
        if self._reader is not None:
            self._reader.close()
            self._reader = None


def _numbered(stem: str, joint: int) -> str:
    """`q` and `q_cmd` of joint 3 are q3 and q3_cmd."""
    base, _, tail = stem.partition("_")
    return f"{base}{joint}" + (f"_{tail}" if tail else "")


def _confirmed(driver: Driver, reason: str) -> bool:
    """Whether the driver begins to stop within `ACKNOWLEDGE_S` and has stopped within
    `STOPPED_S`.
    """
    try:
        driver.link.send("stop", reason=reason)
        began, acknowledged, arrived = time.monotonic(), False, driver.inbox
        while time.monotonic() - began < (STOPPED_S if acknowledged else ACKNOWLEDGE_S):
            for message in arrived:
                acknowledged |= message["kind"] in ENDS
                if message["kind"] == "stopped":
                    return True
            arrived = driver.link.messages(0.01)
    except EOFError:
        pass
    return False


def dashboard_stop(host: str, port: int = 29999) -> str:
    """Stops the robot's program through the dashboard server; says what came of it."""
    try:
        with socket.create_connection((host, port), 0.3) as line:
            line.sendall(b"stop\n")
            line.settimeout(0.5)
            answer = b""
            while answer.count(b"\n") < 2 and (block := line.recv(4096)):
                answer += block
        return "the program was stopped through the dashboard"
    except OSError as error:
        return (
            f"the dashboard did not answer ({error.strerror or error}): the controller's watchdog"
            " stops it, look at the robot"
        )
