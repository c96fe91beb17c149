"""Diagnosis by torque: twins whose torques come from Pinocchio, with one thing in them that the
model does not have.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.base.errors import UsageError
from jaxid.data.dataset import Channel, Dataset, Experiment, ModelSpec
from jaxid.data.signals import zero_phase
from jaxid.diagnosis.run import run_diagnosis
from jaxid.diagnosis.torque.answer import of_model
from jaxid.diagnosis.torque.claims import claims
from jaxid.diagnosis.torque.found import searched
from jaxid.diagnosis.torque.judged import scales
from jaxid.diagnosis.torque.reference import ReferenceNumbers
from jaxid.diagnosis.torque.study import TorqueStudy
from jaxid.diagnosis.torque.waves import Rest
from jaxid.diagnosis.torque.weigh import weigh
from jaxid.dynamics.kinematics import modified_dh
from jaxid.force.torque_filter import evenly
from jaxid.models import SerialArm, UR10e
from jaxid.models.effects import AsymmetricFriction, InputDelay, QuadraticDrag, TorqueScale
from jaxid.problem.binding import bind
from jaxid.problem.residual import InverseDynamics
from test_serial_arm import table_of, twin


pin: Any = pytest.importorskip("pinocchio")
DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
NOISE, TORQUE_NOISE = 2e-5, 0.02
THREE = modified_dh(
    a=[0, 0.05, 0.4], alpha=[0, -np.pi / 2, 0], d=[0.3, 0, 0.05], theta=[0, -0.6, 0.9]
)


def moved(n: int, seed: int, seconds: float = 16.0, rate: float = 100.0) -> tuple[np.ndarray, ...]:
    """t [time], and a motion of several sines q, qd, qdd [time n]."""
    rng, t = np.random.default_rng(seed), np.arange(0, seconds, 1 / rate)
    a, w = rng.uniform(0.1, 0.4, (4, n)), 2 * np.pi * rng.uniform(0.1, 0.7, (4, n))
    angle = w * t[:, None, None] + rng.uniform(0, 6, (4, n))
    return (
        t,
        (a * np.sin(angle)).sum(1),
        (a * w * np.cos(angle)).sum(1),
        -(a * w * w * np.sin(angle)).sum(1),
    )


def run(
    arm: Any, seed: int, load: np.ndarray | None = None, more: Any = None, tilt: float = 0.0
) -> tuple[np.ndarray, ...]:
    """t, torque and position of one run; `load` ten numbers added to the last link, `more(q, qd,
    qdd, rigid)` another torque.
    """
    table = table_of(arm)
    inertia = np.array(table.inertia)
    inertia[-1] += 0 if load is None else load
    model = twin(table.with_inertia(inertia, table.drive_inertia))
    model.gravity.linear = 9.81 * np.array([0, -np.sin(tilt), -np.cos(tilt)])
    data, n = model.createData(), table.n
    t, q, qd, qdd = moved(n, seed)
    rigid = np.array([pin.rnea(model, data, *s) for s in zip(q, qd, qdd, strict=True)])
    rng = np.random.default_rng([seed, 1])
    tau = (
        rigid
        + 0.3 * qdd
        + 2.0 * qd
        + 1.5 * np.tanh(qd / 0.003)
        + (0 if more is None else more(q, qd, qdd, rigid))
    )
    return (
        t,
        tau + TORQUE_NOISE * rng.standard_normal(q.shape),
        q + NOISE * rng.standard_normal(q.shape),
    )


def recorded(
    runs: list[tuple[np.ndarray, ...]], splits: tuple[str, ...] = ("fit", "validation", "report")
) -> jaxid.Dataset:
    n = runs[0][1].shape[1]

    def series(name, k):
        return {f"{name}{j + 1}": [r[k][:, j] for r in runs] for j in range(n)}

    units = {f"tau{j + 1}": "N m" for j in range(n)} | {f"q{j + 1}": "rad" for j in range(n)}
    return jaxid.Dataset.from_arrays(
        [r[0] for r in runs], series("tau", 1), series("q", 2), units=units, split=list(splits)
    )


def asked(
    arm: Any, runs: list[tuple[np.ndarray, ...]], effects: Any = None, reference: Any = None
) -> jaxid.Diagnosis:
    """Without the check of the recording, which has its own tests."""
    return run_diagnosis(arm, recorded(runs), 3, effects, (), InverseDynamics(), 0, None, reference)


def named(d: jaxid.Diagnosis) -> set[tuple[str, str]]:
    return {(e.effect, e.location) for e in d.which.effects}


def body(mass: float, x: float, y: float, z: float) -> np.ndarray:
    """Ten numbers of a point mass about the frame's origin."""
    six = np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
    return mass * np.concatenate([six, [x, y, z, 1.0]])


