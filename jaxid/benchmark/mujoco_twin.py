"""Twins of the blind cases simulated by MuJoCo: its multibody dynamics, its constraints for dry
friction, stops and play.

The same numbers as in numpy_twin.py, for those plants and effects that MuJoCo can express.
What MuJoCo has itself is left to it: damping, dry friction (`frictionloss`, a soft constraint: a
joint that should stand still creeps), rotor inertia, springs, payloads, gravity's direction, a
rotor behind a spring, play as a joint with stops, a swinging mass. What it has not (what the drive
does to the command, dry friction that depends on speed, load or position, drag, a ripple) is set
anew before every step.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign, cos, exp, pi, sin, sqrt
from typing import Any

import mujoco
import numpy as np

from jaxid.benchmark.laws import fine
from jaxid.benchmark.numpy_twin import sensed
from jaxid.benchmark.plants import Lanes, NEUTRAL, TwinPlant


#: Effects that are expressed; a mass that swings on a second joint turns with the link, which is
#: another effect.
EFFECTS = """
dead_zone saturation supply_droop torque_scale actuator_lag input_delay input_hold back_emf
torque_ripple viscous_friction coulomb_friction asymmetric_friction stribeck_friction
quadratic_drag load_dependent_friction position_dependent_friction backlash joint_elasticity
payload constant_torque gravity_offset spring_torque reflected_inertia flexible_mode sensor_bias
sensor_scale sensor_lag sensor_delay timestamp_jitter
""".split()
ON_ONE_JOINT = ("flexible_mode",)
STEP = 2e-4
#: Time constant (s), damping ratio and impedance of dry friction and stops: as stiff as the step
#: allows. MuJoCo's defaults creep so much that no real joint looks like it.
STIFF = (
    'solreffriction="0.0004 1" solimpfriction="0.99 0.999 0.001" '
    'solreflimit="0.0004 1" solimplimit="0.99 0.999 0.0001"'
)
_MJ: Any = mujoco

Own = dict[str, np.ndarray]  # numbers of one lane: [joints]


def recorded(plant: TwinPlant, u: np.ndarray, p: Lanes, rng: np.random.Generator) -> np.ndarray:
    """What the sensors write down [lanes samples ny] under commands u [lanes samples nu], from rest
    at zero.
    """
    p = {
        k: np.broadcast_to(np.asarray(x, float), (len(u), plant.n))
        for k, x in ({**NEUTRAL, **p}).items()
    }
    parts = round(1 / plant.rate / STEP)
    h = 1 / plant.rate / parts
    table = fine(u, p, parts, h)
    runs = []
    for k in range(len(u)):
        own = {name: x[k] for name, x in p.items()}
        runs.append(simulated(plant, table[k], own, h))
    return sensed(plant, np.stack(runs), p, parts, h, rng)


def simulated(plant: TwinPlant, table: np.ndarray, p: Own, h: float) -> np.ndarray:
    """Positions [steps n] that the encoders see (those of the motors) under commands on the fine
    grid [steps n].
    """
    model = _MJ.MjModel.from_xml_string(machine(plant, p, h))
    data = _MJ.MjData(model)
    dofs = [int(model.joint(f"motor{j}").dofadr[0]) for j in range(plant.n)]
    drives = []
    for j in range(plant.n):
        own = {k: float(x[j]) for k, x in p.items()}
        drives.append(TwinDrive(plant, own, float(table[0, j]), h))
    out = np.empty(table.shape)
    for k, commands in enumerate(table.tolist()):
        out[k] = data.qpos[dofs]
        for dof, drive, command in zip(dofs, drives, commands, strict=True):
            torque, level = drive.step(command, float(data.qpos[dof]), float(data.qvel[dof]))
            data.qfrc_applied[dof], model.dof_frictionloss[dof] = torque, level
        _MJ.mj_step(model, data)
    return out


class TwinDrive:
    """What acts on one joint besides what MuJoCo simulates itself: torque of the drive, and the
    level of dry friction.
    """

    def __init__(self, plant: TwinPlant, p: dict[str, float], command: float, h: float):
        self.servo, self.p, self.lagged = plant.model == "servo", p, command
        self.follow = exp(-h / p["lag"]) if p["lag"] > 0 else 0.0

    def step(self, command: float, q: float, v: float) -> tuple[float, float]:
        """Applied torque and level of dry friction in the step that begins at (q, v)."""
        p = self.p
        before, self.lagged = self.lagged, command + (self.lagged - command) * self.follow
        u = (1 + p["scale"]) * (self.lagged if p["lag"] <= 0 else (before + self.lagged) / 2)
        u = min(max(u - p["droop"] * abs(u) * u, -p["limit"]), p["limit"])
        tau = copysign(max(abs(u) - p["dead_zone"], 0.0), u)
        if self.servo:
            tau = p["k_t"] * 7.4 * min(max(p["gain"] * 400.0 * (tau - q), -1.0), 1.0) - p["k_e"] * v
        smooth = p["drag"] * abs(v) * v + p["viscous_asymmetry"] * abs(v) + p["offset"]
        smooth += p["ripple"] * sin(p["ripple_order"] * q) + p["ripple_cosine"] * cos(
            p["ripple_order"] * q
        )
        level = (
            p["coulomb"]
            + p["stribeck"] * exp(-((v / p["stribeck_speed"]) ** 2))
            + p["load"] * abs(tau)
        )
        level += p["uneven"] * sin(p["uneven_order"] * q) + p["uneven_cosine"] * cos(
            p["uneven_order"] * q
        )
        minus, plus = max(level - p["dry_asymmetry"], 0.0), max(level + p["dry_asymmetry"], 0.0)
        return tau - smooth - (plus - minus) / 2, (plus + minus) / 2


def machine(plant: TwinPlant, p: Own, h: float) -> str:
    """The plant as MJCF."""
    gravity, body = PLANTS[plant.model](p)
    return (
        f'<mujoco><option timestep="{h}" integrator="RK4" '
        f'gravity="{gravity[0]} {gravity[1]} {gravity[2]}"><flag contact="disable"/></option>'
        '<compiler autolimits="true" inertiafromgeom="false" angle="radian"/>'
        f'<default><joint type="hinge" {STIFF}/></default><worldbody>{body}</worldbody></mujoco>'
    )


def _inertial(mass: float, at: tuple[float, float, float], diagonal: Sequence[float]) -> str:
    place, own = " ".join(map(repr, at)), " ".join(map(repr, diagonal))
    return f'<inertial mass="{mass!r}" pos="{place}" diaginertia="{own}"/>'


def _point(mass: float, at: tuple[float, float, float]) -> str:
    return f"<body>{_inertial(mass, at, (1e-9,) * 3)}</body>" if mass else ""


def _down(tilt: float) -> tuple[float, float, float]:
    """Gravity in the plane of motion of a machine that is mounted turned by `tilt`."""
    return -9.81 * sin(tilt), 0.0, -9.81 * cos(tilt)


def _jointed(
    p: Own, j: int, place: str, axis: str, link: str, effective: float, armature: float = 0.0
) -> str:
    """A link on joint j, with what its numbers put into the joint: a rotor behind a spring, with
    play, or a swinging mass.
    """

    def v(name):
        return float(p[name][j]) if name in p else 0.0

    joint = (
        f'<joint name="motor{j}" axis="{axis}" damping="{v("viscous") + v("back_emf")!r}" '
        f'stiffness="{v("spring")!r}" armature="{{}}" frictionloss="{max(v("coulomb"), 1e-9)!r}"/>'
    )
    small = _inertial(1e-6, (0, 0, 0), (1e-9, 1e-9, 1e-9))
    if v("swing"):
        w, inertia = 2 * pi * v("swing_frequency"), v("swing")
        link += (
            f"<body>{_inertial(1e-6, (0, 0, 0), (inertia,) * 3)}"
            f'<joint axis="{axis}" stiffness="{inertia * w * w!r}" '
            f'damping="{2 * v("swing_damping") * w * inertia!r}"/></body>'
        )
    rigid = armature + v("reflected")
    if not v("compliance"):
        return f'<body name="link{j}" {place}>{joint.format(rigid)}{link}</body>'
    motor, play, stiffness = v("motor_share") * effective, v("play"), 1 / v("compliance")
    if play:
        second = f'<joint axis="{axis}" range="{-play / 2!r} {play / 2!r}"/>'
    else:
        zeta = 2 * v("spring_damping") * sqrt(stiffness * motor * (1 - v("motor_share")))
        second = f'<joint axis="{axis}" stiffness="{stiffness!r}" damping="{zeta!r}"/>'
    return (
        f'<body name="motor{j}" {place}>{joint.format(rigid + motor)}{small}'
        f'<body name="link{j}">{second}{link}</body></body>'
    )


def _wheel(p: Own) -> tuple[tuple[float, float, float], str]:
    J = float(p["J"][0])
    return (0, 0, 0), _jointed(p, 0, "", "0 1 0", _inertial(1.0, (0, 0, 0), (J, J, J)), J)


def _pendulum(p: Own) -> tuple[tuple[float, float, float], str]:
    J, distance = float(p["J"][0]), 0.3
    mass = float(p["mgl"][0]) / 9.81 / distance
    own = J - mass * distance**2
    return _down(float(p["tilt"][0])), _jointed(
        p, 0, "", "0 -1 0", _inertial(mass, (0, 0, -distance), (own, own, own)), J
    )


def _servo(p: Own) -> tuple[tuple[float, float, float], str]:
    mass, back = float(p["mass"][0]), -float(p["q_offset"][0])
    link = _inertial(mass, (0, 0, -0.1), (1e-7, 1e-7, 1e-7)) + _point(
        float(p["payload"][0]), (0, 0, -0.1)
    )
    armature = float(p["armature"][0])
    body = _jointed(p, 0, "", "0 -1 0", link, mass * 0.01 + armature, armature)
    return _down(back), body


def _tracker(p: Own) -> tuple[tuple[float, float, float], str]:
    """The barrel points back over the yaw axis from a joint at 0.09 m; a thin rod with a camera, so
    that no inertia about it.
    """
    m, mc, length, c, R = 0.043, 0.103, 0.26, 0.036, 0.09
    J, total = float(p["J"][1]), m + mc
    at = (m * length / 2 + mc * c) / total
    across = J - total * at**2
    barrel = _inertial(total, (-at, 0, 0), (1e-6, across, across)) + _point(
        float(p["payload"][1]), (-length, 0, 0)
    )
    tilt = _jointed(p, 1, f'pos="{R} 0 0"', "0 1 0", barrel, J)
    J0 = float(p["J"][0])
    base = _inertial(1.0, (0, 0, 0), (J0, J0, J0)) + tilt
    return (0, 0, -9.81), _jointed(p, 0, "", "0 0 1", base, J0 + J)


def _planar(p: Own) -> tuple[tuple[float, float, float], str]:
    l1, l2, tilt = 0.5, 0.4, float(p["tilt"][0])
    m, c, own, extra = p["m"], p["c"], p["I"], p["payload"]

    def link(j: int, length: float) -> str:
        inertia = (float(own[j]),) * 3
        return _inertial(float(m[j]), (0, 0, -float(c[j])), inertia) + _point(
            float(extra[j]), (0, 0, -length)
        )

    J2 = float(own[1] + m[1] * c[1] ** 2)
    J1 = float(own[0] + m[0] * c[0] ** 2) + J2 + float(m[1]) * l1**2
    second = _jointed(p, 1, f'pos="0 0 {-l1}"', "0 -1 0", link(1, l2), J2)
    return _down(tilt), _jointed(p, 0, "", "0 -1 0", link(0, l1) + second, J1)


#: Plants that are expressed: model -> numbers -> gravity, bodies.
PLANTS = {
    "joint": _wheel,
    "pendulum": _pendulum,
    "servo": _servo,
    "tracker": _tracker,
    "planar_arm": _planar,
}


def expressed(model: str, effect: str) -> bool:
    """Whether this simulator has an effect on a model."""
    alone = model in ("joint", "pendulum", "servo")
    return model in PLANTS and effect in EFFECTS and (alone or effect not in ON_ONE_JOINT)
