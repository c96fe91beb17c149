"""Float64 where a fit needs it, without touching the global setting of the user's program."""

from __future__ import annotations

from contextlib import AbstractContextManager

from jaxid.base.versions import check_jax
from jaxid.numerics import forked
from jaxid.numerics.program_cache import keep_compiled


def float64() -> AbstractContextManager:
    """Context in which JAX computes in float64; outside, the user's precision stands.

    Every computation passes here, so it is also where one that would never end, in a forked
    process, is refused. Raises `UsageError` for a JAX that is too old.
    """
    check_jax()
    forked.begin_to_compute()
    import jax

    keep_compiled()
    switch = getattr(jax, "enable_x64", None)
    if switch is None:  # JAX before 0.8
        import jax.experimental

        switch = getattr(jax.experimental, "enable_x64")  # noqa: B009
    return switch(True)
