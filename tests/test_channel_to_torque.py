"""The way from a recorded channel to joint torque: the same recording in A, mA, counts and N m
gives the same answers.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxid
from jaxid.base.errors import DatasetWarning, UsageError
from jaxid.cli.terminal import warnings_said_once
from jaxid.conventions.missing_force import ForceFit, measured
from jaxid.data.dataset import ModelSpec
from jaxid.diagnosis.missing import joint_load
from jaxid.diagnosis.torque.answer import _body
from jaxid.diagnosis.torque.library import BODY, Unit
from jaxid.diagnosis.torque.study import TorqueStudy
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Command, Signals
from jaxid.dynamics.kinematics import modified_dh
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.force.drive import drive_torque
from jaxid.identification.payload import PayloadEstimate, USUAL_GAIN_STD, usual_gain_std
from jaxid.identification.regression import read_run
from jaxid.identification.run import _stated
from jaxid.models import Joint, Panda, SerialArm, UR10, UR10e
from jaxid.models.effects import CoulombFriction, TorqueScale, ViscousFriction
from jaxid.numerics.precision import float64
from jaxid.problem.binding import bind, resolve_model
from jaxid.problem.residual import InverseDynamics, OutputError


TWO = modified_dh(a=[0, 0.4], alpha=[0, 0], d=[0.1, 0])
ARMS = {"two": SerialArm(TWO), "ur10": UR10(), "ur10e": UR10e(), "panda": Panda()}
UNITS = ("A", "mA", "count")
#: A count of the drive, A.
COUNT = 2.69e-3


def gains_of(arm: Any) -> np.ndarray:
    return np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47, 9.0][: len(arm.prismatic)])


def motion(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """t, joint positions and torques [time n] of a motion."""
    t = np.arange(0, 4, 0.01)
    phase = 2 * np.pi * np.outer(t, 0.3 + 0.11 * np.arange(n))
    q = 0.5 * np.sin(phase + np.arange(n)) + 1e-5 * np.random.default_rng(0).standard_normal(
        phase.shape
    )
    return t, q, 8.0 * np.cos(phase) + 3.0 * np.sign(np.cos(phase)) + 0.05 * np.sin(41 * phase)


def recorded(arm: Any, unit: str) -> jaxid.Dataset:
    """The same recording of an arm, its torque as a torque or as the current that makes it."""
    n, gains = len(arm.prismatic), gains_of(arm)
    t, q, tau = motion(n)
    outputs = {f"q{j + 1}": q[:, j] for j in range(n)}
    names = [f"tau{j + 1}" if unit == "N m" else f"current{j + 1}" for j in range(n)]
    amperes = {
        "N m": 1 / gains,
        "A": np.ones(n),
        "mA": np.full(n, 1e-3),
        "count": np.full(n, COUNT),
    }[unit]
    raw = tau / gains / amperes
    if unit == "count":  # recorded as counts, with a scale that was stated
        raw = raw * COUNT
    inputs = dict(zip(names, raw.T, strict=True))
    constants = (
        {} if unit == "N m" else {f"drive_gain{j + 1}": float(gain) for j, gain in enumerate(gains)}
    )
    units = dict.fromkeys(inputs, "A" if unit == "count" else unit) | dict.fromkeys(outputs, "rad")
    return jaxid.Dataset.from_arrays(
        t,
        inputs,
        outputs,
        units=units,
        model=ModelSpec(arm.name, constants=constants),
        check_model=False,
    )


def same(found: Any, wanted: Any) -> None:
    """Equal to nine digits of the largest."""
    found, wanted = np.asarray(found, float), np.asarray(wanted, float)
    assert np.all(np.isfinite(wanted)) and np.any(wanted)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


@pytest.fixture(scope="module")
def two() -> dict[str, Any]:
    """The arm of two joints bound to its recording in each unit."""
    return {
        unit: bind(ARMS["two"], recorded(ARMS["two"], unit), splits=False)
        for unit in ("N m", *UNITS)
    }


@pytest.mark.parametrize("kind", ARMS)
def test_every_arm_and_unit_gives_the_torque(kind: str) -> None:
    arm, (_, q, tau) = ARMS[kind], motion(len(ARMS[kind].prismatic))
    for unit in ("N m", *UNITS):
        data = recorded(arm, unit)
        chain = _chain(arm, data)
        assert chain.direct and all(u == "N m" for _, u in chain.torque_channels)
        same(
            drive_torque(
                ParameterVector(chain), None, data.experiments[0].u, np.concatenate([q, 0 * q], 1)
            ),
            tau,
        )


def _chain(arm: Any, data: jaxid.Dataset) -> Chain:
    return _stated(resolve_model(arm, data), data)


def _residual(binding: Any, residual: Any) -> np.ndarray:
    problem = ProblemBuilder(binding).problem(residual, "fit", binding.free, binding.theta)
    return np.concatenate([r.ravel() for r in problem.residuals(problem.z(binding.theta))])


def _missing(binding: Any) -> np.ndarray:
    m = measured(binding)
    assert m is not None
    fit = ForceFit(binding, m)
    return np.concatenate([fit.missing(binding.theta, m).ravel(), fit.norm(m)])


def _by_torque(binding: Any) -> np.ndarray:
    study = TorqueStudy(binding, [CoulombFriction, ViscousFriction, TorqueScale], None, None, False)
    rows, _ = study.rows_with_effects(study.theta)
    return np.concatenate(
        [study.theta[binding.free], study.noise, *(x[:, :, -1].ravel() for x in rows.rows)]
    )


def _identified(binding: Any) -> np.ndarray:
    chain = binding.chain
    return read_run(
        binding.dataset, binding.dataset.experiments[0], chain, chain.mechanism.base(), 5.0, 10.0
    ).tau


def _load(binding: Any) -> np.ndarray:
    (e,) = binding.dataset.experiments
    return joint_load(binding, e, binding.motions[e.name])


ROADS = {
    "inverse_dynamics": lambda b: _residual(b, InverseDynamics()),
    "output_error": lambda b: _residual(b, OutputError()),
    "check": _missing,
    "torque": _by_torque,
    "identify": _identified,
    "where": _load,
    "typical": lambda b: np.array([r.torque for r in b.references]),
}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("road", ROADS)
def test_every_road_takes_a_current_for_its_torque(
    road: str, unit: str, two: dict[str, Any]
) -> None:
    same(ROADS[road](two[unit]), ROADS[road](two["N m"]))


@pytest.mark.parametrize("unit,size", [("mN m", 1e-3), ("N cm", 1e-2), ("kgf cm", 0.0980665)])
def test_a_joint_in_other_units_of_torque(unit: str, size: float) -> None:
    t, q, tau = motion(1)
    bound = [
        bind(
            Joint(),
            jaxid.Dataset.from_arrays(t, {"tau": tau[:, 0] / s}, {"q": q[:, 0]}, units={"tau": u}),
            splits=False,
        )
        for u, s in (("N m", 1.0), (unit, size))
    ]
    for road in (lambda b: _residual(b, InverseDynamics()), _missing):
        same(road(bound[1]), road(bound[0]))


def test_an_effect_at_the_input_acts_in_the_unit_of_the_channel() -> None:
    """A dead zone of a current is one of so many amperes, whatever an ampere makes."""
    arm = ARMS["two"]
    binding = bind(arm, recorded(arm, "A"), effects=["dead_zone@current1"], splits=False)
    (i,) = binding.layout.of_effect("dead_zone", "current1")
    assert binding.layout.entries[i].unit == "A"
    chain = binding.layout.model(np.where(np.arange(len(binding.theta)) == i, 0.1, binding.theta))
    with float64():
        u, zero = jnp.array([0.3, 0.3]), jnp.zeros(2)
        command = Command(jnp.zeros(()), jnp.full((), 1e-3), u, u, lambda d: u)
        signals = Signals(command.t, zero, zero, zero, command.h, command, zero)
        after, _ = chain.commanded(signals, chain.start(zero, zero, u).z)
        same(after, gains_of(arm) * np.array([0.2, 0.3]))


def test_a_response_counts_the_gain() -> None:
    """Whatever a linear chain answers to a torque, it answers to a current times its gain."""
    chain = _chain(ARMS["two"], recorded(ARMS["two"], "A"))
    (gain,) = [e for e in chain.effects if e.name == "drive_gain"]
    with float64():
        found = gain.transfer(jnp.array([1.0, 9.0]))
        assert found is not None
        same(found[0], np.tile(gains_of(ARMS["two"]), (2, 1)))
        assert not np.any(np.asarray(found[1]))


def test_a_current_without_a_gain_is_refused() -> None:
    data = recorded(ARMS["two"], "A")
    assert data.model is not None
    bare = replace(data, model=replace(data.model, constants={"drive_gain1": 14.87}))
    with pytest.raises(UsageError, match="current2: in A.*drive_gain2"):
        bind(ARMS["two"], bare)


def test_a_load_without_a_mass_has_no_centre() -> None:
    """Neither where it is read off a diagnosis nor off an identification; nothing divides by it."""
    n = len(BODY)
    unit = Unit("payload", "q2", BODY, np.zeros(n), np.zeros(n), np.ones(n), {}, (0, 1), [])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = _body(unit, np.zeros(n), 1e-6 * np.eye(n), 0.05)
        told = PayloadEstimate(
            np.zeros(10), np.eye(10), np.zeros(10), np.zeros(10), 0.05, 3
        ).to_dict()
    assert found["mass"].value == 0.0 and not {"x", "y", "z"} & found.keys()
    assert np.isnan(told["nearest_body"]["com"]).all() and told["com"][0]["std"] == np.inf


def test_the_share_of_the_gains_is_in_the_interval_of_a_load() -> None:
    """By itself where torques are made of currents; both roads state it alike."""
    arm = ARMS["two"]
    shares = {unit: usual_gain_std(_chain(arm, recorded(arm, unit))) for unit in ("N m", *UNITS)}
    assert shares == {"N m": 0.0, **dict.fromkeys(UNITS, USUAL_GAIN_STD)}
    values = np.array([3.0, 0.03, 0.0, 0.3, *[0.1] * 6])
    unit = Unit("payload", "q2", BODY, np.zeros(10), np.zeros(10), np.ones(10), {}, (0, 1), [])
    exact, counted = (
        _body(unit, values, 1e-6 * np.eye(10), share)["mass"].std for share in (0.0, 0.05)
    )
    assert exact == pytest.approx(1e-3) and counted == pytest.approx(np.hypot(1e-3, 0.15))
    phi = np.concatenate([values[4:], values[1:4], values[:1]])
    load = PayloadEstimate(phi, 1e-6 * np.eye(10), phi, None, 0.05, 3)
    assert (
        load.mass[1] == pytest.approx(counted)
        and "5 %" in load.counted_gains
        and not load.exact_gains
    )


def test_warnings_of_arithmetic_reach_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with warnings_said_once():
        warnings.simplefilter("always")
        assert np.isnan(np.zeros(1) / np.zeros(1)).all()
        warnings.warn("a mass of the file is negative", DatasetWarning, stacklevel=1)
    said = capsys.readouterr().err
    assert "a mass of the file is negative" in said and "invalid value" not in said


def test_a_joint_under_another_role_is_named() -> None:
    arm = ARMS["two"]
    data = recorded(arm, "N m")
    beside = tuple(replace(c, role="auxiliary") if c.name == "q2" else c for c in data.channels)
    (e,) = data.experiments
    moved = replace(e, y=e.y[:, :1], auxiliary={"q2": e.y[:, 1]})
    with pytest.raises(
        UsageError, match=r'q2: recorded as auxiliary; state role = "output" under \[channels.q2\]'
    ):
        bind(arm, replace(data, channels=beside, experiments=(moved,)))


@pytest.mark.parametrize(
    ("channel", "unit", "said"),
    [
        ("yaw_current", "A", r'column = "yaw_current", unit = "N m" and scale = .*gear ratio'),
        ("tau_yaw", "N m", r'column = "tau_yaw", unit = "N m"'),
        ("yaw_tau", "A", r"yaw_tau.*is in A.*scale = .*gear ratio"),
        ("yaw_tau", "%", r"yaw_tau.*convert it: unit = \"N m\" and scale"),
    ],
)
def test_a_robot_says_what_to_write_for_a_channel_of_another_name_or_unit(channel, unit, said):
    text = """<mujoco><worldbody><body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <joint name="yaw"/></body></worldbody></mujoco>"""
    t, q, tau = motion(1)
    data = jaxid.Dataset.from_arrays(
        t,
        {channel: tau[:, 0]},
        {"yaw": q[:, 0]},
        units={channel: unit, "yaw": "rad"},
        check_model=False,
    )
    with pytest.raises(UsageError, match=said):
        bind(jaxid.models.Robot.from_mjcf("yaw.xml", text=text), data)
