# ruff: noqa: E501 (tables of cases, one a line)
"""Imports of tables and arrays: each layout written by the public writer of its format, and read as
what it is.
"""

from __future__ import annotations

import io
import json
import pickle
import shlex
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, HealthCheck, settings, strategies as st

from jaxid.base.errors import DatasetError, UsageError
from jaxid.cli.app import main
from jaxid.data.dataset import Dataset
from jaxid.data.importers.map import import_table
from jaxid.data.importers.text import recognise
from jaxid.data.io import load_dataset


N = 60
T = np.round(np.arange(N) / 100, 4)
Q = np.round(np.sin(3 * T) - 0.2, 6)
TAU = np.round(np.cos(3 * T), 6)
ROWS = np.column_stack([T, Q, TAU])
PLAIN = ("t=t:s", "q=q:rad", "tau=tau:N m")
NUMBERED = ("t=1:s", "q=2:rad", "tau=3:N m")


def run(path: Path, out: Path, channels=PLAIN, **more) -> tuple[Dataset, str]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        done = import_table(path, out, channels=channels, **more)
        return load_dataset(done.folder, check_model=False), done.command


def same(data: Dataset) -> None:
    (e,) = data.experiments
    np.testing.assert_allclose(e.t, T, atol=1e-9)
    np.testing.assert_allclose(e.y[:, 0], Q, atol=1e-9)
    np.testing.assert_allclose(e.u[:, 0], TAU, atol=1e-9)


def text(rows=ROWS, separator=",", decimal=".", header="t,q,tau", end="\n") -> str:
    body = end.join(separator.join(repr(float(v)).replace(".", decimal) for v in r) for r in rows)
    return (header.replace(",", separator) + end if header else "") + body + end


TEXTS = {
    "commas": (text(), PLAIN),
    "semicolons": (text(separator=";"), PLAIN),
    "decimal commas": (text(separator=";", decimal=","), PLAIN),
    "tabs and decimal commas": (text(separator="\t", decimal=","), PLAIN),
    "bars": (text(separator="|"), PLAIN),
    "spaces": (text(separator=" "), PLAIN),
    "no header": (text(header=""), NUMBERED),
    "no header, tabs": (text(header="", separator="\t"), NUMBERED),
    "preamble and units": (
        "Axis1\nNumber of samples,60\nInterval (ms),10\n" + text(header="t,q,tau\ns,rad,N m"),
        ("t=t", "q=q", "tau=tau"),
    ),
    "units in brackets": (text(header="t [s],q (rad),tau [N m]"), ("t=t", "q=q", "tau=tau")),
    "comments": (
        "# bench 3\n# t,q,tau\n" + text(header="").replace("\n0.3,", "\n# note, in between\n0.3,"),
        PLAIN,
    ),
    "percent signs": ("% made by a script\n" + text(separator="\t"), PLAIN),
    "equal column twice": (text(np.column_stack([T, Q, T, TAU]), header="t,q,t,tau"), PLAIN),
    "trailing rows": (text() + ",,\n" * 5, PLAIN),
    "trailing separator": (text().replace("\n", ",\n"), PLAIN),
    "CRLF": (text(end="\r\n"), PLAIN),
    "blank rows": (text().replace("\n", "\n\n"), PLAIN),
    "lvm": (
        "LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\t\n"
        + text(separator="\t", header="X_Value,q,tau,Comment"),
        ("t=X_Value:s", *PLAIN[1:]),
    ),
    "index of pandas": (pd.DataFrame({"t": T, "q": Q, "tau": TAU}).to_csv(), PLAIN),
    "text column": (
        pd.DataFrame({"type": "STATE", "t": T, "q": Q, "tau": TAU}).to_csv(index=False),
        PLAIN,
    ),
    "ISO times": (
        pd.DataFrame(
            {
                "t": [
                    s.isoformat()
                    for s in pd.Timestamp("2026-03-01 10:00") + pd.to_timedelta(T, unit="s")
                ],
                "q": Q,
                "tau": TAU,
            }
        ).to_csv(index=False),
        ("t=t", *PLAIN[1:]),
    ),
    "epoch": (
        pd.DataFrame(
            {"t": 1_767_225_600_000 + np.round(1e3 * T).astype(int), "q": Q, "tau": TAU}
        ).to_csv(index=False),
        ("t=t:ms", *PLAIN[1:]),
    ),
    "units of time": (text(np.column_stack([1e6 * T, Q, TAU])), ("t=t:us", *PLAIN[1:])),
}


