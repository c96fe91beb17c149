"""Other people's recordings as datasets. `import_emps` reads the EMPS benchmark as its authors
publish it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.data.dataset import Dataset, ModelSpec, ParameterPrior
from jaxid.data.io import save_dataset
from jaxid.errors import DatasetError, DatasetProblem, nearest


_RESOLUTION = 5.0e-8  # m, the position encoder of the benchmark
_EMPS = ("t", "qm", "vir", "gtau")


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
    paths = [Path(files)] if isinstance(files, str | os.PathLike) else [Path(f) for f in files]
    problems: list[DatasetProblem] = []
    recordings = [_read_emps(path, problems) for path in paths]
    if not problems and all("pulses_N" in r for r in recordings):
        remedy = "Give DATA_EMPS.mat too"
        problems.append(
            DatasetProblem(
                str(paths[0]) if paths else "emps", None, None, "no recording to fit", remedy
            )
        )
    if problems:
        raise DatasetError(problems)
    pulses = any("pulses_N" in r for r in recordings)
    priors = {
        "inertia": ParameterPrior(90.0, 20.0, 300.0),
        "viscous": ParameterPrior(150.0, 0.0, 1000.0),
        "coulomb": ParameterPrior(10.0, 0.0, 100.0),
        "offset": ParameterPrior(0.0, -20.0, 20.0),
    }
    auxiliary = {
        "position_cmd": [r["qg"] if "qg" in r else np.zeros_like(r["t"]) for r in recordings]
    }
    if not all("qg" in r for r in recordings):
        auxiliary = {}
    if pulses:
        auxiliary["pulses"] = [r.get("pulses_N", np.zeros_like(r["t"])) for r in recordings]
    dataset = Dataset.from_arrays(
        [r["t"] for r in recordings],
        {"force": [r["vir"] * r["gtau"] for r in recordings]},
        {"position": [r["qm"] for r in recordings]},
        auxiliary=auxiliary,
        units={name: "V" if name == "pulses" else "m" for name in auxiliary},
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
            "files": ", ".join(p.name for p in paths),
        },
        names=[p.stem.lower() for p in paths],
        split=["validation" if "pulses_N" in r else "fit" for r in recordings],
        resolution={"position": _RESOLUTION},
        model=ModelSpec("joint", parameters=priors),
        check_model=False,
    )
    return save_dataset(dataset, out, format=format, overwrite=overwrite)


def _read_emps(path: Path, problems: list[DatasetProblem]) -> dict[str, Any]:
    from scipy.io import loadmat

    file = path.name
    try:
        content = loadmat(path)
    except FileNotFoundError:
        problems.append(
            DatasetProblem(
                str(path), None, None, "there is no such file", "Get it from nonlinearbenchmark.org"
            )
        )
        return {}
    except Exception as error:  # SciPy raises whatever its parser stumbles on
        reason = (str(error).splitlines() or [type(error).__name__])[0][:100]
        problems.append(
            DatasetProblem(
                file, None, None, f"not readable as a MAT file ({reason})", "Download it again"
            )
        )
        return {}
    names = [n for n in content if not n.startswith("__")]
    lacking = [n for n in _EMPS if n not in names]
    for name in lacking:
        message = f"there is no variable {name!r}{nearest(name, names)}"
        problems.append(
            DatasetProblem(
                file, None, name, message, "Give DATA_EMPS.mat or DATA_EMPS_PULSES.mat as published"
            )
        )
    if lacking:
        return {}
    recording: dict[str, Any] = {}
    for name in (*_EMPS, "qg", "pulses_N"):
        if name not in names:
            continue
        values = np.asarray(content[name]).ravel()
        if values.dtype.kind not in "biuf" or len(values) == 0:
            problems.append(
                DatasetProblem(file, None, name, "holds no numbers", "Give the file as published")
            )
            continue
        recording[name] = float(values[0]) if name == "gtau" else values.astype(float)
    if len({len(v) for k, v in recording.items() if k != "gtau"}) > 1:
        problems.append(
            DatasetProblem(
                file, None, None, "its variables differ in length", "Give the file as published"
            )
        )
    return recording
