"""Dynamixel servos of the X series: recorded and moved through ROBOTIS' SDK in a driver process."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.limits import Limits
from jaxid.hardware.device import approach, DeviceReading, News, PathPlan, Sample
from jaxid.hardware.dynamixel import registers as x
from jaxid.hardware.errors import HardwareError
from jaxid.hardware.link import Driver
from jaxid.hardware.pauses import kept_from_running, waited
from jaxid.hardware.recorder import Column, COMMANDS, Stream
from jaxid.hardware.trajectory import KINDS, Trajectory
from jaxid.hardware.transfer import Sender


FORMS = ("sync", "bulk", "fast")
#: Without an answer from the driver for so long it is hung (s): its slowest step is a question that
#: is never answered.
SILENT_S = 0.5
OPEN_S = 8.0
STOPPED_S = 1.0


class _Played(NamedTuple):
    """What is commanded about a path, [ticks joints]: from `start` a `lead` to it, what is held
    before and after it; the limits of commands and their largest steps, [joints].
    """

    start: np.ndarray
    lead: np.ndarray
    first: np.ndarray
    end: np.ndarray
    lower: Sequence[float]
    upper: Sequence[float]
    largest: Sequence[float]


class Dynamixel:
    """One or several servos on a serial port.

    `mode` is the kind of command they shall take (current A, velocity rad/s, position rad), None
    only watches. q is 0 where the position register reads `zero` (counts), or where the servo
    stands at the start with `zero="here"`. `form` of question: sync, bulk or fast (fast sync read;
    firmware 46 or newer). The realtime tick of the first servo is the clock. A current stays a
    current: the torque constant belongs to a model.
    """

    def __init__(
        self,
        port: str,
        ids: Sequence[int] | int = (1,),
        *,
        baud: int = 1_000_000,
        rate: float = 200.0,
        mode: str | None = None,
        zero: int | str = x.CENTER,
        form: str = "sync",
    ):
        self.ids = [ids] if isinstance(ids, int) else list(ids)
        if (
            not self.ids
            or len(set(self.ids)) < len(self.ids)
            or not all(0 <= i <= 252 for i in self.ids)
        ):
            raise UsageError(f"ids {self.ids} are not different numbers from 0 to 252")
        if mode is not None and mode not in x.MODES:
            raise UsageError(f"mode is {mode!r}; it is one of {', '.join(x.MODES)}")
        if form not in FORMS:
            raise UsageError(f"form is {form!r}; it is one of {', '.join(FORMS)}")
        if not 1 <= rate <= 1000:
            raise UsageError(f"a rate of {rate:g} Hz is none a servo can follow; choose 1 to 1000")
        if not (zero == "here" or isinstance(zero, int)):
            raise UsageError(f"zero is {zero!r}; write a number of counts, or here")
        self.port, self.baud, self.rate, self.form, self.mode, self._zero = (
            port,
            baud,
            float(rate),
            form,
            mode,
            zero,
        )
        self.joints, self.kinds = len(self.ids), () if mode is None else (mode,)
        self.command_step = 1 / self.rate
        self.name, self.where = "dynamixel", port
        self.local = port.startswith("/dev/pts/")
        self.still_rad = 1.5 * x.POSITION
        self.advice: list[str] = []
        self._driver: Driver | None = None
        self._path: Sender | None = None
        self._lost: dict[str, int] = {}
        self._heard = self._waited = 0.0
        self._patience = SILENT_S

    def open(self) -> None:
        self._driver = Driver("jaxid.hardware.dynamixel.driver", f"servos on {self.port}")
        order = {
            "port": self.port,
            "baud": self.baud,
            "ids": self.ids,
            "rate": self.rate,
            "form": self.form,
        }
        try:
            opened = self._driver.ask("open", "opened", OPEN_S, **order)
        except HardwareError as error:
            self.close()
            raise UsageError(str(error)) from None
        self.servos, self.answer_s = opened["servos"], opened["answer_s"]
        self.zero: list[int] = [s["position"] for s in self.servos]
        if self._zero != "here":
            self.zero = [int(self._zero)] * len(self.servos)
        self._heard = time.monotonic()
        self.advice = self._advise()
        best = 1 / (self.answer_s + (0.0 if self.mode is None else 1e-4) + 3e-4)
        if best < self.rate:
            self.close()
            way = "; ".join(self.advice) or "ask for a lower rate"
            raise UsageError(
                f"{self.port}: an answer takes {1e3 * self.answer_s:.2f} ms, so {self.rate:g} Hz"
                f" cannot be reached: {way}"
            )

    def _advise(self) -> list[str]:
        """What slows this line down, and how to change it."""
        advice = []
        for s in self.servos:
            if s["return_delay"] > 5:
                advice.append(
                    f"servo {s['id']} waits {2 * s['return_delay']} us before it answers: set its"
                    " return delay (register 9) to 0"
                )
        if self.baud < 1_000_000:
            advice.append(
                f"{self.baud} baud is slow: set register 8 of the servo to 3 (1 Mbit/s) and use"
                " --baud 1000000"
            )
        timer = (
            Path("/sys/bus/usb-serial/devices") / Path(self.port).resolve().name / "latency_timer"
        )
        try:
            if (latency := int(timer.read_text())) > 1:
                advice.append(
                    f"the USB adapter holds answers back for {latency} ms: `echo 1 | sudo tee"
                    f" {timer}`"
                )
        except (OSError, ValueError):
            pass
        return advice

    def streams(self) -> list[Stream]:
        columns = []
        for j, servo in enumerate(self.servos):
            n = "" if self.joints == 1 else str(j + 1)
            amps = x.MODELS[servo["model"]][1]
            columns += [
                Column(f"q{n}", "rad", "output", x.POSITION, raw_unit="count", scale=x.POSITION),
                Column(
                    f"qd{n}",
                    "rad/s",
                    "auxiliary",
                    x.VELOCITY,
                    raw_unit="0.229 rev/min",
                    scale=x.VELOCITY,
                ),
                Column(
                    f"current{n}",
                    "A",
                    "input" if self.mode is None else "auxiliary",
                    amps,
                    raw_unit="count",
                    scale=amps,
                ),
                Column(
                    f"voltage{n}", "V", "auxiliary", x.VOLTAGE, raw_unit="0.1 V", scale=x.VOLTAGE
                ),
                Column(f"temperature{n}", "K", "auxiliary", 1.0, raw_unit="degC", scale=1.0),
            ]
            if self.mode is not None:
                stem, unit = KINDS[self.mode]
                columns.append(
                    Column(
                        f"{stem}{n}_cmd",
                        unit,
                        "input",
                        self._scale(j),
                        raw_unit="count",
                        scale=self._scale(j),
                    )
                )
        columns += [Column("t_sent", "s", "clock"), Column("t_received", "s", "clock")]
        info = {
            "port": self.port,
            "baud": self.baud,
            "question": self.form,
            "servos": [
                {**s, "name": x.MODELS[s["model"]][0], "zero_counts": z}
                for s, z in zip(self.servos, self.zero, strict=True)
            ],
            "answer_s": self.answer_s,
            "advice": self.advice,
            "tick_s": x.TICK_S,
        }
        main = Stream(
            self.name,
            tuple(columns),
            "realtime tick of the first servo (register 120)",
            1 / self.rate,
            info,
        )
        told = tuple(c for c in columns if c.name.endswith("_cmd"))
        return [main, Stream("commands", told, COMMANDS)] if told else [main]

    def _scale(self, j: int) -> float:
        """SI value of one count of servo j's goal."""
        return {
            "current": x.MODELS[self.servos[j]["model"]][1],
            "velocity": x.VELOCITY,
            "position": x.POSITION,
        }[self.mode or ""]

    def limits(self) -> Limits:
        def each(name: str, scale) -> tuple[float, ...]:
            return tuple(s[name] * scale(j) for j, s in enumerate(self.servos))

        def position(name: str) -> tuple[float, ...]:
            pairs = zip(self.servos, self.zero, strict=True)
            return tuple((s[name] - zero) * x.POSITION for s, zero in pairs)

        low = high = None
        if self.mode == "position":
            low, high = position("min_position"), position("max_position")
        return Limits(
            lower=low,
            upper=high,
            speed=each("velocity_limit", lambda j: x.VELOCITY),
            current=each("current_limit", lambda j: x.MODELS[self.servos[j]["model"]][1]),
            temperature=each("temperature_limit", lambda j: 1.0)
            and tuple(s["temperature_limit"] + 273.15 for s in self.servos),
        )

    @property
    def _running(self) -> Driver:
        """The driver of a bus that is open."""
        assert self._driver is not None
        return self._driver

    def begin(self) -> None:
        self._running.send("begin")
        self._heard = time.monotonic()

    def filenos(self) -> list[int]:
        return [] if self._driver is None else [self._driver.fileno()]

    def news(self) -> News:
        out, now = News(), time.monotonic()
        messages = self._running.messages()
        if messages:
            self._heard, self._waited = now, waited(self._running.process.pid)
        elif now - self._heard > self._patience + 3 / self.rate:
            silence, kept = now - self._heard, waited(self._running.process.pid) - self._waited
            why = kept_from_running(silence, kept)
            raise HardwareError(f"{self.port}: the driver has been silent for {silence:.2f} s{why}")
        for m in messages:
            if m["kind"] == "sample":
                out.samples.append(Sample(m["received"], m["device"], self._values(m)))
            elif m["kind"] == "command":
                values = [self._from_counts(g, j) for j, g in enumerate(m["goal"])]
                out.commands.append(Sample(m["at"], m["at"], values))
            elif m["kind"] == "lost":
                self._lost = {k: v for k, v in m.items() if k != "kind"}
            else:
                if m["kind"] == "want" and self._path is not None:
                    self._path.answer(m)
                out.messages.append(m)
        return out

    def _values(self, message: dict[str, Any]) -> list[float]:
        values: list[float] = []
        for j, (position, velocity, current, voltage, temperature) in enumerate(message["rows"]):
            amps = x.MODELS[self.servos[j]["model"]][1]
            values += [
                (position - self.zero[j]) * x.POSITION,
                velocity * x.VELOCITY,
                current * amps,
            ]
            values += [voltage * x.VOLTAGE, temperature + 273.15]
            if self.mode is not None:
                goal = message["goal"]
                values.append(
                    self._still(values[-5], j) if goal is None else self._from_counts(goal[j], j)
                )
        return [*values, message["sent"], message["received"]]

    def _still(self, q: float, j: int) -> float:
        return q if self.mode == "position" else 0.0

    def _from_counts(self, goal: float, j: int) -> float:
        return (goal - self._zeros()[j]) * self._scale(j)

    def _step(self) -> int:
        return 5 if self.mode is None else 6

    def measured(self, values: Sequence[float]) -> DeviceReading:
        n = self._step()

        def pick(k):
            return [values[n * j + k] for j in range(self.joints)]

        return DeviceReading(pick(0), pick(1), pick(2), pick(4))

    def alarm(self, values: Sequence[float], moving: bool) -> str | None:
        return None  # the driver tells of hardware errors by itself

    def plan(self, trajectory: Trajectory, limits: Limits, values: Sequence[float]) -> PathPlan:
        step = self.command_step
        path = trajectory.sampled(step)
        hold = round(0.3 / step)
        if self.mode == "position":
            played = self._played_positions(path, hold, limits, values)
        else:
            played = self._played_rates(path, hold, limits)
        largest = played.largest
        if limits.step is not None:
            largest = [min(a, b) for a, b in zip(largest, limits.step, strict=True)]
        begin = len(played.lead) + hold
        shift = self._zeros()
        below = self._whole_counts([-v for v in played.lower])
        above = self._whole_counts(played.upper)
        table = np.concatenate([played.lead, played.first, path, played.end])
        return PathPlan(
            kind=self.mode or "",
            table=self._counts(table),
            step=step,
            lower=[zero - count for zero, count in zip(shift, below, strict=True)],
            upper=[zero + count for zero, count in zip(shift, above, strict=True)],
            largest_step=[max(1, count) for count in self._whole_counts(largest)],
            start=self._counts(played.start[None])[0].round().tolist(),
            marks=[(begin, "play_start"), (begin + len(path) - 1, "play_end")],
        )

    def _played_positions(
        self, path: np.ndarray, hold: int, limits: Limits, values: Sequence[float]
    ) -> _Played:
        """A path of positions: approached from where the joints are, and held at its ends."""
        assert limits.lower is not None and limits.upper is not None
        step = self.command_step
        speed = limits.speed or (math.inf,) * self.joints
        start = np.array(self.measured(values).q)
        return _Played(
            start=start,
            lead=approach(start, path[0], limits, step),
            first=np.repeat(path[:1], hold, axis=0),
            end=np.repeat(path[-1:], hold, axis=0),
            lower=limits.lower,
            upper=limits.upper,
            largest=[1.05 * s * step for s in speed],
        )

    def _played_rates(self, path: np.ndarray, hold: int, limits: Limits) -> _Played:
        """A path of currents or velocities: nothing is commanded before and after it."""
        top = limits.current
        if self.mode != "current":
            top = limits.speed or (math.inf,) * self.joints
        assert top is not None
        largest = list(top)
        if self.mode == "velocity" and limits.acceleration is not None:
            largest = [a * self.command_step for a in limits.acceleration]
        still = np.zeros((hold, self.joints))
        return _Played(
            start=np.zeros(self.joints),
            lead=np.zeros((0, self.joints)),
            first=still,
            end=still,
            lower=[-v for v in top],
            upper=top,
            largest=largest,
        )

    def _whole_counts(self, values: Sequence[float]) -> list[int]:
        """The counts that each joint reaches without passing its value."""
        return [math.floor(v / self._scale(j) + 1e-9) for j, v in enumerate(values)]

    def _zeros(self) -> list[int]:
        """The count at which each joint's command is zero."""
        return list(self.zero) if self.mode == "position" else [0] * self.joints

    def _counts(self, values: np.ndarray) -> np.ndarray:
        scale = np.array([self._scale(j) for j in range(self.joints)])
        return values / scale + np.array(self._zeros())

    def load(self, plan: PathPlan) -> None:
        self._path = Sender(plan.table, self._running.send)

    def arm(self, plan: PathPlan, data_age: float) -> None:
        self._path = None
        self._patience = max(SILENT_S, 1.5 * data_age)
        self._running.send("arm", mode=plan.kind, data_age=data_age)

    def play(self, plan: PathPlan) -> None:
        self._running.send("play", **plan.order())

    def beat(self) -> None:
        if self._driver is not None:
            self._driver.send("beat")

    def losses(self) -> dict[str, int]:
        """Answers that were lost, by reason; none of them was stored."""
        return dict(self._lost)

    def stop(self, reason: str) -> str:
        driver, self._driver = self._driver, None
        if driver is None:
            return "nothing was moving"
        said = "the driver did not answer and was ended; the servo's own bus watchdog stops it"
        try:
            driver.link.send("stop", reason=reason)
            until, arrived = time.monotonic() + STOPPED_S, driver.inbox
            while time.monotonic() < until:
                for m in arrived:
                    if m["kind"] == "lost":
                        self._lost = {k: v for k, v in m.items() if k != "kind"}
                    if m["kind"] == "stopped":
                        said, until = m.get("said") or "nothing was moving", 0.0
                arrived = driver.link.messages(0.02) if until else []
        except EOFError:
            said = "the driver had ended; the servo's own bus watchdog stops it"
        driver.close()
        return said

    def close(self) -> None:
        if self._driver is not None:
            self.stop("closed")