@pytest.mark.parametrize("name", TEXTS)
def test_text_is_recognised_and_said_as_a_command(tmp_path, name, capsys):
    content, channels = TEXTS[name]
    file = tmp_path / "log.txt"
    file.write_bytes(content.encode())
    data, command = run(file, tmp_path / "a", channels)
    same(data)
    words = shlex.split(command)
    assert words[:2] == ["jaxid", "import"]
    assert main([*words[1:-1], str(tmp_path / "b"), "--quiet"]) == 0  # the command says it in full
    again = load_dataset(tmp_path / "b", check_model=False)
    np.testing.assert_array_equal(again.experiments[0].y, data.experiments[0].y)


def test_other_encodings(tmp_path):
    for encoding in ("utf-16", "cp1252", "utf-8-sig"):
        file = tmp_path / "a.csv"
        file.write_bytes(
            text(np.column_stack([T, np.degrees(Q), TAU]), header="t,q (°),tau").encode(encoding)
        )
        same(run(file, tmp_path / encoding, ("t=t:s", "q=q", "tau=tau:N m"))[0])


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    separator=st.sampled_from(",;\t|"),
    decimal=st.sampled_from(".,"),
    preamble=st.lists(
        st.sampled_from(
            ["Axis1", "Samples,60", "Interval (ms),10", "operator: A. B.", "", "***End***"]
        ),
        max_size=4,
    ),
    header=st.booleans(),
    units=st.booleans(),
    columns=st.integers(2, 6),
    scale=st.sampled_from([1e-6, 1.0, 1e5]),
)
def test_any_layout_is_recognised(separator, decimal, preamble, header, units, columns, scale):
    if separator == decimal:
        return
    values = np.round(np.random.default_rng(columns).standard_normal((30, columns)) * scale, 9)
    lines = list(preamble)
    lines += [separator.join(f"c{k}" for k in range(columns))] if header else []
    lines += (
        [separator.join(["s", "rad", "N m", "A", "V", "m"][:columns])] if header and units else []
    )
    first = len(lines) + 1
    lines += [separator.join(f"{v:.6f}".replace(".", decimal) for v in row) for row in values]
    form = recognise(lines)
    assert form is not None and (form.separator, form.decimal, form.first) == (
        separator,
        decimal,
        first,
    )
    if header:
        assert form.header == first - 1 - units and (form.units is not None) == units


# ---- several runs, rows out of order


def test_a_time_that_starts_again_is_another_run(tmp_path):
    twice = np.vstack([ROWS, ROWS + [0, 1, 0], ROWS])
    (tmp_path / "a.csv").write_text(text(twice))
    data, _ = run(tmp_path / "a.csv", tmp_path / "out")
    assert [len(e) for e in data.experiments] == [N, N, N] and "starts again" in data.description
    np.testing.assert_allclose(data.experiments[1].y[:, 0], Q + 1)


def test_rows_out_of_order_are_sorted_and_mixed_recordings_refused(tmp_path):
    order = np.random.default_rng(0).permutation(N)
    (tmp_path / "a.csv").write_text(text(ROWS[order]))
    data, _ = run(tmp_path / "a.csv", tmp_path / "out")
    same(data)
    assert "out of order" in data.description
    (tmp_path / "b.csv").write_text(
        text(np.stack([ROWS[order], ROWS[order] + [0, 1, 0]], 1).reshape(-1, 3))
    )
    with pytest.raises(DatasetError, match="several recordings mixed row by row"):
        run(tmp_path / "b.csv", tmp_path / "other")


def test_rows_before_anything_is_judged(tmp_path):
    (tmp_path / "a.csv").write_text(text() + "x,y,z\n7,,\n")
    with pytest.raises(
        DatasetError, match=r"row 62, column t: not a number: 'x'; so 1 rows|row 62.*--rows 0:60"
    ):
        run(tmp_path / "a.csv", tmp_path / "out")
    same(run(tmp_path / "a.csv", tmp_path / "out", rows=(0, N))[0])


# ---- lists in cells, patterns, another file


