"""What was found goes back into the simulator: patched files, code for what has no field, and the
round trip in MuJoCo.
"""

import importlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxid
import jaxid.dynamics.catalogue
from jaxid.cli.app import main
from jaxid.data.dataset import ModelSpec
from jaxid.robots.bodies import fault
from jaxid.robots.export.identified import nearest_bodies
from jaxid.robots.export.run import export
from jaxid.robots.export.save import save
from jaxid.robots.export.targets import TARGETS
from jaxid.robots.export.xml_text import XmlText
from jaxid.simulation.mujoco_run import Driven, MujocoRobot
from simulated import Simulator


mujoco: Any = importlib.import_module("mujoco")

ARM = """<mujoco model="arm">
  <!-- two joints about y, driven by position actuators -->
  <compiler angle="radian"/>
  <option timestep="2.5e-4" integrator="RK4"/>
  <default>
    <joint damping="0.2" armature="0.02"/> <!-- the motors' -->
  </default>
  <worldbody>
    <body name="upper">
      <joint name="lift" axis="0 1 0"
             range="-2 2"/>
      <inertial pos="0.1 0 0.02" quat="1 0.2 0 0" mass="0.6" diaginertia="2e-3 3e-3 2.5e-3"/>
      <body name="fore" pos="0.25 0 0">
        <joint name="bend" axis='0 1 0' stiffness="0.5" springref="0.1"/>
        <inertial pos="0.08 0 0" mass="0.3" diaginertia="5e-4 1e-3 1e-3"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="lift_act" joint="lift" kp="20" kv="0.8" forcerange="-6 6"/>
    <general joint="bend" gear="2" gainprm="3" biastype="affine" biasprm="0 -3 -0.1"/> <!-- kp 12, kd 0.4 at the joint -->
  </actuator>
</mujoco>
"""
URDF = """<?xml version="1.0"?>
<robot name="arm">
  <!-- kept -->
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0" rpy="0.3 0 0"/><mass value="0.6"/>
    <inertia ixx="2e-3" ixy="0" ixz="0" iyy="3e-3" iyz="0" izz="2.5e-3"/></inertial></link>
  <link name="tip"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="lift" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="9" velocity="5"/></joint>
  <joint name="glue" type="fixed"><parent link="upper"/><child link="tip"/><origin xyz="0.3 0 0"/></joint>
</robot>
"""
JOINTS = ("lift", "bend")


def entry(value, std=1e-3, unit=""):
    return {"value": value, "std": std, "unit": unit}


def fit(parameters=None, effects=(), path: str | Path = "", **robot):
    """A fit.json of the arm as jaxid writes it."""
    drive = {
        "origin": "file",
        "kind": "pd",
        "period": 0.0,
        "joints": {
            "lift": {
                "kp": 20.0,
                "kd": 0.8,
                "gain": 1.0,
                "lowest": -6.0,
                "highest": 6.0,
                "offset": 0.0,
                "delay": 0.0,
                "lag": 0.0,
            },
            "bend": {
                "kp": 12.0,
                "kd": 0.4,
                "gain": 1.0,
                "lowest": None,
                "highest": None,
                "offset": 0.0,
                "delay": 0.0,
                "lag": 0.0,
            },
        },
    }
    own = {"file": str(path), "joints": list(JOINTS), "held": {}, "drive": drive} | robot
    named = [
        {"effect": e, "location": where, "parameters": {k: entry(v) for k, v in n.items()}}
        for e, where, n in effects
    ]
    return {
        "schema": 1,
        "kind": "fit",
        "model": "robot",
        "robot": own,
        "effects": named,
        "parameters": {k: entry(v) for k, v in (parameters or {}).items()},
    }


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return path


# ---- round trip: jaxid's free run with an effect, and MuJoCo's of the patched file

#: Every effect that the round trip goes through, at the value that makes it nothing.
NEUTRAL: dict[tuple[str, str], dict[str, float]] = {
    ("torque_scale", "bend_tau"): {"gain": 0.0},
    ("saturation", "bend_tau"): {"limit": 1e12},
    ("back_emf", "lift_tau"): {"constant": 0.0},
    ("input_delay", "lift_cmd"): {"delay": 0.0},
    ("actuator_lag", "lift_cmd"): {"lag": 0.0},
    ("constant_torque", "bend"): {"torque": 0.0},
    ("spring_torque", "bend"): {"stiffness": 0.0},
    ("quadratic_drag", "lift"): {"coefficient": 0.0},
    ("reflected_inertia", "bend"): {"inertia": 0.0},
    ("payload", "bend"): {"mass": 0.0},
    ("gravity_offset", "lift"): {"tilt": 0.0},
}
#: (name, fitted numbers, effects, largest error over the effect's size)
EXACT = [
    ("damping", {"damping@lift": 0.5}, {}),
    ("armature", {"armature@bend": 0.05}, {}),
    ("mass and centre", {"mass@fore": 0.45, "com_x@fore": 0.1, "com_z@fore": 0.03}, {}),
    (
        "inertia",
        {"gyration_xx@upper": 0.12, "gyration_zz@upper": 0.15, "gyration_zx@upper": 0.03},
        {},
    ),
    ("gains", {"kp@lift": 14.0, "kd@lift": 1.4, "kp@bend": 9.0}, {}),
    ("limit", {"highest@lift": 1.2}, {}),
    ("encoder bias", {"encoder_bias@bend": 0.2}, {}),
    ("torque scale", {}, {("torque_scale", "bend_tau"): {"gain": -0.3}}),
    ("saturation", {}, {("saturation", "bend_tau"): {"limit": 0.5}}),
    ("back EMF", {}, {("back_emf", "lift_tau"): {"constant": 0.4}}),
    ("delay", {}, {("input_delay", "lift_cmd"): {"delay": 0.0137}}),
    ("lag", {}, {("actuator_lag", "lift_cmd"): {"lag": 0.03}}),
    ("torque", {}, {("constant_torque", "bend"): {"torque": 0.25}}),
    (
        "torque and saturation",
        {},
        {("constant_torque", "bend"): {"torque": 0.25}, ("saturation", "bend_tau"): {"limit": 0.6}},
    ),
    ("spring", {}, {("spring_torque", "bend"): {"stiffness": 1.5}}),
    ("drag", {}, {("quadratic_drag", "lift"): {"coefficient": 0.3}}),
    ("rotor", {}, {("reflected_inertia", "bend"): {"inertia": 0.03}}),
    ("payload", {}, {("payload", "bend"): {"mass": 0.2}}),
    (
        "placed payload",
        {},
        {("payload", "bend"): {"mass": 0.2, "dx": 0.1, "dy": 0.02, "dz": -0.05}},
    ),
    ("tilt", {}, {("gravity_offset", "lift"): {"tilt": 0.15}}),
]
APPROXIMATE = [("frictionloss", {"frictionloss@lift": 0.3, "frictionloss@bend": 0.1}, {})]