def wrist(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, rigid: np.ndarray) -> np.ndarray:
    """What the last two joints' shared gear takes."""
    out, w = np.zeros_like(q), qd[:, -2] + qd[:, -1]
    out[:, -2:] = (1.2 * w + 0.8 * np.tanh(w / 0.003) + 0.15 * (qdd[:, -2] + qdd[:, -1]))[:, None]
    return out


def at(joint: int, law: Any) -> Any:
    """A torque at one joint."""
    return lambda q, qd, qdd, rigid: (
        np.eye(q.shape[1])[joint] * law(q[:, joint], qd[:, joint], rigid[:, joint])[:, None]
    )


ARMS = {"ur10e": UR10e(), "three": SerialArm(THREE)}
LAWS = {
    "drag": ("three", at(1, lambda q, v, r: 0.8 * np.abs(v) * v), {("quadratic_drag", "q2")}),
    "spring": ("three", at(2, lambda q, v, r: 1.5 * q), {("spring_torque", "q3")}),
    "load": (
        "three",
        at(1, lambda q, v, r: 0.15 * np.abs(r) * np.tanh(v / 0.003)),
        {("load_dependent_friction", "q2")},
    ),
    "wave": ("three", at(2, lambda q, v, r: np.sin(27.0 * q + 0.4)), {("torque_ripple", "q3")}),
    "wrist": ("ur10e", wrist, {("coupled_friction", "q5 and q6")}),
}


@pytest.mark.parametrize(
    "law", [pytest.param(k, marks=() if k == "wrist" else pytest.mark.slow) for k in LAWS]
)
def test_what_is_withheld_is_named(law, tmp_path):
    arm, more, truth = LAWS[law]
    d = asked(ARMS[arm], [run(ARMS[arm], s, more=more) for s in (1, 2, 3)])
    assert d.which.verdict in ("named", "partly") and named(d) == truth, d.which.text
    assert d.how_far.gap_after < 1.6 < d.how_far.gap_retuned
    # All joints move in every row: the errors of the table, over the noise beside them, are the
    # gap.
    each = [
        (c.rmse_retuned / c.noise, c.rmse_after / c.noise) for c in d.how_far.per_channel.values()
    ]
    assert np.sqrt(np.mean(np.square(each), 0)) == pytest.approx(
        [d.how_far.gap_retuned, d.how_far.gap_after], rel=1e-6
    )
    if law.startswith("load"):
        (effect,) = d.which.effects
        reading = effect.parameters["drive_share"].value
        assert (
            reading == (law == "load of the drive")
            and abs(effect.parameters["mu"].value - 0.15) < 0.03
        )
    if law == "wave":
        (effect,) = d.which.effects
        assert abs(effect.parameters["order"].value - 27.0) < 0.2
    assert "<html" in d.report(tmp_path / "report.html").read_text().lower()


def test_further_columns_explain_what_least_squares_says_of_them():
    rng = np.random.default_rng(0)
    rows, more, weight = rng.normal(size=(60, 4)), rng.normal(size=(60, 2)), rng.uniform(1, 2, 60)
    rows[:, 2] = rows[:, 0] + 1e-12 * rows[:, 2]  # two columns say the same

    def left(columns: np.ndarray) -> float:
        own = weight[:, None] * columns
        target = weight * rows[:, -1]
        numbers = np.linalg.lstsq(own, target, rcond=1e-8)[0]
        return float(np.sum((target - own @ numbers) ** 2))

    both = np.column_stack([rows[:, :-1], more])
    found = Rest.of(rows, weight).explained(more)
    assert found == pytest.approx(left(rows[:, :-1]) - left(both), rel=1e-9)


