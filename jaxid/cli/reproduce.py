"""`jaxid reproduce`. Nothing heavy is imported before it runs."""

from __future__ import annotations

import click

from jaxid.cli.options import OUT, output_options
from jaxid.cli.output import Output, writable_folder


@click.command()
@click.argument("paper", type=click.Choice(("000", "001", "002", "003")))
@click.option(
    "--budget",
    type=click.Choice(("small", "full")),
    default="small",
    show_default=True,
    help="How much is computed.",
)
@OUT
@output_options
def reproduce(paper, budget, out, as_json, quiet) -> int:
    """Do one of the four papers again, whole.

    Its experiments on a twin written apart from the library; its claims and numbers beside ours,
    and what cannot be compared: 000 space manipulator, 001 payload of a UR10, 002 flexible link,
    003 target tracker. Writes result.json and report.html into DIR. The small budget takes minutes
    on two cores; what was finished when it is stopped lies in DIR/partial.
    """
    from jaxid import runtime

    runtime.prepare()
    writable_folder(out)
    from jaxid.study.papers import reproduce as run
    from jaxid.study.papers.page import lines

    with Output(out, as_json, quiet) as output:
        return output.deliver(run(paper, budget, output.progress), lines)
