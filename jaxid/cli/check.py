"""`jaxid check`: what a recording says about itself, before any effect is looked for."""

from __future__ import annotations

import json
from pathlib import Path

import click

from jaxid.base.errors import FAILED, SUCCESS
from jaxid.cli import terminal
from jaxid.cli.app import MODEL
from jaxid.cli.options import AS_RECORDED, DATASET, output_options, WITHOUT
from jaxid.cli.output import Output, writable_folder


@click.command()
@DATASET
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder for check.json and report.html.",
)
@MODEL
@WITHOUT
@AS_RECORDED
@output_options
def check(dataset, out, model, without, as_recorded, as_json, quiet) -> int:
    """Say what is wrong with a recording itself: signs, zeros, units, rows, clocks.

    Prints each finding with the line of dataset.toml that mends it; with --out also writes
    check.json and report.html into DIR. Exit code 1: the recording cannot be used as it is.
    """
    from jaxid import runtime

    runtime.prepare()
    from jaxid.base.serialise import finite
    from jaxid.conventions.checking import check_folder
    from jaxid.conventions.words import checked_text
    from jaxid.fitters.short_fit import free_motion, left_by_short_fit

    def work():
        return check_folder(
            model, dataset, without or (), as_recorded, left_by_short_fit, free_motion
        )

    if out is not None:
        writable_folder(out)
        with Output(out, as_json, quiet) as output:
            result = work()
            code = output.deliver(result, checked_text)
        return code or (SUCCESS if result.usable else FAILED)
    with terminal.Progress(quiet):
        result = work()
    if as_json:
        print(json.dumps(finite(result.to_dict()), indent=1, allow_nan=False))
    elif not quiet:
        terminal.say(checked_text(result))
    return SUCCESS if result.usable else FAILED
