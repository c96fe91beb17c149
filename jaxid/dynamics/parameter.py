"""Parameters live on the field that holds them: start or neutral value, bounds, scale, unit,
meaning.

Bounds and scales of an effect cannot be absolute: a drive of 60 N and a tracker of 0.1 N m share
the library. They are written as multiples of reference quantities (`2 * TORQUE / SPEED`) that are
read off the data of each joint.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, TypeVar

import equinox as eqx
import numpy as np

from jaxid.base.errors import UsageError


M = TypeVar("M")


class TypicalMagnitudes(NamedTuple):
    """Typical magnitudes at one joint: drive torque, speed, travel, duration of a run, and sampling
    step; and of a number of the model, where an effect acts on one. `begin` is the first time of
    all runs, and `span` lasts to their last one (0: as long as a run).
    """

    torque: float
    speed: float
    angle: float
    duration: float
    step: float
    number: float = 1.0
    begin: float = 0.0
    span: float = 0.0


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A number in reference units, `coefficient * torque**a * speed**b * ...`, no more than `most`
    and no less than `least` where that is physical.
    """

    coefficient: float
    powers: tuple[tuple[str, int], ...] = ()
    most: float | None = None
    least: float | None = None

    def __pow__(self, exponent: int) -> Quantity:
        """Raised to a whole power: `TORQUE / ANGLE**3`."""
        powers = tuple((name, power * exponent) for name, power in self.powers if exponent)
        return Quantity(self.coefficient**exponent, powers)

    def up_to(self, most: float) -> Quantity:
        """The same, and no more than this many SI units, whatever the data show."""
        return dataclasses.replace(self, most=most)

    def no_less_than(self, least: float) -> Quantity:
        """The same, and no less than this many SI units, whatever the data show."""
        return dataclasses.replace(self, least=least)

    def __mul__(self, other: Quantity | float) -> Quantity:
        return self._combine(other, 1)

    __rmul__ = __mul__

    def __truediv__(self, other: Quantity | float) -> Quantity:
        return self._combine(other, -1)

    def __rtruediv__(self, other: float) -> Quantity:
        return Quantity(float(other))._combine(self, -1)

    def __neg__(self) -> Quantity:
        return Quantity(-self.coefficient, self.powers)

    def _combine(self, other: Quantity | float, sign: int) -> Quantity:
        other = other if isinstance(other, Quantity) else Quantity(float(other))
        powers = dict(self.powers)
        for name, power in other.powers:
            powers[name] = powers.get(name, 0) + sign * power
        kept = tuple((n, p) for n, p in powers.items() if p)
        return Quantity(self.coefficient * other.coefficient**sign, kept)

    def at(self, reference: TypicalMagnitudes) -> float:
        value = self.coefficient
        for name, power in self.powers:
            value *= getattr(reference, name) ** power
        above = value if self.least is None else max(value, self.least)
        return float(above if self.most is None else min(above, self.most))

    def __str__(self) -> str:
        text = f"{self.coefficient:g}"
        for name, power in self.powers:
            text += f" {'*' if power > 0 else '/'} {name}" + (
                f"^{abs(power)}" if abs(power) > 1 else ""
            )
        text += "" if self.least is None else f", at least {self.least:g}"
        return text if self.most is None else f"{text}, at most {self.most:g}"


@dataclasses.dataclass(frozen=True)
class Moment(Quantity):
    """A time at the share `coefficient` of the way from the first sample of all runs to the last
    one.
    """

    def at(self, reference: TypicalMagnitudes) -> float:
        span = reference.span or reference.duration
        return float(reference.begin + self.coefficient * span)

    def __str__(self) -> str:
        ends = {0.0: "the first sample", 1.0: "the last sample"}
        return ends.get(self.coefficient, f"{100 * self.coefficient:g} % of the way between these")


TORQUE = Quantity(1.0, (("torque", 1),))
SPEED = Quantity(1.0, (("speed", 1),))
ANGLE = Quantity(1.0, (("angle", 1),))
DURATION = Quantity(1.0, (("duration", 1),))
STEP = Quantity(1.0, (("step", 1),))
NUMBER = Quantity(1.0, (("number", 1),))

Bound = float | Quantity


def resolve(value: Bound, reference: TypicalMagnitudes) -> float:
    """A bound or scale as a plain number."""
    return value.at(reference) if isinstance(value, Quantity) else float(value)


class ParameterSpec(NamedTuple):
    """What is known of a parameter before any data. `unit` may hold {F}, {X}, {I}: force,
    coordinate, inertia unit.
    """

    value: float  # start value of a model parameter, neutral value of an effect's
    lower: Bound
    upper: Bound
    scale: Bound
    unit: str
    meaning: str
    log: bool
    fixed: bool
    only: tuple[str, str] | None = None  # the setting, and its value, that the parameter belongs to


def param(
    value: float,
    lower: Bound,
    upper: Bound,
    *,
    unit: str,
    meaning: str = "",
    scale: Bound | None = None,
    log: bool = False,
    only: tuple[str, str] | None = None,
) -> Any:
    """A field that can be fitted.

    `value` is where a fit starts (the neutral value for an effect: the effect is then exactly the
    identity), `scale` a typical change (default: a tenth of the value, or of the bounds), `log`
    searches the logarithm (positive quantities that may lie anywhere in several decades), `only` a
    setting and its value without which the field is a constant.
    """
    if scale is None:
        scale = 0.1 * abs(value) if value else (upper * 0.1)
    return _field(
        ParameterSpec(
            value=value,
            lower=lower,
            upper=upper,
            scale=scale,
            unit=unit,
            meaning=meaning,
            log=log,
            fixed=False,
            only=only,
        )
    )


