"""Whether JAX has a version that jaxid was run with (`docs/versions.md`). JAX is not imported for
it.
"""

from __future__ import annotations

import functools
import re
import sys
import warnings
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, requires, version

from jaxid.base.errors import UsageError


#: What computes a result.
RESULT_PACKAGES = ("jaxid", "jax", "numpy", "scipy")


@functools.cache
def check_jax() -> None:
    """Raises `UsageError` for a JAX that is older than the versions jaxid was run with; warns of a
    newer one, once.

    The bounds are those of the installed package; where it is not installed, nothing is known and
    nothing said.
    """
    try:
        found = version("jax")
        requirements = requires("jaxid") or []
    except PackageNotFoundError:
        return
    lower, upper = bounds_of("jax", requirements)
    if lower is None or upper is None:
        return
    told = (
        f"JAX {found} is installed, and jaxid was not run with it; type:"
        f" {remedy(f'<={upper},>={lower}')}"
    )
    if release(found) < release(lower):
        raise UsageError(told)
    if release(found) > release(upper):
        warnings.warn(f"{told} if something goes wrong", RuntimeWarning, stacklevel=3)


def bounds_of(package: str, requirements: Sequence[str]) -> tuple[str | None, str | None]:
    """The oldest and the newest version of a package (`>=`, `<=`) that requirements name."""
    for requirement in requirements:
        if not re.match(rf"{re.escape(package)}\b(?![-.\[])", requirement):
            continue
        lower = re.search(r">=\s*([\d.]+)", requirement)
        upper = re.search(r"<=\s*([\d.]+)", requirement)
        return lower and lower[1], upper and upper[1]
    return None, None


def release(version: str) -> tuple[int, ...]:
    """The numbers of a version, without what marks a release before or after it, nor zeros at its
    end.
    """
    digits = re.split(r"[^\d.]", version)[0].strip(".")
    numbers = [int(part) for part in digits.split(".")]
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)


def remedy(bounds: str) -> str:
    """What to type for a JAX within bounds."""
    return f"{sys.executable} -m pip install 'jax{bounds}'"


def versions(packages: Sequence[str] = RESULT_PACKAGES) -> dict[str, str]:
    """Version of each package, by default of what computes a result, for its JSON."""
    from importlib.metadata import PackageNotFoundError, version

    out = {}
    for name in packages:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "not installed"
    return out
