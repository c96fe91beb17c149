"""The EMPS import, on small files of the same make."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jaxid.base.errors import DatasetError
from jaxid.data.importers.emps import import_emps
from jaxid.data.io import load_dataset


savemat = pytest.importorskip("scipy.io").savemat


def recording(phase: float = 0.0, **change) -> dict:
    t = 0.001 * np.arange(1200)[:, None]
    made = {
        "t": t,
        "qm": 0.1 * np.sin(5 * t + phase),
        "qg": 0.1 * np.sin(5 * t),
        "vir": np.cos(5 * t),
        "gtau": 35.15065,
    }
    return {k: v for k, v in (made | change).items() if v is not None}


@pytest.fixture
def files(tmp_path) -> list[Path]:
    savemat(tmp_path / "DATA_EMPS.mat", recording())
    savemat(
        tmp_path / "DATA_EMPS_PULSES.mat",
        recording(0.3, pulses_N=5.0 * (np.arange(1200)[:, None] % 50 < 5)),
    )
    return [tmp_path / "DATA_EMPS.mat", tmp_path / "DATA_EMPS_PULSES.mat"]


@pytest.mark.parametrize("form", ["parquet", "csv"])
def test_both_recordings_become_a_dataset(files, tmp_path, form):
    folder = import_emps(files, tmp_path / "emps", format=form)
    dataset = load_dataset(folder, check_model=False)
    assert [(e.name, e.split) for e in dataset.experiments] == [
        ("data_emps", "fit"),
        ("data_emps_pulses", "validation"),
    ]
    (force,), (position,) = dataset.inputs, dataset.outputs
    assert (force.name, force.unit, position.name, position.unit) == ("force", "N", "position", "m")
    assert (
        position.resolution == 5e-8 and dataset.model is not None and dataset.model.name == "joint"
    )
    np.testing.assert_allclose(dataset.experiments[0].u, 35.15065 * recording()["vir"])
    np.testing.assert_allclose(dataset.experiments[1].y, recording(0.3)["qm"])
    assert dataset.experiments[1].auxiliary["pulses"].max() == 5.0
    assert dataset.experiments[0].auxiliary["pulses"].max() == 0.0
    assert "position_cmd" in dataset.experiments[0].auxiliary


def test_the_order_of_the_files_does_not_decide_the_split(files, tmp_path):
    dataset = load_dataset(import_emps(files[::-1], tmp_path / "emps"), check_model=False)
    assert [e.split for e in dataset.experiments] == ["validation", "fit"]


def test_one_recording_is_enough(files, tmp_path):
    dataset = load_dataset(import_emps(files[0], tmp_path / "emps"), check_model=False)
    assert [e.split for e in dataset.experiments] == ["fit"]
    assert {e.split for e in dataset.with_splits().experiments} == {"fit", "validation", "report"}


def test_the_reference_is_optional(tmp_path):
    savemat(tmp_path / "a.mat", recording(qg=None))
    dataset = load_dataset(import_emps(tmp_path / "a.mat", tmp_path / "emps"), check_model=False)
    assert dataset.experiments[0].auxiliary == {}


@pytest.mark.parametrize(
    ("change", "column", "words"),
    [
        ({"vir": None}, "vir", "no variable 'vir'"),
        ({"qm": None, "qn": np.zeros(300)}, "qm", "did you mean 'qn'"),
        ({"qm": "text"}, "qm", "no numbers"),
        ({"gtau": np.zeros(0)}, "gtau", "no numbers"),
        ({"qm": np.zeros(299)}, None, "differ in length"),
    ],
)
def test_another_mat_file_is_refused(tmp_path, change, column, words):
    savemat(tmp_path / "a.mat", recording(**change))
    with pytest.raises(DatasetError) as caught:
        import_emps(tmp_path / "a.mat", tmp_path / "emps")
    (problem,) = caught.value.problems
    assert (problem.file, problem.column) == ("a.mat", column) and words in problem.message
    assert not (tmp_path / "emps").exists()


def test_bad_samples_are_refused_like_any_dataset(tmp_path):
    values = recording()["qm"].copy()
    values[7] = np.nan
    savemat(tmp_path / "a.mat", recording(qm=values))
    with pytest.raises(DatasetError, match="a, row 7, column position"):
        import_emps(tmp_path / "a.mat", tmp_path / "emps")


def test_what_is_no_mat_file_is_refused(files, tmp_path):
    (tmp_path / "text.mat").write_text("t,qm\n0,1\n")
    (tmp_path / "cut.mat").write_bytes(files[0].read_bytes()[:700])
    for bad in ("text.mat", "cut.mat", "absent.mat"):
        with pytest.raises(DatasetError) as caught:
            import_emps(tmp_path / bad, tmp_path / "emps")
        (problem,) = caught.value.problems
        assert ("no such file" in problem.message) == (bad == "absent.mat")


def test_pulses_alone_leave_nothing_to_fit(files, tmp_path):
    with pytest.raises(DatasetError, match="DATA_EMPS.mat too"):
        import_emps(files[1], tmp_path / "emps")
    with pytest.raises(DatasetError):
        import_emps([], tmp_path / "emps")


def test_another_folder_is_not_overwritten(files, tmp_path):
    (tmp_path / "emps").mkdir()
    (tmp_path / "emps" / "mine.txt").write_text("x")
    with pytest.raises(DatasetError, match="other files"):
        import_emps(files, tmp_path / "emps")
    assert import_emps(files, tmp_path / "emps", overwrite=True).is_dir()
    assert not (tmp_path / "emps" / "mine.txt").exists()