def test_lists_in_cells_and_a_file_of_commands(tmp_path):
    state = pd.DataFrame(
        {
            "timestamp": np.round(1e6 * T).astype(int),
            "positions": [[a, a + 1] for a in Q.tolist()],
            "torques": [[b, -b] for b in TAU.tolist()],
        }
    )
    state.to_csv(tmp_path / "state.csv", index=False)
    state.to_parquet(tmp_path / "state.parquet")
    pd.DataFrame(
        {
            "timestamp": np.round(1e6 * T[::2]).astype(int) + 100,
            "positions": [[a, a] for a in Q[::2].tolist()],
        }
    ).to_csv(tmp_path / "control.csv", index=False)
    channels = (
        "t=timestamp:us",
        "q*=positions[*]:rad",
        "tau*=torques[*]:N m",
        "q*_cmd=control.positions[*]:rad:auxiliary",
    )
    for file in ("state.csv", "state.parquet"):
        data, command = run(
            tmp_path / file, tmp_path / f"out_{file}", channels, join=tmp_path / "control.csv"
        )
        (e,) = data.experiments
        np.testing.assert_allclose(e.y, np.stack([Q, Q + 1], 1)[1:])
        np.testing.assert_allclose(
            e.auxiliary["q2_cmd"][:4], Q[[0, 0, 2, 2]]
        )  # the last that was given
        assert (
            "no drift between their clocks can be told" in data.description and "--join" in command
        )
    np.savez(tmp_path / "wide.npz", t=T, positions=np.stack([Q, Q], 1))
    with pytest.raises(
        DatasetError,
        match=r"an array of 2 columns. Name one, q=positions\[0\]:UNIT, or all: 'q\*=positions\[\*\]:UNIT'",
    ):
        run(tmp_path / "wide.npz", tmp_path / "no", ("t=t:s", "q=positions:rad"))


def test_clocks_that_drift_are_told(tmp_path):
    pd.DataFrame({"t": T, "q": Q}).to_csv(tmp_path / "a.csv", index=False)
    pd.DataFrame({"t": T * (1 + 400e-6) + 0.001, "tau": TAU}).to_csv(
        tmp_path / "b.csv", index=False
    )
    data, _ = run(tmp_path / "a.csv", tmp_path / "out", join=tmp_path / "b.csv")
    assert "move apart by 4e+02" in data.description and "clock_ppm" in data.description


# ---- arrays


def test_arrays_of_numpy(tmp_path):
    both = np.stack([Q, Q + 1])
    np.savez(tmp_path / "flat.npz", t=T, q=Q, tau=TAU)
    same(run(tmp_path / "flat.npz", tmp_path / "a")[0])
    for name, array in (("rows.npz", both.T), ("columns.npz", both)):  # either axis may be the time
        np.savez(tmp_path / name, t=T[:, None], q=array, tau=TAU)
        data, _ = run(
            tmp_path / name, tmp_path / name[:-4], ("t=t:s", "q*=q[*]:rad", "tau1=tau:N m")
        )
        np.testing.assert_allclose(data.experiments[0].y, both.T)
    np.save(
        tmp_path / "table.npy",
        np.array([tuple(r) for r in ROWS], dtype=[("t", "f8"), ("q", "f8"), ("tau", "f8")]),
    )
    same(run(tmp_path / "table.npy", tmp_path / "b")[0])
    np.save(tmp_path / "plain.npy", ROWS)
    same(
        run(
            tmp_path / "plain.npy",
            tmp_path / "c",
            ("t=data[0]:s", "q=data[1]:rad", "tau=data[2]:N m"),
        )[0]
    )
    np.savez(tmp_path / "objects.npz", t=np.array([{}], dtype=object))
    with pytest.raises(DatasetError, match="holds Python objects"):
        run(tmp_path / "objects.npz", tmp_path / "d")


def test_mat_files(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "flat.mat", {"t": T, "q": Q, "tau": TAU})
    same(run(tmp_path / "flat.mat", tmp_path / "a")[0])
    savemat(
        tmp_path / "struct.mat", {"log": {"t": T[:, None], "q": Q[:, None], "drive": {"tau": TAU}}}
    )
    same(
        run(tmp_path / "struct.mat", tmp_path / "b")[0]
    )  # by the end of the path, where it is unique
    same(
        run(
            tmp_path / "struct.mat",
            tmp_path / "c",
            ("t=log.t:s", "q=log.q:rad", "tau=log.drive.tau:N m"),
        )[0]
    )


def test_mat_files_of_7_3(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "new.mat", "w", userblock_size=512) as file:
        group = file.create_group("log")
        for name, values in (("t", T), ("q", Q), ("tau", TAU)):
            group[name] = values[None, :]
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512, b" ")
    (tmp_path / "new.mat").write_bytes(head + (tmp_path / "new.mat").read_bytes()[512:])
    same(run(tmp_path / "new.mat", tmp_path / "a")[0])
    with h5py.File(tmp_path / "series.mat", "w") as file:
        file.create_dataset("ts", data=np.zeros(6, "u4")).attrs["MATLAB_class"] = np.bytes_(
            b"timeseries"
        )
    with pytest.raises(DatasetError, match="MATLAB object .*struct\\('t', ts.Time"):
        run(tmp_path / "series.mat", tmp_path / "b")


