"""Values from files and command lines: which are numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeGuard

from jaxid.base.errors import UsageError


def is_number(value: Any) -> TypeGuard[int | float]:
    """Whether a value is a number: no truth value, and not nan."""
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value


def is_finite(value: Any) -> TypeGuard[int | float]:
    return is_number(value) and math.isfinite(value)


def parameter_value(name: str, value: Any) -> float:
    """A parameter's number, or the `value` of its entry in a result. Raises `UsageError` for what
    is no finite number.
    """
    if isinstance(value, Mapping):
        value = value.get("value")
    if not is_finite(value):
        raise UsageError(f"parameter {name}: {value!r} is not a finite number")
    return float(value)
