"""Models of the user's own that commands, datasets and studies name by their file."""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxid
from jaxid.base.errors import DatasetError, UsageError
from jaxid.cli.app import main
from jaxid.dynamics.model_file import own_model, sha256_of
from jaxid.study.check import check_study
from jaxid.study.plan import fingerprint, read_study
from jaxid.study.work import Workshop


HEAD = """
from typing import ClassVar
from jaxtyping import Array
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import param
"""
CART = """
class {name}(Rigid):
    "mass qdd + damping qd + stiffness q = force."

    name: ClassVar[str] = "{id}"
    signatures: ClassVar = (Signature((("force", "N"),), (("position", "m"),), ("position",), linear=True),)
    builtin: ClassVar = ()
    equations: ClassVar[str] = "mass qdd + damping qd + stiffness q = force"
    source: ClassVar[str] = "textbook"

    mass: Array = param(1.0, 1e-2, 1e2, unit="kg")
    damping: Array = param(0.1, 0.0, 10.0, unit="N s/m")
    stiffness: Array = param(5.0, 0.0, 1e3, unit="N/m")

    def matrices(self, q, qd):
        return self.mass[None, None], self.damping * qd + self.stiffness * q
"""
ONE = HEAD + CART.format(name="OwnCart", id="own_cart")
TWO = ONE + CART.format(name="OtherCart", id="other_cart")
DESCRIPTION = """name = "cart"
[channels.force]
role = "input"
unit = "N"
[channels.position]
role = "output"
unit = "m"
noise_std = 1e-4
[[experiments]]
file = "run.csv"
at_rest = true
"""


