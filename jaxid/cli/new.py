"""`jaxid new`: a dataset folder from the files of a recording, with what is recognised."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TYPE_CHECKING

import click

from jaxid.base.errors import SUCCESS
from jaxid.base.wording import names_of
from jaxid.cli import terminal
from jaxid.cli.importing import JOIN, OVERWRITE, RATE
from jaxid.cli.options import output_options


if TYPE_CHECKING:
    from jaxid.data.dataset import Dataset, Geometry
    from jaxid.data.importers.channels import Proposed
    from jaxid.data.importers.map import Imported
    from jaxid.problem.proposed_model import ProposedModel


def pairs(_ctx, _param, values: tuple[str, ...]) -> dict[str, str]:
    """`NAME=WORD`, repeated."""
    found = {}
    for value in values:
        name, equals, word = value.rpartition("=")
        if not equals or not name or not word:
            raise click.BadParameter(f"{value!r} is not of the form NAME=…")
        found[name] = word
    return found


@click.command("new")
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
@click.argument("files", type=click.Path(path_type=Path), metavar="FILE…", nargs=-1, required=True)
@click.option("--model", metavar="M", help="The model; default: proposed by channels and units.")
@click.option(
    "--unit",
    "units",
    multiple=True,
    callback=pairs,
    metavar="NAME=U",
    help="Unit of a channel; repeat it. What is not stated is asked, on a terminal.",
)
@click.option(
    "--role",
    "roles",
    multiple=True,
    callback=pairs,
    metavar="NAME=input|output|auxiliary",
    help="Role of a channel; default: by its name; repeat it.",
)
@JOIN
@RATE
@OVERWRITE
@output_options
def new(folder, files, model, units, roles, join, rate, overwrite, as_json, quiet) -> int:
    """Make a dataset folder from the files of a recording.

    Time, channels, units and roles are recognised, and a model is proposed; what no file states is
    asked, or taken from options. Writes DIR/dataset.toml and the runs beside it.
    """
    import jaxid
    from jaxid.base.errors import DatasetWarning
    from jaxid.data.importers.new_dataset import new_dataset
    from jaxid.problem.proposed_model import proposed_models
    from jaxid.robots.match import is_file, joints_that_move, spec_of_file

    robot = spec_of_file(model).geometry if is_file(model) else None
    asking = sys.stdin.isatty() and not (as_json or quiet)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", DatasetWarning)
        done = new_dataset(
            files,
            folder,
            join=join,
            rate=rate,
            units=units,
            roles=roles,
            joints=None if robot is None else joints_that_move(model),
            ask=asked_unit if asking else None,
            overwrite=overwrite,
        )
    for warning in said:
        if not quiet:
            terminal.complain(warning.message)
    data = jaxid.load_dataset(done.folder, check_model=False)
    proposed = [p for p in proposed_models(data) if not p.renamed]
    if model is None and proposed:
        model = chosen(proposed, asking)
    named = write_model(done.folder, model, robot)
    if as_json:
        print(json.dumps(content(done, data, model, proposed), indent=1))
    elif not quiet:
        terminal.say(text(done.folder, data, model, named, proposed))
    return SUCCESS


def content(
    done: Imported, data: Dataset, model: str | None, proposed: Sequence[ProposedModel]
) -> dict[str, Any]:
    """The JSON of what was made."""
    from jaxid.base.serialise import SCHEMA

    return {
        "schema": SCHEMA,
        "kind": "new",
        "folder": str(done.folder),
        "channels": {c.name: {"role": c.role, "unit": c.unit} for c in data.channels},
        "experiments": names_of(data.experiments),
        "model": model,
        "models": names_of(proposed),
        "command": done.command,
    }


def asked_unit(channel: Proposed) -> str:
    """The unit that a person types."""
    from jaxid.data.units import conversion, UnitError

    while True:
        typed = click.prompt(f"unit of {channel.column} ({channel.role})", type=str)
        try:
            conversion(typed)
        except UnitError as error:
            terminal.complain(error)
            continue
        return typed


def chosen(proposed: Sequence[ProposedModel], asking: bool) -> str | None:
    """The model, where there is one, or a person says which."""
    if len(proposed) == 1:
        return proposed[0].name
    if not asking:
        return None
    for model in proposed:
        terminal.say(str(model))
    return click.prompt("model", type=click.Choice(names_of(proposed)))


def write_model(folder: Path, model: str | None, robot: Geometry | None) -> bool:
    """Names the model in a `dataset.toml`, a robot's file as its copy in the folder. False where
    there is none, or one of the user's own, which stays where it is.
    """
    import tomlkit

    from jaxid.data.write import written_robot
    from jaxid.dynamics.catalogue import model_names

    if robot is not None:
        entry = {"robot": written_robot(robot, folder)}
    elif model in model_names():
        entry = {"name": model}
    else:
        return False
    path = folder / "dataset.toml"
    content = tomlkit.parse(path.read_text(encoding="utf-8"))
    content["model"] = entry
    path.write_text(tomlkit.dumps(content), encoding="utf-8")
    return True


def text(
    folder: Path,
    data: Dataset,
    model: str | None,
    named: bool,
    proposed: Sequence[ProposedModel],
) -> str:
    """What was made, and what to type next; `named`: the folder names the model."""
    lines = [f"{folder / 'dataset.toml'} names:"]
    for channel in data.channels:
        lines.append(f"  {channel.name}: {channel.role}, {channel.unit}")
    runs = ", ".join(f"{e.name} ({len(e.t)} samples)" for e in data.experiments)
    lines.append(f"  runs: {runs}")
    option = ""
    if model is not None:
        lines.append(f"  model: {model}")
        lines.append("Look it over, state the noise of the sensors where you know it, and type:")
        if not named:
            option = f" --model {model}"
    elif proposed:
        lines.append(f"The model may be {' or '.join(map(str, proposed))}. Type:")
        option = f" --model {proposed[0].name}"
    else:
        lines.append("No built-in model has these channels: give your robot's file. Type:")
        option = " --model robot.xml"
    lines.append(f"jaxid diagnose {folder}{option} --out out")
    return "\n".join(lines)
