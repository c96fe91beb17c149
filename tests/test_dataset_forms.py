# ruff: noqa: E501 (tables of cases, one a line)
"""What `dataset.toml` may say of how a channel was recorded: each form undoes what was done to it,
alone and together.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, HealthCheck, settings, strategies as st

from jaxid.base.errors import DatasetError
from jaxid.data.dataset import Dataset
from jaxid.data.forms import glitches
from jaxid.data.io import load_dataset, save_dataset
from jaxid.data.noise import noise_floor
from jaxid.data.repeats import repeats
from jaxid.data.units import conversion


T = np.arange(400) * 0.01
Q = 4 * np.sin(1.3 * T) + T
TAU = np.round(np.cos(3 * T), 1)


def write(
    folder: Path,
    columns: dict,
    channels: dict[str, str],
    top: str = "",
    run: str = "",
    file: str = "run.csv",
) -> Path:
    folder.mkdir(exist_ok=True)
    if file.endswith(".parquet"):
        pq.write_table(pa.table(columns), folder / file)
    elif file:
        pd.DataFrame(columns).to_csv(folder / file, index=False)
    text = f'name = "a"\n{top}\n'
    for name, more in channels.items():
        role, unit = ("input", "N m") if name.startswith("tau") else ("output", "rad")
        text += f'[channels."{name}"]\n' + ("" if "role" in more else f'role = "{role}"\n')
        text += ("" if "unit" in more else f'unit = "{unit}"\n') + more + "\n"
    text += f"[[experiments]]\n{run or f'file = {file!r}'}\n"
    (folder / "dataset.toml").write_text(text, encoding="utf-8")
    return folder


def load(folder: Path) -> Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_dataset(folder, check_model=False)


def refused(folder: Path) -> str:
    with pytest.raises(DatasetError) as caught:
        load(folder)
    return str(caught.value)


# ---- time


@pytest.mark.parametrize(("unit", "per_second"), [("s", 1), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_a_unit_of_time(tmp_path, unit, per_second):
    folder = write(
        tmp_path / unit,
        {"t": np.round(T * per_second, 6), "tau": TAU, "q": Q},
        {"tau": "", "q": ""},
        f'time_unit = "{unit}"',
    )
    np.testing.assert_allclose(load(folder).experiments[0].t, T, atol=1e-12)


@pytest.mark.parametrize(
    ("per_second", "words"),
    [
        (1e3, 'is t in ms? say time_unit = "ms"'),
        (1e6, 'is t in us? say time_unit = "us"'),
        (1e9, "is t in ns?"),
        (1e-6, "shorter than any"),
    ],
)
def test_time_that_cannot_be_seconds_is_refused(tmp_path, per_second, words):
    message = refused(
        write(tmp_path / "d", {"t": T * per_second, "tau": TAU, "q": Q}, {"tau": "", "q": ""})
    )
    assert words in message and "run.csv, row 2, column t" in message


@pytest.mark.parametrize(("unit", "digits"), [("s", 0), ("ms", 3), ("us", 6), ("ns", 9)])
def test_a_clock_that_counts_from_1970_keeps_its_nanoseconds(tmp_path, unit, digits):
    start, step = 1_767_225_600 * 10**digits, max(1, 10 ** (digits - 2))
    t = start + step * np.arange(400)
    columns = {"t": t, "tau": TAU, "q": Q}
    assert f'time_unit = "{unit}"' in refused(write(tmp_path / "d", columns, {"tau": "", "q": ""}))
    for file in ("run.csv", "run.parquet"):
        data = load(
            write(
                tmp_path / file, columns, {"tau": "", "q": ""}, f'time_unit = "{unit}"', file=file
            )
        )
        np.testing.assert_allclose(
            data.experiments[0].t, step / 10**digits * np.arange(400), rtol=1e-12, atol=1e-12
        )
        assert any("2026-01-01" in n for n in data.notes)


def test_dates_are_times(tmp_path):
    stamps = pd.Timestamp("2026-01-01T10:00:00.5") + pd.to_timedelta(T, unit="s")
    files = {"run.csv": [s.isoformat() + "+01:00" for s in stamps], "run.parquet": pa.array(stamps)}
    for file, t in files.items():
        data = load(
            write(tmp_path / file, {"t": t, "tau": TAU, "q": Q}, {"tau": "", "q": ""}, file=file)
        )
        np.testing.assert_allclose(data.experiments[0].t, T, atol=1e-9)


def test_frames_with_dates_and_durations():
    frame = pd.DataFrame({"t": pd.to_timedelta(T, unit="s"), "tau": TAU, "q": Q})

    def take(f):
        return Dataset.from_frame(f, ["tau"], ["q"]).experiments[0].t

    np.testing.assert_allclose(take(frame), T, atol=1e-9)
    dated = frame.assign(t=pd.Timestamp("2026-01-01") + frame["t"])
    np.testing.assert_allclose(take(dated), T, atol=1e-9)
    with pytest.raises(DatasetError, match=r"reset_index\(\)"):
        take(dated.set_index("t"))
    with pytest.raises(DatasetError, match='time_unit = "ms"'):
        take(frame.assign(t=1e3 * T))
    np.testing.assert_allclose(
        Dataset.from_arrays(1e3 * T, {"tau": TAU}, {"q": Q}, time_unit="ms").experiments[0].t, T
    )


# ---- channels


def test_rows_that_belong_earlier(tmp_path):
    late = np.concatenate([[0.0], TAU[:-1]])
    data = load(write(tmp_path / "d", {"t": T, "tau": late, "q": Q}, {"tau": "shift = 1", "q": ""}))
    (run,) = data.experiments
    assert len(run) == 399 and any("1 sample at the ends left out" in n for n in data.notes)
    np.testing.assert_array_equal(run.u[:, 0], TAU[:-1])
    np.testing.assert_array_equal(run.t, T[:-1])
    early = load(
        write(
            tmp_path / "e",
            {"t": T, "tau": np.append(TAU[1:], 9.0), "q": Q},
            {"tau": "shift = -1", "q": ""},
        )
    )
    np.testing.assert_array_equal(early.experiments[0].u[:, 0], TAU[1:])


def test_a_delay_of_whole_rows_is_a_shift_and_an_input_keeps_its_impulse(tmp_path):
    late = np.concatenate([[0.0, 0.0], TAU[:-2]])
    whole = load(
        write(tmp_path / "d", {"t": T, "tau": late, "q": Q}, {"tau": "delay_s = 0.02", "q": ""})
    ).experiments[0]
    np.testing.assert_allclose(whole.u[:, 0], TAU[:-2], atol=1e-9)
    part = load(
        write(tmp_path / "e", {"t": T, "tau": TAU, "q": Q}, {"tau": "delay_s = 0.004", "q": ""})
    ).experiments[0]
    n = len(part)
    np.testing.assert_allclose(
        part.u[:-1, 0], 0.6 * TAU[: n - 1] + 0.4 * TAU[1:n], atol=1e-9
    )  # means of the held signal


def test_a_clock_that_runs_fast(tmp_path):
    fast = 4 * np.sin(1.3 * T / (1 + 5e-3)) + T / (
        1 + 5e-3
    )  # sampled by a clock that shows T too early
    run = load(
        write(tmp_path / "d", {"t": T, "tau": TAU, "q": fast}, {"tau": "", "q": "clock_ppm = 5000"})
    ).experiments[0]
    inside = slice(0, len(run) - 1)
    assert len(run) > 395
    np.testing.assert_allclose(
        run.y[inside, 0], Q[: len(run)][inside], atol=2e-4
    )  # on the lines between samples


@pytest.mark.parametrize(
    ("unit", "raw", "form"),
    [
        ("rad", (Q + np.pi) % (2 * np.pi) - np.pi, "unwrap = true"),
        ("deg", np.degrees(Q) % 360, "unwrap = true"),
        ("deg", np.floor(np.degrees(Q) / 360 * 4096) % 4096, "scale = 0.087890625\nunwrap = true"),
        ("rad", np.floor(Q * 1000) % 5000, "scale = 0.001\nunwrap = 5000"),
    ],
)
def test_wrapped_angles(tmp_path, unit, raw, form):
    channels = {"tau": "", "q": f'unit = "{unit}"\n{form}'}
    run = load(write(tmp_path / "d", {"t": T, "tau": TAU, "q": raw}, channels)).experiments[0]
    off = run.y[:, 0] - Q
    turn = 5.0 if "5000" in form else 2 * np.pi
    assert np.ptp(off) < 2e-3 and abs(off.mean() / turn - round(off.mean() / turn)) < 1e-3


def test_a_wrapped_length_needs_its_range(tmp_path):
    message = refused(
        write(
            tmp_path / "d",
            {"t": T, "tau": TAU, "q": Q},
            {"tau": "", "q": 'unit = "m"\nunwrap = true'},
        )
    )
    assert "not an angle" in message and "unwrap = 4096" in message


def test_glitches_are_left_out_of_the_loss_and_stay_in_the_data(tmp_path):
    bad = np.random.default_rng(0).choice(np.arange(10, 390, 9), 25, replace=False)
    for k, value in enumerate((0.0, 65535.0)):
        q = Q.copy()
        q[bad] = value
        data = load(
            write(
                tmp_path / str(k),
                {"t": T, "tau": TAU, "q": q},
                {"tau": "", "q": "drop_glitches = true"},
            )
        )
        (run,) = data.experiments
        np.testing.assert_array_equal(
            np.flatnonzero(~run.read[:, 0]), np.sort(bad[np.abs(Q[bad] - value) > 0.05])
        )
        np.testing.assert_array_equal(run.y[:, 0], q)  # nothing is filled in
        assert np.isinf(run.noise(np.array([1e-3]), [0])[~run.read]).all()
        assert np.abs(run.motion()[:, 0] - Q).max() < 0.01
        assert load(save_dataset(data, tmp_path / f"saved{k}")) == data
        assert noise_floor(data)["q"].std < 1e-3


def test_an_input_holds_its_last_good_sample_through_a_glitch(tmp_path):
    torn = np.cos(3 * T)
    torn[[50, 200]] = 1000.0
    data = load(
        write(
            tmp_path / "d", {"t": T, "tau": torn, "q": Q}, {"tau": "drop_glitches = true", "q": ""}
        )
    )
    (run,) = data.experiments
    np.testing.assert_array_equal(run.u[[50, 200], 0], torn[[49, 199]])
    assert run.read.all() and any("2 of 400 samples of tau not taken" in n for n in data.notes)


def test_what_is_no_glitch():
    noise = np.random.default_rng(1).standard_normal(20_000)
    jump, bounce = np.where(T < 2, 0.0, 1.0), np.abs(np.sin(9 * T))
    flicker = (np.random.default_rng(2).random(5000) < 0.003) * 1.0
    for signal in (noise, jump, bounce, Q, np.round(Q / 1.5e-3), flicker, np.zeros(100)):
        assert not glitches(signal, 0.01 * np.arange(len(signal))).any()


def test_an_output_that_is_sampled_more_slowly_than_it_is_logged(tmp_path):
    slow = Q[3::10].repeat(10)
    q = np.concatenate([Q[:1].repeat(3), slow])[:400]
    data = load(
        write(tmp_path / "d", {"t": T, "tau": TAU, "q": q}, {"tau": "", "q": "sampled_every = 10"})
    )
    np.testing.assert_array_equal(
        np.flatnonzero(data.experiments[0].read[:, 0]), np.arange(3, 400, 10)
    )
    assert "stays for 10 rows" in refused(
        write(tmp_path / "e", {"t": T, "tau": TAU, "q": q}, {"tau": "", "q": "sampled_every = 7"})
    )


def test_a_column_that_says_which_readings_count(tmp_path):
    valid = (np.arange(400) % 5 > 0).astype(int)
    q = [v if ok else None for v, ok in zip(Q, valid, strict=True)]
    data = load(
        write(
            tmp_path / "d",
            {"t": T, "tau": TAU, "q": q, "ok": valid},
            {"tau": "", "q": 'valid = "ok"'},
        )
    )
    np.testing.assert_array_equal(data.experiments[0].read[:, 0], valid == 1)


def test_a_gear_matrix(tmp_path):
    columns = {"t": T, "m5": TAU, "m6": 0.5 * TAU + 0.1, "q": Q}
    data = load(
        write(
            tmp_path / "d",
            columns,
            {"tau": 'columns = ["m5", "m6"]\nweights = [32.0, -16.0]\nscale = 0.5', "q": ""},
        )
    )
    np.testing.assert_allclose(
        data.experiments[0].u[:, 0], 0.5 * (32 * TAU - 16 * (0.5 * TAU + 0.1))
    )
    assert "go together" in refused(
        write(tmp_path / "e", columns, {"tau": 'columns = ["m5", "m6"]', "q": ""})
    )
    assert "2 columns have 1 weights" in refused(
        write(tmp_path / "f", columns, {"tau": 'columns = ["m5", "m6"]\nweights = [1.0]', "q": ""})
    )


# ---- patterns and numbers


@pytest.mark.parametrize("names", [["1", "2", "3"], ["0", "1", "2"]])
def test_a_table_for_all_joints_by_number(tmp_path, names):
    columns = (
        {"t": T}
        | {f"pos_{n}": Q + k for k, n in enumerate(names)}
        | {f"eff_{n}": TAU + k for k, n in enumerate(names)}
    )
    data = load(
        write(tmp_path / "d", columns, {"tau*": 'column = "eff_*"', "q*": 'column = "pos_*"'})
    )
    assert [c.name for c in data.channels] == ["tau1", "tau2", "tau3", "q1", "q2", "q3"]
    np.testing.assert_allclose(data.experiments[0].y, np.stack([Q, Q + 1, Q + 2], 1))


def test_a_table_for_all_joints_by_name(tmp_path):
    columns = {"t": T, "pos_pan": Q, "eff_lift": TAU, "pos_lift": Q + 1, "eff_pan": TAU + 1}
    data = load(
        write(tmp_path / "d", columns, {"q*": 'column = "pos_*"', "tau*": 'column = "eff_*"'})
    )
    assert data.model is not None and data.model.joints == {"q1": "pan", "q2": "lift"}
    np.testing.assert_allclose(
        data.experiments[0].u, np.stack([TAU + 1, TAU], 1)
    )  # tau1 is of the joint of q1
    assert load(save_dataset(data, tmp_path / "saved")) == data
    message = refused(
        write(tmp_path / "e", columns, {"q*": 'column = "angle_*"', "tau*": 'column = "eff_*"'})
    )
    assert "no column matches 'angle_*'" in message and "pos_pan" in message


def test_list_columns(tmp_path):
    both = np.stack([Q, Q + 1], 1)
    for file, cells in (
        ("run.parquet", both.tolist()),
        ("run.csv", [str(list(map(float, r))) for r in both]),
    ):
        folder = write(
            tmp_path / file,
            {"t": T, "tau": TAU, "p": cells},
            {"tau": "", "q*": 'column = "p[*]"'},
            file=file,
        )
        np.testing.assert_allclose(load(folder).experiments[0].y, both)


def test_files_without_a_header(tmp_path):
    folder = write(
        tmp_path / "d",
        {},
        {"tau": "column = 3", "q": "column = 2"},
        "time = 1",
        run='file = "run.csv"',
        file="",
    )
    np.savetxt(folder / "run.csv", np.column_stack([T, Q, TAU]), delimiter=",")
    np.testing.assert_allclose(load(folder).experiments[0].y[:, 0], Q)
    assert "the file has 3" in refused(
        write(
            folder, {}, {"tau": "column = 4", "q": "column = 2"}, "time = 1", 'file = "run.csv"', ""
        )
    )
    assert "time = 1" in refused(
        write(folder, {}, {"tau": "", "q": ""}, "", 'file = "run.csv"', "")
    )


def test_a_run_a_file(tmp_path):
    folder = write(
        tmp_path / "d",
        {"t": T, "tau": TAU, "q": Q},
        {"tau": "", "q": ""},
        run='files = "run_*.csv"\nat_rest = true',
        file="",
    )
    for k in (1, 2, 10):
        pd.DataFrame({"t": T, "tau": TAU, "q": Q + k}).to_csv(folder / f"run_{k}.csv", index=False)
    data = load(folder)
    assert [e.name for e in data.experiments] == ["run_1", "run_2", "run_10"] and all(
        e.at_rest for e in data.experiments
    )
    (folder / "run_2.csv").write_text("t,tau\n0,1\n")
    assert "run_2.csv" in refused(folder)
    (folder / "dataset.toml").write_text(
        (folder / "dataset.toml").read_text().replace("run_*", "runs_*")
    )
    assert "matches no file (there is: run_1.csv" in refused(folder)


def test_a_column_twice(tmp_path):
    folder = write(tmp_path / "d", {}, {"tau": "", "q": ""}, run='file = "run.csv"', file="")
    same = "\n".join(f"{t},{q},{t},{u}" for t, q, u in zip(T, Q, TAU, strict=True))
    (folder / "run.csv").write_text("t,q,t,tau\n" + same)
    np.testing.assert_allclose(load(folder).experiments[0].t, T)  # equal columns are one
    (folder / "run.csv").write_text("t,q,q,tau\n" + same)
    assert (
        "'q' stands twice (columns 2 and 3, which differ). Name one by its number: column = 2"
        in refused(folder)
    )


def test_rows_are_chosen_before_anything_is_judged(tmp_path):
    folder = write(
        tmp_path / "d", {}, {"tau": "", "q": ""}, run='file = "run.csv"\nrows = [2, 402]', file=""
    )
    body = "\n".join(f"{t},{q},{u}" for t, q, u in zip(T, Q, TAU, strict=True))
    (folder / "run.csv").write_text(f"t,q,tau\nstart\n0,x,y,z\n{body}\n5,,\n")
    assert len(load(folder).experiments[0]) == 400
    (folder / "dataset.toml").write_text(
        (folder / "dataset.toml").read_text().replace("[2, 402]", "[1, 402]")
    )
    assert "row 3: 4 fields where the header has 3" in refused(folder)


def test_repeats_are_stated(tmp_path):
    folder = write(
        tmp_path / "d",
        {"t": T, "tau": TAU, "q": Q},
        {"tau": "", "q": ""},
        run='file = "run.csv"\n[[experiments]]\nfile = "b.csv"\nrepeat_of = "run"',
    )
    pd.DataFrame({"t": T, "tau": TAU + 0.01, "q": Q + 0.01}).to_csv(folder / "b.csv", index=False)
    data = load(folder)
    assert [len(g) for g in repeats(data.experiments)] == [2]
    assert load(save_dataset(data, tmp_path / "saved")) == data
    (folder / "dataset.toml").write_text(
        (folder / "dataset.toml").read_text().replace('of = "run"', 'of = "rum"')
    )
    assert "no run 'rum' to repeat (did you mean 'run'?)" in refused(folder)


@pytest.mark.parametrize(
    ("file", "shown"),
    [
        (r'"C:\Users\me\run.csv"', "C:/Users/me/run.csv"),
        (r'"sub\run.csv"', "sub/run.csv"),
        (r"'sub\run.csv'", "sub/run.csv"),
    ],
)
def test_paths_of_windows(tmp_path, file, shown):
    folder = write(tmp_path / "d", {}, {"tau": "", "q": ""}, run=f"file = {file}", file="")
    (folder / "sub").mkdir()
    pd.DataFrame({"t": T, "tau": TAU, "q": Q}).to_csv(folder / "sub" / "run.csv", index=False)
    message = refused(folder)
    assert "forward slashes" in message and shown in message


# ---- together


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    scale=st.floats(0.01, 100).flatmap(lambda v: st.sampled_from([v, -v])),
    offset=st.floats(-10, 10),
    unit=st.sampled_from(["rad", "deg", "rev", "mrad"]),
    wrap=st.booleans(),
    shift=st.integers(-5, 5),
    weights=st.lists(st.floats(0.5, 4), min_size=1, max_size=3),
    time_unit=st.sampled_from(["s", "ms", "us"]),
    every=st.sampled_from([1, 1, 4]),
)
def test_forms_compose_and_survive_saving(
    tmp_path, scale, offset, unit, wrap, shift, weights, time_unit, every
):
    """A signal that was wrapped, put into a unit, scaled, shifted and spread over columns comes
    back as it was.
    """
    to = conversion(unit)
    stated = Q / to.factor
    if wrap:
        turn = 2 * np.pi / to.factor
        stated = stated % turn
    stated = stated[np.arange(400) // every * every]
    raw = np.roll((stated - offset) / scale, shift)
    parts = np.random.default_rng(0).standard_normal((len(weights) - 1, 400))
    last = (
        raw - sum((w * p for w, p in zip(weights, parts, strict=False)), np.zeros(400))
    ) / weights[-1]
    columns = {f"m{k}": p for k, p in enumerate([*parts, last])}
    form = f"columns = {list(columns)}\nweights = {weights}\nscale = {scale!r}\noffset = {offset!r}\nunit = '{unit}'\nshift = {shift}\n"
    form += ("unwrap = true\n" if wrap else "") + f"sampled_every = {every}\n"
    if every > 1:  # the last value must stay equal to the bit, so that what repeats can be told
        columns, form = (
            {"m0": raw},
            form.replace(f"columns = {list(columns)}\nweights = {weights}", "column = 'm0'"),
        )
    t = T * {"s": 1, "ms": 1e3, "us": 1e6}[time_unit]
    folder = write(
        tmp_path / "d",
        {"t": t, "tau": TAU} | columns,
        {"tau": "", "q": form},
        f'time_unit = "{time_unit}"',
    )
    data = load(folder)
    (run,) = data.experiments
    assert len(run) == 400 - abs(shift)
    at = np.arange(max(0, -shift), 400 - max(0, shift))
    off = (run.y[:, 0] - Q[at])[run.read[:, 0]]
    turns = np.round(off.mean() / (2 * np.pi)) if wrap else 0
    np.testing.assert_allclose(off, 2 * np.pi * turns, atol=1e-7)
    assert run.read.sum() >= (400 - abs(shift)) // every
    again = load(save_dataset(data, tmp_path / "saved", overwrite=True))
    assert again == data
