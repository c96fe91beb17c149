"""A recording compared with the simulator of its robot's file, at that one's own steps."""

import importlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.data.dataset import ModelSpec
from jaxid.diagnosis.goals.asked import GoalsQuestion
from jaxid.diagnosis.goals.gains import known_loosely, with_room
from jaxid.diagnosis.goals.in_file_steps import _about, _candidates
from jaxid.diagnosis.goals.own_run import run_of_file, stepped_changes
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.goals.settings import (
    delays_said,
    HOLD,
    otherwise,
    settings_of,
    SimulationSetting,
    STEPS,
    STICKING,
)
from jaxid.diagnosis.hypothesis import SearchResult
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.replay import measured_start
from jaxid.fitting.run import ProblemBuilders
from jaxid.fitting.simulate import simulate_dataset
from jaxid.models import Robot
from jaxid.problem.binding import bind, resolve_model
from jaxid.problem.residual import OutputError
from jaxid.robots.export.outcome import ExportOutcome, Number, robot_entry
from jaxid.robots.export.stepped import stepped
from jaxid.robots.match import notes_of
from jaxid.robots.origin import origin


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

STEP, EVERY = 0.002, 5
#: A pendulum with soft friction, a drive whose goal comes late, and a stop that it meets.
FILE = f"""<mujoco><compiler angle="radian"/>
  <option timestep="{STEP}" integrator="implicitfast" tolerance="1e-14" iterations="200"/>
  <worldbody><body>
    <joint name="lift" axis="0 1 0" damping="0.4" armature="0.05" frictionloss="0.5"
     range="-0.5 0.35"/>
    <inertial pos="0 0 -.15" mass="1.2" diaginertia=".02 .02 .004"/>
  </body></worldbody>
  <actuator><position joint="lift" kp="60" kv="2" delay="0.012" nsample="7"/></actuator>
</mujoco>"""


def goals(seconds: float) -> np.ndarray:
    t = np.arange(0, seconds, STEP * EVERY)
    return 0.5 * np.sin(2 * np.pi * 1.1 * t) * np.minimum(1.0, 4 * t)


def recorded(text: str, u: np.ndarray, every: int = EVERY) -> np.ndarray:
    """Positions in MuJoCo at the goals' samples, every so many steps, from rest."""
    model = mujoco.MjModel.from_xml_string(text)
    data, out = mujoco.MjData(model), []
    n = int(model.actuator_history[0, 0])
    if n:
        before = np.arange(-n, 0) * model.opt.timestep
        mujoco.mj_initCtrlHistory(model, data, 0, before, np.zeros((n, 1)))
    for goal in u:
        out.append(float(data.qpos[0]))
        data.ctrl[:] = goal
        mujoco.mj_step(model, data, every)
    return np.array(out)


def dataset(u: np.ndarray, q: np.ndarray, simulator: str | None = "mujoco") -> jaxid.Dataset:
    made = jaxid.Dataset.from_arrays(
        np.arange(len(u)) * STEP * EVERY,
        {"lift_cmd": u},
        {"lift": q},
        units={"lift": "rad", "lift_cmd": "rad"},
        noise_std={"lift": 1e-4},
        check_model=False,
    )
    first = replace(made.experiments[0], initial={"lift": float(q[0]), "lift_qd": 0.0})
    spec = ModelSpec(simulator=simulator)
    return replace(made, experiments=(first,), model=spec)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.from_mjcf("lift.xml", text=FILE)


def test_a_recording_of_mujocos_is_its_files_run(robot):
    u = goals(1.5)
    q = recorded(FILE, u)
    assert q.max() > 0.35  # the stop has been met
    simulation = simulate_dataset(None, dataset(u, q), robot)
    assert np.abs(simulation.runs[0]["lift"] - q).max() < 1e-9


