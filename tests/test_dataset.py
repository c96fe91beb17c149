# ruff: noqa: E501 (tables of cases, one a line)
"""Datasets: what is refused and how, what is accepted, and that nothing is lost between arrays,
folders and splits.
"""

from __future__ import annotations

import math
import sys
import types
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, HealthCheck, settings, strategies as st

import jaxid
import jaxid.dynamics
from jaxid.base.errors import DatasetError, DatasetProblem, DatasetWarning
from jaxid.data.dataset import Channel, Controller, ModelSpec, ParameterPrior
from jaxid.data.io import load_dataset
from jaxid.dynamics.mechanism import Signature


TOML = """\
name = "bench"
[model]
name = "pendulum"
without = ["coulomb_friction"]
[model.constants]
inertia = 0.08
[model.parameters.viscous]
value = 0.3
lower = 0.0
upper = 3.0
[channels.tau]
role = "input"
unit = "N m"
[channels.q]
role = "output"
unit = "rad"
noise_std = 2.0e-4
[[experiments]]
file = "fit.csv"
split = "fit"
at_rest = true
[[experiments]]
file = "check.csv"
split = "validation"
"""


@pytest.fixture
def pendulum(monkeypatch):
    """A catalogue with one model, so that the checks are tested apart from the models."""
    signature = Signature((("tau", "N m"),), (("q", "rad"),), ("q",))
    info = types.SimpleNamespace(
        name="pendulum",
        signatures=(signature,),
        parameters=("inertia", "gravity_torque", "viscous", "coulomb", "offset"),
        constants=("gravity",),
        builtin_effects=("viscous_friction", "coulomb_friction"),
        states=("q", "qd"),
    )
    fake = types.ModuleType("jaxid.dynamics.catalogue")
    fake.__dict__.update(
        model_names=lambda: ("joint", "pendulum"),
        effect_names=lambda: ("payload", "coulomb_friction", "viscous_friction"),
        describe=lambda name, model=None: info,
    )
    monkeypatch.setitem(sys.modules, "jaxid.dynamics.catalogue", fake)
    monkeypatch.setattr(jaxid.dynamics, "catalogue", fake, raising=False)


def samples(count: int = 120, phase: float = 0.0) -> list[list[str]]:
    rows = [["t", "tau", "q"]]
    for i in range(count):
        t = 0.01 * i
        rows.append(
            [
                f"{t:.4f}",
                f"{math.sin(9 * t + phase):.6f}",
                f"{0.3 * math.sin(4 * t + phase) + 0.01:.6f}",
            ]
        )
    return rows


class Folder:
    """A sound dataset, to be broken."""

    def __init__(self, path: Path):
        self.path = path
        self.path.mkdir()
        self.toml = TOML
        self.fit = samples()
        self.check = samples(phase=1.0)

    def write(self) -> Path:
        (self.path / "dataset.toml").write_text(self.toml, encoding="utf-8")
        for name, rows in (("fit.csv", self.fit), ("check.csv", self.check)):
            if not (self.path / name).exists():
                (self.path / name).write_text(
                    "\n".join(",".join(r) for r in rows) + "\n", encoding="utf-8"
                )
        return self.path

    def replace(self, old: str, new: str) -> None:
        assert old in self.toml
        self.toml = self.toml.replace(old, new, 1)

    def bytes(self, content: bytes, name: str = "fit.csv") -> None:
        (self.path / name).write_bytes(content)

    def text(self) -> str:
        return "\n".join(",".join(r) for r in self.fit) + "\n"

    def parquet(self, columns: dict, name: str = "fit.parquet") -> None:
        self.replace('file = "fit.csv"', f'file = "{name}"')
        pq.write_table(pa.table(columns), self.path / name)

    def cell(self, row: int, column: int, value: str) -> None:
        """Sets a cell by the row an editor shows."""
        self.fit[row - 1][column] = value


@pytest.fixture
def folder(tmp_path) -> Folder:
    return Folder(tmp_path / "bench")


@dataclass(frozen=True)
class Broken:
    name: str
    mutate: Callable[[Folder], object]
    file: str
    row: int | None
    column: str | None
    words: str


def toml(old: str, new: str) -> Callable[[Folder], object]:
    return lambda f: f.replace(old, new)


def cell(row: int, column: int, value: str) -> Callable[[Folder], object]:
    return lambda f: f.cell(row, column, value)


