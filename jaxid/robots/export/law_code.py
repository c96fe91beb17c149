"""Code for what no field says: laws of effects as expressions that NumPy and PyTorch both run."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from jaxid.dynamics.effect import Effect, OWN_EFFECTS
from jaxid.dynamics.export_law import ExportLaw, in_python, SIGNALS, StandsFor
from jaxid.dynamics.law_in_c import in_c
from jaxid.dynamics.parameter import specs
from jaxid.models.effects import LIBRARY
from jaxid.robots.export.sheet import RobotChange


#: Port -> table of the module, and what an entry of it is.
PORTS = {
    "force": (
        "FORCE",
        "joint -> torque against positive motion: subtract it from the joint's torque",
    ),
    "dry": (
        "DRY",
        (
            "joint -> level of dry friction beside the file's own: |f| <= level while the joint"
            " sticks, level sign(qd) else"
        ),
    ),
    "command": ("COMMAND", "channel -> what arrives of a command u"),
    "torque": ("TORQUE", "channel -> what arrives of a drive torque u"),
    "reading": ("READING", "channel -> what the sensor says of a true value y"),
}
#: Port -> arguments of an entry.
ARGUMENTS = {
    "force": "q, qd, load, dt",
    "dry": "q, qd, load, dt",
    "command": "u, dt",
    "torque": "u, dt",
    "reading": "y, dt",
}


def kind_of(effect: str) -> type[Effect] | None:
    """The class of an effect of the library, or of the user's own; None: it is not known here."""
    own = next((kind for kind in LIBRARY if kind.name == effect), None)
    return own or OWN_EFFECTS.get(effect)


def own_number(effect: str) -> StandsFor | None:
    """The number of a robot that an effect is, where the robot itself has that law."""
    kind = kind_of(effect)
    number = None if kind is None else kind.stands_for
    return number if number is not None and number.fitted else None


def law_of(effect: str) -> ExportLaw | None:
    """How an effect is written as code; None: it is not."""
    kind = kind_of(effect)
    law = None if kind is None else kind.export_law
    return law if isinstance(law, ExportLaw) else None


def why_not(effect: str) -> str:
    """Why no code beside a simulator can be an effect, "" where nothing is known of that."""
    kind = kind_of(effect)
    law = "" if kind is None else kind.export_law
    return law if isinstance(law, str) else ""


def code(changes: Iterable[RobotChange], head: str, tail: str = "", library: str = "numpy") -> str:
    """A Python module with the laws of these changes: tables FORCE, DRY, COMMAND, TORQUE,
    READING.
    """
    tables: dict[str, list[str]] = {port: [] for port in PORTS}
    memories: dict[str, None] = {}
    for change in changes:
        law = _law(change)
        key = change.place if law.port in ("force", "dry") else change.location
        term = _term(law, _numbers(change))
        tables[law.port].append(f"    ({key!r}, {term}),  # {change.effect}")
        if law.memory:
            memories[law.memory] = None
    body = [f'"""{head}\n"""\n', f"import {library} as xp\n"]
    body += [f"\n{text}" for text in memories]
    for port, (name, meaning) in PORTS.items():
        if tables[port]:
            body.append(f"\n#: {meaning}\n{name} = [\n" + "\n".join(tables[port]) + "\n]\n")
    return "\n".join(body) + tail


def c_code(changes: Iterable[RobotChange], head: str) -> str:
    """A header of C with a function for each law of these changes that remembers nothing."""
    functions = []
    for change in changes:
        law = _law(change)
        name = re.sub(r"\W", "_", f"{change.location}_{change.effect}")
        arguments = ", ".join(f"double {signal}" for signal in SIGNALS[law.port])
        _, meaning = PORTS[law.port]
        functions.append(
            f"/* {change.location}: {meaning} */\n"
            f"static double {name}({arguments}) {{\n"
            f"  return {in_c(law, _numbers(change))};\n"
            "}\n"
        )
    return "\n".join([f"/* {head} */\n\n#include <math.h>\n", *functions])


def _law(change: RobotChange) -> ExportLaw:
    law = law_of(change.quantity)
    assert law is not None
    return law


def _numbers(change: RobotChange) -> dict[str, float]:
    """The effect's numbers; one that a result lacks is neutral."""
    kind = kind_of(change.quantity)
    assert kind is not None
    neutral = {name: spec.value for name, spec in specs(kind).items()}
    return {**neutral, **change.value}


def _term(law: ExportLaw, numbers: Mapping[str, float]) -> str:
    if not law.memory:
        return f"lambda {ARGUMENTS[law.port]}: {in_python(law, numbers)}"
    name = law.memory.partition("class ")[2].partition(":")[0]
    given = ", ".join(f"{key}={float(value)!r}" for key, value in numbers.items())
    return f"{name}({given})"


def lawful(changes: Iterable[RobotChange]) -> list[RobotChange]:
    """Those changes that have code and a place."""
    return [c for c in changes if c.place and isinstance(c.value, Mapping) and law_of(c.quantity)]
