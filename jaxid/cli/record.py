"""`jaxid record`: a dataset from a robot or a servo; motion only with --live."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

import click

from jaxid.base.errors import UsageError
from jaxid.base.stopping import ending
from jaxid.cli import terminal
from jaxid.cli.app import Commands, FAILED, SUCCESS
from jaxid.cli.options import OUT, output_options


#: Priority (`nice`) of what only looks on.
GIVES_WAY = 5


@click.group(cls=Commands)
def record() -> None:
    """Record a dataset from a robot or a servo; nothing moves without --live.

    Limits protect against mistakes in a trajectory, not people: keep the emergency stop in reach.
    """


def _numbers(_ctx, param, value: str | None) -> list[float] | None:
    try:
        return None if value is None else [float(v) for v in value.split(",")]
    except ValueError:
        raise click.BadParameter(
            f"{value!r} is not a number, or numbers with commas", param=param
        ) from None


def _constants(_ctx, param, values: tuple[str, ...]) -> dict[str, float]:
    constants = {}
    try:
        for value in values:
            name, number = value.split("=", 1)
            constants[name.strip()] = float(number)
    except ValueError:
        raise click.BadParameter("write NAME=NUMBER", param=param) from None
    return constants


def _common(command: Callable) -> Callable:
    for option in (
        OUT,
        click.option(
            "--seconds",
            type=float,
            metavar="S",
            help="How long; with --play, the path's own length.",
        ),
        click.option(
            "--play",
            type=click.Path(),
            metavar="TRAJECTORY",
            help="A file, or a folder of `jaxid excite`.",
        ),
        click.option(
            "--watch",
            is_flag=True,
            help="Show it in the browser, as `jaxid watch` does, until Ctrl-C.",
        ),
        click.option("--live", is_flag=True, help="Move. Without it a path is only checked."),
        click.option(
            "--limits",
            type=click.Path(),
            metavar="FILE",
            help="TOML: lower, upper, speed, acceleration, current …",
        ),
        click.option(
            "--sensor",
            "sensors",
            type=click.Path(),
            multiple=True,
            metavar="FILE",
            help="TOML of a further sensor.",
        ),
        click.option(
            "--split",
            type=click.Choice(["fit", "validation", "report"]),
            default="fit",
            show_default=True,
        ),
        click.option(
            "--model",
            metavar="M",
            help="The model that the dataset is meant for, or a robot's file.",
        ),
        click.option(
            "--joint",
            type=click.IntRange(1),
            metavar="J",
            help="The joint of a model with one joint.",
        ),
        click.option(
            "--gain",
            callback=_numbers,
            metavar="K,…",
            help="N m/A assumed of the drive, for models that take torque.",
        ),
        click.option(
            "--constant",
            "constants",
            multiple=True,
            callback=_constants,
            metavar="NAME=X",
            help="Known of this run.",
        ),
        click.option(
            "--append", is_flag=True, help="Add a run to a folder that was recorded before."
        ),
        output_options,
    )[::-1]:
        command = option(command)
    return command


@record.command()
@click.option("--host", required=True, metavar="H", help="Address of the controller.")
@click.option("--rate", type=float, default=500.0, show_default=True, help="Samples a second.")
@_common
def ur10(host, rate, **options) -> int:
    """A UR10, or another UR with six joints.

    Every sample is kept; the controller's time is the clock.
    """
    from jaxid.base.extras import required
    from jaxid.hardware import UR

    if options["play"] is not None and options["live"]:
        required("rtde_control")
    return _record(UR(host, rate=rate), **options)


@record.command()
@click.option("--port", required=True, metavar="P", help="Serial port, such as /dev/ttyUSB0.")
@click.option(
    "--id",
    "ids",
    type=click.IntRange(0, 252),
    multiple=True,
    required=True,
    metavar="N",
    help="May be repeated.",
)
@click.option("--baud", type=int, default=1_000_000, show_default=True, help="Bits a second.")
@click.option("--rate", type=float, default=200.0, show_default=True, help="Questions a second.")
@click.option(
    "--mode", type=click.Choice(["current", "velocity", "position"]), help="What --play commands."
)
@click.option(
    "--zero",
    default="2048",
    show_default=True,
    metavar="COUNTS",
    help="Where q = 0; `here` is where it stands now.",
)
@click.option(
    "--form",
    type=click.Choice(["sync", "bulk", "fast"]),
    default="sync",
    show_default=True,
    help="Form of question.",
)
@_common
def dynamixel(port, ids, baud, rate, mode, zero, form, **options) -> int:
    """Dynamixel servos of the X series."""
    from jaxid.base.extras import required
    from jaxid.hardware import Dynamixel

    for package in ("serial", "dynamixel_sdk"):
        required(package)
    if options["play"] is not None and mode is None:
        raise UsageError(
            "say with --mode what the trajectory commands: current, velocity or position"
        )
    if zero != "here" and not zero.lstrip("-").isdigit():
        raise UsageError(f"--zero {zero}: write a number of counts, or here")
    return _record(
        Dynamixel(
            port,
            ids,
            baud=baud,
            rate=rate,
            mode=mode,
            zero=zero if zero == "here" else int(zero),
            form=form,
        ),
        **options,
    )


@record.command()
@click.argument("folder", type=click.Path(path_type=Path))
@output_options
def recover(folder, as_json, quiet) -> int:
    """Save a recording whose process was killed: FOLDER is its --out."""
    from jaxid.hardware import recover

    for recording in recover(folder):
        _show(recording, as_json, quiet)
    return SUCCESS


@contextmanager
def _watched(out: Path, model: str | None) -> Iterator[Callable[[], None]]:
    """While this is open, `jaxid watch` shows the recording: in a process of its own, which is
    there before anything moves and gives way to the recording. Gives what waits for Ctrl-C.
    """
    from jaxid.base.extras import required

    required("bokeh")
    required("tornado")
    words = [sys.executable, "-m", "jaxid", "watch", str(out)]
    if model is not None:
        words += ["--model", model]
    shown = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert shown.stdout is not None
    try:
        terminal.complain(shown.stdout.readline().strip() or "jaxid watch did not start")
        os.setpriority(os.PRIO_PROCESS, shown.pid, GIVES_WAY)
        yield lambda: _stays(shown)
    except UsageError:  # nothing was recorded, and the page has nothing to tidy up
        shown.kill()
        raise
    finally:
        shown.terminate()
        shown.wait()


def _stays(page: subprocess.Popen) -> None:
    """A page of a recording that has ended, until Ctrl-C."""
    terminal.complain("the page stays until Ctrl-C; `jaxid watch` shows it again")
    with suppress(KeyboardInterrupt):
        page.wait()


def _record(
    device, out, play, limits, sensors, as_json, quiet, gain, constants, watch, **options
) -> int:
    from jaxid.hardware import HardwareError, Limits, record, SensorSpec, Trajectory
    from jaxid.hardware.channels import joints_of

    if play is not None:
        named = joints_of(options["model"])
        play = Trajectory.read(play, device.joints, device.kinds[0], named)
    limits = None if limits is None else Limits.read(limits)
    specs = [SensorSpec.read(s) for s in sensors]
    # A batch system ends a job with SIGTERM, a lost connection with SIGHUP, and a shell has
    # background jobs ignore SIGINT: the device is let go in any case.
    before = {n: signal.signal(n, signal.default_int_handler) for n in {signal.SIGINT, *ending()}}
    recorded = play is None or options["live"]
    shown = _watched(out, options["model"]) if watch and recorded else nullcontext(None)
    code = SUCCESS
    try:
        with shown as stays:
            try:
                with terminal.Progress(quiet) as progress:
                    result = record(
                        device,
                        out,
                        play=play,
                        limits=limits,
                        sensors=specs,
                        gain=gain,
                        constants=constants,
                        progress=progress.callback,
                        **options,
                    )
                _show(result, as_json, quiet, getattr(device, "advice", []))
            except HardwareError as error:
                terminal.complain("; ".join([str(error), *getattr(error, "__notes__", [])]))
                code = FAILED
            if stays is not None:
                stays()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return code


def _show(recording, as_json: bool, quiet: bool, advice=()) -> None:
    if as_json:
        print(json.dumps(recording.to_dict(), indent=1))
    elif not quiet:
        terminal.say("\n".join([recording.text, *(f"- {a}" for a in advice)]))