EITHER = ["ur10e", pytest.param("three", marks=pytest.mark.slow)]


@pytest.mark.parametrize("arm", EITHER)
def test_nothing_is_named_where_nothing_is_missing(arm):
    d = asked(ARMS[arm], [run(ARMS[arm], s) for s in (4, 5, 6)])
    assert d.which.verdict == "none" and not d.which.effects, d.which.text


def test_an_outsider_gets_no_name():
    """Damping that depends on the position of another joint is in no library."""

    def outsider(q, qd, qdd, rigid):
        return np.stack([2.5 * np.sin(4 * q[:, 1]) * qd[:, 0], 0 * q[:, 0], 0 * q[:, 0]], 1)

    d = asked(ARMS["three"], [run(ARMS["three"], s, more=outsider) for s in (7, 8, 9)])
    assert d.which.verdict == "unknown", d.which.text
    assert d.how_far.ceiling is not None and d.how_far.ceiling < 0.9


def payload_of(d: jaxid.Diagnosis) -> dict[str, Any]:
    (found,) = [e for e in d.which.effects if e.effect == "payload"]
    return found.parameters


@pytest.mark.parametrize("arm", EITHER)
def test_a_load_that_only_later_runs_carry_is_named(arm):
    load, last = body(1.5, 0.05, 0.02, 0.1), f"q{len(ARMS[arm].prismatic)}"
    d = asked(ARMS[arm], [run(ARMS[arm], 1), run(ARMS[arm], 2, load), run(ARMS[arm], 3, load)])
    assert d.which.verdict == "named" and named(d) == {("payload", last)}, d.which.text
    mass = payload_of(d)["mass"]
    assert abs(mass.value - 1.5) < 0.1
    assert d.where and all("run_1" not in f.text for f in d.where)


@pytest.mark.slow
def test_a_reference_turns_the_question_to_what_is_different():
    arm, load = ARMS["three"], body(1.5, 0.05, 0.02, 0.1)
    before = jaxid.identify(
        arm, recorded([run(arm, s) for s in (11, 12, 13)]), friction="linear", as_recorded=True
    )
    d = asked(arm, [run(arm, s, load) for s in (1, 2, 3)], reference=ReferenceNumbers.read(before))
    assert d.which.verdict in ("named", "partly") and ("payload", "q3") in named(d), d.which.text
    assert abs(payload_of(d)["mass"].value - 1.5) < 0.2
    alone = asked(arm, [run(arm, s, load) for s in (1, 2, 3)])  # absorbed by the arm's own numbers
    assert alone.which.verdict == "none"


@pytest.mark.slow
def test_a_tilted_base_is_named():
    arm = ARMS["three"]
    d = asked(arm, [run(arm, s, tilt=0.05) for s in (1, 2, 3)])
    assert d.which.verdict == "named" and named(d) == {("gravity_offset", "q1")}, d.which.text
    (found,) = d.which.effects
    assert abs(abs(found.parameters["roll"].value) - 0.05) < 0.01


def test_what_a_torque_cannot_show_is_refused_by_name():
    runs = [run(ARMS["three"], s) for s in (1, 2, 3)]
    with pytest.raises(jaxid.UsageError, match="cannot see backlash"):
        asked(ARMS["three"], runs, effects=["backlash"])


@pytest.mark.slow
def test_uneven_samples_tell_what_even_ones_do():
    """Every 15th sample is late by half a step and a rest of the steps are even: plain least
    squares on both is the yardstick.
    """
    t, tau, q = run(ARMS["three"], 1)
    late = t.copy()
    late[7::15] += 0.6 * (t[1] - t[0])
    uneven = [(late, *(np.stack([np.interp(late, t, c) for c in x.T], 1) for x in (tau, q)))]
    numbers = []
    for runs in ([(t, tau, q)], uneven):
        f = jaxid.fit(
            ARMS["three"],
            recorded(runs, ("fit",)),
            residual="inverse_dynamics",
            as_recorded=True,
            cutoff_hz=8.0,
        )
        numbers.append(
            {
                k: v.value
                for k, v in f.parameters.items()
                if v.identifiable and v.std and v.std < 0.1 * abs(v.value)
            }
        )
    shared = numbers[0].keys() & numbers[1].keys()
    assert len(shared) > 8
    for name in shared:
        assert numbers[1][name] == pytest.approx(numbers[0][name], rel=0.05), name