class Bench:
    """Goals for both joints, and the runs of both simulators on them."""

    def __init__(self, folder: Path):
        self.path = folder / "arm.xml"
        self.path.write_text(ARM)
        self.t = np.arange(0, 2.0, 0.002)
        self.goals = np.stack(
            [
                0.7 * np.sin(2 * np.pi * (0.4 + 0.3 * self.t) * self.t),
                -0.5 * np.sin(2 * np.pi * 0.8 * self.t),
            ],
            1,
        )
        moving = {
            j: 1e-3 * np.sin(self.t) for j in JOINTS
        }  # what was measured counts for nothing here
        goals = {f"{j}_cmd": self.goals[:, k] for k, j in enumerate(JOINTS)}
        units = dict.fromkeys((*moving, *goals), "rad")
        start = {name: 0.0 for j in JOINTS for name in (j, f"{j}_qd")}
        # Steps of no order of their own: what is exported is compared, not what steps make.
        own = ModelSpec(simulator="own")
        self.data = jaxid.Dataset.from_arrays(
            self.t, goals, moving, units=units, initial=start, model=own
        )
        self.model = jaxid.models.Robot.from_mjcf(self.path)
        cases = [*EXACT, *APPROXIMATE]
        self.plain, *runs = self.by_jaxid([({}, {}), *((p, e) for _, p, e in cases)])
        self.runs = {name: run for (name, _, _), run in zip(cases, runs, strict=True)}

    def by_jaxid(self, cases):
        """Free runs with the numbers and effects of each case: one program, a lane each."""
        from jaxid.problem.binding import bind

        binding = bind(
            self.model, self.data, effects=[f"{e}@{where}" for e, where in NEUTRAL], splits=False
        )
        own = Simulator(binding.chain, self.t, self.goals, whole=True)
        thetas = []
        for parameters, effects in cases:
            numbers = {
                f"{e}.{k}@{where}": v
                for (e, where), n in {**NEUTRAL, **effects}.items()
                for k, v in n.items()
            }
            theta = binding.theta.copy()
            for name, value in {**numbers, **parameters}.items():
                theta[binding.layout.index(name)] = value
            thetas.append(theta)
        assert own.layout.names == binding.layout.names
        names = [n for n, _ in binding.chain.signature.outputs]
        return list(own.outputs(np.array(thetas))[:, :, [names.index(j) for j in JOINTS]])

    def by_mujoco(self, path: Path):
        from jaxid.robots.mjcf import read_mjcf

        robot = MujocoRobot(path, read_mjcf(path), {}, None)
        return robot.run(
            JOINTS,
            self.t,
            self.goals,
            [False] * 2,
            Driven("goal", None, robot),
            np.zeros(2),
            np.zeros(2),
        )


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return Bench(tmp_path_factory.mktemp("arm"))


def error_over_size(bench: Bench, name: str, parameters, effects, out: Path):
    found = export(fit(parameters, [(*key, n) for key, n in effects.items()], bench.path), "mjcf")
    save(found, out)
    size = np.sqrt(np.mean((bench.runs[name] - bench.plain) ** 2))
    error = np.sqrt(np.mean((bench.by_mujoco(out / "arm.xml") - bench.runs[name]) ** 2))
    return found, error / size, size


@pytest.mark.slow
def test_both_simulators_agree_on_the_file_as_it_stands(bench):
    assert np.sqrt(np.mean((bench.by_mujoco(bench.path) - bench.plain) ** 2)) < 1e-3


@pytest.mark.parametrize(("name", "parameters", "effects"), EXACT, ids=[e[0] for e in EXACT])
def test_an_exact_row_comes_back_within_two_percent(bench, name, parameters, effects, tmp_path):
    found, share, size = error_over_size(bench, name, parameters, effects, tmp_path)
    assert {r.how for r in found.rows} == {"exact"}, found.rows
    assert size > 1e-3 and share < 0.02, f"{name}: {100 * share:.2f} % of {size:.3g} rad"


@pytest.mark.parametrize(
    ("name", "parameters", "effects"), APPROXIMATE, ids=[e[0] for e in APPROXIMATE]
)
def test_an_approximate_row_says_so_and_is_near(bench, name, parameters, effects, tmp_path):
    found, share, size = error_over_size(bench, name, parameters, effects, tmp_path)
    assert {r.how for r in found.rows} == {"approximate"}
    assert size > 1e-3 and share < 0.1, f"{name}: {100 * share:.2f} % of {size:.3g} rad"


# ---- the user's own text


def test_the_text_keeps_everything_but_the_attributes_that_were_meant(arm, tmp_path):
    found = export(fit({"damping@lift": 0.5, "kp@bend": 9.0}, path=arm), "mjcf")
    new = found.files["arm.xml"]
    assert (
        new.replace(
            '\n             range="-2 2" damping="0.5"', '\n             range="-2 2"'
        ).replace(
            'gainprm="2.25" biastype="affine" biasprm="0 -2.25 -0.1"',
            'gainprm="3" biastype="affine" biasprm="0 -3 -0.1"',
        )
        == ARM
    )
    assert arm.read_text() == ARM