def text(change: Callable[[str], str]) -> Callable[[Folder], object]:
    return lambda f: f.bytes(change(f.text()).encode())


def both(*mutations: Callable[[Folder], object]) -> Callable[[Folder], object]:
    return lambda f: [m(f) for m in mutations]


def columns(**change) -> dict:
    t = np.arange(120) * 0.01
    return {"t": t, "tau": np.sin(9 * t), "q": np.sin(4 * t)} | change


def null_at(sample: int) -> list:
    values: list = np.sin(4 * np.arange(120) * 0.01).tolist()
    values[sample] = None
    return values


def constant_output(f: Folder) -> None:
    for row in f.fit[1:]:
        row[2] = "0.5"


def duplicated_rows(f: Folder) -> None:
    f.fit[50:50] = [list(f.fit[49])]


def gap(f: Folder) -> None:
    for row in f.fit[61:]:
        row[0] = f"{float(row[0]) + 3:.4f}"


def link_outside(f: Folder) -> None:
    outside = f.path.parent / "outside.csv"
    outside.write_text(f.text())
    (f.path / "fit.csv").symlink_to(outside)


EXPERIMENT = '[[experiments]]\nfile = "fit.csv"\n'
RESPONSE = '[[experiments]]\nfile = "frf.csv"\nkind = "frequency_response"\ninput = "tau"\noutput = "q"\nsplit = "report"\n'


def response(
    head: str = "omega,gain,phase", row: str = "2.0,0.5,-0.1", more: str = ""
) -> Callable[[Folder], object]:
    def mutate(f: Folder) -> None:
        f.toml += RESPONSE + more
        f.bytes(f"{head}\n1.0,0.9,-0.05\n{row}\n3.0,0.2,-0.3\n".encode(), "frf.csv")

    return mutate