def constant(value: float, *, unit: str, meaning: str = "") -> Any:
    """A field with a known number that is not fitted (geometry, gravity); a dataset may state it,
    for each run too.
    """
    return _field(
        ParameterSpec(
            value=value,
            lower=-np.inf,
            upper=np.inf,
            scale=1.0,
            unit=unit,
            meaning=meaning,
            log=False,
            fixed=True,
        )
    )


class SettingSpec(NamedTuple):
    """What a model or an effect is built with: a whole number between bounds, yes and no, or one of
    some words.
    """

    default: int | bool | str
    lower: int
    upper: int
    meaning: str
    words: tuple[str, ...] = ()

    def check(self, name: str, value: Any) -> Any:
        """The value as the setting holds it; raises `UsageError` for one that it cannot have."""
        if self.words:
            if value not in self.words:
                raise UsageError(f"{name} = {value!r}: it is one of {', '.join(self.words)}")
            return value
        if (
            not isinstance(value, int | float)
            or not self.lower <= value <= self.upper
            or value != int(value)
        ):
            kind = (
                "true or false"
                if isinstance(self.default, bool)
                else f"a whole number from {self.lower} to {self.upper}"
            )
            raise UsageError(f"{name} = {value!r}: it is {kind}")
        return type(self.default)(value)


def setting(
    default: int | bool | str,
    lower: int = 0,
    upper: int = 1,
    *,
    meaning: str,
    words: tuple[str, ...] = (),
) -> Any:
    """A field that decides the structure of a model (a number of elements, a term taken or not) or
    which of some `words` an effect is. A dataset states a model's among its constants, an effect's
    stands in its id: `NAME(load=drive)`. Another value is another compiled program.
    """
    return eqx.field(
        static=True,
        default=default,
        metadata={"setting": SettingSpec(default, lower, upper, meaning, words)},
    )


def settings(owner: Any) -> dict[str, SettingSpec]:
    """Field name -> specification of a class or instance that has settings."""
    return {
        f.name: f.metadata["setting"] for f in dataclasses.fields(owner) if "setting" in f.metadata
    }


def with_settings(owner: M, values: Mapping[str, Any]) -> M:
    """The same module with those of the values that are settings of it.

    Raises `UsageError` for a value out of bounds.
    """
    chosen = {
        name: spec.check(name, values[name])
        for name, spec in settings(owner).items()
        if name in values
    }
    return dataclasses.replace(owner, **chosen) if chosen else owner  # type: ignore[type-var]


def _field(spec: ParameterSpec) -> Any:
    return eqx.field(
        default=np.float64(spec.value), converter=_number, metadata={"parameter": spec}
    )


def _number(value: Any) -> Any:
    """Python and NumPy numbers become float64 arrays that follow the precision in force; tracers
    pass.
    """
    return (
        np.asarray(value, np.float64)
        if isinstance(value, int | float | list | tuple | np.ndarray | np.generic)
        else value
    )


def specs(owner: Any) -> dict[str, ParameterSpec]:
    """Field name -> specification of a class or instance that declares parameters."""
    fields = {f.name: f for f in dataclasses.fields(owner)}

    def chosen(name):
        return fields[name].default if isinstance(owner, type) else getattr(owner, name)

    found = {
        name: f.metadata["parameter"] for name, f in fields.items() if "parameter" in f.metadata
    }
    return {
        name: spec
        for name, spec in found.items()
        if spec.only is None or chosen(spec.only[0]) == spec.only[1]
    }


@lru_cache(maxsize=64)
def kind_with(kind: type[M], values: tuple[tuple[str, Any], ...]) -> type[M]:
    """The class of a module with other defaults of its settings, named by them:
    `load_dependent_friction(load=drive)`.

    Raises `UsageError` for a setting that it does not have, or a value that it cannot have.
    """
    own, chosen = settings(kind), {}
    for name, value in values:
        if name not in own:
            has = f"; it has {', '.join(own)}" if own else ", nor any other"
            raise UsageError(f"{kind.name} has no setting {name!r}{has}")  # pyright: ignore[reportAttributeAccessIssue]
        chosen[name] = own[name].check(name, value)
    told = {k: v for k, v in chosen.items() if v != own[k].default}
    if not told:
        return kind
    body: dict[str, Any] = {
        "__annotations__": {},
        "__doc__": kind.__doc__,
        "__module__": kind.__module__,
    }
    for name, value in told.items():
        spec = own[name]
        body[name] = setting(value, spec.lower, spec.upper, meaning=spec.meaning, words=spec.words)
        body["__annotations__"][name] = type(value)
    plain: str = kind.name  # pyright: ignore[reportAttributeAccessIssue]
    body |= {
        "name": f"{plain}({', '.join(f'{k}={v}' for k, v in told.items())})",
        "contains": (plain,),
    }
    body["__annotations__"] |= {"name": ClassVar[str], "contains": ClassVar[tuple[str, ...]]}
    made = type(kind)(kind.__name__, (kind,), body)
    numbers = specs(made)
    probes: list[dict[str, Any]] = []
    for probe in kind.probes:  # pyright: ignore[reportAttributeAccessIssue]
        known = {k: v for k, v in probe.items() if k in numbers}
        if known not in probes:
            probes.append(known)
    made.probes = tuple(probes)  # pyright: ignore[reportAttributeAccessIssue]
    return made


def with_fields(owner: Any, values: dict[str, Any]) -> Any:
    """The same module with some parameter fields replaced (works on tracers)."""
    if not values:
        return owner
    names = list(values)

    def where(m):
        return [getattr(m, n) for n in names]

    return eqx.tree_at(where, owner, [values[n] for n in names])
