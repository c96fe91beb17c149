"""Recording a device, and playing a path on it: one loop that watches everything and lets go of the
motion when in doubt.
"""

from __future__ import annotations

import os
import select
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.base.wording import names_of
from jaxid.data.limits import Limits
from jaxid.data.write import robot_file, written_robot
from jaxid.hardware import preflight
from jaxid.hardware.channels import channel_map, robot_of
from jaxid.hardware.device import Device, PathPlan, Sample
from jaxid.hardware.errors import HardwareError
from jaxid.hardware.finishing import finish, Recording
from jaxid.hardware.pauses import Pauses, progress_said
from jaxid.hardware.preflight import (
    check_words,
    dry_text,
    refuse_other_columns,
    refuse_path,
    refuse_size,
    refuse_state,
)
from jaxid.hardware.recorder import Column, COMMANDS, Recorder, Stream, SUFFIX
from jaxid.hardware.sensor import SensorSpec, SerialSensor
from jaxid.hardware.trajectory import Trajectory


SILENCE_S = 0.5  # a device that sends nothing for so long is lost
BEAT_S = 0.01
MORE_ROOM = "play a path that leaves it more room (`jaxid excite --limits`)"
BUSY, SILENT = "this computer was busy", "no data"
ARMED_S = 15.0


@dataclass
class _RecordingWatch:
    """What is known while recording."""

    began: float
    heard: float
    phase: str = "recording"  # recording | loading | arming | playing | played
    asked: float = 0.0
    last: Sample | None = None
    first: Sample | None = None
    done_at: float | None = None
    notes: list[str] = field(default_factory=list)
    pauses: Pauses = field(default_factory=Pauses)

    @property
    def moving(self) -> bool:
        return self.phase in ("arming", "playing")

    def played_since(self, now: float) -> float:
        """Seconds since the path was played to its end; 0 before."""
        return 0.0 if self.done_at is None else now - self.done_at


def record(
    device: Device,
    out: str | os.PathLike[str],
    seconds: float | None = None,
    *,
    play: Trajectory | None = None,
    live: bool = False,
    limits: Limits | None = None,
    sensors: Sequence[SensorSpec] = (),
    split: str = "fit",
    model: str | None = None,
    joint: int | None = None,
    gain: Sequence[float] | float | None = None,
    constants: Mapping[str, float] | None = None,
    append: bool = False,
    progress: Callable[[str, int, int, str], None] | None = None,
) -> Recording:
    """Records `seconds` of a device into a dataset folder; with `play` a path is moved and recorded
    to its end.

    Nothing moves without `live`: the path, the device and the way to the path's start are then only
    checked. Limits are the device's own, tightened by `limits`. `model`, `joint` and `gain` (N m/A)
    say which model the dataset is meant for (see `channel_map`); `constants` what is known of this
    run. `append` adds a run to a folder that an earlier recording made.

    Raises `UsageError` before anything moved or was written, `HardwareError` for what ended a
    recording early: all rows up to then are in the folder, marked as not complete. So they are
    after Ctrl-C.
    """
    out = Path(out)
    gains = _gains(gain)
    number = preflight.next_run(out, append)
    check_words(device, play, seconds, split)
    with ExitStack() as stack:
        stack.callback(device.close)
        device.open()
        serial = [SerialSensor(s) for s in sensors if s.port is not None]
        for sensor in serial:
            stack.callback(sensor.close)
            sensor.open()
        own = device.streams()
        streams = [*own, *(s.spec.stream() for s in serial)]
        if len(set(names_of(streams))) < len(streams):
            raise UsageError("two devices have the same name; rename a sensor")
        files = [s for s in sensors if s.file is not None]
        columns = _columns([*streams, *(s.stream() for s in files)])
        channel_map(model, columns, joint, gains)
        if number > 1:
            refuse_other_columns(out, names_of(columns))
        bounds = (limits or Limits()).within(device.limits(), device.joints)
        refuse_size(out, streams, play.duration if play is not None else float(seconds or 0.0))
        if play is not None:
            refuse_path(play, bounds, device)
            _refuse_rate(streams[0].period, bounds)
        watch = _first_samples(device)
        assert watch.last is not None
        plan = None
        if play is not None:
            refuse_state(device, bounds, watch.last)
            plan = device.plan(play, bounds, watch.last.values)
            if not live:
                return _dry_run(out, plan, dry_text(device, play, plan, watch.last))
        about = preflight.about(
            device=device,
            out=out,
            split=split,
            model=model,
            joint=joint,
            gains=gains,
            constants=constants,
            play=play,
            plan=plan,
            bounds=bounds,
        )
        about["sensor_files"] = [f.model_dump(exclude_none=True) for f in files]
        robot = robot_of(model)
        about["robot"] = None if robot is None else robot_file(robot)
        out.mkdir(parents=True, exist_ok=True)
        folder = out / f"run_{number}{SUFFIX}"
        recorder = Recorder(folder, streams, about)
        if robot is not None:
            written_robot(robot, folder)
        reason, error = _recorded(
            device=device,
            sensors=serial,
            own=len(own),
            recorder=recorder,
            watch=watch,
            plan=plan,
            seconds=seconds,
            bounds=bounds,
            progress=progress,
        )
        if recorder.counts[0] == 0:
            shutil.rmtree(folder)
            raise error or HardwareError(f"{device.name}: nothing was received")
        recording = finish(folder, reason)
        if isinstance(error, HardwareError):
            error.folder = str(out)
            error.add_note(f"{recording.rows} rows up to then are in {out}, marked as not complete")
        if error is not None:
            raise error
        return recording


