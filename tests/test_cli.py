"""The command line: what it writes, prints and returns. The work behind it is replaced by sample
results.
"""

from __future__ import annotations

import json
import os
import re
import resource
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import jaxid
import jaxid.api  # it takes its names before some of them are replaced here
from jaxid.base import wording
from jaxid.base.errors import DatasetWarning
from jaxid.base.serialise import finite, json_bytes
from jaxid.base.stopping import Interrupted
from jaxid.cli import app as cli, terminal
from jaxid.data.dataset import Dataset
from jaxid.dynamics import catalogue
from report_sample import hostile, sample_diagnosis, sample_fit, sample_simulation


ROOT = Path(__file__).parents[1]
COMMANDS = ("fit", "diagnose", "simulate", "import", "models", "effects", "fitters")


@pytest.fixture
def calls(monkeypatch):
    """Replaces the package's functions by ones that note their arguments and return samples."""
    seen = {}

    def answer(name, result):
        def function(*args, **kwargs):
            seen[name] = (args, kwargs)
            return result

        monkeypatch.setattr(jaxid, name, function, raising=False)

    for where in ("jaxid.problem.binding", "jaxid.diagnosis.foreseen"):  # the dataset is none
        monkeypatch.setattr(f"{where}.foreseen", lambda *_: SimpleNamespace(large=False))
    answer("load_dataset", "the dataset")
    answer("fit", sample_fit(samples=200))
    answer("diagnose", sample_diagnosis(200))
    answer("simulate", sample_simulation())
    return seen


def run(*arguments: object) -> int:
    return cli.main([str(a) for a in arguments])


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True)


def test_every_residual_is_known_by_its_name():
    """In a process that has imported nothing but the verbs."""
    code = (
        "import jaxid.api as a; from jaxid.dynamics.catalogue import RESIDUALS;"
        " print([a.resolve_residual(n).name for n in RESIDUALS])"
    )
    assert python("-c", code).stdout.strip() == str(list(catalogue.RESIDUALS))


def test_help_is_light():
    code = (
        "import sys; from jaxid.cli.app import main; code = main(['--help'])\n"
        "print([m for m in ('jax', 'numpy', 'scipy', 'matplotlib') if m in sys.modules], code)"
    )
    result = python("-c", code)
    assert result.stdout.strip().endswith("[] 0")
    for name in COMMANDS:
        assert f"  {name} " in result.stdout


@pytest.mark.realtime  # alone: a busy core counts more of its own time, too
def test_help_is_quick():
    def seconds() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert python("-m", "jaxid.cli", "--help").returncode == 0
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    assert any(
        seconds() <= 0.2 for _ in range(12)
    )  # its own time, in the best of a busy machine's moments


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_json_and_quiet(name, capsys):
    assert run(name, "--help") == 0
    out = capsys.readouterr().out
    assert "--json" in out and "--quiet" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["diagnos"], "diagnose"),
        (["fit", "data", "--out", "x", "--efects", "a"], "--effect"),
        (["fit", "data"], "--out"),
        (["fit", "data", "--out", "x", "--seed", "minus"], "--seed"),
        (["fit", "data", "--out", "x", "--budget", "0"], "--budget"),
        (["fit", "data", "--out", "x", "--residual", "output"], "output_error"),
        (["diagnose", "data", "--out", "x", "--max-effects", "-1"], "--max-effects"),
        (["models", "pendulun"], "pendulum"),
        (["effects", "stribeck"], "stribeck_friction"),
        (["import", "emsp", "a.mat", "--out", "x"], "emps"),
    ],
)
def test_wrong_words_name_the_nearest(arguments, words, capsys):
    assert run(*arguments) == 2
    captured = capsys.readouterr()
    assert words in captured.err and captured.out == ""
    assert "Traceback" not in captured.err


def test_fit(calls, tmp_path, capsys):
    arguments = "--model joint --fitter lm --effect dead_zone@tau --effect input_delay --without coulomb_friction,x"
    arguments += " --residual output_error --loss sum_of_norms --seed 3 --budget 50"
    assert run("fit", "data", "--out", tmp_path / "a" / "b", *arguments.split()) == 0
    args, kwargs = calls["fit"]
    assert args == ("joint", "the dataset")
    kwargs.pop("progress")
    assert kwargs == {
        "fitter": "lm",
        "solver": None,
        "residual": "output_error",
        "loss": "sum_of_norms",
        "effects": ("dead_zone@tau", "input_delay"),
        "without": ("coulomb_friction", "x"),
        "seed": 3,
        "budget": 50,
        "cutoff_hz": None,
        "window": None,
        "forgetting": None,
        "posterior": False,
        "block_s": None,
        "as_recorded": False,
    }
    assert sorted(p.name for p in (tmp_path / "a" / "b").iterdir()) == ["fit.json", "report.html"]
    out = capsys.readouterr().out
    assert "0.08123 ± 0.00042" in out and "kg m^2" in out and "at its bound" in out


