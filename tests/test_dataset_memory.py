# ruff: noqa: E501 (tables of cases, one a line)
"""Datasets in memory: splits, arrays and frames, saving and loading back, real recordings."""

from __future__ import annotations

import json
import os
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, HealthCheck, settings, strategies as st

from jaxid.base.errors import DatasetError, DatasetProblem
from jaxid.data.dataset import (
    Channel,
    Controller,
    Dataset,
    Experiment,
    FrequencyResponse,
    ModelSpec,
    ParameterPrior,
)
from jaxid.data.io import load_dataset, save_dataset


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).parents[2] / "shared" / "data"))


# splits


def run(
    count: int, split: str, dt: float = 0.01, name: str = "run", start: float = 0.0
) -> Experiment:
    t = start + dt * np.arange(count)
    return Experiment(name, split, t, np.sin(t)[:, None], np.cos(t)[:, None], at_rest=True)


def dataset_of(*runs: Experiment) -> Dataset:
    return Dataset("d", (Channel("tau", "input", "N m"), Channel("q", "output", "rad")), runs)


def test_one_run_is_cut_in_three():
    dataset = dataset_of(run(1000, "fit")).with_splits()
    fit, validation, report = dataset.experiments
    assert [e.split for e in dataset.experiments] == ["fit", "validation", "report"]
    assert [e.name for e in dataset.experiments] == ["run#fit", "run#validation", "run#report"]
    assert len(fit) == 700 and fit.at_rest
    assert (
        validation.t[0] == pytest.approx(7.2) and len(validation) == 140 and not validation.at_rest
    )
    assert report.t[0] == pytest.approx(7.2 + 1.4 + 0.2) and report.t[-1] == pytest.approx(9.99)
    assert len(dataset.notes) == 2 and "20 samples (0.2 s) left out" in dataset.notes[0]
    assert dataset.with_splits() is dataset


def test_guard_gap_is_a_tenth_of_a_second_where_sampling_is_fast():
    dataset = dataset_of(run(100, "fit"), run(4000, "validation", dt=0.001, name="v")).with_splits()
    _, first, second = dataset.experiments
    assert len(first) == 2000 and second.t[0] - first.t[-1] == pytest.approx(0.101)


def test_report_runs_are_left_alone_and_validation_is_not_halved_then():
    runs = (run(1000, "fit"), run(300, "report", name="r"))
    dataset = dataset_of(*runs).with_splits()
    assert [(e.split, len(e)) for e in dataset.experiments] == [
        ("fit", 700),
        ("validation", 280),
        ("report", 300),
    ]
    full = dataset_of(run(100, "fit"), run(100, "validation"), run(100, "report"))
    assert full.with_splits() is full


def test_parts_know_what_went_before_them():
    whole = dataset_of(run(3000, "fit"))
    fit, validation, report = whole.with_splits().experiments
    assert fit.past is None and fit.whole is fit
    source = whole.experiments[0]
    for part, samples in (
        (validation, 500),
        (report, int(np.searchsorted(source.t, report.t[0]))),
    ):  # five seconds, or all of it
        assert part.past is not None and len(part.past) == samples
        first = int(np.searchsorted(source.t, part.t[0]))
        np.testing.assert_array_equal(part.whole.t, source.t[first - samples : first + len(part)])
        np.testing.assert_array_equal(part.whole.y, source.y[first - samples : first + len(part)])
    assert validation.piece(10, 100, name="n", split="fit").past is None  # unless it is asked for
    _, fast, last = dataset_of(run(30_000, "fit", dt=1e-4)).with_splits().experiments
    assert (
        fast.past is not None
        and len(fast.past) == 1000
        and last.past is not None
        and len(last.past) == 20_000
    )


def test_short_runs_stay_whole_and_the_note_says_so():
    dataset = dataset_of(run(60, "fit")).with_splits()
    assert [e.split for e in dataset.experiments] == ["fit"]
    assert "too short (60 samples)" in dataset.notes[0]


@given(count=st.integers(20, 3000), dt=st.floats(1e-4, 0.5))
@settings(max_examples=40, deadline=None)
def test_splits_never_share_a_sample_nor_invent_one(count, dt):
    whole = dataset_of(run(count, "fit", dt=dt))
    pieces = whole.with_splits().experiments
    times = np.concatenate([p.t for p in pieces])
    assert len(np.unique(times)) == len(times) and set(times) <= set(whole.experiments[0].t)
    for a, b in zip(pieces[:-1], pieces[1:], strict=True):
        gap, rest = (
            b.t[0] - a.t[-1],
            pieces[-1].t[-1] - a.t[-1],
        )  # of what is over soon a third at most
        assert gap >= 20 * dt * (1 - 1e-9) and gap >= min(0.1, rest / 3 - dt) - 1e-9
    assert all(len(p) >= 20 for p in pieces)


