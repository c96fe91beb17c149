"""`jaxid doctor`: whether jaxid works on this computer."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from jaxid.base.errors import FAILED, SUCCESS
from jaxid.base.wording import table
from jaxid.cli import terminal
from jaxid.cli.options import output_options


if TYPE_CHECKING:
    from jaxid.cli.self_test import Health


@click.command()
@output_options
def doctor(as_json, quiet) -> int:
    """Say whether jaxid works on this computer: versions, cores, cache, extras, a self test.

    The self test compiles, which takes about a minute the first time. Nothing is written but the
    cache of programs. Exit code 1: something that was tried went wrong.
    """
    from jaxid import runtime

    runtime.prepare()
    from jaxid.cli.self_test import examine

    with terminal.Progress(quiet):
        health = examine()
    if as_json:
        print(json.dumps(health.to_dict(), indent=1))
    elif not quiet:
        terminal.say(text(health))
    return SUCCESS if health.well else FAILED


def text(health: Health) -> str:
    """The findings as a table, then the self test and what to type where something is missing."""
    packages = ", ".join(f"{name} {version}" for name, version in health.packages.items())
    rows = [
        ("Python", health.python),
        ("system", health.system),
        ("packages", packages),
        ("cores", str(health.cores)),
        ("memory", _size(health.memory_bytes)),
        ("devices", ", ".join(health.devices)),
        ("cache", _cache(health)),
        *((f"extra {name}", _extra(name, there)) for name, there in health.extras.items()),
    ]
    tests = [(_outcome(test.passed), test.name, test.seen) for test in health.tests]
    verdict = "All is well." if health.well else "Something went wrong: see the lines above."
    return "\n".join(
        [table(("what", "found"), rows), "", table(("", "self test", "seen"), tests), "", verdict]
    )


def _outcome(passed: bool) -> str:
    if passed:
        return "ok"
    return "WRONG"


def _size(size: int | None) -> str:
    if size is None:
        return "not told by this system"
    if size < 1e9:
        return f"{size / 1e6:.0f} MB"
    return f"{size / 1e9:.1f} GB"


def _cache(health: Health) -> str:
    if health.cache is None:
        return "none can be written: every command compiles anew; set JAXID_CACHE_DIR to a folder"
    return f"{health.cache}, {_size(health.cache_bytes)}"


def _extra(name: str, there: bool) -> str:
    if there:
        return "installed"
    return f'missing; type: pip install "jaxid[{name}]"'
