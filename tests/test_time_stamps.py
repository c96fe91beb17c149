"""Time stamps that scatter: found where they do and nowhere else, in a fit and in a diagnosis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import jaxid
from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.data.noise import noise_floor
from jaxid.data.time_stamps import scattered_stamps, Stamps, with_scatter
from test_diagnosis import recording


def motion(t: np.ndarray, fast: float = 1.0) -> np.ndarray:
    return 0.8 * np.sin(3 * fast * t) + 0.1 * np.sin(11 * fast * t)


def dataset(t: np.ndarray, y: np.ndarray, **channel) -> Dataset:
    run = Experiment("run", "fit", t, np.sin(t)[:, None], y[:, None])
    return Dataset(
        "d", (Channel("tau", "input", "N m"), Channel("q", "output", "rad", **channel)), (run,)
    )


def found(data: Dataset) -> dict[str, Stamps]:
    return scattered_stamps(data, noise_floor(data))


T = 0.004 * np.arange(3000)


@settings(max_examples=15, deadline=None)
@given(
    spread=st.floats(5e-4, 4e-3),
    seed=st.integers(0, 2**31),
    stated=st.booleans(),
    irregular=st.booleans(),
)
def test_the_spread_is_read_off_the_recording(spread, seed, stated, irregular):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.003, 0.005, T.size)) if irregular else T
    y = motion(t + spread * rng.standard_normal(t.size)) + 3e-4 * rng.standard_normal(t.size)
    data = dataset(t, y, **({"noise_std": 3e-4} if stated else {}))
    (stamps,) = found(data).values()
    assert abs(stamps.spread - spread) < 5 * stamps.std + 0.03 * spread and "ms" in stamps.text
    again = noise_floor(with_scatter(data, {"q": stamps}, noise_floor(data)))["q"]
    assert 1.5e-4 < again.std < 3 * 3e-4  # what is left without the stamps shows at reversals only


@settings(max_examples=25, deadline=None)
@given(
    kind=st.sampled_from(["white", "coarse", "by position", "bursts", "known times", "fast"]),
    seed=st.integers(0, 2**31),
    std=st.floats(1e-5, 1e-3),
)
def test_other_noise_is_not_blamed_on_stamps(kind, seed, std):
    rng = np.random.default_rng(seed)
    t = T
    if kind == "known times":  # irregular, but told as they were
        t = np.cumsum(rng.uniform(0.001, 0.007, T.size))
    y = motion(t, 6.0 if kind == "fast" else 1.0)
    noise = std * rng.standard_normal(t.size)
    if kind == "coarse":
        y = 20 * std * np.round((y + noise / 10) / (20 * std))
        noise = 0 * noise
    if kind == "by position":
        noise *= 1 + 5 * np.abs(y)
    if kind == "bursts":
        noise *= np.where(rng.uniform(size=t.size) < 0.02, 20, 1)
    assert not found(dataset(t, y + noise))


def test_parts_of_a_run_keep_their_scatter():
    y = motion(T + 0.002 * np.random.default_rng(0).standard_normal(T.size))
    data = with_scatter(dataset(T, y), {"q": Stamps(0.002, 1e-5, "")}, noise_floor(dataset(T, y)))
    split = data.with_splits()
    for e in split.experiments:
        assert (
            e.scatter is not None
            and e.scatter.shape == e.y.shape
            and e.whole.scatter.shape == e.whole.y.shape  # pyright: ignore
        )  # type: ignore[union-attr]
    assert np.allclose(
        data.experiments[0].noise(np.array([3e-4]), [0])[:, 0] ** 2 - 9e-8,
        data.experiments[0].scatter[:, 0] ** 2,  # pyright: ignore
    )  # type: ignore[index]


@pytest.mark.slow
def test_a_fit_reads_the_spread_and_weighs_the_readings_by_it():
    data = recording("pendulum", 1, jitter=0.003)
    plain, fit = (jaxid.fit("pendulum", data, effects=e) for e in ((), ("timestamp_jitter",)))
    (effect,) = fit.effects
    spread = effect.parameters["spread"]
    assert spread.std is not None and abs(spread.value - 0.003) < 3 * spread.std
    assert 0.8 < fit.loss < 1.2 and plain.loss > 10
    for name, estimate in fit.parameters.items():  # readings near standstill tell most
        other = plain.parameters[name]
        if estimate.std and other.std:
            assert estimate.std < other.std


@pytest.mark.slow
@pytest.mark.parametrize("beside", [(), ("load_dependent_friction",)])
def test_a_diagnosis_names_time_stamps_that_scatter(beside):
    d = jaxid.diagnose(
        "pendulum", recording("pendulum", 1, jitter=0.003, **({"load": 0.1} if beside else {}))
    )
    assert d.which.verdict == "named"
    assert [e.effect for e in d.which.effects] == ["timestamp_jitter", *beside]
    spread = d.which.effects[0].parameters["spread"]
    assert (
        spread.std is not None
        and abs(spread.value - 0.003) < 3 * spread.std
        and d.which.effects[0].location == "q"
    )
    assert d.how_far.gap_after < 1.1 and d.how_far.gap_retuned > 5
    assert d.which.ranking[0].effect == "timestamp_jitter" and d.which.ranking[0].evidence > 100
    assert "scatter by" in d.which.text


@pytest.mark.slow
def test_stamps_that_no_reading_shows_are_not_asked():
    """To second order they shift a reading as a smooth law may; the noise that they would make is
    not there.
    """
    data = recording("joint", 3, dead_zone=0.03)
    found = jaxid.diagnose(None, data, effects=["timestamp_jitter"])
    assert found.which.verdict == "unknown" and not found.which.ranking
    assert found.notes[-1].startswith("timestamp_jitter: neighbouring readings do not scatter")
