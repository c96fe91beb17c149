"""Serial arms against Pinocchio, which shares no code with them, and against the maker's tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxid.base.errors import UsageError
from jaxid.dynamics import kinematics as kin, rigid_body as rb
from jaxid.dynamics.base_parameters import (
    base_parameters,
    standard_names,
    standard_torque,
    torque_columns,
)
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Command
from jaxid.dynamics.kinematics import ArmTable, modified_dh, standard_dh
from jaxid.dynamics.parameter import TypicalMagnitudes
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.models import Panda, SerialArm, UR10, UR10e
from jaxid.numerics.precision import float64
from jaxid.robots.urdf_tree import read_urdf
from simulated import Simulator


pin: Any = pytest.importorskip("pinocchio")

REFERENCE = TypicalMagnitudes(torque=50.0, speed=2.0, angle=3.0, duration=10.0, step=0.01)
DOWN = (0.0, 0.0, -9.81)
RIGHT = np.pi / 2


def turn(axis: str, angle: float) -> np.ndarray:
    return pin.SE3(pin.utils.rotate(axis, angle), np.zeros(3))


def shift(x: float, y: float, z: float) -> Any:
    return pin.SE3(np.eye(3), np.array([x, y, z], float))


def twin(table: ArmTable) -> Any:
    """The same chain in Pinocchio, its placements from elementary turns and shifts."""
    model = pin.Model()
    parent = 0
    for j in range(table.n):
        M = (
            turn("z", table.gamma[j])
            * shift(0, 0, table.b[j])
            * turn("x", table.alpha[j])
            * shift(table.a[j], 0, 0)
        )
        M = M * turn("z", table.theta[j]) * shift(0, 0, table.d[j])
        joint = pin.JointModelPZ() if table.prismatic[j] else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, M, f"j{j}")
        xx, xy, xz, yy, yz, zz, hx, hy, hz, m = table.inertia[j]
        body = pin.Inertia.FromDynamicParameters(np.array([m, hx, hy, hz, xx, xy, yy, xz, yz, zz]))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    return model


def full(M: np.ndarray) -> np.ndarray:
    return np.triu(M) + np.triu(M, 1).T


def random_table(rng: np.random.Generator, prismatic: list[bool]) -> ArmTable:
    """A chain with general placements between its joints and bodies that can exist."""
    n = len(prismatic)
    geometry = np.array([kin.geometry_of(pin.SE3.Random().homogeneous) for _ in range(n)]).T
    inertia = []
    for _ in range(n):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        sizes = rng.uniform(0.01, 0.4, 3)
        central = axes @ np.diag(sizes.sum() - sizes) @ axes.T
        inertia.append(
            rb.about_origin(
                rng.uniform(0.5, 8), rng.uniform(-0.3, 0.3, 3), central[np.triu_indices(3)]
            )
        )
    return ArmTable(
        *geometry, prismatic=tuple(prismatic), inertia=np.array(inertia), drive_inertia=np.zeros(n)
    )


def fast(arm: Any) -> Any:
    """Torque, acceleration and mass matrix of many states [samples n], compiled."""

    @jax.jit
    def run(q, qd, x):
        def one(q, qd, x):
            return (
                arm.inverse(q, qd, x),
                arm.vector_field(0.0, (q, qd), x)[1],
                arm.matrices(q, qd)[0],
            )

        return jax.vmap(one)(q, qd, x)

    def call(*arrays: np.ndarray) -> list[np.ndarray]:
        with float64():
            return [np.asarray(o) for o in run(*(jnp.asarray(a) for a in arrays))]

    return call


def relative(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference of a row, as a share of the row."""
    a, b = a.reshape(len(a), -1), b.reshape(len(b), -1)
    return float(np.max(np.abs(a - b).max(1) / np.abs(b).max(1)))


def compare(table: ArmTable, arm: Any, model: Any, count: int, seed: int = 1) -> None:
    rng = np.random.default_rng(seed)
    q, qd, x = rng.uniform(-3, 3, (3, count, table.n))
    data = model.createData()
    model.armature = np.asarray(arm.Ia)
    tau, qdd, M = fast(arm)(q, qd, x)
    assert (
        relative(tau, np.array([pin.rnea(model, data, *s) for s in zip(q, qd, x, strict=True)]))
        < 1e-9
    )
    assert (
        relative(qdd, np.array([pin.aba(model, data, *s) for s in zip(q, qd, x, strict=True)]))
        < 1e-9
    )
    assert relative(M, np.array([full(pin.crba(model, data, s)) for s in q])) < 1e-9


