"""Recordings and files of others, each as its README asks; skipped where they are not at hand."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import jaxid
from jaxid.cli.app import main
from jaxid.conventions.checking import run_check
from jaxid.conventions.finding import Checked
from jaxid.data.dataset import Dataset
from jaxid.fitters.short_fit import left_by_short_fit
from jaxid.numerics.stated_numbers import REFUTED
from jaxid.problem.binding import resolve_model
from jaxid.robots.match import notes_of, prepared, robot_from


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).parents[1] / "../shared/data"))
CASES = DATA.parent / "cases"


def case(name: str) -> Path:
    """The folder of a case."""
    if not (CASES / name).is_dir():
        pytest.skip(f"{name} is not in {CASES}: set JAXID_DATA to the folder beside the cases")
    return CASES / name


def checked(name: str) -> Checked:
    """What `jaxid check` finds in a case."""
    return run_check(None, jaxid.load_dataset(case(name)), gap=left_by_short_fit)


def imported(*words: str, folder: Path, out: Path) -> Dataset:
    """The dataset that `jaxid import` writes from files of a case; paths are relative to it."""
    given = [str(folder / w) if (folder / w).is_file() else w for w in words]
    assert main(["import", *given, "--out", str(out)]) == 0
    return jaxid.load_dataset(out)


#: Joints of the arm of several cases, and what its log calls them.
LOGGED = {"base_yaw": "base_yaw", "shoulder": "shoulder", "elbow": "elbow", "wrist": "wrist"}


def with_runs(name: str, into: Path) -> Path:
    """A case whose description names Parquet files, of which the folder has the text."""
    folder = shutil.copytree(case(name), into / name)
    described = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(reading_text(described, LOGGED))
    return folder


def reading_text(described: str, logged: Mapping[str, str]) -> str:
    """A description of Parquet files as one of the text that they were made of; `logged` says what
    the text calls a joint.
    """
    for k, run in enumerate(("run_a", "run_b", "run_c"), 1):
        described = described.replace(f'file = "run_{k}.parquet"', f'file = "{run}.csv"')
    for joint, column in logged.items():
        goal, read = f"[channels.{joint}_cmd]\n", f"[channels.{joint}]\n"
        described = described.replace(goal, f'{goal}column = "goal_{column}"\n')
        described = described.replace(read, f'{read}column = "pos_{column}"\n')
    return f'time = "time"\n{described}'


def diagnosed(folder: Path, into: Path) -> Path:
    """The result of `jaxid diagnose` of a folder."""
    assert main(["diagnose", str(folder), "--out", str(into / "found")]) == 0
    return into / "found" / "diagnosis.json"


def exported(result: Path, robot: Path, into: Path, *words: str, to: str = "mjcf") -> Path:
    """The folder that `jaxid export` of a result writes for a robot's file."""
    command = ["export", str(result), "--to", to, "--robot", str(robot), "--out", str(into)]
    assert main([*command, *words]) == 0
    return into


# ---- what a recording says about itself


def test_one_recording_under_two_names_is_one():
    found = checked("rig3_01_one_recording_under_two_names")
    (copy,) = found.findings
    assert (copy.kind, copy.channel, copy.applied) == ("copy", "b", True)
    assert found.mended is not None
    assert [e.name for e in found.mended.experiments] == ["a"]


def test_a_torque_that_is_reported_late_is_taken_earlier():
    (late,) = checked("rig3_02_torque_reported_22_ms_late").findings
    assert (late.kind, late.channel, late.applied) == ("row_shift", "tau", True)
    assert float(late.line.removeprefix("delay_s = ")) == pytest.approx(0.022, abs=1e-3)
    assert "no machine does that" in late.text


@pytest.mark.slow
def test_nothing_is_missing_once_a_late_torque_is_taken_earlier():
    found = jaxid.diagnose(None, jaxid.load_dataset(case("rig3_02_torque_reported_22_ms_late")))
    assert (found.which.verdict, found.which.effects) == ("none", ())


def test_the_sign_of_a_register_is_no_sign_of_a_channel():
    found = checked("rig3_03_sign_bit_registers").findings
    told = {f.channel: f.line for f in found}
    assert {f.kind for f in found} == {"unsigned"}
    assert told == {"tau": "sign_bit = 10", "qd": "sign_bit = 15"}


