"""Errors a user can mend: each names what is wrong and what to do about it."""


class UsageError(ValueError):
    """A wrong argument: an unknown name, a model that does not fit the data, a fitter that does not fit the residual."""


class NotSaved(OSError):
    """Files could not be written; older ones are as they were. `needed` and `free` are in bytes, `free` None if unknown."""

    def __init__(self, number: int | None, reason: str, path: str, needed: int, free: int | None = None):
        super().__init__(number, reason, path)
        self.needed, self.free = needed, free

    def __str__(self) -> str:
        room = "" if self.free is None else f", {self.free:,} are free"
        return f"{self.filename}: not written ({self.strerror}): {self.needed:,} bytes are needed{room}"


def nearest(word: str, choices) -> str:
    """`" (did you mean 'x'?)"` for the closest choice, or the list of choices when nothing is close."""
    from difflib import get_close_matches

    choices = list(choices)
    close = get_close_matches(word, choices, n=1, cutoff=0.5)
    return f" (did you mean {close[0]!r}?)" if close else f" (there is: {', '.join(choices)})"