def table_of(arm: Any) -> ArmTable:
    geometry = (np.asarray(getattr(arm, k)) for k in ("a", "alpha", "d", "theta", "b", "gamma"))
    with float64():
        return ArmTable(
            *geometry,
            prismatic=arm.prismatic,
            inertia=np.asarray(arm.inertia()),
            drive_inertia=np.asarray(arm.Ia),
        )


def test_ur10_equals_pinocchio():
    """Torque, acceleration and mass matrix at 1000 random states, drive inertias included."""
    arm = UR10()
    compare(table_of(arm), arm, twin(table_of(arm)), 1000)


@pytest.mark.parametrize("prismatic", [(0, 1, 0, 1), (1, 0, 0), (1, 1, 1, 0, 0, 0, 1)], ids=str)
def test_mixed_chains_equal_pinocchio(prismatic):
    pin.seed(4)
    table = random_table(np.random.default_rng(2), [bool(p) for p in prismatic])
    compare(table, SerialArm(table), twin(table), 60)


def test_regressor_equals_pinocchio():
    pin.seed(5)
    for table in (
        table_of(UR10()),
        random_table(np.random.default_rng(3), [False, True, False, False]),
    ):
        model, n = twin(table), table.n
        data = model.createData()
        rng = np.random.default_rng(0)
        q, qd, qdd = rng.uniform(-3, 3, (3, 40, n))
        ours = torque_columns(SerialArm(table), q, qd, qdd).reshape(40, n, n, 11)
        order = [9, 6, 7, 8, 0, 1, 3, 2, 4, 5]  # theirs: m, first moments, Ixx Ixy Iyy Ixz Iyz Izz
        theirs = np.array(
            [pin.computeJointTorqueRegressor(model, data, *s) for s in zip(q, qd, qdd, strict=True)]
        )
        assert (
            np.max(np.abs(ours[..., order] - theirs.reshape(40, n, n, 10)))
            < 1e-9 * np.abs(theirs).max()
        )


def test_the_torque_of_standard_parameters_is_their_columns_times_them():
    rng = np.random.default_rng(6)
    for table in (table_of(UR10()), random_table(rng, [False, True, False, False])):
        arm, phi = SerialArm(table), rng.uniform(-1, 1, 11 * table.n)
        motion = rng.uniform(-3, 3, (3, 40, table.n))
        expected = torque_columns(arm, *motion) @ phi
        assert np.allclose(
            standard_torque(arm, phi, *motion),
            expected,
            rtol=0,
            atol=1e-12 * np.abs(expected).max(),
        )


def test_compiled_and_plain_recursions_agree():
    """The same formulas under `lax.scan` and in NumPy, batched behind the joints."""
    arm = UR10()
    q, qd, qdd = np.random.default_rng(0).uniform(-2, 2, (3, 6, 30))
    E = kin.placements(arm, arm.prismatic, q)
    phi = table_of(arm).inertia
    bodies, base = rb.chain_of(arm.prismatic, batch=1, inertia=phi), rb.still(DOWN)
    plain = (
        rb.inverse_dynamics(E, bodies, base, qd, qdd),
        rb.regressor(E, bodies, base, qd, qdd),
    )
    with float64():

        @jax.jit
        def run(q, qd, qdd):
            E = kin.placements(arm, arm.prismatic, q)
            tau = rb.inverse_dynamics(E, bodies, base, qd, qdd)
            return tau, rb.regressor(E, bodies, base, qd, qdd)

        for a, b in zip(run(*(jnp.asarray(x) for x in (q, qd, qdd))), plain, strict=True):
            assert np.allclose(a, b, rtol=1e-11, atol=1e-11)


# ---- kinematics


def dh_standard(q: np.ndarray, a, alpha, d) -> np.ndarray:
    T = pin.SE3.Identity()
    for j in range(len(q)):
        T = T * turn("z", q[j]) * shift(0, 0, d[j]) * shift(a[j], 0, 0) * turn("x", alpha[j])
    return T.homogeneous