def _gains(gain: Sequence[float] | float | None) -> list[float] | None:
    if gain is None:
        return None
    if isinstance(gain, int | float):
        return [float(gain)]
    return [float(g) for g in gain]


def _columns(streams: Sequence[Stream]) -> list[Column]:
    """The columns of what is measured."""
    columns: list[Column] = []
    for stream in streams:
        if stream.clock != COMMANDS:
            columns += stream.columns
    return columns


def _refuse_rate(period: float | None, bounds: Limits) -> None:
    """A motion is watched by samples that come often enough."""
    if period is not None and period > bounds.data_age / 2:
        raise UsageError(
            f"{1 / period:g} samples a second are too few to move with a data_age of"
            f" {bounds.data_age:g} s: raise the rate"
        )


def _dry_run(out: Path, plan: PathPlan, text: str) -> Recording:
    return Recording(
        folder=out,
        file="",
        rows=0,
        seconds=plan.duration,
        rate=0.0,
        lost=0,
        duplicated=0,
        gaps=(),
        complete=False,
        end_reason=text,
        notes=(),
        dry_run=True,
    )


def _recorded(
    device: Device, sensors: Sequence[SerialSensor], recorder: Recorder, **settings: Any
) -> tuple[str, BaseException | None]:
    """Records to the end, whatever it is, and closes the recording: why it ended, and what ended it
    early.
    """
    error: BaseException | None = None
    reason, complete = "the time was over", True
    try:
        reason = _run(device=device, sensors=sensors, recorder=recorder, **settings)
    except BaseException as caught:
        error, complete = caught, False
        reason = str(caught) or type(caught).__name__
        if isinstance(caught, KeyboardInterrupt):
            reason = "interrupted"
        recorder.event("fault", reason)
    finally:
        said = _let_go(device, reason)
        if settings["plan"] is not None:
            recorder.event("stop", said)
        _note_losses(device, sensors, recorder)
        recorder.event("end", reason, complete=complete)
        try:
            recorder.close()
        except OSError as full:
            text = f"{recorder.folder}: rows could not be written ({full.strerror})"
            error = error or HardwareError(text)
    return reason, error


def _note_losses(device: Device, sensors: Sequence[SerialSensor], recorder: Recorder) -> None:
    losses = device.losses()
    if losses:
        text = ", ".join(f"{n} {why.replace('_', ' ')}" for why, n in losses.items())
        recorder.event("note", f"lost answers, none of them stored: {text}", losses=losses)
    for sensor in sensors:
        if sensor.malformed:
            recorder.event(
                "note",
                f"sensor {sensor.spec.name}: {sensor.malformed} lines were not readable and"
                " left out",
            )


