"""What a result says of a model's numbers, read from its JSON: a stranger's input, of which only
what is known is taken.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.numbers import is_finite, is_number
from jaxid.robots.steps import EXACT_STEPS


KINDS = ("fit", "diagnosis", "identification")
#: A name of a file: no control characters, and not longer than this.
NAME = r"[^\x00-\x1f]{1,200}"
#: Most numbers or effects that are taken from a file.
MOST = 5000
#: How the note of a number begins that is not carried over.
AS_STATED = "as the file has it"


@dataclass(frozen=True)
class Number:
    """A fitted number; `std` None where the data do not determine it."""

    value: float
    std: float | None = None
    unit: str = ""
    at_bound: bool = False
    kept: str = ""  # why it is as the file has it
    lower: float = -math.inf
    upper: float = math.inf

    @property
    def doubt(self) -> str:
        """What is to be said of it."""
        if self.kept:
            return self.kept
        if self.at_bound:
            return "it stands at its bound and may stand for something else"
        return "" if self.std is not None else "the data do not determine it by itself"


@dataclass(frozen=True)
class Named:
    """An effect that was found, with its numbers."""

    effect: str
    location: str
    numbers: Mapping[str, Number]

    def value(self, name: str) -> float:
        """One of its numbers; raises `UsageError` where the result lacks it."""
        if name not in self.numbers:
            raise UsageError(
                f"the result's effect {self.effect} at {self.location} has no number {name!r}"
            )
        return self.numbers[name].value


@dataclass(frozen=True)
class ExportOutcome:
    """`names` and `covariance` of the numbers, [n n], nan where unknown. `content` is the JSON
    itself.
    """

    kind: str
    model: str
    parameters: Mapping[str, Number]
    effects: tuple[Named, ...]
    robot: Mapping[str, Any]
    names: tuple[str, ...] = ()
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    content: Mapping[str, Any] = field(default_factory=dict)

    def renamed(self, joints: Mapping[str, str]) -> ExportOutcome:
        """The same with its locations under other joints' names."""

        def other(place):
            return joints.get(place, place)

        numbers = {}
        for name, number in self.parameters.items():
            field, at_sign, place = name.partition("@")
            numbers[f"{field}@{other(place)}" if at_sign else name] = number
        inputs = {"tau", "force", "u"} if len(joints) == 1 else set()

        def at(e):
            return next(iter(joints.values())) if e.location in inputs else other(e.location)

        return replace(
            self,
            parameters=numbers,
            effects=tuple(replace(e, location=at(e)) for e in self.effects),
        )

    @property
    def drive(self) -> Mapping[str, Any] | None:
        """The law that drove a robot, None where torques did."""
        return self.robot.get("drive")


def outcome(content: Any) -> ExportOutcome:
    """The numbers of a fit, a diagnosis or an identification. Raises `UsageError` for anything else
    and for a failed fit.
    """
    kind = content.get("kind") if isinstance(content, Mapping) else None
    if kind not in KINDS:
        raise UsageError(
            f"this is not a result of {', '.join(KINDS)}: give the JSON that jaxid fit, diagnose or"
            " identify wrote"
        )
    which = content.get("which") if kind == "diagnosis" else content
    effects = which.get("effects", []) if isinstance(which, Mapping) else []
    parameters = content.get("parameters", {})
    robot = content.get("robot") or {}
    _check_kinds(effects, parameters, robot)
    if kind != "identification" and not parameters and not effects:
        raise UsageError(
            "the result holds no numbers: the fit failed, and there is nothing to carry over"
        )
    names, matrix = _covariance(
        content.get("covariance"), content.get("names") if kind == "identification" else None
    )
    return ExportOutcome(
        kind=kind,
        model=_name(content.get("model"), "model"),
        parameters={_name(k, "parameters"): _number(k, v) for k, v in parameters.items()},
        effects=tuple(map(_effect, effects)),
        robot=robot_entry(robot),
        names=names,
        covariance=matrix,
        content=content,
    )


def tables(listed: Any) -> list[Mapping[str, Any]]:
    """The tables of a list in a result; none of what is no list."""
    if not isinstance(listed, list):
        return []
    return [entry for entry in listed if isinstance(entry, Mapping)]


def _name(value: Any, where: str) -> str:
    if not isinstance(value, str) or not re.fullmatch(NAME, value):
        raise UsageError(f"{where} of the result: {str(value)[:60]!r} is not a name")
    return value


def number(name: str, entry: Any) -> float:
    """A finite number of a result. Raises `UsageError`."""
    value = entry.get("value") if isinstance(entry, Mapping) else entry
    if not is_finite(value):
        raise UsageError(f"{name} of the result: {str(value)[:60]!r} is not a finite number")
    return float(value)


