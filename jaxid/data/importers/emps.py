"""Other people's recordings as datasets. `import_emps` reads the EMPS benchmark as its authors
publish it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import DatasetError, DatasetProblem, nearest
from jaxid.base.wording import names_of
from jaxid.data.dataset import Dataset, ModelSpec, ParameterPrior
from jaxid.data.importers.runs import first_line, paths_of
from jaxid.data.io import save_dataset


_RESOLUTION = 5.0e-8  # m, the position encoder of the benchmark
_EMPS = ("t", "qm", "vir", "gtau")
_AUXILIARY_UNITS = {"position_cmd": "m", "pulses": "V"}
_PRIORS = {
    "inertia": ParameterPrior(90.0, 20.0, 300.0),
    "viscous": ParameterPrior(150.0, 0.0, 1000.0),
    "coulomb": ParameterPrior(10.0, 0.0, 100.0),
    "offset": ParameterPrior(0.0, -20.0, 20.0),
}


def import_emps(
    files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    *,
    format: str = "parquet",
    overwrite: bool = False,
) -> Path:
    """Writes a dataset folder from `DATA_EMPS.mat` and, if given, `DATA_EMPS_PULSES.mat`; returns
    the folder.

    The force is the drive input `vir` (V) times the drive gain `gtau` (N/V). A file with `pulses_N`
    becomes the validation run; its pulses are contained in `vir` already and are kept as an
    auxiliary channel in V. Source: Janot, Gautier, Brunot, "Data Set and Reference Models of EMPS",
    2019.

    Raises `DatasetError` for a file that is not such a MAT file, and where the folder cannot be
    written.
    """
    paths = paths_of(files)
    recordings = _recordings(paths)
    auxiliary = _auxiliary(recordings)
    dataset = Dataset.from_arrays(
        [r["t"] for r in recordings],
        {"force": [r["vir"] * r["gtau"] for r in recordings]},
        {"position": [r["qm"] for r in recordings]},
        auxiliary=auxiliary,
        units={name: _AUXILIARY_UNITS[name] for name in auxiliary},
        name="emps",
        description=(
            "EMPS: DC-motor ball-screw axis, recorded in closed loop; the measured drive force is"
            " the input"
        ),
        source={
            "source": (
                "Janot, Gautier, Brunot, Data Set and Reference Models of EMPS, 2019"
                " (nonlinearbenchmark.org)"
            ),
            "files": ", ".join(names_of(paths)),
        },
        names=[p.stem.lower() for p in paths],
        split=[_split(r) for r in recordings],
        resolution={"position": _RESOLUTION},
        model=ModelSpec("joint", parameters=_PRIORS),
        check_model=False,
    )
    return save_dataset(dataset, out, format=format, overwrite=overwrite)


def _recordings(paths: Sequence[Path]) -> list[dict[str, np.ndarray]]:
    """What the files hold, one of which has to be a recording to fit."""
    problems: list[DatasetProblem] = []
    recordings = [_read_emps(path, problems) for path in paths]
    if not problems and all(_split(r) == "validation" for r in recordings):
        file = str(paths[0]) if paths else "emps"
        remedy = "Give DATA_EMPS.mat too"
        problems.append(DatasetProblem(file, None, None, "no recording to fit", remedy))
    if problems:
        raise DatasetError(problems)
    return recordings


def _split(recording: Mapping[str, np.ndarray]) -> str:
    return "validation" if "pulses_N" in recording else "fit"


def _auxiliary(
    recordings: Sequence[Mapping[str, np.ndarray]],
) -> dict[str, list[np.ndarray]]:
    """The commanded position where every file has it, the pulses (0 elsewhere) where one has."""
    auxiliary = {}
    if all("qg" in r for r in recordings):
        auxiliary["position_cmd"] = [r["qg"] for r in recordings]
    if any("pulses_N" in r for r in recordings):
        auxiliary["pulses"] = [r.get("pulses_N", np.zeros_like(r["t"])) for r in recordings]
    return auxiliary


def _read_emps(path: Path, problems: list[DatasetProblem]) -> dict[str, Any]:
    """Variables of a file by their names; `problems` gets what is wrong with it."""
    from scipy.io import loadmat

    file = path.name

    def complain(message: str, remedy: str, name: str | None = None, where: str = file) -> None:
        problems.append(DatasetProblem(where, None, name, message, remedy))

    if not path.is_file():
        complain("there is no such file", "Get it from nonlinearbenchmark.org", where=str(path))
        return {}
    try:
        content = loadmat(path)
    except Exception as error:  # SciPy raises whatever its parser stumbles on
        complain(f"not readable as a MAT file ({first_line(error)})", "Download it again")
        return {}
    names = [n for n in content if not n.startswith("__")]
    lacking = [n for n in _EMPS if n not in names]
    for name in lacking:
        message = f"there is no variable {name!r}{nearest(name, names)}"
        complain(message, "Give DATA_EMPS.mat or DATA_EMPS_PULSES.mat as published", name)
    if lacking:
        return {}
    recording: dict[str, Any] = {}
    for name in (*_EMPS, "qg", "pulses_N"):
        if name not in names:
            continue
        values = np.asarray(content[name]).ravel()
        if values.dtype.kind not in "biuf" or len(values) == 0:
            complain("holds no numbers", "Give the file as published", name)
            continue
        recording[name] = float(values[0]) if name == "gtau" else values.astype(float)
    lengths = {len(values) for name, values in recording.items() if name != "gtau"}
    if len(lengths) > 1:
        complain("its variables differ in length", "Give the file as published")
    return recording
