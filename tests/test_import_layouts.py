# ruff: noqa: E501 (tables of cases, one a line)
"""Layouts of tables that programs write by habit: headers of several rows, printed arrays, clocks,
lists of recordings; and what is proposed or refused of them.
"""

from __future__ import annotations

import shlex

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from jaxid.base.errors import DatasetError, UsageError
from jaxid.cli.app import main
from jaxid.data.dataset import Dataset
from test_import_tables import PLAIN, Q, run, same, T, TAU, text


CLOCKED = ("t=t", *PLAIN[1:])


def rows(pattern: str, header: str) -> str:
    """One row a sample: `t`, `q`, `tau` of a pattern."""
    return "\n".join(
        [
            header,
            *(pattern.format(t=t, q=q, tau=tau) for t, q, tau in zip(T, Q, TAU, strict=True)),
            "",
        ]
    )


LAYOUTS = {
    "levels of pandas": (text(header="").replace("0.0,", "signal,joint1,joint1\n,position,effort\n0.0,", 1), ("t=signal:s", "q=joint1.position:rad", "tau=joint1.effort:N m")),
    "levels and a name of the index": (text(header="").replace("0.0,", ",pos,tau\n,j1,j1\nt,,\n0.0,", 1), ("t=t:s", "q=pos.j1:rad", "tau=tau.j1:N m")),
    "merged cells": (rows("{t};{q};{q};{tau}", "time;arm;;drive\nt;q;q2;tau"), ("t=t:s", "q=q:rad", "tau=tau:N m")),
    "units in square brackets": (text(separator=";", decimal=",", header="t,q,tau\n[s],[rad],[Nm]".replace(",", ";")), ("t=t", "q=q", "tau=tau")),
    "arrays as NumPy prints them": (rows("{t},[{q} {q}],[{tau}]", "t,pos,eff"), ("t=t:s", "q=pos[0]:rad", "tau=eff[0]:N m")),
    "arrays as Python prints them": (rows("{t},\"array([{q}, 0.], dtype=float32)\",\"array('d', [{tau}])\"", "t,pos,eff"), ("t=t:s", "q=pos[0]:rad", "tau=eff[0]:N m")),
    "time of day": (rows("12:59:5{t:.2f},{q},{tau}", "t,q,tau"), CLOCKED),
    "day, month, year": (rows("01.03.2026 12:00:0{t:.2f};{q};{tau}", "t;q;tau"), CLOCKED),
    "one date between slashes": (rows("3/1/2026 12:00:0{t:.2f},{q},{tau}", "t,q,tau"), CLOCKED),
}  # fmt: skip


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_of_habit(tmp_path, name):
    content, channels = LAYOUTS[name]
    (tmp_path / "log.csv").write_text(content)
    same(run(tmp_path / "log.csv", tmp_path / "out", channels)[0])


def test_midnight_and_dates_that_cannot_be_told(tmp_path):
    days = [
        f"28.02.2026 23:59:59.{k:02d}" if k < 100 else f"01.03.2026 00:00:00.{k - 100:02d}"
        for k in range(40, 160)
    ]
    (tmp_path / "a.csv").write_text(
        "\n".join(["t,q,tau", *(f"{d},{k % 7},{k % 5}" for k, d in enumerate(days)), ""])
    )
    data, _ = run(tmp_path / "a.csv", tmp_path / "a", CLOCKED)
    np.testing.assert_allclose(data.experiments[0].t, np.arange(120) / 100, atol=1e-9)
    (tmp_path / "b.csv").write_text(
        (tmp_path / "a.csv")
        .read_text()
        .replace("28.02.2026", "2/3/2026")
        .replace("01.03.2026", "3/3/2026")
    )
    with pytest.raises(DatasetError, match="2/3/2026"):
        run(tmp_path / "b.csv", tmp_path / "b", CLOCKED)


def test_a_unit_that_no_clock_can_have_is_refused(tmp_path):
    for unit, scale in (("ns", 10**9), ("us", 10**6), ("ms", 10**3)):
        stamps = np.array([1_767_225_600 * scale + round(t * scale) for t in T])
        (tmp_path / "a.csv").write_text(
            "\n".join(
                ["t,q,tau", *(f"{a},{q},{u}" for a, q, u in zip(stamps, Q, TAU, strict=True)), ""]
            )
        )
        with pytest.raises(DatasetError, match=f"later than any clock.*--channel t=t:{unit}"):
            run(tmp_path / "a.csv", tmp_path / "out")
        same(run(tmp_path / "a.csv", tmp_path / unit, (f"t=t:{unit}", *PLAIN[1:]))[0])


