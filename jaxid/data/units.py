"""Units of measured channels: every unit a dataset may state, and its conversion to SI.

A value in SI is `factor * value + shift`; a width (noise, resolution) converts by `factor` alone.
Names are case-sensitive (mN is not MN). `N m`, `N*m`, `N·m`, `Nm` and `rad/s^2`, `rad/s²`,
`rad/s**2` are the same unit.

`g` alone means gram or the acceleration of gravity: the channel that the model needs decides, and
where nothing decides it is refused; `gram` and `g_n` always say which.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from jaxid.base.errors import nearest


@dataclass(frozen=True)
class Conversion:
    """`SI value = factor * value + shift`, in the SI unit `si`."""

    factor: float
    si: str
    shift: float = 0.0


_STANDARD_GRAVITY = 9.80665
_POUND_FORCE = 4.4482216152605
_INCH = 0.0254

_TABLE: dict[str, dict[str, float]] = {
    "1": {"1": 1, "%": 0.01, "ppm": 1e-6, "count": 1},
    "rad": {
        "rad": 1,
        "mrad": 1e-3,
        "urad": 1e-6,
        "deg": math.pi / 180,
        "arcmin": math.pi / 10800,
        "arcsec": math.pi / 648000,
        "rev": 2 * math.pi,
    },
    "rad/s": {
        "rad/s": 1,
        "mrad/s": 1e-3,
        "deg/s": math.pi / 180,
        "rev/s": 2 * math.pi,
        "rpm": math.pi / 30,
    },
    "rad/s^2": {"rad/s^2": 1, "deg/s^2": math.pi / 180, "rev/s^2": 2 * math.pi},
    "m": {"m": 1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": _INCH, "ft": 12 * _INCH},
    "m/s": {"m/s": 1, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6, "km/h": 1 / 3.6, "in/s": _INCH},
    "m/s^2": {"m/s^2": 1, "cm/s^2": 1e-2, "mm/s^2": 1e-3, "g_n": _STANDARD_GRAVITY},
    "N": {
        "N": 1,
        "mN": 1e-3,
        "kN": 1e3,
        "kgf": _STANDARD_GRAVITY,
        "gf": _STANDARD_GRAVITY * 1e-3,
        "lbf": _POUND_FORCE,
    },
    "N m": {
        "N m": 1,
        "mN m": 1e-3,
        "uN m": 1e-6,
        "kN m": 1e3,
        "N cm": 1e-2,
        "N mm": 1e-3,
        "kgf m": _STANDARD_GRAVITY,
        "kgf cm": _STANDARD_GRAVITY * 1e-2,
        "kgf mm": _STANDARD_GRAVITY * 1e-3,
        "gf cm": _STANDARD_GRAVITY * 1e-5,
        "oz in": _POUND_FORCE / 16 * _INCH,
        "lbf in": _POUND_FORCE * _INCH,
        "lbf ft": _POUND_FORCE * 12 * _INCH,
    },
    "V": {"V": 1, "mV": 1e-3, "uV": 1e-6, "kV": 1e3},
    "A": {"A": 1, "mA": 1e-3, "uA": 1e-6, "kA": 1e3},
    "W": {"W": 1, "mW": 1e-3, "kW": 1e3},
    "J": {"J": 1, "mJ": 1e-3, "kJ": 1e3},
    "kg": {"kg": 1, "gram": 1e-3, "mg": 1e-6, "t": 1e3, "lb": 0.45359237},
    "kg m^2": {"kg m^2": 1, "kg cm^2": 1e-4, "g cm^2": 1e-7},
    "s": {"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60},
    "Hz": {"Hz": 1, "kHz": 1e3},
    "Pa": {"Pa": 1, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "psi": _POUND_FORCE / _INCH**2},
    "K": {"K": 1},
    "ohm": {"ohm": 1},
    "N/m": {"N/m": 1, "N/mm": 1e3},
    "N m/rad": {"N m/rad": 1, "N m/deg": 180 / math.pi},
    "N m/A": {"N m/A": 1, "mN m/A": 1e-3},
    "N m s/rad": {"N m s/rad": 1},
    "N s/m": {"N s/m": 1},
}
_UNITS: dict[str, Conversion] = {}
for _si, _row in _TABLE.items():
    _UNITS |= {name: Conversion(float(factor), _si) for name, factor in _row.items()}
_UNITS["degC"] = Conversion(1.0, "K", 273.15)
_UNITS["degF"] = Conversion(5 / 9, "K", 459.67 * 5 / 9)

_OTHER_NAMES = {
    "": "1",
    "-": "1",
    "none": "1",
    "percent": "%",
    "counts": "count",
    "tick": "count",
    "ticks": "count",
    "radian": "rad",
    "radians": "rad",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "°/s": "deg/s",
    "°/s^2": "deg/s^2",
    "dps": "deg/s",
    "turn": "rev",
    "turns": "rev",
    "rps": "rev/s",
    "rev/min": "rpm",
    "r/min": "rpm",
    "1/min": "rpm",
    "°C": "degC",
    "C": "degC",
    "°F": "degF",
    "Nm": "N m",
    "mNm": "mN m",
    "kNm": "kN m",
    "Ncm": "N cm",
    "Nmm": "N mm",
    "kgfm": "kgf m",
    "kgfcm": "kgf cm",
    "kg cm": "kgf cm",
    "kgcm": "kgf cm",
    "gcm": "gf cm",
    "g cm": "gf cm",
    "ozf in": "oz in",
    "ozin": "oz in",
    "in lbf": "lbf in",
    "ft lbf": "lbf ft",
    "in lb": "lbf in",
    "ft lb": "lbf ft",
    "lb in": "lbf in",
    "lb ft": "lbf ft",
    "g0": "g_n",
    "gn": "g_n",
    "sec": "s",
    "inch": "in",
    "volt": "V",
    "amp": "A",
    "Ohm": "ohm",
    "Ω": "ohm",
    "N m s": "N m s/rad",
}


class UnitError(ValueError):
    """A unit that the table lacks, or that means two things."""


def _tidy(unit: str) -> str:
    text = unit.strip().replace("²", "^2").replace("**", "^").replace("µ", "u").replace("μ", "u")
    text = re.sub(r"\s*/\s*", "/", text)
    text = re.sub(r"\s*[*·⋅.]\s*|(?<=[a-zA-Z])-(?=[a-zA-Z])", " ", text) if len(text) > 1 else text
    text = re.sub(r"\s+", " ", text)
    text = re.sub(r" s\^-1$", "/s", text)
    text = re.sub(r" s\^-2$", "/s^2", text)
    return text.replace("/s/s", "/s^2")


def conversion(unit: str, wanted: str | None = None) -> Conversion:
    """The conversion of `unit` to SI. `wanted` is the SI unit that the model's channel has; it
    decides what `g` is.

    Raises `UnitError` with the nearest known unit for an unknown one, and for `g` where nothing
    decides.
    """
    name = _tidy(unit)
    name = _OTHER_NAMES.get(name, name)
    if name == "g":
        if wanted in ("kg", "m/s^2"):
            return _UNITS["gram" if wanted == "kg" else "g_n"]
        raise UnitError("unit 'g' means gram or the acceleration of gravity: write 'gram' or 'g_n'")
    if name in _UNITS:
        return _UNITS[name]
    raise UnitError(f"unknown unit {unit!r}{nearest(name, _UNITS)}")


def si_unit(unit: str) -> str:
    """The SI unit of the quantity that `unit` measures, as the table spells it; a unit it lacks
    comes back as it is.
    """
    try:
        return conversion(unit).si
    except UnitError:
        return unit


def named_unit(si: str, factor: float) -> str:
    """The first unit of a quantity that is `factor` of its SI unit; empty where none is."""
    for name, own in _TABLE.get(si, {}).items():
        if abs(own / factor - 1) < 1e-6:
            return name
    return ""


def read_as(si: str, stated: float = 1.0) -> dict[str, float]:
    """By how much a channel of a quantity is too large where it was recorded in another unit than
    the stated one, `stated` of the SI unit: "deg read as rad" -> 57.3. Empty for an unknown one.
    """
    others = dict.fromkeys(_TABLE.get(si, {}).values())
    others.pop(stated, None)
    own = named_unit(si, stated)
    return {f"{named_unit(si, factor)} read as {own}": stated / factor for factor in others}


def unit_names() -> tuple[str, ...]:
    """Every unit the table has, by its first spelling."""
    return tuple(_UNITS)
