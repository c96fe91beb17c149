"""Motion and forces of all joints of a robot by those that lead, where some follow others."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxid.robots.curves import Curve
from jaxid.robots.tree import Tree


class Follower(NamedTuple):
    """A joint that follows by a curve: its place, that of its leader among those that lead, and its
    viscous friction.
    """

    joint: int
    leader: int
    curve: Curve
    damping: float


class Coupled(NamedTuple):
    """All joints = `ratios` q + `shift`, but for those that follow by `curves`; `ratios` None where
    all lead.
    """

    ratios: tuple[tuple[float, ...], ...] | None
    shift: tuple[float, ...]
    curves: tuple[Follower, ...] = ()

    def positions(self, q: Any) -> Any:
        """Of all joints."""
        if self.ratios is None:
            return q
        out = np.array(self.ratios) @ q + np.array(self.shift)
        for one in self.curves:
            out = jnp.asarray(out).at[one.joint].set(one.curve.at(q[one.leader])[0])
        return out

    def jacobian(self, q: Any) -> Any:
        """Rates of all joints by those that lead [n leading]; None where all lead."""
        if self.ratios is None:
            return None
        out = np.array(self.ratios)
        for one in self.curves:
            slope = one.curve.at(q[one.leader])[1]
            out = jnp.asarray(out).at[one.joint, one.leader].set(slope)
        return out

    def bent(self, q: Any, qd: Any) -> Any:
        """Accelerations that curves give all joints while those that lead keep their speed."""
        out = jnp.zeros(len(self.shift), jnp.result_type(qd))
        for one in self.curves:
            bend = one.curve.at(q[one.leader])[2]
            out = out.at[one.joint].set(bend * qd[one.leader] ** 2)
        return out

    def braked(self, q: Any, qd: Any) -> Any:
        """Viscous friction, at those that lead, of joints that follow by curves, beside what it is
        where a line touches these.
        """
        out = jnp.zeros_like(qd)
        for one in self.curves:
            slope = one.curve.at(q[one.leader])[1]
            more = one.damping * (slope**2 - one.curve.tangent()[1] ** 2)
            out = out.at[one.leader].add(more * qd[one.leader])
        return out


def coupled(tree: Tree) -> Coupled:
    """How the joints of a tree follow each other."""
    S, c = tree.follow()
    ratios = tuple(tuple(map(float, row)) for row in S)
    curves = []
    for one in tree.couplings:
        if one.curve is not None:
            joint, leader = tree.joint(one.follower), tree.leading.index(one.leader)
            curves.append(Follower(joint, leader, one.curve, float(tree.damping[joint, 0])))
    follows = bool(tree.couplings) or tree.floats
    return Coupled(ratios if follows else None, tuple(map(float, c)), tuple(curves))


def carried(S: Any, rates: Any) -> Any:
    """Rates of all joints by those that lead; `S` None: all lead."""
    return rates if S is None else S @ rates


def gathered(S: Any, tau: Any) -> Any:
    """Torques at the joints that lead by those at all joints."""
    return tau if S is None else S.T @ tau
