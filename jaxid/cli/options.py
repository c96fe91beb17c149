"""Options that commands share, and how they begin."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from jaxid.base.numbers import is_finite
from jaxid.cli import terminal
from jaxid.cli.output import writable_folder
from jaxid.dynamics.catalogue import RESIDUALS


def names(_ctx, _param, value: str | None) -> tuple[str, ...] | None:
    """A list written with commas, of which those in brackets belong to a name."""
    from jaxid.fitting.settings import split_outside_brackets

    if value is None:
        return None
    return split_outside_brackets(value)


def names_of_all(_ctx, _param, values: tuple[str, ...]) -> tuple[str, ...]:
    """The names of an option that may be repeated, each time one or several with commas."""
    from jaxid.fitting.settings import split_outside_brackets

    found: list[str] = []
    for value in values:
        found += split_outside_brackets(value)
    return tuple(found)


def output_options(command: Callable) -> Callable:
    command = click.option("--quiet", is_flag=True, help="Print nothing but errors.")(command)
    return click.option(
        "--json", "as_json", is_flag=True, help="Print the result as JSON and nothing else."
    )(command)


DATASET = click.argument("dataset", type=click.Path())


OUT = click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder for results.",
)


def effects_option(meaning: str) -> Callable:
    """`--effect E,… --effect E`: the same way of writing effects in every command."""
    return click.option(
        "--effect",
        "--effects",
        "effects",
        multiple=True,
        callback=names_of_all,
        metavar="E[@LOCATION],…",
        help=meaning,
    )


WITHOUT = click.option(
    "--without",
    callback=names,
    metavar="E,…",
    help="Built-in effects to leave out; each becomes a candidate.",
)


RESIDUAL = click.option(
    "--residual", metavar="R", type=click.Choice(RESIDUALS), help=f"{', '.join(RESIDUALS)}."
)


CUTOFF = click.option(
    "--cutoff",
    type=click.FloatRange(0, min_open=True),
    metavar="HZ",
    help="Low-pass of inverse_dynamics; default: from the motion.",
)


AS_RECORDED = click.option(
    "--as-recorded", is_flag=True, help="Take the data as they are: apply no finding of the check."
)


SECONDS = click.option(
    "--seconds",
    type=click.FloatRange(min=0, min_open=True),
    metavar="S",
    help="The best answer there is by then.",
)


SEED = click.option(
    "--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Random seed."
)


def asked_posterior(posterior: bool, draws: int | None) -> Any:
    """What is to be drawn beside a fit, False for nothing. Raises `UsageError` where an extra is
    missing.
    """
    from jaxid.base.errors import UsageError
    from jaxid.base.extras import required

    if not posterior:
        if draws is not None:
            raise UsageError("--draws belongs to --posterior")
        return False
    required("blackjax")
    required("arviz")
    from jaxid import runtime

    runtime.prepare()
    from jaxid.fitting.nuts import Sampling

    return Sampling() if draws is None else Sampling(draws=draws)


def start(dataset: str, out: Path) -> tuple[Any, Any]:
    """Loads the dataset, then makes sure that results can be written, before any long work."""
    from jaxid import runtime

    runtime.prepare()
    import jaxid

    data = jaxid.load_dataset(dataset)
    writable_folder(out)
    return jaxid, data


def foretell(work: str, model: str | None, data: Any, quiet: bool) -> None:
    """Says on standard error what a long fit or identification will take."""
    from jaxid.problem.binding import foreseen

    if not quiet and (wanted := foreseen(work, model, data)).large:
        terminal.complain(wanted)


def foretell_diagnosis(
    model: str | None,
    data: Any,
    effects: Sequence[str] | None,
    without: Sequence[str],
    residual: str | None,
    quiet: bool,
) -> None:
    """Says on standard error what a long diagnosis will take."""
    from jaxid.diagnosis.foreseen import foreseen

    if not quiet and (wanted := foreseen(model, data, effects, without, residual)).large:
        terminal.complain(wanted)


def read_parameters(path: Path) -> dict[str, Any]:
    """The content of a FIT.json; only `parameters` is needed."""
    from jaxid.base.errors import UsageError

    wanted = 'it needs {"parameters": {"inertia": {"value": 0.08}}, "effects": []}'
    content = _json_of(path, wanted)
    if not isinstance(content, dict) or not isinstance(content.get("parameters"), dict):
        raise UsageError(f"--parameters {path}: no object `parameters` in it; {wanted}")
    groups = [("parameters", content["parameters"])]
    effects = content.get("effects", [])
    if not isinstance(effects, list):
        raise UsageError(f"--parameters {path}: `effects` is not a list; {wanted}")
    for i, effect in enumerate(effects):
        inside = effect.get("parameters", {}) if isinstance(effect, dict) else None
        if not isinstance(inside, dict) or not isinstance(effect.get("effect"), str):
            raise UsageError(
                f"--parameters {path}: effects[{i}] needs an `effect`, a `location` and"
                " `parameters`"
            )
        groups.append((f"effects[{i}].parameters", inside))
    for group, parameters in groups:
        for name, entry in parameters.items():
            if not _states_number(entry):
                raise UsageError(
                    f'--parameters {path}: {group}.{name} needs a finite number, as in {{"value":'
                    " 0.08}"
                )
    return content


def _json_of(path: Path, wanted: str) -> Any:
    from jaxid.base.errors import UsageError
    from jaxid.base.serialise import with_effects
    from jaxid.base.small_files import read_small, TooLarge

    try:
        return with_effects(json.loads(read_small(path).decode()))
    except TooLarge as error:
        raise UsageError(f"--parameters {path}: {error}; {wanted}") from error
    except OSError as error:
        raise UsageError(f"--parameters {path}: cannot be read ({error.strerror})") from error
    except json.JSONDecodeError as error:
        raise UsageError(
            f"--parameters {path}: not JSON, line {error.lineno} column {error.colno}: {error.msg};"
            f" {wanted}"
        ) from error
    except UsageError:
        raise
    except (ValueError, RecursionError) as error:
        raise UsageError(f"--parameters {path}: not JSON text; {wanted}") from error


def _states_number(entry: Any) -> bool:
    """Whether an entry's `value` is a finite number."""
    value = entry.get("value") if isinstance(entry, dict) else None
    return is_finite(value)
