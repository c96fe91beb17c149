"""Options mean the same in every command, and stand where they make sense."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

from jaxid.cli.app import cli


#: Option -> commands that take it, at least.
EVERYWHERE = {
    "--model": ("check", "fit", "diagnose", "compare", "identify", "simulate"),
    "--without": ("check", "fit", "diagnose", "compare"),
    "--effect": ("fit", "diagnose", "compare"),
    "--effects": ("fit", "diagnose", "compare"),
    "--residual": ("fit", "diagnose", "compare"),
    "--cutoff": ("fit", "diagnose", "compare", "identify"),
    "--as-recorded": ("check", "fit", "diagnose", "compare", "identify"),
    "--seed": ("fit", "diagnose", "compare", "excite"),
    "--seconds": ("diagnose", "compare", "identify"),
}
#: Emulators and pages go on until they are stopped: they have no result.
WITHOUT_RESULT = ("emulate", "view", "watch")


def commands() -> dict[str, click.Command]:
    context = cli.make_context("jaxid", [], resilient_parsing=True)
    found: dict[str, click.Command] = {}
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            inside = {f"{name} {k}": command.get_command(context, k) for k in command.commands}
            found |= {k: c for k, c in inside.items() if c is not None}
        else:
            found[name] = command
    return found


def options(command: click.Command) -> dict[str, click.Option]:
    named = [p for p in command.params if isinstance(p, click.Option)]
    return {name: option for option in named for name in option.opts}


@pytest.mark.parametrize("flag", EVERYWHERE)
def test_an_option_stands_wherever_it_makes_sense(flag):
    known = commands()
    assert [name for name in EVERYWHERE[flag] if flag not in options(known[name])] == []


def test_every_result_can_be_json_and_every_command_quiet():
    for name, command in commands().items():
        if name.split()[0] not in WITHOUT_RESULT:
            assert {"--json", "--quiet"} <= set(options(command)), name


def test_an_option_takes_the_same_in_every_command():
    shared = ("--without", "--effect", "--residual", "--cutoff", "--as-recorded", "--seed")
    for flag in shared:
        kinds = set()
        for name in EVERYWHERE[flag]:
            if name == "identify" and flag == "--cutoff":
                continue  # it has a default of its own
            option = options(commands()[name])[flag]
            kinds.add((option.name, option.multiple, option.is_flag, str(option.type)))
        assert len(kinds) == 1, (flag, kinds)


@pytest.mark.parametrize(
    "words",
    [
        ["--effect", "dead_zone,input_delay"],
        ["--effects", "dead_zone, input_delay"],
        ["--effect", "dead_zone", "--effect", "input_delay"],
    ],
)
@pytest.mark.parametrize("name", EVERYWHERE["--effect"])
def test_effects_are_written_with_commas_or_one_by_one(name, words):
    context = commands()[name].make_context(name, ["data", "--out", "out", *words])
    assert context.params["effects"] == ("dead_zone", "input_delay")


def test_settings_of_an_effect_may_hold_commas():
    words = ["data", "--out", "out", "--effect", "a(x=1, y=2)@q1,b"]
    context = commands()["fit"].make_context("fit", words)
    assert context.params["effects"] == ("a(x=1, y=2)@q1", "b")


def test_the_table_for_contributors_names_every_option_that_is_shared():
    text = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text()
    for flag in ("--effect", "--as-recorded", "--cutoff", "--json", "--quiet"):
        assert f"`{flag}" in text, flag