# arrays and frames


def signals(count: int = 100):
    t = 0.01 * np.arange(count)
    return t, np.sin(5 * t), 0.2 * np.cos(3 * t)


def test_arrays_in_three_lines():
    t, tau, q = signals()
    dataset = Dataset.from_arrays(t, {"tau": tau}, {"q": q}, noise_std={"q": 1e-3}, at_rest=True)
    assert dataset.channels == (Channel("tau", "input", "N m"), Channel("q", "output", "rad", 1e-3))
    np.testing.assert_array_equal(dataset.experiments[0].y[:, 0], q)
    assert (
        dataset.experiments[0].at_rest
        and dataset.experiments[0].name == "data"
        and len(dataset.sha256) == 64
    )


def test_several_runs_of_arrays():
    t, tau, q = signals()
    dataset = Dataset.from_arrays(
        [t, t],
        {"tau": [tau, 2 * tau]},
        {"q": [np.rad2deg(q), np.rad2deg(2 * q)]},
        units={"q": "deg"},
        split=["fit", "validation"],
        initial=[{"q": 0.2}, None],
        model="arm",
        check_model=False,
        constants={"gravity": np.float64(9.8)},
    )
    first, second = dataset.experiments
    assert (first.name, second.name, second.split) == ("run_1", "run_2", "validation")
    assert (
        first.initial == {"q": 0.2}
        and second.initial is None
        and first.constants == {"gravity": 9.8}
    )
    np.testing.assert_allclose(second.y[:, 0], 2 * q)


def test_free_motion_of_arrays():
    t, _, q = signals()
    dataset = Dataset.from_arrays(t.tolist(), outputs={"q": q.tolist()})
    assert dataset.experiments[0].u.shape == (100, 0) and dataset.model == ModelSpec(free=True)


def nan_at(values: np.ndarray, index: int) -> np.ndarray:
    values = values.copy()
    values[index] = np.nan
    return values


T, TAU, Q = signals()
ARRAYS = {
    "missing sample": (lambda: Dataset.from_arrays(T, {"tau": TAU}, {"q": nan_at(Q, 7)}), ("data", 7, "q"), "index 7 is missing"),
    "length": (lambda: Dataset.from_arrays(T, {"tau": TAU[:-1]}, {"q": Q}), ("data", None, "tau"), "99 samples"),
    "shape": (lambda: Dataset.from_arrays(T, {"tau": TAU[:, None]}, {"q": Q}), ("data", None, "tau"), "shape (100, 1)"),
    "complex": (lambda: Dataset.from_arrays(T, {"tau": TAU * 1j}, {"q": Q}), ("data", None, "tau"), "complex"),
    "time": (lambda: Dataset.from_arrays(T[::-1], {"tau": TAU}, {"q": Q}), ("data", 1, "t"), "backwards"),
    "no unit": (lambda: Dataset.from_arrays(T, {"x": TAU}, {"q": Q}), ("data", None, "x"), "unit is not stated"),
    "unit of nothing": (lambda: Dataset.from_arrays(T, {"tau": TAU}, {"q": Q}, units={"w": "rad"}), ("data", None, "w"), "not there"),
    "two roles": (lambda: Dataset.from_arrays(T, {"q": TAU}, {"q": Q}), ("data", None, "q"), "two roles"),
    "runs": (lambda: Dataset.from_arrays([T, T], {"tau": [TAU]}, {"q": [Q, Q]}), ("data", None, "tau"), "2 runs"),
    "settings": (lambda: Dataset.from_arrays(T, {"tau": TAU}, {"q": Q}, split=["fit", "fit"]), ("data", None, None), "2 values for 1 run"),
    "split": (lambda: Dataset.from_arrays(T, {"tau": TAU}, {"q": Q}, split="train"), ("data", None, "experiments[1].split"), "'train'"),
    "noise": (lambda: Dataset.from_arrays(T, {"tau": TAU}, {"q": Q}, noise_std={"q": -1.0}), ("data", None, "channels.q.noise_std"), "-1.0"),
    "nothing measured": (lambda: Dataset.from_arrays(T, {"tau": TAU}), ("data", None, "channels"), 'role = "output"'),
    "run's own name": (lambda: Dataset.from_arrays([T, T], {"tau": [TAU, nan_at(TAU, 3)]}, {"q": [Q, Q]}), ("run_2", 3, "tau"), "missing"),
}  # fmt: skip