def test_ur10_modified_table_is_the_makers_standard_one():
    """T_std = Rz(pi) T_mdh Rz(pi) (paper 001's table flips x axes), and the upright pose is where
    the maker draws it.
    """
    maker = (
        [0, -0.612, -0.5723, 0, 0, 0],
        [RIGHT, 0, 0, RIGHT, -RIGHT, 0],
        [0.1273, 0, 0, 0.163941, 0.1157, 0.0922],
    )
    table, flip = table_of(UR10()), np.diag([-1.0, -1.0, 1.0, 1.0])
    for q in np.random.default_rng(0).uniform(-3, 3, (20, 6)):
        assert np.allclose(flip @ kin.flange(table, q) @ flip, dh_standard(q, *maker), atol=1e-14)
    up = kin.flange(table, np.array([0, -RIGHT, 0, -RIGHT, 0, 0]))
    assert np.allclose(np.abs(up[:3, 3]), [0, 0.256141, 1.4273], atol=1e-6)


def test_standard_table():
    rng = np.random.default_rng(1)
    a, alpha, d = rng.uniform(-0.5, 0.5, 5), rng.uniform(-3, 3, 5), rng.uniform(-0.5, 0.5, 5)
    table = standard_dh(a, alpha, d)
    for q in rng.uniform(-3, 3, (10, 5)):
        assert np.allclose(kin.flange(table, q), dh_standard(q, a, alpha, d), atol=1e-14)


def test_tables_of_unequal_length_are_refused():
    with pytest.raises(UsageError, match="alpha has 2"):
        modified_dh([0, 0, 0], [0, 0], [0, 0, 0])


def test_tilted_base_and_payload():
    """A wall-mounted arm with a known load against Pinocchio with turned gravity and an added
    body.
    """
    import equinox as eqx

    arm = eqx.tree_at(
        lambda m: (m.base_roll, m.base_pitch, m.payload, m.payload_x, m.payload_y, m.payload_z),
        UR10(),
        tuple(np.float64(x) for x in (0.7, -1.1, 3.5, 0.02, -0.05, 0.08)),
    )
    table = table_of(UR10())
    model = twin(table)
    model.appendBodyToJoint(
        6, pin.Inertia(3.5, np.array([0.02, -0.05, 0.08]), np.zeros((3, 3))), pin.SE3.Identity()
    )
    model.gravity.linear = (pin.utils.rotate("y", -1.1) @ pin.utils.rotate("x", 0.7)).T @ np.array(
        DOWN
    )
    compare(table, arm, model, 50)


# ---- URDF


URDF = """<robot name="test">
  <link name="world"/>
  <link name="base"><inertial><mass value="9"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="mount" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0.1 0.2 0.3" rpy="0.1 0 0.4"/></joint>
  <link name="upper"><inertial><origin xyz="0.1 0.02 0.3" rpy="0.3 0.2 -0.5"/><mass value="4"/>
    <inertia ixx="0.3" ixy="0.01" ixz="-0.02" iyy="0.4" iyz="0.03" izz="0.2"/>
  </inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0.1 0.5" rpy="0.2 -0.3 0.1"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="50" velocity="3"/><dynamics damping="0.7" friction="1.2"/></joint>
  <link name="slide"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.12" izz="0.05" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="lift" type="prismatic"><parent link="upper"/><child link="slide"/><origin xyz="0.3 0 0" rpy="0 0 1"/>
    <axis xyz="0.6 0 0.8"/><limit lower="0" upper="0.4" effort="9" velocity="1"/></joint>
  <link name="bracket"><inertial><origin xyz="0.02 0.01 0" rpy="1 0 0"/><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.015" ixy="0" ixz="0.001" iyz="0"/>
  </inertial></link>
  <joint name="bolt" type="fixed"><parent link="slide"/><child link="bracket"/><origin xyz="0.05 0 0.2" rpy="0 0.4 0"/></joint>
  <link name="camera"><inertial><mass value="0.2"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="clamp" type="fixed"><parent link="upper"/><child link="camera"/><origin xyz="0 0.1 0"/></joint>
  <link name="hand"><inertial><origin xyz="0 0 0.05"/><mass value="1"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.01" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="wrist" type="continuous"><parent link="bracket"/><child link="hand"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 0 -1"/></joint>
  <link name="tool"/>
  <joint name="flange" type="fixed"><parent link="hand"/><child link="tool"/><origin xyz="0 0 0.2" rpy="0 1.5 0"/></joint>
</robot>"""