def test_goals_along_straight_lines_are_those_of_each_steps_beginning(robot):
    u = goals(1.5)
    data = dataset(u, recorded(FILE, u))
    goal = next(c for c in data.channels if c.role == "input")
    channels = [replace(c, hold="linear") if c is goal else c for c in data.channels]
    lines = replace(data, channels=tuple(channels))
    t = data.experiments[0].t
    fine = np.interp(np.arange(len(u) * EVERY) * STEP, t, u)
    q = recorded(FILE, fine, 1)[::EVERY]
    made = simulate_dataset(None, lines, robot).runs[0]["lift"]
    assert np.abs(made - q).max() < 1e-9
    assert np.abs(simulate_dataset(None, data, robot).runs[0]["lift"] - q).max() > 1e-4


@pytest.mark.parametrize(("simulator", "near"), [("mujoco", 1e-9), ("own", 2e-2)])
def test_a_drive_with_a_time_constant_follows_as_in_mujoco(simulator, near):
    text = FILE.replace('delay="0.012" nsample="7"', 'timeconst="0.03"').replace("0.35", "2")
    u = goals(1.0)
    q = recorded(text, u)
    made = simulate_dataset(None, dataset(u, q, simulator), Robot.from_mjcf("lift.xml", text=text))
    assert np.abs(made.runs[0]["lift"] - q).max() < near * np.ptp(q)


def test_its_steps_are_not_divided_further(robot):
    u = goals(1.0)
    data = dataset(u, recorded(FILE, u))
    binding = bind(robot, data)
    assert ProblemBuilder(binding).step == STEP
    benches = ProblemBuilders(binding)
    assert benches.of(1e-3) is benches.of(5e-4)
    own = bind(robot, dataset(u, u, "own"))
    assert ProblemBuilder(own).step != STEP


def test_a_result_says_whose_steps_were_taken(robot, tmp_path: Path):
    u = goals(0.5)
    steps = {"own": "", "mujoco": "IMPLICITFAST", "mujoco_rk4": "RK4"}
    for simulator, integrator in steps.items():
        data = dataset(u, u, simulator)
        found = origin(resolve_model(robot, data).mechanism, None)["simulator"]
        assert (found["kind"], found.get("integrator", "")) == (simulator, integrator)
        assert found.get("timestep", STEP) == STEP
        folder = tmp_path / simulator
        jaxid.save_dataset(data, folder)
        again = jaxid.load_dataset(folder).model
        assert again is not None and again.simulator == simulator


def test_a_number_of_the_files_own_simulator_is_written_as_it_is(robot):
    """That of a machine that takes no steps is written as they make it."""

    def exported(simulator: str, in_steps: dict[str, float] | None = None) -> float:
        found = ExportOutcome(
            kind="fit",
            model="robot",
            parameters={"armature@lift": Number(0.08, 0.001)},
            effects=(),
            robot={"simulator": {"kind": simulator, "numbers": in_steps or {}}},
        )
        numbers: Any = SimpleNamespace(damping=0.4, kd=2.0, armature=0.05)
        sheet: Any = SimpleNamespace(tree=robot.tree.tree, before={"lift": numbers})
        return stepped(found, sheet)[0].parameters["armature@lift"].value

    assert exported("mujoco") == 0.08
    assert exported("own") < 0.08
    assert exported("mujoco_rk4") == exported("own")
    assert exported("mujoco_rk4", {"armature@lift": 0.07}) == 0.07


def test_a_result_that_is_read_again_says_whose_steps_were_taken():
    for kind in ("own", "mujoco", "mujoco_rk4"):
        assert robot_entry({"simulator": {"kind": kind}})["simulator"] == {"kind": kind}
    assert robot_entry({"file": "arm.xml"})["simulator"] == {"kind": "own"}