D = "dataset.toml"
BROKEN = [
    # the description
    Broken("no dataset.toml", lambda f: None, D, None, None, "no dataset.toml"),
    Broken("TOML syntax", toml('unit = "rad"', "unit = rad"), D, 16, None, "not readable as TOML"),
    Broken("TOML key twice", toml('unit = "rad"', 'unit = "rad"\nunit = "rad"'), D, 17, None, "not readable as TOML"),
    Broken("TOML not UTF-8", lambda f: (f.path / D).write_bytes(TOML.encode() + b"# \xff\n"), D, 25, None, "UTF-8"),
    Broken("unknown top key", toml('name = "bench"', 'name = "bench"\ntimes = "t"'), D, 2, "times", "did you mean 'time'"),
    Broken("no name", toml('name = "bench"\n', ""), D, None, "name", "'name' is missing"),
    Broken("control character in the name", toml('"bench"', '"be\\u0007nch"'), D, 1, "name", "control characters"),
    Broken("channel key", toml("noise_std", "noise_stdd"), D, 17, "channels.q.noise_stdd", "did you mean 'noise_std'"),
    Broken("unknown unit", toml('unit = "rad"', 'unit = "rads"'), D, 16, "channels.q.unit", "did you mean 'rad"),
    Broken("no unit", toml('unit = "rad"\n', ""), D, 14, "channels.q.unit", "'unit' is missing"),
    Broken("ambiguous g", toml('[channels.q]', '[channels.acc]\ncolumn = "q"\nrole = "auxiliary"\nunit = "g"\n[channels.q]'), D, 17, "channels.acc.unit", "gram or the acceleration"),
    Broken("role", toml('role = "output"', 'role = "outputs"'), D, 15, "channels.q.role", "did you mean 'output'"),
    Broken("hold", toml('unit = "N m"', 'unit = "N m"\nhold = "first"'), D, 14, "channels.tau.hold", "'first'"),
    Broken("scale 0", toml('unit = "rad"', 'unit = "rad"\nscale = 0'), D, 17, "channels.q.scale", "is 0"),
    Broken("scale a text", toml('unit = "rad"', 'unit = "rad"\nscale = "2"'), D, 17, "channels.q.scale", "valid number"),
    Broken("scale nan", toml('unit = "rad"', 'unit = "rad"\nscale = nan'), D, 17, "channels.q.scale", "nan"),
    Broken("negative noise", toml("2.0e-4", "-2.0e-4"), D, 17, "channels.q.noise_std", "-0.0002"),
    Broken("resolution 0", toml('unit = "rad"', 'unit = "rad"\nresolution = 0.0'), D, 17, "channels.q.resolution", "0.0"),
    Broken("channel name", toml("[channels.q]", '[channels."q\\u0001"]'), D, 14, "channels.q\x01", "not a name"),
    Broken("channel named t", toml("[channels.q]", '[channels.t]\nrole = "auxiliary"\nunit = "s"\n[channels.q]'), D, 14, "channels.t", "name of the time"),
    Broken("bad split", toml('"validation"', '"validate"'), D, 24, "experiments[2].split", "did you mean 'validation'"),
    Broken("experiment key", toml("at_rest", "at_rust"), D, 21, "experiments[1].at_rust", "did you mean 'at_rest'"),
    Broken("no file", toml('file = "check.csv"\n', ""), D, 22, "experiments[2].file", "'file' is missing"),
    Broken("no experiments", lambda f: setattr(f, "toml", f.toml.split("[[exp")[0]), D, None, "experiments", "no experiments"),
    Broken("no fit", toml('"fit"\n', '"report"\n'), D, 18, "experiments", 'has split = "fit"'),
    Broken("start stated twice", lambda f: f.replace("at_rest = true", "at_rest = true\ninitial = {q = 0.1}"), D, 18, "experiments[1]", "both at_rest and initial"),
    Broken("rows backwards", toml("at_rest = true", "rows = [40, 10]"), D, 21, "experiments[1].rows", "behind the start"),
    Broken("names twice", lambda f: setattr(f, "toml", f.toml.replace("split =", 'name = "a"\nsplit =')), D, 25, "experiments[2].name", "already"),
    Broken("controller", lambda f: setattr(f, "toml", f.toml + '[controller]\nkind = "pd"\nkp = "high"\n'), D, 27, "controller.kp", "valid number"),
    Broken("prior", toml("lower = 0.0", "lower = 0.5"), D, 7, "model.parameters.viscous", "must rise"),
    Broken("huge number", toml("0.08", "1" + "0" * 400), D, 6, "model.constants.inertia", ""),
    # the model
    Broken("unknown model", toml('"pendulum"', '"pendulun"'), D, 3, "model.name", "did you mean 'pendulum'"),
    Broken("unknown without", toml('["coulomb_friction"]', '["coulomb_fricton"]'), D, 4, "model.without", "did you mean 'coulomb_friction'"),
    Broken("unknown constant", toml("inertia = 0.08", "inertias = 0.08"), D, 6, "model.constants.inertias", "did you mean 'inertia'"),
    Broken("unknown parameter", toml("parameters.viscous", "parameters.viscos"), D, 7, "model.parameters.viscos", "did you mean 'viscous'"),
    Broken("unknown run constant", toml("at_rest = true", "constants = {gravty = 9.8}"), D, 21, "experiments[1].constants.gravty", "did you mean 'gravity'"),
    Broken("unknown state", toml("at_rest = true", "initial = {qdd = 9.8}"), D, 21, "experiments[1].initial.qdd", "no state 'qdd'"),
    Broken("missing role", toml("[channels.tau]", '[channels.torque]\ncolumn = "tau"'), D, 11, "channels.tau", "input channel here: torque"),
    Broken("wrong role", toml('role = "input"', 'role = "auxiliary"'), D, 12, "channels.tau.role", "as input, but it is auxiliary"),
    Broken("no input and no model", lambda f: setattr(f, "toml", 'name = "x"\n' + f.toml[f.toml.index("[channels.q]") :]), D, 2, "channels", 'no channel with role = "input"'),
    Broken("no channels", lambda f: setattr(f, "toml", f.toml[: f.toml.index("[channels.tau]")] + f.toml[f.toml.index("[[exp") :]), D, None, "channels", "no channels"),
    Broken("response of nothing", lambda f: [response()(f), f.replace('output = "q"', 'output = "qq"')], D, 29, "experiments[3].output", "did you mean 'q'"),
    Broken("wrong quantity", toml('unit = "rad"', 'unit = "m"'), D, 16, "channels.q.unit", "needs a unit like 'rad'"),
    Broken("unknown output", toml("[channels.q]", '[channels.w]\ncolumn="q"\nrole="output"\nunit="rad"\n[channels.q]'), D, 16, "channels.w.role", "no output 'w'"),
    Broken("free with input", toml("[model]", "[model]\nfree = true"), D, 3, "model.free", "free motion has no input"),
    # the files
    Broken("file missing", toml("check.csv", "chek.csv"), D, 23, "experiments[2].file", "no file 'chek.csv' (there is: check.csv, fit.csv)"),
    Broken("file outside", toml("check.csv", "../check.csv"), D, 23, "experiments[2].file", "outside"),
    Broken("file absolute", toml("check.csv", "/etc/hosts.csv"), D, 23, "experiments[2].file", "outside"),
    Broken("link outside", link_outside, D, 19, "experiments[1].file", "outside"),
    Broken("file a folder", lambda f: (f.path / "fit.csv").mkdir(), D, 19, "experiments[1].file", "is a folder"),
    Broken("suffix", toml("check.csv", "check.xlsx"), D, 23, "experiments[2].file", "neither"),
    Broken("NUL in the file name", toml("check.csv", "check\\u0000.csv"), D, 23, "experiments[2].file", "not readable"),
    Broken("empty file", text(lambda s: ""), "fit.csv", None, None, "empty"),
    Broken("header only", text(lambda s: "t,tau,q\n"), "fit.csv", 1, None, "without samples"),
    Broken("no header", text(lambda s: s.split("\n", 1)[1]), "fit.csv", 1, None, "numbers, not names"),
    Broken("semicolons", text(lambda s: s.replace(",", ";")), "fit.csv", 1, None, "semicolons"),
    Broken("semicolons, decimal commas", text(lambda s: s.replace(",", ";").replace(".", ",")), "fit.csv", 1, None, "semicolons and decimal commas"),
    Broken("tabs", text(lambda s: s.replace(",", "\t")), "fit.csv", 1, None, "tabs"),
    Broken("decimal comma", cell(30, 2, '"0,25"'), "fit.csv", 30, "q", "decimal comma"),
    Broken("decimal commas", text(lambda s: s.replace(".", ",")), "fit.csv", 2, None, "decimal commas perhaps; so 120 rows"),
    Broken("UTF-16", lambda f: f.bytes(f.text().encode("utf-16")), "fit.csv", 1, None, "UTF-16"),
    Broken("not UTF-8", lambda f: f.bytes(f.text().replace("q\n", "q,\xb0\n", 1).encode("latin-1")), "fit.csv", 1, None, "UTF-8"),
    Broken("binary", lambda f: f.bytes(b"t,tau,q\n1,2\x00,3\n"), "fit.csv", 2, None, "binary"),
    Broken("column twice", text(lambda s: s.replace("tau", "q", 1)), "fit.csv", 1, "q", "stands twice"),
    Broken("ragged", lambda f: f.fit[39].pop(), "fit.csv", 40, None, "2 fields where the header has 3"),
    Broken("empty row", lambda f: f.fit.insert(39, [""]), "fit.csv", 40, None, "empty row"),
    Broken("quote open", cell(40, 1, '"0.1'), "fit.csv", 121, None, "not readable as CSV"),
    Broken("not Parquet", toml('file = "fit.csv"', 'file = "fit.parquet"'), "fit.parquet", None, None, "Parquet"),
    # columns, selection, samples
    Broken("column missing", toml('unit = "rad"', 'unit = "rad"\ncolumn = "taw"'), "fit.csv", 1, "taw", "(did you mean 'tau'?), nor in check.csv"),
    Broken("time column missing", toml('name = "bench"', 'name = "bench"\ntime = "tt"'), "fit.csv", 1, "tt", "for the time"),
    Broken("where column", toml("at_rest = true", 'where = {logs = "a"}'), "fit.csv", 1, "logs", "for `where`"),
    Broken("where value", toml("at_rest = true", "where = {t = 77.5}"), "fit.csv", None, "t", "no row has"),
    Broken("rows beyond", toml("at_rest = true", "rows = [0, 121]"), "fit.csv", None, None, "beyond the 120 samples"),
    Broken("window beyond", toml("at_rest = true", "window_s = [5.0, 6.0]"), "fit.csv", None, "t", "no sample lies in"),
    Broken("unparsable", cell(17, 1, "fast"), "fit.csv", 17, "tau", "sample 16 (row 17) is not a number: 'fast'"),
    Broken("underscore", cell(17, 1, "1_0"), "fit.csv", 17, "tau", "not a number"),
    Broken("missing sample", cell(18, 2, ""), "fit.csv", 18, "q", "sample 17 (row 18) is missing"),
    Broken("NaN samples", both(cell(18, 2, "nan"), cell(20, 2, "NA")), "fit.csv", 18, "q", "2 samples in all"),
    Broken("infinite sample", cell(18, 2, "-inf"), "fit.csv", 18, "q", "infinite"),
    Broken("NaN time", cell(50, 0, "nan"), "fit.csv", 50, "t", "missing"),
    Broken("time stands", duplicated_rows, "fit.csv", 51, "t", "time stands still at sample 50 (row 51)"),
    Broken("time backwards", cell(60, 0, "0.1"), "fit.csv", 60, "t", "time runs backwards"),
    Broken("gap", gap, "fit.csv", 62, "t", "a gap of 3.01 s before sample 61 (row 62)"),
    Broken("constant output", constant_output, "fit.csv", None, "q", "never moves"),
    Broken("too short", lambda f: f.fit.__delitem__(slice(16, None)), "fit.csv", None, None, "15 samples"),
    Broken("overflow", both(cell(17, 2, "9e300"), toml('unit = "rad"', 'unit = "rad"\nscale = 1e10')), "fit.csv", 17, "q", "too large"),
    Broken("Parquet null", lambda f: f.parquet(columns(q=null_at(16))), "fit.parquet", 18, "q", "sample 17 (row 18) is missing"),
    Broken("Parquet text", lambda f: f.parquet(columns(q=["x"] * 120)), "fit.parquet", 2, "q", "not a number: 'x'"),
    Broken("Parquet empty", lambda f: f.parquet({"t": [], "tau": [], "q": []}), "fit.parquet", 1, None, "without samples"),
    # frequency responses
    Broken("response without phase", response(head="omega,gain,fase"), "frf.csv", 1, "phase", "there is no column"),
    Broken("response of a channel", response(more='phase_unit = "grad"'), D, 31, "experiments[3].phase_unit", "'grad'"),
    Broken("response at 0", response(row="0,0.5,-0.1"), "frf.csv", 3, "omega", "above 0"),
    Broken("response NaN", response(row="2,nan,-0.1"), "frf.csv", 3, "gain", "missing"),
    Broken("response with a window", response(more="window_s = [0.0, 1.0]"), D, 25, "experiments[3]", "no meaning"),
    Broken("key of a response", toml("at_rest = true", 'output = "q"'), D, 18, "experiments[1]", "no meaning"),
]  # fmt: skip