def _number(name: str, entry: Any) -> Number:
    value = number(name, entry)
    if not isinstance(entry, Mapping):
        return Number(value)
    std = entry.get("std")
    return Number(
        value=value,
        std=float(std) if is_finite(std) and std >= 0 else None,
        unit=str(entry.get("unit") or "")[:40],
        at_bound=bool(entry.get("at_bound")),
        lower=_bound(entry.get("lower"), -math.inf),
        upper=_bound(entry.get("upper"), math.inf),
    )


def _bound(entry: Any, none: float) -> float:
    return float(entry) if is_number(entry) else none


def _effect(entry: Any) -> Named:
    inside = entry.get("parameters", {}) if isinstance(entry, Mapping) else None
    if not isinstance(inside, Mapping):
        raise UsageError("an effect of the result needs `effect`, `location` and `parameters`")
    name = _name(entry.get("effect"), "effects")
    if not all(isinstance(k, str) and k.isidentifier() for k in inside):
        raise UsageError(f"the numbers of effect {name} in the result have names that are none")
    return Named(
        name,
        _name(entry.get("location"), name),
        {_name(k, name): _number(f"{name}.{k}", v) for k, v in inside.items()},
    )


def _check_kinds(effects: Any, parameters: Any, robot: Any) -> None:
    tables = isinstance(parameters, Mapping) and isinstance(robot, Mapping)
    if not isinstance(effects, list) or not tables:
        raise UsageError("effects, parameters or robot of the result are not what jaxid writes")
    if max(len(effects), len(parameters)) > MOST:
        raise UsageError(f"the result has more than {MOST} numbers or effects")


def _covariance(entry: Any, names: Any) -> tuple[tuple[str, ...], np.ndarray]:
    """(names, matrix), empty where the result has none."""
    rows = entry.get("matrix") if isinstance(entry, Mapping) else entry
    names = entry.get("names") if isinstance(entry, Mapping) else names
    if not isinstance(rows, list) or not isinstance(names, list):
        return (), np.zeros((0, 0))
    try:
        matrix = np.array(rows, float).reshape(len(rows), -1)  # nan for None
    except (TypeError, ValueError):
        raise UsageError("the covariance of the result is not a matrix") from None
    n = min(len(names), len(matrix), matrix.shape[1] if matrix.size else 0)
    return tuple(_name(k, "covariance") for k in names[:n]), matrix[:n, :n]


def robot_entry(robot: Mapping[str, Any]) -> dict[str, Any]:
    """What a result says of its robot, checked: its law's numbers are numbers, None where there is
    no limit.
    """
    if not robot:
        return {}
    held = robot.get("held") or {}
    base = robot.get("base") or {}
    place: dict[str, Any] = {k: number(k, base.get(k, 0.0)) for k in ("roll", "pitch", "yaw")}
    if base.get("kind") == "free":
        place["kind"] = "free"
    return {
        "file": str(robot.get("file") or "")[:4096],
        "sha256": str(robot.get("sha256") or "")[:64],
        "joints": _names(robot, "joints"),
        "leads": _names(robot, "leads"),
        "held": {_name(k, "robot.held"): number(k, v) for k, v in held.items()},
        "base": place,
        "without": _names(robot, "without"),
        "drive": _drive(robot.get("drive")),
        "simulator": _simulator(robot.get("simulator")),
    }


def _simulator(simulator: Any) -> dict[str, Any]:
    """Whose steps a result's simulations took, and the numbers for the file's own steps."""
    if not isinstance(simulator, Mapping):
        return {"kind": "own"}
    kind = simulator.get("kind")
    if kind not in ("mujoco", EXACT_STEPS):
        kind = "own"
    written = simulator.get("numbers") or {}
    if not written:
        return {"kind": kind}
    if not isinstance(written, Mapping) or len(written) > MOST:
        raise UsageError("robot.simulator.numbers of the result are not what jaxid writes")
    return {
        "kind": kind,
        "numbers": {_name(k, "numbers"): number(k, v) for k, v in written.items()},
        "hard": simulator.get("hard") is True,
    }


def _names(robot: Mapping[str, Any], key: str) -> list[str]:
    return [_name(name, f"robot.{key}") for name in robot.get(key) or []]


def _drive(drive: Any) -> dict[str, Any] | None:
    if not isinstance(drive, Mapping):
        return None
    joints = drive.get("joints")
    if not isinstance(joints, Mapping) or not all(isinstance(n, Mapping) for n in joints.values()):
        raise UsageError("robot.drive.joints of the result is not a table by joint")
    return {**drive, "joints": {_name(j, "drive"): _law(n) for j, n in joints.items()}}


def _law(numbers: Mapping[str, Any]) -> dict[str, float]:
    endless = {"lowest": -math.inf, "highest": math.inf}
    law = {}
    for key, value in numbers.items():
        without_limit = value is None and key in endless
        law[_name(key, "drive")] = endless[key] if without_limit else number(key, value)
    return law