def test_the_files_own_steps_are_taken_under_goals_where_they_are_known(robot):
    u = goals(0.5)

    def taken(text: str = FILE, **stated) -> str:
        data = replace(dataset(u, u), model=ModelSpec(**stated))
        chain = resolve_model(Robot.from_mjcf("lift.xml", text=text), data)
        said = " ".join(notes_of(Robot.from_mjcf("lift.xml", text=text), data))
        assert ("in jaxid's own steps" in said) == (chain.mechanism.integrator == "")
        return chain.mechanism.integrator

    assert taken() == "IMPLICITFAST" and taken(simulator="own") == ""
    assert taken(FILE.replace('delay="0.012"', 'delay="0.0113"')) == ""


#: The same with more friction.
DRY = FILE.replace('frictionloss="0.5"', 'frictionloss="1.8"')


@pytest.mark.slow
def test_a_single_number_is_found_by_the_files_own_steps(robot):
    """Columns that know no steps propose it, and the run of the file at its own steps settles it."""
    u = goals(1.5)
    noise = 1e-4 * np.random.default_rng(5).standard_normal(len(u))
    data = dataset(u, recorded(DRY, u) + noise)
    binding = bind(robot, data)
    likeliest = stepped_changes(binding, [])
    own = [c for c in likeliest if c.index == (binding.layout.index("frictionloss@lift"),)]
    (change,) = own
    assert change.proposal.theta[change.index[0]] == pytest.approx(1.8, rel=0.5)  # to first order
    bench = ProblemBuilder(binding)
    run = run_of_file(bench)
    assert run is not None and np.std(run.left["fit"][0]) > 3e-4 and not run.accounts(binding)
    problem = bench.problem(OutputError(), "fit", list(change.index), change.proposal.theta)
    (path,) = levenberg_marquardt([(problem, problem.z(change.proposal.theta))], 20, 1e-8)
    assert problem.theta(path.z)[change.index[0]] == pytest.approx(1.8, rel=0.01)
    assert 2 * path.cost / path.count < 1.3


@pytest.mark.parametrize("frictionloss", [0.5, 1.0])
def test_goals_go_the_other_way_where_a_claim_is_borne_out(robot, frictionloss):
    """With a file that is right, and with one that lacks more than the hold could explain."""
    text = FILE.replace('frictionloss="0.5"', f'frictionloss="{frictionloss}"')
    u = goals(1.5)
    fine = np.interp(np.arange(len(u) * EVERY) / EVERY, np.arange(len(u)), u)
    noise = 1e-4 * np.random.default_rng(6).standard_normal(len(u))
    said = {
        "held": recorded(text, u) + noise,
        "along straight lines": recorded(text, fine, 1)[::EVERY] + noise,
    }
    found = {way: is_so(HOLD, robot, dataset(u, q)) for way, q in said.items()}
    assert found == {"held": False, "along straight lines": True}


def is_so(setting: SimulationSetting, robot: Robot, data: jaxid.Dataset) -> bool:
    """Whether a setting is otherwise than stated, beside the re-tuned model."""
    return turned([setting], robot, data) is setting


def turned(
    settings: list[SimulationSetting], robot: Robot, data: jaxid.Dataset
) -> SimulationSetting | None:
    """Which of some settings is otherwise than stated, beside the re-tuned model."""
    ask = GoalsQuestion(
        model=robot,
        dataset=data,
        without=(),
        kinds=(),
        max_effects=1,
        step=STEP,
        answer=lambda *_: pytest.fail("no search is asked here"),
        progress=None,
    )
    binding = ask.known()
    decider = Decider(ask.made(binding), binding.layout.names)
    nominal = decider.refit((), binding.theta)
    return otherwise(settings, ask, decider, SearchResult(nominal, nominal))


