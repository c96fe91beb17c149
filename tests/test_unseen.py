"""What recordings would not show: what is claimed of them is what an independent twin does."""

import functools

import numpy as np
import pytest

import jaxid
from jaxid.base.stopping import Interrupted
from reference import multisine


NOISE = 3e-4
T = np.arange(1200) / 200
SPLITS = ["fit", "fit", "validation", "report"]
J, MGL, VISCOUS = 0.06, 0.9, 0.03


def swung(u: np.ndarray, mgl: float, spring: float, more: tuple[float, ...]) -> np.ndarray:
    """A pendulum under held torques [runs time], four Runge-Kutta steps a sample; `more` damping in
    some of them.
    """
    h, x, out = 1 / 800, np.zeros((2, len(u))), []
    viscous = VISCOUS + np.array(more)
    for k in range(len(T)):
        out.append(x[0])

        def slope(x, k=k, c=viscous):
            return np.array([x[1], (u[:, k] - mgl * np.sin(x[0]) - spring * x[0] - c * x[1]) / J])

        for _ in range(4):
            a = slope(x)
            b = slope(x + h / 2 * a)
            c = slope(x + h / 2 * b)
            x = x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c))
    return np.array(out).T


@functools.cache
def recording(
    reach: tuple[float, ...],
    mgl: float = MGL,
    spring: float = 0.0,
    more: tuple[float, ...] = (0,) * 4,
) -> jaxid.Dataset:
    """A pendulum under multisines of these amplitudes in N m, one for each split."""
    u = np.array(
        [a * multisine(T, [1.0], seed=k, periods=2.5, lines=6)[:, 0] for k, a in enumerate(reach)]
    )
    q = swung(u, mgl, spring, more) + NOISE * np.random.default_rng(7).standard_normal(u.shape)
    return jaxid.Dataset.from_arrays(
        [T] * 4,
        {"tau": list(u)},
        {"q": list(q)},
        units={"tau": "N m", "q": "rad"},
        split=SPLITS,
        at_rest=True,
        noise_std={"q": NOISE},
        model="pendulum",
    )


def diagnosed(data: jaxid.Dataset, *effects: str) -> jaxid.Diagnosis:
    allowed = effects or ("spring_torque", "quadratic_drag", "dead_zone")
    return jaxid.diagnose(None, data, effects=allowed, without=["coulomb_friction"])


SMALL, LARGE = (0.015,) * 4, (0.4,) * 4


def test_a_spring_hides_in_gravity_where_the_pendulum_hardly_moves(tmp_path):
    """sin q is q there; with large motion the same effect would show. A twin that has a spring of
    the size that is stated fits as well without it, with the gravity torque that is stated.
    """
    small = diagnosed(recording(SMALL))
    assert small.which.verdict == "none"
    (spring,) = [u for u in small.unseen if u.effect == "spring_torque"]
    assert spring.distance < 3 < spring.stirred and not spring.absorbed
    moved = {m.name: m for m in spring.moved}["gravity_torque"]
    size, unit = spring.parameters["stiffness"]
    assert unit == "N m/rad" and moved.without - moved.beside == pytest.approx(size, rel=0.1)
    assert "spring_torque" in small.next_experiment and small.rivals is not None
    assert small.to_dict()["unseen"][0]["location"] in ("q", "tau")
    assert (
        "What these recordings would not show" in small.report(tmp_path / "report.html").read_text()
    )
    large = diagnosed(recording(LARGE))
    assert large.which.verdict == "none" and not [
        u for u in large.unseen if u.effect == "spring_torque" and u.moved
    ]
    truth = 0.9 - size
    with_it = diagnosed(recording(SMALL, truth, size))
    fitted = with_it.nominal.parameters["gravity_torque"]
    assert with_it.which.verdict == "none" and fitted.std is not None
    assert abs(fitted.value - 0.9) < 3 * fitted.std < 0.2 * abs(fitted.value - truth)


def test_what_fit_runs_cannot_show_validation_runs_name(tmp_path):
    """Fitted where it hardly moves, judged where it swings: the fit runs come down to the noise
    without the spring.
    """
    found = diagnosed(recording((0.015, 0.015, 0.4, 0.4), spring=0.3))
    assert [str(e) for e in found.which.effects] == [
        "spring_torque at q"
    ] and found.how_far.gap_after < 1.3
    assert found.final.parameters["gravity_torque"].value == pytest.approx(0.9, rel=0.02)
    far = found.how_far
    (whole,) = far.per_run
    assert whole.part == "run_4" and (whole.retuned, whole.after) == pytest.approx(
        (far.gap_retuned, far.gap_after)
    )
    parts = [
        s for s in far.per_regime if s.part in ("forward", "backward", "standstill")
    ]  # every sample is in one of them
    assert sum(s.samples for s in parts) == whole.samples
    assert sum(s.samples * s.retuned**2 for s in parts) == pytest.approx(
        whole.samples * far.gap_retuned**2
    )
    page = found.report(tmp_path / "report.html").read_text()
    assert "situation by situation" in page and "would not show" not in page


def test_a_number_that_drifts_is_a_sign():
    """Damping of one run that is not that of the others, which is no effect of the library; without
    it there is no sign.
    """
    drifts = diagnosed(recording((0.2,) * 4, more=(0.0, 2e-4, 0.0, 0.0)), "dead_zone")
    assert (
        "viscous is not the same in all of the recordings" in drifts.which.text
        and "half of run_2" in drifts.which.text
    )
    steady = diagnosed(recording((0.2,) * 4), "dead_zone")
    assert (
        steady.which.verdict == "none"
        and "not the same" not in steady.which.text
        and "stands out" not in steady.which.text
    )


def test_what_is_known_survives_an_interruption(monkeypatch):
    """Ctrl-C while it is worked out what the recordings would not show: the verdict was there
    before.
    """

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxid.diagnosis.answer.BlindSpotSearch.look", stopped)
    with pytest.raises(Interrupted) as caught:
        diagnosed(recording(SMALL), "quadratic_drag")
    partial = caught.value.partial
    assert (
        isinstance(partial, jaxid.Diagnosis)
        and partial.which.verdict == "none"
        and not partial.unseen
    )
    assert "Stopped before" in partial.which.text
