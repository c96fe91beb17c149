"""Bodies of a robot's file that cannot exist: what is simulated is not what the file says."""

from __future__ import annotations

from pathlib import PurePath
from typing import Any

from jaxid.conventions.finding import DataFinding


def impossible(mechanism: Any) -> list[DataFinding]:
    """Of each link with an inertia that no body has a finding; none where the mechanism is no
    robot's.
    """
    held = getattr(mechanism, "tree", None)
    if held is None:
        return []
    tree = held.tree
    file = PurePath(tree.file).name or "the robot"
    moving = [(link, fault) for link, fault in tree.impossible if tree.floats or link != tree.base]
    return [_finding(file, link, fault) for link, fault in moving]


def _finding(file: str, link: str, fault: str) -> DataFinding:
    text = (
        f"{file}: {fault}. No body has it, and MuJoCo refuses the file. The nearest body that can"
        f" exist is simulated. Correct <inertia> of link {link!r} in the file: a sign may be lost,"
        " or its axes may be those of another frame."
    )
    # It is so whatever is asked for: nothing can be simulated as the file has it.
    return DataFinding(
        "impossible_body",
        link,
        None,
        text,
        decisive=True,
        applied=True,
        headline=(
            f"link {link!r} of {file} has an inertia that no body has; everything below has the"
            " nearest body that can exist"
        ),
    )