@pytest.mark.parametrize("broken", BROKEN, ids=lambda b: b.name)
def test_one_fault_is_one_problem_at_its_place(broken: Broken, folder: Folder, pendulum):
    broken.mutate(folder)
    if broken.name == "not Parquet":
        folder.bytes(b"PAR1 not really", "fit.parquet")
    path = folder.path
    if broken.name not in ("no dataset.toml", "TOML not UTF-8"):
        folder.write()
    with pytest.raises(DatasetError) as caught:
        load_dataset(path)
    problems = caught.value.problems
    assert len(problems) == 1, str(caught.value)
    problem = problems[0]
    assert (problem.file, problem.row, problem.column) == (
        broken.file,
        broken.row,
        broken.column,
    ), str(problem)
    assert broken.words in problem.message, str(problem)
    assert problem.remedy and "Traceback" not in str(problem)


def test_everything_wrong_is_said_at_once(folder, pendulum):
    folder.replace("noise_std", "noise_stdd")
    folder.replace('"validation"', '"validate"')
    folder.replace("viscous]", "viscos]")
    folder.cell(30, 0, "late")
    folder.cell(40, 1, "nan")
    folder.check[50][2] = "x"
    with pytest.raises(DatasetError) as caught:
        load_dataset(folder.write())
    places = [(p.file, p.row) for p in caught.value.problems]
    assert sorted(places, key=str) == sorted(
        [(D, 17), (D, 24), (D, 7), ("fit.csv", 30), ("fit.csv", 40), ("check.csv", 51)], key=str
    ), str(caught.value)
    assert str(caught.value).startswith("6 problems in the data:")


