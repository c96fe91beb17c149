"""One recording under two names, and repeats that change one way: neither tells anything of
scatter.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import jaxid
from jaxid.conventions.checking import run_check
from jaxid.data.noise import noise_floor
from jaxid.data.repeats import one_way


T = np.arange(800) * 0.005
STEP = 2 * np.pi / 4096


def motion(seed: int = 0, noise: float = 2e-4, size: float = 1.0) -> np.ndarray:
    """A smooth motion with its noise."""
    return size * (np.sin(3 * T) + 0.4 * np.sin(7.3 * T + 1)) + noise * np.random.default_rng(
        seed
    ).standard_normal(len(T))


def recorded(
    *q: np.ndarray,
    splits: tuple[str, ...] = ("fit", "validation"),
    tau: list[np.ndarray] | None = None,
):
    """Runs of a joint under one command, without a model."""
    command = np.round(np.cos(3 * T), 3)
    inputs = tau or [command[: len(x)] for x in q]
    return jaxid.Dataset.from_arrays(
        [T[: len(x)] for x in q],
        {"tau": inputs},
        {"q": list(q)},
        split=list(splits),
        names=["a", "b", "c", "d", "e", "f"][: len(q)],
    )


def found_copies(data: jaxid.Dataset):
    checked = run_check(None, data)
    return [f for f in checked.findings if f.kind == "copy"], checked


def rounded_in_degrees(q: np.ndarray) -> np.ndarray:
    return np.radians(np.round(np.degrees(q), 2))


def of_four_digits(q: np.ndarray) -> np.ndarray:
    return np.array([float(f"{x:.4g}") for x in q])


def one_cell_changed(q: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(q)) == 200, q + 0.3, q)


@pytest.mark.parametrize(
    "copy",
    [
        lambda q: q,
        one_cell_changed,
        lambda q: q[:300],
        rounded_in_degrees,
        lambda q: np.float32(q).astype(float),
        of_four_digits,
    ],
    ids=["whole", "changed", "cut", "rounded", "float32", "digits"],
)
@pytest.mark.parametrize(
    "sensor", [lambda q: q, lambda q: np.round(q / STEP) * STEP], ids=["white", "counts"]
)
def test_a_copy_counts_neither_as_validation_nor_as_repeat(sensor, copy):
    q = sensor(motion())
    (found,), checked = found_copies(recorded(q, copy(q)))
    assert found.channel == "b" and found.applied and "b holds" in found.text and "a" in found.text
    assert checked.mended is not None
    assert [e.name for e in checked.mended.experiments] == ["a"]
    assert noise_floor(checked.mended)["q"].source != "repeatability"


def test_a_copy_without_its_first_row_is_one():
    q, command = motion(), np.round(np.cos(3 * T), 3)
    (found,), _ = found_copies(recorded(q, q[1:], tau=[command, command[1:]]))
    assert found.applied and found.value == len(q) - 1


def test_a_stretch_of_another_run_is_left_out_and_the_rest_is_kept():
    long, tau = motion(size=0.5), np.random.default_rng(3).uniform(-1, 1, len(T))
    data = recorded(long[:500], long[350:], tau=[tau[:500], tau[350:]])
    (found,), checked = found_copies(data)
    assert found.value == 150 and "these samples of b" in found.text
    assert checked.mended is not None
    first, second = checked.mended.experiments
    assert len(first) == 500 and len(second) == 300 and second.y[0, 0] == long[500]


def test_a_copy_under_other_time_stamps_is_one():
    data = recorded(motion(), motion())
    late = replace(data.experiments[1], t=data.experiments[1].t + 12.5)
    (found,), _ = found_copies(replace(data, experiments=(data.experiments[0], late)))
    assert found.applied


@pytest.mark.parametrize(
    "sensor", [lambda q: q, lambda q: np.round(q / STEP) * STEP, lambda q: np.round(q, 2)]
)
def test_repeats_of_a_run_are_no_copies(sensor):
    found, checked = found_copies(recorded(sensor(motion(0)), sensor(motion(1))))
    assert not found and checked.mended is not None and len(checked.mended.experiments) == 2


def test_a_simulation_that_is_run_twice_is_asked_about():
    (found,), checked = found_copies(recorded(motion(noise=0.0), motion(noise=0.0)))
    assert (
        not found.decisive and checked.mended is not None and len(checked.mended.experiments) == 2
    )


@pytest.mark.parametrize("count", [45, 60, 90])
def test_repeats_whose_codes_agree_are_asked_about(count):
    """A coarse encoder gives two short runs the same codes; so few readings hardly show its step."""
    step = 2 * np.pi / 200
    runs = [np.round(motion(seed, noise=1e-6)[:count] / step) * step for seed in (0, 1)]
    assert np.array_equal(runs[0], runs[1])
    found, checked = found_copies(recorded(*runs))
    assert all(not f.decisive for f in found)
    assert checked.mended is not None and len(checked.mended.experiments) == 2


@pytest.mark.parametrize("blurred", [False, True])
def test_motion_on_an_odd_clock_is_no_noise_of_a_copy(blurred):
    """A clock that alternates makes motion alternate by rows; time stamps that scatter, by
    times.
    """
    rng = np.random.default_rng(0)
    true = T if blurred else np.cumsum(np.tile([0.004, 0.006], len(T) // 2))
    stamps = T + 1e-4 * rng.standard_normal(len(T)) if blurred else true
    q = np.sin(5 * true) + 0.4 * np.sin(9 * true)
    data = jaxid.Dataset.from_arrays(
        [stamps, stamps + 3.0], {"tau": [np.cos(3 * true)] * 2}, {"q": [q, q]}
    )
    (found,), _ = found_copies(data)
    assert not found.decisive


# ---- repeats that change one way


def warming(runs: int, order: list[int] | None = None):
    """Repeats whose motion grows as friction falls."""
    size = [1 - 0.3 * np.exp(-k / 2) for k in (order or range(runs))]
    data = recorded(
        *(motion(k, size=s) for k, s in enumerate(size)),
        splits=("fit",) * (runs - 1) + ("validation",),
    )
    return replace(
        data, experiments=tuple(replace(e, initial={"q": 0.0}) for e in data.experiments)
    )


@pytest.mark.parametrize("runs", [4, 6])
def test_what_drifts_from_run_to_run_is_said_and_is_no_scatter(runs):
    data = warming(runs)
    noise = noise_floor(data)["q"]
    assert (
        noise.source == "sensor"
        and noise.std == pytest.approx(2e-4, rel=0.15)
        and "one way" in noise.text
    )
    checked = run_check(None, data)
    assert not checked.findings and checked.mended is not None
    (note,) = [n for n in checked.notes if "one way" in n]
    assert note in checked.mended.notes and "no scatter" in note and "a, b" in note


def test_repeats_that_scatter_are_scatter():
    assert not one_way(warming(6, [2, 0, 5, 1, 4, 3]).experiments)
    assert noise_floor(warming(6, [2, 0, 5, 1, 4, 3]))["q"].source == "repeatability"
    assert not one_way(warming(3).experiments)  # in one of three orders three runs change one way


def test_flicker_is_the_sensors_however_repeats_differ():
    """Runs that travel radians and end wherever friction leaves them: none of them stands still."""
    data = warming(4, [3, 0, 2, 1])
    far = [replace(e, y=e.y * (1 + 0.8 * k * (-1) ** k)) for k, e in enumerate(data.experiments)]
    assert not [
        f
        for f in run_check(None, replace(data, experiments=tuple(far))).findings
        if f.kind == "does_not_move"
    ]
