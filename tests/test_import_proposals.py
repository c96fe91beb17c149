# ruff: noqa: E501 (tables of layouts, one a line)
"""What is proposed for a file whose channels nobody named: every command runs as it is printed, and
none leaves the input out.
"""

from __future__ import annotations

import json
import shlex
import tomllib

import numpy as np
import pytest

from jaxid.cli.app import main
from jaxid.data.importers.quantities import meaning_of
from jaxid.data.io import load_dataset
from test_import_tables import Q, run, same, T, TAU


def german(header: str, columns: list[np.ndarray]) -> str:
    body = [
        ";".join(f"{v:.6f}".replace(".", ",") for v in row) for row in zip(*columns, strict=True)
    ]
    return "\n".join(["Prüfstand X1;Datum 12.03.2024;", "Abtastzeit;10 ms", "", header, *body, ""])


def plain(header: str, columns: list[np.ndarray], separator: str = ",") -> str:
    body = [separator.join(f"{v:.6f}" for v in row) for row in zip(*columns, strict=True)]
    return "\n".join([header.replace(",", separator), *body, ""])


TWO = [T, Q, Q + 1, TAU, -TAU]
#: Name -> the file, and role -> the channels that the command must have.
LAYOUTS = {
    "a German axis": ("a.csv", german("Zeit [ms];Sollposition [mm];Istposition [mm];Motorstrom [A]", [1e3 * T, Q, Q, TAU]), {"output": ["position"], "input": ["current"], "auxiliary": ["position_cmd"]}),
    "a German joint": ("a.csv", german("Zeit [s];Sollwinkel [deg];Istwinkel [deg];Istdrehzahl [rpm];Drehmoment [Nm]", [T, Q, Q, Q, TAU]), {"output": ["q"], "input": ["tau"], "auxiliary": ["q_cmd", "qd"]}),
    "a goal and a position": ("a.csv", plain("time,target_pos,actual_pos,following_error", [T, Q, Q, Q]), {"output": ["q"], "input": ["q_cmd"], "auxiliary": ["following_error"]}),
    "units behind names": ("a.csv", plain("time_s,knee_goal_rad,knee_rad", [T, Q, Q]), {"output": ["q"], "input": ["q_cmd"]}),
    "tabs and brackets": ("a.txt", plain("t (s),q (rad),i_motor (A),u (V)", [T, Q, TAU, TAU], "\t"), {"output": ["q"], "input": ["current"], "auxiliary": ["voltage"]}),
    "current positions": ("a.csv", plain("stamp,present_position,goal_position,present_current", [T, Q, Q, TAU]), {"output": ["q"], "input": ["current"], "auxiliary": ["q_cmd"]}),
    "two joints": ("a.csv", plain("t,q_1,q_2,tau_1,tau_2", TWO), {"output": ["q1", "q2"], "input": ["tau1", "tau2"]}),
    "joints with names": ("a.csv", plain("t,lift_position,elbow_position,lift_effort,elbow_effort", TWO), {"output": ["q1", "q2"], "input": ["tau1", "tau2"]}),
    "joints of a robot's log": ("a.csv", plain("t,shoulder.pos,elbow.pos,shoulder.pos.target,elbow.pos.target", TWO), {"output": ["q1", "q2"], "input": ["q1_cmd", "q2_cmd"]}),
    "camel case": ("a.csv", plain("Timestamp,AxisActPos,AxisSetPos,AxisActTorque", [T, Q, Q, TAU]), {"output": ["q"], "input": ["tau"], "auxiliary": ["q_cmd"]}),
    "words that say nothing": ("a.csv", plain("t,foo,bar", [T, Q, TAU]), {"output": ["foo"], "auxiliary": ["bar"]}),
    "no header": ("a.csv", plain("", [T, Q, TAU])[1:], {"output": ["channel_2"], "auxiliary": ["channel_3"]}),
    "lists in cells": ("a.csv", "\n".join(["t,position,goal", *(f'{t},"[{q}, {q}]","[{q}, {q}]"' for t, q in zip(T, Q, strict=True)), ""]), {"output": ["q1", "q2"], "input": ["q1_cmd", "q2_cmd"]}),
    "matrices in cells": ("a.csv", "\n".join(["t,q,pose", *(f'{t},{q},"[[1, {q}], [0, 1]]"' for t, q in zip(T, Q, strict=True)), ""]), {"output": ["q"]}),
    "JSON with its rate": ("a.json", json.dumps({"fs": 100, "angle": Q.tolist(), "torque": TAU.tolist(), "kp": 20.0}), {"output": ["q"], "input": ["tau"]}),
}  # fmt: skip


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_proposed_command_runs_as_printed(tmp_path, capsys, name):
    file, content, wanted = LAYOUTS[name]
    (tmp_path / file).write_text(content, encoding="cp1252")
    kind = "json" if file.endswith("json") else "csv"
    assert main(["import", kind, str(tmp_path / file), "--out", str(tmp_path / "out")]) == 2
    command = capsys.readouterr().err.split("unit: ")[1].split(" (roles")[0]
    assert main([*shlex.split(command)[1:], "--quiet"]) == 0
    channels = load_dataset(tmp_path / "out", check_model=False).channels
    for role in ("output", "input"):
        assert [c.name for c in channels if c.role == role] == wanted.get(role, [])
    assert set(wanted.get("auxiliary", [])) <= {c.name for c in channels if c.role == "auxiliary"}


