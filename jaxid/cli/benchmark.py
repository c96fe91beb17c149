"""`jaxid benchmark make` and `jaxid benchmark score`: the public yardstick."""

from __future__ import annotations

import json
from pathlib import Path

import click

from jaxid.base.errors import SUCCESS
from jaxid.cli import terminal
from jaxid.cli.app import Commands
from jaxid.cli.options import OUT, output_options


@click.group(cls=Commands)
def benchmark() -> None:
    """Make blind cases whose gaps are known, and score anybody's answers to them."""


@benchmark.command()
@click.option(
    "--set",
    "name",
    required=True,
    metavar="NAME",
    help="A set of cases, several with commas, or all.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**63 - 1),
    required=True,
    metavar="N",
    help="Keep it secret: it makes the key as well.",
)
@OUT
@click.option(
    "--cases", type=click.IntRange(1, 9999), metavar="N", help="How many of each set; default: all."
)
@click.option(
    "--workers", type=click.IntRange(1), metavar="N", help="Processes; default: one a core."
)
@output_options
def make(name, seed, out, cases, workers, as_json, quiet) -> int:
    """Write blind cases into DIR/cases, to be published, and their key into DIR/key.json.

    Sets: rigs, poor, pairs, outsiders, arms, robots, loose, contact, carts, conventions; all
    of these; papers.
    """
    from jaxid.benchmark.make import make as made

    with terminal.Progress(quiet):
        found = made(name, seed, out, cases, workers)
    if as_json:
        print(json.dumps(found.to_dict(), indent=1))
    elif not quiet:
        where = f"{found.folder / 'cases'}, the key beside them"
        terminal.say(f"{found.cases} cases in {where} (SHA-256 {found.key_sha256}).")
    return SUCCESS


@benchmark.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.argument("answers", metavar="ANSWERS", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder for score.json."
)
@output_options
def score(folder, answers, out, as_json, quiet) -> int:
    """Score a JSON of answers to the cases that `make` wrote into DIR.

    Prints class, place, size, where, how far and calibration with their intervals. Writes
    score.json beside the answers, or into the folder of --out.
    """
    from jaxid.base.atomic_files import replace_files
    from jaxid.base.serialise import finite
    from jaxid.benchmark.score import card_text, score as scored
    from jaxid.cli.output import writable_folder

    target = out or answers.parent
    writable_folder(target)
    found = scored(folder, answers)
    text = json.dumps(finite(found.to_dict()), indent=1, allow_nan=False)
    replace_files(target, {"score.json": (text + "\n").encode()})
    if as_json:
        print(text)
    elif not quiet:
        terminal.say(card_text(found))
    return SUCCESS