def test_a_series_at_equal_steps():
    t = np.cumsum(np.tile([0.002, 0.002, 0.0053, 0.0018], 200))
    e = jaxid.Dataset.from_arrays(
        t, {"tau": np.sin(t)}, {"q": np.cos(t)}, units={"tau": "N m", "q": "rad"}
    ).experiments[0]
    even = evenly(e)
    assert np.ptp(np.diff(even.t)) < 1e-9 and np.allclose(even.y[:, 0], np.cos(even.t), atol=1e-6)
    assert np.allclose(
        zero_phase(even.t, even.u, 20.0)[100:-100, 0], np.sin(even.t)[100:-100], atol=1e-3
    )
    assert evenly(even) is even


# ---- recordings of others


@pytest.fixture
def public():
    def load(name: str) -> jaxid.Dataset:
        if not (DATA / name).is_dir():
            pytest.skip(f"{name} is not in {DATA}; set JAXID_DATA")
        return jaxid.load_dataset(DATA / name)

    return load


@pytest.mark.slow
def test_a_double_pendulum_is_bounded_honestly(public):
    """Somebody's machine: what it lacks at joint 1 is not known."""
    began = time.process_time()
    d = jaxid.diagnose(
        None,
        public("double_pendulum_c0"),
        residual="inverse_dynamics",
        cutoff_hz=8.0,
        as_recorded=True,
    )
    assert time.process_time() - began < 60
    assert d.which.verdict in ("unknown", "partly")


@pytest.mark.slow
def test_a_load_is_weighed_where_joints_stick_and_torques_are_held(monkeypatch):
    """1.2 kg at the end of link 3, whose centre of mass is at 0.24 m (MuJoCo, encoders, a loop at 200 Hz)."""
    folder = DATA.parent / "cases" / "rec_01_loaded_against_unloaded"
    if not folder.is_dir():
        pytest.skip(f"{folder.name} is not beside {DATA}; set JAXID_DATA")
    monkeypatch.chdir(folder)
    d = jaxid.diagnose(None, jaxid.load_dataset(folder), residual="inverse_dynamics")
    assert d.which.verdict == "named" and named(d) == {("payload", "q3")}, d.which.text
    found = payload_of(d)
    assert abs(found["mass"].value - 1.2) < 2 * found["mass"].std < 0.02
    assert abs(found["x"].value - 0.24) < 0.005


def repeated(drift: float, more: float = 0.0) -> jaxid.Dataset:
    """A joint with friction on four motions, each three times; `drift` is what its friction differs
    by from time to time, `more` viscous friction that acts forwards alone.
    """
    rng, runs = np.random.default_rng(4), []
    for motion in range(4):
        for again, split in enumerate(("fit", "validation", "report")):
            t, q, qd, qdd = moved(1, 40 + motion)
            dry = (1 + drift * rng.standard_normal()) * (0.35 * np.tanh(qd / 0.003) + 0.2 * qd)
            tau = 0.02 * qdd + dry + more * np.maximum(qd, 0) + 0.003 * rng.standard_normal(q.shape)
            first = None if again == 0 else f"m{motion}_0"
            runs.append(
                Experiment(
                    f"m{motion}_{again}",
                    split,
                    t,
                    tau,
                    q + NOISE * rng.standard_normal(q.shape),
                    repeat_of=first,
                )
            )
    return Dataset(
        "repeated", (Channel("tau", "input", "N m"), Channel("q", "output", "rad")), tuple(runs)
    )


def claimed_of(study: TorqueStudy, rows: Any, weights: Any, chooser: Any) -> list[str]:
    """Effects that the evidence of the fit and validation runs claims."""
    which = [*study.of("fit"), *study.of("validation")]
    found = claims(weigh(scales(study, rows, weights, chooser, which)), 3)
    return [rows.units[claim.unit].effect for claim in found]


