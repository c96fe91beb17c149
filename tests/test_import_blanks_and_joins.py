"""Tables with blank cells, and several files on one clock; and what reading leaves behind."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxid.base.errors import DatasetError, UsageError
from jaxid.cli.app import main
from jaxid.data.importers.lerobot import _leaves
from jaxid.data.io import load_dataset
from jaxid.data.table import read_table
from test_import_tables import PLAIN, Q, run, T, TAU


def table(columns: dict[str, list[str]]) -> str:
    lines = [",".join(columns), *(",".join(cells) for cells in zip(*columns.values(), strict=True))]
    return "\n".join(lines) + "\n"


def cells(values: np.ndarray, blank: np.ndarray | None = None) -> list[str]:
    """Numbers as text, nothing where `blank`."""
    written = [repr(float(v)) for v in values]
    return (
        written if blank is None else ["" if b else w for w, b in zip(written, blank, strict=True)]
    )


@pytest.mark.parametrize("every", [2, 10])
def test_blank_cells_are_no_readings(tmp_path, capsys, every):
    blank = np.arange(len(T)) % every == 1
    (tmp_path / "log.csv").write_text(
        table({"t": cells(T), "q": cells(Q, blank), "tau": cells(TAU)})
    )
    channels = [f"--channel={c}" for c in PLAIN]
    assert (
        main(["import", "csv", str(tmp_path / "log.csv"), *channels, f"--out={tmp_path / 'out'}"])
        == 0
    )
    assert f"{blank.sum()} of 60 cells of q are blank, no reading there" in capsys.readouterr().err
    (e,) = load_dataset(tmp_path / "out", check_model=False).experiments
    np.testing.assert_array_equal(e.read[:, 0], ~blank)
    np.testing.assert_allclose(e.y[~blank, 0], Q[~blank])
    np.testing.assert_allclose(e.u[:, 0], TAU)


def test_a_blank_command_holds_its_last_value(tmp_path):
    blank = np.arange(len(T)) % 7 == 3
    (tmp_path / "log.csv").write_text(
        table({"t": cells(T), "q": cells(Q), "tau": cells(TAU, blank)})
    )
    (e,) = run(tmp_path / "log.csv", tmp_path / "out")[0].experiments
    np.testing.assert_allclose(e.u[:, 0], np.where(blank, np.roll(TAU, 1), TAU))


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (
            {"t": cells(T, np.arange(60) == 7), "q": cells(Q), "tau": cells(TAU)},
            "row 9, column t: missing",
        ),
        (
            {"t": cells(T), "q": cells(Q, np.arange(60) > 9), "tau": cells(TAU)},
            "'q' holds 10 readings in 60 rows",
        ),
        (
            {"t": cells(T), "q": [*cells(Q)[:-1], "inf"], "tau": cells(TAU, np.arange(60) == 3)},
            "column q: infinite",
        ),
        (
            {"t": cells(T), "q": [*cells(Q)[:-1], "off"], "tau": cells(TAU)},
            "column q: not a number: 'off'",
        ),
    ],
)
def test_what_is_no_blank_reading_is_refused(tmp_path, columns, words):
    (tmp_path / "log.csv").write_text(table(columns))
    with pytest.raises(DatasetError, match=words):
        run(tmp_path / "log.csv", tmp_path / "out")


def three_files(folder: Path) -> list[str]:
    for name, values in (("position", Q), ("velocity", np.gradient(Q, T)), ("effort", TAU)):
        (folder / f"{name}.csv").write_text(
            table({"stamp": cells(T), f"lift_{name}": cells(values), "flag": cells(0 * T + 1)})
        )
    paths = [str(folder / f"{name}.csv") for name in ("position", "velocity", "effort")]
    return [
        "import",
        "csv",
        paths[0],
        f"--join={paths[1]}",
        f"--join={paths[2]}",
        f"--out={folder / 'out'}",
    ]


def test_every_joined_file_counts_and_stands_in_the_command(tmp_path, capsys):
    command = three_files(tmp_path)
    channels = ("t=stamp:s", "q=lift_position:rad", "qd=lift_velocity:rad/s", "tau=lift_effort:N m")
    assert main([*command, *(f"--channel={c}" for c in channels)]) == 0
    (e,) = load_dataset(tmp_path / "out", check_model=False).experiments
    np.testing.assert_allclose(e.u[:, 0], TAU)
    np.testing.assert_allclose(e.auxiliary["qd"], np.gradient(Q, T))
    said = capsys.readouterr().out.split("in full: ")[1].strip()
    assert said.count("--join") == 2
    assert main([*shlex.split(said)[1:], "--quiet"]) == 0  # the same folder again


def test_a_name_that_two_joined_files_have_needs_its_file(tmp_path):
    command = three_files(tmp_path)
    joined = [word.removeprefix("--join=") for word in command if word.startswith("--join")]
    (tmp_path / "plain.csv").write_text(table({"stamp": cells(T), "q": cells(Q)}))
    with pytest.raises(DatasetError, match="there is no column 'flag'"):
        run(
            tmp_path / "plain.csv",
            tmp_path / "a",
            ("t=stamp:s", "q=q:rad", "x=flag:1:auxiliary"),
            join=joined,
        )
    data, _ = run(
        tmp_path / "plain.csv",
        tmp_path / "a",
        ("t=stamp:s", "q=q:rad", "x=effort.flag:1:auxiliary"),
        join=joined,
    )
    assert data.experiments[0].auxiliary["x"].all()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "effort.csv").write_bytes((tmp_path / "effort.csv").read_bytes())
    with pytest.raises(UsageError, match="two files are called 'effort'"):
        run(
            tmp_path / "plain.csv",
            tmp_path / "b",
            join=[*joined, tmp_path / "other" / "effort.csv"],
        )


@pytest.mark.parametrize(
    "names",
    [
        ["a", "b"],
        [["a", "b"]],
        {"motors": ["a", "b"]},
        {"left": {"arm": ["a"]}, "right": [["b"]]},
        {"b": 1, "a": 0},
    ],
)
def test_names_of_joints_however_deep_they_lie(names):
    assert _leaves(names) == ["a", "b"]


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted by /proc")
def test_reading_parquet_leaves_no_thread_behind(tmp_path):
    """A worker that lets the file's bytes go while the interpreter ends aborts the process."""
    import pyarrow
    import pyarrow.parquet

    path = tmp_path / "log.parquet"
    pyarrow.parquet.write_table(pyarrow.table({"t": T, "q": Q}), path)
    program = (
        "import os, sys, pathlib, numpy, pyarrow, pyarrow.parquet\n"
        "from jaxid.data.table import read_table\n"
        "path = pathlib.Path(sys.argv[1])\n"
        "before = set(os.listdir('/proc/self/task'))\n"
        "assert read_table(path, path.name, path.read_bytes()).count == 60\n"
        "names = [open(f'/proc/self/task/{k}/comm').read() for k in set(os.listdir('/proc/self/task')) - before]\n"
        "sys.exit(len([n for n in names if 'jemalloc' not in n]))\n"
    )
    assert subprocess.run([sys.executable, "-c", program, str(path)], timeout=120).returncode == 0


def test_threads_that_read_csv_hold_no_memory_of_python(monkeypatch):
    import pyarrow

    given = []
    reader = pyarrow.BufferReader
    monkeypatch.setattr(
        pyarrow, "BufferReader", lambda buffer: given.append(buffer) or reader(buffer)
    )
    content = table({"t": cells(T), "q": cells(Q)}).encode()
    assert read_table(Path("log.csv"), "log.csv", content).count == 60
    assert given[0].address != pyarrow.py_buffer(content).address