@pytest.mark.parametrize(
    ("name", "parameters", "effects"), EXACT + APPROXIMATE, ids=[e[0] for e in EXACT + APPROXIMATE]
)
def test_apply_makes_the_model_of_the_patched_file(arm, name, parameters, effects, tmp_path):
    found = export(fit(parameters, [(*key, n) for key, n in effects.items()], arm), "mjcf")
    made: dict[str, Any] = {}
    exec(found.files["apply.py"], made)
    a = mujoco.MjModel.from_xml_string(found.files["arm.xml"])
    b = made["apply"](mujoco.MjSpec.from_file(str(arm))).compile()
    plain = mujoco.MjModel.from_xml_string(ARM)
    fields = [n for n in dir(a) if n.startswith(("dof_", "jnt_", "body_", "actuator_", "qpos"))]
    fields = [n for n in fields if isinstance(getattr(a, n), np.ndarray)]
    assert [
        n for n in fields if not np.allclose(getattr(a, n), getattr(b, n), rtol=1e-7, atol=1e-9)
    ] == []
    same = all(
        np.array_equal(getattr(a, n), getattr(plain, n))
        for n in fields
        if getattr(a, n).shape == getattr(plain, n).shape
    )
    assert not same or not np.array_equal(a.opt.gravity, plain.opt.gravity)


def test_includes_are_patched_beside_the_file_and_degrees_stay(tmp_path):
    inner = '<mujocoinclude><body name="l"><joint name="j" axis="0 1 0" range="-90 90" ref="10"/>'
    inner += (
        '<inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/></body></mujocoinclude>'
    )
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "link.xml").write_text(inner)
    path = tmp_path / "robot.xml"
    path.write_text('<mujoco><worldbody><include file="parts/link.xml"/></worldbody></mujoco>')
    found = export(
        fit({"encoder_bias@j": 0.1, "damping@j": 0.2}, path=path, joints=["j"], drive=None), "mjcf"
    )
    save(found, tmp_path / "out")
    joint = re.search(r"<joint[^>]*>", (tmp_path / "out" / "parts" / "link.xml").read_text())
    assert (
        joint is not None
        and 'ref="15.72957795"' in joint[0]
        and 'range="-84.27042205 95.72957795"' in joint[0]
    )
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "robot.xml"))
    assert model.dof_damping[0] == 0.2


def test_motors_and_mimic_joints(tmp_path):
    """A scale of torques is the gear's; a leader takes what its followers have not."""
    path = tmp_path / "hand.xml"
    link = '<inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>'
    path.write_text(f"""<mujoco><worldbody><body name="a"><joint name="a" axis="0 1 0" damping="0.1"/>{link}<body name="b">
<joint name="b" axis="0 1 0" damping="0.4"/>{link}</body></body></worldbody>
<equality><joint joint1="b" joint2="a" polycoef="0 0.5 0 0 0"/></equality>
<actuator><motor joint="a" gear="2" ctrlrange="-1 1"/></actuator></mujoco>""")
    effects = [("torque_scale", "a_tau", {"gain": 0.1}), ("constant_torque", "a", {"torque": 0.3})]
    found = export(fit({"damping@a": 0.5}, effects, path, joints=["a", "b"], drive=None), "mjcf")
    model = mujoco.MjModel.from_xml_string(found.files["hand.xml"])
    np.testing.assert_allclose(
        model.dof_damping, [0.4, 0.4]
    )  # 0.5 is that of both: 0.4 + 0.5^2 0.4
    np.testing.assert_allclose(model.actuator_gear[0, 0], 2.2)
    np.testing.assert_allclose(model.actuator_biasprm[0, :3], [-0.3 / 2.2, 0, 0])
    assert model.actuator_gainprm[0, 0] == 1.0 and model.actuator_ctrlrange[0, 1] == 1.0


def test_a_law_of_the_recording_goes_into_position_actuators_of_the_file(arm):
    law = fit(path=arm)["robot"]["drive"] | {"origin": "[controller]"}
    law["joints"]["lift"] |= {"kp": 30.0, "lowest": -2.0, "highest": 2.0}
    rows = export(fit({"damping@lift": 0.3}, path=arm, drive=law), "mjcf").rows
    told = {r.effect: r for r in rows}
    assert (
        told["kp"].value == 30.0
        and "[controller]" in told["kp"].note
        and told["saturation"].value == [-2.0, 2.0]
    )
    motor = ARM.replace(
        '<position name="lift_act" joint="lift" kp="20" kv="0.8" forcerange="-6 6"/>',
        '<motor joint="lift"/>',
    )
    arm.write_text(motor)
    (row,) = export(fit({"kp@lift": 28.0}, path=arm, drive=law), "mjcf").rows
    assert row.how == "code" and '<position joint="lift" kp="28"' in row.note


