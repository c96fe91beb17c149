"""What the data leave open, as ranges for domain randomisation: mean, standard deviation, 95 %
interval, correlations.

Together they are one distribution, that of the covariance of the result. Where a number stands at
its bound, its interval and those of the numbers that trade for it go to one side. What is known of
a sum or a ratio only holds where numbers are drawn together: `draws` are such. Events of a
framework draw each number by itself; theirs are what each may be beside the others as written.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxid.base.numbers import is_number
from jaxid.numerics.drawn import beside_the_others, draws
from jaxid.numerics.truncated import positive
from jaxid.robots.export.outcome import ExportOutcome, Number, tables


#: Standard deviations to either side of a 95 % interval of a normal distribution.
NORMAL_95 = 1.959963984540054
#: Draws of all numbers together, and the digits that each is written with.
DRAWS, DIGITS = 200, 7
#: Numbers that are not negative.
POSITIVE = (
    "damping",
    "frictionloss",
    "armature",
    "mass",
    "kp",
    "kd",
    "delay",
    "timeconst",
    "stiffness",
    "quadratic_damping",
)


@dataclass(frozen=True)
class Ranges:
    """`table` as `ranges.json` holds it; `files` in the framework's own form."""

    table: Mapping[str, Any]
    files: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def ranges_of(found: ExportOutcome, to: str, written: ExportOutcome | None = None) -> Ranges:
    """The ranges of a result's numbers. Numbers that the data do not determine have none, and are
    listed. `written`: the result with the numbers as they go into a file.
    """
    numbers = {k: n for k, n in found.parameters.items()}
    if found.kind == "identification":
        numbers = _identified(found)
    for e in found.effects:
        numbers |= {f"{e.effect}.{k}@{e.location}": n for k, n in e.numbers.items()}
    intervals = _intervals(found, numbers)
    rows: dict[str, Any] = {}
    left: list[str] = []
    for name, n in numbers.items():
        if n.std is None:
            left.append(name)
            continue
        low, high = intervals[name]
        if name.partition("@")[0] in POSITIVE:
            low = max(0.0, low)
        rows[name] = {"mean": n.value, "std": n.std, "interval_95": [low, high], "unit": n.unit}
    names, correlation = _correlation(found, list(rows))
    table = {
        "numbers": rows,
        "not_determined": left,
        "correlation": {"names": names, "matrix": correlation},
        "draws": _draws(found, {name: numbers[name] for name in rows}),
    }
    notes = () if names else ("the result holds no covariance: numbers are taken as independent",)
    own = OWN.get(to)
    if own is None:
        return Ranges(table, {}, notes)
    alone = _one_by_one(found, written or found, rows)
    return Ranges(table, {f"ranges_{to}.py": own(alone)}, notes)


def _lowest(name: str, n: Number) -> float:
    return max(0.0, n.lower) if name.partition("@")[0] in POSITIVE else n.lower


def _draws(found: ExportOutcome, numbers: Mapping[str, Number]) -> dict[str, Any]:
    """Numbers drawn together, within their bounds: a row of `values` for each draw."""
    names = list(numbers)
    every = list(numbers.values())
    C = np.diag([float(n.std or 0.0) ** 2 for n in every])
    shared, own = _shared(found, names)
    if own.size and np.isfinite(own).all():
        at = [names.index(name) for name in shared]
        C[np.ix_(at, at)] = own
    low = np.array([_lowest(name, n) for name, n in numbers.items()])
    high = np.array([n.upper for n in every])
    mean = np.array([n.value for n in every])
    values = draws(mean, C, low, high, DRAWS) if names else np.zeros((0, 0))
    return {"names": names, "values": [list(map(_digits, row)) for row in values]}


def _digits(x: float) -> float:
    return float(f"{x:.{DIGITS}g}")


def _one_by_one(
    found: ExportOutcome, written: ExportOutcome, rows: Mapping[str, Mapping[str, Any]]
) -> dict[str, Mapping[str, Any]]:
    """The rows with what each number may be beside the others as they are written."""
    names, C = _shared(found, list(rows))
    if not C.size or not np.isfinite(C).all():
        return dict(rows)
    out = dict(rows)
    for name, std in zip(names, beside_the_others(C), strict=True):
        n = written.parameters.get(name)
        if n is None:
            continue
        reach = NORMAL_95 * float(std)
        interval = [max(_lowest(name, n), n.value - reach), min(n.upper, n.value + reach)]
        out[name] = {**rows[name], "interval_95": interval}
    return out


def _identified(found: ExportOutcome) -> dict[str, Number]:
    """Base parameters and friction, by the names that a fit would have."""
    out: dict[str, Number] = {}
    for row in tables(found.content.get("base_parameters")):
        _add(out, str(row.get("name")), row)
    for row in tables(found.content.get("friction")):
        for key, entry in row.items():
            _add(out, f"{key}@{row.get('joint')}", entry)
    return out


def _add(numbers: dict[str, Number], name: str, entry: Any) -> None:
    """Adds what is a number."""
    number = _number(entry)
    if number is not None:
        numbers[name[:200]] = number


def _number(entry: Any) -> Number | None:
    if not isinstance(entry, Mapping) or not is_number(entry.get("value")):
        return None
    std = entry.get("std")
    spread = float(std) if is_number(std) else None
    return Number(float(entry["value"]), spread, str(entry.get("unit") or "")[:40])