def test_lists_of_recordings_and_matrices(tmp_path):
    savemat(
        tmp_path / "runs.mat",
        {"run": [{"t": T, "q": Q, "tau": TAU}, {"t": T, "q": -Q, "tau": TAU}]},
    )
    data, _ = run(tmp_path / "runs.mat", tmp_path / "a")
    assert [len(e) for e in data.experiments] == [len(T)] * 2 and np.allclose(
        data.experiments[1].y[:, 0], -Q
    )
    np.save(tmp_path / "matrix.npy", np.column_stack([T, Q, TAU]))
    same(run(tmp_path / "matrix.npy", tmp_path / "b", ("t=1:s", "q=2:rad", "tau=3:N m"))[0])
    np.savez(tmp_path / "deep.npz", t=T, obs=Q[:, None, None], tau=TAU)
    same(run(tmp_path / "deep.npz", tmp_path / "c", ("t=t:s", "q=obs:rad", "tau=tau:N m"))[0])


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        (
            "a.csv",
            text(header="t [ms],q [rad],tau [N m]"),
            "--channel t=t:ms --channel q=q:rad:output --channel 'tau=tau:N m:input'",
        ),
        (
            "b.csv",
            text(np.column_stack([1e6 * T, Q, TAU]), header="t_us,q,tau"),
            "--channel t=t_us:us --channel q=q:1:output --channel tau=tau:1:input",
        ),
        (
            "c.csv",
            text(np.column_stack([1.7e12 + 1e3 * T, Q, TAU]), header="stamp,/js/arm/pos,x"),
            "--channel t=stamp:ms --channel q=/js/arm/pos:1:output --channel x=x:1:auxiliary",
        ),
        (
            "d.csv",
            rows("2026-03-01T12:00:0{t:.2f},RUN,{q},{tau}", "time,state,q,tau"),
            "--channel t=time --channel q=q:1:output --channel tau=tau:1:input",
        ),
        (
            "e.csv",
            rows('{t},"[{q}, {tau}]"', "t,pos"),
            "--channel t=t:s --channel 'q*=pos[*]:1:output'",
        ),
        (
            "f.csv",
            text(header=""),
            "--channel t=1:s --channel channel_2=2:1:output --channel channel_3=3:1:auxiliary",
        ),
        (
            "g.json",
            f'{{"log": {{"fs": 100, "q": {Q.tolist()}}}}}',
            "--channel q=log.q:1:output --out",
        ),
    ],
)
def test_what_is_proposed_has_the_units_of_the_file(tmp_path, name, content, said):
    (tmp_path / name).write_text(content)
    with pytest.raises(UsageError) as caught:
        run(tmp_path / name, tmp_path / "out", ())
    assert said in str(caught.value)
    command = str(caught.value).split("unit: ")[1].split(" (roles")[0]
    assert main([*shlex.split(command)[1:], "--quiet"]) == 0


def test_refusals_of_what_is_packed(tmp_path):
    np.savez(tmp_path / "a.npz", data=np.array({"q": Q}, dtype=object))
    with pytest.raises(DatasetError, match=r"'data' holds Python objects.*numpy.savez"):
        run(tmp_path / "a.npz", tmp_path / "out")
    (tmp_path / "a.csv.gz").write_bytes(b"\x1f\x8b\x08\x00rest")
    with pytest.raises(DatasetError, match="compressed.*gunzip"):
        run(tmp_path / "a.csv.gz", tmp_path / "out")


@pytest.mark.parametrize(
    ("times", "settings", "words"),
    [
        (
            np.where(
                np.arange(60) == 7,
                np.datetime64("NaT"),
                np.datetime64("2026-03-01") + (1e3 * T).astype("timedelta64[ms]"),
            ),
            {},
            "index 7 has no time",
        ),
        (
            (1_767_225_600_000 + 1e3 * T).astype(int),
            {"time_unit": "s"},
            'later than any clock.*time_unit = "ms"',
        ),
    ],
)
def test_times_of_a_frame_that_cannot_be(times, settings, words):
    frame = pd.DataFrame({"t": times, "q": Q, "tau": TAU})
    with pytest.raises(DatasetError, match=words):
        Dataset.from_frame(
            frame, inputs=["tau"], outputs=["q"], units={"tau": "N m", "q": "rad"}, **settings
        )
