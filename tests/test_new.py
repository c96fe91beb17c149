"""`jaxid new`: files become a dataset folder with what is recognised, and a model is proposed."""

from __future__ import annotations

import json
import tomllib

import click
import numpy as np
import pytest

import jaxid
from jaxid.cli import new as command
from jaxid.cli.app import main
from jaxid.data.importers import by_joint
from jaxid.data.importers.new_dataset import new_dataset
from jaxid.problem.proposed_model import proposed_models, without_a_model


T = np.arange(400) / 100


def written(path, header, *columns, delimiter=","):
    np.savetxt(path, np.column_stack(columns), delimiter=delimiter, header=header, comments="")
    return path


def dataset(inputs, outputs, units=None):
    return jaxid.Dataset.from_arrays(
        T,
        {name: np.sin(T * (k + 1)) for k, name in enumerate(inputs)},
        {name: np.cos(T * (k + 1)) for k, name in enumerate(outputs)},
        units=units or {},
    )


def test_a_slide_is_recognised_whole(tmp_path, capsys):
    log = written(
        tmp_path / "log.csv",
        "Zeit [ms];Kraft [N];Position [mm]",
        T * 1000,
        np.sin(T),
        1000 * np.cos(T),
        delimiter=";",
    )
    assert main(["new", str(tmp_path / "slide"), str(log)]) == 0
    said = capsys.readouterr().out
    assert "force: input, N" in said and "position: output, m" in said
    assert "model: joint" in said and "jaxid diagnose" in said
    data = jaxid.load_dataset(tmp_path / "slide")
    assert data.model is not None and data.model.name == "joint"
    np.testing.assert_allclose(data.experiments[0].y[:, 0], np.cos(T), atol=1e-12)
    np.testing.assert_allclose(data.experiments[0].t, T, atol=1e-12)


def test_what_no_file_states_is_said_or_asked(tmp_path, monkeypatch, capsys):
    log = written(tmp_path / "log.csv", "t,tau,q", T, np.sin(T), np.degrees(np.cos(T)))
    out = tmp_path / "arm"
    assert main(["new", str(out), str(log)]) == 2
    error = capsys.readouterr().err
    assert "--unit q=UNIT" in error and "--unit tau=UNIT" in error
    assert not out.exists()
    asked = []

    def ask(channel):
        asked.append(channel.name)
        return {"tau": "N m", "q": "deg"}[channel.name]

    folder = new_dataset([log], out, ask=ask).folder
    assert asked == ["tau", "q"]
    data = jaxid.load_dataset(folder, check_model=False)
    np.testing.assert_allclose(data.experiments[0].y[:, 0], np.cos(T), atol=1e-12)

    answers = iter(["nonsense", "rad"])
    monkeypatch.setattr(click, "prompt", lambda text, type: next(answers))
    [channel] = [c for c in command_channels(log) if c.name == "q"]
    assert command.asked_unit(channel) == "rad"
    assert "nonsense" in capsys.readouterr().err


def command_channels(path):
    from jaxid.data.importers.command import ImportRequest
    from jaxid.data.importers.propose import recognised
    from jaxid.data.importers.source import read_source
    from jaxid.data.importers.text import StatedFormat

    stated = StatedFormat()
    asked = ImportRequest([read_source(path, stated)], [], stated, None, None, "out", False)
    return recognised(asked).channels


