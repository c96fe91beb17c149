"""Arrays that other programs write: MAT, npz and npy, JSON and JSON lines, TDMS, Parquet, PyTorch;
read by their own libraries.

Each reader gives name -> array; what lies inside structs, groups and objects has their names before
it: `log.q`, `data[0].q`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.extras import needed
from jaxid.data.importers.runs import first_line, refused
from jaxid.data.records import MINIMUM_SAMPLES


Arrays = dict[str, Any]
_MATLAB_TIME = (
    "In MATLAB write its arrays by themselves: s = struct('t', ts.Time, 'q', ts.Data);"
    " save('plain.mat', '-struct', 's') (a timetable: s = table2struct(timetable2table(tt),"
    " 'ToScalar', true))"
)
_EXCEL = "In the spreadsheet choose Save as, CSV UTF-8, and import that: jaxid import csv"


def kind_of(path: Path, content: bytes) -> str:
    """Which kind of file it is, by what it begins with, else by its name."""
    suffix = path.suffix.lower()
    if suffix in (".xlsx", ".xls", ".xlsm", ".ods"):
        raise refused(path, "a spreadsheet, which jaxid does not read", _EXCEL)
    if suffix in (".pkl", ".pickle"):
        raise refused(
            path,
            "a pickle, which can run any program and is not read",
            "Write it as npz: numpy.savez('log.npz', t=t, q=q)",
        )
    if content[:2] == b"\x1f\x8b":
        raise refused(
            path, "a compressed file", f"Unpack it and import what is inside: gunzip --keep {path}"
        )
    for start, kind in _BEGINS.items():
        if content.startswith(start):
            return kind
    if content.startswith(b"PK\x03\x04"):
        return _kind_of_zip(path, content)
    if suffix in _SUFFIXES:
        return _SUFFIXES[suffix]
    if content.lstrip().startswith(b"{"):
        return "json"
    return "mat" if suffix == ".mat" else "csv"


#: Kinds of files by what they begin with, and by their names where that tells nothing.
_BEGINS = {
    b"PAR1": "parquet",
    b"\x93NUMPY": "npz",
    b"TDSm": "tdms",
    b"\x89HDF": "mat",
    b"MATLAB 5": "mat",
    b"MATLAB 7": "mat",
}
_SUFFIXES = {
    ".pt": "torch",
    ".pth": "torch",
    ".json": "json",
    ".jsonl": "json",
    ".ndjson": "json",
}


def _kind_of_zip(path: Path, content: bytes) -> str:
    """What an archive holds."""
    names = _zip_names(path, content)
    if any(n.endswith("data.pkl") for n in names):
        return "torch"
    if any(n.startswith("xl/") for n in names):
        raise refused(path, "an Excel workbook, which jaxid does not read", _EXCEL)
    return "npz"


def read_arrays(kind: str, path: Path) -> Arrays:
    """The arrays of a file. Raises `DatasetError` that says what was recognised where it cannot be
    read.
    """
    try:
        return READERS[kind](path)
    except (OSError, ValueError, KeyError, TypeError, NotImplementedError, EOFError) as error:
        from jaxid.base.errors import DatasetError, UsageError

        if isinstance(error, DatasetError | UsageError):
            raise
        raise refused(
            path, f"not readable as {_WORDS[kind]} ({first_line(error)})", "Write the file again"
        ) from None


_WORDS = {
    "mat": "a MAT file",
    "npz": "NumPy's npz or npy",
    "json": "JSON",
    "torch": "PyTorch tensors",
    "tdms": "TDMS",
    "parquet": "Parquet",
}


def _zip_names(path: Path, content: bytes) -> list[str]:
    import io
    import zipfile

    try:
        return zipfile.ZipFile(io.BytesIO(content)).namelist()
    except (zipfile.BadZipFile, OSError) as error:
        raise refused(
            path, f"a damaged archive ({first_line(error)})", "Write the file again"
        ) from None


def _flat(name: str, value: Any, out: Arrays) -> None:
    """Adds what a nested value holds, each array under its path."""
    if isinstance(value, Mapping):
        return _flat_fields(name, value, out)
    if isinstance(value, np.ndarray) and value.dtype.names:
        return _flat_fields(name, {key: value[key] for key in value.dtype.names}, out)
    if isinstance(value, np.ndarray) and value.dtype == object:
        value = value.tolist()
    if not isinstance(value, list):
        out[name] = value
    elif _are_objects(value):
        _flat_rows(name, value, out)
    else:
        out[name] = _numbers_or_texts(value)


def _flat_fields(name: str, fields: Mapping[Any, Any], out: Arrays) -> None:
    prefix = f"{name}." if name else ""
    for key, inner in fields.items():
        _flat(f"{prefix}{key}", inner, out)


def _flat_rows(name: str, rows: list[Any], out: Arrays) -> None:
    """Objects in a list: series where they are samples, else each under its number."""
    columns = _records(rows)
    if columns is not None:
        return _flat_fields(name, columns, out)
    for k, row in enumerate(rows):
        _flat(f"{name}[{k}]", row, out)


def _numbers_or_texts(values: list[Any]) -> np.ndarray:
    try:
        return np.array(values, dtype=float)
    except (ValueError, TypeError):
        return np.array([str(v) for v in values])


def _records(rows: list[Any]) -> dict[str, list[Any]] | None:
    """Objects of the same keys whose values are single numbers, texts or short lists, as columns;
    None for anything else.
    """
    keys = list(rows[0])
    if len(rows) < 2 or any(set(row) != set(keys) for row in rows):
        return None
    holds_series = any(isinstance(v, list | np.ndarray) for v in rows[0].values())
    if holds_series and len(rows) < MINIMUM_SAMPLES:
        return None  # a few recordings, not a few samples
    columns = {}
    for key in keys:
        columns[key] = [row[key] for row in rows]
    return columns


def _npz(path: Path) -> Arrays:
    loaded = np.load(path, allow_pickle=False)
    out: Arrays = {}
    if isinstance(loaded, np.ndarray):
        _flat("" if loaded.dtype.names else "data", loaded, out)
        return out
    with loaded:
        for name in loaded.files:
            try:
                _flat(name, loaded[name], out)
            except ValueError:
                what = "Python objects (a pickle, which can run any program and is not read)"
                remedy = "Write plain arrays: numpy.savez('log.npz', t=t, q=q)"
                raise refused(path, f"{name!r} holds {what}", remedy) from None
    return out


def _json(path: Path) -> Arrays:
    text = path.read_text(encoding="utf-8-sig")
    out: Arrays = {}
    try:
        content = json.loads(text)
    except ValueError:
        content = [json.loads(line) for line in text.splitlines() if line.strip()]  # JSON lines
    except RecursionError:
        raise refused(path, "JSON nested too deeply", "Write plain arrays") from None
    if _are_objects(content):
        content = _joined(content)
    if not isinstance(content, Mapping):
        content = {"data": content}
    _flat("", content, out)
    return out


def _are_objects(values: Any) -> bool:
    """Whether a value is a list of objects, at least one."""
    return isinstance(values, list) and values != [] and all(map(_is_object, values))


def _is_object(value: Any) -> bool:
    return isinstance(value, Mapping)


def _joined(rows: list[Any]) -> Any:
    """Objects a line: where some lines lack keys, only the lines that have the most common keys
    count.
    """
    sets = [frozenset(r) for r in rows]
    usual = max(dict.fromkeys(sets), key=sets.count)
    kept = [r for r in rows if frozenset(r) == usual]
    nested: list[dict[str, Any]] = []
    for row in kept:
        flat: Arrays = {}
        for key, value in row.items():
            _flat_object(key, value, flat)
        nested.append(flat)
    return _records(nested) or {f"[{k}]": r for k, r in enumerate(kept)}


def _flat_object(name: str, value: Any, out: Arrays) -> None:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            _flat_object(f"{name}.{key}", inner, out)
    else:
        out[name] = value


def _mat(path: Path) -> Arrays:
    with path.open("rb") as stream:
        head = stream.read(128)
    if b"HDF" in head or b"MATLAB 7.3" in head:
        return _mat73(path)
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque, MatReadError

    try:
        content = loadmat(path, squeeze_me=True, simplify_cells=True)
    except (MatReadError, NotImplementedError) as error:
        raise refused(
            path,
            f"not readable as a MAT file ({first_line(error)})",
            "Write it again with save(..., '-v7')",
        ) from None
    except Exception as error:  # SciPy raises whatever its parser stumbles on
        raise refused(
            path, f"not readable as a MAT file ({first_line(error)})", "Write the file again"
        ) from None
    opaque = False
    out: Arrays = {}
    for name, value in content.items():
        if isinstance(value, MatlabOpaque) or name in ("None", "__function_workspace__"):
            opaque = True
        elif not name.startswith("__"):
            _flat(name, value, out)
    if opaque and not any(map(np.ndim, out.values())):
        raise refused(
            path,
            "holds MATLAB objects (timeseries, timetable, table), which only MATLAB reads",
            _MATLAB_TIME,
        )
    return out


def _mat73(path: Path) -> Arrays:
    h5py = needed("h5py")
    out: Arrays = {}
    objects: list[str] = []

    def visit(prefix: str, group: Any) -> None:
        for name, item in group.items():
            if name.startswith("#"):
                continue
            full = f"{prefix}.{name}" if prefix else name
            made_by = item.attrs.get("MATLAB_class", b"")
            decoded = "MATLAB_object_decode" in item.attrs
            if decoded or made_by in (b"timeseries", b"timetable", b"table"):
                objects.append(full)
            elif isinstance(item, h5py.Group):
                visit(full, item)
            elif item.dtype.kind in "biuf" and made_by != b"char":
                out[full] = np.squeeze(item[()].T)  # MATLAB stores columns first

    with h5py.File(path, "r") as file:
        visit("", file)
    if objects and not any(map(np.ndim, out.values())):
        raise refused(
            path,
            f"{objects[0]!r} is a MATLAB object (timeseries, timetable, table), which only MATLAB"
            " reads",
            _MATLAB_TIME,
        )
    return out


def _tdms(path: Path) -> Arrays:
    reader = needed("nptdms").TdmsFile
    out: Arrays = {}
    with reader.open(path) as file:
        groups = file.groups()
        for group in groups:
            for channel in group.channels():
                name = channel.name if len(groups) == 1 else f"{group.name}.{channel.name}"
                out[name] = channel[:]
                if "wf_increment" in channel.properties and len(channel):
                    out.setdefault("dt", np.float64(channel.properties["wf_increment"]))
    return out


def _torch(path: Path) -> Arrays:
    from jaxid.data.importers.torch import read_tensors

    out: Arrays = {}
    _flat("", read_tensors(path), out)
    return out


READERS: dict[str, Callable[[Path], Arrays]] = {
    "npz": _npz,
    "json": _json,
    "mat": _mat,
    "tdms": _tdms,
    "torch": _torch,
}
