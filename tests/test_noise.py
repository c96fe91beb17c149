"""The noise floor against data whose noise is known, and units against SciPy's constants."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import constants

from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.data.noise import noise_floor, quantisation_step, sensor_noise
from jaxid.data.repeats import repeats
from jaxid.data.units import conversion, si_unit, unit_names, UnitError


T = 0.005 * np.arange(2000)
MOTION = 0.8 * np.sin(3 * T) + 0.1 * np.sin(11 * T)


def dataset(*outputs: np.ndarray, at_rest: bool = True, splits=("fit",) * 9, **channel) -> Dataset:
    runs = tuple(
        Experiment(f"r{i}", split, T, np.sin(T)[:, None], y[:, None], at_rest=at_rest)
        for i, (y, split) in enumerate(zip(outputs, splits, strict=False))
    )
    return Dataset(
        "d", (Channel("tau", "input", "N m"), Channel("q", "output", "rad", **channel)), runs
    )


def noise(std: float, seed: int = 0) -> np.ndarray:
    return std * np.random.default_rng(seed).standard_normal(len(T))


def quantised(y: np.ndarray, step: float) -> np.ndarray:
    return step * np.round(y / step)


def test_stated_noise_counts():
    found = noise_floor(dataset(MOTION + noise(1e-4), noise_std=1e-3))["q"]
    assert (found.std, found.source, found.unit) == (1e-3, "stated", "rad")
    assert "sensor's alone" in found.text


def test_sensor_noise_is_right_on_average():
    rng = np.random.default_rng(5)
    found = [sensor_noise([rng.standard_normal(1000)]) ** 2 for _ in range(1000)]
    assert np.mean(found) == pytest.approx(
        1, abs=0.012
    )  # 4 standard errors of the mean; 0.967 without the median's own


@pytest.mark.parametrize("std", [1e-5, 1e-4, 1e-3, 1e-2])
def test_sensor_noise_is_estimated_where_nothing_is_stated(std):
    found = noise_floor(dataset(MOTION + noise(std)))["q"]
    assert found.source == "sensor" and found.std == pytest.approx(std, rel=0.1)


def test_fast_motion_is_not_taken_for_noise():
    t = 0.02 * np.arange(2000)
    y = np.sin(8 * t) + 1e-4 * np.random.default_rng(0).standard_normal(len(t))
    assert sensor_noise([y]) == pytest.approx(1e-4, rel=0.15)


def test_impacts_are_not_taken_for_noise():
    y = MOTION + noise(1e-4)
    y[::400] += 0.1
    assert sensor_noise([y]) == pytest.approx(1e-4, rel=0.15)


def test_data_without_noise_have_a_floor_above_zero():
    found = noise_floor(dataset(np.linspace(0, 1, len(T)) ** 2))["q"]
    assert 0 < found.std < 1e-7


@pytest.mark.parametrize("step", [2 * math.pi / 4096, 1e-3, math.radians(0.29)])
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_quantisation_is_found(step, kind):
    y = quantised(MOTION, step).astype(kind).astype(float)
    assert quantisation_step([y]) == pytest.approx(step, rel=1e-3)
    found = noise_floor(dataset(y))["q"]
    assert found.source in ("quantisation", "sensor") and found.std >= 0.999 * step / math.sqrt(12)


def test_steps_too_fine_to_be_found_are_in_the_sensor_noise():
    y = quantised(MOTION, 5e-8)
    found = noise_floor(dataset(y))["q"]
    assert found.std == pytest.approx(5e-8 / math.sqrt(12), rel=0.5)


def test_steady_motion_is_not_quantised():
    assert quantisation_step([0.3 * T]) is None


def test_a_sum_of_two_recordings_keeps_its_step():
    step = 2 * math.pi / 4096
    assert quantisation_step(
        [quantised(MOTION, step), quantised(MOTION[:300] / 3, step)]
    ) == pytest.approx(step)


@given(seed=st.integers(0, 10**6), count=st.integers(30, 3000))
@settings(max_examples=60, deadline=None)
def test_noisy_floats_are_not_quantised(seed, count):
    rng = np.random.default_rng(seed)
    y = np.sin(np.arange(count) * 0.01) + 1e-3 * rng.standard_normal(count)
    assert quantisation_step([y]) is None
    assert quantisation_step([np.sin(np.arange(count) * 0.01)]) is None


def test_stated_resolution_counts_and_is_not_searched_for():
    found = noise_floor(dataset(quantised(MOTION, 1e-3), resolution=2e-3))["q"]
    assert found.std == pytest.approx(2e-3 / math.sqrt(12)) and found.source == "quantisation"
    assert "stated" in found.text and "1e-3" not in found.text


def test_the_largest_counts():
    found = noise_floor(dataset(quantised(MOTION, 1e-2), noise_std=1e-3))["q"]
    assert found.source == "quantisation"
    assert noise_floor(dataset(quantised(MOTION, 1e-3), noise_std=1e-2))["q"].source == "stated"


def test_stated_noise_and_a_stated_step_add_up():
    found = noise_floor(dataset(MOTION, resolution=1e-2, noise_std=2e-3))["q"]
    assert (
        found.std == pytest.approx(math.hypot(2e-3, 1e-2 / math.sqrt(12)))
        and found.source == "stated"
    )
    assert "0.002" in found.text and "0.01" in found.text


def test_repeated_runs_show_what_the_machine_does():
    rng = np.random.default_rng(1)
    wander = [MOTION + 0.01 * rng.standard_normal() * np.sin(T) + noise(1e-5, i) for i in range(6)]
    found = noise_floor(dataset(*wander, noise_std=1e-5))["q"]
    expected = np.sqrt(np.mean(np.var(np.stack(wander), axis=0, ddof=1)))
    assert found.source == "repeatability" and found.std == pytest.approx(expected)
    assert "sensor's alone" not in found.text and "6 runs" in found.text


def test_a_repeat_that_stops_before_the_other_is_one():
    """As where the end of a run is kept for report; what covers less than half of the other says
    nothing of it.
    """
    wander = [MOTION + 0.01 * k * np.sin(T) + noise(1e-5, k) for k in range(2)]
    both = dataset(*wander, noise_std=1e-5)

    def short(count):
        return replace(
            both,
            experiments=(
                both.experiments[0],
                both.experiments[1].piece(0, count, name="b", split="fit"),
            ),
        )

    expected = np.sqrt(np.mean(np.var(np.stack([y[: len(T) - 7] for y in wander]), axis=0, ddof=1)))
    assert noise_floor(short(len(T) - 7))["q"].std == pytest.approx(expected)
    assert noise_floor(short(len(T) // 2 - 1))["q"].source == "stated"


def test_runs_from_different_starts_are_no_repeats():
    found = noise_floor(dataset(MOTION, MOTION + 0.5, at_rest=False, noise_std=1e-3))["q"]
    assert found.source == "stated"


@pytest.mark.parametrize("inputs", [{}, {"force": np.zeros_like}])
def test_runs_that_coast_are_repeats_only_where_that_is_stated(inputs):
    """From one position, at speeds that nobody states: no input makes the motion."""
    t = np.arange(0, 4, 5e-3)
    rng = np.random.default_rng(5)
    runs = [v * (1 - np.exp(-t)) + rng.normal(0, 1e-4, t.size) for v in (6.0, 5.0)]
    data = Dataset.from_arrays(
        [t, t],
        {name: [made(t), made(t)] for name, made in inputs.items()},
        {"x": runs},
        units={"x": "m", **dict.fromkeys(inputs, "N")},
        check_model=False,
    )
    first, second = data.experiments
    assert repeats([first, second]) == []
    known = [replace(e, initial={"x": 0.0, "xd": 6.0}) for e in (first, second)]
    assert len(repeats(known)) == 1
    assert len(repeats([first, replace(second, repeat_of=first.name)])) == 1


def test_report_runs_are_not_looked_at():
    found = noise_floor(
        dataset(MOTION + noise(1e-4), MOTION + noise(0.3), splits=("fit", "report"))
    )["q"]
    assert found.std == pytest.approx(1e-4, rel=0.1)


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("deg", "rad", constants.degree),
        ("arcmin", "rad", constants.arcmin),
        ("arcsec", "rad", constants.arcsec),
        ("rpm", "rad/s", 2 * math.pi / constants.minute),
        ("in", "m", constants.inch),
        ("km/h", "m/s", constants.kmh),
        ("kgf", "N", constants.kgf),
        ("lbf", "N", constants.lbf),
        ("oz in", "N m", constants.oz * constants.g * constants.inch),
        ("kgf cm", "N m", constants.kgf / 100),
        ("kg cm", "N m", constants.kgf / 100),
        ("N mm", "N m", 1e-3),
        ("lb", "kg", constants.lb),
        ("gram", "kg", 1e-3),
        ("g_n", "m/s^2", constants.g),
        ("bar", "Pa", constants.bar),
        ("psi", "Pa", constants.psi),
        ("%", "1", 0.01),
        ("mA", "A", 1e-3),
        ("N·m", "N m", 1),
        ("N*m", "N m", 1),
        ("Nm", "N m", 1),
        ("rad/s²", "rad/s^2", 1),
        ("m / s**2", "m/s^2", 1),
        ("rad s^-1", "rad/s", 1),
        ("°/s", "rad/s", constants.degree),
        ("µm", "m", 1e-6),
        ("-", "1", 1),
    ],
)
def test_units_agree_with_scipy(unit, si, factor):
    found = conversion(unit)
    assert found.si == si and found.factor == pytest.approx(factor, rel=1e-12) and found.shift == 0


@pytest.mark.parametrize(("unit", "value"), [("degC", 25.0), ("degF", 77.0), ("°C", 25.0)])
def test_temperatures_shift(unit, value):
    found = conversion(unit)
    assert found.factor * value + found.shift == pytest.approx(298.15)


@given(unit=st.sampled_from(unit_names()), value=st.floats(-1e6, 1e6))
def test_every_unit_leads_to_an_si_unit_and_back(unit, value):
    found = conversion(unit)
    assert conversion(found.si).factor == 1 and conversion(found.si).shift == 0
    assert (found.factor * value + found.shift - found.shift) / found.factor == pytest.approx(
        value, abs=1e-6
    )


@given(unit=st.text(max_size=8))
def test_any_text_is_a_unit_or_a_unit_error(unit):
    try:
        conversion(unit)
    except UnitError as error:
        assert repr(unit) in str(error) or "'g'" in str(error)


def test_g_needs_to_know_what_it_measures():
    assert conversion("g", "kg").factor == 1e-3
    assert conversion("g", "m/s^2").si == "m/s^2"
    with pytest.raises(UnitError, match="gram"):
        conversion("g")
    with pytest.raises(UnitError, match="did you mean 'N mm'"):
        conversion("N mmm")
    assert si_unit("furlong") == "furlong" and si_unit("deg") == "rad"


def test_what_repeats_differ_by_adds_up_along_a_run_not_within_windows():
    """Friction that differs from time to time: after ten seconds the joint is elsewhere, a second
    after each start it is not.
    """

    def slow(k):
        return k * 0.01 * T**2

    runs = [MOTION + slow(k) + noise(1e-4, k + 1) for k in (-1, 0, 1)]
    whole, parts = (
        noise_floor(dataset(*runs))["q"],
        noise_floor(dataset(*runs), window=lambda e: 1.0)["q"],
    )
    assert whole.source == parts.source == "repeatability"
    assert whole.std == pytest.approx(0.01 * 100 / math.sqrt(5), rel=0.01)
    assert parts.std == pytest.approx(
        math.hypot(0.01 / math.sqrt(180), 1e-4), rel=0.05
    )  # a parabola beside its line
    assert "windows of 1 s" in parts.text
    alike = noise_floor(
        dataset(*(MOTION + noise(1e-4, k) for k in range(3))), window=lambda e: 1.0
    )["q"]
    assert alike.std == pytest.approx(1e-4, rel=0.1)
