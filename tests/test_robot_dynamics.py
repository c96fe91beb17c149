"""Dynamics of trees against MuJoCo, which shares no code with them."""

import importlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxid.dynamics.parameter import with_fields
from jaxid.models import Robot
from jaxid.numerics.fast_math import dot, inverse as inverted
from jaxid.numerics.precision import float64
from simulated import quick_jit
from written_robots import ROBOTS, tilted


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads


STATES = 1000


def states(robot, count, seed=0):
    rng = np.random.default_rng(seed)
    n = len(robot.signatures[0].joints)
    return (rng.uniform(-k, k, (count, n)) for k in (3.0, 4.0, 8.0))


def peer(text, robot, q, qd, qdd):
    """M, bias and inverse dynamics of the moving joints by MuJoCo [states ...]; bias holds the
    springs and the weight that gravcomp takes off, as here.
    """
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data = mujoco.MjData(model)
    tree = robot.tree.tree
    number = [model.joint(name).id for name in tree.joints]
    at, dof = model.jnt_qposadr[number], model.jnt_dofadr[number]
    S, c = tree.follow()
    found = []
    dense = np.zeros((model.nv, model.nv))
    for a, b, d in zip(q, qd, qdd, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = model.qpos0, 0, 0
        data.qpos[at], data.qvel[dof], data.qacc[dof] = S @ a + c, S @ b, S @ d
        acc = data.qacc.copy()
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, dense)
        bias = data.qfrc_bias - data.qfrc_spring - data.qfrc_gravcomp
        data.qacc[:] = acc
        mujoco.mj_inverse(model, data)
        inverse = data.qfrc_inverse[dof]
        found.append((S.T @ dense[np.ix_(dof, dof)] @ S, S.T @ bias[dof], S.T @ inverse))
    return [np.array(x) for x in zip(*found, strict=True)]


@pytest.mark.parametrize("name", ROBOTS)
def test_tree_moves_as_in_mujoco(name):
    text = ROBOTS[name]()
    robot = Robot.from_mjcf(f"{name}.xml", text=text)
    q, qd, qdd = states(robot, STATES)
    M, bias, inverse = peer(text, robot, q, qd, qdd)

    def everything(q, qd, qdd, tau):
        ready = robot.prepare(None)
        M, bias = ready.matrices(q, qd)
        return (
            M,
            bias,
            ready.inverse(q, qd, qdd),
            dot(inverted(M), tau - bias),
        )  # as `Rigid.vector_field` does

    forward = np.linalg.solve(M, (inverse - bias)[..., None])[..., 0]
    with float64():  # to NumPy inside: outside, JAX would compare in float32
        own = [np.asarray(a) for a in quick_jit(jax.vmap(everything))(q, qd, qdd, inverse)]
    for mine, theirs in zip(own, (M, bias, inverse, forward), strict=True):
        assert mine.dtype == np.float64 and np.abs(mine - theirs).max() < 1e-9 * max(
            1.0, np.abs(theirs).max()
        )
    assert np.array_equal(own[0], np.swapaxes(own[0], 1, 2)) or robot.coupling.ratios is not None


def test_base_moves_as_prescribed_by_its_pose():
    """A base turned by its roll, pitch and yaw is the file's base turned so."""
    R = Robot.from_mjcf("tilted.xml", text=tilted())
    q, qd, qdd = states(R, STATES)
    angles = 0.3, -0.7, 1.1
    w = _quaternion(*angles)
    text = (
        tilted()
        .replace("<worldbody>", f'<worldbody><body quat="{" ".join(map(repr, w))}">')
        .replace("</worldbody>", "</body></worldbody>")
    )
    turned = with_fields(
        R,
        {f"base_{k}": np.float64(a) for k, a in zip(("roll", "pitch", "yaw"), angles, strict=True)},
    )
    M, bias, inverse = peer(text, R, q, qd, qdd)
    with float64():
        own_M, own_bias = (
            np.asarray(a)
            for a in quick_jit(jax.vmap(lambda q, v: turned.prepare(None).matrices(q, v)))(q, qd)
        )
    assert (
        np.abs(own_M - M).max() < 1e-9 and np.abs(own_bias - bias).max() < 1e-9 * np.abs(bias).max()
    )


def _quaternion(roll, pitch, yaw):
    out = np.zeros(4)
    quat = [np.zeros(4) for _ in range(3)]
    for k, a in enumerate((roll, pitch, yaw)):
        axis = np.zeros(3)
        axis[k] = 1.0
        mujoco.mju_axisAngle2Quat(quat[k], axis, a)
    mujoco.mju_mulQuat(out, quat[1], quat[0])
    both = np.zeros(4)
    mujoco.mju_mulQuat(both, quat[2], out)
    return [float(v) for v in both]


@pytest.mark.parametrize("name", ["shoulder", "hand"])
def test_gradients_are_finite_also_at_rest(name):
    robot = Robot.from_mjcf(f"{name}.xml", text=ROBOTS[name]())
    n = len(robot.signatures[0].joints)

    def torque(robot, q):
        return jnp.sum(robot.inverse(q, jnp.zeros(n), jnp.ones(n)))

    with float64():
        slope = jax.jit(jax.grad(torque, allow_int=True))(robot, jnp.zeros(n))
        along = jax.jit(jax.grad(lambda q: torque(robot, q)))(jnp.zeros(n))
    assert np.isfinite(along).all() and np.abs(along).max() > 0
    leaves = [leaf for leaf in jax.tree.leaves(slope) if leaf.dtype == np.float64]
    assert len(leaves) > 20 and all(np.isfinite(leaf).all() for leaf in leaves)