def test_a_urdf_is_patched_by_name(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    effects = [("saturation", "lift_tau", {"limit": 4.0})]
    numbers = {
        "damping@lift": 0.5,
        "frictionloss@lift": 0.1,
        "mass@upper": 0.9,
        "armature@lift": 0.02,
        "encoder_bias@lift": 0.1,
    }
    found = export(fit(numbers, effects, path, joints=["lift"], drive=None), "urdf")
    text = found.files["arm.urdf"]
    assert "<!-- kept -->" in text and '<dynamics damping="0.5" friction="0.1"/>' in text
    assert 'lower="-1.9" upper="2.1" effort="4"' in text
    how = {r.effect: r.how for r in found.rows}
    assert how["armature"] == "none" and {
        how[k] for k in ("damping", "frictionloss", "mass", "saturation", "encoder_bias")
    } == {"exact"}
    from jaxid.robots.urdf_tree import read_urdf_tree

    before, after = read_urdf_tree(path), read_urdf_tree(path, text)
    np.testing.assert_allclose(
        after.inertia[0, 9], 0.9
    )  # of the link and the tip that is fixed to it
    np.testing.assert_allclose(after.inertia[0, 6:9] / 0.9, before.inertia[0, 6:9] / 0.7, atol=1e-9)
    np.testing.assert_allclose(
        after.place[0][:3, :3],
        [[np.cos(0.1), 0, -np.sin(0.1)], [0, 1, 0], [np.sin(0.1), 0, np.cos(0.1)]],
        atol=1e-9,
    )


def test_edits_of_a_text():
    text = XmlText("<a>\n  <!-- b='1' --><b x='1>2' y = \"é\"/>\n  <c/>\n</a>")
    b, c = text.elements[1], text.elements[2]
    text.set(b, {"y": '"', "z": "3"})
    text.insert(c, "<d/>")
    text.insert(text.elements[0], "<e/>")
    assert (
        text.result()
        == "<a>\n  <!-- b='1' --><b x='1>2' y = '\"' z=\"3\"/>\n  <c>\n    <d/>\n  </c>\n  <e/>\n</a>"
    )


# ---- what has no field


CODED = [
    ("stribeck_friction", "lift", {"extra": 0.2, "speed": 0.1}),
    ("asymmetric_friction", "lift", {"dry": 0.1, "viscous": 0.05}),
    ("load_dependent_friction", "lift", {"mu": 0.1}),
    ("position_dependent_friction", "bend", {"sine": 0.1, "cosine": 0.05, "order": 3.0}),
    ("power_law_friction", "lift", {"coefficient": 0.2, "exponent": 0.5}),
    ("torque_ripple", "bend", {"sine": 0.1, "cosine": -0.2, "order": 7.0}),
    ("lugre_friction", "lift", {"level": 0.3, "presliding": 0.01, "relaxation": 0.001}),
    ("hysteresis", "bend", {"level": 0.2, "width": 0.05}),
    ("temperature_dependent_friction", "lift", {"change": -0.1, "time": 5.0}),
]


def test_code_does_what_the_effects_do(arm):
    """Each law beside the effect itself, along one motion; and before the steps of MuJoCo."""
    import jax.numpy as jnp

    from jaxid.dynamics.catalogue import effect_class
    from jaxid.dynamics.effect import Signals
    from jaxid.dynamics.parameter import with_fields

    made: dict[str, Any] = {}
    found = export(fit(effects=CODED, path=arm), "mjcf")
    assert (
        {r.how for r in found.rows} == {"code"}
        and set(found.files) == {"effects.py"}
        and found.carries
    )
    exec(found.files["effects.py"], made)
    laws = iter([*made["FORCE"], *made["DRY"]])
    h = 1e-3
    t = np.arange(0, 0.5, h)
    by_port = sorted(CODED, key=lambda e: e[0] not in FORCES)
    for name, joint, numbers in by_port:
        where, law = next(laws)
        assert where == joint, name
        effect = with_fields(effect_class(name)(), {k: np.array([v]) for k, v in numbers.items()})
        state = effect.start(jnp.zeros(1))
        for now in t[:120]:
            q, qd, load = 0.3 * np.sin(9 * now), 2.7 * np.cos(9 * now), 0.8

            def one(v):
                return jnp.array([v])

            nothing: Any = None
            s = Signals(one(now), one(q), one(qd), one(load), jnp.asarray(h), nothing, one(qd))
            force, minus, plus, state = effect(s, state)
            wanted = (
                float(jnp.ravel(force)[0])
                if name in FORCES
                else float(jnp.ravel(plus if qd > 0 else minus)[0])
            )
            if name == "asymmetric_friction":
                wanted += float(jnp.ravel(plus)[0])
            assert abs(float(law(q, qd, load, h)) - wanted) < 5e-3 * max(1.0, abs(wanted)), (
                name,
                now,
            )
    model = mujoco.MjModel.from_xml_string(ARM)
    data, effects = mujoco.MjData(model), made["Effects"](model)
    for _ in range(20):
        effects(model, data)
        mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all() and model.dof_frictionloss[0] > 0


FORCES = (
    "asymmetric_friction",
    "power_law_friction",
    "torque_ripple",
    "lugre_friction",
    "hysteresis",
    "temperature_dependent_friction",
)

EVERY = [
    *(e for e in CODED),
    ("dead_zone", "lift_cmd", {"width": 0.1}),
    ("supply_droop", "lift_tau", {"droop": 0.1}),
    ("sensor_bias", "lift", {"bias": 0.1}),
    ("sensor_lag", "lift", {"lag": 0.1}),
    ("sensor_delay", "lift", {"delay": 0.01}),
    ("backlash", "bend", {"play": 0.01}),
    ("timestamp_jitter", "lift", {"spread": 1e-3}),
    ("my_own", "lift", {"size": 1.0}),
]
NUMBERS = {
    "damping@lift": 0.5,
    "frictionloss@bend": 0.1,
    "armature@lift": 0.03,
    "kp@lift": 14.0,
    "kd@lift": 1.0,
    "mass@fore": 0.4,
    "highest@lift": 3.0,
    "gravity_of_mars": 3.7,
}


@pytest.mark.parametrize("to", list(TARGETS))
def test_nothing_is_passed_over(arm, to, tmp_path):
    """Every effect and every number has a row, with a field or a reason; the code is Python, and
    the texts are XML or YAML.
    """
    effects = EVERY + [(*k, n) for _, _, own in EXACT for k, n in own.items()][:-1]
    found = export(fit(NUMBERS, effects, arm), to, ranges=True)
    save(found, tmp_path / "out")
    rows = json.loads((tmp_path / "out" / "export.json").read_text())
    assert {(e, where) for e, where, _ in effects} <= {(r["effect"], r["location"]) for r in rows}
    assert {n.partition("@")[0] for n in NUMBERS} <= {r["effect"] for r in rows}
    for r in rows:
        assert list(r) == ["effect", "location", "field", "value", "unit", "how", "note"]
        assert r["how"] in ("exact", "approximate", "code", "none") and (r["field"] or r["note"]), r
    assert {"jitter" in r["effect"] for r in rows if r["how"] == "none"} >= {True}
    for name, text in found.files.items():
        if name.endswith(".py"):
            compile(text, name, "exec")
        elif name.endswith((".xml", ".urdf")):
            XmlText(text)
        elif name.endswith(".sdf"):
            XmlText(f"<sdf>{text}</sdf>")
    ranges = json.loads((tmp_path / "out" / "ranges.json").read_text())
    low, high = ranges["numbers"]["damping@lift"]["interval_95"]
    assert low == pytest.approx(0.5 - 1.96e-3, abs=1e-5) and high == pytest.approx(
        0.5 + 1.96e-3, abs=1e-5
    )
    assert (f"ranges_{to}.py" in found.files) == (to in ("mjlab", "isaaclab"))


def test_targets_are_those_that_the_command_lists():
    assert tuple(TARGETS) == jaxid.dynamics.catalogue.TARGETS


def test_correlations_stand_beside_the_ranges(arm):
    content = fit({"damping@lift": 0.5, "armature@lift": 0.03}, path=arm)
    content["covariance"] = {
        "names": ["damping@lift", "armature@lift"],
        "matrix": [[4e-6, -1e-6], [-1e-6, 1e-6]],
    }
    found = export(content, "mjcf", ranges=True)
    assert found.ranges is not None
    np.testing.assert_allclose(found.ranges["correlation"]["matrix"], [[1, -0.5], [-0.5, 1]])


# ---- results of other models, and of an identification


def test_a_result_without_a_robot_gives_attributes_to_copy(tmp_path):
    content = {
        "kind": "fit",
        "model": "pendulum",
        "effects": [
            {
                "effect": "stribeck_friction",
                "location": "q",
                "parameters": {"extra": {"value": 0.1}, "speed": {"value": 0.2}},
            }
        ],
        "parameters": {"viscous": {"value": 0.2}, "inertia": {"value": 0.1}},
    }
    found = export(content, "mjcf")
    assert 'damping="0.2 0 0"' in found.files["joints.xml"] and "effects.py" in found.files
    assert {r.effect: r.how for r in found.rows} == {
        "viscous": "exact",
        "inertia": "none",
        "stribeck_friction": "code",
    }
    assert not export(
        {"kind": "fit", "model": "pendulum", "parameters": {"inertia": {"value": 0.1}}},
        "ros2_control",
    ).carries
    path = tmp_path / "one.xml"
    link = '<inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>'
    path.write_text(
        f'<mujoco><worldbody><body name="l"><joint name="hinge"/>{link}</body></worldbody></mujoco>'
    )
    assert 'damping="0.2"' in export(content, "mjcf", robot=path).files["one.xml"]


def test_base_parameters_go_to_the_nearest_bodies_that_can_exist(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    from jaxid.models import SerialArm
    from jaxid.robots.arms import table_of
    from jaxid.robots.mjcf import read_mjcf

    arm: Any = SerialArm(table_of(read_mjcf(path)))
    base = arm.base()

    def split(name):
        return (name.rstrip("0123456789"), int(name[-1]) - 1)

    phi = np.array(
        [float(np.asarray(getattr(arm, kind))[j]) for kind, j in map(split, base.standard)]
    )
    same, off = nearest_bodies(phi, base.K, base.values(phi), base.standard)
    assert off < 1e-6 and np.abs(base.K @ (same - phi)).max() < 1e-6
    beta = base.values(phi) * np.where(
        np.array([n.startswith("mx") for n in base.names]), 1.3, 1.05
    )
    rows = [
        {"name": n, "value": float(b), "std": 1e-3, "unit": "kg m"}
        for n, b in zip(base.names, beta, strict=True)
    ]
    friction = [
        {"joint": j, "F_c": entry(0.1), "F_v": entry(0.3), "offset": entry(0.02)} for j in JOINTS
    ]
    own = {
        "kind": "identification",
        "model": "serial_arm",
        "base_parameters": rows,
        "friction": friction,
        "robot": {"file": str(path), "joints": list(JOINTS)},
    }
    found = export(own, "mjcf")
    model = mujoco.MjModel.from_xml_string(found.files["arm.xml"])
    for b in (1, 2):
        ten = np.zeros(10)
        ten[[0, 3, 5]], ten[9] = model.body_inertia[b], model.body_mass[b]
        assert fault("link", ten) is None
    assert any("nearest" in r.note for r in found.rows)
    assert model.dof_frictionloss[0] == 0.1 and model.dof_damping[1] == 0.3
    new: Any = SerialArm(table_of(read_mjcf(path, found.files["arm.xml"])))
    phi = np.array(
        [float(np.asarray(getattr(new, kind))[j]) for kind, j in map(split, base.standard)]
    )
    np.testing.assert_allclose(base.values(phi), beta, atol=2e-3 * np.abs(beta).max())


def branched(tmp_path) -> Path:
    """A URDF of two joints in a row, with a third one on a branch of its own."""
    link = '<inertial><origin xyz="{at} 0 0"/><mass value="{m}"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="9e-3" iyz="0" izz="9e-3"/>'
    joint = '<joint name="{j}" type="revolute"><parent link="{up}"/><child link="{l}"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>'
    joint += '<limit lower="-2" upper="2" effort="9" velocity="9"/></joint>'
    rows = [
        ("lift", "trunk", "upper", 1.6, 0.12),
        ("bend", "upper", "fore", 0.9, 0.1),
        ("pan", "trunk", "head", 0.8, 0.05),
    ]
    made = [
        f'<link name="{l}">{link.format(at=at, m=m)}</inertial></link>{joint.format(j=j, up=up, l=l)}'
        for j, up, l, m, at in rows
    ]
    path = tmp_path / "branched.urdf"
    path.write_text(f'<robot name="b"><link name="trunk"/>{made}</robot>')
    return path


@pytest.mark.parametrize("names", [("lift", "bend"), ("q1", "q2")])
def test_an_identified_chain_of_a_file_that_branches(tmp_path, names):
    from jaxid.models import SerialArm
    from jaxid.robots.arms import table_of
    from jaxid.robots.urdf_tree import read_urdf_tree

    path = branched(tmp_path)
    tree = read_urdf_tree(path)
    arm: Any = SerialArm(table_of(tree.locked({"pan": 0.0})))
    base = arm.base()

    def split(name):
        return (name.rstrip("0123456789"), int(name[-1]) - 1)

    phi = np.array(
        [float(np.asarray(getattr(arm, kind))[j]) for kind, j in map(split, base.standard)]
    )
    beta = base.values(phi) * np.where(np.array([n.startswith("mx") for n in base.names]), 1.3, 1.0)
    rows = [
        {"name": n, "value": float(b), "std": 1e-3, "unit": "kg m"}
        for n, b in zip(base.names, beta, strict=True)
    ]
    friction = [{"joint": j, "F_c": entry(0.3), "F_v": entry(0.2)} for j in names]
    content = {
        "kind": "identification",
        "model": "serial_arm",
        "base_parameters": rows,
        "friction": friction,
    }
    found = export(content, "urdf", robot=path)
    after = read_urdf_tree(path, found.files["branched.urdf"])
    head = tree.links.index("head")
    np.testing.assert_array_equal(after.inertia[head], tree.inertia[head])
    assert after.frictionloss.tolist() == [0.3, 0.3, 0.0] and after.damping[:, 0].tolist() == [
        0.2,
        0.2,
        0.0,
    ]
    assert not np.allclose(after.inertia[1], tree.inertia[1])
    short = content | {"friction": friction[:1]}
    short["friction"][0] = {**friction[0], "joint": "q1"}
    with pytest.raises(jaxid.UsageError, match=r"model\.joints"):  # the first of either branch
        export(short, "urdf", robot=path)


# ---- what strangers write


def test_nothing_of_the_user_is_overwritten(arm, tmp_path):
    found = export(fit({"damping@lift": 0.5}, path=arm), "mjcf")
    with pytest.raises(jaxid.UsageError, match=r"arm\.xml was not written by jaxid export"):
        save(found, tmp_path)
    out = tmp_path / "out"
    save(found, out)
    save(found, out)  # its own files are replaced
    (out / "apply.py").write_text("mine")
    with pytest.raises(
        jaxid.UsageError, match=r"apply\.py was not written by jaxid export, or was edited"
    ):
        save(found, out)
    assert arm.read_text() == ARM and (out / "apply.py").read_text() == "mine"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "export.json").symlink_to(arm)
    with pytest.raises(jaxid.UsageError, match="not a plain file"):
        save(found, tmp_path / "other")
    from dataclasses import replace

    with pytest.raises(jaxid.UsageError, match="outside"):
        save(replace(found, files={"../x.xml": ""}), tmp_path / "third")
    assert not (tmp_path / "x.xml").exists()


HOSTILE = [
    ([1, 2], "not a result"),
    ({"kind": "fit", "model": "robot", "parameters": {}}, "failed"),
    ({"kind": "fit", "model": "robot", "parameters": {"damping@lift": {"value": 1e999}}}, "finite"),
    ({"kind": "fit", "model": "robot", "parameters": {"a" * 300: {"value": 1}}}, "not a name"),
    ({"kind": "fit", "model": "m", "effects": [{"effect": "lugre_friction", "location": "q", "parameters": {"x);(": 1}}],
      "parameters": {}}, "names"),
    ({"kind": "fit", "model": "robot", "parameters": {"a": {"value": 1}}, "robot": {"file": "/no/such.xml"}}, "--robot FILE"),
]  # fmt: skip


@pytest.mark.parametrize(("content", "said"), HOSTILE, ids=[said for _, said in HOSTILE])
def test_a_content_that_is_none_is_refused(content, said):
    with pytest.raises(jaxid.UsageError, match=re.escape(said)):
        export(content, "mjcf")


def test_a_result_that_doubts_itself_says_so(arm):
    which = {
        "verdict": "partly",
        "effects": [],
        "confusable_with": [{"effect": "payload", "location": "bend"}],
    }
    content = fit({"damping@lift": 0.5}, path=arm) | {"kind": "diagnosis", "which": which}
    notes = " ".join(export(content, "mjcf").notes)
    assert "no known effect explains" in notes and "payload at bend" in notes


def test_a_file_that_changed_or_has_other_joints_is_refused(arm):
    content = fit({"damping@lift": 0.5}, path=arm, sha256="0" * 64)
    with pytest.raises(jaxid.UsageError, match="has changed since"):
        export(content, "mjcf")
    assert export(content, "mjcf", robot=arm).carries
    arm.write_text(ARM.replace('"bend"', '"bent"'))
    with pytest.raises(jaxid.UsageError, match="no joint 'bend'"):
        export(content, "mjcf", robot=arm)


def test_the_command(arm, tmp_path, capsys):
    result = tmp_path / "fit.json"
    result.write_text(
        json.dumps(
            fit(
                {"damping@lift": 0.5},
                [("stribeck_friction", "lift", {"extra": 0.1, "speed": 0.1})],
                arm,
            )
        )
    )
    assert main(["export", str(result), "--to", "mjcf", "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "joint[lift]@damping" in told and "code" in told and "arm.xml" in told
    assert (
        main(["export", str(result), "--to", "mjcf", "--out", str(tmp_path / "out"), "--json"]) == 0
    )
    assert json.loads(capsys.readouterr().out)[0]["effect"] == "damping"
    assert main(["export", str(result), "--to", "gazebo", "--out", str(tmp_path / "no")]) == 2
    assert "sdf" in capsys.readouterr().err and not (tmp_path / "no").exists()
    result.write_text(
        json.dumps({"kind": "fit", "model": "pendulum", "parameters": {"inertia": {"value": 0.1}}})
    )
    assert (
        main(["export", str(result), "--to", "ros2_control", "--out", str(tmp_path / "none")]) == 1
    )
    assert json.loads((tmp_path / "none" / "export.json").read_text())[0]["how"] == "none"


def test_the_page_of_a_robot_says_what_to_do():
    from dataclasses import replace

    from jaxid.report import fit_page
    from report_sample import sample_fit

    fit = sample_fit()
    assert "jaxid export" not in fit_page(fit)
    page = fit_page(replace(fit, robot={"file": "/somewhere/my arm.urdf"}))
    assert (
        "jaxid export fit.json --to urdf" in page
        and "my arm.urdf" in page
        and "/somewhere" not in page
    )


# ---- replay


def recorded_in_mujoco(bench: Bench, path: Path, controller=None):
    """The bench's goals with the motion of a file as what was measured."""
    from dataclasses import replace

    q = bench.by_mujoco(path)
    names = [c.name for c in bench.data.outputs]
    y = q[:, [JOINTS.index(n) for n in names]]
    return replace(
        bench.data, experiments=(replace(bench.data.experiments[0], y=y),), controller=controller
    )


def test_replay_of_the_file_that_made_the_recording(bench, tmp_path):
    """Beside jaxid's run of the result that the file was exported from; an edited file is one of
    its own.
    """
    effects = [(e, where, n) for (e, where), n in NEUTRAL.items()]
    effects[2] = ("back_emf", "lift_tau", {"constant": 0.4})
    save(export(fit({"damping@bend": 0.4}, effects, bench.path), "mjcf"), tmp_path)
    data = recorded_in_mujoco(bench, tmp_path / "arm.xml")
    found = jaxid.replay(data, tmp_path / "arm.xml")
    assert any("exported from" in n for n in found.notes)
    for row in found.rows:
        assert (
            row["mujoco"] < 1e-9
            and 0 < row["difference"] < 1e-3
            and abs(row["jaxid"] - row["difference"]) < 1e-9
        )
        assert row["before"] > 10 * row["difference"] and "before" in repr(found)
    assert not [n for n in found.notes if "further" in n]
    assert "run_1.parquet" in found.tables() and found.to_dict()["per_joint"][0]["joint"] == "lift"


def test_two_files_are_compared_in_mujoco(bench, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    other = tmp_path / "other.xml"
    other.write_text(ARM.replace('kp="20"', 'kp="10"'))
    data = recorded_in_mujoco(bench, other)
    found = jaxid.replay(data, bench.path, other)
    rows = {r["joint"]: r for r in found.rows}
    assert rows["lift"]["against"] < 1e-9 and rows["lift"]["mujoco"] > 0.02
    assert rows["lift"]["mujoco"] == pytest.approx(rows["lift"]["difference"])
    other.write_text(
        ARM.replace('timestep="2.5e-4" integrator="RK4"', 'timestep="0.05"').replace(
            "-3 -0.1", "-3 -90"
        )
    )
    found = jaxid.replay(data, bench.path, other)
    assert not np.isfinite(found.rows[0]["against"]) and any("diverged" in n for n in found.notes)
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


URDF_ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.1 0 0"/><mass value="0.6"/>
<inertia ixx="2e-3" ixy="0" ixz="0" iyy="3e-3" iyz="0" izz="2.5e-3"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.08 0 0"/><mass value="0.3"/>
<inertia ixx="5e-4" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link>
<joint name="lift" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<dynamics damping="0.2"/></joint>
<joint name="bend" type="continuous"><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/><origin xyz="0.25 0 0"/>
<dynamics damping="0.1"/></joint></robot>"""


@pytest.mark.parametrize("every", [0.0, 0.005])
def test_a_urdf_under_the_recordings_law(bench, tmp_path, every):
    """The same arm as MJCF with actuators, and as URDF whose law [controller] states: continuous,
    or sampled at 200 Hz.
    """
    from jaxid.data.dataset import Controller

    same = ARM.replace('damping="0.2" armature="0.02"', 'damping="0.2"').replace(
        'stiffness="0.5" springref="0.1"', 'damping="0.1"'
    )
    same = same.replace('pos="0.1 0 0.02" quat="1 0.2 0 0"', 'pos="0.1 0 0"').replace(
        ' forcerange="-6 6"', ""
    )
    (tmp_path / "same.xml").write_text(same)
    (tmp_path / "arm.urdf").write_text(URDF_ARM)
    settings = {
        "kp": [20.0, 12.0],
        "kd": [0.8, 0.4],
        "sample_time": every,
        "velocity": "measured",
        "reference_velocity": "none",
    }
    data = recorded_in_mujoco(bench, tmp_path / "same.xml", Controller("pd", settings))
    found = jaxid.replay(data, tmp_path / "arm.urdf", tmp_path / "same.xml")
    for row in found.rows:
        assert row["against"] < 1e-9 and row["mujoco"] < (0.002 if every == 0 else 0.03), row


def test_the_replay_command(arm, tmp_path, capsys):
    t = np.arange(0, 1, 0.01)
    rows = np.column_stack([t, 0.3 * np.sin(6 * t), 0.2 * t, 0.25 * np.sin(6 * t), 0.19 * t])
    np.savetxt(
        tmp_path / "run.csv",
        rows,
        delimiter=",",
        header="t,lift_cmd,bend_cmd,lift,bend",
        comments="",
    )
    roles = {"lift_cmd": "input", "bend_cmd": "input", "lift": "output", "bend": "output"}
    channels = "".join(f'[channels.{c}]\nrole = "{r}"\nunit = "rad"\n' for c, r in roles.items())
    (tmp_path / "dataset.toml").write_text(
        f'name = "arm"\n{channels}[[experiments]]\nfile = "run.csv"\nat_rest = true\n'
    )
    own = [
        "replay",
        str(tmp_path),
        "--robot",
        str(arm),
        "--against",
        str(arm),
        "--out",
        str(tmp_path / "out"),
    ]
    assert main([*own, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((tmp_path / "out" / "replay.json").read_text())
    assert [r["joint"] for r in told["per_joint"]] == list(JOINTS) and {
        r["difference"] for r in told["per_joint"]
    } == {0.0}
    assert (tmp_path / "out" / "run_1.parquet").is_file()
    assert main(own) == 0 and "rms error in MuJoCo" in capsys.readouterr().out
    assert (
        main(
            [
                "replay",
                str(tmp_path),
                "--robot",
                str(tmp_path / "no.xml"),
                "--out",
                str(tmp_path / "out"),
            ]
        )
        == 2
    )


def test_a_replay_that_nothing_drives_is_refused(arm):
    t = np.arange(0, 1, 0.01)
    own = {"units": {"current": "A", "lift": "rad", "bend": "rad"}, "check_model": False}
    data = jaxid.Dataset.from_arrays(
        t, {"current": np.sin(t)}, {"lift": np.sin(t), "bend": np.sin(t)}, **own
    )
    with pytest.raises(
        jaxid.UsageError, match="nothing that was recorded drives arm.xml: of its joints add goals"
    ):
        jaxid.replay(data, arm)


def test_a_patch_that_makes_things_worse_is_said():
    from jaxid.fitting.replay import _worse

    rows = [
        {"joint": j, "before": b, "mujoco": m}
        for j, b, m in (("lift", 1.0, 0.1), ("bend", 0.1, 0.2))
    ]
    (said,) = _worse(rows)
    assert said.startswith("bend") and "do not take it over" in said


def test_joints_named_q_take_the_torques_of_their_numbers(tmp_path):
    """A file's own q, driven by `tau`."""
    from jaxid.robots.match import named
    from jaxid.robots.mjcf import read_mjcf

    path = tmp_path / "rod.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="q" axis="0 1 0"/><inertial pos="0 0 -.2" mass=".4" '
        'diaginertia=".01 .01 .001"/></body></worldbody></mujoco>'
    )
    t = np.arange(0, 1, 0.01)
    units = {"tau": "N m", "q": "rad"}
    data = jaxid.Dataset.from_arrays(
        t, {"tau": np.sin(t)}, {"q": np.sin(t)}, units=units, check_model=False
    )
    assert [c.name for c in named(data, read_mjcf(path)).channels] == ["q_tau", "q"]


# ---- what holds at other time steps, and what the recording does not say


def swing(text: str, step: float, late: float = 0.0) -> np.ndarray:
    """Positions of the arm's joints after 0.4 s of a goal that swings, `late` s late, run in MuJoCo
    in steps of `step` s.
    """
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = step
    data = mujoco.MjData(model)
    rows = []
    for k in range(round(0.4 / step)):
        data.ctrl[0] = np.sin(20 * max(0.0, k * step - late))
        mujoco.mj_step(model, data)
        rows.append(data.qpos[0])
    return np.array(rows)


@pytest.mark.parametrize("step", [2e-3, 1e-3, 2e-4])
def test_a_delay_holds_at_other_time_steps(arm, step):
    text = export(fit({}, [("input_delay", "lift_cmd", {"delay": 0.038})], arm), "mjcf").files[
        "arm.xml"
    ]
    assert 'timestep="2.5e-4"' in text  # the file's own step stays
    off = np.abs(swing(text, step) - swing(ARM, step, late=0.038)).max()
    delayed = np.abs(swing(ARM, step) - swing(ARM, step, late=0.038)).max()
    assert off < 0.05 * delayed, f"{off:.3g} rad of {delayed:.3g}"


def test_a_law_without_a_limit_leaves_the_files(arm):
    law = fit(path=arm)["robot"]["drive"] | {"origin": "[controller]"}
    law["joints"]["lift"] |= {"kp": 30.0, "lowest": None, "highest": None}
    found = export(fit({"kp@lift": 33.0}, path=arm, drive=law), "mjcf")
    model = mujoco.MjModel.from_xml_string(found.files["arm.xml"])
    assert (
        model.actuator_forcerange[0].tolist() == [-6.0, 6.0]
        and model.actuator_gainprm[0, 0] == 33.0
    )
    assert [r.field for r in found.rows if r.effect == "saturation"] == []
    (note,) = [n for n in found.notes if "saturation" in n]
    assert "lift (-6 to 6 N m)" in note
    shifted = export(
        fit({"kp@lift": 33.0}, [("constant_torque", "lift", {"torque": 0.5})], arm, drive=law),
        "mjcf",
    )
    model = mujoco.MjModel.from_xml_string(shifted.files["arm.xml"])
    np.testing.assert_allclose(model.actuator_forcerange[0], [-6.5, 5.5])


def test_a_limit_in_one_direction_is_not_called_exact(arm):
    law = fit(path=arm)["robot"]["drive"] | {"origin": "[controller]"}
    law["joints"]["bend"] |= {"lowest": None, "highest": 4.0}
    rows = export(fit({"damping@lift": 0.3}, path=arm, drive=law), "mjcf").rows
    (row,) = [r for r in rows if r.effect == "saturation"]
    assert row.how == "approximate" and "no limit in one direction" in row.note


# ---- what is written is nearer to the recording


#: One joint that a drive holds, run in steps of 4 ms: first-order steps make its inertia h / 2 (0.8
#: + 3) more.
STEPPED = """<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/>
<worldbody><body><joint name="q" axis="0 1 0" armature="{armature}" damping="0.8" frictionloss="{dry}"/>
<inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody>
<actuator><position joint="q" kp="60" kv="3"/></actuator></mujoco>"""


def stepped_fit(path: Path, armature: float, effects=(), **numbers: float):
    law = {
        "kp": 60.0,
        "kd": 3.0,
        "gain": 1.0,
        "lowest": None,
        "highest": None,
        "offset": 0.0,
        "delay": 0.0,
        "lag": 0.0,
    }
    drive = {"origin": "file", "kind": "pd", "period": 0.0, "joints": {"q": law}}
    return fit({"armature@q": armature} | numbers, effects, path, joints=["q"], drive=drive)


def samples(text: str, late: float = 0.0) -> np.ndarray:
    """Positions every 4 ms of a run of 1 s to goals that jump every 40 ms, `late` s late."""
    model = mujoco.MjModel.from_xml_string(text)
    data, step = mujoco.MjData(model), float(model.opt.timestep)
    goals = np.random.default_rng(3).normal(0, 0.5, 25)
    goals[0] = 0.0
    every, rows = round(0.004 / step), []
    for k in range(round(1.0 / step)):
        if k % every == 0:
            rows.append(data.qpos[0])
        data.ctrl[0] = goals[int((max(0.0, k * step - late) + 1e-9) / 0.04)]
        mujoco.mj_step(model, data)
    return np.array(rows)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_what_the_files_steps_add_is_not_written_a_second_time(tmp_path, integrator):
    path = tmp_path / "one.xml"
    path.write_text(STEPPED.format(step=0.004, integrator=integrator, armature=0.03, dry=0))
    truth = samples(STEPPED.format(step=1e-4, integrator="RK4", armature=0.12, dry=0), late=0.02)
    found = export(stepped_fit(path, 0.12, [("input_delay", "q_cmd", {"delay": 0.02})]), "mjcf")
    off = np.sqrt(np.mean((samples(found.files["one.xml"]) - truth) ** 2))
    plain = STEPPED.format(step=0.004, integrator=integrator, armature=0.12, dry=0)
    twice = np.sqrt(np.mean((samples(plain, late=0.02) - truth) ** 2))
    assert off < 0.2 * twice, f"{off:.3g} rad, {twice:.3g} without the steps"
    assert any(integrator.lower() in note for note in found.notes)


def test_a_number_that_the_files_steps_explain_stays(tmp_path):
    path = tmp_path / "one.xml"
    path.write_text(STEPPED.format(step=0.004, integrator="implicitfast", armature=0.12, dry=0))
    assert not export(stepped_fit(path, 0.12 + 0.002 * 3.8), "mjcf").carries
    assert not export(stepped_fit(path, 0.12), "mjcf").carries  # of a machine that does not step


def test_friction_is_hardened_only_where_the_recording_is_nearer_with_it(tmp_path):
    path = tmp_path / "one.xml"
    path.write_text(STEPPED.format(step=0.001, integrator="implicitfast", armature=0.03, dry=0.1))
    found = stepped_fit(path, 0.03, (), **{"frictionloss@q": 1.5})
    untried = export(found, "mjcf")
    assert "solreffriction" not in untried.files["one.xml"] and any(
        "--data" in n for n in untried.notes
    )
    for hard in (True, False):
        asked: list[bool] = []

        def trial(files, name, rows, hard=hard, asked=asked):
            asked.append("solreffriction" in files[name])
            return {"q": 1.0 if asked[-1] == hard else 2.0}

        told = export(found, "mjcf", trial=trial)
        assert (
            ("solreffriction" in told.files["one.xml"]) == hard and True in asked and False in asked
        )
