"""A page for each effect, written from the effect's own file."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any


#: From the command to the sensor: what `acts_on` calls each place, and what it is called here.
PLACES = {
    "command": "command",
    "drive": "drive",
    "joint": "joint",
    "body": "links",
    "sensor": "sensor",
}
#: What an expression of an export is, by its port.
PORTS = {
    "force": "a torque that opposes positive motion, added at the joint",
    "dry": "the level of dry friction at the joint",
    "command": "the command, before the drive",
    "torque": "the torque of the drive",
    "reading": "what the sensor reads",
}
#: Below a picture of a signature.
COLOURS = "Computed for a rich motion; of a force, blue is forwards and orange backwards."
#: Numbers of a joint that MJCF has under the same name.
MJCF = ("damping", "armature", "frictionloss", "stiffness", "springref")
TARGETS = ("mjcf", "urdf", "isaaclab", "mjlab", "sdf", "drake", "ros2_control", "genesis")


def write(folder: Path, pictures: Path, mates: Callable[[str], str | None]) -> None:
    """Writes NAME.md for each effect; `mates` says what it cannot be told from."""
    from jaxid.dynamics import catalogue

    folder.mkdir(parents=True, exist_ok=True)
    for name in catalogue.effect_names():
        drawn = (pictures / f"{name}.svg").is_file()
        (folder / f"{name}.md").write_text(page(name, drawn, mates(name)), encoding="utf-8")


def page(name: str, drawn: bool, mates: str | None) -> str:
    """The page of an effect; `drawn`: whether there is a picture of its signature."""
    from generate import plain  # pyright: ignore[reportMissingImports]

    from jaxid.dynamics import catalogue

    info, kind = catalogue.describe_effect(name), catalogue.effect_class(name)
    out = [f"# {name}", "", plain(info.text), ""]
    if kind.plain:
        out += [f"In a result: {in_a_result(kind.plain)}", ""]
    out += ["## What it looks like", "", _sentence(plain(info.signature)), ""]
    if drawn:
        out += [f"```{{image}} ../signatures/{name}.svg", f":alt: missing force left by {name}"]
        out += ["```", "", COLOURS, ""]
    place = kind.acts_on
    if place == "timing":
        place = "sensor" if info.family == "sensor" else "command"
    out += ["## Where it acts", "", "```text", sketch(place), "```", ""]
    out += [f"Location in commands: {plain(info.locations)}.", ""]
    out += [
        "## Equation",
        "",
        "```text",
        info.equation,
        "```",
        "",
        f"Source: {plain(info.source)}.",
        "",
    ]
    if info.parameters:
        out += ["| number | unit | meaning |", "| --- | --- | --- |"]
        out += [f"| `{p.name}` | {plain(p.unit)} | {plain(p.meaning)} |" for p in info.parameters]
        out += [""]
    out += ["## What it is confused with", "", confused(kind, mates), ""]
    out += ["## What to record", "", _sentence(plain(info.what_to_record)), ""]
    if kind.check:
        out += ["## What to look at on the machine", "", plain(kind.check), ""]
    out += ["## What to write in a simulator", "", *written(kind), ""]
    return "\n".join(out)


def sketch(place: str) -> str:
    """The way from command to sensor, with the place marked."""
    marked = [f"[{shown.upper()}]" if place == own else shown for own, shown in PLACES.items()]
    way = " --> ".join(marked)
    return way if place in PLACES else f"{way}      (changes a number of the model)"


def in_a_result(sentence: str) -> str:
    """What a result says of the effect, with the names of its numbers in the place of these."""
    from generate import plain  # pyright: ignore[reportMissingImports]

    parts = re.split(r"\{(\w+)[^}]*\}", sentence)
    return "".join(f"`{part}`" if k % 2 else plain(part) for k, part in enumerate(parts))


def confused(kind: Any, mates: str | None) -> str:
    """What looks alike: stated in the effect's file, and computed for models; `mates` is None where
    nothing was computed of it.
    """
    said = []
    if kind.resembles:
        said.append(f"By its form: {', '.join(f'`{name}`' for name in kind.resembles)}.")
    if kind.refines:
        said.append(f"It refines `{kind.refines}`, which does as well where the motion is poor.")
    if mates:
        said.append(f"In an open loop with rich excitation: {mates}.")
    alone = "Rich excitation tells it from every other effect of the library."
    asked = "A diagnosis says what its recording cannot tell from it, as `confusable_with`."
    return " ".join(said) or (asked if mates is None else alone)


def written(kind: Any) -> list[str]:
    """What to write in each simulator, as the export does it."""
    out = []
    stands = kind.stands_for
    if stands is not None and stands.quantity in MJCF:
        out += [
            f"MJCF and mjlab: the joint's attribute `{stands.quantity}`, from `{stands.number}`.",
            "",
        ]
    elif stands is not None:
        out += [
            f"Where a target has a field for it: {stands.quantity}, from `{stands.number}`.",
            "",
        ]
    law = kind.export_law
    if isinstance(law, str) and law:
        out += [f"As code it is not written: {law}.", ""]
    elif law and law.text:
        out += [f"As code, for {PORTS[law.port]}:", "", "```python", law.text, "```", ""]
    elif law:
        out += [f"As code with a memory, for {PORTS[law.port]}: {law.words}", ""]
    out += [
        "The command writes what has a field, with the numbers of your result, and says which are",
        "exact and which are left out:",
        "",
    ]
    out += ["```sh", f"jaxid export diagnosis.json --to {TARGETS[0]} --out fixed", "```", ""]
    out += [f"Other targets: {', '.join(f'`{target}`' for target in TARGETS[1:])}."]
    return out


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".") + "."