def test_diagnose(calls, tmp_path, capsys):
    assert (
        run(
            "diagnose",
            "data",
            "--out",
            tmp_path,
            "--effects",
            "dead_zone, input_delay",
            "--max-effects",
            "2",
        )
        == 0
    )
    args, kwargs = calls["diagnose"]
    kwargs.pop("progress")
    assert args == (None, "the dataset")
    assert kwargs == {
        "max_effects": 2,
        "effects": ("dead_zone", "input_delay"),
        "without": (),
        "residual": None,
        "cutoff_hz": None,
        "reference": None,
        "seed": 0,
        "as_recorded": False,
        "seconds": None,
        "accuracy": None,
    }
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    assert content["kind"] == "diagnosis" and content["schema"] == 1
    assert (tmp_path / "report.html").is_file()
    out = capsys.readouterr().out
    assert 6 <= len(out.splitlines()) <= 16
    for words in (
        "WHERE",
        "WHICH",
        "coulomb_friction at q (level 0.1123 ± 0.0016 N m)",
        "99.8 %",
        "stribeck",
        "NEXT",
    ):
        assert words in out


def test_simulate(calls, tmp_path, capsys):
    import pyarrow.parquet

    (tmp_path / "p.json").write_text('{"parameters": {"inertia": {"value": 0.08}}, "effects": []}')
    assert (
        run("simulate", "data", "--parameters", tmp_path / "p.json", "--out", tmp_path / "out") == 0
    )
    args, kwargs = calls["simulate"]
    assert args == (
        None,
        "the dataset",
        {"parameters": {"inertia": {"value": 0.08}}, "effects": []},
    )
    assert kwargs == {"solver": None}
    names = ["run_1.parquet", "run_2.parquet", "simulation.json"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == names
    table = pyarrow.parquet.read_table(tmp_path / "out" / "run_2.parquet")
    assert table.column_names == ["t", "q"]
    assert np.allclose(table["q"].to_numpy(), np.cos(np.linspace(0, 1, 11)))
    assert "0.00200 rad" in capsys.readouterr().out


def test_a_diagnosis_is_simulated_with_what_it_names(calls, tmp_path):
    named = sample_diagnosis(200)
    assert named.which.effects
    (tmp_path / "d.json").write_bytes(json_bytes(named))
    assert (
        run("simulate", "data", "--parameters", tmp_path / "d.json", "--out", tmp_path / "out") == 0
    )
    assert [e["effect"] for e in calls["simulate"][0][2]["effects"]] == [
        e.effect for e in named.which.effects
    ]


@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_json_is_all_there_is(calls, command, tmp_path, capsys):
    assert run(command, "data", "--out", tmp_path, "--json") == 0
    captured = capsys.readouterr()
    expected = {"fit": sample_fit(samples=200), "diagnose": sample_diagnosis(200)}[command]
    assert json.loads(captured.out) == finite(expected.to_dict())
    assert captured.err == ""


@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_quiet_prints_nothing(calls, command, tmp_path, capsys):
    assert run(command, "data", "--out", tmp_path, "--quiet") == 0
    assert capsys.readouterr() == ("", "")


def test_json_holds_no_nan(calls, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(
        jaxid, "fit", lambda *a, **k: replace(sample_fit(samples=200), loss=float("nan"))
    )
    assert run("fit", "data", "--out", tmp_path, "--json") == 0
    assert json.loads(capsys.readouterr().out)["loss"] is None


def test_failed_fit_is_saved_and_exits_1(calls, monkeypatch, tmp_path, capsys):
    failed = replace(
        sample_fit(samples=200),
        failed=True,
        converged=False,
        stopped_because="every start diverged",
    )
    monkeypatch.setattr(jaxid, "fit", lambda *a, **k: failed)
    assert run("fit", "data", "--out", tmp_path) == 1
    assert (tmp_path / "fit.json").is_file()
    assert "every start diverged" in capsys.readouterr().err


def test_a_warning_on_the_users_file_is_a_sentence_said_once(calls, monkeypatch, tmp_path, capsys):
    def warns(*args, **kwargs):
        for level in (1, 2, 3):  # from three of our lines
            warnings.warn(
                "arm.urdf: link 'a' has principal moments that no body can have",
                DatasetWarning,
                stacklevel=level,
            )
        return sample_fit(samples=200)

    monkeypatch.setattr(jaxid, "fit", warns)
    assert run("fit", "data", "--out", tmp_path) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "no body can have" in line]
    assert said == ["jaxid: arm.urdf: link 'a' has principal moments that no body can have"]


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (jaxid.UsageError("there is no effect 'x'"), 2, "there is no effect 'x'"),
        (jaxid.DatasetError([]), 2, ""),
        (
            PermissionError(13, "Permission denied", "data/a.csv"),
            2,
            "data/a.csv: Permission denied",
        ),
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError(), 1, "memory"),
        (TypeError("deep inside"), 1, "internal error, TypeError: deep inside"),
    ],
)
def test_errors_have_a_sentence_and_no_traceback(
    calls, monkeypatch, tmp_path, capsys, error, code, words
):
    def broken(*args, **kwargs):
        raise error

    monkeypatch.setattr(jaxid, "diagnose", broken)
    assert run("diagnose", "data", "--out", tmp_path, "--json") == code
    captured = capsys.readouterr()
    assert captured.out == "" and words in captured.err and "Traceback" not in captured.err


