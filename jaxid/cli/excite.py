"""`jaxid excite`: designs an experiment for a model, and writes it as a folder that `jaxid record
--play` takes.
"""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jaxid.cli import terminal
from jaxid.cli.app import SUCCESS
from jaxid.cli.options import OUT, output_options, SEED


if TYPE_CHECKING:
    from jaxid.data.limits import Limits
    from jaxid.diagnosis.result import Diagnosis
    from jaxid.excitation.result import Excitation


#: What a device is commanded by, and what its columns are called, in the order of preference.
PLAYED = {"current": "current", "position": "q", "velocity": "qd"}
#: Joints of a UR, which plays positions.
OF_A_UR = 6


def _numbers(_ctx, param, value: str | None) -> list[float] | None:
    try:
        return None if value is None else [float(v) for v in value.split(",")]
    except ValueError:
        raise click.BadParameter(
            f"{value!r} is not a number, or numbers with commas", param=param
        ) from None


@click.command()
@click.option(
    "--model",
    required=True,
    metavar="M",
    help="Model id (see `jaxid models`), a robot's file, or FILE.py[:CLASS].",
)
@OUT
@click.option(
    "--harmonics",
    type=click.IntRange(2, 50),
    default=8,
    show_default=True,
    metavar="N",
    help="Lines of the spectrum.",
)
@click.option(
    "--base-frequency",
    type=click.FloatRange(1e-3),
    metavar="HZ",
    help="Of the first line; default: 1 / duration.",
)
@click.option(
    "--duration",
    type=click.FloatRange(0.1),
    default=10.0,
    show_default=True,
    metavar="S",
    help="Whole periods.",
)
@click.option(
    "--rate",
    type=click.FloatRange(1.0),
    default=125.0,
    show_default=True,
    metavar="HZ",
    help="Samples a second.",
)
@click.option(
    "--limits",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="TOML, as for `jaxid record`: lower, upper, speed …",
)
@click.option(
    "--criterion",
    type=click.Choice(("condition", "d_optimal", "paper001")),
    help="Default: condition for arms, else d_optimal.",
)
@click.option(
    "--friction",
    type=click.Choice(("model", "linear", "power", "stribeck")),
    default="model",
    show_default=True,
    help="Arms: the friction law whose parts are to be told apart.",
)
@click.option(
    "--starts",
    type=click.IntRange(1, 1000),
    default=16,
    show_default=True,
    metavar="N",
    help="Searched together.",
)
@click.option(
    "--iterations",
    type=click.IntRange(1, 100_000),
    default=400,
    show_default=True,
    metavar="N",
    help="Arms: of descent.",
)
@click.option(
    "--floor",
    type=float,
    default=0.0,
    show_default=True,
    metavar="M",
    help="Arms: nothing goes below; -10 for no floor.",
)
@click.option(
    "--radius",
    type=click.FloatRange(0),
    default=0.06,
    show_default=True,
    metavar="M",
    help="Arms: half a link's width.",
)
@click.option(
    "--amplitude",
    callback=_numbers,
    metavar="X,…",
    help="Largest input, in its unit, for models that are not arms.",
)
@click.option(
    "--gain", callback=_numbers, metavar="K,…", help="N m/A: adds the currents to command."
)
@click.option(
    "--parameters",
    type=click.Path(path_type=Path),
    metavar="FIT.json",
    help="What is known of the machine.",
)
@SEED
@output_options
def excite(
    model,
    out,
    harmonics,
    base_frequency,
    duration,
    rate,
    limits,
    criterion,
    friction,
    starts,
    iterations,
    floor,
    radius,
    amplitude,
    gain,
    parameters,
    seed,
    as_json,
    quiet,
) -> int:
    """Design an experiment: the motion or the input that shows most of a model.

    Arms get a periodic motion within their limits, at rest at both ends; all other models an input.
    Writes a dataset folder for `jaxid record --play`, excitation.json, trajectory.csv and a plot;
    for a UR also what it plays.
    """
    from jaxid import runtime
    from jaxid.cli.options import read_parameters

    runtime.prepare()
    from jaxid.base.errors import NotSaved
    from jaxid.base.serialise import finite
    from jaxid.data.limits import Limits
    from jaxid.excitation.design import excite

    known = None if parameters is None else read_parameters(parameters)
    own = None if limits is None else Limits.read(limits)
    with terminal.Progress(quiet) as progress:
        made = excite(
            model,
            harmonics=harmonics,
            base_frequency_hz=base_frequency,
            duration_s=duration,
            rate_hz=rate,
            limits=own,
            criterion=criterion,
            friction=friction,
            starts=starts,
            iterations=iterations,
            seed=seed,
            floor=floor,
            radius=radius,
            amplitude=amplitude,
            gain=gain,
            parameters=known,
            progress=progress.callback,
        )
    unsaved = None
    try:
        made.save(out)
    except NotSaved as error:
        unsaved = error
    if as_json:
        print(json.dumps(finite(made.to_dict()), indent=1, allow_nan=False))
    elif unsaved or not quiet:
        terminal.say(excitation_text(made, out if unsaved is None else None))
    if unsaved:
        raise unsaved
    return SUCCESS


