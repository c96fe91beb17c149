"""Study and dataset files that were damaged or written to do harm: clear errors, no script, no
formula, no escape sequence.
"""

from __future__ import annotations

import ast
import csv
import io
import random
import re
import time
from pathlib import Path

import pytest

import jaxid
from jaxid.base import wording
from jaxid.cli import app as cli, terminal
from jaxid.study import check_study, run_study, study_status
from jaxid.study.outcome import Outcome
from jaxid.study.tables import cell, csv_text, FORMULA, table_rows
from jaxid.study.words import progress_text, result_text, status_text
from test_batch import quoted, SOLVE, table, write_dataset, write_study
from test_report import assert_harmless


ROOT = Path(__file__).parents[1]

#: For every text a person can write into a study or a dataset.
NAMES = (
    "<script>alert(1)</script>", "<img src=x onerror=alert(1)>", "\"><svg onload=alert(1)>", "' onmouseover='alert(1)",
    "</style><script>alert(1)</script>", "</title><script>x</script>", "<a href=javascript:alert(1)>x</a>", "&lt;script&gt;",
    "<iframe src=//evil>", "<!--", "-->", "]]><script>x</script>", "{{7*7}}", "{% for x in y %}", "{{ ''.__class__ }}",
    "=1+1", "+1+1", "-1+1", "@SUM(A1)", "=HYPERLINK(\"http://evil\")", "=cmd|'/c calc'!A0", " =1+1", "'=1+1", "\u00a0=1+1",
    "a,b\"c", "$\\frac{1$", "\\alpha_{", "%s%n%x", "\x9b31m",
    "../../etc/passwd", "/dev/null", "CON", "a" * 5000, "\u202eevil", "e\u0301\u200b",
    "\U0001f4a9", "\u2028line", "\ufeffbom", "null", "DROP TABLE results; --", "'; DELETE FROM results; --",
)  # fmt: skip
#: These hold control characters, which a name may not; a description or a reason may.
CONTROL = ("\x1b]0;owned\x07", "\x1b[2J", "a\nb", "a\r=1+1", "\t=1+1", "\x00", "\x08\x08")


def visible(text: str) -> bool:
    return not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", text)


def harmless_cell(value: str) -> bool:
    return (
        not value.startswith(FORMULA[:-1])
        and visible(value)
        and not value.strip().startswith(FORMULA[:-1])
    )


@pytest.mark.slow
def test_forty_names_in_every_field(tmp_path, capsys):
    """Study, description, dataset and path; effects, models and fitters of such names are refused
    by name.
    """
    assert len(NAMES) >= 40
    for k, name in enumerate(NAMES):
        home = tmp_path / str(k)
        write_dataset(home / "small", name, samples=30)
        study = write_study(home, "seeds = 2", name=name)
        study.write_text(
            study.read_text().replace("[[runs]]", f"description = {quoted(name)}\n[[runs]]")
        )
        result = run_study(study, workers=1, solver=SOLVE, check=False) if k == 0 else None
        if result is None:  # the same outcomes without the processes
            read = study_status(study)[0]
            outcomes = {
                t: Outcome(
                    t,
                    "failed",
                    f"{name} {CONTROL[k % len(CONTROL)]}",
                    log=f"{name}\n{CONTROL[k % len(CONTROL)]}",
                )
                for t in read.tasks
            }
            result = type(FIRST["result"])(read, outcomes, True, notes=(name,))
        FIRST.setdefault("result", result)
        from jaxid.study.page import write_study as write_page

        page = assert_harmless(write_page(result, home / "page.html").read_text(encoding="utf-8"))
        assert (
            name != "{{7*7}}" or name in page.text
        )  # as it was written; "49" alone may be part of a time or a hash
        rows = list(csv.reader(io.StringIO(csv_text(*table_rows(result)), newline="")))
        assert len(rows) == 3 and all(harmless_cell(c) for c in rows[1][:4]), rows[1]
        for text in (
            result_text(result),
            status_text(result.study, result.outcomes, result.status),
        ):
            terminal.say(text)
            assert visible(capsys.readouterr().out)
        if k % 4:  # every page and table, and the command for some
            continue
        bad = write_study(
            home,
            f"effects = [[{quoted(name)}]]",
            f"models = [{quoted(name)}]",
            f"fitters = [{quoted(name)}]",
        )
        assert cli.main(["batch", str(bad)]) == 2
        told = capsys.readouterr()
        assert (
            visible(told.err)
            and "there is no model" in told.err
            and "there is no effect" in told.err
            and not told.out
        )


FIRST: dict = {}


@pytest.mark.parametrize("name", CONTROL)
def test_control_characters(tmp_path, capsys, name):
    write_dataset(tmp_path / "small", samples=30)
    study = write_study(tmp_path, "seeds = 2", name=name)
    assert cli.main(["batch", str(study)]) == 2
    told = capsys.readouterr().err
    assert visible(told) and "holds control characters" in told
    assert visible(cell(name)) and harmless_cell(cell(name))