def write_dataset(folder: Path, model: str = "") -> Path:
    """A cart of 2 kg on a spring of 8 N/m, damped by 0.5 N s/m, by semi-implicit steps of 1 ms."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(0)
    rows, q, qd = [], 0.0, 0.0
    for k in range(120):
        force = 3.0 * np.sin(0.15 * k) + 2.0 * np.sin(0.4 * k)
        rows.append((0.05 * k, force, q + 1e-4 * rng.standard_normal()))
        for _ in range(50):
            qd += 1e-3 * (force - 0.5 * qd - 8.0 * q) / 2.0
            q += 1e-3 * qd
    np.savetxt(folder / "run.csv", rows, delimiter=",", header="t,force,position", comments="")
    (folder / "dataset.toml").write_text(DESCRIPTION + model)
    return folder


@pytest.mark.parametrize(
    "text, said",
    [
        ("x = 1\n", ("holds no model", "Rigid")),
        ("class Plain:\n    pass\n", ("Plain is none", "Rigid")),
        (TWO, ("several models, OwnCart, OtherCart", "m.py:OwnCart")),
        (HEAD + "def broken(:\n", ("line 6", "Correct the file")),
        ("import no_such_module_here\n", ("line 1", "'no_such_module_here'", "installed")),
        ("x = 1\n1 / 0\n", ("line 2", "ZeroDivisionError")),
        ("raise SystemExit(0)\n", ("line 1", "ends Python")),
        (
            HEAD + CART.format(name="Pendulum", id="pendulum"),
            ("'pendulum' of a model of jaxid", "another `name`"),
        ),
        (
            ONE.replace(
                '    equations: ClassVar[str] = "mass qdd + damping qd + stiffness q = force"\n', ""
            ),
            ("`equations`",),
        ),
        (
            ONE + "    def __init__(self, mass):\n        self.mass = mass\n",
            ("OwnCart()", "start value"),
        ),
        (ONE.replace("def matrices", "def matrix"), ("OwnCart", "`matrices`")),
        (b"\x00\x01", ("m.py",)),
    ],
)
def test_a_file_that_is_no_model_is_refused_with_what_to_do(tmp_path, text, said):
    content = text if isinstance(text, bytes) else text.encode()
    (tmp_path / "m.py").write_bytes(content)
    known = set(sys.modules)
    with pytest.raises(UsageError) as error:
        own_model(str(tmp_path / "m.py"))
    assert [word for word in said if word not in str(error.value)] == []
    left = {name for name in set(sys.modules) - known if name.startswith("jaxid_model_")}
    assert len(left) <= 1, "a file that cannot be run leaves no module"


def test_a_class_is_named_behind_the_file(tmp_path):
    file = tmp_path / "m.py"
    file.write_text(TWO + "class Plain:\n    pass\n")
    other = own_model(f"{file}:OtherCart")
    assert other.__name__ == "OtherCart"
    assert own_model(f"{file}:other_cart") is other, (
        "by the model's own name, and one class in a process"
    )
    assert sha256_of(other()) == hashlib.sha256(file.read_bytes()).hexdigest()
    with pytest.raises(UsageError, match="no class 'OtherCar'.*did you mean 'OtherCart'"):
        own_model(f"{file}:OtherCar")
    with pytest.raises(UsageError, match="Plain in m.py is not a model"):
        own_model(f"{file}:Plain")


def test_a_changed_file_is_another_model(tmp_path):
    file = tmp_path / "m.py"
    file.write_text(ONE)
    before = own_model(str(file))
    file.write_text(ONE.replace("param(5.0", "param(7.0"))
    after = own_model(str(file))
    assert float(before().stiffness) == 5.0  # pyright: ignore[reportAttributeAccessIssue]
    assert float(after().stiffness) == 7.0  # pyright: ignore[reportAttributeAccessIssue]


def test_a_dataset_names_a_file_of_its_folder(tmp_path):
    folder = write_dataset(tmp_path / "data", '[model]\nfile = "m.py"\nname = "OwnCart"\n')
    (folder / "m.py").write_text(TWO)
    data = jaxid.load_dataset(folder)
    assert data.model is not None and data.model.name == "own_cart"
    assert any("runs as code" in note for note in data.notes)
    assert fingerprint(folder)[0] == data.sha256, "a study knows the dataset before it is loaded"
    (folder / "m.py").write_text(TWO + "\n")
    assert jaxid.load_dataset(folder).sha256 != data.sha256
    saved = jaxid.save_dataset(data, tmp_path / "saved", format="csv")
    assert jaxid.load_dataset(saved).model == data.model


def test_a_file_of_another_folder_is_not_run(tmp_path):
    folder = write_dataset(tmp_path / "data", '[model]\nfile = "../m.py"\n')
    (tmp_path / "m.py").write_text("raise AssertionError('was run')\n")
    with pytest.raises(DatasetError, match="lies outside the folder"):
        jaxid.load_dataset(folder)
    (folder / "m.py").symlink_to(tmp_path / "m.py")
    (folder / "dataset.toml").write_text(DESCRIPTION + '[model]\nfile = "m.py"\n')
    with pytest.raises(DatasetError, match="lies outside the folder"):
        jaxid.load_dataset(folder)


def test_a_dataset_is_read_without_running_its_model(tmp_path):
    folder = write_dataset(tmp_path / "data", '[model]\nfile = "m.py"\n')
    (folder / "m.py").write_text("raise RuntimeError('was run')\n")
    assert jaxid.load_dataset(folder, check_model=False).sha256 == fingerprint(folder)[0]
    with pytest.raises(DatasetError, match=r"dataset.toml.*RuntimeError: was run"):
        jaxid.load_dataset(folder)


def test_names_of_the_dataset_are_looked_for_in_the_file(tmp_path):
    folder = write_dataset(
        tmp_path / "data", '[model]\nfile = "m.py"\nconstants = { stifness = 8.0 }\n'
    )
    (folder / "m.py").write_text(ONE)
    with pytest.raises(DatasetError, match="no constant or parameter 'stifness'.*'stiffness'"):
        jaxid.load_dataset(folder)
    (folder / "m.py").write_text(TWO)
    with pytest.raises(DatasetError, match='several models.*Write `name = "CLASS"` beside `file`'):
        jaxid.load_dataset(folder)


def test_commands_take_a_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_dataset(Path("data"))
    Path("m.py").write_text(TWO)
    digest = hashlib.sha256(Path("m.py").read_bytes()).hexdigest()
    assert main(["models", "m.py:OwnCart", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["name"] == "own_cart"
    assert main(["fit", "data", "--model", "m.py", "--out", "f", "--quiet"]) == 2
    assert "several models" in capsys.readouterr().err
    assert (
        main(
            [
                "fit",
                "data",
                "--model",
                "m.py:OwnCart",
                "--residual",
                "inverse_dynamics",
                "--out",
                "f",
                "--quiet",
            ]
        )
        == 0
    )
    fit = json.loads(Path("f/fit.json").read_text())
    assert fit["model"] == "own_cart" and fit["model_sha256"] == digest
    assert fit["parameters"]["mass"]["value"] == pytest.approx(2.0, rel=0.3)
    assert main(["simulate", "data", "--parameters", "f/fit.json", "--out", "s", "--quiet"]) == 2
    assert "named by its file" in capsys.readouterr().err
    assert main(["identify", "data", "--model", "m.py:OwnCart", "--out", "i", "--quiet"]) == 2
    assert "own_cart" in capsys.readouterr().err


def test_a_study_names_files(tmp_path):
    write_dataset(tmp_path / "data")
    study = tmp_path / "study.toml"
    study.write_text(
        'name = "s"\nstore = "store"\n[[runs]]\ncommand = "fit"\ndatasets = ["data"]\n'
        'models = ["m.py:OwnCart", "m.py:OtherCart"]\n'
    )
    (tmp_path / "m.py").write_text(TWO)
    tasks = list(check_study(study).tasks.values())
    assert [t.system for t in tasks] == ["OwnCart", "OtherCart"]
    assert tasks[0].model == f"{tmp_path.resolve()}/m.py:OwnCart", (
        "the same file wherever a worker is started"
    )
    (tmp_path / "m.py").write_text(TWO + "\n")
    again = list(read_study(study).tasks.values())
    assert len({t.key for t in (*tasks, *again)}) == 4, "what changed runs anew"
    task = tasks[0].settings | {"key": tasks[0].key, "group": tasks[0].group}
    with pytest.raises(UsageError, match="not the file that the study began with"):
        list(Workshop().work([task]))