def test_options_come_before_what_is_recognised(tmp_path, capsys):
    log = written(tmp_path / "log.csv", "t,tau,q,extra", T, np.sin(T), np.cos(T), np.cos(2 * T))
    arguments = ["new", str(tmp_path / "d"), str(log), "--json", "--model", "pendulum"]
    units = ["--unit", "tau=N m", "--unit", "q=deg"]
    assert main([*arguments, *units, "--role", "extra=auxiliary"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["model"] == "pendulum" and found["models"] == ["joint", "pendulum"]
    assert found["channels"]["q"]["role"] == "output"
    text = tomllib.loads((tmp_path / "d" / "dataset.toml").read_text())
    assert text["model"] == {"name": "pendulum"}


def test_of_two_models_neither_is_chosen_and_files_stay_with_the_command(tmp_path, capsys):
    log = written(tmp_path / "log.csv", "t,tau,q", T, np.sin(T), np.cos(T))
    units = ["--unit", "tau=N m", "--unit", "q=rad"]
    assert main(["new", str(tmp_path / "d"), str(log), *units]) == 0
    said = capsys.readouterr().out
    assert "The model may be joint" in said and "or pendulum" in said
    assert "model" not in tomllib.loads((tmp_path / "d" / "dataset.toml").read_text())
    own = ["--model", "mine.py:Duffing", "--overwrite"]
    assert main(["new", str(tmp_path / "d"), str(log), *units, *own]) == 0
    assert "--model mine.py:Duffing --out out" in capsys.readouterr().out
    assert "model" not in tomllib.loads((tmp_path / "d" / "dataset.toml").read_text())


def test_wrong_words_say_what_there_is(tmp_path, capsys):
    log = written(tmp_path / "log.csv", "t,tau,q", T, np.sin(T), np.cos(T))
    out = str(tmp_path / "d")
    for options, word in (
        (["--unit", "taw=N m"], "tau"),
        (["--unit", "tau"], "NAME="),
        (["--role", "q=outputs"], "output"),
        (["--unit", "tau=N m", "--unit", "q=parsec"], "parsec"),
    ):
        assert main(["new", out, str(log), *options]) == 2
        assert word in capsys.readouterr().err
    bare = written(tmp_path / "bare.csv", "tau,q", np.sin(T), np.cos(T))
    assert main(["new", out, str(bare)]) == 2
    assert "--rate" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("inputs", "outputs", "units", "first", "renamed"),
    [
        (["force"], ["position"], {}, "joint", {}),
        (["tau"], ["q"], {}, "joint", {}),
        (["u_theta", "u_alpha"], ["theta", "alpha"], {"u_theta": "V", "u_alpha": "V", "theta": "rad", "alpha": "rad"}, "tracker", {}),
        (["motor"], ["slide"], {"motor": "N", "slide": "m"}, "joint", {"motor": "force", "slide": "position"}),
    ],
)  # fmt: skip
def test_models_are_proposed_by_names_and_by_units(inputs, outputs, units, first, renamed):
    data = dataset(inputs, outputs, units)
    found = proposed_models(data)
    assert found[0].name == first and found[0].renamed == renamed
    with pytest.raises(jaxid.UsageError) as error:
        jaxid.fit(None, data)
    assert f"--model {first}" in str(error.value)


def test_channels_of_no_model_are_said():
    units = {"a": "V", "b": "m/s", "c": "rad"}
    data = dataset(["a"], ["b", "c"], units)
    assert proposed_models(data) == ()
    assert "--model robot.xml" in without_a_model(data)


@pytest.mark.parametrize("outputs", [("qd",), ("q", "qd")])
def test_a_bench_that_reads_its_speed_is_a_joint(outputs):
    units = {"tau": "N m", "q": "rad", "qd": "rad/s"}
    own = {name: units[name] for name in ("tau", *outputs)}
    first = proposed_models(dataset(["tau"], outputs, own))[0]
    assert first.name == "joint" and not first.renamed


def test_a_fan_by_its_speed_is_told_to_be_a_joint(tmp_path, capsys):
    """Columns of a German bench: the speed in revolutions a minute."""
    log = written(
        tmp_path / "fan.csv",
        "Zeit [s];Moment [Nm];Drehzahl [1/min]",
        T,
        np.sin(T),
        9.5 * np.cos(T),
        delimiter=";",
    )
    assert main(["new", str(tmp_path / "fan"), str(log)]) == 0
    assert "--model joint" in capsys.readouterr().out


ARM = """<mujoco><worldbody>
  <body name="a"><joint name="shoulder" axis="0 1 0"/><geom size="0.1" mass="1"/>
    <body name="b" pos="0 0 1"><joint name="lift" type="slide" axis="0 1 0"/><geom size="0.1" mass="1"/></body>
  </body></worldbody>
  <actuator><position joint="shoulder" kp="9" kv="1"/><position joint="lift" kp="9" kv="1"/></actuator>
</mujoco>"""


def test_columns_of_a_robots_joints_are_its_channels(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(ARM)
    header = "time,shoulder_cmd,lift_cmd_m,shoulder,lift_pos_mm,shoulder_current,spare"
    columns = (np.sin(T), np.cos(T), np.sin(T), 1000 * np.cos(T), T, T)
    log = written(tmp_path / "log.csv", header, T, *columns)
    out = tmp_path / "arm"
    words = ["new", str(out), str(log), "--model", str(tmp_path / "arm.xml")]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "--unit shoulder_cmd=UNIT," in error and "one stands for all" in error
    assert main([*words, "--unit", "shoulder=rad"]) == 0
    said = capsys.readouterr().out
    assert f"jaxid diagnose {out} --out out" in said
    data = jaxid.load_dataset(out)
    assert data.model is not None and data.model.name == "robot"
    assert data.input_names == ["shoulder_cmd", "lift_cmd"]
    assert data.output_names == ["shoulder", "lift"]
    np.testing.assert_allclose(data.experiments[0].y[:, 1], np.cos(T), atol=1e-12)


@pytest.mark.parametrize(
    ("column", "name"),
    [
        ("shoulder", "shoulder"),
        ("shoulder_pos_deg", "shoulder"),
        ("target_shoulder", "shoulder_cmd"),
        ("shoulder_setpoint", "shoulder_cmd"),
        ("shoulder_velocity", "shoulder_qd"),
        ("shoulder_torque_Nm", "shoulder_tau"),
        ("shoulder_temperature", None),
        ("shoulder_error", None),
        ("shoulders", None),
        ("shoulder_2", "shoulder_2"),
    ],
)
def test_a_column_says_its_joint(column, name):
    joints = {"shoulder": False, "shoulder_2": False}
    found = by_joint._of_a_joint(column, "", joints)
    assert (None if found is None else found.name) == name
