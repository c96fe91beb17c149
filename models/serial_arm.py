"""Serial arms of any kind: revolute and prismatic joints, from a Denavit-Hartenberg table or a
URDF.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.dynamics.base_parameters import base_parameters, BaseParameters, STANDARD, standard_names
from jaxid.dynamics.effect import InputEffect
from jaxid.dynamics.kinematics import ArmTable, free_fall, modified_dh, placements
from jaxid.dynamics.mechanism import Signature, Staged
from jaxid.dynamics.parameter import constant, param, ParameterSpec, Quantity, with_fields
from jaxid.dynamics.rigid_body import (
    chain_of,
    each_joint,
    INERTIA,
    inverse_dynamics,
    mass_matrix,
    Placements,
    poses,
    still,
    symmetric,
)
from jaxid.models.effects import ConstantTorque, CoulombFriction, PowerLawFriction


class DriveGain(InputEffect):
    """What a drive makes of its command: N m per unit of the input. Known, not fitted: any error of
    it scales every inertia.
    """

    name: ClassVar[str] = "drive_gain"
    #: What else happens to a command happens to it in its own unit.
    stage: ClassVar[int] = 2
    equation: ClassVar[str] = "u -> gain u"
    signature: ClassVar[str] = "all torques of a joint in one proportion"
    source: ClassVar[str] = "paper 001: tau = K i"
    excitation: ClassVar[str] = "a known payload, or a torque sensor"
    gain: Array = constant(1.0, unit="{F}/{u}", meaning="joint torque per unit of the input")
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ()

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        return self.gain * u, z

    def known_gain(self):
        return self.gain

    def transfer(self, omega):
        return self.gain + 0 * omega[:, None], 0 * self.gain * omega[:, None]


def signatures_of(prismatic: tuple[bool, ...]) -> tuple[Signature, ...]:
    """Channels of a chain: torques (forces) or motor currents in, joint positions out."""
    joints = tuple(f"q{j + 1}" for j in range(len(prismatic)))
    outputs = tuple(
        (q, "m" if slides else "rad") for q, slides in zip(joints, prismatic, strict=True)
    )
    torques = tuple((f"tau{j + 1}", "N" if slides else "N m") for j, slides in enumerate(prismatic))
    currents = tuple((f"current{j + 1}", "A") for j in range(len(prismatic)))
    slides = prismatic if any(prismatic) else ()
    return tuple(
        Signature(inputs, outputs, joints, prismatic=slides) for inputs in (torques, currents)
    )


def ends_of(table: ArmTable) -> tuple[tuple[float, ...], ...]:
    """Where each link of a chain ends, in its own frame: at the next joint; the last at the tool,
    or twice as far as its centre of mass where nothing says where that is.
    """
    E = table.placements(np.zeros(table.n))
    ends = [[float(component[j + 1]) for component in E.p] for j in range(table.n - 1)]
    tool = np.asarray(table.tool, float)[:3, 3]
    m = float(table.inertia[-1, 9])
    last = tool if np.any(tool) or m <= 0 else 2 * table.inertia[-1, 6:9] / m
    return tuple(tuple(map(float, end)) for end in (*ends, last))


class AbstractArm(Staged):
    """Abstract: n links in a chain, each with ten inertial parameters about the origin of its frame
    and a drive inertia.

    The frame of joint j stands in the frame before it at Rz(gamma) Tz(b) Rx(alpha) Tx(a) Rz(theta +
    q) Tz(d), q added to d where the joint slides. Fitted by default: the parameters that lead the
    base parameters (`base`), with all others kept as they are; friction levels and offsets; not the
    exponents of friction. A dataset that names others under [model.parameters] has them fitted too.
    """

    prismatic: tuple[bool, ...] = eqx.field(static=True)
    far: tuple[tuple[float, ...], ...] = eqx.field(
        static=True
    )  # where each link ends, in its own frame, m

    Ixx: Array = param(
        0.0,
        -np.inf,
        np.inf,
        scale=1.0,
        unit="kg m^2",
        meaning="inertia of the link about its frame's origin",
    )
    Ixy: Array = param(0.0, -np.inf, np.inf, scale=1.0, unit="kg m^2", meaning="its product x y")
    Ixz: Array = param(0.0, -np.inf, np.inf, scale=1.0, unit="kg m^2", meaning="its product x z")
    Iyy: Array = param(0.0, -np.inf, np.inf, scale=1.0, unit="kg m^2", meaning="inertia about y")
    Iyz: Array = param(0.0, -np.inf, np.inf, scale=1.0, unit="kg m^2", meaning="its product y z")
    Izz: Array = param(
        0.0, -np.inf, np.inf, scale=1.0, unit="kg m^2", meaning="inertia about the joint axis"
    )
    mx: Array = param(
        0.0, -np.inf, np.inf, scale=1.0, unit="kg m", meaning="mass times centre of mass, x"
    )
    my: Array = param(
        0.0, -np.inf, np.inf, scale=1.0, unit="kg m", meaning="mass times centre of mass, y"
    )
    mz: Array = param(
        0.0, -np.inf, np.inf, scale=1.0, unit="kg m", meaning="mass times centre of mass, z"
    )
    m: Array = param(0.0, 0.0, np.inf, scale=1.0, unit="kg", meaning="mass of the link")
    Ia: Array = param(
        0.0,
        0.0,
        np.inf,
        scale=1.0,
        unit="{I}",
        meaning="inertia of the drive, reflected through its gear",
    )

    a: Array = constant(0.0, unit="m", meaning="offset along x of the frame before")
    alpha: Array = constant(0.0, unit="rad", meaning="twist about x of the frame before")
    d: Array = constant(0.0, unit="m", meaning="offset along the joint axis")
    theta: Array = constant(0.0, unit="rad", meaning="turn about the joint axis at q = 0")
    b: Array = constant(
        0.0, unit="m", meaning="offset along z of the frame before (frames of a URDF)"
    )
    gamma: Array = constant(
        0.0, unit="rad", meaning="turn about z of the frame before (frames of a URDF)"
    )
    gravity: Array = constant(9.81, unit="m/s^2")
    base_roll: Array = constant(0.0, unit="rad", meaning="base tilted about the world's x, z up")
    base_pitch: Array = constant(0.0, unit="rad", meaning="then about the world's y")
    payload: Array = constant(0.0, unit="kg", meaning="known point mass in the last link's frame")
    payload_x: Array = constant(0.0, unit="m")
    payload_y: Array = constant(0.0, unit="m")
    payload_z: Array = constant(0.0, unit="m")

    equations: ClassVar[str] = (
        "M(q) qdd + C(q, qd) qd + g(q) + Ia qdd + (F_c + F_v |qd|^exponent) sign(qd) + offset ="
        " drive_gain tau\nby recursive Newton-Euler (torque) and composite rigid bodies (mass"
        " matrix)"
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (DriveGain, {"gain": "drive_gain"}),
        (CoulombFriction, {"level": "F_c"}),
        (PowerLawFriction, {"coefficient": "F_v", "exponent": "exponent"}),
        (ConstantTorque, {"torque": "offset"}),
    )
    #: Whether the torque is measured at the drive; behind the gear no drive inertia shows.
    motor_side: ClassVar[bool] = True

    def _set(self, table: ArmTable) -> None:
        self.prismatic = table.prismatic
        self.far = ends_of(table)
        for k, name in enumerate(INERTIA):
            setattr(self, name, table.inertia[:, k].copy())
        setattr(self, "Ia", table.drive_inertia.copy())
        for name in ("a", "alpha", "d", "theta", "b", "gamma"):
            setattr(self, name, getattr(table, name).copy())
        for name in (
            "gravity",
            "base_roll",
            "base_pitch",
            "payload",
            "payload_x",
            "payload_y",
            "payload_z",
        ):
            setattr(self, name, np.float64(9.81 if name == "gravity" else 0.0))

    # ---- what a fit may move

    def base(self) -> BaseParameters:
        """The combinations of inertial parameters that motion can show."""
        drives = () if self.motor_side else tuple(f"Ia{j + 1}" for j in range(len(self.prismatic)))
        return base_parameters(self, drives)

    def held(self) -> frozenset[str]:
        n = len(self.prismatic)
        exponents = {f"exponent{j + 1}" if n > 1 else "exponent" for j in range(n)}
        return frozenset({*standard_names(n)} - {*self.base().names} | exponents)

    def spec_of(self, field: str, place: int, spec: ParameterSpec) -> ParameterSpec:
        """Bounds by the arm's own size: regrouped parameters stand for much more than one link, but
        not for ten arms.
        """
        if field not in STANDARD:
            return spec
        mass = max(float(np.sum(np.asarray(self.m))), 1e-3)
        offsets = (np.abs(np.asarray(getattr(self, k))) for k in ("a", "d", "b"))
        reach = max(float(sum(np.sum(o) for o in offsets)), 1e-2)
        slides = field == "Ia" and self.prismatic[place]
        size = mass * (
            1.0 if field == "m" or slides else reach if field in ("mx", "my", "mz") else reach**2
        )
        lower = 0.0 if field in ("m", "Ia") else -10 * size
        return spec._replace(lower=lower, upper=10 * size, scale=0.01 * size)

    # ---- dynamics

    def inertia(self) -> Float[Array, "n 10"]:
        """Inertial parameters of the links, the payload in the last."""
        phi = jnp.stack([jnp.asarray(getattr(self, name)) for name in INERTIA], 1)
        m, x, y, z = self.payload, self.payload_x, self.payload_y, self.payload_z
        six = [y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y]
        return phi.at[-1].add(m * jnp.stack([jnp.asarray(v) for v in (*six, x, y, z, 1.0 + 0 * x)]))

    #: About how many axes its base may stand askew: the world's x, then y.
    tilts: ClassVar[int] = 2

    def loaded(self, mass: Float[Array, " n"]) -> AbstractArm:
        """With a point mass at the far end of each link: where the next one begins, or the tool."""
        x, y, z = jnp.asarray(self.far).T
        ten = [
            y * y + z * z,
            -x * y,
            -x * z,
            x * x + z * z,
            -y * z,
            x * x + y * y,
            x,
            y,
            z,
            jnp.ones_like(x),
        ]
        return with_fields(
            self,
            {name: getattr(self, name) + mass * v for name, v in zip(INERTIA, ten, strict=True)},
        )

    def tilted(self, angle: Float[Array, " n"]) -> AbstractArm:
        """On a base turned by angle[0] about the world's x, then by angle[1] about its y."""
        turned = {"base_roll": self.base_roll + angle[0]}
        return with_fields(
            self,
            turned
            | ({"base_pitch": self.base_pitch + angle[1]} if len(self.prismatic) > 1 else {}),
        )

    def placements(self, q: Float[Array, "n ..."]) -> Placements:
        """Frame of each link in the frame before it."""
        return placements(self, self.prismatic, q)

    def outline(self, x, signature):
        return jnp.concatenate(
            [jnp.zeros((1, 3)), jnp.stack([jnp.asarray(p) for p in self.frames(x[0]).p], -1)]
        )

    def frames(self, q: Float[Array, "n ..."]) -> Placements:
        """Frame of each link in the base frame."""
        return poses(self.placements(q))

    def free_fall(self) -> tuple[Any, Any, Any]:
        """Gravity vector in the base frame, m/s^2."""
        return free_fall(self.gravity, jnp.asarray(self.base_roll), jnp.asarray(self.base_pitch))

    def matrices(self, q, qd):
        E = self.placements(q)
        bodies = chain_of(self.prismatic, batch=0, inertia=self.inertia())
        M = symmetric(mass_matrix(E, bodies, each_joint(len(self.prismatic), batch=0)))
        bias = inverse_dynamics(E, bodies, still(self.free_fall()), qd, jnp.zeros_like(qd))
        return M + jnp.diag(jnp.asarray(self.Ia)), bias

    def inverse(self, q, qd, qdd):
        """Joint torque of a motion [n ...] (any number of samples behind the joints), friction
        excluded.
        """
        batch = qdd.ndim - 1
        bodies = chain_of(self.prismatic, batch, self.inertia())
        tau = inverse_dynamics(self.placements(q), bodies, still(self.free_fall()), qd, qdd)
        Ia = jnp.asarray(self.Ia).reshape(-1, *(1,) * batch)
        return tau + Ia * qdd

    def rotors(self):
        return jnp.asarray(self.Ia)