def recover(folder: str | os.PathLike[str]) -> list[Recording]:
    """Finishes every recording in a folder whose process died before it could. Raises `UsageError`
    where there is none.
    """
    folder = Path(folder)
    left = (
        [folder]
        if folder.name.endswith(SUFFIX)
        else sorted(p for p in folder.glob(f"*{SUFFIX}") if p.is_dir())
    )
    if not left:
        raise UsageError(f"{folder}: there is no unfinished recording (a folder run_1{SUFFIX})")
    return [finish(p) for p in left]


def _first_samples(device: Device) -> _RecordingWatch:
    """Waits for data; raises `HardwareError` where none come."""
    device.begin()
    now = time.monotonic()
    watch = _RecordingWatch(now, now)
    while watch.last is None:
        _wait(device, [], 0.02)
        for sample in device.news().samples:
            watch.last = sample
        if time.monotonic() - now > 2 * SILENCE_S:
            raise HardwareError(f"{device.name}: connected, but no data within {2 * SILENCE_S:g} s")
    watch.heard = time.monotonic()
    return watch


# ---- while


def _wait(device: Device, sensors: Sequence[SerialSensor], timeout: float) -> None:
    try:
        select.select([*device.filenos(), *sensors], [], [], max(timeout, 0.0))
    except (OSError, ValueError):
        pass  # a line that just broke; reading it says what happened


def _run(
    device,
    sensors,
    own: int,
    recorder: Recorder,
    watch: _RecordingWatch,
    plan: PathPlan | None,
    seconds,
    bounds: Limits,
    progress,
) -> str:
    """Until the time is over or the path played; returns why it ended, raises what ended it early,
    with the pause of this computer that it may have come from.
    """
    watch.pauses = Pauses()
    try:
        return _watched(
            device=device,
            sensors=sensors,
            own=own,
            recorder=recorder,
            watch=watch,
            plan=plan,
            seconds=seconds,
            bounds=bounds,
            progress=progress,
        )
    except HardwareError as error:
        watch.pauses.lap()
        allowed, text = bounds.data_age if watch.moving else SILENCE_S, str(error)
        why = "" if BUSY in text else watch.pauses.said(allowed)
        late = BUSY in text + why or SILENT in text
        if late and watch.moving:
            why += (
                f" (data_age allows {allowed:g} s while it moves: close other programs, or raise it"
                f" where that is safe, by `data_age = {min(5 * allowed, 2.0):g}` in a file for"
                " --limits)"
            )
        if not why:
            raise
        raise HardwareError(text + (why if why.startswith(" ") else f"; {why}")) from error


def _watched(
    device: Device,
    sensors: Sequence[SerialSensor],
    own: int,
    recorder: Recorder,
    watch: _RecordingWatch,
    plan: PathPlan | None,
    seconds: Any,
    bounds: Limits,
    progress: Callable[[str, int, int, str], None] | None,
) -> str:
    watch.began = watch.heard = now = time.monotonic()
    silence = max(SILENCE_S, 3 * (recorder.streams[0].period or 0.0))
    total = plan.duration if plan is not None else float(seconds)
    heard = [now] * len(sensors)
    beaten = told = 0.0
    if plan is not None:
        watch.phase, watch.asked = "loading", now
        device.load(plan)
    while True:
        watch.pauses.lap()
        _wait(device, sensors, BEAT_S)
        watch.pauses.lap(BEAT_S)
        news = device.news()
        now = time.monotonic()
        for sample in news.samples:
            recorder.append(0, *sample)
            watch.last, watch.first = sample, watch.first or sample
            watch.heard = now
            _judge(device, bounds, sample, watch)
        for command in news.commands:
            recorder.append(1, *command)
        _read_sensors(sensors, own, recorder, heard, now)
        for message in news.messages:
            _hear(device, recorder, watch, plan, bounds, message, now)
        _refuse_silence(device, watch, bounds.data_age if watch.moving else silence, now)
        if now - beaten >= BEAT_S:
            device.beat()
            beaten = now
        if progress is not None and now - told > 0.2:
            told = now
            watch.pauses.lap()
            progress(*progress_said(now - watch.began, total, recorder.counts[0]))
            watch.pauses.lap(doing="showing the progress")
        if plan is None and now - watch.began >= seconds:
            return "the time was over"
        if watch.played_since(now) > 0.25:
            return "the path was played"


