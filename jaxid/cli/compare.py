"""`jaxid compare`. Nothing heavy is imported before it runs."""

from __future__ import annotations

import click

from jaxid.cli import terminal
from jaxid.cli.app import FAILED, MODEL
from jaxid.cli.options import (
    AS_RECORDED,
    CUTOFF,
    DATASET,
    effects_option,
    names,
    OUT,
    output_options,
    RESIDUAL,
    SEED,
    start,
    WITHOUT,
)
from jaxid.cli.output import Output
from jaxid.dynamics.catalogue import LOSSES


@click.command()
@DATASET
@OUT
@MODEL
@click.option(
    "--fitters",
    callback=names,
    metavar="F,…",
    help="Fitters, also as 'de(CR=0.8)'; default: lm,hybrid,de,rde,pso,ga.",
)
@click.option(
    "--seeds", type=click.IntRange(1), default=10, show_default=True, help="Runs of each fitter."
)
@click.option(
    "--budget",
    type=click.IntRange(1),
    metavar="N",
    help="Most evaluations of a run; default: 10000.",
)
@click.option(
    "--seconds",
    type=click.FloatRange(0, min_open=True),
    metavar="S",
    help="Most seconds of a run, compiling left out.",
)
@effects_option("Effect to add; may be repeated.")
@WITHOUT
@RESIDUAL
@CUTOFF
@click.option("--loss", metavar="L", type=click.Choice(LOSSES), help=f"{', '.join(LOSSES)}.")
@click.option(
    "--starts",
    type=click.Choice(("random", "guess")),
    default="random",
    show_default=True,
    help="Where runs start.",
)
@click.option(
    "--tolerance",
    type=float,
    default=1e-3,
    show_default=True,
    help="A run within this share of the best loss counts.",
)
@SEED
@AS_RECORDED
@output_options
def compare(
    dataset,
    out,
    model,
    fitters,
    seeds,
    budget,
    seconds,
    effects,
    without,
    residual,
    cutoff,
    loss,
    starts,
    tolerance,
    seed,
    as_recorded,
    as_json,
    quiet,
) -> int:
    """Compare fitters on the same loss.

    Success rate, evaluations and time to the best known loss; every fitter runs with every seed,
    from the same starts. Writes comparison.json, runs.parquet and report.html into DIR; when it is
    stopped, those of the runs that were finished into DIR/partial.
    """
    jaxid, data = start(dataset, out)
    from jaxid.report.comparison_text import comparison_text

    with Output(out, as_json, quiet) as output:
        result = jaxid.compare(
            model,
            data,
            fitters=fitters,
            seeds=seeds,
            budget=budget,
            seconds=seconds,
            effects=effects,
            without=without or (),
            residual=residual,
            cutoff_hz=cutoff,
            loss=loss,
            starts=starts,
            tolerance=tolerance,
            seed=seed,
            progress=output.progress,
            as_recorded=as_recorded,
        )
        code = output.deliver(result, comparison_text)
    if all(run.status == "failed" for run in result.runs):
        terminal.complain("every run failed; the model diverges within these bounds")
        return FAILED
    return code
