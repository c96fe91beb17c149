"""`jaxid import`: recordings made by others as dataset folders."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import click

from jaxid.cli import terminal
from jaxid.cli.app import SUCCESS
from jaxid.cli.options import OUT, output_options
from jaxid.data.importers import IMPORTERS


#: Kinds that are read by a map of channels, whatever a file turns out to be.
TABLES = ("csv", "mat", "npz", "json", "torch", "tdms", "parquet", "lvm")
KINDS = (*IMPORTERS, *TABLES)
TABLE_OPTIONS = ("channels", "join", "rows", "rate", "separator", "decimal", "header", "first")
#: Options whose values have another name than the option.
SPELLED = {"channels": "channel", "ranges": "range"}


def interval(_ctx, _param, value: str | None) -> tuple[int, int] | None:
    """`FIRST:END`."""
    if value is None:
        return None
    first, _, end = value.partition(":")
    if not (first.isdigit() and end.isdigit() and int(first) < int(end)):
        raise click.BadParameter("write FIRST:END, samples from 0, END not included: 0:1600")
    return int(first), int(end)


def header_row(_ctx, _param, value: str | None) -> int | None:
    """A row from 1, or 0 for none."""
    if value is None or value == "none":
        return None if value is None else 0
    if not value.isdigit() or int(value) < 1:
        raise click.BadParameter("write the number of the row as an editor shows it, or none")
    return int(value)


def listed(_ctx, _param, value: str | None) -> tuple[str, ...]:
    """`A,B,…`."""
    return tuple(filter(None, (value or "").split(",")))


OVERWRITE = click.option(
    "--overwrite", is_flag=True, help="Replace a folder that has other content."
)
JOIN = click.option(
    "--join",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="FILE",
    help="Tables: another file whose columns are taken too; repeat it.",
)
RATE = click.option(
    "--rate",
    type=click.FloatRange(0, min_open=True),
    metavar="HZ",
    help="Tables without times: the sampling rate.",
)


HELP = f"""Convert a recording made by others.

KIND: {", ".join(TABLES)} (tables, by --channel), {", ".join(IMPORTERS)}. Several files of one
recording become one folder. What was recognised of a table is printed as the command that says it.
"""


@click.command("import", help=HELP)
@click.argument("kind", metavar="KIND")
@click.argument("files", type=click.Path(path_type=Path), metavar="FILE…", nargs=-1, required=True)
@OUT
@OVERWRITE
@click.option(
    "--channel",
    "channels",
    multiple=True,
    metavar="NAME=COLUMN:UNIT[:ROLE]",
    help=(
        "Tables: a channel, or t; repeat it. COLUMN: name, number, or pattern,"
        " 'q*=positions[*]:rad'."
    ),
)
@JOIN
@click.option(
    "--rows",
    callback=interval,
    metavar="FIRST:END",
    help="Tables: samples to take, chosen before anything is judged.",
)
@RATE
@click.option(
    "--separator", metavar="C", help="Text: what stands between columns; default: recognised."
)
@click.option(
    "--decimal", type=click.Choice((".", ",")), help="Text: the decimal sign; default: recognised."
)
@click.option(
    "--header",
    callback=header_row,
    metavar="ROW|none",
    help="Text: the row of the names; default: recognised.",
)
@click.option(
    "--first",
    type=click.IntRange(1),
    metavar="ROW",
    help="Text: the first row of data; default: recognised.",
)
@click.option("--topic", metavar="T", help="rosbag, mcap: the topic of the joint states.")
@click.option(
    "--command-topic",
    metavar="T[:position|velocity|effort]",
    help="rosbag, mcap: the topic of the goals.",
)
@click.option(
    "--command-joints",
    callback=listed,
    metavar="A,B,…",
    help="rosbag, mcap: the joints of a command without names, in its order.",
)
@click.option(
    "--unit",
    multiple=True,
    metavar="[NAME=]U",
    help="lerobot: the unit of states and actions; repeat it.",
)
@click.option(
    "--calibration",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="lerobot: what normalised values stand for.",
)
@click.option(
    "--range",
    "ranges",
    multiple=True,
    metavar="NAME=LO:HI",
    help="lerobot: a normalised joint's ends, in --unit.",
)
@output_options
def import_(kind, files, out, overwrite, as_json, quiet, **options) -> int:
    import jaxid
    from jaxid.base.errors import DatasetWarning, nearest

    if kind not in KINDS:
        raise jaxid.UsageError(f"unknown kind of recording {kind!r}{nearest(kind, KINDS)}")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", DatasetWarning)
        folder, command = _convert(kind, files, out, overwrite, options)
    for warning in said:
        if not quiet:
            terminal.complain(warning.message)
    data = jaxid.load_dataset(folder, check_model=False)
    if as_json:
        summary = {
            "schema": 1,
            "kind": "dataset",
            "name": data.name,
            "folder": str(folder),
            "channels": {c.name: c.unit for c in data.channels},
            "joints": dict(data.stated.joints),
            "experiments": [
                {"name": e.name, "split": e.split, "samples": len(e.t)} for e in data.experiments
            ],
            "command": command,
        }
        print(json.dumps(summary, indent=1))
    elif not quiet:
        runs = len(data.experiments)
        word = "run" if runs == 1 else "runs"
        terminal.say(f"{data.name}: {runs} {word} written to {folder}")
        if command:
            terminal.say(f"recognised, and said in full: {command}")
    return SUCCESS


def _convert(
    kind: str, files: Any, out: Path, overwrite: bool, options: dict[str, Any]
) -> tuple[Path, str]:
    """The folder, and the command that says what was recognised."""
    from jaxid.base.lazy import at

    given = {name: value for name, value in options.items() if value not in (None, ())}
    if kind in TABLES:
        _refuse_others(kind, given, TABLE_OPTIONS)
        return _convert_table(files, out, overwrite, options)
    importer = IMPORTERS[kind]
    _refuse_others(kind, given, importer.options)
    return at(importer.place)(files, out, overwrite=overwrite, **given), ""


def _refuse_others(kind: str, given: Iterable[str], allowed: Sequence[str]) -> None:
    from jaxid.base.errors import UsageError

    for name in given:
        if name not in allowed:
            said = SPELLED.get(name, name).replace("_", "-")
            raise UsageError(f"--{said} has no meaning for recordings of kind {kind!r}")


def _convert_table(
    files: Any, out: Path, overwrite: bool, options: dict[str, Any]
) -> tuple[Path, str]:
    from jaxid.data.importers.map import import_table
    from jaxid.data.importers.text import separator_of, StatedFormat

    stated = StatedFormat(
        separator_of(options["separator"]),
        options["decimal"],
        options["header"],
        options["first"],
    )
    chosen = {k: options[k] for k in ("channels", "join", "rows", "rate")}
    done = import_table(files, out, stated=stated, overwrite=overwrite, **chosen)
    return done.folder, done.command