def test_urdf_read_by_both(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    arm = SerialArm.from_urdf(path)
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    assert model.nv == 3
    rng = np.random.default_rng(0)
    q, qd, x = rng.uniform(-2, 2, (3, 50, 3))
    tau, qdd, M = fast(arm)(q, qd, x)
    theirs = [
        np.r_[s[:2], np.cos(s[2]), np.sin(s[2])] for s in q
    ]  # a continuous joint is a point on a circle there
    assert (
        relative(
            tau, np.array([pin.rnea(model, data, *s) for s in zip(theirs, qd, x, strict=True)])
        )
        < 1e-9
    )
    assert (
        relative(qdd, np.array([pin.aba(model, data, *s) for s in zip(theirs, qd, x, strict=True)]))
        < 1e-9
    )
    assert relative(M, np.array([full(pin.crba(model, data, s)) for s in theirs])) < 1e-9
    table = read_urdf(path, tip="tool")
    assert table.joints == ("shoulder", "lift", "wrist") and table.prismatic == (False, True, False)
    assert list(table.upper) == [2, 0.4, np.inf] and list(table.velocity) == [3, 1, np.inf]
    pin.forwardKinematics(model, data, theirs[0])
    pin.updateFramePlacements(model, data)
    assert np.allclose(
        kin.flange(table, q[0]), data.oMf[model.getFrameId("tool")].homogeneous, atol=1e-12
    )
    effects = {e.name: e for e in Chain(arm).effects}
    assert list(effects["coulomb_friction"].level) == [1.2, 0, 0]  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('type="continuous"', 'type="floating"'), "wrist.*floating"),
        (('<parent link="bracket"/>', '<parent link="braket"/>'), "braket.*did you mean 'bracket'"),
        (('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>'), "shoulder.*zero"),
        (('<mass value="4"/>', '<mass value="four"/>'), "mass of link 'upper'.*four"),
        (("<robot", "<robt"), "not XML"),
        (('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/><mimic joint="lift"/>'), "wrist.*mimics"),
        (('name="clamp" type="fixed"', 'name="clamp" type="revolute"'), "several branches.*tip"),
        (
            ('<robot name="test">', '<!DOCTYPE r [<!ENTITY e "x">]><robot name="test">&e;'),
            "entities",
        ),
    ],
    ids=lambda x: None if isinstance(x, tuple) else str(x)[:12],
)
def test_urdf_faults_are_named(tmp_path, change, message):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.replace(*change))
    with pytest.raises(UsageError, match=message):
        read_urdf(path)


# ---- properties


MANY = 10_000


