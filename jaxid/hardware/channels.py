"""From recorded columns to the channels of a dataset: as they are, or as a model needs them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.base.wording import stem_and_number
from jaxid.data.dataset import Geometry
from jaxid.hardware.recorder import Column


def channel_map(
    model: str | None, columns: Sequence[Column], joint: int | None, gain: Sequence[float] | None
) -> dict[str, dict]:
    """`[channels]` of a dataset: as recorded, or as a model needs them.

    `model` is an id or a robot's file, whose joints are the device's in their order. With a model,
    torques are currents times a stated gain (N m/A), which stays visible as `scale`; `joint` picks
    one joint of several for a model with one. Raises `UsageError` where the model cannot be served.
    """
    columns = [c for c in columns if c.role != "clock"]
    have = {c.name: c for c in columns}
    if model is None:
        return {c.name: _channel(c) for c in columns}
    first = ""
    for wanted in _forms(model, joint, bool(gain)):
        chosen: dict[str, dict] = {}
        used = set()
        for channel, name, unit, role in wanted:
            entry, column = _serve(name, unit, role, have, joint, gain)
            if column is None:
                first = first or (entry if channel == name else f"for {channel!r} {entry}")
                break
            if column != channel:
                entry["column"] = column
            chosen[channel] = entry
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


def robot_of(model: str | None) -> Geometry | None:
    """The file of a robot that a recording is meant for, includes in place; None for a model."""
    if model is None:
        return None
    from jaxid.robots.match import is_file, spec_of_file

    return spec_of_file(model).geometry if is_file(model) else None


def joints_of(model: str | None) -> list[str]:
    """The joints of a robot's file that a device moves, in its order; none for a model."""
    from jaxid.robots.match import is_file, joints_that_move

    return list(joints_that_move(model)) if model is not None and is_file(model) else []


def _forms(model: str, joint: int | None, gain: bool) -> Iterator[list[tuple[str, str, str, str]]]:
    """What a model may be recorded by, the first that is there: (channel, the device's word for it,
    unit, role) of each.
    """
    from jaxid.robots.match import is_file, joints_that_move

    if not is_file(model):
        from jaxid.dynamics.catalogue import describe

        for signature in describe(model).signatures:
            inputs = [(name, name, unit, "input") for name, unit in signature.inputs]
            yield inputs + [(name, name, unit, "output") for name, unit in signature.outputs]
        return
    joints = joints_that_move(model)
    numbers = [""] if len(joints) == 1 else [str(k) for k in range(1, len(joints) + 1)]
    numbered = dict(zip(joints, numbers, strict=True))
    motion, goals, torques = [], [], []
    for name, slides in joints.items():
        number = numbered[name]
        motion.append((name, f"q{number}", "m" if slides else "rad", "output"))
        goals.append((f"{name}_cmd", f"q{number}_cmd", "m" if slides else "rad", "input"))
        torques.append((f"{name}_tau", f"tau{number}", "N" if slides else "N m", "input"))
    yield (torques if gain else goals) + motion
    yield (goals if gain else torques) + motion


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
    stem, number = stem_and_number(name)
    place = number or ("" if joint is None else str(joint))
    # `q_cmd` of a model is q3_cmd of joint 3.
    base, _, tail = stem.partition("_")
    joined = f"{base}{place}_{tail}" if tail else f"{base}{place}"
    for column in (joined, f"{stem}{place}", name):
        if column in have and have[column].unit == unit:
            return _channel(have[column]) | {"role": role}, column
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
