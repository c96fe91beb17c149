"""Drives that follow the rate of their goal, where the robot's file follows the goal alone."""

import importlib
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.conventions.checking import _confirmed
from jaxid.conventions.finding import DataFinding
from jaxid.conventions.mending import Mending
from jaxid.conventions.samples import Shown
from jaxid.dynamics.parameter import with_fields
from jaxid.fitting.simulate import simulate_dataset
from jaxid.models import Joint, Robot
from jaxid.models.effects import VelocityFeedforward
from jaxid.problem.binding import bind
from jaxid.robots.export.code_beside import commanded, left_out, on_commands
from jaxid.robots.export.target import ExportRow


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

STEP, EVERY = 0.002, 5
PERIOD = STEP * EVERY
LEAD = 0.03  # s
ARM = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="arm"><joint name="lift" axis="0 1 0" damping="0.5" armature="0.02"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1.5"/></body></worldbody>
  <actuator><position joint="lift" kp="60" kv="3"/></actuator></mujoco>"""


def robot() -> Robot:
    return Robot.from_mjcf("arm.xml", text=ARM)


def recorded(lead: float, late: int = 0, noise: float = 1e-4, seconds: float = 8.0) -> Any:
    """Three runs in MuJoCo under goals that are held between samples, `late` samples late; the rate
    of a goal is its difference to the sample before.
    """
    model = mujoco.MjModel.from_xml_string(ARM)
    rng = np.random.default_rng(5)
    t = np.arange(int(seconds / PERIOD)) * PERIOD
    goals, positions = [], []
    for run in range(3):
        goal = 0.4 * np.sin(2 * np.pi * (0.5 + 0.1 * run) * t)
        goal += 0.15 * np.sin(2 * np.pi * (1.6 + 0.3 * run) * t + run)
        goal *= np.minimum(t, 1.0)
        arrives = np.concatenate([np.full(late, goal[0]), goal])[: len(goal)]
        rate = np.diff(arrives, prepend=arrives[0]) / PERIOD
        data = mujoco.MjData(model)
        q = np.empty(len(t))
        for k in range(len(t)):
            q[k], data.ctrl[0] = data.qpos[0], arrives[k] + lead * rate[k]
            mujoco.mj_step(model, data, EVERY)
        goals.append(goal)
        positions.append(q + noise * rng.standard_normal(len(t)))
    return jaxid.Dataset.from_arrays(
        [t] * 3,
        {"lift_cmd": goals},
        {"lift": positions},
        units={"lift": "rad", "lift_cmd": "rad"},
        split=["fit", "validation", "report"],
        check_model=False,
    )


@pytest.mark.parametrize("late", [pytest.param(0, marks=pytest.mark.slow), 2])
def test_a_run_with_it_is_that_of_mujoco(late):
    data = recorded(LEAD, late, noise=0.0, seconds=2.0)
    numbers = {"velocity_feedforward": {"lead": LEAD}, "input_delay": {"delay": late * PERIOD}}
    effects = []
    for name, own in numbers.items():
        told = {number: {"value": value} for number, value in own.items()}
        effects.append({"effect": name, "location": "lift_cmd", "parameters": told})
    content = {"parameters": {}, "effects": effects}
    runs = simulate_dataset(content, data, robot()).runs
    for run, measured in zip(runs, data.experiments, strict=True):
        np.testing.assert_allclose(run["lift"], measured.y[:, 0], atol=1e-8)


def test_it_is_asked_of_goals_alone():
    goals = bind(robot(), recorded(0.0, seconds=1.0))
    assert goals.chain.offers(VelocityFeedforward) == ("lift_cmd",)
    torque = jaxid.Chain(Joint())
    assert torque.offers(VelocityFeedforward) == ()


def test_its_code_beside_a_file_is_the_effect():
    """Goals that change at each sample, and ones that stand in between."""
    beside: dict[str, Any] = {}
    exported: Any = VelocityFeedforward.export_law
    exec(exported.memory, beside)
    law = beside["VelocityFeedforward"](lead=LEAD)
    goals = np.array([0.1, 0.3, 0.2, 0.2, 0.2, 0.5])
    handed = [law(goal, PERIOD) for goal in goals]
    rate = np.diff(goals, prepend=goals[0]) / PERIOD
    np.testing.assert_allclose(handed, goals + LEAD * rate, atol=1e-12)


def test_an_export_is_tried_with_its_laws_on_goals():
    data = recorded(0.0, seconds=1.0)
    row = ExportRow("velocity_feedforward", "lift_cmd", "", {"lead": LEAD}, "s", "code", "")
    drag = ExportRow("quadratic_drag", "lift", "", {"coefficient": 1.0}, "", "code", "")
    edited = ExportRow.of({**row.to_dict(), "value": {"lead": "much"}})
    handed = commanded(data, [row, drag, edited])
    for before, after in zip(data.experiments, handed.experiments, strict=True):
        rate = np.diff(before.u[:, 0], prepend=before.u[0, 0]) / PERIOD
        np.testing.assert_allclose(after.u[:, 0], before.u[:, 0] + LEAD * rate, atol=1e-9)
    assert on_commands([row, drag]) == "velocity_feedforward at lift_cmd"
    assert left_out([row, drag]) == "quadratic_drag at lift"


def test_its_response_leads_in_phase():
    omega = np.array([0.0, 1.0, 20.0])
    effect = with_fields(VelocityFeedforward(), {"lead": np.array([LEAD])})
    found = effect.transfer(omega)
    assert found is not None
    np.testing.assert_allclose(found[0][:, 0] + 1j * found[1][:, 0], 1 + 1j * omega * LEAD)


def test_a_goal_that_seems_late_may_be_followed_by_its_rate():
    """The simulations of a check are told here, as its own would be."""
    binding = bind(robot(), recorded(0.0, seconds=1.0))
    late = DataFinding("row_shift", "lift_cmd", 2.0, "lift moves before lift_cmd.", decisive=True)
    shown = Shown(late, Mending({"lift_cmd": {"shift": 2}}))

    def gap(led):
        def left(_binding, data, effects):
            if "velocity_feedforward@lift_cmd" in effects:
                return led
            return 271.0 if data is binding.dataset else 29.0

        return left

    (asked,) = _confirmed(binding, binding.dataset, shown.mending, [shown], gap(1.03))
    assert not asked.finding.decisive and not asked.mending
    assert ("velocity_feedforward", "lift_cmd") in asked.finding.same_as
    (kept,) = _confirmed(binding, binding.dataset, shown.mending, [shown], gap(150.0))
    assert kept.finding.decisive and kept.mending


@pytest.mark.slow
def test_a_law_that_brakes_the_goals_rate_is_named():
    found = jaxid.diagnose(robot(), recorded(LEAD))
    assert not any(finding.applied for finding in found.data)
    assert found.which.verdict == "named"
    (effect,) = found.which.effects
    assert (effect.effect, effect.location) == ("velocity_feedforward", "lift_cmd")
    lead = effect.parameters["lead"]
    assert lead.std is not None
    assert abs(lead.value - LEAD) < 3 * lead.std + 1e-5
    assert found.how_far.gap_after < 1.1


@pytest.mark.slow
def test_of_a_file_that_is_right_it_is_not_claimed():
    assert jaxid.diagnose(robot(), recorded(0.0)).which.verdict == "none"