@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_mass_matrix_is_symmetric_and_positive_definite(seed):
    """10,000 random states in one batch."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-np.pi, np.pi, (MANY, 6))
    with float64():
        M = np.asarray(matrices_of_ur10(jnp.asarray(q)))
    assert np.array_equal(M, np.swapaxes(M, 1, 2))
    assert np.linalg.eigvalsh(M).min() > 1e-3


matrices_of_ur10 = jax.jit(jax.vmap(lambda q: UR10().matrices(q, 0 * q)[0]))


def test_consistent_bodies():
    """The preset's links can exist, Table VI's could not; rods as start values can."""
    for arm in (UR10(), UR10e(), Panda(), SerialArm()):
        assert np.linalg.eigvalsh(rb.pseudo_inertia(table_of(arm).inertia)).min() > 0
    body = rb.about_origin(2.0, [0.1, 0, 0.2], [0.1, 0, 0, 0.1, 0, 0.25])  # 0.25 > 0.1 + 0.1
    assert np.linalg.eigvalsh(rb.pseudo_inertia(body)).min() < 0


def test_energy_is_kept():
    """20 s of free fall in steps of 1 ms, the wrist turning at up to 40 rad/s."""
    arm = UR10()

    def energy(q, v):
        F, phi = arm.frames(q), arm.inertia()
        height = phi[:, 9] * F.p[2] + phi[:, 6] * F.x[2] + phi[:, 7] * F.y[2] + phi[:, 8] * F.z[2]
        return v @ arm.matrices(q, v)[0] @ v / 2 + 9.81 * jnp.sum(height)

    def block(x, _):
        def step(x, _):
            free = arm.free(1e-3, x, jnp.zeros(6))
            return arm.close(1e-3, x, free, jnp.zeros(6), free.qd, jnp.zeros(6)), None

        return jax.lax.scan(step, x, None, length=200)[0], (energy(*x), jnp.abs(x[1]).max())

    with float64():
        x = jnp.array([0.3, -1.2, 0.8, -0.5, 0.4, 0.2]), jnp.array([0.5, -0.3, 0.2, 0.4, 0.3, 0.2])
        E, speed = jax.jit(lambda x: jax.lax.scan(block, x, None, length=100)[1])(x)
    assert np.max(np.asarray(speed)) > 20
    assert np.ptp(np.asarray(E)) < 1e-8 * 200  # J; the arm exchanges 200 J


def test_no_gradient_is_nan():
    """1000 random draws of all parameters, at rest and in motion, of torque and acceleration,
    friction included.
    """
    chain = Chain(UR10()).smoothed(1e-2)
    layout = ParameterVector(chain)
    lower, upper, _ = layout.boxes([REFERENCE] * 6)
    friction = np.array([e.owner >= 0 and not e.spec.fixed for e in layout.entries])

    def torque(theta, q, qd, qdd):
        model = layout.model(theta)
        still = Command(
            jnp.zeros(()), jnp.full((), 1e-3), jnp.zeros(6), jnp.zeros(6), lambda d: jnp.zeros(6)
        )
        z = model.start(q, qd, jnp.zeros(6)).z
        return model.inverse(still, z, q, qd, qdd)[0]

    def acceleration(theta, q, qd, tau):
        return layout.model(theta).ode()(0.0, (q, qd), (None, lambda t: tau))[1]

    @jax.jit
    @jax.vmap
    def slopes(theta, q, qd, x):
        return [jax.jacfwd(f, (0, 1, 2, 3))(theta, q, qd, x) for f in (torque, acceleration)]

    rng = np.random.default_rng(0)
    theta = np.tile(layout.values, (1000, 1))
    share = rng.uniform(size=(1000, int(friction.sum()))) ** 2
    theta[:, friction] = lower[friction] + share * (upper - lower)[friction]
    theta[:, : 11 * 6] *= rng.uniform(0.8, 1.25, (1000, 66))
    q, qd, x = rng.uniform(-3, 3, (3, 1000, 6))
    qd[:300] = 0.0
    q[:100], x[:100] = 0.0, 0.0
    with float64():
        for k in range(0, 1000, 250):
            part = slice(k, k + 250)
            for jacobian in jax.tree.leaves(
                slopes(*(jnp.asarray(a[part]) for a in (theta, q, qd, x)))
            ):
                assert np.isfinite(jacobian).all()


def test_simulation_with_friction_sticks():
    """The whole chain, six joints with dry friction: an arm held by friction stands still, the same
    arm without falls.
    """
    chain = Chain(UR10())
    t = np.arange(0, 0.2, 2e-3)
    s = Simulator(chain, t, np.zeros((len(t), 6)), size=1024)
    start = [0.1, -1.5, 0.2, -1.5, 0.1, 0.0, *np.zeros(6)]
    y = s.outputs([{f"F_c{j}": 500.0 for j in range(1, 7)}, {}], start)
    assert np.abs(y[0] - start[:6]).max() < 1e-8
    assert np.abs(y[1, -1] - start[:6]).max() > 1e-3 and np.isfinite(y).all()


# ---- what a fit sees of it


def test_names_units_and_what_is_held():
    pin.seed(1)
    arm = SerialArm(random_table(np.random.default_rng(0), [False, True, False]))
    layout = ParameterVector(Chain(arm))
    unit = {e.name: e.unit for e in layout.entries}
    assert unit["m2"] == "kg" and unit["Ixx3"] == "kg m^2" and unit["mx1"] == "kg m"
    assert unit["Ia1"] == "kg m^2" and unit["Ia2"] == "kg"
    assert unit["F_c1"] == "N m" and unit["F_c2"] == "N" and unit["F_v2"] == "N (s/m)^exponent"
    assert [u for _, u in arm.signatures[0].inputs] == ["N m", "N", "N m"]
    assert {"exponent1", "exponent2", "exponent3"} <= arm.held()
    assert layout.values[layout.index("m2")] == arm.m[1]
    moved = layout.model(np.arange(len(layout)) + 0.5)  # pyright: ignore[reportArgumentType]
    assert moved.mechanism.Iyz[2] == layout.index("Iyz3") + 0.5  # pyright: ignore[reportAttributeAccessIssue]


def test_preset_data_is_the_shared_one():
    content = json.loads(
        (Path(__file__).parents[1] / "models" / "ur10_consistent.json").read_text()
    )
    assert content["order"] == list(standard_names(6))
    assert (
        np.linalg.eigvalsh(rb.pseudo_inertia(np.array(content["phi"]).reshape(6, 11)[:, :10])).min()
        > 9e-6
    )


# ---- base parameters


PAPER = (
    "Izz1 Ixx2 Ixy2 Ixz2 Iyz2 Izz2 mx2 my2 Ixx3 Ixy3 Ixz3 Iyz3 Izz3 mx3 my3 Ixx4 Ixy4 Ixz4 Iyz4 Izz4 mx4 my4 "
    "Ixx5 Ixy5 Ixz5 Iyz5 Izz5 mx5 my5 Ixx6 Ixy6 Ixz6 Iyz6 Izz6 mx6 my6 Ia3 Ia4 Ia5 Ia6"
).split()
#: Appendix of paper 001 (damaged print repaired from the geometry): the rows with regrouping.
REGROUPED = {
    "Izz1": "Izz1 + Ia1 + Iyy2 + Iyy3 + Iyy4 + a3^2 m3 + 2 d4 mz4 + (a3^2 + a4^2 + d4^2) (m4 + m5 + m6)",
    "Ixx2": "Ixx2 - Iyy2 - a3^2 (m3 + m4 + m5 + m6)",
    "Ixz2": "Ixz2 - a3 (mz3 + mz4) - a3 d4 (m4 + m5 + m6)",
    "Izz2": "Izz2 + Ia2 + a3^2 (m3 + m4 + m5 + m6)",
    "mx2": "mx2 + a3 (m3 + m4 + m5 + m6)",
    "Ixx3": "Ixx3 - Iyy3 - a4^2 (m4 + m5 + m6)",
    "Ixz3": "Ixz3 - a4 mz4 - a4 d4 (m4 + m5 + m6)",
    "Izz3": "Izz3 + a4^2 (m4 + m5 + m6)",
    "mx3": "mx3 + a4 (m4 + m5 + m6)",
    "Ixx4": "Ixx4 - Iyy4 + Iyy5 + 2 d5 mz5 + d5^2 (m5 + m6)",
    "Izz4": "Izz4 + Iyy5 + 2 d5 mz5 + d5^2 (m5 + m6)",
    "my4": "my4 + mz5 + d5 (m5 + m6)",
    "Ixx5": "Ixx5 - Iyy5 + Iyy6 + 2 d6 mz6 + d6^2 m6",
    "Izz5": "Izz5 + Iyy6 + 2 d6 mz6 + d6^2 m6",
    "my5": "my5 - mz6 - d6 m6",
    "Ixx6": "Ixx6 - Iyy6",
}


def test_ur10_has_the_papers_base_parameters():
    """Forty of inertia in the paper's order, hence 58 with friction, and its regrouping."""
    arm = UR10()
    base = arm.base()
    assert list(base.names) == PAPER
    symbols = {f"{k}{j + 1}": float(getattr(arm, k)[j]) for k in "ad" for j in range(6)}
    expressions = dict(zip(base.names, base.expressions(symbols), strict=True))
    assert expressions == {name: REGROUPED.get(name, name) for name in PAPER}


