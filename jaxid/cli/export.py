"""`jaxid export` and `jaxid replay`: a result carried back into a simulator, and what that
simulator then says.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from jaxid.base.errors import FAILED, SUCCESS, UsageError
from jaxid.cli import terminal
from jaxid.cli.options import DATASET, OUT, output_options, start
from jaxid.cli.output import Output, writable_folder
from jaxid.dynamics.catalogue import TARGETS


@click.command()
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.json")
@click.option("--to", required=True, metavar="F", help=f"{', '.join(TARGETS)}.")
@click.option(
    "--robot",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The file to patch; default: the result's own.",
)
@click.option(
    "--ranges",
    is_flag=True,
    help="Also ranges for domain randomisation, by what the data leave open.",
)
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="The recording to try an MJCF's patch on.",
)
@OUT
@output_options
def export(result, to, robot, ranges, data, out, as_json, quiet) -> int:
    """Carry a diagnosis, a fit or an identification back into a simulator.

    Writes the patched file or the code, export.json (for each effect and number the field that
    carries it) and source.json into DIR; with --ranges also ranges.json. A patched MJCF is tried in
    MuJoCo on the recording, which is looked for beside the robot's file and the result. Exit code 1
    where nothing can be carried over.
    """
    content = read_result(result)
    from jaxid import runtime

    runtime.prepare()
    from jaxid.fitting.tried import recording_of
    from jaxid.report.carried_text import export_text
    from jaxid.robots.export.run import export as exported
    from jaxid.robots.export.save import save

    trial = (
        recording_of(content, result.parent, data)
        if to == "mjcf" and isinstance(content, Mapping)
        else None
    )
    found = exported(content, to, robot, ranges, result.parent, trial)
    writable_folder(out)
    save(found, out)
    if as_json:
        from jaxid.base.serialise import finite

        print(json.dumps(finite(found.to_list()), indent=1, allow_nan=False))
    elif not quiet:
        terminal.say(export_text(found, out))
    if found.carries:
        return SUCCESS
    if any(r.kept for r in found.rows):
        terminal.complain(
            f"nothing to carry into {to}: the data refute no number of the file"
            f" ({out / 'export.json'} has each)"
        )
    else:
        terminal.complain(
            f"nothing of this result can be carried into {to}: {out / 'export.json'} says why"
        )
    return FAILED


def read_result(path: Path) -> Any:
    """The content of a result's JSON. Raises `UsageError`."""
    from jaxid.base.small_files import read_small, TooLarge

    try:
        if not path.is_file():
            raise UsageError(f"{path}: no such file, or none that is plain")
        return json.loads(read_small(path).decode())
    except TooLarge as error:
        raise UsageError(f"{path}: {error}") from error
    except (ValueError, RecursionError) as error:
        if isinstance(error, UsageError):
            raise
        raise UsageError(
            f"{path}: not JSON ({str(error)[:100]}); give the JSON that jaxid fit, diagnose or"
            " identify wrote"
        ) from error


@click.command()
@DATASET
@click.option(
    "--robot",
    required=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="MJCF or URDF, patched or not.",
)
@click.option(
    "--against",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Compare with this file in place of jaxid.",
)
@OUT
@output_options
def replay(dataset, robot, against, out, as_json, quiet) -> int:
    """Run a robot's file in MuJoCo on a recording, and say how far off each joint is.

    Beside it stands jaxid's own free run: of the result that the file was exported from where
    `jaxid export` wrote it, else of the same file. Writes replay.json into DIR.
    """
    jaxid, data = start(dataset, out)
    from jaxid.report.carried_text import replay_text

    with Output(out, as_json, quiet) as output:
        return output.deliver(jaxid.replay(data, robot, against), replay_text)
