"""Numbers that stand in a file beside its series are kept and said, and no model takes them."""

import json
import tomllib
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.base.errors import DatasetWarning
from jaxid.data.importers.beside import MOST
from jaxid.data.importers.map import import_table


T = np.arange(100) * 0.01
CHANNELS = ("t=t:s", "q=q:rad:output", "tau=tau:N m:input")
SERIES = {"t": T, "q": np.sin(T), "tau": np.cos(T)}


def kept(tmp_path, files):
    """`[source]` of the dataset that these files become."""
    with pytest.warns(DatasetWarning) as said:
        import_table(files, tmp_path / "out", channels=CHANNELS)
    source = tomllib.loads((tmp_path / "out" / "dataset.toml").read_text())["source"]
    text = "; ".join(str(w.message) for w in said)
    return {k: v for k, v in source.items() if k not in ("source", "files")}, text


def npz(folder, name="a", **beside):
    file = folder / f"{name}.npz"
    np.savez(file, **SERIES, **beside)
    return file


def test_gains_and_masses_of_an_npz_are_kept_and_said(tmp_path):
    file = npz(tmp_path, kp=20.0, mass=np.array([0.3]), gear=np.array([50, 100]), name_="arm")
    found, said = kept(tmp_path, file)
    assert found == {"kp": 20.0, "mass": 0.3, "gear": "50, 100"}
    assert "no model uses them: kp = 20; mass = 0.3; gear = 50, 100" in said
    data = jaxid.load_dataset(tmp_path / "out")
    assert isinstance(data.source, dict) and data.source["mass"] == 0.3
    assert data.model is None


def test_nested_numbers_of_json_and_mat_have_their_path(tmp_path):
    scipy_io = pytest.importorskip("scipy.io")
    inner = {"kp": 7.5, "limit": [-2.0, 2.0], "on": True, "who": "me"}
    lists = {name: values.tolist() for name, values in SERIES.items()}
    file = tmp_path / "a.json"
    file.write_text(json.dumps(lists | {"law": inner}))
    expected = {"law.kp": 7.5, "law.limit": "-2, 2"}
    assert kept(tmp_path, file)[0] == expected
    numbers = {"kp": 7.5, "limit": np.array([-2.0, 2.0]), "who": "me"}
    scipy_io.savemat(tmp_path / "b.mat", SERIES | {"law": numbers})
    (tmp_path / "mat").mkdir()
    assert kept(tmp_path / "mat", tmp_path / "b.mat")[0] == expected


def test_numbers_of_an_hdf5_file_are_kept_and_its_texts_are_none(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w") as file:
        for name, values in SERIES.items():
            file[name] = values
        file["par/mass"] = 0.4
        file["who"] = np.array([[109, 101]], np.uint16)
        file["who"].attrs["MATLAB_class"] = np.bytes_("char")
    assert kept(tmp_path, tmp_path / "a.mat")[0] == {"par.mass": 0.4}


def test_what_differs_between_runs_stands_there_for_each(tmp_path):
    files = [npz(tmp_path, "a", mass=0.3, kp=2.0), npz(tmp_path, "b", mass=0.5, kp=2.0)]
    assert kept(tmp_path, files)[0] == {"mass of a": 0.3, "mass of b": 0.5, "kp": 2.0}


def test_a_rate_that_made_the_times_is_none_of_them(tmp_path):
    file = tmp_path / "a.npz"
    np.savez(file, q=SERIES["q"], tau=SERIES["tau"], fs=100.0, source=3.0, bad=np.nan)
    with pytest.warns(DatasetWarning):
        import_table(file, tmp_path / "out", channels=CHANNELS[1:])
    source = tomllib.loads((tmp_path / "out" / "dataset.toml").read_text())["source"]
    assert source == {"source": "npz", "files": "a", "source of the file": 3.0}


def test_many_numbers_are_cut_with_a_word(tmp_path):
    many: dict[str, Any] = {f"n{k}": float(k) for k in range(MOST + 7)}
    found, said = kept(tmp_path, npz(tmp_path, **many))
    assert len(found) == MOST and "7 more are left out" in said
