"""`jaxid view`, `jaxid watch`: pages on the loopback. Nothing heavy is imported before they run."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from typing import Any

import click

from jaxid.base.extras import required
from jaxid.cli import terminal
from jaxid.cli.app import MODEL, SUCCESS


PORT = click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    metavar="N",
    help="On the loopback; default: any that is free.",
)
OPEN = click.option(
    "--open/--no-open", "open_", default=True, show_default=True, help="Open the browser."
)


@click.command()
@click.argument("results", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option(
    "--dataset",
    type=click.Path(),
    metavar="DATASET",
    help="The recording that free runs are drawn on; default: that of the first result.",
)
@MODEL
@PORT
@OPEN
def view(results, dataset, model, port, open_) -> int:
    """Show results side by side in the browser.

    RESULTS are folders of fits or diagnoses. Runs lie over each other, zoom and cursor go together,
    and effects are switched off and on: the free run is then drawn anew. Prints the address, which
    only this computer reaches and only with its token. Ctrl-C ends it.
    """
    required("bokeh")
    required("tornado")
    from jaxid import runtime

    runtime.prepare()
    import jaxid
    from jaxid.view.compare import results_site
    from jaxid.view.results import read_results, recording_of, Viewer

    saved = read_results(results)
    data = jaxid.load_dataset(dataset) if dataset else recording_of(results, saved)
    viewer = Viewer(saved, data, model)
    return _served(results_site(viewer), port, open_)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@MODEL
@click.option(
    "--known",
    type=click.FloatRange(0, 1, min_open=True),
    default=0.1,
    show_default=True,
    metavar="SHARE",
    help="A number is known when its standard deviation is at most this share of it, or of the largest"
    " number in its unit.",
)
@PORT
@OPEN
def watch(folder, model, known, port, open_) -> int:
    """Show a recording while it is made.

    FOLDER is the --out of `jaxid record`. Shows the channels, how far they moved, what `jaxid
    check` finds, which numbers are known by now, and says when it is enough. Of a recording
    that has ended it shows the last run. Ctrl-C ends it, and nothing of the recording.
    """
    required("bokeh")
    required("tornado")
    from jaxid import runtime

    runtime.prepare()
    from jaxid.view.recording import watch_site, Watcher

    watcher = Watcher(folder, model, known)
    watcher.begin()
    try:
        return _served(watch_site(watcher), port, open_)
    finally:
        watcher.stop()


def _served(site: Any, port: int, open_: bool) -> int:
    from jaxid.view.server import run

    def ready(address: str) -> None:
        terminal.say(address)
        sys.stdout.flush()
        if open_:
            webbrowser.open(address)

    try:
        run(site, port, ready)
    except KeyboardInterrupt:
        pass
    return SUCCESS