def test_repeats_that_warm_up_move_and_are_no_scatter():
    found = checked("rig3_04_repeats_that_warm_up")
    assert found.findings == ()
    assert any("change one way" in note and "warms up" in note for note in found.notes)


def test_a_lag_of_a_drive_is_no_shift_of_rows():
    assert checked("rig3_05_propeller_square_and_lag").findings == ()


@pytest.mark.slow
def test_a_propeller_has_neither_a_filter_in_its_sensor_nor_cogging():
    folder = case("rig3_05_propeller_square_and_lag")
    found = jaxid.diagnose(None, jaxid.load_dataset(folder))
    named = {e.effect for e in found.which.effects}
    assert not named & {"sensor_lag", "torque_ripple"}


def test_a_speed_that_was_averaged_is_late_whatever_the_model():
    (late,) = checked("rig3_06_speed_channel_filtered").findings
    assert (late.kind, late.channel) == ("filtered", "qd")
    assert late.value == pytest.approx(0.046, abs=3e-3)
    assert "Use q alone" in late.text


def test_play_is_read_off_two_encoders():
    (play,) = checked("rig3_07_two_encoders_show_the_play").findings
    assert play.kind == "play"
    assert play.interval_95 is not None
    low, high = play.interval_95
    assert low <= 0.030 <= high
    assert play.value == pytest.approx(0.030, abs=2e-3)


def test_a_tight_spot_of_a_belt_is_told_by_where_it_lies():
    data = jaxid.load_dataset(case("new3_belt_tight_spot"))
    found = jaxid.diagnose("joint", data, residual="inverse_dynamics")
    spot = found.where[0]
    assert (spot.location, spot.variable, spot.direction) == ("position", "position", "both")
    assert spot.range is not None
    assert spot.range == pytest.approx((0.29, 0.41), abs=0.03)
    assert spot.value == pytest.approx(11.0, abs=3.0) and spot.unit == "N"  # 14 N at its peak
    assert "against the motion" in spot.text
    assert not any(e.effect == "hysteresis" for e in found.which.effects)


# ---- robots' files


def test_an_inertia_of_a_robot_that_no_body_has_is_decisive():
    found = checked("robot3_urdf_negative_inertia").findings
    assert [(f.kind, f.channel, f.decisive) for f in found] == [("impossible_body", "hip", True)]
    assert "-0.0013" in found[0].text and "-0.0012" in found[0].text


def test_a_branch_is_exported_without_what_the_identification_left_out(tmp_path):
    folder = case("robot3_export_of_a_branch")
    robot, found = folder / "mobile.urdf", tmp_path / "found"
    assert main(["identify", str(folder), "--out", str(found)]) == 0
    patched = exported(found / "identification.json", robot, tmp_path / "patched", to="urdf")
    text = (patched / "mobile.urdf").read_text()
    assert text.count("<joint") == robot.read_text().count("<joint")
    assert "friction" in text


@pytest.mark.slow
def test_a_limit_that_nothing_states_is_left_as_the_file_has_it(tmp_path):
    folder = case("robot3_force_limit_lost")
    result = diagnosed(folder, tmp_path)
    patched = exported(result, folder / "hub.xml", tmp_path / "patched")
    text = (patched / "hub.xml").read_text()
    assert 'forcerange="-6 6"' in text
    assert "1000000000" not in text


@pytest.mark.slow
def test_a_number_at_its_bound_leaves_a_covariance(tmp_path):
    folder = case("robot3_covariance_at_bound")
    robot, result = folder / "hub.xml", diagnosed(folder, tmp_path)
    patched = exported(result, robot, tmp_path / "patched")
    ranges = exported(result, robot, tmp_path / "ranges", "--ranges", to="mjlab")
    matrix = np.array(json.loads(result.read_text())["covariance"]["matrix"])
    scale = np.sqrt(np.diag(matrix))
    assert np.linalg.eigvalsh(matrix / scale / scale[:, None]).min() > -1e-6
    written = (patched / "hub.xml").read_text()
    kv = float(written.split('kv="')[1].split('"')[0])
    assert kv == pytest.approx(0.05, abs=0.01)
    kp = float(written.split('kp="')[1].split('"')[0])
    assert kp == pytest.approx(8, rel=0.02)  # MuJoCo's friction is softer than the machine's
    assert 'damping="0.02"' in written and 'frictionloss="0.02"' in written
    told = json.loads((ranges / "ranges.json").read_text())["correlation"]["matrix"]
    assert np.linalg.eigvalsh(np.array(told)).min() > -1e-6


