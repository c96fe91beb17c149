"""From recorded columns to the channels of a dataset: as they are, or as a model needs them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.hardware.recorder import Column


def channel_map(
    model: str | None, columns: Sequence[Column], joint: int | None, gain: Sequence[float] | None
) -> dict[str, dict]:
    """`[channels]` of a dataset: as recorded, or as a model needs them.

    With a model, torques are currents times a stated gain (N m/A), which stays visible as `scale`;
    `joint` picks one joint of several for a model with one. Raises `UsageError` where the model
    cannot be served.
    """
    columns = [c for c in columns if c.role != "clock"]
    have = {c.name: c for c in columns}
    if model is None:
        return {c.name: _channel(c) for c in columns}
    from jaxid.dynamics.catalogue import describe

    first, used = "", set()
    for signature in describe(model).signatures:
        wanted = [(n, u, "input") for n, u in signature.inputs] + [
            (n, u, "output") for n, u in signature.outputs
        ]
        chosen: dict[str, dict] = {}
        used = set()
        for name, unit, role in wanted:
            entry, column = _serve(name, unit, role, have, joint, gain)
            if column is None:
                first = first or entry
                break
            chosen[name] = entry
            used.add(column)
        else:
            # What the model does not need stays auxiliary; a column that is needed under another
            # name is not listed twice.
            rest = {
                c.name: _channel(c) | {"role": "auxiliary"}
                for c in columns
                if c.name not in used and c.name not in chosen
            }
            return chosen | rest
    raise UsageError(f"model {model}: {first}")


def _channel(c: Column) -> dict[str, Any]:
    entry = {"role": c.role, "unit": c.unit, "noise_std": c.noise_std, "resolution": c.resolution}
    entry |= {"hold": c.hold} if c.hold != "zero" else {}
    return {k: v for k, v in entry.items() if v is not None}


def _serve(
    name: str,
    unit: str,
    role: str,
    have: Mapping[str, Column],
    joint: int | None,
    gain: Sequence[float] | None,
) -> tuple[Any, str | None]:
    """The channel entry for one name of a model's signature and its column; or a sentence and
    None.
    """
    stem = name.rstrip("0123456789")
    number = name[len(stem) :]
    place = number or ("" if joint is None else str(joint))
    # `q_cmd` of a model is q3_cmd of joint 3.
    base, _, tail = stem.partition("_")
    joined = f"{base}{place}_{tail}" if tail else f"{base}{place}"
    for column in (joined, f"{stem}{place}", name):
        if column in have and have[column].unit == unit:
            entry = _channel(have[column]) | {"role": role}
            if column != name:
                entry["column"] = column
            return entry, column
    if stem == "tau":
        column = _current_of(place, have)
        if column is not None:
            return _torque_by_current(name, unit, role, have[column], place, gain)
    stems = (stem, "current") if stem == "tau" else (stem,)
    several = sorted(c for c in have if c.rstrip("0123456789") in stems)
    hint = ""
    if several and not number and joint is None:
        hint = f" (there is: {', '.join(several)}; pick one with --joint)"
    return f"it needs {name!r} in {unit}, which this device does not record{hint}", None


def _current_of(place: str, have: Mapping[str, Column]) -> str | None:
    """The column of a joint's current: one that drives the motion, or else one that is measured."""
    named = [c for c in (f"current{place}", f"current{place}_cmd") if c in have]
    inputs = [c for c in named if have[c].role == "input"]
    return next(iter([*inputs, *named]), None)


def _torque_by_current(
    name: str, unit: str, role: str, current: Column, place: str, gain: Sequence[float] | None
) -> tuple[Any, str | None]:
    """A joint's torque as its current times a gain; or a sentence and None. See `_serve`."""
    if gain is None:
        return (
            f"it needs the torque {name!r}, and the device has a current, {current.name!r}. State"
            " the gain you assume in N m/A (--gain); it stays visible in dataset.toml as `scale`",
            None,
        )
    k = int(place) - 1 if place and len(gain) > 1 else 0
    if k >= len(gain):
        return f"there are {len(gain)} gains, none for joint {place}", None
    scale = float(gain[k])
    entry = {"role": role, "unit": unit, "column": current.name, "scale": scale}
    if current.resolution is not None:
        entry["resolution"] = abs(scale) * current.resolution
    return entry, current.name
