"""What commands write to a terminal: text without control characters, errors, progress."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress

from jaxid.wording import clean, one_line


def say(text: object) -> None:
    print(clean(text))


def complain(text: object) -> None:
    with suppress(OSError):  # the terminal is gone
        print(f"jaxid: {clean(text)}", file=sys.stderr, flush=True)


class Progress:
    """A progress line on standard error while work goes on; nothing at all where that is no terminal."""

    def __init__(self, quiet: bool):
        self.callback: Callable[[str, int, int, str], None] | None = None
        self._bar = None
        if quiet or not sys.stderr.isatty():
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress as Bar, SpinnerColumn, TextColumn, TimeElapsedColumn

        self._bar = Bar(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=30),
            TimeElapsedColumn(),
            TextColumn("{task.fields[text]}", markup=False),
            console=Console(stderr=True),
            transient=True,
        )
        self._tasks = {}
        self.callback = self._advance

    def _advance(self, stage: str, done: int, total: int, text: str) -> None:
        assert self._bar is not None
        stage, text = one_line(stage), one_line(text)
        if stage not in self._tasks:
            for task in self._tasks.values():
                self._bar.stop_task(task)
            self._tasks[stage] = self._bar.add_task(stage, total=total or None, text=text)
        self._bar.update(self._tasks[stage], completed=done, total=total or None, text=text)

    def __enter__(self) -> Progress:
        if self._bar is not None:
            self._bar.start()
        return self

    def stop(self) -> None:
        """Takes the line away; what is written afterwards stands by itself."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = self.callback = None

    def __exit__(self, *exception) -> None:
        self.stop()
