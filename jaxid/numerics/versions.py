"""Whether JAX has a version that jaxid was run with (`docs/versions.md`). JAX is not imported for it."""

from __future__ import annotations

import functools
import sys
import warnings
from importlib.metadata import PackageNotFoundError, requires, version

from jaxid.errors import UsageError


@functools.cache
def check_jax() -> None:
    """Raises `UsageError` for a JAX that is older than the versions jaxid was run with; warns of a newer one, once.

    The bounds are those of the installed package; where it is not installed, nothing is known and nothing said."""
    from packaging.requirements import Requirement
    from packaging.version import Version

    try:
        found = Version(version("jax"))
        bounds = next(r.specifier for r in map(Requirement, requires("jaxid") or []) if r.name == "jax")
    except (PackageNotFoundError, StopIteration):
        return
    if bounds.contains(found, prereleases=True):
        return
    told = f"JAX {found} is installed, and jaxid was not run with it; type: {remedy(str(bounds))}"
    if any(not bound.contains(found, prereleases=True) for bound in bounds if bound.operator.startswith(">")):
        raise UsageError(told)
    warnings.warn(f"{told} if something goes wrong", RuntimeWarning, stacklevel=3)


def remedy(bounds: str) -> str:
    """What to type for a JAX within bounds."""
    return f"{sys.executable} -m pip install 'jax{bounds}'"


def versions() -> dict[str, str]:
    """Versions of what computes a result, for its JSON."""
    from importlib.metadata import PackageNotFoundError, version

    out = {}
    for name in ("jaxid", "jax", "numpy", "scipy"):
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "not installed"
    return out
