"""Any robot of an MJCF or URDF file: a tree of hinge and slide joints, driven by torques or by
goals.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.data.dataset import Dataset
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.mechanism import Signature
from jaxid.dynamics.parameter import constant, param, ParameterSpec
from jaxid.dynamics.rigid_body import Base, still
from jaxid.robots import dynamics, free_numbers, rods
from jaxid.robots.bodies import beyond_ends, BODY, body_of, ten_numbers
from jaxid.robots.channels import GRAVITY, PLACE, RIDE, signature_of
from jaxid.robots.coupled import carried, Coupled, coupled, gathered
from jaxid.robots.file_step import asked_of, FIELDS as SOFT
from jaxid.robots.floating import balanced, based, without_slides
from jaxid.robots.goal_driven import GoalDriven
from jaxid.robots.ground import friction_of, Ground, nameless_of, pose_of
from jaxid.robots.tree import roll_pitch_yaw, StaticTree, Tree, up_to

from .effects import ActuatorLag, CoulombFriction, InputDelay, QuadraticDrag, ViscousFriction
from .effects.body import PlacedPayload
from .robot_drive import PositionLaw, SampledLag


plan_of = lru_cache(dynamics.plan)


class Robot(GoalDriven):
    """A robot from its file: `Robot.from_mjcf("robot.xml")`, `Robot.from_urdf("robot.urdf")`.

    Numbers go by the names of joints and links: armature@JOINT, damping@JOINT, frictionloss@JOINT,
    mass@LINK, com_x@LINK (in the link's frame). Bodies are written so that every value within its
    bounds is a body that can exist. Fitted by default: armature, damping and dry friction of each
    joint, its link's centre of mass across the axis (where gravity shows it), and what [controller]
    names; numbers that a dataset names under [model.parameters] are fitted too. On channels
    `JOINT_cmd` the law of [controller] or of the file's actuators drives.
    """

    name: ClassVar[str] = "robot"
    source: ClassVar[str] = (
        "Featherstone 2008; joints, drives and dissipation with MuJoCo's meaning"
    )
    equations: ClassVar[str] = (
        "M(q) qdd + bias(q, qd) + armature qdd + stiffness (q - springref) + damping qd +"
        " frictionloss sign(qd) = tau\ntau the recorded torque, or gain clip(kp (goal(t - delay) -"
        " q) + kd (rate - qd) + offset, lowest, highest);\nrecursive Newton-Euler and composite"
        " rigid bodies over the tree, mimic joints eliminated"
    )
    builtin: tuple[tuple[type, dict[str, str]], ...] = eqx.field(
        static=True,
        default=(
            (ViscousFriction, {"coefficient": "damping@{joint}"}),
            (CoulombFriction, {"level": "frictionloss@{joint}"}),
        ),
    )
    signatures: tuple[Signature, ...] = eqx.field(static=True, default=())
    variants: ClassVar[dict[str, type]] = {"payload": PlacedPayload}

    mass: Array = param(
        0.0,
        0.0,
        np.inf,
        scale=1.0,
        unit="kg",
        meaning="mass of the link and of what is fixed to it",
    )
    com_x: Array = param(
        0.0,
        -np.inf,
        np.inf,
        scale=1.0,
        unit="m",
        meaning="its centre of mass in the link's frame, x",
    )
    com_y: Array = param(
        0.0,
        -np.inf,
        np.inf,
        scale=1.0,
        unit="m",
        meaning="its centre of mass in the link's frame, y",
    )
    com_z: Array = param(
        0.0,
        -np.inf,
        np.inf,
        scale=1.0,
        unit="m",
        meaning="its centre of mass in the link's frame, z",
    )
    gyration_xx: Array = param(
        0.0,
        0.0,
        np.inf,
        scale=1.0,
        unit="m",
        meaning="spread of its mass about its centre: factor xx",
    )
    gyration_yx: Array = param(
        0.0, -np.inf, np.inf, scale=1.0, unit="m", meaning="spread of its mass: factor yx"
    )
    gyration_yy: Array = param(
        0.0, 0.0, np.inf, scale=1.0, unit="m", meaning="spread of its mass: factor yy"
    )
    gyration_zx: Array = param(
        0.0, -np.inf, np.inf, scale=1.0, unit="m", meaning="spread of its mass: factor zx"
    )
    gyration_zy: Array = param(
        0.0, -np.inf, np.inf, scale=1.0, unit="m", meaning="spread of its mass: factor zy"
    )
    gyration_zz: Array = param(
        0.0, 0.0, np.inf, scale=1.0, unit="m", meaning="spread of its mass: factor zz"
    )
    armature: Array = param(
        0.0,
        0.0,
        np.inf,
        scale=1.0,
        unit="{I}",
        meaning="inertia of the drive, reflected through its gear",
    )
    encoder_bias: Array = param(
        0.0, -0.3, 0.3, scale=0.01, unit="{X}", meaning="reading of the encoder at the joint's zero"
    )
    stiffness: Array = param(
        0.0, 0.0, np.inf, scale=1.0, unit="{F}/{X}", meaning="spring at the joint"
    )
    springref: Array = constant(0.0, unit="{X}", meaning="where that spring is at rest")
    cubic_damping: Array = constant(
        0.0, unit="{F} s^3/{X}^3", meaning="torque per cube of the speed"
    )

    x: Array = constant(
        0.0, unit="m", meaning="origin of the joint in the frame of the link before"
    )
    y: Array = constant(0.0, unit="m")
    z: Array = constant(0.0, unit="m")
    roll: Array = constant(
        0.0, unit="rad", meaning="turn of the joint's frame, Rz(yaw) Ry(pitch) Rx(roll)"
    )
    pitch: Array = constant(0.0, unit="rad")
    yaw: Array = constant(0.0, unit="rad")
    gravity: Array = constant(0.0, unit="m/s^2", meaning="vector of free fall in the world")
    base_roll: Array = param(
        0.0, -3.2, 3.2, scale=0.01, unit="rad", meaning="base tilted about the world's x"
    )
    base_pitch: Array = param(0.0, -3.2, 3.2, scale=0.01, unit="rad", meaning="then about its y")
    base_yaw: Array = constant(0.0, unit="rad", meaning="then about its z")

    joints: tuple[str, ...] = eqx.field(static=True, default=())  # of all nodes, mimics among them
    links: tuple[str, ...] = eqx.field(static=True, default=())  # of those nodes that carry a body
    carriers: tuple[int, ...] = eqx.field(static=True, default=())
    parent: tuple[int, ...] = eqx.field(static=True, default=())
    slides: tuple[bool, ...] = eqx.field(static=True, default=())
    axes: tuple[tuple[float, ...], ...] = eqx.field(static=True, default=())
    anchors: tuple[tuple[float, ...], ...] = eqx.field(static=True, default=())
    reference: tuple[float, ...] = eqx.field(static=True, default=())
    lifted: tuple[tuple[float, ...], ...] | None = eqx.field(static=True, default=None)
    coupling: Coupled = eqx.field(static=True, default=Coupled(None, ()))
    fitted: tuple[Any, ...] = eqx.field(
        static=True, default=()
    )  # numbers of the law: `drives.Fitted`
    prepared: Any = None
    added: Any = None  # ten numbers more at each node
    tilt: Any = None  # (angle, axis): the base turned further
    floats: bool = eqx.field(
        static=True, default=False
    )  # on a free base: see `jaxid.robots.floating`
    rides: bool = eqx.field(
        static=True, default=False
    )  # whether the last inputs are the motion of the base

    def __init__(
        self,
        tree: Tree | None = None,
        driven: bool | None = None,
        law: Any = None,
        rides: bool = False,
        simulator: str = "own",
        ground: Ground | None = None,
    ):
        """`simulator` "mujoco": steps are those that the tree's file asks MuJoCo for, where they
        are known and the base does not float. `ground`: what touches planes in such steps.
        """
        tree = rods.chain_of_rods(2, 0.3, 0.5) if tree is None else tree  # links in a plane
        leading = tree.leading
        S, _ = tree.follow()
        self.tree, self.floats = StaticTree(tree), tree.floats
        self.joints, self.parent, self.slides = tree.joints, tree.parent, tree.slides
        self.carriers = tuple(k for k, link in enumerate(tree.links) if link)
        self.links = tuple(tree.links[k] for k in self.carriers)

        def rounded(a):
            return tuple(tuple(float(v) for v in row) for row in a)

        self.axes, self.anchors = rounded(tree.axis), rounded(tree.anchor[list(self.carriers)])
        self.reference, self.coupling = tuple(map(float, tree.reference)), coupled(tree)
        self.lifted = None if tree.lifted is None else rounded(tree.lifted)
        bodies = np.array(
            [body_of(tree.inertia[k], tree.anchor[k])[0] for k in self.carriers]
        ).reshape(-1, 10)
        for k, name in enumerate(BODY):
            setattr(self, name, bodies[:, k])
        places = np.array([[*T[:3, 3], *roll_pitch_yaw(T[:3, :3])] for T in tree.place]).reshape(
            -1, 6
        )
        for k, name in enumerate(PLACE):
            setattr(self, name, places[:, k])
        numbers = {
            "armature": tree.armature,
            "stiffness": tree.stiffness,
            "springref": tree.spring,
            "encoder_bias": np.zeros(len(leading)),
            "cubic_damping": (S**4).T @ tree.damping[:, 2],
            "gravity": np.array(tree.gravity, np.float64),
            **{f"base_{k}": np.float64(0.0) for k in PLACE[3:]},
        }
        stated = None if tree.floats else tree.simulator
        step = asked_of(simulator, stated)
        self.integrator = "" if step is None else step.integrator
        # Also where no simulation needs them: a layout of numbers holds whatever steps are taken.
        soft = dict.fromkeys(SOFT, np.float64(0.0)) if stated is None else stated.of(leading)
        for name, value in (numbers | soft).items():
            setattr(self, name, value)
        self.ground, self.sliding_friction = ground, friction_of(ground)
        self.prepared = self.yielding = self.added = self.tilt = self.drive_law = None
        self.weight = None
        self.fitted = ()
        if driven is None:
            driven = law is not None or all(
                j in tree.actuators and tree.actuators[j].kind == "position" for j in tree.driven
            )
        self.rides = rides
        self.signatures = (signature_of(tree, driven, () if law is None else law.rates, rides),)
        own: list[tuple[type, dict[str, str]]] = [
            (ViscousFriction, {"coefficient": "damping@{joint}"}),
            (CoulombFriction, {"level": "frictionloss@{joint}"}),
        ]
        if np.any(tree.damping[:, 1]):
            own.append((QuadraticDrag, {"coefficient": "quadratic_damping@{joint}"}))
        if driven:
            from jaxid.robots.drives import file_law

            self._drive(file_law(tree, tree.leading) if law is None else law, own)
        self.builtin = tuple(own)

    def _drive(self, law: Any, own: list) -> None:
        """Sets a drive law (a `drives.Law`), its numbers and which of them are fitted."""
        self.drive_law = law
        own.append(
            (
                PositionLaw,
                {
                    k: f"{k}@{{joint}}"
                    for k in ("kp", "kd", "ki", "gain", "lowest", "highest", "offset")
                },
            )
        )
        if law.delayed:
            own.append((InputDelay, {"delay": "delay@{joint}"}))
        if any(law.lag):
            lag = SampledLag if self.integrator else ActuatorLag
            own.append((lag, {"lag": "timeconst@{joint}"}))
        self.fitted = law.fitted(self.tree.tree.driven)

    def driven_by(self, law: Any) -> Robot:
        """The same driven by goals through a law (a `jaxid.robots.drives.DriveLaw`)."""
        tree, simulator = self.tree.tree, self.simulator
        return type(self)(tree, law=law, rides=self.rides, simulator=simulator, ground=self.ground)

    def stepped(self, simulator: str) -> Robot:
        """The same by jaxid's steps ("own"), its file's ("mujoco") or exact ones ("mujoco_rk4")."""
        driven = self.drive_law is not None
        return type(self)(self.tree.tree, driven, self.drive_law, self.rides, simulator)

    @classmethod
    def from_mjcf(
        cls,
        path: str | Path,
        *,
        tip: str | None = None,
        text: str | None = None,
        free: bool = False,
    ) -> Robot:
        """The robot of an MJCF file; with `tip` only the joints up to that link move. `free`: its
        base floats, and its angles base_roll, base_pitch, base_yaw are the last joints. Needs no
        meshes but those that give an inertia.

        Raises `UsageError` for what is not a tree of hinge and slide joints, by name.
        """
        from jaxid.robots.mjcf import read_mjcf

        return cls(based(up_to(read_mjcf(path, text), tip), free))

    @classmethod
    def from_urdf(
        cls,
        path: str | Path,
        *,
        tip: str | None = None,
        text: str | None = None,
        free: bool = False,
    ) -> Robot:
        """The robot of a URDF file; `tip`, `free` and errors as of `from_mjcf`."""
        from jaxid.robots.urdf_tree import read_urdf_tree

        return cls(based(up_to(read_urdf_tree(path, text), tip), free))

    def limits(self) -> Any:
        """`lower`, `upper` (rad, m), `velocity` and `effort` [joints] of the joints that move by
        themselves, by the file.
        """
        tree: Tree = self.tree.tree
        own = [tree.joints.index(j) for j in tree.leading]
        return SimpleNamespace(
            **{k: getattr(tree, k)[own] for k in ("lower", "upper", "velocity", "effort")}
        )

    def matched(self, dataset: Dataset) -> Chain:
        """The model of a recording: its joints by name, joints that it lacks held, its drive law.
        See `jaxid.robots.match`.
        """
        from jaxid.robots.match import matched

        return matched(self, dataset)

    def nameless(self, signature):
        names = {joint: f"joint {k + 1}" for k, joint in enumerate(self.joints)}
        signature = signature.renamed(names)
        law = None if self.drive_law is None else self.drive_law.nameless
        changed = {
            "joints": tuple(names.values()),
            "links": tuple(f"link {k + 1}" for k in range(len(self.links))),
            "tree": None,
            "signatures": (signature,),
            "drive_law": law,
            "fitted": (),
            "ground": nameless_of(self.ground),
        }
        out = object.__new__(type(self))  # static fields cannot be replaced otherwise
        for f in dataclasses.fields(self):
            object.__setattr__(out, f.name, changed.get(f.name, getattr(self, f.name)))
        return out, signature

    # ---- what a fit may move

    def nominal_effects(self):
        tree: Tree = self.tree.tree
        S, _ = tree.follow()
        numbers = {
            ViscousFriction: {"coefficient": (S**2).T @ tree.damping[:, 0]},
            CoulombFriction: {"level": np.abs(S).T @ tree.frictionloss},
            QuadraticDrag: {"coefficient": np.abs(S**3).T @ tree.damping[:, 1]},
        }
        law = self.drive_law
        if law is not None:
            numbers |= {
                PositionLaw: {**law.numbers, **law.words},
                InputDelay: {"delay": np.array(law.delay)},
                **dict.fromkeys((ActuatorLag, SampledLag), {"lag": np.array(law.lag)}),
            }
        return [kind(**numbers[kind]) for kind, _ in self.builtin]

    def number_name(self, field: str, place: int) -> str:
        if field == "gravity":
            return GRAVITY[place]
        if field in BODY:
            return f"{field}@{self.links[place]}"
        if field == "sliding_friction" and self.ground is not None:
            return f"{field}@{self.ground.shapes[place]}"
        of_leading = field in ("encoder_bias", "cubic_damping", *SOFT)
        names = self.signatures[0].joints if of_leading else self.joints
        return f"{field}@{names[place]}"

    def held(self) -> frozenset[str]:
        return free_numbers.held(self)

    def known(self):
        return {one.name: one.known for one in self.fitted}

    def spec_of(self, field: str, place: int, spec: ParameterSpec) -> ParameterSpec:
        """Bounds by the robot's own size."""
        return free_numbers.spec_of(self, field, place, spec)

    # ---- dynamics

    def inertia(self) -> Float[Array, "n 10"]:
        """Ten numbers of every node about its joint."""
        own = ten_numbers(
            jnp.stack([jnp.asarray(getattr(self, k)) for k in BODY]),
            np.array(self.anchors).reshape(-1, 3),
        )
        own = jnp.zeros((len(self.joints), 10)).at[np.array(self.carriers, int)].set(own)
        return own if self.added is None else own + self.added

    def body(self) -> dynamics.Body:
        place = jnp.stack([jnp.asarray(getattr(self, k)) for k in PLACE])
        return dynamics.body(
            plan_of(self.parent),
            self.slides,
            np.array(self.axes).reshape(-1, 3),
            place,
            self.inertia(),
            None if self.lifted is None else np.array(self.lifted),
        )

    def standing(self) -> Base:
        """Gravity in the frame of the tilted base."""
        return still(self._fall((self.base_roll, self.base_pitch, self.base_yaw)))  # type: ignore[arg-type]

    def riding(self, ride: Float[Array, " 9"]) -> Base:
        """Gravity and the base's own motion (`RIDE`), turned about its origin, in its frame."""
        offset = jnp.stack(
            [jnp.asarray(self.base_roll), jnp.asarray(self.base_pitch), jnp.asarray(self.base_yaw)]
        )
        angles, rates = ride[:3] + offset, ride[3:6]
        w, wd = jax.jvp(dynamics.angular_velocity, (angles, rates), (rates, ride[6:]))
        fall = self._fall(tuple(angles))
        zero = 0.0 * w[0]
        return Base(tuple(w), tuple(wd), tuple(zero - f for f in fall))  # type: ignore[arg-type]

    def _fall(self, angles: Any) -> tuple[Any, ...]:
        """Vector of free fall in the frame of a base that is turned so."""
        return dynamics.falling(angles, jnp.asarray(self.gravity), self.tilt)

    def prepare(self, h):
        ready = self._with("prepared", (self.body(), self.standing()))
        if not self.integrator:
            return ready
        places = np.array([self.joints.index(joint) for joint in self.signatures[0].joints])
        resting = np.array(self.reference)[places] + self.encoder_bias
        ready = ready._with("yielding", ready.soft_joints(resting))
        return ready._with("weight", ready.weight_at(resting))

    def tree_pose(self, q):
        body, plan = self._worked_out()[0], plan_of(self.parent)
        own = self.coupling.positions(q - self.encoder_bias) - np.array(self.reference)
        poses = dynamics.poses(plan, dynamics.frames(plan, body, own))
        return pose_of(poses, self.axes, self.slides, self.parent)

    def _worked_out(self) -> tuple[dynamics.Body, Base]:
        return (self.body(), self.standing()) if self.prepared is None else self.prepared

    def _spring(self, q: Float[Array, " n"]) -> Float[Array, " n"]:
        return self.stiffness * (q - self.springref)

    def _nodes(self, q: Any, qd: Any) -> tuple[Any, Any, Any, Any]:
        """How nodes move with the joints, their positions and speeds, and how these bend."""
        own = q - self.encoder_bias
        S, bent = self.coupling.jacobian(own), self.coupling.bent(own, qd)
        return S, self.coupling.positions(own), carried(S, qd), bent

    def matrices(self, q, qd) -> Any:
        body, base = self._worked_out()
        plan = plan_of(self.parent)
        S, q, qd, bent = self._nodes(q, qd)
        E = dynamics.frames(plan, body, q - np.array(self.reference))
        M = dynamics.mass_matrix(plan, body, E) + jnp.diag(jnp.asarray(self.armature))
        bias = dynamics.inverse_dynamics(plan, body, E, base, qd, bent) + self._spring(q)
        if self.coupling.curves:
            bias = bias + self.armature * bent
        if self.floats:
            M, bias = without_slides(M, bias)
        return (M, bias) if S is None else (S.T @ M @ S, S.T @ bias)

    def damped(self, h, x, tau, qd, slope, stiffness):
        """Where goals drive, by one evaluation in the middle of the step: their law is quicker than
        what it moves, its torque is that of the middle and of second order, and the rest need be no
        better.
        """
        if self.drive_law is None:
            return super().damped(h, x, tau, qd, slope, stiffness)
        return dynamics.middle_step(self.matrices, h, x, tau, qd, slope, stiffness)

    @property
    def of_one_joint(self):
        return frozenset({"armature", "stiffness"} if self.coupling.ratios is None else ())

    def inverse(self, q, qd, qdd):
        """Joint torque of a motion [nq], dissipation excluded."""
        (body, base), plan = self._worked_out(), plan_of(self.parent)
        S, q, qd, bent = self._nodes(q, qd)
        qdd = carried(S, qdd) + bent
        E = dynamics.frames(plan, body, q - np.array(self.reference))

        def force(a):
            return dynamics.inverse_dynamics(plan, body, E, base, qd, a)

        tau = balanced(force, qdd, body) if self.floats else force(qdd)
        return gathered(S, tau + self.armature * qdd + self._spring(q))

    def rotors(self):
        own = jnp.asarray(self.armature)
        ratios = self.coupling.ratios
        return own if ratios is None else jnp.asarray(np.array(ratios).T ** 2) @ own

    def momenta(self, q: Float[Array, " nq"], qd: Float[Array, " nq"]) -> Float[Array, " nq"]:
        """Generalised momenta of a robot on a free base, armature excluded, in the frame in which
        its linear momentum is 0.
        """
        body, plan = self._worked_out()[0], plan_of(self.parent)
        S, q, qd, _ = self._nodes(q, qd)
        E = dynamics.frames(plan, body, q - np.array(self.reference))
        rest = still((0.0 * q[0],) * 3)

        def forces(a):
            return dynamics.inverse_dynamics(plan, body, E, rest, 0 * qd, a)

        return gathered(S, balanced(forces, qd, body))

    def drive(self, signature, u, q, qd):
        tau = u[: q.shape[0]] if signature.inputs else jnp.zeros_like(q)
        if self.floats and signature.inputs:  # nothing drives the angles of the base
            tau = jnp.concatenate([u[: q.shape[0] - 3], jnp.zeros(3, u.dtype)])
        if self.rides and signature.inputs:
            tau = tau - self._carried(u[-len(RIDE) :], q, qd)
        return tau - self.cubic_damping * qd**3 - self.coupling.braked(q - self.encoder_bias, qd)

    def _carried(self, ride: Any, q: Any, qd: Any) -> Any:
        """Joint torque that the base's motion takes beside that of the base at rest."""
        (body, base), plan = self._worked_out(), plan_of(self.parent)
        S, q, qd, _ = self._nodes(q, qd)
        E = dynamics.frames(plan, body, q - np.array(self.reference))
        steady = jnp.zeros_like(qd)
        moving, resting = (
            dynamics.inverse_dynamics(plan, body, E, b, qd, steady)
            for b in (self.riding(ride), base)
        )
        return gathered(S, moving - resting)

    def outline(self, x, signature):
        """The tree as one line that goes out along each limb and back."""
        tilt = (self.base_roll, self.base_pitch, self.base_yaw)
        return dynamics.outlined(self.tree_pose(x[0]).origin, tilt, self.parent)

    # ---- where effects of the mechanism act

    def loaded(
        self, mass: Float[Array, " nq"], beyond: Float[Array, "nq 3"] | None = None
    ) -> Robot:
        """The same with a point mass `beyond` the end of each joint's link: the next joint, else
        the link's centre of mass.
        """
        return self._with("added", beyond_ends(self, mass, beyond))

    def tilted(self, angle: Float[Array, " nq"]) -> Robot:
        """The same on a base turned by angle[0] about the first joint's axis."""
        R = dynamics.turn(*(getattr(self, name)[0] for name in PLACE[3:]))
        axis = tuple(sum(R[i][k] * self.axes[0][k] for k in range(3)) for i in range(3))
        return self._with("tilt", (angle[0], axis))

    def _with(self, field: str, value: Any) -> Robot:
        return eqx.tree_at(lambda m: getattr(m, field), self, value, is_leaf=lambda x: x is None)
