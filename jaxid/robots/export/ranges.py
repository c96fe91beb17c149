"""What the data leave open, as ranges for domain randomisation: mean, standard deviation, 95 % interval, correlations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxid.robots.export.outcome import Number, Outcome


#: Standard deviations to either side of a 95 % interval of a normal distribution.
NORMAL_95 = 1.959963984540054
#: Numbers that are not negative.
POSITIVE = ("damping", "frictionloss", "armature", "mass", "kp", "kd", "delay", "timeconst", "stiffness", "quadratic_damping")


@dataclass(frozen=True)
class Ranges:
    """`table` as `ranges.json` holds it; `files` in the framework's own form."""

    table: Mapping[str, Any]
    files: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def ranges_of(found: Outcome, to: str) -> Ranges:
    """The ranges of a result's numbers. Numbers that the data do not determine have none, and are listed."""
    numbers = {k: n for k, n in found.parameters.items()}
    if found.kind == "identification":
        numbers = _identified(found)
    for e in found.effects:
        numbers |= {f"{e.effect}.{k}@{e.location}": n for k, n in e.numbers.items()}
    rows: dict[str, Any] = {}
    left: list[str] = []
    for name, n in numbers.items():
        if n.std is None:
            left.append(name)
            continue
        low, high = n.value - NORMAL_95 * n.std, n.value + NORMAL_95 * n.std
        if name.partition("@")[0] in POSITIVE:
            low = max(0.0, low)
        rows[name] = {"mean": n.value, "std": n.std, "interval_95": [low, high], "unit": n.unit}
    names, correlation = _correlation(found, list(rows))
    table = {"numbers": rows, "not_determined": left, "correlation": {"names": names, "matrix": correlation}}
    notes = () if names else ("the result holds no covariance: numbers are taken as independent",)
    own = OWN.get(to)
    return Ranges(table, {} if own is None else {f"ranges_{to}.py": own(rows)}, notes)


def _identified(found: Outcome) -> dict[str, Number]:
    """Base parameters and friction, by the names that a fit would have."""
    out: dict[str, Number] = {}
    listed, friction = found.content.get("base_parameters"), found.content.get("friction")
    for r in listed if isinstance(listed, list) else []:
        if isinstance(r, Mapping) and (n := _number(r)) is not None:
            out[str(r.get("name"))[:200]] = n
    for r in friction if isinstance(friction, list) else []:
        for k, entry in r.items() if isinstance(r, Mapping) else ():
            if (n := _number(entry)) is not None:
                out[f"{k}@{r.get('joint')}"[:200]] = n
    return out


def _number(entry: Any) -> Number | None:
    known = lambda v: isinstance(v, int | float) and not isinstance(v, bool)
    if not isinstance(entry, Mapping) or not known(entry.get("value")):
        return None
    std = entry.get("std")
    return Number(float(entry["value"]), float(std) if known(std) else None, str(entry.get("unit") or "")[:40])  # type: ignore[arg-type]


def _correlation(found: Outcome, wanted: list[str]) -> tuple[list[str], list[list[float | None]]]:
    """(names, matrix) of those numbers that the covariance holds."""
    std = np.sqrt(np.maximum(np.diag(found.covariance), 0.0)) if found.covariance.size else np.zeros(0)
    keep = [i for i in range(len(found.names)) if std[i] > 0]
    C = found.covariance[np.ix_(keep, keep)] / std[keep] / std[keep][:, None] if keep else np.zeros((0, 0))
    return [found.names[i] for i in keep], [[None if not np.isfinite(v) else float(np.clip(v, -1, 1)) for v in row] for row in C]


def _by_field(rows: Mapping[str, Any], field: str) -> dict[str, list[float]]:
    return {k.partition("@")[2]: r["interval_95"] for k, r in rows.items() if k.partition("@")[0] == field}


def _mjlab(rows: Mapping[str, Any]) -> str:
    lines = ['"""Events of domain randomisation by what was measured; written for mjlab 1.6, not run."""', "",
             "from mjlab.envs.mdp import dr", "from mjlab.managers.event_manager import EventTermCfg",
             "from mjlab.managers.scene_entity_config import SceneEntityCfg", "", "EVENTS = {"]  # fmt: skip
    for quantity, function in (("damping", "joint_damping"), ("frictionloss", "joint_friction"), ("armature", "joint_armature")):
        for joint, interval in _by_field(rows, quantity).items():
            lines += [
                f"    {f'{quantity}_{joint}'!r}: EventTermCfg(", f'        func=dr.{function}, mode="startup",',
                f'        params={{"asset_cfg": SceneEntityCfg("robot", joint_names=({joint!r},)),',
                f'                "ranges": {tuple(interval)!r}, "operation": "abs"}},', "    ),",
            ]  # fmt: skip
    return "\n".join([*lines, "}", ""])


def _isaaclab(rows: Mapping[str, Any]) -> str:
    lines = ['"""Events of domain randomisation by what was measured; written for Isaac Lab 3.0, not run."""', "",
             "from isaaclab.envs import mdp", "from isaaclab.managers import EventTermCfg, SceneEntityCfg", "",
             "EVENTS = {"]  # fmt: skip
    for quantity, function, key in (
        ("armature", "randomize_joint_parameters", "armature_distribution_params"),
        ("frictionloss", "randomize_joint_parameters", "friction_distribution_params"),
        ("kp", "randomize_actuator_gains", "stiffness_distribution_params"),
        ("kd", "randomize_actuator_gains", "damping_distribution_params"),
    ):
        for joint, interval in _by_field(rows, quantity).items():
            lines += [
                f"    {f'{quantity}_{joint}'!r}: EventTermCfg(", f'        func=mdp.{function}, mode="startup",',
                f'        params={{"asset_cfg": SceneEntityCfg("robot", joint_names=[{joint!r}]), {key!r}: {tuple(interval)!r},',
                '                "operation": "abs", "distribution": "uniform"},', "    ),",
            ]  # fmt: skip
    return "\n".join([*lines, "}", ""])


OWN = {"mjlab": _mjlab, "isaaclab": _isaaclab}