_DEFAULT = modified_dh(  # an upright elbow arm with a spherical wrist
    a=[0, 0, 0.5, 0, 0, 0],
    alpha=[0, -np.pi / 2, 0, -np.pi / 2, np.pi / 2, -np.pi / 2],
    d=[0.3, 0, 0, 0.5, 0, 0.1],
    theta=[0, -np.pi / 2, 0, 0, 0, 0],
)


class SerialArm(AbstractArm):
    """Any serial chain: `SerialArm(modified_dh(...))`, `SerialArm(standard_dh(...))` or
    `SerialArm.from_urdf("arm.urdf")`.
    """

    name: ClassVar[str] = "serial_arm"
    source: ClassVar[str] = (
        "Luh, Walker, Paul 1980; Featherstone 2008; frames of Khalil and Kleinfinger 1986"
    )
    signatures: tuple[Signature, ...] = eqx.field(
        static=True, default=signatures_of(_DEFAULT.prismatic)
    )

    friction: tuple[tuple[float, float], ...] = eqx.field(static=True, default=())
    joint_names: tuple[str, ...] = eqx.field(static=True, default=())

    def __init__(self, table: ArmTable = _DEFAULT):
        self._set(table)
        self.signatures = signatures_of(table.prismatic)
        self.joint_names = tuple(table.joints)
        self.friction = tuple(
            zip(map(float, table.coulomb), map(float, table.viscous), strict=True)
        )

    def nominal_effects(self):
        """Friction starts from what the table (a URDF's dynamics) says."""
        if not self.friction:
            return super().nominal_effects()
        level, viscous = np.array(self.friction).T
        return [
            DriveGain(),
            CoulombFriction(level),
            PowerLawFriction(viscous),
            ConstantTorque(),
        ]  # pyright: ignore

    @classmethod
    def from_urdf(
        cls, path: str | Path, tip: str | None = None, root: str | None = None
    ) -> SerialArm:
        """The chain of a URDF from `root` (default: its root link) to `tip` (default: the only
        leaf).
        """
        from jaxid.robots.urdf_tree import read_urdf

        return cls(read_urdf(path, tip, root))
