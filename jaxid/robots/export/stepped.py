"""A result in the terms of a file whose simulator steps: what its steps add by themselves is not
written a second time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from jaxid.robots.export.law_code import own_number
from jaxid.robots.export.outcome import ExportOutcome, Named, Number, tables
from jaxid.robots.export.sheet import JointNumbers, Sheet
from jaxid.robots.steps import nearest, Steps


ARMATURE = "armature"
#: A stated number is refuted beyond this many standard deviations.
REFUTED = 3.0
#: Of a machine that takes no steps.
FOLLOWS = "numbers are those with which the file follows the machine best in its own {}"
#: What of a joint is later by the steps, by a fit's number or by an effect.
DELAY = "delay"


def stepped(found: ExportOutcome, sheet: Sheet) -> tuple[ExportOutcome, tuple[str, ...]]:
    """The result with its armatures less, and its delays more, what the steps of the file's
    simulator make of them; and what is to be said of that. `sheet`: the robot before.
    """
    steps = sheet.tree.steps if sheet.tree is not None else None
    simulator = found.robot.get("simulator", {})
    own = sheet.tree.simulator if sheet.tree is not None else None
    if simulator.get("numbers") and own is not None:
        return _in_its_steps(found, simulator), (FOLLOWS.format(own.said),)
    if steps is None or simulator.get("kind") == "mujoco":
        return found, ()
    stated = _stated(found)
    numbers = dict(found.parameters)
    for name, n in found.parameters.items():
        kind, _, place = name.partition("@")
        if kind == ARMATURE and place in sheet.before:
            added = _added(steps, found, place, sheet.before[place])
            held = stated.get(name, sheet.before[place].armature)
            numbers[name] = replace(n, value=_in_file(held, n, added))
        elif kind == DELAY:
            numbers[name] = _later(steps, n, stated.get(name))
    effects = tuple(_late(steps, e) for e in found.effects)
    changed = effects != found.effects or numbers != found.parameters
    note = (
        f"armatures and delays are those of {steps.said}, which add h / 2 of all damping to an"
        " inertia and act h / 2 early"
    )
    return replace(found, parameters=numbers, effects=effects), (note,) if changed else ()


def _in_its_steps(found: ExportOutcome, simulator: Mapping[str, Any]) -> ExportOutcome:
    """The result with numbers that were fitted in the file's own steps."""
    written, parameters = simulator["numbers"], {}
    for name, n in found.parameters.items():
        parameters[name] = replace(n, value=written.get(name, n.value))
    effects = []
    for e in found.effects:
        numbers = {}
        for field, n in e.numbers.items():
            own = f"{e.effect}.{field}@{e.location}"
            numbers[field] = replace(n, value=written.get(own, n.value))
        effects.append(replace(e, numbers=numbers))
    robot = {**found.robot, "simulator": {"kind": "mujoco", "hard": simulator.get("hard", False)}}
    return replace(found, parameters=parameters, effects=tuple(effects), robot=robot)


def _stated(found: ExportOutcome) -> dict[str, float]:
    out = {}
    for row in tables(found.content.get("stated")):
        value = row.get("stated")
        if isinstance(value, int | float):
            out[f"{row.get('parameter')}@{row.get('joint')}"] = float(value)
    return out


def _in_file(stated: float, n: Number, added: float) -> float:
    """What the file has to state: as near to what it states as `added` allows while the data do not
    refute that, else all of it less.
    """
    near = nearest(stated, n.value, added)
    refuted = n.std is None or abs(near - stated) > REFUTED * n.std
    return max(0.0, n.value - added) if refuted else near


def _added(steps: Steps, found: ExportOutcome, joint: str, before: JointNumbers) -> float:
    def value(kind: str, otherwise: float) -> float:
        own = found.parameters.get(f"{kind}@{joint}")
        return otherwise if own is None else own.value

    return steps.inertia(value("damping", before.damping), value("kd", before.kd))


def _later(steps: Steps, n: Number, stated: float | None = None) -> Number:
    """A delay as the file has to state it; one that is stated stays where the data and the steps
    allow it.
    """
    if n.value <= 0:
        return n
    later = n.value + steps.delay
    if stated is not None and n.std is not None:
        near = nearest(stated, later, steps.delay)
        later = near if abs(near - stated) <= REFUTED * n.std else later
    return replace(n, value=later)


def _late(steps: Steps, effect: Named) -> Named:
    own = own_number(effect.effect)
    if own is None or not _is_delay(effect.effect) or own.number not in effect.numbers:
        return effect
    later = _later(steps, effect.numbers[own.number])
    return replace(effect, numbers={**effect.numbers, own.number: later})


def shifted(name: str) -> bool:
    """Whether the steps of a simulator shift a number of a fit, or an effect."""
    return name in (ARMATURE, DELAY) or _is_delay(name)


def _is_delay(effect: str) -> bool:
    """Whether the delay of a joint's command is what an effect stands for."""
    own = own_number(effect)
    return own is not None and own.quantity == DELAY