def crlf(f: Folder) -> None:
    f.bytes(f.text().replace("\n", "\r\n").encode())


def no_last_newline(f: Folder) -> None:
    f.bytes(f.text().rstrip("\n").encode())


def irregular(f: Folder) -> None:
    for i, row in enumerate(f.fit[1:]):
        row[0] = f"{0.01 * (i + 0.4 * math.sin(7 * i)):.6f}"


SOUND = {
    "CRLF": crlf,
    "byte order mark": lambda f: f.bytes(b"\xef\xbb\xbf" + f.text().encode()),
    "no last newline": no_last_newline,
    "blank rows at the end": lambda f: f.bytes((f.text() + "\n\n  \n").encode()),
    "empty cells at the end": lambda f: f.bytes((f.text() + ",,\n").encode()),
    "quoted header": lambda f: f.bytes(f.text().replace("t,tau,q", '"t","tau","q"').encode()),
    "spaces round names and numbers": lambda f: f.bytes(f.text().replace(",", " , ").encode()),
    "comma after every row": lambda f: f.bytes(f.text().replace("\n", ",\n").encode()),
    "scientific notation": lambda f: f.cell(30, 2, "1.25E-2"),
    "unused columns of text and NaN": lambda f: [
        f.bytes("\n".join(",".join([*r, "state" if i == 0 else "nan" if i % 2 else "ok"]) for i, r in enumerate(f.fit)).encode())
    ],
    "irregular sampling": irregular,
    "negative time": lambda f: [r.__setitem__(0, f"{float(r[0]) - 5:.4f}") for r in f.fit[1:]],
    "two channels of one column": toml("[channels.q]", '[channels.q_raw]\ncolumn="q"\nrole="auxiliary"\nunit="rad"\n[channels.q]'),
    "split left out": toml('split = "fit"\n', ""),
    "file in a sub-folder": lambda f: [
        (f.path / "sub").mkdir(),
        f.bytes(f.text().encode(), "sub/fit.csv"),
        f.replace('"fit.csv"', '"sub/fit.csv"'),
    ],
    "upper-case suffix": lambda f: [f.bytes(f.text().encode(), "fit.CSV"), f.replace('"fit.csv"', '"fit.CSV"')],
    "Parquet of float32": lambda f: f.parquet({k: v.astype(np.float32) if k != "t" else v for k, v in columns().items()}),
    "Parquet of integers": lambda f: f.parquet(columns(q=(np.sin(4 * columns()["t"]) * 1000).astype(np.int16))),
    "Parquet with an index column": lambda f: f.parquet(columns(__index_level_0__=np.arange(120))),
    "a missing sample outside the rows": both(cell(5, 2, "nan"), toml("at_rest = true", "rows = [4, 120]")),
    "a missing sample outside the window": both(cell(5, 2, "nan"), toml("at_rest = true", "window_s = [0.04, 2.0]")),
    "constants of a run": toml("at_rest = true", "constants = {gravity = 9.8, payload = 0.5}"),
    "source as a table": toml('name = "bench"', 'name = "bench"\nsource = {origin = "a bench", recorded = 2024-05-01}'),
    "licence beside source": toml('name = "bench"', 'name = "bench"\nsource = "a bench"\nlicence = "CC0"'),
    "no model": lambda f: setattr(f, "toml", f.toml[: f.toml.index("[model]")] + f.toml[f.toml.index("[channels.tau]") :]),
    "units with signs": toml('"N m"', '"N·m"'),
}  # fmt: skip


