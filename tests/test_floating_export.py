"""A result of a robot on a free base carried back into its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

from floating_twin import ANGLES, mujoco, recording, text, torques
from jaxid.data.dataset import Controller, Geometry
from jaxid.models import Robot
from jaxid.problem.binding import resolve_model
from jaxid.robots.export.run import export
from jaxid.robots.origin import origin, origin_on
from test_floating import compared, spec_of, URDF


T = np.arange(51) * 0.01


def changed(robot: Robot, numbers: dict[str, float]) -> Robot:
    for name, value in numbers.items():
        field, _, link = name.partition("@")
        own = np.array(getattr(robot, field))
        own[robot.links.index(link)] = value
        robot = eqx.tree_at(lambda r, field=field: getattr(r, field), robot, own)
    return robot


@pytest.mark.parametrize("kind", ["mjcf", "urdf"])
def test_the_base_and_its_arm_are_patched(tmp_path: Path, kind: str):
    """The patched file in MuJoCo with a free joint and without gravity moves as the fitted model
    does, lumped bodies too.
    """
    last, n = ("a2", 4) if kind == "mjcf" else ("arm", 1)
    file = tmp_path / ("craft.xml" if kind == "mjcf" else "craft.urdf")
    file.write_text(text() if kind == "mjcf" else URDF)
    numbers = {
        "mass@craft": 9.5,
        "com_y@craft": 0.03,
        "gyration_xx@craft": 0.2,
        f"mass@{last}": 1.9,
        f"com_x@{last}": 0.22,
    }
    read = Robot.from_mjcf if kind == "mjcf" else Robot.from_urdf
    robot = read(file, free=True)
    content = {
        "schema": 1,
        "kind": "fit",
        "model": "robot",
        "effects": [
            {
                "effect": "step_change",
                "location": f"mass@{last}",
                "parameters": {"size": 0.4, "time": 3.0},
            }
        ],
        "parameters": {k: {"value": v, "std": 0.01, "unit": "kg"} for k, v in numbers.items()},
        "robot": origin(robot, Geometry(file=file.name, robot=file.read_text(), path=str(file))),
    }
    out = export(content, kind)
    assert {r.effect: r.how for r in out.rows[:-1]} == dict.fromkeys(
        [k.partition("@")[0] for k in numbers], "exact"
    )
    assert out.rows[-1].how == "none" and "holds that of before" in out.rows[-1].note
    spec = mujoco.MjSpec.from_string(out.files[file.name])
    spec.option.gravity = (0, 0, 0)
    if kind == "urdf":
        spec.compiler.fusestatic = False
        spec.bodies[1].add_freejoint()
    assert compared(changed(robot, numbers), spec.compile(), n) < 1e-8


def test_a_law_goes_by_the_driven_joints():
    """The angles of the base have no drive: what a result says of its robot leaves them out."""
    data = recording([torques(T, 1)], [np.tile(T[:, None], 7)], T, 1e-4)
    goals = replace(
        data,
        channels=tuple(
            replace(
                c,
                name=c.name.replace("_tau", "_cmd"),
                unit=c.unit.replace("N m", "rad").replace("N", "m"),
            )
            for c in data.channels
        ),
        controller=Controller("pd", {"kp": 5.0, "kd": 1.0}),
    )
    told = origin_on(None, goals)
    assert list(told["drive"]["joints"]) == [
        j for j in resolve_model(None, goals).signature.joints if j not in ANGLES
    ]
    assert told["base"]["kind"] == "free" and spec_of(data).base == {"kind": "free"}
