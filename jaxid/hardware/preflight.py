"""Before a recording: everything that can be refused while nothing moves and nothing is written,
and what is noted down of it.
"""

from __future__ import annotations

import datetime
import platform
import shutil
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.data.limits import Limits
from jaxid.hardware.device import Device, PathPlan, Sample
from jaxid.hardware.recorder import Stream, SUFFIX
from jaxid.hardware.trajectory import Trajectory


def next_run(out: Path, append: bool) -> int:
    left = sorted(out.glob(f"run_*{SUFFIX}")) if out.is_dir() else []
    if left:
        raise UsageError(
            f"{left[0]} was never finished: save it with `jaxid record recover {out}`, or remove it"
        )
    if out.is_dir() and any(out.iterdir()):
        if not append:
            raise UsageError(
                f"{out} exists and is not empty; choose another folder, or add a run to it with"
                " --append"
            )
        if not (out / "run_1.json").is_file() or not (out / "dataset.toml").is_file():
            raise UsageError(f"{out} was not made by a recording, so no run can be added to it")
        return 1 + max(int(p.stem[4:]) for p in out.glob("run_*.json") if p.stem[4:].isdigit())
    if append and not out.is_dir():
        raise UsageError(f"{out} does not exist, so no run can be added to it; leave out --append")
    return 1


def refuse_other_columns(out: Path, columns: Sequence[str]) -> None:
    channels = tomllib.loads((out / "dataset.toml").read_text(encoding="utf-8")).get("channels", {})
    lacking = [name for name, c in channels.items() if c.get("column", name) not in columns]
    if lacking:
        raise UsageError(
            f"{out} has channels that this recording lacks ({', '.join(lacking)}); record into"
            " another folder"
        )


def check_words(device: Device, play: Trajectory | None, seconds: float | None, split: str) -> None:
    if split not in ("fit", "validation", "report"):
        raise UsageError(f"split is {split!r}; it is fit, validation or report")
    if play is None and seconds is None:
        raise UsageError("say for how many seconds to record")
    if seconds is not None and not 0 < seconds < 1e6:
        raise UsageError(f"{seconds:g} seconds cannot be recorded")
    if play is not None and play.kind not in device.kinds:
        raise UsageError(
            f"{device.name} takes {' or '.join(device.kinds)} commands, the trajectory holds"
            f" {play.kind}"
        )
    if play is not None and seconds is not None and seconds < play.duration:
        raise UsageError(
            f"the trajectory takes {play.duration:g} s: record at least so long, or give a"
            " shorter one"
        )
    if play is not None and play.joints != device.joints:
        raise UsageError(
            f"the trajectory has {play.joints} joints, {device.name} has {device.joints}"
        )
    if play is not None and (why := play.not_in_seconds()):
        raise UsageError(f"the trajectory {play.source} cannot be played: {why}")


def refuse_path(play: Trajectory, bounds: Limits, device: Device) -> None:
    problems = play.check(bounds, device.command_step)
    if problems:
        text = "\n".join(f"- {p}" for p in problems)
        raise UsageError(
            f"the trajectory {play.source} cannot be played on {device.name}; nothing was"
            f" moved:\n{text}"
        )


def refuse_size(out: Path, streams: Sequence[Stream], seconds: float) -> None:
    """The rows as they come, and once more as the tables that they become, have to find room on the
    disk.
    """
    need = 0.0
    for stream in streams:
        if stream.period is not None:
            need += 2 * seconds * (24 + 8 * len(stream.columns)) / stream.period
    free = shutil.disk_usage(next(p for p in out.resolve().parents if p.is_dir())).free
    if need > free:
        raise UsageError(
            f"{seconds:g} s need {need / 1e9:.3g} GB, and {free / 1e9:.3g} GB are free for {out}:"
            " make room, or record less"
        )


def refuse_state(device: Device, bounds: Limits, sample: Sample) -> None:
    why = device.alarm(sample.values, True) or bounds.violation(*device.measured(sample.values))
    if why:
        raise UsageError(f"{device.name} cannot be moved now: {why}")


def dry_text(device: Device, play: Trajectory, plan: PathPlan, sample: Sample) -> str:
    start = max(
        abs(a - b) for a, b in zip(device.measured(sample.values).q, play.values[0], strict=True)
    )
    way = f", beginning {start:.3g} rad from where it stands" if play.kind == "position" else ""
    return (
        f"dry run: the path ({play.duration:.1f} s, {play.kind}) keeps all limits{way}; with the"
        f" way there it takes {plan.duration:.1f} s. Nothing was moved or recorded; --live does it."
    )


def about(
    device, out: Path, split, model, joint, gains, constants, play, plan, bounds: Limits
) -> dict[str, Any]:
    from importlib.metadata import PackageNotFoundError, version

    versions = {"python": platform.python_version()}
    for package in ("jaxid", "ur-rtde", "dynamixel-sdk", "pyserial"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    now = datetime.datetime.now().astimezone()
    excitation = None
    if play is not None:
        excitation = {
            "kind": play.kind,
            "source": play.source,
            "duration_s": play.duration,
            "sha256": play.sha256,
        }
    where = getattr(device, "where", device.name)
    return {
        "name": out.resolve().name,
        "description": (
            f"recorded from {device.name}"
            + (f" while playing {play.source or 'a path'}" if play else "")
        ),
        "source": {
            "hardware": f"{device.name} at {where}",
            "recorded": now.isoformat(timespec="seconds"),
            "by": "jaxid record",
        },
        "provenance": (
            "emulated or simulated (loopback or pseudo terminal)"
            if getattr(device, "local", False)
            else "real device"
        ),
        "split": split,
        "model": model,
        "joint": joint,
        "gain": gains,
        "constants": dict(constants or {}),
        "excitation": excitation,
        "limits": {k: v for k, v in bounds.__dict__.items() if v is not None},
        "still_rad": getattr(device, "still_rad", 1e-4),
        "versions": versions,
    }
