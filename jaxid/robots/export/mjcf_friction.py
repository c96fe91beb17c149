"""Dry friction in MuJoCo: a soft constraint, which attributes of the joint make harder."""

from __future__ import annotations

from collections.abc import Mapping

from jaxid.robots.export.target import APPROXIMATE, Field
from jaxid.robots.file_step import HARD_SOLIMP, HARD_SOLREF


#: What makes friction hard; the rest of solimp says nothing at the distance of zero where it acts.
HOLDS = {
    "solreffriction": " ".join(f"{number:g}" for number in HARD_SOLREF),
    "solimpfriction": " ".join(f"{number:g}" for number in HARD_SOLIMP[:2]),
}
SOFT = (
    "a soft constraint in MuJoCo: with solreffriction and solimpfriction as set here it creeps by"
    " less than 1e-4 rad/s, and the recording is nearer with them"
)
CREEPS = (
    "a soft constraint in MuJoCo that creeps: solreffriction and solimpfriction, which harden it,"
    " are left as they are"
)
UNTRIED = (
    "how hard dry friction is in MuJoCo (solreffriction, solimpfriction) is left as the file has"
    " it: the recording on which to try it was not found. Name it with --data DIR"
)


def friction_field(
    joint: str, level: float, present: Mapping[str, str], hardened: bool
) -> tuple[Field, dict[str, str]]:
    """The field of a joint's dry friction, and attributes beside it where it is to be `hardened`;
    `present` are those that the element has.
    """
    name = f"joint[{joint}]@frictionloss"
    stated = [k for k in HOLDS if k in present]
    if level == 0:
        return Field(name), {}
    if stated:
        left = (
            f"the file states {' and '.join(stated)}, which are left: they say how well friction"
            " holds"
        )
        return Field(name, APPROXIMATE, left), {}
    if hardened:
        return Field(name, APPROXIMATE, SOFT), dict(HOLDS)
    return Field(name, APPROXIMATE, CREEPS), {}