@pytest.mark.parametrize("name", ARRAYS)
def test_broken_arrays(name):
    call, place, words = ARRAYS[name]
    with pytest.raises(DatasetError) as caught:
        call()
    assert len(caught.value.problems) == 1, str(caught.value)
    problem = caught.value.problems[0]
    assert (problem.file, problem.row, problem.column) == place and words in problem.message, str(
        problem
    )


def test_an_unknown_argument_is_named():
    with pytest.raises(TypeError, match="did you mean 'noise_std'"):
        Dataset.from_arrays(T, {"tau": TAU}, {"q": Q}, noise_sdt={"q": 1.0})


def test_frames_of_pandas_and_pyarrow():
    table = pa.table({"time": T, "motor": TAU, "q": np.rad2deg(Q)})
    settings: dict[str, Any] = dict(
        inputs={"tau": "motor"}, outputs=["q"], time="time", units={"q": "deg"}
    )
    one = Dataset.from_frame(table, **settings)
    two = Dataset.from_frame([table, table], split=["fit", "report"], **settings)
    np.testing.assert_allclose(one.experiments[0].y[:, 0], Q)
    assert two.experiments[1].split == "report"
    with pytest.raises(DatasetError, match="did you mean 'motor'"):
        Dataset.from_frame(table, {"tau": "motr"}, ["q"], time="time")
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    frame = pandas.DataFrame({"time": T, "motor": TAU, "q": np.rad2deg(Q)}, index=T + 5)
    assert Dataset.from_frame(frame, **settings) == one


# saving

word = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), min_size=1, max_size=12
).filter(str.strip)
value = st.floats(-1e6, 1e6)


@st.composite
def datasets(draw) -> Dataset:
    count = draw(st.integers(20, 40))
    free = draw(st.booleans())
    inputs = (
        ()
        if free
        else (Channel("tau", "input", "N m", hold=draw(st.sampled_from(["zero", "linear"]))),)
    )
    width = st.none() | st.floats(1e-6, 1.0)
    outputs = tuple(
        Channel(f"q{i + 1}", "output", "rad", draw(width), draw(width))
        for i in range(draw(st.integers(1, 2)))
    )
    extra = (Channel("temperature1", "auxiliary", "K"),) if draw(st.booleans()) else ()
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    names = draw(st.lists(word, min_size=1, max_size=3, unique=True))
    runs = tuple(
        Experiment(
            name,
            "fit" if i == 0 else draw(st.sampled_from(["fit", "validation", "report"])),
            np.cumsum(rng.uniform(0.01, 0.02, count)),
            rng.standard_normal((count, len(inputs))),
            rng.standard_normal((count, len(outputs))),
            {c.name: rng.standard_normal(count) for c in extra},
            at_rest=(rest := draw(st.booleans())),
            initial=None if rest else draw(st.none() | st.just({"q1": 0.5, "qd1": -1.0})),
            constants=draw(st.dictionaries(st.sampled_from(["payload", "supply"]), value)),
            initial_window_s=draw(st.none() | st.floats(0.01, 1.0)),
        )
        for i, name in enumerate(names)
    )
    omega = np.sort(rng.uniform(0.1, 100, 5))
    gain = rng.standard_normal(5) + 1j * rng.standard_normal(5)
    responses = (
        () if free else (FrequencyResponse("\u2192 response", "report", omega, gain, "tau", "q1"),)
    )
    spec = ModelSpec(
        draw(st.none() | st.just("arm")),
        draw(st.sampled_from([(), ("coulomb_friction",)])),
        free,
        draw(st.dictionaries(st.sampled_from(["gravity", "inertia"]), value)),
        draw(st.sampled_from([{}, {"viscous": ParameterPrior(0.1, None, 2.0)}])),
    )
    controller = draw(
        st.none() | st.just(Controller("pd", {"kp": [1.0, 2.0], "sample_time": 1e-3}))
    )
    source = draw(st.none() | word | st.just({"source": "a bench", "licence": "CC0"}))
    description = draw(
        st.text(st.characters(codec="utf-8", exclude_categories=("Cs",)), max_size=20)
    )
    return Dataset(
        draw(word), inputs + outputs + extra, runs, responses, spec, controller, description, source
    )