@pytest.mark.slow
def test_only_the_friction_that_is_wrong_is_written(tmp_path):
    folder = with_runs("new3_export_hardens_friction", tmp_path)
    robot, result = folder / "robot.xml", diagnosed(folder, tmp_path)
    told = json.loads(result.read_text())
    refuted = [r["parameter"] for r in told["stated"] if abs(r["deviation"] or 0.0) > REFUTED]
    assert (told["which"]["verdict"], refuted) == ("none", ["frictionloss"])
    patched = exported(result, robot, tmp_path / "patched", "--data", str(folder))
    text = (patched / "robot.xml").read_text()
    assert text.count("solreffriction") == robot.read_text().count("solreffriction")
    assert text.count("frictionloss") == robot.read_text().count("frictionloss")
    page = (result.parent / "report.html").read_text()
    assert "dry friction" in page.split("<h1>")[1].split("</h1>")[0]


@pytest.mark.slow
def test_what_the_steps_of_a_file_add_is_counted_once(tmp_path):
    folder = with_runs("new3_mujoco_integrator_counted_twice", tmp_path)
    found = jaxid.diagnose(None, jaxid.load_dataset(folder))
    refuted = [r for r in found.final.stated if r.refuted]
    assert [(r.parameter, r.joint) for r in refuted] == [("armature", "elbow")]
    assert refuted[0].fitted == pytest.approx(0.12, rel=0.02)


# ---- joints that a file drives, couples or names in its own way


def notes(folder: Path, tip: str | None = None) -> str:
    """What a result says of how the robot of a case and its recording were brought together."""
    dataset = jaxid.load_dataset(folder)
    asked = None if tip is None else robot_from(str(folder / "picker.xml"), tip)
    robot, data = prepared(asked, dataset)
    return " ".join((*data.notes, *notes_of(robot, data)))


def test_a_gripper_by_a_tendon_contradicts_nothing():
    assert checked("robot3_gripper_by_tendon").findings == ()


@pytest.mark.parametrize("tip", [None, "fore"])
def test_fingers_in_a_tendon_are_held_where_nobody_recorded_them(tip):
    said = notes(case("robot3_gripper_by_tendon"), tip)
    held = said.split("held: ")[1]
    assert "thumb" in held and "index" in held
    assert tip is not None or "not simulated" in said and "'grip'" in said


@pytest.mark.parametrize("described", ["dataset_1_as_recorded", "dataset_2_after_the_advice"])
def test_either_finger_may_be_recorded_of_two_that_a_file_couples(described, tmp_path):
    folder = shutil.copytree(case("new3_gripper_follower_advice_loops"), tmp_path / "data")
    text = (folder / f"{described}.toml").read_text()
    first, model = text.index('[[experiments]]\nfile = "run_2'), text.index("[model]")
    of_one_run = (text[:first] + text[model:]).replace('column = "finger_l"\n', "")
    fingers = {"finger_l": "gripper", "finger_r": "gripper"}
    (folder / "dataset.toml").write_text(reading_text(of_one_run, LOGGED | fingers))
    robot, data = prepared(None, jaxid.load_dataset(folder))
    bound = resolve_model(robot, data)
    said = notes(folder)
    if described == "dataset_1_as_recorded":
        assert bound.signature.joints[-1] == "finger_l"
        assert "finger_l is recorded and stands for finger_r" in said
    else:
        assert bound.signature.joints[-1] == "finger_r"
        assert "the goal of finger_l is taken as that of finger_r" in said


