"""The README's code runs as it stands there."""

import importlib
import json
import math
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.base.wording import percent
from jaxid.cli.app import main


ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
OWN_MODEL, FROM_PYTHON = re.findall(r"```python\n(.*?)```", README, re.S)
EXTENDING = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "extending.md").read_text(), re.S)
OWN_EFFECT = next(block for block in EXTENDING if "JointEffect" in block)
TABLE, ROBOT = (
    b.splitlines() for b in re.findall(r"```sh\n(.*?)```", README, re.S) if b.startswith("jaxid")
)
(STATED,) = re.findall(r"```toml\n(.*?)```", README, re.S)
(ANSWER,) = re.findall(r"```text\n(.*?)```", README, re.S)
#: A number, and how near one that another machine computed has to be.
NUMBER, NEAR = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?"), 0.05


def test_it_is_short():
    assert len(README.splitlines()) <= 160


def told_alike(lines: str, told: str) -> None:
    """The same words, and numbers that differ by no more than computers do."""

    def words(s):
        return re.sub(r"\s+", " ", NUMBER.sub("#", s)).strip()

    assert words(lines) in words(told)

    def numbers(s):
        return [float(x) for x in NUMBER.findall(s)]

    for part in re.split(r"\n(?=[A-Z])", lines.strip()):
        (label,) = re.findall(r"^[A-Z ]{4,8}(?=  )", part)
        other = next(p for p in re.split(r"\n(?=[A-Z])", told) if p.startswith(label))
        for a, b in zip(numbers(part), numbers(other), strict=False):
            assert abs(a - b) <= NEAR * max(abs(a), abs(b)) or label.strip() == "WHERE", part


def test_first_block_goes_from_data_to_a_diagnosis(tmp_path, monkeypatch, capsys):
    shutil.copytree(ROOT / "examples" / "servo_pendulum", tmp_path / "my_robot")
    monkeypatch.chdir(tmp_path)
    made: dict = {}
    exec(FROM_PYTHON, made)
    told = capsys.readouterr().out
    assert "named" in told and "dead_zone" in told
    told_alike(ANSWER, told)
    assert (tmp_path / "report.html").stat().st_size > 10_000
    the_picture_shows(made["diagnosis"])


def the_picture_shows(diagnosis: jaxid.Diagnosis) -> None:
    """The README's first picture is of these numbers; docs/make_picture.py makes it anew."""
    picture = (ROOT / "docs" / "_static" / "gap.svg").read_text()
    words = re.findall(r"<text[^>]*>([^<]*)</text>", picture)
    labels = [float(m[1]) for w in words if (m := re.match(r"([\d.]+(?:e[+-]?\d+)?)(?:,|$)", w))]
    far = diagnosis.how_far
    for gap in (far.gap_before, far.gap_retuned, far.gap_after):
        assert any(abs(label / gap - 1) < 0.02 for label in labels), (
            f"{gap:.4g} is not in the picture: make it anew"
        )
    assert f"{percent(far.shrinkage)} of the gap closed" in words


def sprung_cart() -> jaxid.Dataset:
    """Mass 2 kg, stiffness 40 N/m, viscous 1.5 N s/m: exact by the matrix exponential of the held
    force.
    """
    from scipy.linalg import expm

    t = np.arange(600) / 100
    rng = np.random.default_rng(0)
    u = 4 * np.sin(2 * np.pi * 0.5 * t) + 2 * np.sin(2 * np.pi * 1.3 * t)
    step = expm(np.array([[0, 1, 0], [-20, -0.75, 0.5], [0, 0, 0]]) * 0.01)
    x, q = np.zeros(2), []
    for force in u:
        q.append(x[0])
        x = (step @ np.append(x, force))[:2]
    return jaxid.Dataset.from_arrays(
        t,
        {"force": u},
        {"position": np.array(q) + 1e-5 * rng.standard_normal(600)},
        units={"force": "N", "position": "m"},
        at_rest=True,
        noise_std={"position": 1e-5},
    )


def test_the_recipes_for_a_model_and_an_effect_fit():
    made: dict = {}
    for block in (OWN_MODEL, OWN_EFFECT):
        exec(block, made)
    data = sprung_cart()
    fit = jaxid.fit(made["SpringCart"](), data, without=["coulomb_friction"])
    for name, truth in {"mass": 2.0, "stiffness": 40.0, "viscous": 1.5}.items():
        found = fit.parameters[name]
        assert found.std is not None and abs(found.value - truth) < 4 * found.std + 1e-4 * truth
    from jaxid.dynamics.chain import Chain
    from jaxid.dynamics.parameter_vector import ParameterVector

    joint = Chain(jaxid.models.Joint()).with_effects(made["SpringTorque"]())
    assert "spring_torque.stiffness@q" in ParameterVector(joint).names