@given(dataset=datasets(), form=st.sampled_from(["parquet", "csv"]))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_saved_is_loaded(tmp_path_factory, dataset, form):
    target = tmp_path_factory.mktemp("saved") / "d"
    save_dataset(dataset, target, format=form)
    assert load_dataset(target, check_model=False) == dataset


def test_saving_overwrites_only_when_told_so(tmp_path):
    dataset = Dataset.from_arrays(T, {"tau": TAU}, {"q": Q})
    other = Dataset.from_arrays(T, {"tau": TAU}, {"q": 2 * Q})
    target = tmp_path / "a" / "d"
    assert save_dataset(dataset, target) == target
    save_dataset(dataset, target)
    with pytest.raises(DatasetError, match="overwrite=True"):
        save_dataset(other, target)
    assert load_dataset(target) == dataset
    save_dataset(other, target, overwrite=True)
    assert load_dataset(target) == other
    assert [p.name for p in target.parent.iterdir()] == ["d"]
    (tmp_path / "file").write_text("x")
    for place in (tmp_path / "file", tmp_path / "file" / "d"):
        with pytest.raises(DatasetError):
            save_dataset(dataset, place, overwrite=True)
    with pytest.raises(ValueError, match="xlsx"):
        save_dataset(dataset, tmp_path / "b", format="xlsx")


def test_a_failed_save_leaves_nothing(tmp_path):
    dataset = Dataset.from_arrays(T, {"tau": TAU}, {"q": Q})
    bad = replace(
        dataset, experiments=(replace(dataset.experiments[0], auxiliary={"x": np.zeros(3)}),)
    )
    with pytest.raises((ValueError, pa.ArrowInvalid)):
        save_dataset(bad, tmp_path / "d")
    assert list(tmp_path.iterdir()) == []


def test_errors_survive_pickling():
    error = DatasetError([DatasetProblem("a.csv", 3, "q", "is bad", "Mend it")])
    again = pickle.loads(pickle.dumps(error))
    assert (
        str(again) == str(error) == "a.csv, row 3, column q: is bad. Mend it"
        and again.problems == error.problems
    )


# recordings of others, where they are at hand

RECORDINGS = {
    "emps": (2, 24841, ("force",), ("position",)),
    "multiarm_single_pendulum": (2, 36668, (), ("q",)),
    "panda_exciting": (
        2,
        13778,
        tuple(f"tau{i}" for i in range(1, 8)),
        tuple(f"q{i}" for i in range(1, 8)),
    ),
    "ur10e": (3, 2875, tuple(f"tau{i}" for i in range(1, 7)), tuple(f"q{i}" for i in range(1, 7))),
}


@pytest.mark.filterwarnings("ignore::jaxid.base.errors.DatasetWarning")
@pytest.mark.parametrize("name", RECORDINGS)
def test_real_recordings_load(name):
    if not (DATA / name / "dataset.toml").is_file():
        pytest.skip(f"{name} is not in {DATA}: set JAXID_DATA to the folder of recordings")
    count, samples, inputs, outputs = RECORDINGS[name]
    dataset = load_dataset(DATA / name, check_model=False)
    assert len(dataset.experiments) == count and len(dataset.experiments[0]) == samples
    assert (
        tuple(c.name for c in dataset.inputs) == inputs
        and tuple(c.name for c in dataset.outputs) == outputs
    )
    assert {e.split for e in dataset.with_splits().experiments} == {"fit", "validation", "report"}


def test_where_on_a_real_recording(tmp_path):
    source = DATA / "xl330_pendulum" / "xl330.parquet"
    if not source.is_file():
        pytest.skip(f"xl330_pendulum is not in {DATA}: set JAXID_DATA to the folder of recordings")
    (tmp_path / "xl330.parquet").write_bytes(source.read_bytes())
    logs = list(dict.fromkeys(pq.read_table(source).column("log").to_pylist()))
    experiments = "".join(
        f'[[experiments]]\nfile = "xl330.parquet"\nwhere = {{ log = {json.dumps(x)} }}\n'
        for x in logs
    )
    (tmp_path / "dataset.toml").write_text(
        'name = "xl330"\n[channels.q_cmd]\ncolumn = "q_goal_rad"\nrole = "input"\nunit = "rad"\n'
        '[channels.q]\ncolumn = "q_rad"\nrole = "output"\nunit = "rad"\n' + experiments
    )
    dataset = load_dataset(tmp_path)
    assert len(dataset.experiments) == 12 and sum(map(len, dataset.experiments)) == 14603
