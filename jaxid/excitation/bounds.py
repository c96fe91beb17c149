"""What an excitation may ask of a machine: joint range, speed, acceleration, and how large an input
may be.

The limits that a user states (the same TOML file as for `jaxid record`) come first; what is not
stated comes from the maker's tables where a model has one, else from a cautious rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.limits import Limits
from jaxid.dynamics.mechanism import Signature


class Bounds(NamedTuple):
    """Per joint [n]: `home` a pose to move about, range `lower` ... `upper` (rad or m), `speed`,
    `acceleration`, and the standard deviation of the torque's noise, nan where unknown (N m or N).
    `source` says where they come from; `stated` [n] whether somebody states a joint's range, which
    then stays where it is.
    """

    home: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    torque_noise: np.ndarray
    source: str
    stated: np.ndarray


class KnownLimits(NamedTuple):
    home: Sequence[float]
    lower: Sequence[float]
    upper: Sequence[float]
    speed: Sequence[float]
    acceleration: Sequence[float]
    source: str
    torque_noise: Sequence[float] | None = None


_90 = float(np.pi / 2)
#: Upright arm; 1.2 rad to either side keep a UR's links apart.
_UPRIGHT = np.array([0.0, -_90, 0.0, -_90, 0.0, 0.0])
_UR_SPEED = (2.09, 2.09, 3.14, 3.14, 3.14, 3.14)
KNOWN: dict[str, KnownLimits] = {
    "ur10": KnownLimits(
        _UPRIGHT.tolist(), (_UPRIGHT - 1.2).tolist(), (_UPRIGHT + 1.2).tolist(), _UR_SPEED, (8.0,) * 6,
        "1.2 rad about the upright arm; speeds of the data sheet; 8 rad/s^2",
        (3.7817, 4.1789, 3.0339, 1.7334, 1.0670, 0.9896),  # paper 001, Table II
    ),
    "ur10e": KnownLimits(
        _UPRIGHT.tolist(), (_UPRIGHT - 1.2).tolist(), (_UPRIGHT + 1.2).tolist(), _UR_SPEED, (8.0,) * 6,
        "1.2 rad about the upright arm; speeds of the data sheet; 8 rad/s^2",
    ),
    "panda": KnownLimits(
        (0.0, -_90 / 2, 0.0, -1.5 * _90, 0.0, _90, _90 / 2), (-1.4, -1.3, -1.4, -2.8, -1.4, 0.4, -0.6),
        (1.4, 0.5, 1.4, -1.0, 1.4, 2.9, 2.2), (2.0, 2.0, 2.0, 2.0, 2.4, 2.4, 2.4), (6.0,) * 7,
        "inside the ranges and speeds of the Franka Control Interface documentation, about its ready pose; 6 rad/s^2",
    ),
}  # fmt: skip
#: Where nothing is known: (half range, speed, acceleration) of a joint that turns and of one that
#: slides.
TURNS, SLIDES = (1.2, 3.0, 12.0), (0.15, 0.5, 3.0)


def slides_of(signature: Signature) -> np.ndarray:
    """Which joints translate, [n]."""
    n = len(signature.joints)
    return np.array(signature.prismatic or (signature.linear,) * n, bool)


def bounds_of(model: str, signature: Signature, stated: Limits | None, table: Any = None) -> Bounds:
    """Bounds of a model's joints; `table` an `ArmTable` with the maker's limits (from a URDF), if
    there is one.

    Raises `UsageError` for an empty range.
    """
    n = len(signature.joints)
    stated = (stated or Limits()).widened(n)
    ranged = np.full(n, stated.lower is not None or stated.upper is not None or model in KNOWN)
    known = KNOWN.get(model)
    if known is not None:
        home, lower, upper, speed, acceleration = (np.array(v, float) for v in known[:5])
        source = known.source
    else:
        rule = np.where(slides_of(signature)[:, None], SLIDES, TURNS).T
        home, lower, upper, speed, acceleration = (
            np.zeros(n),
            -rule[0],
            rule[0].copy(),
            rule[1],
            rule[2],
        )
        source = "a cautious rule: 1.2 rad, 3 rad/s, 12 rad/s^2 (0.15 m, 0.5 m/s, 3 m/s^2)"
        if table is not None and len(table.lower) == n:
            ranged |= np.isfinite(table.lower) | np.isfinite(table.upper)
            low, high = (
                np.where(np.isfinite(table.lower), table.lower, lower),
                np.where(np.isfinite(table.upper), table.upper, upper),
            )
            home = np.clip(home, low + 0.1 * (high - low), high - 0.1 * (high - low))
            lower, upper = (
                np.maximum(home - 1.5 * rule[0], 0.95 * low + 0.05 * high),
                np.minimum(home + 1.5 * rule[0], 0.05 * low + 0.95 * high),
            )
            speed = np.where(
                np.isfinite(table.velocity) & (table.velocity > 0),
                np.minimum(0.9 * table.velocity, speed),
                speed,
            )
            source = "the file's ranges and speeds where it states them, but not beyond " + source
    own = []
    for name, value in (
        ("lower", lower),
        ("upper", upper),
        ("speed", speed),
        ("acceleration", acceleration),
    ):
        if getattr(stated, name) is not None:
            value[:] = getattr(stated, name)
            own.append(name)
    if own:
        source = f"{', '.join(own)} as stated" + ("" if len(own) == 4 else f"; else {source}")
    for j in np.flatnonzero(~(lower < upper)):
        raise UsageError(
            f"limits: the range of {signature.joints[j]} is empty ({lower[j]:g} to {upper[j]:g})"
        )
    home = np.where((home > lower) & (home < upper), home, (lower + upper) / 2)
    noise = (
        np.full(n, np.nan)
        if known is None or known.torque_noise is None
        else np.array(known.torque_noise)
    )
    return Bounds(
        home=home,
        lower=lower,
        upper=upper,
        speed=speed,
        acceleration=acceleration,
        torque_noise=noise,
        source=source,
        stated=ranged,
    )
