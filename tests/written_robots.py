"""Robots of our own writing as MJCF, for tests: every kind of tree that jaxid reads."""

from __future__ import annotations

import numpy as np


def _body(
    rng: np.random.Generator,
    name: str,
    joints: str,
    inside: str = "",
    pos: str | None = None,
    quat: bool = True,
) -> str:
    """A body with a random frame and a random inertia that can exist."""
    place = " ".join(f"{v:.4f}" for v in rng.uniform(-0.2, 0.2, 3)) if pos is None else pos
    turn = f' quat="{" ".join(f"{v:.4f}" for v in rng.normal(size=4))}"' if quat else ""
    m = rng.uniform(0.2, 2.0)
    B = rng.normal(size=(3, 3)) * 0.05
    S = m * B @ B.T + 1e-4 * np.eye(3)
    I = np.trace(S) * np.eye(3) - S
    full = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
    com = " ".join(f"{v:.4f}" for v in rng.uniform(-0.1, 0.1, 3))
    inertial = (
        f'<inertial pos="{com}" mass="{m:.5f}" fullinertia="{" ".join(f"{v:.9f}" for v in full)}"/>'
    )
    return f'<body name="{name}" pos="{place}"{turn}>{joints}{inertial}{inside}</body>'


def _joint(rng: np.random.Generator, name: str, kind: str = "hinge", more: str = "") -> str:
    axis = " ".join(f"{v:.4f}" for v in rng.normal(size=3))
    at = " ".join(f"{v:.4f}" for v in rng.uniform(-0.05, 0.05, 3))
    return f'<joint name="{name}" type="{kind}" axis="{axis}" pos="{at}" armature="{rng.uniform(0, 0.05):.4f}" {more}/>'


def _limb(rng: np.random.Generator, name: str, kinds: list[str], end: str = "") -> str:
    inside = end
    for k in reversed(range(len(kinds))):
        inside = _body(rng, f"{name}{k + 1}_link", _joint(rng, f"{name}{k + 1}", kinds[k]), inside)
    return inside


def _mjcf(world: str, more: str = "") -> str:
    return f'<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>{world}</worldbody>{more}</mujoco>'


def chain(seed: int = 1) -> str:
    return _mjcf(_limb(np.random.default_rng(seed), "j", ["hinge"] * 6))


def two_arms(seed: int = 2) -> str:
    rng = np.random.default_rng(seed)
    return _mjcf(_limb(rng, "left", ["hinge"] * 4) + _limb(rng, "right", ["hinge"] * 3))


def quadruped(seed: int = 3) -> str:
    """Its trunk is held by a free joint that is left out, and carries a head that is welded to
    it.
    """
    rng = np.random.default_rng(seed)
    legs = "".join(_limb(rng, leg, ["hinge"] * 3) for leg in ("FL", "FR", "RL", "RR"))
    return _mjcf(_body(rng, "trunk", "<freejoint/>", _body(rng, "head", "") + legs))


def humanoid(seed: int = 4) -> str:
    """20 joints: legs of five, a torso of two that carries two arms of three and a neck of two."""
    rng = np.random.default_rng(seed)
    upper = (
        _limb(rng, "arm_l", ["hinge"] * 3)
        + _limb(rng, "arm_r", ["hinge"] * 3)
        + _limb(rng, "neck", ["hinge"] * 2)
    )
    return _mjcf(
        _limb(rng, "leg_l", ["hinge"] * 5)
        + _limb(rng, "leg_r", ["hinge"] * 5)
        + _limb(rng, "torso", ["hinge"] * 2, upper)
    )


def gantry(seed: int = 5) -> str:
    """Slides and hinges mixed, with springs and a reference."""
    rng = np.random.default_rng(seed)
    more = 'stiffness="3.0" springref="0.2" ref="0.3"'
    tool = _body(rng, "tool", _joint(rng, "spin", "hinge", more))
    return _mjcf(
        _body(
            rng,
            "beam",
            _joint(rng, "x", "slide"),
            _body(rng, "car", _joint(rng, "lift", "slide", more), tool),
        )
    )


def shoulder(seed: int = 6) -> str:
    """Three joints on one body, and two behind it on another: one slides."""
    rng = np.random.default_rng(seed)
    far = _body(rng, "hand", _joint(rng, "roll") + _joint(rng, "reach", "slide"))
    return _mjcf(_body(rng, "upper", _joint(rng, "a") + _joint(rng, "b") + _joint(rng, "c"), far))


def hand(seed: int = 7) -> str:
    """A wrist and two fingers whose outer joints follow the inner ones."""
    rng = np.random.default_rng(seed)
    fingers = _limb(rng, "thumb", ["hinge"] * 2) + _limb(rng, "index", ["hinge"] * 2)
    equal = "".join(
        f'<joint joint1="{f}2" joint2="{f}1" polycoef="{c} {r} 0 0 0"/>'
        for f, c, r in (("thumb", 0.1, 0.8), ("index", -0.2, -1.3))
    )
    return _mjcf(_body(rng, "palm", _joint(rng, "wrist"), fingers), f"<equality>{equal}</equality>")


def tilted(seed: int = 8) -> str:
    """Two limbs of unequal length on a base that stands askew."""
    rng = np.random.default_rng(seed)
    return _mjcf(
        _body(
            rng,
            "base",
            "",
            _limb(rng, "p", ["hinge", "slide", "hinge"]) + _limb(rng, "r", ["hinge"]),
        )
    )


def lifted(seed: int = 9) -> str:
    """An arm whose weight is cancelled in parts: wholly, by half, and not at all; its hand carries
    a tool that is welded to it, and a finger that slides.
    """
    rng = np.random.default_rng(seed)
    hand = _body(rng, "tool", "") + _limb(rng, "finger", ["slide"])
    text = _mjcf(_limb(rng, "j", ["hinge"] * 4, hand))
    for body, share in (("j1_link", 1), ("j3_link", 0.5), ("j4_link", 1), ("finger1_link", 1)):
        text = text.replace(f'name="{body}"', f'name="{body}" gravcomp="{share}"')
    return text


ROBOTS = {
    f.__name__: f
    for f in (chain, two_arms, quadruped, humanoid, gantry, shoulder, hand, tilted, lifted)
}