@pytest.mark.parametrize("drift", [0.0, 0.08])
def test_what_repeats_differ_by_is_noise(drift):
    data = repeated(drift)
    study = TorqueStudy(bind("joint", data), [AsymmetricFriction], None, None, False)
    rows, weights = study.rows_with_effects(study.theta)
    coulomb = (
        np.linalg.norm(
            weights.spread[study.plant.free.index(study.binding.layout.index("coulomb"))]
        )
        / 0.35
    )
    assert coulomb < 0.02 if drift == 0 else 0.04 < coulomb < 0.16
    chooser = study.chooser(rows, weights, study.of("fit"), study.of("validation"))
    nominal = of_model(study, rows, chooser.nominal)
    assert 0.4 < nominal.gap(study.of("validation")) < 2.2
    assert claimed_of(study, rows, weights, chooser) == []


def test_an_effect_shows_in_spite_of_what_repeats_differ_by():
    study = TorqueStudy(
        bind("joint", repeated(0.04, 0.15)), [AsymmetricFriction], None, None, False
    )
    rows, weights = study.rows_with_effects(study.theta)
    chooser = study.chooser(rows, weights, study.of("fit"), study.of("validation"))
    assert claimed_of(study, rows, weights, chooser) == ["asymmetric_friction"]


def _free_swings(**inputs) -> jaxid.Dataset:
    t = np.arange(0, 12.0, 5e-3)
    swing = 0.6 * np.exp(-0.08 * t) * np.cos(5.0 * t)
    return jaxid.Dataset.from_arrays(
        [t, t],
        {name: [made(t), made(t)] for name, made in inputs.items()},
        {"q": [swing, 0.7 * swing]},
        units={"q": "rad", **dict.fromkeys(inputs, "N m")},
        split=["fit", "validation"],
        noise_std={"q": 1e-4},
        model=ModelSpec("pendulum", constants={"inertia": 0.08}),
        check_model=False,
    )


def test_free_swings_are_compared_by_torque():
    """They have no input: what is not recorded is nothing, as in a simulation."""
    study = TorqueStudy(bind(None, _free_swings()), [QuadraticDrag], None, None, False)
    for run in study.runs:
        assert run.u.shape == run.q.shape and not run.u.any()
    places = searched(study, 1).weighed.places
    assert 0.0 <= places["quadratic_drag", "q"] <= 1.0


@pytest.mark.parametrize("recorded", [False, True])
def test_a_drive_that_gives_nothing_has_no_effects(recorded):
    """A gain that takes all of the torque away would meet any motion without a drive."""
    inputs = {"tau": np.zeros_like} if recorded else {}
    kinds = [QuadraticDrag, TorqueScale, InputDelay]
    study = TorqueStudy(bind(None, _free_swings(**inputs)), kinds, None, None, False)
    effects = {u.effect for u in study.asked(kinds, study.theta)}
    assert effects == {"quadratic_drag"}
    driven = TorqueStudy(bind(None, _free_swings(tau=np.sin)), kinds, None, None, False)
    effects = {u.effect for u in driven.asked(kinds, driven.theta)}
    assert effects == {"quadratic_drag", "torque_scale", "input_delay"}


def test_a_machine_that_coasts_tells_no_numbers_by_torque():
    """Without any torque the numbers of its model at zero meet every motion."""
    t = np.arange(0, 4.0, 5e-3)
    coasts = [v * (1 - np.exp(-0.8 * t)) for v in (6.0, 4.0)]
    data = jaxid.Dataset.from_arrays(
        [t, t],
        {"force": [0 * t, 0 * t]},
        {"position": coasts},
        units={"force": "N", "position": "m"},
        split=["fit", "validation"],
        noise_std={"position": 1e-4},
        model="joint",
        check_model=False,
    )
    with pytest.raises(UsageError, match="only the ratios of inertia, viscous, coulomb, offset"):
        jaxid.diagnose(None, data, residual="inverse_dynamics")
    stated = replace(data, model=ModelSpec("joint", constants={"inertia": 2.0}))
    found = jaxid.diagnose(None, stated, residual="inverse_dynamics")
    assert found.nominal.parameters["viscous"].value == pytest.approx(1.6, rel=0.01)