@pytest.mark.parametrize("name", SOUND)
def test_unusual_but_sound(name: str, folder: Folder, pendulum):
    SOUND[name](folder)
    dataset = load_dataset(folder.write())
    assert [e.split for e in dataset.experiments] == ["fit", "validation"]
    assert dataset.experiments[0].u.shape == dataset.experiments[0].y.shape
    assert 100 < len(dataset.experiments[0]) <= 120


def test_loads_what_the_file_says(folder, pendulum):
    folder.replace('unit = "rad"', 'unit = "deg"\nscale = 2.0\noffset = 1.0')
    folder.toml += '[controller]\nkind = "pd"\nkp = 12\nkd = [1.0, 2.0]\nsample_time = 0.002\n'
    dataset = load_dataset(folder.write() / "dataset.toml")
    raw = np.array([float(r[2]) for r in folder.fit[1:]])
    np.testing.assert_allclose(dataset.experiments[0].y[:, 0], np.deg2rad(2 * raw + 1))
    assert dataset.outputs == (Channel("q", "output", "rad", np.deg2rad(2e-4)),)
    assert dataset.inputs == (Channel("tau", "input", "N m"),)
    assert dataset.model == ModelSpec(
        "pendulum",
        ("coulomb_friction",),
        False,
        {"inertia": 0.08},
        {"viscous": ParameterPrior(0.3, 0.0, 3.0)},
    )
    assert dataset.controller == Controller(
        "pd", {"kp": 12.0, "kd": [1.0, 2.0], "sample_time": 0.002}
    )
    first = dataset.experiments[0]
    assert first.at_rest and first.initial is None and first.source == "fit.csv, rows 2 to 121"
    assert not first.y.flags.writeable and len(dataset.sha256) == 64
    assert dataset.split("validation") == (dataset.experiments[1],)