@pytest.mark.parametrize("frictionloss", [0.5, 1.0])
def test_a_machine_takes_no_steps_where_a_claim_is_borne_out(robot, frictionloss):
    """A recording of the file's own simulator, and one in steps of a twentieth."""
    text = FILE.replace('frictionloss="0.5"', f'frictionloss="{frictionloss}"')
    fine = text.replace(f'timestep="{STEP}"', f'timestep="{STEP / 20}"').replace(
        'nsample="7"', 'nsample="121"'
    )
    u = goals(1.5)
    noise = 1e-4 * np.random.default_rng(6).standard_normal(len(u))
    in_steps = recorded(text, u) + noise
    in_none = recorded(fine, u, 20 * EVERY) + noise
    assert not is_so(STEPS, robot, dataset(u, in_steps, None))
    assert is_so(STEPS, robot, dataset(u, in_none, None))
    assert settings_of(dataset(u, in_none)) == [HOLD]  # steps that are stated stay


def test_joints_stick_where_a_claim_is_borne_out():
    """A file with MuJoCo's soft friction, a recording of it in fine steps, and one of hard
    friction.
    """
    text = FILE.replace(' delay="0.012" nsample="7"', "").replace(' range="-0.5 0.35"', "")
    robot = Robot.from_mjcf("lift.xml", text=text)
    fine = text.replace(f'timestep="{STEP}"', f'timestep="{STEP / 20}" integrator="RK4"').replace(
        ' integrator="implicitfast"', ""
    )
    hard = f'<default><joint solreffriction="{STEP / 10} 1" solimpfriction=".99 .9999 .001"/>'
    u = goals(1.5)
    noise = 1e-4 * np.random.default_rng(6).standard_normal(len(u))
    soft = recorded(fine, u, 20 * EVERY) + noise
    held = recorded(fine.replace("<worldbody>", f"{hard}</default><worldbody>"), u, 20 * EVERY)
    both = [STEPS, STICKING]
    assert turned(both, robot, dataset(u, recorded(text, u) + noise, None)) is None
    assert turned(both, robot, dataset(u, soft, None)) is STEPS
    assert turned(both, robot, dataset(u, held + noise, None)) is STICKING


def test_a_delay_is_said_to_be_that_for_the_files_steps(robot):
    u = goals(0.5)

    def said(simulator: str, *named: str) -> str:
        return " ".join(delays_said(bind(robot, dataset(u, u, simulator)), named))

    assert "commands act 1 ms early" in said("mujoco", "coulomb_friction", "input_delay")
    assert not said("mujoco", "coulomb_friction")
    assert not said("mujoco_rk4", "input_delay")


def test_what_is_written_begins_at_the_numbers_of_the_fit(robot):
    """Those of a law of the model, named as an effect, too: it is fitted once, not as one more."""

    def number(value: float) -> Any:
        return SimpleNamespace(value=value)

    brake = SimpleNamespace(
        effect="coulomb_friction", location="lift", parameters={"level": number(0.8)}
    )
    late = SimpleNamespace(
        effect="input_delay", location="lift_cmd", parameters={"delay": number(0.013)}
    )
    fit: Any = SimpleNamespace(parameters={"armature@lift": number(0.06)}, effects=[brake, late])
    u = goals(0.5)
    binding = known_loosely(with_room(bind(robot, dataset(u, u))))
    begins = _about(binding, fit)
    at = [binding.layout.index(name) for name in ("armature@lift", "frictionloss@lift")]
    assert begins.theta[at].tolist() == [0.06, 0.8]
    assert [begins.priors[i][0] for i in at] == [0.06, 0.8]
    assert brake.effect not in [c.effect for c in _candidates(binding, fit)]


def test_a_run_begins_with_the_speed_that_it_has():
    """One that is pulled from rest stands still first; a reading that is missing raises nothing."""
    t = np.arange(30) * 0.01
    q = 20 * t**2
    data = dataset(q, q)
    run = replace(data.experiments[0], t=t, initial=None, at_rest=False)
    assert measured_start(run, data, ("lift",)) == pytest.approx([0.0, 0.0], abs=1e-9)
    missing = replace(run, y=np.where(run.t[:, None] == t[2], np.nan, run.y))
    assert np.isnan(measured_start(missing, data, ("lift",))[1])
