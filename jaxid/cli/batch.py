"""`jaxid batch`. Nothing heavy is imported before it runs."""

from __future__ import annotations

import json
import sys
import time

import click

from jaxid.base import wording
from jaxid.base.progress import RedrawnLines
from jaxid.cli import terminal
from jaxid.cli.app import FAILED, INTERRUPTED, SUCCESS
from jaxid.cli.options import output_options


@click.command()
@click.argument("study", type=click.Path())
@click.option(
    "--workers",
    type=click.IntRange(1, 4096),
    metavar="N",
    help="Processes on this computer; default: one a core. slurm: jobs.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Run on the dask cluster of this scheduler, as in tcp://10.0.0.1:8786.",
)
@click.option(
    "--cluster",
    type=click.Choice(["local", "slurm"]),
    help="Start workers: here (the default), or by SLURM's sbatch.",
)
@click.option(
    "--interface",
    metavar="NAME",
    help="slurm: the network between the nodes, as in ib0; all goes by TLS.",
)
@click.option(
    "--status", is_flag=True, help="Only say how far the study is, also while it runs elsewhere."
)
@click.option(
    "--retry", is_flag=True, help="Run tasks again that failed, crashed or took too long."
)
@output_options
def batch(study, workers, scheduler, cluster, interface, status, retry, as_json, quiet) -> int:
    """Run many fits or diagnoses: every combination that STUDY.toml lists.

    Writes study.sqlite, and at the end runs.parquet, runs.csv and report.html, into the study's
    `store`. Started again, it goes on where it stopped and runs only what changed.
    """
    if status:
        return tell_status(study, as_json, quiet)
    from jaxid import runtime

    runtime.prepare()
    from jaxid.study.coordinator import StudyFailed
    from jaxid.study.run import run_study, summary

    with LiveTable(quiet) as table:
        try:
            place = {
                "workers": workers,
                "scheduler": scheduler,
                "cluster": cluster,
                "interface": interface,
            }
            result = run_study(study, **place, retry=retry, heard=table.show)
        except StudyFailed as error:
            terminal.complain(str(error))
            return FAILED
    for note in result.notes:
        terminal.complain(note)
    s = result.status
    if as_json:
        print(json.dumps(summary(result), indent=1, allow_nan=False))
    elif result.unsaved or not quiet:
        from jaxid.study import words

        terminal.say(words.result_text(result))
    if result.interrupted:
        terminal.complain(
            f"interrupted; {s.done + s.failed} of {s.total} tasks are saved, the same command goes"
            " on from there"
        )
        return INTERRUPTED
    if result.unsaved:
        terminal.complain(result.unsaved)
        return FAILED
    if s.failed:
        terminal.complain(
            f"{s.failed} of {s.total} tasks failed; {result.study.store / 'report.html'} says why,"
            " --retry runs them again"
        )
        return FAILED
    return SUCCESS


def tell_status(study: str, as_json: bool, quiet: bool) -> int:
    from jaxid.study.run import study_status
    from jaxid.study.words import status_text

    read, outcomes, status = study_status(study)
    if as_json:
        print(json.dumps(status.to_dict()))
    elif not quiet:
        terminal.say(status_text(read, outcomes, status))
    return SUCCESS


class LiveTable:
    """A live table on standard error while a study runs; nothing at all where that is no
    terminal.
    """

    def __init__(self, quiet: bool):
        self.on = not quiet and sys.stderr.isatty()
        self._drawn = 0.0
        self._table = RedrawnLines()

    def __enter__(self) -> LiveTable:
        return self

    def __exit__(self, *exception) -> None:
        if self.on:
            self._table.stop()

    def show(self, progress) -> None:
        if self.on and time.monotonic() - self._drawn > 0.5:
            from jaxid.study.words import progress_text

            self._drawn = time.monotonic()
            self._table.show(wording.clean(progress_text(progress)))