def test_csv_holds_no_formula_and_the_same_numbers(tmp_path):
    write_dataset(tmp_path / "small", '=HYPERLINK("http://evil")')
    study = write_study(tmp_path, "seeds = 5")
    run_study(study, workers=1, solver=SOLVE, check=False)
    with open(tmp_path / "out" / "runs.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(r["dataset"] == '\'=HYPERLINK("http://evil")' for r in rows)
    assert [float(r["viscous"]) for r in rows] == [r["viscous"] for r in table(tmp_path / "out")]


def mutated(text: bytes, rng: random.Random) -> bytes:
    """A text with some of its bytes, words or lines changed."""
    content = bytearray(text)
    words = (
        b"[",
        b"]]",
        b"=",
        b'"',
        b"'",
        b"1e999",
        b"-1",
        b"nan",
        b"9" * 400,
        b"\x00",
        b"\xff",
        b"[[runs]]",
        b"\n",
        b"{",
        b"../",
        b"true",
    )
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(content) + 1)
        kind = rng.randrange(6)
        if kind == 0 and content:
            content[min(at, len(content) - 1)] = (
                rng.choice(b"0123456789-.=[]abc'_ ") if rng.random() < 0.8 else rng.randrange(256)
            )
        elif kind == 1:
            content[at:at] = rng.choice(words)
        elif kind == 2:
            del content[at : at + rng.choice((1, 2, 5, 30))]
        elif kind == 3 and rng.random() < 0.2:
            lines = content.split(b"\n")
            rng.shuffle(lines)
            content = bytearray(b"\n".join(lines))
        elif kind == 4:
            lines = content.split(b"\n")
            lines.insert(rng.randrange(len(lines)), rng.choice(lines))
            content = bytearray(b"\n".join(lines))
        else:
            digits = [k for k, c in enumerate(content) if 48 <= c < 58]
            if digits:
                content[rng.choice(digits)] = rng.choice(b"0123456789")
    return bytes(content)


def survives(
    folder: Path, files: tuple[Path, ...], rng: random.Random, count: int, limit_s: float
) -> dict[str, int]:
    """Mutates one of the files `count` times; the study is either read or refused with a clear
    error.
    """
    study, ends = folder / "study.toml", {"read": 0, "refused": 0}
    for _ in range(count):
        path = rng.choice(files)
        clean = path.read_bytes()
        path.write_bytes(mutated(clean, rng))
        began = time.monotonic()
        try:
            check_study(study)
            ends["read"] += 1
        except (jaxid.UsageError, jaxid.DatasetError) as error:
            assert str(error).strip() and len(str(error)) < 100_000
            ends["refused"] += 1
        finally:
            path.write_bytes(clean)
        assert time.monotonic() - began < limit_s
    return ends


def rich_study(folder: Path) -> tuple[Path, ...]:
    """A study that uses most keys, and its files."""
    write_dataset(folder / "small", samples=40)
    study = write_study(
        folder,
        "models = ['joint']",
        "effects = [[], ['dead_zone@tau']]",
        "fitters = ['lm', 'de']",
        "seeds = 2",
        "budget = 100",
        "timeout_s = 60.5",
        "residual = 'output_error'",
        "loss = 'sum_of_squares'",
        "[[runs]]",
        "command = 'diagnose'",
        "datasets = ['small']",
        "effects = [['backlash', 'dead_zone']]",
        "max_effects = 2",
    )
    check_study(study)
    return study, folder / "small" / "dataset.toml", folder / "small" / "run.csv"


def test_names_that_no_disk_can_hold(tmp_path):
    write_dataset(tmp_path / "small", samples=40)
    study = write_study(tmp_path, store="x" * 400)
    with pytest.raises(
        jaxid.UsageError, match=r"row \d+.*cannot be a folder \(File name too long\)"
    ):
        check_study(study)


def test_mutated_files(tmp_path):
    files = rich_study(tmp_path)
    ends = survives(tmp_path, files, random.Random(5), 300, 5.0)
    assert ends["refused"] > 100 and ends["read"] > 10, ends


def test_status_of_mutated_studies(tmp_path, capsys):
    """The light reader alone."""
    study, rng = rich_study(tmp_path)[0], random.Random(6)
    clean = study.read_bytes()
    for _ in range(100):
        study.write_bytes(mutated(clean, rng))
        assert cli.main(["batch", str(study), "--status"]) in (0, 2)
        told = capsys.readouterr()
        assert visible(told.out + told.err)


def test_nothing_in_the_package_runs_what_it_reads():
    """No pickle, eval, exec, YAML or shell in the package; arrays are read without pickles. Files
    of PyTorch are pickles: the one module that reads them knows tensors alone (its own tests hold
    it to that). A model of one's own is code: one module runs it.
    """
    tensors = ROOT / "jaxid/data/importers/torch.py"
    own_models = ROOT / "jaxid/dynamics/model_file.py"
    for top in ("jaxid", "models", "fitters"):
        for path in (ROOT / top).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import | ast.ImportFrom):
                    names = {
                        getattr(node, "module", "") or "",
                        *(alias.name for alias in node.names),
                    }
                    assert path == tensors or not names & {
                        "pickle",
                        "cPickle",
                        "dill",
                        "cloudpickle",
                        "marshal",
                        "shelve",
                        "yaml",
                    }, path
                if isinstance(node, ast.Call):
                    called = node.func.id if isinstance(node.func, ast.Name) else ""
                    assert path == own_models or called not in ("eval", "exec", "compile"), path
                    for keyword in node.keywords:
                        value = getattr(keyword.value, "value", None)
                        assert (keyword.arg, value) not in (
                            ("shell", True),
                            ("allow_pickle", True),
                        ), path


def test_progress_names_no_escape(tmp_path):
    write_dataset(tmp_path / "small", "\u202e evil", samples=30)
    study, outcomes, _ = study_status(write_study(tmp_path, "seeds = 2"))
    from jaxid.study.run import StudyProgress

    assert visible(wording.clean(progress_text(StudyProgress(study, outcomes, 2, 10.0, 1))))