@pytest.mark.parametrize("base", ["", '[model.base]\nkind = "prescribed"\n'])
def test_a_joint_of_the_file_is_no_attitude_of_the_base(base, tmp_path):
    folder = shutil.copytree(case("new3_joint_named_base_yaw"), tmp_path / "data")
    with (folder / "dataset.toml").open("a") as described:
        described.write(base)
    robot, data = prepared(None, jaxid.load_dataset(folder))
    assert resolve_model(robot, data).signature.joints == tuple(LOGGED)
    assert "recorded and not used" not in notes(folder)


# ---- files that are imported


def test_a_trace_with_one_block_a_variable_is_read_by_name(tmp_path):
    words = ("t=GVL.fTorque:ms", "tau=GVL.fTorque:N m:input", "q=GVL.fPos:rad:output")
    folder = case("rig3_08_plc_trace_one_block_per_variable")
    channels = [f"--channel={w}" for w in words]
    data = imported("csv", "axis.trace.csv", *channels, folder=folder, out=tmp_path / "out")
    (run,) = data.experiments
    assert len(run) == 800
    np.testing.assert_allclose(np.diff(run.t), 0.008, atol=1e-9)


def test_blank_cells_of_a_log_are_no_readings(tmp_path):
    words = ("t=time_s:s", "knee_cmd=knee_goal_rad:rad:input", "knee=knee_rad:rad:output")
    channels = [f"--channel={w}" for w in words]
    folder = case("robot3_blank_cells")
    data = imported("csv", "log.csv", *channels, folder=folder, out=tmp_path / "out")
    (run,) = data.experiments
    assert run.read is not None
    assert (len(run), np.count_nonzero(~run.read)) == (1200, 24)


def test_every_file_that_is_joined_counts(tmp_path):
    words = (
        "t=stamp:s",
        "lift=lift_position:rad:output",
        "lift_qd=lift_velocity:rad/s:output",
        "lift_tau=lift_effort:N m:input",
    )
    channels = [f"--channel={w}" for w in words]
    files = ("position.csv", "--join", "velocity.csv", "--join", "effort.csv")
    folder = case("robot3_join_twice")
    data = imported("csv", *files, *channels, folder=folder, out=tmp_path / "out")
    assert {c.name for c in data.channels} == {"lift", "lift_qd", "lift_tau"}
    assert len(data.experiments[0]) == 600


def test_two_joined_tables_end_as_they_should(tmp_path):
    words = ("t=stamp:us", "q*=positions[*]:rad:output", "q*_cmd=goal.positions[*]:rad:input")
    channels = [f"--channel={w}" for w in words]
    folder = case("robot3_import_abort")
    files = ("state.csv", "--join", "goal.csv")
    data = imported("csv", *files, *channels, folder=folder, out=tmp_path / "out")
    assert len(data.outputs) == len(data.inputs) == 4


def test_names_in_a_list_of_lists_are_names(tmp_path, capsys):
    folder = case("robot3_lerobot_nested_names")
    command = ["import", "lerobot", str(folder), "--unit", "rad", "--out", str(tmp_path / "out")]
    assert main(command) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "q1 = LeftShoulderPitch, q2 = LeftElbow, q3 = RightShoulderPitch" in said


def test_a_proposal_has_the_only_input(tmp_path, capsys):
    log = case("new3_import_proposal_drops_the_input") / "Fahrt1.csv"
    assert main(["import", "csv", str(log), "--out", str(tmp_path / "out")]) == 2
    command = capsys.readouterr().err.split("unit: ")[1].split(" (roles")[0]
    assert "Motorstrom" in command and ":A:input" in command
    assert "Istposition" in command and "Sollposition" in command


# ---- a model of one's own


def test_commands_take_a_model_by_its_file(tmp_path):
    folder = case("new3_own_model_no_command")
    model, data, out = str(folder / "duffing.py"), str(folder / "osc"), str(tmp_path / "out")
    assert main(["check", data, "--model", model]) == 0
    assert main(["fit", data, "--model", f"{model}:Duffing", "--out", out]) == 0
    numbers = json.loads((tmp_path / "out" / "fit.json").read_text())["parameters"]
    true = {"delta": 0.25, "alpha": 1.0, "beta": 4.0}
    found = {name: numbers[name]["value"] for name in true}
    assert found == pytest.approx(true, rel=0.05)
