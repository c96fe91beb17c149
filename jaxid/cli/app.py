"""The command line. Nothing heavy is imported before a command runs: `jaxid --help` loads no
JAX.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from contextlib import AbstractContextManager, nullcontext, suppress
from keyword import iskeyword
from pathlib import Path

import click

from jaxid.base.errors import explain, FAILED, SUCCESS
from jaxid.base.stopping import INTERRUPTED, stoppable
from jaxid.cli import terminal
from jaxid.cli.model import MODEL as MODEL
from jaxid.cli.options import (
    AS_RECORDED,
    asked_posterior,
    CUTOFF,
    DATASET,
    effects_option,
    foretell,
    foretell_diagnosis,
    OUT,
    output_options,
    read_parameters,
    RESIDUAL,
    SECONDS,
    SEED,
    start,
    WITHOUT,
)
from jaxid.cli.output import Output
from jaxid.dynamics.catalogue import LOSSES


#: Commands that live in modules of their own, as light to import as this one: name -> module that
#: has it under that name.
MODULES = {
    "batch": "jaxid.cli.batch",
    "benchmark": "jaxid.cli.benchmark",
    "check": "jaxid.cli.check",
    "compare": "jaxid.cli.compare",
    "doctor": "jaxid.cli.doctor",
    "excite": "jaxid.cli.excite",
    "export": "jaxid.cli.export",
    "identify": "jaxid.cli.identify",
    "import": "jaxid.cli.importing",
    "new": "jaxid.cli.new",
    "record": "jaxid.cli.record",
    "reproduce": "jaxid.cli.reproduce",
    "emulate": "jaxid.cli.emulate",
    "replay": "jaxid.cli.export",
    "view": "jaxid.cli.view",
    "watch": "jaxid.cli.view",
}


class Commands(click.Group):
    """A group that answers an unknown command with the nearest one."""

    def resolve_command(self, ctx, args):
        from jaxid.base.errors import nearest

        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            ctx.fail(f"No such command {args[0]!r}{nearest(args[0], self.list_commands(ctx))}.")
        return super().resolve_command(ctx, args)


class AllCommands(Commands):
    """The commands of this module and those of `MODULES`, imported when they are asked for."""

    def list_commands(self, ctx):
        return sorted({*super().list_commands(ctx), *MODULES})

    def get_command(self, ctx, cmd_name):
        if cmd_name in MODULES:
            return getattr(
                importlib.import_module(MODULES[cmd_name]),
                f"{cmd_name}_" if iskeyword(cmd_name) else cmd_name,
            )
        return super().get_command(ctx, cmd_name)


@click.group(
    cls=AllCommands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(package_name="jaxid")
def cli() -> None:
    """Fits mechanical models to measured data and says where a simulator is wrong, which effect is
    missing, and how far the gap shrinks once it is added.

    Exit codes: 0 success, 1 a fit failed, 2 bad input, 130 interrupted (what was finished is
    saved).
    """


SOLVER = click.option(
    "--solver",
    metavar="own|diffrax:S",
    help="What simulates: jaxid's own stepping, or a solver of diffrax (diffrax:Tsit5).",
)


@cli.command()
@DATASET
@OUT
@MODEL
@click.option(
    "--fitter", metavar="F", help="Fitter (see `jaxid fitters`), also as 'de(popsize=20, F=0.5)'."
)
@effects_option("Effect to add; may be repeated.")
@WITHOUT
@RESIDUAL
@CUTOFF
@click.option("--loss", metavar="L", type=click.Choice(LOSSES), help=f"{', '.join(LOSSES)}.")
@SEED
@click.option("--budget", type=click.IntRange(1), metavar="N", help="Most evaluations of the loss.")
@click.option(
    "--window",
    type=click.IntRange(1),
    metavar="N",
    help="Fit along the data, the last N blocks at a time.",
)
@click.option(
    "--forgetting",
    type=click.FloatRange(0, 1, min_open=True),
    metavar="LAMBDA",
    help=(
        "Fit along the data block by block, what is known counting LAMBDA times as much each time;"
        " 1 forgets nothing."
    ),
)
@click.option(
    "--block",
    "block_s",
    type=click.FloatRange(0, min_open=True),
    metavar="S",
    help="Seconds of such a block.",
)
@click.option("--posterior", is_flag=True, help="Also draw from the posterior (NUTS).")
@click.option("--draws", type=click.IntRange(100), metavar="N", help="Of each of its four chains.")
@SOLVER
@AS_RECORDED
@output_options
def fit(
    dataset,
    out,
    model,
    fitter,
    effects,
    without,
    residual,
    cutoff,
    loss,
    seed,
    budget,
    window,
    forgetting,
    block_s,
    posterior,
    draws,
    solver,
    as_recorded,
    as_json,
    quiet,
) -> int:
    """Fit a model to a dataset.

    With --window or --forgetting along the data, at the same cost for every block. Writes fit.json
    and report.html into DIR; with --posterior also posterior.nc (for ArviZ) and posterior.png.
    """
    sampling = asked_posterior(posterior, draws)
    jaxid, data = start(dataset, out)
    foretell("fit", model, data, quiet)
    from jaxid.report.text import fit_text

    with Output(out, as_json, quiet) as output:
        result = jaxid.fit(
            model,
            data,
            fitter=fitter,
            residual=residual,
            cutoff_hz=cutoff,
            loss=loss,
            effects=effects,
            without=without or (),
            seed=seed,
            budget=budget,
            window=window,
            forgetting=forgetting,
            block_s=block_s,
            posterior=sampling,
            solver=solver,
            progress=output.progress,
            as_recorded=as_recorded,
        )
        code = output.deliver(result, fit_text)
    if result.failed:
        terminal.complain(f"the fit failed: {result.stopped_because}")
        return FAILED
    return code


@cli.command()
@DATASET
@OUT
@MODEL
@click.option(
    "--max-effects",
    type=click.IntRange(1, 20),
    default=3,
    show_default=True,
    help="Most effects to name.",
)
@effects_option("Candidates (see `jaxid effects`); default: all.")
@WITHOUT
@RESIDUAL
@CUTOFF
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    metavar="RESULT.json",
    help="A result of another recording: what differs?",
)
@SEED
@click.option(
    "--next",
    "next_",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Also design what to record next.",
)
@click.option(
    "--limits",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="TOML: of that run; default: what was recorded.",
)
@click.option(
    "--accuracy",
    metavar="SIZE",
    help='What is left within it is not missing: "1 mrad", or "q = 1 mrad, position = 0.1 mm".',
)
@SECONDS
@AS_RECORDED
@output_options
def diagnose(
    dataset,
    out,
    model,
    max_effects,
    effects,
    without,
    residual,
    cutoff,
    reference,
    seed,
    next_,
    limits,
    accuracy,
    seconds,
    as_recorded,
    as_json,
    quiet,
) -> int:
    """Say where a model is wrong, and which effect is missing.

    Also says how far the gap shrinks once it is added. Writes diagnosis.json and report.html into
    DIR. With --next, also the input that best tells the two leading hypotheses apart, as a folder
    that `jaxid record --play` takes.
    """
    from jaxid.data.limits import Limits

    own = None if limits is None else Limits.read(limits)
    jaxid, data = start(dataset, out)
    foretell_diagnosis(model, data, effects or None, without or (), residual, quiet)
    from jaxid.report.text import diagnosis_text

    with Output(out, as_json, quiet, seconds) as output:
        result = jaxid.diagnose(
            model,
            data,
            max_effects=max_effects,
            effects=effects or None,
            without=without or (),
            residual=residual,
            cutoff_hz=cutoff,
            reference=reference,
            seed=seed,
            progress=output.progress,
            as_recorded=as_recorded,
            seconds=seconds,
            accuracy=accuracy,
        )
        code = output.deliver(result, diagnosis_text)
    if next_ is not None:
        from jaxid.cli.excite import design_next

        design_next(result, next_, own, as_json or quiet)
    if result.final.failed:
        terminal.complain(f"the fit failed: {result.final.stopped_because}")
        return FAILED
    return code


@cli.command()
@DATASET
@click.option(
    "--parameters",
    "parameters",
    required=True,
    type=click.Path(path_type=Path),
    metavar="FIT.json",
    help="A fit, or a diagnosis with what it names.",
)
@OUT
@MODEL
@SOLVER
@output_options
def simulate(dataset, parameters, out, model, solver, as_json, quiet) -> int:
    """Run a model on a dataset's inputs.

    Writes run_1.parquet …, run_1.png … (poses of the mechanism over time) and simulation.json into
    DIR.
    """
    fitted = read_parameters(parameters)
    jaxid, data = start(dataset, out)
    from jaxid.report.text import simulation_text

    with Output(out, as_json, quiet) as output:
        return output.deliver(jaxid.simulate(model, data, fitted, solver=solver), simulation_text)


@cli.command()
@click.argument("name", required=False)
@output_options
def models(name, as_json, quiet) -> int:
    """List the models, or describe one."""
    return catalogue("models", name, as_json, quiet)


@cli.command()
@click.argument("name", required=False)
@click.option(
    "--model",
    metavar="M",
    help="Say which effects model M cannot tell apart, and which its parameters absorb.",
)
@output_options
def effects(name, model, as_json, quiet) -> int:
    """List the effects a model can lack, or describe one."""
    if model is None:
        return catalogue("effects", name, as_json, quiet)
    from jaxid import runtime

    runtime.prepare()
    from jaxid.diagnosis.equivalence import equivalences

    found = equivalences(model)
    if as_json:
        print(json.dumps(found.to_dict(), indent=1))
    elif not quiet:
        terminal.say(str(found))
    return SUCCESS


@cli.command()
@click.argument("name", required=False)
@output_options
def fitters(name, as_json, quiet) -> int:
    """List the fitters, or describe one."""
    return catalogue("fitters", name, as_json, quiet)


def catalogue(kind: str, name: str | None, as_json: bool, quiet: bool) -> int:
    from jaxid import runtime
    from jaxid.cli import listing

    runtime.prepare()
    found = listing.find(kind, name)
    if as_json:
        print(json.dumps(listing.to_dict(kind, name, found), indent=1))
    elif not quiet:
        terminal.say(
            listing.summary(kind, found) if name is None else listing.description(found[0])
        )
    return SUCCESS


#: Commands that end in their own way: a robot is brought to a stop, workers are told.
IN_THEIR_OWN_WAY = ("record", "emulate", "batch")


def run() -> None:
    """The command line as a process, which ends with it: threads that still compile are not waited
    for.
    """
    code = main()
    if code == INTERRUPTED and not set(sys.argv[1:2]) & set(IN_THEIR_OWN_WAY):
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)
    sys.exit(code)


def watched(arguments: list[str] | None) -> AbstractContextManager[None]:
    """Within it Ctrl-C ends the process in time, also where compiled code does not hear of it."""
    first = (sys.argv[1:] if arguments is None else arguments)[:1]
    return nullcontext() if set(first) & set(IN_THEIR_OWN_WAY) else stoppable(terminal.interrupted)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command line and returns the exit code."""
    terminal.begin()
    for stream in (sys.stdout, sys.stderr):
        # A terminal that cannot show `±` gets `?` instead of an error; streams replaced by others
        # stay as they are.
        if callable(reconfigure := getattr(stream, "reconfigure", None)):
            reconfigure(errors="replace")
    try:
        with terminal.warnings_said_once(), watched(arguments):
            code = cli.main(args=arguments, prog_name="jaxid", standalone_mode=False)
        sys.stdout.flush()
        return code or SUCCESS
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (KeyboardInterrupt, click.Abort):
        terminal.complain("interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # The reader went away (`jaxid effects | head`); keep Python from failing again when it
        # closes the stream.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except Exception as error:
        if os.environ.get("JAXID_TRACEBACK"):
            raise
        code, message = explain(error)
        terminal.complain(message)
        return code


if __name__ == "__main__":
    run()