def test_json(tmp_path):
    files = {
        "arrays.json": json.dumps({"t": T.tolist(), "log": {"q": Q.tolist(), "tau": TAU.tolist()}}),
        "records.json": json.dumps([{"t": t, "q": q, "tau": u} for t, q, u in ROWS.tolist()]),
        "lines.jsonl": "\n".join(
            json.dumps({"t": t, "state": {"q": q}, "tau": u}) for t, q, u in ROWS.tolist()
        ),
        "rate.json": json.dumps({"hz": 100, "data": [{"q": Q.tolist(), "tau": TAU.tolist()}]}),
    }
    for name, content in files.items():
        (tmp_path / name).write_text(content)
        data, command = run(tmp_path / name, tmp_path / f"out_{name}")
        same(data)
        assert ("nominal" in data.description) == ("--rate 100" in command) == (name == "rate.json")
    (tmp_path / "two.json").write_text(
        json.dumps({"hz": 100, "data": [{"q": Q.tolist(), "tau": TAU.tolist()}] * 2})
    )
    assert len(run(tmp_path / "two.json", tmp_path / "two")[0].experiments) == 2
    (tmp_path / "none.json").write_text(json.dumps({"q": Q.tolist(), "tau": TAU.tolist()}))
    with pytest.raises(DatasetError, match="--rate HZ"):
        run(tmp_path / "none.json", tmp_path / "none")
    same(run(tmp_path / "none.json", tmp_path / "none", PLAIN[1:], rate=100.0)[0])


def test_tdms(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("log", n, v, properties={})
                for n, v in (("t", T), ("q", Q), ("tau", TAU))
            ]
        )
    same(run(tmp_path / "a.tdms", tmp_path / "a")[0])
    with nptdms.TdmsWriter(tmp_path / "b.tdms") as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("log", n, v, properties={"wf_increment": 0.01})
                for n, v in (("q", Q), ("tau", TAU))
            ]
        )
    data, _ = run(tmp_path / "b.tdms", tmp_path / "b", PLAIN[1:])
    same(data)
    assert "nominal" in data.description


class _Storage:
    def __init__(self, key: str, array: np.ndarray):
        self.key, self.array = key, array