def typed(lines: list[str]) -> None:
    """Each line as it stands there."""
    for line in lines:
        program, *words = shlex.split(line, comments=True)
        assert program == "jaxid" and main(words) == 0, line


def test_the_road_from_a_table_runs_as_it_is_typed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    pendulum_log(Path("log.csv"))
    typed(TABLE)
    told = capsys.readouterr().out
    assert "Nothing found" in told and "Nothing is missing" in told, told
    assert Path("out/report.html").stat().st_size > 10_000 and Path("out/diagnosis.json").is_file()


#: What is typed for the words in capitals of the table of commands, and for its dots.
FILLED = {
    "DATASET": ["bench"],
    "STUDY.toml": ["study.toml"],
    "FIT.json": ["fit/fit.json"],
    "RESULT.json": ["fit/fit.json"],
    "FORMAT": ["isaaclab"],
    "FILE…": ["log.csv"],
    "M": ["pendulum"],
    "NAME": ["carts"],
    "…": ["--seed", "3", "--cases", "1", "--workers", "1", "--out", "benchmark"],
}
#: Rows that other tests type: the file, and how the command stands there. They need a robot or an
#: emulator, go on until they are stopped, or take long.
ELSEWHERE = {
    "import": ("test_readme.py", r"typed\(TABLE\)"),
    "replay": ("test_readme.py", r"typed\(ROBOT\)"),
    "identify": ("test_identification.py", r'\["identify", str\(tmp_path / "data"\), "--out"'),
    "reproduce": ("test_papers.py", r'main\(\["reproduce", paper, "--out"'),
    "record ur10": ("test_hardware_ur.py", r'"record", "ur10", "--host"'),
    "record dynamixel": ("test_view.py", r'"record", "dynamixel", "--port"'),
    "emulate ur10": ("emulators.py", r'"emulate",\s+\*arguments'),
    "view": ("test_view.py", r'"jaxid", "view", "with", "without"'),
    "watch": ("test_view.py", r'"jaxid", "watch", "data"'),
}
ROWS = [
    shlex.split(command)[1:]
    for row in re.findall(r"^\| (`jaxid .*?) \|", README, re.M)
    for command in re.findall(r"`(jaxid [^`]*)`", row)
]


#: Commands in the text beside the table, with more than a name and its option.
(OF_THE_TEXT,) = (
    command
    for command in re.findall(r"`(jaxid [^`]*)`", re.sub(r"(?m)^\|.*$|```[^`]*```", "", README))
    if len(command.split()) > 3
)


def elsewhere(words: list[str]) -> bool:
    """Whether another test types a row of the table."""
    return words[0] in ELSEWHERE or " ".join(words[:2]) in ELSEWHERE


@pytest.mark.parametrize("name", ELSEWHERE)
def test_rows_of_the_table_that_others_type_are_typed_there(name):
    file, line = ELSEWHERE[name]
    assert any(" ".join(words).startswith(name) for words in ROWS)
    assert re.search(line, (ROOT / "tests" / file).read_text()), file


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_other_rows_of_the_table_run_as_they_are_typed(tmp_path, monkeypatch):
    """One after the other in one folder; each DIR is named after its command."""
    monkeypatch.chdir(tmp_path)
    pendulum_log(Path("log.csv"))
    typed(TABLE[:1])
    toml = Path("bench/dataset.toml")
    toml.write_text(toml.read_text() + '\n[model]\nname = "pendulum"\n')
    study = 'name = "s"\nstore = "batch"\n[[runs]]\ncommand = "fit"\ndatasets = ["bench"]\n'
    Path("study.toml").write_text(study)
    own = [words for words in ROWS if not elsewhere(words)]
    for words in own:
        filled: list[str] = []
        for word in words:
            filled += FILLED.get(word, [words[0] if word == "DIR" else word])
        assert main(filled) == 0, filled
    made = {path.name for path in tmp_path.iterdir() if path.is_dir()}
    assert {words[0] for words in own if "DIR" in words} | {"batch", "benchmark"} <= made


@pytest.mark.parametrize("listed", [w for w in ROWS if w[0] in ("models", "effects", "fitters")])
def test_what_there_is_is_listed_and_each_described_by_its_name(listed, capsys):
    assert main([*listed, "--json"]) == 0
    first = json.loads(capsys.readouterr().out)[listed[0]][0]["name"]
    assert main([*listed, first]) == 0 and first in capsys.readouterr().out