def test_options_that_were_given_stay_in_the_proposal(tmp_path, capsys):
    (tmp_path / "a.csv").write_text(plain("t,q", [T, Q]))
    (tmp_path / "b.csv").write_text(plain("t,tau", [T, TAU]))
    given = ["--join", str(tmp_path / "b.csv"), "--rows", "5:50", "--separator", ",", "--overwrite"]
    assert (
        main(["import", "csv", str(tmp_path / "a.csv"), *given, "--out", str(tmp_path / "out")])
        == 2
    )
    command = capsys.readouterr().err.split("unit: ")[1].split(" (roles")[0]
    assert all(word in shlex.split(command) for word in given)
    assert main([*shlex.split(command)[1:], "--quiet"]) == 0
    data = load_dataset(tmp_path / "out", check_model=False)
    assert len(data.experiments[0].t) == 45 and [c.name for c in data.inputs] == ["tau"]


def test_a_table_without_times_asks_for_the_rate(tmp_path, capsys):
    (tmp_path / "a.csv").write_text(plain("q,tau", [Q, TAU]))
    assert main(["import", "csv", str(tmp_path / "a.csv"), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "no column of times is found" in said and "--rate HZ --channel q=q" in said
    command = said.split("unit: ")[1].split(" (roles")[0].replace("HZ", "100")
    assert main([*shlex.split(command)[1:], "--quiet"]) == 0


def test_more_columns_than_are_shown_are_counted(tmp_path, capsys):
    names = ["t", *(f"x{k}y" for k in range(1, 60))]
    (tmp_path / "a.csv").write_text(plain(",".join(names), [T, *(Q + k for k in range(59))]))
    assert main(["import", "csv", str(tmp_path / "a.csv"), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert (
        "and 20 more, the last 'x59y'" in said
        and "19 more channels are left out of the command" in said
    )


@pytest.mark.parametrize(
    ("name", "unit", "quantity", "goal"),
    [
        ("Sollposition", "", "position", True),
        ("Istposition", "", "position", False),
        ("Motorstrom", "A", "current", False),
        ("lrActPos", "", "position", False),
        ("GVL.fTorque", "", "torque", False),
        ("dq_des", "", "velocity", True),
        ("current_position", "", "position", False),
        ("cmd", "rad", "position", True),
        ("Schleppfehler", "mm", "", False),
        ("distance", "", "", False),
        ("list", "", "", False),
        ("soll_drehzahl", "", "velocity", True),
        ("setpoint", "", "", True),
        ("Consigne position", "rad", "position", True),
        ("Position mesurée", "rad", "position", False),
        ("Vitesse", "", "velocity", False),
        ("Posición deseada", "rad", "position", True),
        ("Corriente del motor", "", "current", False),
        ("Posizione comandata", "", "position", True),
        ("Coppia", "", "torque", False),
        ("Posição desejada", "", "position", True),
        ("Gewenste positie", "", "position", True),
        ("Motorstroom", "A", "current", False),
        ("目标位置", "", "position", True),
        ("实际位置", "", "position", False),
        ("电机电流", "A", "current", False),
        ("指令角度", "", "position", True),
        ("トルク", "", "torque", False),
        ("Заданное положение", "", "position", True),
        ("position", "", "position", False),
        ("coupled_mass", "", "", False),
    ],
)
def test_what_a_name_says(name, unit, quantity, goal):
    found = meaning_of(name, unit)
    assert (found.quantity, found.goal) == (quantity, goal)


def trace(late: float = 0.0) -> str:
    """A trace of a controller: a block a variable, its times in ms, those of the second `late`."""
    lines = ["[key]; [value]", "Name; Plant.Trace1", "EveryNCycles; 1"]
    for k, (name, shift, values) in enumerate((("GVL.fTorque", 0.0, TAU), ("GVL.fPos", late, Q))):
        lines += [f"{k}.Variable; {name}", f"{k}.Class; 14", f"{k}.Data; "]
        lines += [f"; {1e3 * t + shift:g}; {v}" for t, v in zip(T, values, strict=True)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("clock", ["t", "GVL.fTorque"])
def test_a_trace_of_one_block_a_variable(tmp_path, capsys, clock):
    (tmp_path / "a.csv").write_text(trace())
    same(
        run(
            tmp_path / "a.csv",
            tmp_path / "a",
            (f"t={clock}:ms", "tau=GVL.fTorque:N m:input", "q=GVL.fPos:rad:output"),
        )[0]
    )
    assert main(["import", "csv", str(tmp_path / "a.csv"), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "a trace with one block a variable (2)" in said
    assert (
        "--channel t=t:ms --channel tau=GVL.fTorque:1:input --channel q=GVL.fPos:1:output" in said
    )


def test_blocks_with_other_times_are_read_where_they_were(tmp_path):
    (tmp_path / "a.csv").write_text(trace(late=4))
    data, _ = run(
        tmp_path / "a.csv",
        tmp_path / "a",
        ("t=t:ms", "tau=GVL.fTorque:N m:input", "q=GVL.fPos:rad:output"),
    )
    (e,) = data.experiments
    np.testing.assert_allclose(e.y[e.read[:, 0], 0], Q)
    np.testing.assert_allclose(e.t[e.read[:, 0]], T + 0.004, atol=1e-9)
    np.testing.assert_allclose(e.u[::2, 0], TAU)


def test_joints_that_are_elements_of_lists_are_one_recording(tmp_path, capsys):
    joints = 3
    header = ["tick_ms"]
    columns = [1e3 * T]
    for k in range(joints):
        header += [f"motor_state[{k}].q", f"motor_state[{k}].tau_est"]
        columns += [Q + k, TAU + k]
    for k in range(joints):
        header += [f"motor_cmd[{k}].q", f"motor_cmd[{k}].kp"]
        columns += [Q - k, 20.0 + 0 * Q]
    path = tmp_path / "lowstate.csv"
    path.write_text(plain(",".join(header), columns))
    assert main(["import", "csv", str(path), "--out", str(tmp_path / "out")]) == 2
    command = capsys.readouterr().err.split("unit: ")[1].split(" (roles")[0]
    assert "'kp*=motor_cmd[*].kp:1:auxiliary'" in command
    assert main([*shlex.split(command)[1:], "--quiet"]) == 0
    (e,) = load_dataset(tmp_path / "out", check_model=False).experiments
    np.testing.assert_allclose(e.y, np.stack([Q, Q + 1, Q + 2], axis=1), atol=1e-6)
    np.testing.assert_allclose(e.u, np.stack([TAU, TAU + 1, TAU + 2], axis=1), atol=1e-6)


def test_names_of_joints_beside_arrays_name_the_channels_again_by_the_printed_command(
    tmp_path, capsys
):
    path = tmp_path / "log.npz"
    names = ["FL_hip", "FR_hip", "FL_knee", "FR_knee"]
    positions = np.stack([Q + k for k in range(4)], axis=1)
    np.savez(path, time=T, joint_pos=positions, joint_pos_target=-positions, joint_names=names)
    wanted = ["--channel", "t=time:s", "--channel", "q*=joint_pos[*]:rad"]
    wanted += ["--channel", "q*_cmd=joint_pos_target[*]:rad:input"]
    command = ["import", "npz", str(path), *wanted, "--out", str(tmp_path / "a")]
    for folder in ("a", "b"):
        command[command.index("--out") + 1] = str(tmp_path / folder)
        assert main(command) == 0
        stated = tomllib.loads((tmp_path / folder / "dataset.toml").read_text())
        assert stated["model"]["joints"] == {f"q{k}": n for k, n in enumerate(names, 1)}
        said = capsys.readouterr().out.split("said in full: ")[1].splitlines()[0]
        command = shlex.split(said)[1:]