def _shared(found: ExportOutcome, wanted: Iterable[str]) -> tuple[list[str], np.ndarray]:
    """(names, covariance) of those of the wanted numbers that the result's covariance holds."""
    asked = set(wanted)
    size = np.diag(found.covariance) if found.covariance.size else np.zeros(0)
    keep = [i for i, name in enumerate(found.names) if name in asked and size[i] > 0]
    return [found.names[i] for i in keep], found.covariance[np.ix_(keep, keep)]


def _intervals(
    found: ExportOutcome, numbers: Mapping[str, Number]
) -> dict[str, tuple[float, float]]:
    """95 % of each number that has a standard deviation.

    What stands at a bound has half of its own, by its root mean square from there; a number that
    trades for it moves with it to one side, and by what is its own to both.
    """
    known = {name: n for name, n in numbers.items() if n.std is not None}
    sides = {name: _side(n) for name, n in known.items()}
    alone = {name: NORMAL_95 * (n.std or 0.0) for name, n in known.items()}
    reach = {name: (size, size) for name, size in alone.items()} | _beside_bounds(found, sides)
    out = {}
    for name, n in known.items():
        down, up = reach[name]
        if sides[name] > 0:
            down = 0.0
        if sides[name] < 0:
            up = 0.0
        out[name] = max(n.lower, n.value - down), min(n.upper, n.value + up)
    return out


def _beside_bounds(
    found: ExportOutcome, sides: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """(down, up) of 95 % of each number that may trade for one that stands at its bound."""
    names, C = _shared(found, sides)
    at = [k for k, name in enumerate(names) if sides[name]]
    if not at or not np.isfinite(C).all():
        return {}
    variance = np.diag(C)
    pull = C[:, at] @ np.linalg.pinv(C[np.ix_(at, at)], hermitian=True)
    own = np.maximum(variance - np.einsum("ij,ij->i", pull, C[:, at]), 0.0)
    away = [sides[names[k]] for k in at]
    reach = pull * (np.sqrt(variance[at]) * away)
    down = NORMAL_95 * np.sqrt(own + np.sum(np.minimum(reach, 0.0) ** 2, 1))
    up = NORMAL_95 * np.sqrt(own + np.sum(np.maximum(reach, 0.0) ** 2, 1))
    return {name: (float(down[k]), float(up[k])) for k, name in enumerate(names)}


def _side(n: Number) -> float:
    """To which side of its bound a number can go, 0 where it stands at none."""
    if not n.at_bound:
        return 0.0
    return 1.0 if n.value - n.lower <= n.upper - n.value else -1.0


def _correlation(
    found: ExportOutcome, wanted: Iterable[str]
) -> tuple[list[str], list[list[float | None]]]:
    """(names, matrix) of those numbers that the covariance holds."""
    names, C = _shared(found, wanted)
    if C.size and np.isfinite(C).all():
        C = positive(C)
    size = np.sqrt(np.diag(C))
    R = C / np.outer(size, size)
    rows: list[list[float | None]] = np.clip(R, -1, 1).tolist()
    for i, j in np.argwhere(~np.isfinite(R)):
        rows[i][j] = None
    return names, rows


def _by_field(rows: Mapping[str, Any], field: str) -> dict[str, list[float]]:
    return {
        k.partition("@")[2]: r["interval_95"]
        for k, r in rows.items()
        if k.partition("@")[0] == field
    }


def _mjlab(rows: Mapping[str, Any]) -> str:
    lines = [
        (
            '"""Events of domain randomisation by what was measured; written for mjlab 1.6, not'
            ' run."""'
        ),
        "",
        "from mjlab.envs.mdp import dr",
        "from mjlab.managers.event_manager import EventTermCfg",
        "from mjlab.managers.scene_entity_config import SceneEntityCfg",
        "",
        "EVENTS = {",
    ]
    for quantity, function in (
        ("damping", "joint_damping"),
        ("frictionloss", "joint_friction"),
        ("armature", "joint_armature"),
    ):
        for joint, interval in _by_field(rows, quantity).items():
            lines += [
                f"    {f'{quantity}_{joint}'!r}: EventTermCfg(",
                f'        func=dr.{function}, mode="startup",',
                f'        params={{"asset_cfg": SceneEntityCfg("robot", joint_names=({joint!r},)),',
                f'                "ranges": {tuple(interval)!r}, "operation": "abs"}},',
                "    ),",
            ]
    return "\n".join([*lines, "}", ""])


def _isaaclab(rows: Mapping[str, Any]) -> str:
    lines = [
        (
            '"""Events of domain randomisation by what was measured; written for Isaac Lab 3.0, not'
            ' run."""'
        ),
        "",
        "from isaaclab.envs import mdp",
        "from isaaclab.managers import EventTermCfg, SceneEntityCfg",
        "",
        "EVENTS = {",
    ]
    for quantity, function, key in (
        ("armature", "randomize_joint_parameters", "armature_distribution_params"),
        ("frictionloss", "randomize_joint_parameters", "friction_distribution_params"),
        ("kp", "randomize_actuator_gains", "stiffness_distribution_params"),
        ("kd", "randomize_actuator_gains", "damping_distribution_params"),
    ):
        for joint, interval in _by_field(rows, quantity).items():
            lines += [
                f"    {f'{quantity}_{joint}'!r}: EventTermCfg(",
                f'        func=mdp.{function}, mode="startup",',
                (
                    '        params={"asset_cfg": SceneEntityCfg("robot",'
                    f" joint_names=[{joint!r}]), {key!r}: {tuple(interval)!r},"
                ),
                '                "operation": "abs", "distribution": "uniform"},',
                "    ),",
            ]
    return "\n".join([*lines, "}", ""])


OWN = {"mjlab": _mjlab, "isaaclab": _isaaclab}