def excitation_text(made: Excitation, out: Path | None) -> str:
    """The design as tables for a terminal; `out` is where it was written."""
    from jaxid.base.wording import table

    c = made.content
    head = (
        f"{c['model']}: {c['kind_of_excitation']} of {c['duration_s']:g} s, condition number"
        f" {c['condition_number']:.4g}"
    )
    head += f" ({c['condition_number_scaled']:.4g} with columns of equal length)"
    rows = []
    for e in made.limits:
        reached = (
            f"{e['lowest']:.3g} … {e['highest']:.3g}" if "lowest" in e else f"{e['highest']:.3g}"
        )
        limit = (
            f"{e['lower']:.3g} … {e['upper']:.3g}"
            if "lower" in e
            else f"{e['limit']:.3g}"
            if "limit" in e
            else ""
        )
        rows.append(
            (
                e["joint"],
                e["quantity"],
                reached,
                limit,
                e["unit"],
                f"{100 * e['share']:.0f} %" if "share" in e else "",
            )
        )
    parts = [
        head,
        table(("", "quantity", "reached", "limit", "unit", "used"), rows),
        f"limits: {c['limits_from']}",
    ]
    clear = c.get("clearance")
    if clear:
        parts.append(
            f"links stay {clear['links_m']:.3f} m apart and {clear['height_m']:.3f} m above the"
            " base's plane"
        )
    parts += [f"note: {n}" for n in c["notes"]]
    if out is not None:
        parts.append(f"written to {out}; {how_to_play(made, out)}")
    return "\n".join(parts)


def how_to_play(made: Excitation, out: Path) -> str:
    """What plays the path of a design that was written to a folder: the command of a device that
    takes its columns, whose own words are in capitals. It records what the model of the design
    needs.
    """
    played = _mode_and_joints(made)
    if played is None and "tau" in made.commands:
        return "a servo plays it as currents: give --gain, the torque per ampere of its drive"
    if played is None:
        return "no device of jaxid record has joints of these names: play trajectory.csv yourself"
    mode, joints = played
    words = ["ur10", "--host", "HOST"]
    if mode != "position" or joints != OF_A_UR:
        words = ["dynamixel", "--port", "PORT"]
        for number in range(1, joints + 1):
            words += ["--id", str(number)]
        words += ["--mode", mode]
    words += ["--play", str(out), *_meant_for(made, out), "--out", f"{out}_run"]
    return f"play it with: jaxid record {shlex.join(words)}"


def _mode_and_joints(made: Excitation) -> tuple[str, int] | None:
    """By what a device is commanded to play a design, and how many joints it has; None where none
    of its kinds of command is there.
    """
    for mode, stem in PLAYED.items():
        wanted = re.compile(rf"{stem}\d*_cmd")
        joints = sum(bool(wanted.fullmatch(name)) for name in made.commands)
        if joints:
            return mode, joints
    inputs = made.dataset.inputs
    turned = all(channel.unit == "rad" for channel in inputs)
    return ("position", len(inputs)) if turned and _robot_of(made) else None


def _robot_of(made: Excitation) -> str:
    """The name of the robot's file that a design is for; nothing for another model."""
    geometry = getattr(made.dataset.model, "geometry", None)
    return "" if geometry is None else geometry.file


def _meant_for(made: Excitation, out: Path) -> list[str]:
    """The options of a recording that give the channels of the model of a design; none where that
    takes torques which the design does not play.
    """
    gains, model = made.content.get("gains"), made.dataset.model
    inputs = {channel.name for channel in made.dataset.inputs}
    if model is None or gains is None and not inputs <= set(made.commands):
        return []
    robot = _robot_of(made)
    words = ["--model", str(out / robot) if robot else model.file or str(model.name)]
    return words if gains is None else [*words, "--gain", ",".join(f"{k:g}" for k in gains)]


def design_next(diagnosis: Diagnosis, out: Path, limits: Limits | None, silent: bool) -> None:
    """Writes the run that tells the two leading hypotheses apart; a diagnosis without such a run
    stands as it is.
    """
    from jaxid.base.errors import UsageError

    try:
        made = diagnosis.next_run(limits=limits)
        made.save(out)
    except UsageError as error:
        terminal.complain(f"--next: {error}")
        return
    if not silent:
        terminal.say(f"{made.content['notes'][-1]}\nwritten to {out}; {how_to_play(made, out)}")
