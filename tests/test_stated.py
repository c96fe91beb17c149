"""What is said of stated numbers: all together, by the smallest change that the data allow; ratios
where only these are known.
"""

from __future__ import annotations

import numpy as np
import pytest

from jaxid.fitting.result import Covariance, Estimate
from jaxid.fitting.stated import judged, StatedNumber
from jaxid.numerics.stated_numbers import BoundedEstimates, smallest_change


NAMES = ("kp", "kd", "inertia", "friction")
UNITS = ("N m/rad", "N m s/rad", "kg m^2", "N m")
#: A servo on a vertical axis: no torque and no gravity tells how large all of them are together.
TRUE = np.array([8.0, 0.05, 0.007, 0.02])
SCALE = 1.2
FITTED = SCALE * TRUE


def only_ratios(relative: float = 0.003, scale: float = 0.9) -> np.ndarray:
    """The covariance of numbers of which ratios are known so well, and their common scale
    hardly.
    """
    return (relative**2 * np.eye(4) + scale**2) * np.outer(FITTED, FITTED)


def servo(stated: dict[str, float]) -> tuple[StatedNumber, ...]:
    C = only_ratios()
    found = {
        k: Estimate(float(v), float(np.sqrt(C[k, k])), unit, 0.0, 100 * float(v))
        for k, (v, unit) in enumerate(zip(FITTED, UNITS, strict=True))
    }

    def off(k, name):
        return (float(FITTED[k]) - stated[name]) / float(np.sqrt(C[k, k]))

    rows = {
        k: StatedNumber(
            "axis",
            "",
            name,
            stated[name],
            float(FITTED[k]),
            found[k].std,
            off(k, name),
            f"{name}: …",
            UNITS[k],
        )
        for k, name in enumerate(NAMES)
        if name in stated
    }
    return judged(rows, NAMES, found, Covariance(NAMES, C))


def test_numbers_whose_ratios_are_right_are_not_refuted():
    told = servo(dict(zip(NAMES, map(float, TRUE), strict=True)))
    assert len(told) == 4 and not any(s.refuted for s in told)


def test_the_one_number_that_is_wrong_beside_the_others_is_refuted():
    told = servo({"kp": 8.0, "kd": 0.7, "inertia": 0.007, "friction": 0.02})
    (wrong,) = [s for s in told if s.refuted]
    assert wrong.parameter == "kd" and wrong.deviation is not None and wrong.deviation < -50
    assert wrong.beside == pytest.approx(0.05, rel=0.02)
    assert (
        wrong.text.startswith("kd of axis: 0.050")
        and "with the other numbers as stated" in wrong.text
    )


def test_what_all_ratios_share_is_refuted_alone():
    """All but the inertia are a fifth too low: it is the inertia that is wrong, by the fewest
    changes.
    """
    told = servo({"kp": 8.0, "kd": 0.05, "inertia": 0.0084, "friction": 0.02})
    assert [s.parameter for s in told if s.refuted] == ["inertia"]


def test_a_ratio_of_two_is_said_as_that():
    told = servo({"kp": 8.0, "inertia": 0.0084})
    (wrong,) = [s for s in told if s.refuted]
    assert wrong.parameter in ("kp of axis / inertia of axis", "inertia of axis / kp of axis")
    assert "20 % higher than stated" in wrong.text or "17 % lower than stated" in wrong.text
    assert "not which of the two differs" in wrong.text
    assert all(s.deviation is None for s in told if s is not wrong)


def the_one_refuted(
    names: tuple[str, ...],
    units: tuple[str, ...],
    fitted: tuple[float, ...],
    stated: tuple[float, ...],
    C: np.ndarray,
) -> StatedNumber:
    """The only row that is refuted, of numbers of one axis that were fitted with a covariance."""
    found, rows = {}, {}
    for k, name in enumerate(names):
        std = float(np.sqrt(C[k, k]))
        found[k] = Estimate(fitted[k], std, units[k], -1000.0, 1000.0)
        rows[k] = StatedNumber(
            joint="axis",
            link="",
            parameter=name,
            stated=stated[k],
            fitted=fitted[k],
            std=std,
            deviation=(fitted[k] - stated[k]) / std,
            text=f"{name}: …",
            unit=units[k],
        )
    (wrong,) = [s for s in judged(rows, names, found, Covariance(names, C)) if s.refuted]
    return wrong


def test_of_two_where_one_is_stated_as_nothing_both_ways_are_said():
    """Dry friction, stated 0, and where a mass is: the data tell friction + 100 mass's place."""
    line = np.array([[1.0, -0.01], [-0.01, 1e-4]])
    C = 100.0 * line + 1e-4 * np.diag([1.0, 1e-4])
    wrong = the_one_refuted(("friction", "com"), ("N m", "m"), (4.0, -0.26), (0.0, -0.3), C)
    assert "friction of axis is 8.0" in wrong.text and "com of axis is -0.22" in wrong.text
    assert wrong.text.startswith("either ") and "the data do not tell which" in wrong.text


def test_a_sum_that_the_data_do_not_tell_is_not_said():
    """The data tell damping and twice kd; their sum, product, ratio and difference hardly."""
    along = np.array([20.0, -10.0])
    C = np.outer(along, along) + 0.01 * np.eye(2)
    units = ("N m s/rad",) * 2
    wrong = the_one_refuted(("damping", "kd"), units, (15.0, 190.0), (12.0, 200.0), C)
    assert wrong.text.startswith("either ")
    assert wrong.std is not None and wrong.deviation is not None
    assert abs(wrong.fitted - wrong.stated) > 3 * wrong.std


def known(value, covariance, lower=-1e9, upper=1e9) -> BoundedEstimates:
    n = len(value)
    return BoundedEstimates(
        np.array(value, float), np.array(covariance, float), np.full(n, lower), np.full(n, upper)
    )


def test_a_sum_is_bounded_by_what_cannot_be_negative():
    """Damping and kd of one law: kd cannot be as high as it is stated, for the damping would have
    to be negative.
    """
    C = 1e-8 * np.eye(2) + 0.03**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    change = smallest_change(known([0.0, 0.07], C, 0.0, 14.0), np.array([0.02, 0.7]))
    assert change.refuted == (1,) and not change.instead
    assert change.value == pytest.approx([0.02, 0.05], abs=1e-3)


def test_numbers_that_only_together_are_too_far_are_refuted():
    """Each is near where it is stated beside the other, and both are not."""
    C = np.linalg.inv(np.array([[1.0, -0.99], [-0.99, 1.0]]))
    assert set(smallest_change(known([0.0, 0.0], C), np.array([100.0, 100.0])).refuted) == {0, 1}


def test_chance_refutes_rarely():
    rng = np.random.default_rng(0)
    A = rng.standard_normal((5, 5))
    draws = rng.multivariate_normal(np.zeros(5), A @ A.T, 400)
    refuted = [bool(smallest_change(known(x, A @ A.T), np.zeros(5)).refuted) for x in draws]
    assert np.mean(refuted) < 0.05


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_no_number_refutes_nothing(value):
    told = smallest_change(known([1.0, value], np.eye(2)), np.array([1.1, 5.0]))
    assert told.refuted == ()
    told = smallest_change(known([1.0, 2.0], np.diag([1.0, value])), np.array([1.1, 50.0]))
    assert told.refuted == ()