def _read_sensors(
    sensors: Sequence[SerialSensor],
    own: int,
    recorder: Recorder,
    heard: list[float],
    now: float,
) -> None:
    """Stores what the sensors sent, behind the `own` streams of the device; `heard`: when each was
    heard of last.
    """
    for k, sensor in enumerate(sensors):
        for sample in sensor.read():
            recorder.append(own + k, *sample)
            heard[k] = now
        silent = now - heard[k]
        if silent > 2 * SILENCE_S:
            raise HardwareError(f"sensor {sensor.spec.name} has been silent for {silent:.1f} s")


def _refuse_silence(device: Device, watch: _RecordingWatch, most: float, now: float) -> None:
    """Ends the recording of a device that sends nothing for `most` seconds, or does not start."""
    age = now - watch.heard
    if age > most:
        moved = " while it moved" if watch.moving else ""
        raise HardwareError(f"{device.name}: {SILENT} for {age:.2f} s{moved}")
    if now - watch.asked <= ARMED_S:
        return
    if watch.phase == "loading":
        what = "its driver did not take the path"
    elif watch.phase == "arming":
        what = "it did not become ready to move"
    else:
        return
    raise HardwareError(f"{device.name}: {what} within {ARMED_S:g} s")


def _judge(device: Device, bounds: Limits, sample: Sample, watch: _RecordingWatch) -> None:
    """Ends the recording where the device says so or a measurement is beyond a limit. What is only
    watched may do as it likes.
    """
    why = device.alarm(sample.values, watch.phase == "playing")
    if why is None and watch.moving:
        why = bounds.violation(*device.measured(sample.values))
        why = why and f"{why}; {MORE_ROOM}"
        tracking = getattr(device, "tracking", None)
        if (
            why is None
            and tracking is not None
            and bounds.tracking is not None
            and watch.phase == "playing"
        ):
            distance = tracking(sample.values)
            if distance > min(bounds.tracking):
                why = (
                    f"a joint is {distance:.3g} rad from where it was told to be; the limit is"
                    f" {min(bounds.tracking):.3g} rad"
                )
    if why is not None:
        raise HardwareError(f"{device.name}: {why}")


def _hear(
    device: Device,
    recorder: Recorder,
    watch: _RecordingWatch,
    plan: PathPlan | None,
    bounds: Limits,
    message: Mapping[str, Any],
    now: float,
) -> None:
    kind = message["kind"]
    if kind == "want":
        watch.asked = now
    elif kind == "loaded" and plan is not None:
        watch.phase, watch.asked = "arming", now
        device.arm(plan, bounds.data_age)
    elif kind == "armed" and plan is not None:
        watch.phase = "playing"
        device.play(plan)
    elif kind == "mark":
        recorder.event("mark", "", name=message["name"], at=message["at"])
    elif kind == "done":
        watch.phase, watch.done_at = "played", now
        if message.get("clamped"):
            recorder.event("note", f"{message['clamped']} commands were clamped to the limits")
        if message.get("longest_s", 0) > 0.02:
            recorder.event(
                "note",
                f"commands were up to {1e3 * message['longest_s']:.0f} ms late; the path was played"
                " that much slower",
            )
    elif kind == "note":
        recorder.event("note", message["text"])


def _let_go(device: Device, reason: str) -> str:
    """Stops everything, whatever happens meanwhile; a second Ctrl-C does not get in between."""
    for _ in range(3):
        try:
            return device.stop(reason)
        except KeyboardInterrupt:
            continue
        except Exception as error:
            return f"stopping met an error: {error}"
    return "stopping was interrupted"