@pytest.mark.parametrize("prismatic", [(0, 0, 0), (0, 1, 0, 0), (1, 1, 0)], ids=str)
def test_base_parameters_say_all_that_torque_does(prismatic):
    pin.seed(7)
    table = random_table(np.random.default_rng(5), [bool(p) for p in prismatic])
    arm = SerialArm(table)
    base = base_parameters(arm)
    rng = np.random.default_rng(9)
    W = torque_columns(arm, *rng.uniform(-2, 2, (3, 200, table.n))).reshape(-1, 11 * table.n)
    assert np.linalg.matrix_rank(W, 1e-9 * np.linalg.norm(W, 2)) == len(base.kept)
    assert np.abs(W - W[:, base.kept] @ base.K).max() < 1e-9 * np.abs(W).max()
    phi = rng.normal(size=11 * table.n)
    assert np.allclose(W @ phi, W[:, base.kept] @ base.values(phi), atol=1e-9)


def test_panda_and_tilted_bases():
    """The 43 coefficients known of the Panda; a tilted base shows two first moments of link 1
    more.
    """
    import equinox as eqx

    assert len(Panda().base().kept) == 43
    tilted = eqx.tree_at(lambda m: m.base_roll, UR10(), np.float64(0.5))
    assert set(tilted.base().names) - set(PAPER) == {"mx1", "my1"}
