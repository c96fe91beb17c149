"""From an emulator with a hidden effect to its name: excitation, recording with the real client library, diagnosis."""

from __future__ import annotations

import json

import numpy as np
import pytest
from emulators import Emulator

from jaxid.cli import main
from jaxid.hardware import Trajectory


CANDIDATES = "dead_zone,quadratic_drag,stribeck_friction,load_dependent_friction"

SERVO = """
model = "pendulum"
torque_constant = 1.77
[parameters]
inertia = 0.034
gravity_torque = 0.92
viscous = 0.05
coulomb = 0.07
offset = 0.015
[[effects]]
effect = "dead_zone"
parameters = { width = 0.12 }
"""

ARM = """
model = "pendulum"
seed = 3
[parameters]
inertia = [2.5, 2.5, 1.3, 0.3, 0.3, 0.2]
gravity_torque = [0.0, 60.0, 21.0, 3.0, 0.0, 0.0]
viscous = [12.0, 12.0, 6.5, 2.0, 2.0, 2.0]
coulomb = [8.0, 8.0, 4.0, 1.5, 1.5, 1.5]
[noise]
q = 1.0e-4
[[effects]]
effect = "quadratic_drag"
joint = 3
parameters = { coefficient = 5.0 }
"""


def write(file, play: Trajectory, names: list[str]) -> str:
    table = np.column_stack([play.t, play.values])
    np.savetxt(file, table, delimiter=",", header=",".join(["t", *names]), comments="", fmt="%.6f")
    return str(file)


def diagnosed(tmp_path, capsys) -> dict:
    capsys.readouterr()
    assert main(["diagnose", str(tmp_path / "data"), "--out", str(tmp_path / "diagnosis"), "--effects", CANDIDATES]) == 0
    return json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text())


def check(result: dict, effect: str, field: str, hidden: float, truth: dict[str, float]) -> None:
    """The hidden effect is the first named one, alone or beside smaller ones; hidden numbers lie in their 95 % intervals.

    Seven intervals hold together with 95 % where each is 2.7 standard deviations wide.
    """
    first = result["which"]["effects"][0]
    assert result["which"]["verdict"] == "named" and first["effect"] == effect, result["which"]
    entries = {name: result["parameters"][name] for name in truth} | {field: first["parameters"][field]}
    for name, value in {**truth, field: hidden}.items():
        entry = entries[name]
        assert abs(entry["value"] - value) < 2.7 * entry["std"], f"{name}: {entry['value']} ± {entry['std']}, hidden {value}"
    assert result["how_far"]["gap_after"] < 1.3 < 10 < result["how_far"]["gap_before"]


@pytest.mark.slow
def test_a_servo_with_a_hidden_dead_zone(tmp_path, capsys):
    (tmp_path / "plant.toml").write_text(SERVO)
    play = write(
        tmp_path / "play.csv", Trajectory.multisine(0.5, 10.0, frequencies=(0.15, 2.5), lines=9, kind="current"), ["current_cmd"]
    )
    (tmp_path / "limits.toml").write_text("data_age = 0.8\n")
    servo = Emulator.servo(tmp_path, plant=str(tmp_path / "plant.toml"))
    try:
        arguments = ["record", "dynamixel", "--port", servo.address, "--id", "1", "--mode", "current", "--rate", "100"]
        arguments += ["--play", play, "--live", "--limits", str(tmp_path / "limits.toml"), "--out", str(tmp_path / "data")]
        assert main([*arguments, "--model", "pendulum", "--gain", "1.77"]) == 0, capsys.readouterr().err
    finally:
        servo.close()
    result = diagnosed(tmp_path, capsys)
    truth = {"inertia": 0.034, "gravity_torque": 0.92, "viscous": 0.05, "coulomb": 0.07, "offset": 0.015}
    check(result, "dead_zone", "width", 0.12, truth)


@pytest.mark.slow
def test_an_arm_with_hidden_drag(tmp_path, capsys):
    pytest.importorskip("rtde_control", reason="ur_rtde has no wheel for this Python")
    (tmp_path / "plant.toml").write_text(ARM)
    path = Trajectory.multisine([0, 0, 0.5, 0, 0, 0], 9.0, center=[0, 0, 0.3, 0, 0, 0], frequencies=(0.1, 0.7), lines=7)
    play = write(tmp_path / "play.csv", path, [f"q{j}_cmd" for j in range(1, 7)])
    (tmp_path / "limits.toml").write_text("data_age = 0.8\n")
    robot = Emulator.ur(tmp_path, plant=str(tmp_path / "plant.toml"))
    try:
        arguments = [
            "record",
            "ur10",
            "--host",
            robot.address,
            "--play",
            play,
            "--live",
            "--limits",
            str(tmp_path / "limits.toml"),
        ]
        arguments += ["--out", str(tmp_path / "data"), "--model", "pendulum", "--joint", "3", "--gain", "8.5"]
        assert main(arguments) == 0, capsys.readouterr().err
    finally:
        robot.close()
    result = diagnosed(tmp_path, capsys)
    truth = {"inertia": 1.3, "gravity_torque": 21.0, "viscous": 6.5, "coulomb": 4.0, "offset": 0.0}
    check(result, "quadratic_drag", "coefficient", 5.0, truth)
