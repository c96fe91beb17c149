"""A robot whose joints and contacts give way as its file says where MuJoCo steps it."""

from __future__ import annotations

from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxid.dynamics.mechanism import Staged
from jaxid.dynamics.mujoco_step import SoftJoints
from jaxid.dynamics.parameter import constant, param
from jaxid.dynamics.soft_constraints import Edges, Slip, Stops
from jaxid.numerics.fast_math import inverse
from jaxid.numerics.precision import float64
from jaxid.robots.ground import distances_of, edges_of, Ground, TreePose, yielding_of
from jaxid.robots.steps import EXACT_STEPS


class Yielding(Staged):
    """Abstract: a tree of joints with the numbers of soft friction and soft stops, those of
    `jaxid.robots.file_step`, for each joint that leads.
    """

    slip_rate: Array = constant(0.0, unit="1/s", meaning="how quickly dry friction stops a joint")
    slip_share: Array = constant(0.0, unit="1", meaning="its compliance by the inverse inertia")
    stop_lower: Array = constant(0.0, unit="{X}", meaning="lower end of the joint")
    stop_upper: Array = constant(0.0, unit="{X}", meaning="upper end of the joint")
    stop_margin: Array = constant(0.0, unit="{X}", meaning="how far before its end a stop acts")
    stop_stiffness: Array = constant(0.0, unit="1/s^2", meaning="how hard it pushes back")
    stop_rate: Array = constant(0.0, unit="1/s", meaning="how quickly it stops a joint")
    stop_softest: Array = constant(0.0, unit="1", meaning="its impedance where it begins")
    stop_hardest: Array = constant(0.0, unit="1", meaning="its impedance further on")
    stop_width: Array = constant(0.0, unit="{X}", meaning="over which its impedance rises")
    stop_midpoint: Array = constant(0.0, unit="1", meaning="where that rise turns")
    stop_power: Array = constant(0.0, unit="1", meaning="how steep it is there")
    sliding_friction: Array = param(
        0.0, 0.0, 3.0, scale=0.1, unit="1", meaning="friction coefficient of a shape on the ground"
    )

    #: How a simulation steps: an integrator of `jaxid.dynamics.mujoco_step`, "" for jaxid's own.
    integrator: str = eqx.field(static=True, default="")
    tree: Any = eqx.field(static=True, default=None)  # the file's own numbers: a `StaticTree`
    yielding: Any = None  # `SoftJoints`, where they are ready
    ground: Ground | None = eqx.field(static=True, default=None)  # what touches planes
    weight: Any = None  # inverse mass at the points of the ground, where it is ready

    @property
    def own_step(self):
        return self.tree.tree.simulator.timestep if self.integrator else None

    @property
    def simulator(self) -> str:
        """Whose steps it takes: "own", "mujoco" or "mujoco_rk4"."""
        if not self.integrator:
            return "own"
        as_its_file = self.integrator == self.tree.tree.simulator.integrator
        return "mujoco" if as_its_file else EXACT_STEPS

    @property
    def first_order_steps(self):
        return self.tree.tree.steps if self.simulator == "mujoco" else None

    def soft_joints(self, at: Any = None) -> SoftJoints:
        """How joints give way where MuJoCo steps; `at` the positions [nq] of the file's reference
        pose, where they are not ready.
        """
        if self.yielding is not None:
            return self.yielding
        stops = []
        for name in Stops._fields:
            stops.append(getattr(self, f"stop_{name}"))
        M, _ = self.matrices(at, jnp.zeros_like(at))
        weight = jnp.sum(inverse(M) * np.eye(len(at)), -1)
        slip = Slip(rate=self.slip_rate, share=self.slip_share)
        return SoftJoints(slip=slip, stops=Stops(*stops), weight=weight)

    def tree_pose(self, q: Any) -> TreePose:
        """The nodes at positions q [nq] of the joints."""
        raise NotImplementedError

    def edges(self, q: Any, qd: Any) -> Edges | None:
        """Edges of the contacts with the ground at positions and speeds [nq]; None where nothing
        can touch.
        """
        if self.ground is None:
            return None
        return edges_of(self.ground, self.tree_pose(q), self.sliding_friction, self.weight, qd)

    def weight_at(self, at: Any) -> Any:
        """Inverse mass at the points of the ground, `at` the positions [nq] of the file's reference
        pose; None where there are none.
        """
        if self.ground is None:
            return None
        M, _ = self.matrices(at, jnp.zeros_like(at))
        return yielding_of(self.ground, self.tree_pose(at), M)

    def told_by_torque(self, q, beside):
        if self.ground is None:
            return super().told_by_torque(q, beside)
        ground = self.ground
        with float64():
            ready = cast(Yielding, self.prepare(None))
            least = jax.vmap(lambda x: jnp.min(distances_of(ground, ready.tree_pose(x))))(q)
        near = np.flatnonzero(np.asarray(least) <= 0)
        told = np.ones(len(q), bool)
        for sample in near:
            told[max(0, sample - beside) : sample + beside + 1] = False
        return told
