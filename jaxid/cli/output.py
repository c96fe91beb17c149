"""What commands leave in the folder `--out` and on the terminal, also when they are stopped or the
disk is full.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, TYPE_CHECKING

from jaxid.base.atomic_files import settle
from jaxid.base.errors import FAILED, NotSaved, SUCCESS, UsageError
from jaxid.base.interim import listening
from jaxid.base.stopping import stoppable
from jaxid.cli import terminal


if TYPE_CHECKING:
    from jaxid.fitting.fitter import Progress


class Output:
    """Shows progress while work goes on inside `with`, saves what is known before the end as it
    comes (`interim`) in a folder of its own, and the result in the place of an older one
    (`deliver`). Ctrl-C, SIGTERM and SIGHUP leave what there is.
    """

    def __init__(self, out: Path, as_json: bool, quiet: bool, seconds: float | None = None):
        self.out, self.as_json, self.quiet = out, as_json, quiet
        self._progress = terminal.Progress(quiet, seconds)
        self.kept: Path | None = None  # what is saved by now
        self._latest: Any = None
        self._told = False  # what was kept, after an interruption
        self._stack = ExitStack()

    def __enter__(self) -> Output:
        self._stack.enter_context(self._progress)
        self._stack.enter_context(stoppable(self._last_words))
        self._stack.enter_context(listening(self.interim))
        return self

    @property
    def progress(self) -> Progress | None:
        return self._progress.callback

    def interim(self, result: Any) -> None:
        """Saves what is known so far; work goes on where it cannot be saved."""
        from jaxid.report.result_files import save_partial

        with suppress(NotSaved):
            self.kept, self._latest = save_partial(result, self.out, page=False), result

    def deliver(self, result: Any, text: Callable[[Any], str]) -> int:
        """Saves the result and prints it, by its `text` or as JSON; returns the exit code. A result
        that cannot be saved is printed in any case.
        """
        from jaxid.report.result_files import DRAWN, kind_of, save

        if kind_of(result) in DRAWN:  # which takes seconds
            self.interim(result)
        try:
            save(result, self.out)
        except NotSaved as error:
            self._progress.stop()
            self.show(result, text, quiet=False)
            self._complain(error)
            return FAILED
        self.kept = None
        self._progress.stop()
        self.show(result, text, self.quiet)
        return SUCCESS

    def show(self, result: Any, text: Callable[[Any], str], quiet: bool) -> None:
        from jaxid.base.serialise import finite

        if self.as_json:
            print(json.dumps(finite(result.to_dict()), indent=1, allow_nan=False))
        elif not quiet:
            terminal.say(text(result))
            if (page := self.out / "report.html").is_file() and self.kept is None:
                terminal.say(f"The report with pictures: {page}")
            terminal.say_time()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: Any
    ) -> None:
        self._progress.stop()
        try:
            if isinstance(error, KeyboardInterrupt):
                settle(self.out)
                self._stopped(getattr(error, "partial", None) or self._latest)
        finally:
            self._stack.close()

    def _stopped(self, result: Any) -> None:
        from jaxid.report.result_files import save_partial

        if result is None:
            self._told = True
            return terminal.complain("nothing was finished yet")
        try:
            if result is not self._latest:
                self.kept = save_partial(result, self.out, page=False)
            self._told = True
            terminal.complain(f"what was finished is in {self.kept}")
            save_partial(result, self.out, page=True)
        except NotSaved as unsaved:
            self._complain(unsaved)

    def _complain(self, error: NotSaved) -> None:
        kept = "" if self.kept is None else f". Without its page the result is in {self.kept}"
        terminal.complain(f"{error}{kept}. Make room, or name another folder with --out")

    def _last_words(self) -> None:
        """For a process that does not end in time."""
        terminal.give_back()
        if self._told:
            return terminal.complain("interrupted")
        kept = (
            "nothing was finished yet"
            if self.kept is None
            else f"what was finished is in {self.kept}"
        )
        terminal.complain(f"interrupted; {kept}")


def writable_folder(out: Path) -> None:
    """Makes the folder and ends what a process that was killed had begun there, or says why nothing
    could be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        settle(out)
        probe = out / f".jaxid-{os.getpid()}.partial"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UsageError(
            f"--out {out}: cannot write there ({error.strerror}); name a folder that is writable"
        ) from error