class _Tensor:
    """Pickles as a tensor of PyTorch does."""

    def __init__(self, array: np.ndarray, key: str):
        self.array, self.storage = array, _Storage(key, array)

    def __reduce__(self):
        strides = tuple(s // self.array.itemsize for s in self.array.strides)
        return _rebuild_tensor_v2, (self.storage, 0, self.array.shape, strides, False, {})


def _rebuild_tensor_v2(*_):
    raise AssertionError


class _Global:
    def __init__(self, module: str, name: str):
        self.module, self.name = module, name


_Plain: Any = getattr(pickle, "_Pickler")  # the one in Python, whose steps can be changed


class _Pickler(_Plain):
    """Writes the names that PyTorch would, which need not be installed."""

    def persistent_id(self, obj):
        if isinstance(obj, _Storage):
            kind = {"f8": "DoubleStorage", "f4": "FloatStorage", "i8": "LongStorage"}[
                obj.array.dtype.str[1:]
            ]
            return ("storage", _Global("torch", kind), obj.key, "cpu", obj.array.size)
        return None

    def save(self, obj, save_persistent_id=True):
        if isinstance(obj, _Global):
            self.write(pickle.GLOBAL + f"{obj.module}\n{obj.name}\n".encode())
        elif obj is _rebuild_tensor_v2:
            self.write(pickle.GLOBAL + b"torch._utils\n_rebuild_tensor_v2\n")
        else:
            super().save(obj, save_persistent_id)


def torch_file(path: Path, arrays: dict[str, np.ndarray], extra=None) -> None:
    """The archive that `torch.save` writes of a dictionary of tensors."""
    stream = io.BytesIO()
    tensors = {name: _Tensor(a, str(k)) for k, (name, a) in enumerate(arrays.items())}
    _Pickler(stream, protocol=2).dump(tensors | ({} if extra is None else {"extra": extra}))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("log/data.pkl", stream.getvalue())
        archive.writestr("log/byteorder", "little")
        for k, a in enumerate(arrays.values()):
            archive.writestr(f"log/data/{k}", a.tobytes())
        archive.writestr("log/version", "3\n")


def test_tensors_of_pytorch(tmp_path):
    torch_file(tmp_path / "a.pt", {"t": T, "q": np.stack([Q, Q + 1], 1), "tau": TAU})
    data, _ = run(tmp_path / "a.pt", tmp_path / "a", ("t=t:s", "q*=q[*]:rad", "tau1=tau:N m"))
    np.testing.assert_allclose(data.experiments[0].y, np.stack([Q, Q + 1], 1))
    torch_file(tmp_path / "b.pt", {"t": T}, extra=_Global("os", "system"))
    with pytest.raises(DatasetError, match="it holds os.system, and only tensors are read"):
        run(tmp_path / "b.pt", tmp_path / "b")
    (tmp_path / "old.pt").write_bytes(pickle.dumps({"t": 1}))
    with pytest.raises(DatasetError, match="plain pickle"):
        run(tmp_path / "old.pt", tmp_path / "c")
    torch = pytest.importorskip("torch")
    torch.save(
        {"t": torch.tensor(T), "q": torch.tensor(Q), "tau": torch.tensor(TAU)}, tmp_path / "d.pt"
    )
    same(run(tmp_path / "d.pt", tmp_path / "d")[0])


# ---- what is refused


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.xlsx", b"PK\x03\x04", "Save as, CSV UTF-8"),
        ("a.pkl", b"\x80\x04", "a pickle"),
        ("a.bin", b"\x00\x01\x02" * 50, "binary data"),
        ("a.mat", b"MATLAB 5.0 MAT-file" + b"\0" * 200, "not readable as a MAT file"),
        ("a.json", b'{"t": [0, 1', "not readable as JSON"),
        ("a.csv", b"", "empty"),
        ("a.csv", b"hello\nworld\n", "no rows of numbers"),
        (
            "a.csv",
            text(np.column_stack([1e3 * T, Q, TAU])).encode(),
            "is t in ms\\? say --channel t=t:ms",
        ),
        (
            "a.csv",
            text(header="t,q,q").encode(),
            "stands twice .columns 2 and 3, which differ.*q=2:rad",
        ),
        ("a.csv", text(header="").encode(), "no header. Name it by number"),
    ],
)
def test_refusals_say_what_was_recognised_and_what_to_type(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    channels = ("t=1:s", "q=q:rad") if "no header" in words else ("t=t", "q=q:rad")
    with pytest.raises(DatasetError, match=words):
        run(tmp_path / name, tmp_path / "out", channels)
    assert not (tmp_path / "out").exists()


def test_without_channels_a_command_is_proposed(tmp_path):
    (tmp_path / "a.csv").write_text(TEXTS["preamble and units"][0])
    with pytest.raises(
        UsageError,
        match=r"header in row 4, units in row 5, data from row 6\) holds: t \(s\), q \(rad\), tau \(N m\)",
    ) as caught:
        run(tmp_path / "a.csv", tmp_path / "out", ())
    command = str(caught.value).split("unit: ")[1].split(" (roles")[0]
    assert main([*shlex.split(command)[1:], "--quiet"]) == 0


def test_the_cases_of_a_bench(tmp_path):
    """The eleven files of the shared case, each by one command."""
    import os

    folder = (
        Path(os.environ.get("JAXID_DATA", Path(__file__).parents[1] / "../shared/data")).parent
        / "cases"
        / "rig_06_text_formats_refused"
    )
    if not folder.is_dir():
        pytest.skip("the shared cases are not here")
    own = {"headerless.csv": NUMBERED, "analyser.lvm": ("t=X_Value:s", *PLAIN[1:])}
    files = [p for p in sorted(folder.iterdir()) if p.suffix not in (".py", ".md")]
    assert len(files) == 11
    for path in files:
        data, _ = run(path, tmp_path / path.name, own.get(path.name, PLAIN))
        assert (
            len(data.experiments[0]) == 50
            and abs(float(np.median(np.diff(data.experiments[0].t))) - 0.01) < 1e-9
        )


def test_a_column_goes_by_its_header_as_it_stands(tmp_path):
    (tmp_path / "log.csv").write_text(text(header="t [s],angle (rad),motor [N m]"))
    same(
        run(
            tmp_path / "log.csv",
            tmp_path / "out",
            ("t=t [s]:s", "q=angle (rad):rad", "tau=motor [N m]:N m"),
        )[0]
    )
    with pytest.raises(DatasetError, match="there is no column"):
        run(tmp_path / "log.csv", tmp_path / "other", ("t=t:s", "q=angle:rad", "tau=speed [A]:N m"))