@pytest.mark.slow
def test_the_command_for_an_own_model_runs_as_it_is_typed(tmp_path, monkeypatch, capsys):
    """A cart on a spring that lacks nothing."""
    monkeypatch.chdir(tmp_path)
    Path("spring_cart.py").write_text(OWN_MODEL)
    jaxid.save_dataset(sprung_cart(), "my_robot")
    typed([OF_THE_TEXT])
    assert "Nothing is missing" in capsys.readouterr().out


def pendulum_log(file: Path) -> None:
    """Writes the log of a pendulum that lacks nothing."""
    t = np.arange(600) / 100
    torque, q, qd, angle = 0.6 * np.sin(2.1 * t) + 0.4 * np.sin(5.3 * t), 0.0, 0.0, []
    for push in torque:
        angle.append(np.degrees(q))
        for _ in range(100):
            qd += 1e-4 * (push - 0.05 * qd - 1.2 * math.sin(q)) / 0.06
            q += 1e-4 * qd
    angle += 0.02 * np.random.default_rng(0).standard_normal(t.size)
    rows = [f"{a:.2f},{b:.6f},{c:.6f}" for a, b, c in zip(t, torque, angle, strict=True)]
    file.write_text("\n".join(["time_s,motor_Nm,enc_deg", *rows]))


def one_hinge(folder: Path) -> Any:
    """Writes a recording of one hinge that is driven by goals, with friction that its file does not
    state; returns MuJoCo.
    """
    mujoco: Any = importlib.import_module("mujoco")
    robot = """<mujoco><option timestep="0.001" integrator="implicitfast"/><compiler angle="radian"/><worldbody>
<body name="arm"><joint name="shoulder" type="hinge" axis="0 1 0" damping="0.3" frictionloss="{}"/>
<inertial pos="0.2 0 0" mass="1.2" diaginertia="0.01 0.02 0.02"/></body></worldbody></mujoco>"""
    folder.mkdir()
    (folder / "robot.xml").write_text(robot.format(0.0))
    model = mujoco.MjModel.from_xml_string(robot.format(0.4))
    rng, text = np.random.default_rng(1), ['name = "recording"', STATED]
    names = ("shoulder", "input", "_cmd"), ("shoulder", "output", "")
    text += [f'[channels.{n}{tail}]\nrole = "{role}"\nunit = "rad"' for n, role, tail in names]
    for k, split in enumerate(("fit", "validation", "report")):
        data, rows = mujoco.MjData(model), ["t,shoulder_cmd,shoulder"]
        tones, phases = rng.uniform(0.1, 0.35, 4), rng.uniform(0, 6, 4)

        def goal(t, a=tones, p=phases):
            return float(np.sum(a * np.sin(np.array([0.8, 1.9, 3.1, 5.2]) * t + p))) * min(1, t)

        for i in range(1200):
            target = goal(i / 200)
            rows.append(
                f"{i / 200:.3f},{target:.6f},{data.qpos[0] + 1e-4 * rng.standard_normal():.6f}"
            )
            for _ in range(5):
                data.qfrc_applied[0] = 20.0 * (target - data.qpos[0]) - 1.5 * data.qvel[0]
                mujoco.mj_step(model, data)
        (folder / f"run_{k}.csv").write_text("\n".join(rows))
        text.append(f'[[experiments]]\nfile = "run_{k}.csv"\nsplit = "{split}"\nat_rest = true')
    (folder / "dataset.toml").write_text("\n".join(text))
    return mujoco


@pytest.mark.slow
def test_the_road_of_a_robot_runs_as_it_is_typed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    mujoco = one_hinge(Path("recording"))
    typed(ROBOT)
    fixed = mujoco.MjModel.from_xml_path("fixed/robot.xml")
    assert fixed.dof_frictionloss[0] == pytest.approx(0.4, abs=0.05)
    assert "The model lacks coulomb_friction at shoulder" in capsys.readouterr().out


@pytest.mark.slow
def test_a_law_that_does_not_say_which_rate_it_brakes_is_asked(tmp_path):
    """Without the line of the README kd would be taken to act on the goal's rate too, which looks
    like a delay.
    """
    one_hinge(tmp_path / "recording")
    toml = tmp_path / "recording" / "dataset.toml"
    toml.write_text(
        "\n".join(
            line
            for line in toml.read_text().splitlines()
            if not line.startswith(("sample_time", "     "))
        )
    )
    checked = jaxid.check(None, jaxid.load_dataset(tmp_path / "recording"))
    (law,) = [f for f in checked.findings if f.kind == "law"]
    assert (
        law.decisive
        and law.applied
        and law.line == 'reference_velocity = "none"'
        and "delay" in law.text
    )
    assert checked.mended is not None and checked.mended.controller is not None
    assert checked.mended.controller.settings["reference_velocity"] == "none"