def test_sha256_follows_the_content(folder, pendulum):
    before = load_dataset(folder.write()).sha256
    assert load_dataset(folder.path).sha256 == before
    folder.cell(30, 2, "0.123456")
    (folder.path / "fit.csv").unlink()
    assert load_dataset(folder.write()).sha256 != before


def test_where_chooses_a_log_and_runs_may_share_a_file(folder, pendulum):
    rows = [["log", *folder.fit[0]]]
    for name in ("slow", "fast"):
        rows += [[name, *r] for r in folder.fit[1:]]
    folder.bytes("\n".join(map(",".join, rows)).encode())
    folder.replace("at_rest = true", 'where = {log = "slow"}')
    folder.replace('"check.csv"', '"fit.csv"\nwhere = {log = "fast"}')
    dataset = load_dataset(folder.write())
    assert [(e.name, len(e)) for e in dataset.experiments] == [("fit:slow", 120), ("fit:fast", 120)]
    assert dataset.experiments[1].source == "fit.csv, rows 122 to 241"


def test_gaps_are_split_where_the_user_says_so(folder, pendulum):
    gap(folder)
    folder.replace("at_rest = true", "split_at_gaps = true\ninitial = {q = 0.01, qd = 1.2}")
    dataset = load_dataset(folder.write())
    names = [(e.name, len(e), e.initial) for e in dataset.split("fit")]
    assert names == [("fit#1", 60, {"q": 0.01, "qd": 1.2}), ("fit#2", 60, None)]
    assert "split at 1 gap into 2 runs" in dataset.notes[0]


def test_long_steps_and_constant_inputs_are_warnings(folder, pendulum):
    for row in folder.fit[61:]:
        row[0] = f"{float(row[0]) + 0.1:.4f}"
        row[1] = "0.5"
    for row in folder.fit[1:61]:
        row[1] = "0.5"
    with pytest.warns(DatasetWarning) as caught:
        dataset = load_dataset(folder.write())
    assert len(caught) == len(dataset.notes) == 2
    assert "1 time step over 5 medians" in dataset.notes[0] and "row 62" in dataset.notes[0]
    assert "input 'tau' is constant in fit" in dataset.notes[1]
    assert caught[0].filename == __file__


def test_a_joint_held_in_one_run_is_sound(folder):
    for f in (folder.fit, folder.check):
        f[0].append("q2")
        for i, row in enumerate(f[1:]):
            row.append("0.1" if f is folder.fit else f"{0.01 * i:.3f}")
    folder.toml += '[channels.q2]\nrole = "output"\nunit = "rad"\n'
    folder.write()
    assert load_dataset(folder.path, check_model=False).experiments[0].y.shape == (120, 2)


def test_g_is_decided_by_the_model(folder, pendulum):
    sys.modules["jaxid.dynamics.catalogue"].describe("pendulum").signatures = (
        Signature((("tau", "N m"),), (("q", "m/s^2"),), ("q",)),
    )
    folder.replace('unit = "rad"', 'unit = "g"')
    dataset = load_dataset(folder.write())
    assert dataset.outputs[0].unit == "m/s^2"
    np.testing.assert_allclose(dataset.experiments[0].y[0, 0], float(folder.fit[1][2]) * 9.80665)


