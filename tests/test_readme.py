"""The README's code runs as it stands there."""

import re
import shutil
from pathlib import Path

import numpy as np

import jaxid
from jaxid.wording import percent


ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
OWN_MODEL, FROM_PYTHON = re.findall(r"```python\n(.*?)```", README, re.S)
EXTENDING = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "extending.md").read_text(), re.S)
OWN_EFFECT = next(block for block in EXTENDING if "JointEffect" in block)
(ANSWER,) = re.findall(r"```text\n(.*?)```", README, re.S)
#: A number, and how near one that another machine computed has to be.
NUMBER, NEAR = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?"), 0.05


def test_it_is_short():
    assert len(README.splitlines()) <= 160


def told_alike(lines: str, told: str) -> None:
    """The same words, and numbers that differ by no more than computers do."""
    words = lambda s: re.sub(r"\s+", " ", NUMBER.sub("#", s)).strip()
    assert words(lines) in words(told)
    numbers = lambda s: [float(x) for x in NUMBER.findall(s)]
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
    kept = [line for line in told.splitlines() if "rms error" not in line]  # a line for each channel
    told_alike(ANSWER, "\n".join(kept))
    assert (tmp_path / "report.html").stat().st_size > 10_000
    the_picture_shows(made["diagnosis"])


def the_picture_shows(diagnosis: jaxid.Diagnosis) -> None:
    """The README's first picture is of these numbers; docs/make_picture.py makes it anew."""
    picture = (ROOT / "docs" / "_static" / "gap.svg").read_text()
    words = re.findall(r"<text[^>]*>([^<]*)</text>", picture)
    labels = [float(w) for w in words if re.fullmatch(r"[\d.]+(e[+-]?\d+)?", w)]
    far = diagnosis.how_far
    for gap in (far.gap_before, far.gap_retuned, far.gap_after):
        assert any(abs(label / gap - 1) < 0.02 for label in labels), f"{gap:.4g} is not in the picture: make it anew"
    assert f"{percent(far.shrinkage)} of the gap closed" in words


def test_the_recipes_for_a_model_and_an_effect_fit():
    made: dict = {}
    for block in (OWN_MODEL, OWN_EFFECT):
        exec(block, made)
    t = np.arange(600) / 100
    rng = np.random.default_rng(0)
    u = 4 * np.sin(2 * np.pi * 0.5 * t) + 2 * np.sin(2 * np.pi * 1.3 * t)
    # mass 2, stiffness 40, viscous 1.5: exact by the matrix exponential of the held input
    from scipy.linalg import expm

    step = expm(np.array([[0, 1, 0], [-20, -0.75, 0.5], [0, 0, 0]]) * 0.01)
    x, q = np.zeros(2), []
    for force in u:
        q.append(x[0])
        x = (step @ np.append(x, force))[:2]
    data = jaxid.Dataset.from_arrays(
        t, {"force": u}, {"position": np.array(q) + 1e-5 * rng.standard_normal(600)},
        units={"force": "N", "position": "m"}, at_rest=True, noise_std={"position": 1e-5},
    )  # fmt: skip
    fit = jaxid.fit(made["SpringCart"](), data, without=["coulomb_friction"])
    for name, truth in {"mass": 2.0, "stiffness": 40.0, "viscous": 1.5}.items():
        found = fit.parameters[name]
        assert found.std is not None and abs(found.value - truth) < 4 * found.std + 1e-4 * truth
    from jaxid.dynamics.chain import Chain
    from jaxid.dynamics.parameter_vector import Layout

    joint = Chain(jaxid.models.Joint()).with_effects(made["SpringTorque"]())
    assert "spring_torque.stiffness@q" in Layout(joint).names