def test_interrupt_saves_what_was_finished(calls, monkeypatch, tmp_path, capsys):
    def interrupted(*args, **kwargs):
        raise Interrupted(sample_fit(samples=200))

    monkeypatch.setattr(jaxid, "diagnose", interrupted)
    assert run("diagnose", "data", "--out", tmp_path) == 130
    assert json.loads((tmp_path / "partial" / "fit.json").read_text())["kind"] == "fit"
    assert (tmp_path / "partial" / "report.html").is_file() and not (tmp_path / "fit.json").exists()
    assert "fit.json" in capsys.readouterr().err


def test_out_that_is_a_file(calls, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        assert run("fit", "data", "--out", out) == 2
        assert "cannot write there" in capsys.readouterr().err
    assert "fit" not in calls  # found before the work, not after


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_out_that_is_read_only(calls, tmp_path, capsys):
    tmp_path.chmod(0o500)
    assert run("fit", "data", "--out", tmp_path) == 2
    assert "cannot write there" in capsys.readouterr().err


@pytest.mark.parametrize(
    "content",
    [
        b"{",
        b"",
        b"[]",
        b"3",
        b"{}",
        b'{"parameters": 3}',
        b'{"parameters": {"inertia": 3}}',
        b'{"parameters": {"inertia": {"value": "3"}}}',
        b'{"parameters": {"inertia": {"value": NaN}}}',
        b'{"parameters": {"inertia": {"value": 1e999}}}',
        b'{"parameters": {"inertia": {"value": true}}}',
        b'{"parameters": {}, "effects": {}}',
        b'{"parameters": {}, "effects": ["dead_zone"]}',
        b'{"parameters": {}, "effects": [{"effect": "dead_zone", "parameters": {"width": {}}}]}',
        b"\xff\xfe\x00",
        b"[" * 100000,
        b'{"parameters": {"inertia": {"value": ' + b"9" * 5000 + b"}}}",
    ],
)
def test_broken_parameters(calls, tmp_path, capsys, content):
    (tmp_path / "p.json").write_bytes(content)
    assert (
        run("simulate", "data", "--parameters", tmp_path / "p.json", "--out", tmp_path / "out") == 2
    )
    captured = capsys.readouterr()
    assert "p.json" in captured.err and "Traceback" not in captured.err and captured.out == ""


@pytest.mark.parametrize("path", ["missing.json", "."])
def test_parameters_that_cannot_be_read(calls, tmp_path, capsys, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    assert run("simulate", "data", "--parameters", path, "--out", "out") == 2
    assert "cannot be read" in capsys.readouterr().err


def test_missing_dataset(tmp_path, capsys):
    assert run("diagnose", tmp_path / "nowhere", "--out", tmp_path / "out") == 2
    assert "nowhere" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_import(monkeypatch, tmp_path, capsys):
    from jaxid.data.importers import emps as importers

    t = np.arange(50) * 1e-3
    data = Dataset.from_arrays(
        [t],
        {"force": [np.sin(t)]},
        {"position": [np.cos(9 * t)]},
        units={"force": "N", "position": "m"},
        name="emps",
    )
    seen = []

    def convert(files, out, *, overwrite=False):
        seen.append((files, overwrite))
        return jaxid.save_dataset(data, out)

    monkeypatch.setattr(importers, "import_emps", convert)
    assert run("import", "emps", "a.mat", "b.mat", "--out", tmp_path / "emps", "--json") == 0
    assert seen == [((Path("a.mat"), Path("b.mat")), False)]
    content = json.loads(capsys.readouterr().out)
    assert (
        content["channels"] == {"force": "N", "position": "m"}
        and content["experiments"][0]["samples"] == 50
    )


def test_help_of_import_names_every_kind():
    from jaxid.cli.importing import import_, KINDS

    words = re.findall(r"\w+", import_.help or "")
    assert set(KINDS) <= set(words)


@pytest.mark.parametrize("kind", ["models", "effects", "fitters"])
def test_lists(kind, capsys):
    assert run(kind) == 0
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines()[1:]]
    assert run(kind, "--json") == 0
    content = json.loads(capsys.readouterr().out)
    assert [entry["name"] for entry in content[kind]] == names
    for name in names:
        assert run(kind, name) == 0
        assert capsys.readouterr().out.startswith(name)
        assert run(kind, name, "--json") == 0
        assert json.loads(capsys.readouterr().out)["name"] == name
    assert run(kind, "--quiet") == 0
    assert capsys.readouterr().out == ""


def test_control_characters_never_reach_the_terminal(calls, monkeypatch, tmp_path, capsys):
    diagnosis = hostile(sample_diagnosis(200))
    monkeypatch.setattr(jaxid, "diagnose", lambda *a, **k: diagnosis)
    monkeypatch.setattr(jaxid, "fit", lambda *a, **k: diagnosis.final)
    assert run("diagnose", "data", "--out", tmp_path) == 0
    assert run("fit", "data", "--out", tmp_path) == 0
    terminal.complain("evil \x1b]0;title\x07 \u202e name")
    captured = capsys.readouterr()
    assert not set("\x1b\x07\u202e") & set(captured.out + captured.err)


def test_a_terminal_gets_a_bar(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert terminal.Progress(quiet=True).callback is None
    with terminal.Progress(quiet=False) as progress:
        assert progress.callback is not None
        for done in range(3):
            progress.callback("refit [bold]x\x1b[31m", done, 2, "dead_zone")
        progress.callback("unknown length", 1, 0, "")
    captured = capsys.readouterr()
    assert captured.out == ""


def test_reader_that_goes_away():
    script = f"{sys.executable} -m jaxid.cli.app effects | head -1"
    result = subprocess.run(["sh", "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert "Traceback" not in result.stderr


def test_tables_line_up():
    assert wording.table(("a", "b"), [("long", "x"), ("s", "y")]) == "a     b\nlong  x\ns     y"


def test_a_pipe_gets_a_line_every_half_minute(capsys, monkeypatch):
    clock = iter([0.0, 10.0, 31.0, 45.0, 62.0])
    monkeypatch.setattr(terminal.time, "monotonic", lambda: next(clock))
    with terminal.Progress(quiet=False) as progress:
        assert progress.callback is not None
        for done in range(4):
            progress.callback("effects", done, 9, "best dead_zone\x1b[2J")
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "jaxid: effects 1 of 9, best dead_zone?[2J (31 s)",
        "jaxid: effects 3 of 9, best dead_zone?[2J (62 s)",
    ]
    assert terminal.Progress(quiet=True).callback is None


@pytest.mark.parametrize("large", [True, False])
def test_long_work_is_foretold_before_it_begins(large, calls, monkeypatch, tmp_path, capsys):
    class Wanted(SimpleNamespace):
        def __str__(self):
            return "diagnose of 9 rows in 1 run: about 0.7 GB and 20 minutes"

    def foreseen(*asked):
        assert "diagnose" not in calls and asked[1] == "the dataset"
        return Wanted(large=large)

    monkeypatch.setattr("jaxid.diagnosis.foreseen.foreseen", foreseen)
    assert run("diagnose", "data", "--out", tmp_path) == 0
    assert ("about 0.7 GB and 20 minutes" in capsys.readouterr().err) is large