def test_frequency_response_in_every_form(folder, pendulum):
    omega = np.array([1.0, 2.0, 2.0, 5.0])
    value = np.array([1.0 - 0.1j, 0.5 - 0.4j, 0.52 - 0.41j, 0.1 - 0.3j])
    forms = {
        "a": ({"omega": omega, "re": np.real(value), "im": np.imag(value)}, ""),
        "b": ({"frequency": omega / 2 / np.pi, "gain": abs(value), "phase": np.angle(value)}, ""),
        "c": (
            {"w": omega, "gain": abs(value), "ph": np.angle(value, deg=True)},
            'phase_unit = "deg"\ncolumns = {omega = "w", phase = "ph"}\n',
        ),
    }
    folder.replace('unit = "rad"', 'unit = "mrad"')
    for name, (table, more) in forms.items():
        pq.write_table(pa.table(table), folder.path / f"{name}.parquet")
        folder.toml += RESPONSE.replace("frf.csv", f"{name}.parquet") + more
    dataset = load_dataset(folder.write())
    assert [r.name for r in dataset.responses] == ["a", "b", "c"]
    for found in dataset.responses:
        np.testing.assert_allclose(found.omega, omega)
        np.testing.assert_allclose(found.response, 1e-3 * value)
        assert (found.input, found.output, found.split) == ("tau", "q", "report")


def test_model_is_not_asked_when_told_so(folder):
    folder.replace('"pendulum"', '"my_own"')
    assert load_dataset(folder.write(), check_model=False).model == ModelSpec(
        "my_own",
        ("coulomb_friction",),
        False,
        {"inertia": 0.08},
        {"viscous": ParameterPrior(0.3, 0.0, 3.0)},
    )


def test_a_recording_in_the_place_of_a_folder_is_told_how_to_become_one(tmp_path):
    (tmp_path / "run.csv").write_text("t,q\n0,0\n")
    with pytest.raises(DatasetError, match=r"jaxid import SOURCE .*run\.csv --out"):
        load_dataset(tmp_path / "run.csv")


def test_a_missing_folder_is_a_problem(tmp_path):
    for path in (tmp_path / "nowhere", tmp_path / "no\0where"):
        with pytest.raises(DatasetError):
            load_dataset(path)


# robustness

PIECES = [
    b"",
    b"[",
    b"]",
    b'"',
    b"\n",
    b",",
    b";",
    b"=",
    b"\x00",
    b"\xff",
    b"nan",
    b"1e999",
    b"[[experiments]]\n",
    b"-",
    b"[a.b]\n",
    b"9" * 30,
    b"true",
    b"{",
    b"'",
]


@given(data=st.data())
@settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
def test_random_damage_is_refused_or_harmless(tmp_path_factory, pendulum, data):
    folder = Folder(tmp_path_factory.mktemp("damage") / "d")
    folder.fit = folder.fit[:40]
    folder.write()
    for name in ("dataset.toml", "fit.csv"):
        content = bytearray((folder.path / name).read_bytes())
        for _ in range(data.draw(st.integers(0, 3))):
            start = data.draw(st.integers(0, len(content)))
            stop = min(len(content), start + data.draw(st.integers(0, 8)))
            content[start:stop] = data.draw(st.sampled_from(PIECES) | st.binary(max_size=4))
        (folder.path / name).write_bytes(bytes(content))
    try:
        load_dataset(folder.path)
    except DatasetError as error:
        assert error.problems and all(p.message and p.remedy for p in error.problems)


@given(
    raw=st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(
                    [
                        "name",
                        "channels",
                        "experiments",
                        "model",
                        "controller",
                        "q",
                        "role",
                        "unit",
                        "file",
                        "rows",
                        "where",
                        "initial",
                        "constants",
                        "parameters",
                        "value",
                        "kind",
                    ]
                ),
                inner,
                max_size=6,
            )
        ),
        max_leaves=25,
    )
)
@settings(max_examples=150, deadline=None)
def test_any_document_is_refused_with_problems(raw):
    from jaxid.data.schema import Places, read_document

    if isinstance(raw, dict):
        document = read_document(raw, Places("x"))
        assert all(isinstance(p, DatasetProblem) for p in document.problems)
        assert document.header is not None or document.problems


def test_a_misspelt_selection_blames_no_sample_outside_it(folder, pendulum):
    folder.cell(5, 2, "nan")
    folder.replace("at_rest = true", "row = [10, 100]")
    with pytest.raises(DatasetError) as caught:
        load_dataset(folder.write())
    assert [p.column for p in caught.value.problems] == ["experiments[1].row"]


def test_sample_numbers_follow_the_file_where_a_row_is_unreadable(folder, pendulum):
    folder.cell(60, 2, "nan")
    folder.fit[39].pop()
    with pytest.raises(DatasetError) as caught:
        load_dataset(folder.write())
    assert [p.row for p in caught.value.problems] == [40, 60]
    assert "sample 59 (row 60)" in caught.value.problems[1].message
