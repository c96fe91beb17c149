"""JAX in a process that was forked: its threads stay behind in the parent, and whatever waits for
them waits for ever.
"""

from __future__ import annotations

import os
import sys

from jaxid.base.errors import UsageError


_computed = False  # in this process or one that it was forked from
_broken = False  # forked from one that had computed


def begin_to_compute() -> None:
    """Raises `UsageError` in a process that was forked from one in which JAX had computed."""
    global _computed
    _computed = True
    if _broken:
        raise UsageError(
            "this process was forked from one that had already used JAX, and would wait for its"
            ' threads for ever: use spawn (`multiprocessing.get_context("spawn")`), or `jaxid'
            " batch`, or fork before the first fit"
        )


def _before() -> None:
    """JAX may have been used without jaxid."""
    global _computed
    used = getattr(sys.modules.get("jax._src.xla_bridge"), "backends_are_initialized", None)
    _computed = _computed or (used is not None and bool(used()))


def _in_child() -> None:
    global _broken
    _broken = _computed


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before, after_in_child=_in_child)
