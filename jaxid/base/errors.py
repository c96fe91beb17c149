"""Errors a user can mend: each names what is wrong and what to do about it."""

from collections.abc import Sequence
from dataclasses import dataclass


class UsageError(ValueError):
    """A wrong argument: an unknown name, a model that does not fit the data, a fitter that does not
    fit the residual.
    """


class NotSaved(OSError):
    """Files could not be written; older ones are as they were. `needed` and `free` are in bytes,
    `free` None if unknown.
    """

    def __init__(
        self, number: int | None, reason: str, path: str, needed: int, free: int | None = None
    ):
        super().__init__(number, reason, path)
        self.needed, self.free = needed, free

    def __str__(self) -> str:
        room = "" if self.free is None else f", {self.free:,} are free"
        return (
            f"{self.filename}: not written ({self.strerror}): {self.needed:,} bytes are"
            f" needed{room}"
        )


def nearest(word: str, choices) -> str:
    """`" (did you mean 'x'?)"` for the closest choice, or the list of choices when nothing is
    close.
    """
    from difflib import get_close_matches

    choices = list(choices)
    close = get_close_matches(word, choices, n=1, cutoff=0.5)
    return f" (did you mean {close[0]!r}?)" if close else f" (there is: {', '.join(choices)})"


@dataclass(frozen=True)
class DatasetProblem:
    """One fault of a dataset. `row` counts as an editor does (the header is row 1, the first sample
    row 2).
    """

    file: str
    row: int | None
    column: str | None
    message: str
    remedy: str

    def __str__(self) -> str:
        place = [self.file]
        if self.row is not None:
            place.append(f"row {self.row}")
        if self.column is not None:
            place.append(
                f"column {self.column}" if not self.file.endswith(".toml") else self.column
            )
        return f"{', '.join(place)}: {self.message}. {self.remedy}"


class DatasetError(ValueError):
    """A dataset that was refused; `problems` holds every fault found, `str()` lists them all."""

    def __init__(self, problems: Sequence[DatasetProblem]):
        self.problems = list(problems)
        super().__init__(str(self))

    def __str__(self) -> str:
        if len(self.problems) == 1:
            return str(self.problems[0])
        return "\n".join(
            [f"{len(self.problems)} problems in the data:", *(f"- {p}" for p in self.problems)]
        )

    def __reduce__(self):
        return (type(self), (self.problems,))


class DatasetWarning(UserWarning):
    """Data that were accepted and deserve a look; the same sentence stands in `Dataset.notes`."""


BAD_INPUT = 2


def explain(error: Exception) -> tuple[int, str]:
    """Exit code and message of an error that reached the top."""
    from jaxid.base.errors import DatasetError, NotSaved, UsageError

    if isinstance(error, UsageError | DatasetError):
        return BAD_INPUT, str(error)
    if isinstance(error, NotSaved):
        return FAILED, f"{error}. Make room, or name another folder with --out"
    if isinstance(error, OSError):
        why = error.strerror or str(error) or type(error).__name__
        return (BAD_INPUT, f"{error.filename}: {why}") if error.filename else (FAILED, why)
    if isinstance(error, MemoryError):
        return FAILED, "not enough memory"
    return (
        FAILED,
        (
            f"internal error, {type(error).__name__}: {error} (JAXID_TRACEBACK=1 shows where;"
            " please report it)"
        ),
    )


SUCCESS, FAILED = 0, 1
