"""Programs that reverse-mode differentiation can pass: `jax.grad` knows no loop whose length is
found while it runs.

The stepping asks `reversible()` while it is traced. Inside, loops over time have the static length
of the output, and the sticking solve has the derivative of what it solves instead of that of its
iterations; the numbers are the same to rounding. Everything else keeps its loops that end early,
which forward tangents pass and which cost less.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar


_REVERSIBLE: ContextVar[bool] = ContextVar("jaxid-reversible", default=False)


def reversible() -> bool:
    """Whether what is traced now has to be differentiable in reverse."""
    return _REVERSIBLE.get()


@contextmanager
def in_reverse() -> Iterator[None]:
    """While this is open, what is traced is differentiable in reverse."""
    token = _REVERSIBLE.set(True)
    try:
        yield
    finally:
        _REVERSIBLE.reset(token)
