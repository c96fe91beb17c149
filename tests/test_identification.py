"""Identification of six-axis arms: a UR10 simulated by Pinocchio, payloads, the recursion;
recordings where they are at hand.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import jaxid
from jaxid.cli.app import cli
from jaxid.dynamics.base_parameters import standard_values
from jaxid.dynamics.rigid_body import about_origin
from jaxid.fitting.recursive_least_squares import ridge_rls
from jaxid.identification.online import OnlineIdentification
from jaxid.identification.run import _errors, identify
from jaxid.models import UR10
from jaxid.report.identified import error
from test_serial_arm import table_of, twin


pin: Any = pytest.importorskip("pinocchio")

DATA = Path(
    os.environ.get("JAXID_DATA", Path(__file__).parents[1] / ".." / "shared" / "data")
).resolve()
HOME = np.array([0, -np.pi / 2, 0, -np.pi / 2, 0, 0])
#: Paper 001: friction of Table VI (F_c2 := 0), torque noise of Table II, the first payload in frame
#: 6.
LEVEL = np.array([10.0037, 0.0, 5.1803, 2.7800, 2.0115, 1.7533])
VISCOUS = np.array([21.6084, 26.4096, 15.1400, 2.7746, 3.4578, 3.5335])
EXPONENT = np.array([0.5758, 0.2723, 0.6093, 0.9995, 0.8031, 0.7209])
OFFSET = np.array([-0.3426, 0.0582, 0.1780, 0.6453, 0.6725, 0.5685])
NOISE = np.array([3.7817, 4.1789, 3.0339, 1.7334, 1.0670, 0.9896])
LOAD = about_origin(3.5256, [0, 0, 0.0296], [0.0064, 0, 0, 0.0064, 0, 0.0045])


def excitation(seed: int, seconds: float = 10.0) -> tuple[np.ndarray, ...]:
    """Five harmonics of 0.1 Hz about the home pose, as (17) of the paper; t, q, qd, qdd."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, 1 / 125)
    w = 2 * np.pi * 0.1 * np.arange(1, 6)
    a, b = rng.normal(size=(2, 5, 6))
    peak = np.hypot(a, b)
    shrink = np.maximum((peak / w[:, None]).sum(0) / 1.4, peak.sum(0) / 2.0)
    a, b = a / shrink, b / shrink
    s, c, wide = np.sin(np.outer(t, w)), np.cos(np.outer(t, w)), w[:, None]
    return (
        t,
        HOME + s @ (a / wide) - c @ (b / wide),
        c @ a + s @ b,
        -s @ (a * wide) + c @ (b * wide),
    )


def torque(
    motion: tuple[np.ndarray, ...], load: np.ndarray | None = None, exponent: np.ndarray = EXPONENT
) -> np.ndarray:
    """Joint torque by Pinocchio, plus the paper's friction."""
    table = table_of(UR10())
    if load is not None:
        inertia = table.inertia.copy()
        inertia[-1] += load
        table = table.with_inertia(inertia)
    model = twin(table)
    model.armature = table.drive_inertia
    data = model.createData()
    _, q, qd, qdd = motion
    tau = np.array([pin.rnea(model, data, *s) for s in zip(q, qd, qdd, strict=True)])
    return tau + (LEVEL + VISCOUS * np.abs(qd) ** exponent) * np.sign(qd) + OFFSET


def recording(
    load: np.ndarray | None, noise: float, seed: int, exponent: np.ndarray = EXPONENT
) -> jaxid.Dataset:
    """A fitted run and one for validation, other motion."""
    rng = np.random.default_rng(seed)
    runs = [excitation(3), excitation(8)]
    taus = [torque(m, load, exponent) for m in runs]
    taus = [tau + noise * NOISE * rng.normal(size=tau.shape) for tau in taus]
    return jaxid.Dataset.from_arrays(
        [m[0] for m in runs],
        {f"tau{j + 1}": [tau[:, j] for tau in taus] for j in range(6)},
        {f"q{j + 1}": [m[1][:, j] for m in runs] for j in range(6)},
        model="ur10",
        split=["fit", "validation"],
    )


def truth(base, load: np.ndarray | None = None) -> np.ndarray:
    table = table_of(UR10())
    phi = np.column_stack([table.inertia, table.drive_inertia])
    if load is not None:
        phi[-1, :10] += load
    return base.values(phi.ravel())


@pytest.fixture(scope="module")
def quiet():
    return recording(None, 0.02, 1)


@pytest.mark.parametrize("method", ["ls", "wls", "rls", "tls", "constrained"])
def test_base_parameters_and_friction_come_back(quiet, method):
    r = identify(None, quiet, method=method, friction="power")
    base = UR10().base()
    error = np.abs(r.theta[:40] - truth(base))
    assert np.all(error < 0.02 + 0.03 * np.abs(truth(base))), dict(
        zip(base.names, error, strict=True)
    )
    assert max(e.relative_error for e in r.experiments) < 0.01
    assert r.exponents is not None and np.abs(r.exponents - EXPONENT)[[0, 2, 3, 4, 5]].max() < 0.05
    assert r.identifiable.all()
    assert (r.standard is not None) == (method == "constrained")


def test_the_right_law_wins_on_held_out_motion(quiet):
    assert identify(None, quiet).law == "power"
    assert identify(None, recording(None, 0.02, 1, np.ones(6))).law == "linear"


def test_after_its_time_an_identification_tries_no_further_law(quiet, monkeypatch):
    monkeypatch.setattr("jaxid.base.deadline.SEARCH", 0.0)
    short = identify(None, quiet, seconds=3600)
    assert not short.complete and [trial.law for trial in short.laws] == ["linear"]
    assert short.to_dict()["complete"] is False and "within 3600 s" in short.notes[-1]
    with pytest.raises(jaxid.UsageError, match="nothing was known yet"):
        identify(None, quiet, seconds=1e-3)


@pytest.mark.slow
def test_a_constrained_arm_can_be_simulated(quiet):
    """Noise makes plain estimates unphysical; the constrained ones are bodies that can exist, and
    predict as well.
    """
    from jaxid.dynamics.rigid_body import pseudo_inertia

    noisy = recording(None, 1.0, 5)
    plain, bodies = (
        identify(None, noisy, method=m, friction="power") for m in ("wls", "constrained")
    )
    assert bodies.standard is not None
    phi = np.array(list(bodies.standard.values())).reshape(6, 11)
    assert np.linalg.eigvalsh(pseudo_inertia(phi[:, :10])).min() > 0 and phi[:, 10].min() >= 0
    assert (bodies.theta[40:52] >= 0).all()
    assert bodies.experiments[1].relative_error < 1.05 * plain.experiments[1].relative_error


def test_one_moving_joint_leaves_directions_open():
    """What one joint's motion cannot show is said to be open and stays where the model had it."""
    t, q, qd, qdd = excitation(3)
    hold = np.tile(HOME, (len(t), 1))
    hold[:, 3] = q[:, 3]
    rates = [np.where(np.arange(6) == 3, x, 0.0) for x in (qd, qdd)]
    tau = torque((t, hold, *rates)) + 0.01 * np.random.default_rng(0).normal(size=q.shape)
    wiggle = 1e-12 * np.sin(np.outer(t, np.ones(6)))
    data = jaxid.Dataset.from_arrays(
        t,
        {f"tau{j + 1}": tau[:, j] for j in range(6)},
        {f"q{j + 1}": (hold + wiggle)[:, j] for j in range(6)},
        model="ur10",
    )
    r = identify(None, data, friction="linear")
    assert not r.identifiable[list(r.names).index("Ixx2")]
    assert any("not determined" in n for n in r.notes)
    assert np.abs(r.theta[:40]).max() < 50


# ---- payload


def test_payload_by_difference():
    """Mass and centre of mass within their intervals; all rows beat the paper's three at equal
    data.
    """
    empty = identify(None, recording(None, 1.0, 11), friction="power")
    loaded = identify(
        None, recording(LOAD, 1.0, 12), friction="power", reference=empty, gain_std=0.0
    )
    payload = loaded.payload
    assert payload is not None and payload.rows == 22 and payload.published is not None
    m, std = payload.mass
    assert abs(m - LOAD[9]) < 3 * std and std < 0.2
    for (value, spread), real in zip(payload.com(), LOAD[6:9] / LOAD[9], strict=True):
        assert abs(value - real) < 3.5 * spread and spread < 0.01
    assert abs(payload.published[9] - LOAD[9]) < 0.5
    content = loaded.to_dict()["payload"]
    low, high = content["mass"]["interval_95"]
    assert low < m < high and high - low == pytest.approx(2 * 1.96 * std, rel=1e-3)


def test_payload_rows_are_exact_without_noise():
    """Equations (12) to (16) and least squares of all rows return the body that was added."""
    from jaxid.identification.payload import payload_of

    base = UR10().base()
    found = payload_of(truth(base, LOAD) - truth(base), 1e-6 * np.eye(40), base)
    assert np.allclose(found.phi, LOAD, atol=1e-9) and np.allclose(found.body, LOAD, atol=1e-6)
    assert found.published is not None and np.allclose(found.published, LOAD, atol=1e-9)


def test_impossible_payloads_become_the_nearest_body():
    """The paper's own identified payload has negative moments of inertia."""
    from jaxid.dynamics.rigid_body import pseudo_inertia
    from jaxid.identification.payload import nearest_body

    paper = np.array(
        [0.0023, -0.0289, -0.0480, -0.0958, 0.0265, -0.0501, -0.0751, 0.0056, 0.1819, 3.5242]
    )
    assert np.linalg.eigvalsh(pseudo_inertia(paper)).min() < 0
    body = nearest_body(
        paper, np.diag(1 / np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05, 0.05, 0.05]) ** 2)
    )
    assert np.linalg.eigvalsh(pseudo_inertia(body)).min() >= -1e-12 and abs(body[9] - 3.5242) < 0.05


@pytest.mark.slow
def test_references_of_another_arm_are_refused(quiet, tmp_path):
    with pytest.raises(jaxid.UsageError, match="identification.json of the unloaded arm"):
        identify(None, quiet, friction="linear", reference={"kind": "fit"})
    with pytest.raises(jaxid.UsageError, match="cannot be read"):
        identify(None, quiet, friction="linear", reference=tmp_path / "none.json")
    other = identify(None, quiet, friction="linear").to_dict()
    other["names"] = other["names"][1:]
    with pytest.raises(jaxid.UsageError, match="same model"):
        identify(None, quiet, friction="linear", reference=other)


@pytest.mark.slow
def test_feed_forward_holds_the_loaded_arm(tmp_path):
    """Gravity and torque of the loaded arm, elsewhere than where it was identified, against
    Pinocchio.
    """
    from jaxid.identification.feed_forward import FeedForward

    loaded = identify(None, recording(LOAD, 0.02, 12), friction="power")
    forward = FeedForward.load(FeedForward.of(loaded).save(tmp_path / "forward.json"))
    motion = excitation(21)
    expected = torque(motion, LOAD)
    error = forward(*motion[1:]) - expected
    moving = np.abs(motion[2]) > 0.05  # sign(qd) is smoothed
    assert np.sqrt(np.mean(error[moving] ** 2)) < 0.02 * np.sqrt(np.mean(expected[moving] ** 2))
    model = twin(
        table_of(UR10()).with_inertia(
            table_of(UR10()).inertia + np.vstack([np.zeros((5, 10)), LOAD])
        )
    )
    g = np.array(
        [pin.computeGeneralizedGravity(model, model.createData(), q) for q in motion[1][::100]]
    )
    assert np.abs(forward.gravity(motion[1][::100]) - g).max() < 1.0
    assert np.allclose(forward.gravity(motion[1][0]), forward.gravity(motion[1][:1])[0])
    empty = identify(None, recording(None, 0.02, 11), friction="power")
    bare = FeedForward.of(empty.to_dict()).gravity(motion[1][::100])
    assert np.abs(bare - g).max() > 10.0  # without the load it would sag
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(jaxid.UsageError, match="feed-forward"):
        FeedForward.load(tmp_path / "other.json")


# ---- online


@pytest.fixture(scope="module")
def stream():
    """Motion, torque and the written-out regressor of the loaded arm."""
    motion = excitation(3)
    return motion, torque(motion, LOAD) + NOISE * np.random.default_rng(4).normal(
        size=(len(motion[0]), 6)
    )


def prior() -> np.ndarray:
    return np.concatenate([truth(UR10().base()), LEVEL, VISCOUS, OFFSET])


def test_recursion_is_ridge_regression(stream):
    """(8) to (11) with P0 = 10, xi = 100 equal the closed form with prior weight xi / P0, and the
    stop rule counts.
    """
    from jaxid.dynamics.base_parameters import torque_columns
    from jaxid.identification.regression import friction_columns, LAWS

    (t, q, qd, qdd), tau = stream
    online = OnlineIdentification(UR10(), prior(), exponent=EXPONENT)
    for k in range(600):
        online.update(q[k], qd[k], qdd[k], tau[k])
    F = friction_columns(LAWS["power"], qd[:600], EXPONENT)
    W = np.zeros((600, 6, 58))
    W[:, :, :40] = torque_columns(UR10(), q[:600], qd[:600], qdd[:600])[
        :, :, list(online.base.kept)
    ]
    for i in range(3):
        W[:, np.arange(6), 40 + 6 * i + np.arange(6)] = F[:, i]
    W = W.reshape(-1, 58)
    ridge = np.linalg.solve(W.T @ W + 10 * np.eye(58), W.T @ tau[:600].ravel() + 10 * prior())
    assert np.abs(online.theta - ridge).max() < 1e-9
    assert np.allclose(online.covariance, np.linalg.inv(W.T @ W / 100 + np.eye(58) / 10), atol=1e-9)
    assert [online.names[i] for i in online.watched] == [
        "Ixy6",
        "Ixz6",
        "Iyz6",
        "Izz6",
        "mx6",
        "my6",
    ]  # pi_31 .. pi_36


def test_a_rehearsal_changes_nothing(stream):
    (t, q, qd, qdd), tau = stream
    twins = [OnlineIdentification(UR10(), prior(), exponent=EXPONENT) for _ in range(2)]
    twins[1].rehearse()  # also before the first sample
    for k in range(20):
        for online in twins:
            online.update(q[k], qd[k], qdd[k], tau[k])
        twins[1].rehearse()
    assert all(np.array_equal(a, b) for a, b in zip(twins[0].state, twins[1].state, strict=True))


def test_payload_online_and_the_stop_rule(stream):
    (t, q, qd, qdd), tau = stream
    online = OnlineIdentification(
        UR10(), prior(), exponent=EXPONENT, noise_var=NOISE**2, prior_var=10.0
    )
    clean = torque((t, q, qd, qdd), LOAD)
    for k in range(len(t)):
        online.update(q[k], qd[k], qdd[k], clean[k])
        online.check() if k % 25 == 0 else None
    m, std = online.payload().mass
    assert abs(m - LOAD[9]) < 3 * std + 0.02 and std < 0.1
    assert abs((online.published_mass() or 0) - LOAD[9]) < 0.1
    assert online.converged_at is not None and 300 < online.converged_at < len(t)


def test_forgetting_follows_a_change():
    """A load dropped halfway: with a forgetting factor the estimate follows, without it stays
    between.
    """
    motion = excitation(3)
    half = len(motion[0]) // 2
    tau = np.concatenate([torque(motion, LOAD)[:half], torque(motion)[half:]])
    masses = {}
    for forgetting in (1.0, 0.99):
        online = OnlineIdentification(
            UR10(), prior(), exponent=EXPONENT, noise_var=1.0, forgetting=forgetting
        )
        for k in range(len(tau)):
            online.update(motion[1][k], motion[2][k], motion[3][k], tau[k])
        masses[forgetting] = online.payload().mass[0]
    assert abs(masses[0.99]) < 0.3 < 1.0 < masses[1.0]
    with pytest.raises(jaxid.UsageError, match="forgetting"):
        OnlineIdentification(UR10(), forgetting=1.5)


def test_streaming_does_not_recompile(stream):
    (t, q, qd, qdd), tau = stream
    online = OnlineIdentification(UR10(), prior(), exponent=EXPONENT)
    online.update(q[0], qd[0], qdd[0], tau[0])
    before = online._update._cache_size()  # pyright: ignore
    times = []
    for k in range(1, 400):
        began = time.perf_counter()
        online.update(q[k], qd[k], qdd[k], tau[k])
        online.theta  # waits for it
        times.append(time.perf_counter() - began)
    assert online._update._cache_size() == before  # pyright: ignore
    assert np.median(times) < 2e-3  # 500 Hz, on any machine; the figure stands in benchmarks/


def test_recursion_is_a_pure_function():
    import jax
    import jax.numpy as jnp

    from jaxid.fitting.recursive_least_squares import RecursiveState
    from jaxid.numerics.precision import float64

    rng = np.random.default_rng(0)
    with float64():
        Y, tau = jnp.asarray(rng.normal(size=(50, 2, 4))), jnp.asarray(rng.normal(size=(50, 2)))
        zero = jnp.zeros((), jnp.int32)
        start = RecursiveState(jnp.zeros(4), 3.0 * jnp.eye(4), zero, zero)
        end, _ = jax.lax.scan(
            lambda s, x: (ridge_rls(s, *x, noise_var=jnp.array([1.0, 4.0])), None), start, (Y, tau)
        )
        w = np.array([1.0, 0.25])
        H = np.einsum("tji,j,tjk->ik", Y, w, Y) + np.eye(4) / 3
        assert np.allclose(
            end.theta, np.linalg.solve(H, np.einsum("tji,j,tj->i", Y, w, tau)), atol=1e-12
        )
    assert int(end.seen) == 50


def test_recursion_ends_at_weighted_least_squares(quiet):
    """`rls` sees the same rows with the same weights as `wls`, but all of them and one after the
    other.
    """
    a, b = (identify(None, quiet, method=m, friction="linear") for m in ("wls", "rls"))
    assert np.abs(a.theta - b.theta).max() < 0.3 * np.max(a.std()) + 1e-3
    assert b.experiments[1].relative_error == pytest.approx(
        a.experiments[1].relative_error, rel=0.05
    )


def test_recursion_says_when_the_payload_has_converged():
    empty = identify(None, recording(None, 0.05, 11), friction="linear", method="rls")
    loaded = identify(
        None, recording(LOAD, 0.05, 12), friction="linear", method="rls", reference=empty
    )
    assert loaded.payload is not None
    content = loaded.to_dict()["payload"]
    assert content["converged_after_s"] is None or 2.4 < content["converged_after_s"] <= 10.0


def test_replay_is_the_stream(stream):
    """The recursion over recorded rows ends where the stream ends, and its rule fires at the same
    sample.
    """
    from jaxid.dynamics.base_parameters import torque_columns
    from jaxid.fitting.recursive_least_squares import replay
    from jaxid.identification.regression import friction_columns, LAWS

    (t, q, qd, qdd), _ = stream
    tau = torque((t, q, qd, qdd), LOAD)
    online = OnlineIdentification(UR10(), prior(), exponent=EXPONENT)
    for k in range(len(t)):
        online.update(q[k], qd[k], qdd[k], tau[k])
        online.check()
    F = friction_columns(LAWS["power"], qd, EXPONENT)
    W = np.zeros((len(t), 6, 58))
    W[:, :, :40] = torque_columns(UR10(), q, qd, qdd)[:, :, list(online.base.kept)]
    for i in range(3):
        W[:, np.arange(6), 40 + 6 * i + np.arange(6)] = F[:, i]
    theta, P, met = replay(W, tau, prior(), watched=online.watched)
    assert np.abs(theta - online.theta).max() < 1e-8 and np.abs(P - online.covariance).max() < 1e-8
    assert met == online.converged_at


# ---- instruments


def test_instruments_need_the_commanded_motion(quiet):
    with pytest.raises(jaxid.UsageError, match="q1_cmd"):
        identify(None, quiet, method="iv", friction="linear")


def test_instruments_remove_the_bias_of_noisy_positions():
    """Encoder noise in the columns shrinks the drive inertias of least squares; instruments bring
    them back.
    """
    runs, rng = [excitation(3), excitation(8)], np.random.default_rng(2)
    taus = [torque(m, exponent=np.ones(6)) for m in runs]
    noisy = [m[1] + 2e-3 * rng.normal(size=m[1].shape) for m in runs]
    data = jaxid.Dataset.from_arrays(
        [m[0] for m in runs],
        {f"tau{j + 1}": [tau[:, j] for tau in taus] for j in range(6)},
        {f"q{j + 1}": [q[:, j] for q in noisy] for j in range(6)},
        auxiliary={f"q{j + 1}_cmd": [m[1][:, j] for m in runs] for j in range(6)},
        model="ur10",
    )
    real = truth(UR10().base())
    settings: dict[str, Any] = {"friction": "linear", "cutoff_hz": 8.0, "motion_hz": 25.0}
    error = {
        m: np.linalg.norm(identify(None, data, method=m, **settings).theta[:40] - real)
        for m in ("ls", "iv")
    }
    assert error["iv"] < 0.5 * error["ls"], error


# ---- command line, recordings


def test_the_command(quiet, tmp_path):
    jaxid.save_dataset(quiet, tmp_path / "data")
    out = tmp_path / "out"
    done = CliRunner().invoke(
        cli,
        ["identify", str(tmp_path / "data"), "--out", str(out), "--friction", "power", "--json"],
    )
    assert done.exit_code == 0, done.output
    content = json.loads((out / "identification.json").read_text())
    assert content == json.loads(done.stdout)
    assert content["schema"] == 1 and content["kind"] == "identification"
    assert len(content["base_parameters"]) == 40 and len(content["friction"]) == 6
    assert {"F_c", "F_v", "offset", "exponent"} <= set(content["friction"][0])
    assert [e["split"] for e in content["experiments"]] == ["fit", "validation"]
    page = (out / "report.html").read_text()
    assert "Base parameters" in page and "<script" not in page
    loaded = CliRunner().invoke(
        cli,
        [
            "identify",
            str(tmp_path / "data"),
            "--out",
            str(tmp_path / "b"),
            "--friction",
            "power",
            "--reference",
            str(out / "identification.json"),
            "--quiet",
        ],
    )
    assert loaded.exit_code == 0, loaded.output
    assert (
        abs(
            json.loads((tmp_path / "b" / "identification.json").read_text())["payload"]["mass"][
                "value"
            ]
        )
        < 1e-6
    )


def test_an_arm_from_a_urdf(tmp_path):
    """`--model arm.urdf`: a slide and two hinges, named by the joints' numbers in the recording."""
    from test_serial_arm import URDF

    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    model = pin.buildModelFromUrdf(str(path))
    data, t = model.createData(), np.arange(0, 12, 0.01)
    rng = np.random.default_rng(0)
    w = 2 * np.pi * np.array([0.15, 0.4, 0.7])
    a = rng.uniform(0.2, 0.5, (3, 3))
    phase = rng.uniform(0, 6, (3, 3))
    angle = w[:, None] * t[:, None, None] + phase
    q, qd, qdd = (
        (a * np.sin(angle)).sum(1),
        (a * w[:, None] * np.cos(angle)).sum(1),
        -(a * w[:, None] ** 2 * np.sin(angle)).sum(1),
    )

    def state(s):
        return np.r_[s[:2], np.cos(s[2]), np.sin(s[2])]

    tau = (
        np.array(
            [pin.rnea(model, data, state(s), v, x) for s, v, x in zip(q, qd, qdd, strict=True)]
        )
        + 0.5 * qd
    )
    tau += 0.01 * rng.normal(size=tau.shape)
    recorded = jaxid.Dataset.from_arrays(
        t,
        {f"tau{j + 1}": tau[:, j] for j in range(3)},
        {f"q{j + 1}": q[:, j] for j in range(3)},
        units={"tau2": "N", "q2": "m"},
        check_model=False,
    )
    r = identify(str(path), recorded, friction="linear")
    assert r.torque_units == ("N m", "N", "N m")
    assert all(e.relative_error < 0.01 for e in r.experiments)
    assert np.allclose(r.theta[-6:-3], 0.5, atol=0.05)  # F_v


def arm_folder(folder: Path, model: str) -> Path:
    """A dataset of two joints in a folder; `model` is its [model] table."""
    t = np.arange(0, 4, 0.02)
    q = np.stack([0.5 * np.sin(2 * t) + 0.2 * np.sin(5 * t), 0.4 * np.cos(3 * t)], 1)
    columns = np.column_stack([t, q, 3 * np.sin(q)])
    folder.mkdir()
    np.savetxt(folder / "run.csv", columns, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    channels = "".join(
        f'[channels.{n}{j}]\nrole = "{role}"\nunit = "{unit}"\n'
        for n, role, unit in (("q", "output", "rad"), ("tau", "input", "N m"))
        for j in (1, 2)
    )
    (folder / "dataset.toml").write_text(
        f'name = "two"\n{model}\n{channels}[[experiments]]\nfile = "run.csv"\n'
    )
    return folder


TABLE = 'name = "serial_arm"\n[model.dh]\na = [0.0, 0.4]\nalpha = [1.5707963, 0.0]\nd = [0.3, 0.0]'


@pytest.mark.slow
def test_links_in_the_dataset(tmp_path):
    """A table under [model.dh], and a URDF of the folder: read, fitted, saved and read again."""
    from jaxid.problem.binding import resolve_model
    from test_serial_arm import URDF

    data = jaxid.load_dataset(arm_folder(tmp_path / "dh", f"[model]\n{TABLE}"))
    arm: Any = resolve_model(None, data).mechanism
    assert (
        arm.prismatic == (False, False)
        and np.allclose(arm.a, [0, 0.4])
        and np.allclose(arm.d, [0.3, 0])
    )
    assert len(identify(None, data, friction="linear", cutoff_hz=4.0).weights) == 2
    again = jaxid.load_dataset(jaxid.save_dataset(data, tmp_path / "copy"))
    assert again == data and again.model == data.model

    text = URDF.replace('type="prismatic"', 'type="revolute"')
    folder = arm_folder(tmp_path / "urdf", '[model]\nname = "serial_arm"\nurdf = "arm.urdf"')
    (folder / "arm.urdf").write_text(text)
    with pytest.raises(jaxid.DatasetError, match="tau3"):  # it has three joints, the recording two
        jaxid.load_dataset(folder)
    tip = "slide"  # behind the second joint
    (folder / "dataset.toml").write_text(
        (folder / "dataset.toml")
        .read_text()
        .replace('urdf = "arm.urdf"', f'urdf = "arm.urdf"\ntip = "{tip}"')
    )
    data = jaxid.load_dataset(folder)
    assert resolve_model(None, data).nq == 2
    assert jaxid.load_dataset(jaxid.save_dataset(data, tmp_path / "copy_2")).model == replace_file(
        data.model
    )


def replace_file(spec: Any) -> Any:
    """The same model as a saved dataset names it."""
    from dataclasses import replace

    return replace(spec, geometry=replace(spec.geometry, file="arm.urdf"))


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (
            TABLE.replace("alpha = [1.5707963, 0.0]", "alpha = [0.0]"),
            "alpha has 1 entries and a has 2",
        ),
        (TABLE.replace("serial_arm", "ur10"), "serial_arm"),
        ('name = "serial_arm"\nurdf = "../arm.urdf"', "outside the folder"),
        ('name = "serial_arm"\nurdf = "arm.urdf"', "there is no file"),
        ('name = "serial_arm"\nurdf = "run.csv"', "neither .urdf nor .xml"),
    ],
)
def test_links_that_cannot_be_read_are_refused(model, words, tmp_path):
    with pytest.raises(jaxid.DatasetError, match=words):
        jaxid.load_dataset(arm_folder(tmp_path / "data", f"[model]\n{model}"))


def test_entities_in_a_urdf_are_refused(tmp_path):
    folder = arm_folder(tmp_path / "data", '[model]\nname = "serial_arm"\nurdf = "arm.urdf"')
    (folder / "arm.urdf").write_text(
        '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="r">&x;</robot>'
    )
    with pytest.raises(jaxid.DatasetError, match="entities"):
        jaxid.load_dataset(folder)


def test_models_that_are_no_arm_are_refused():
    t = np.linspace(0, 2, 201)
    data = jaxid.Dataset.from_arrays(t, {"tau": np.sin(t)}, {"q": np.sin(3 * t)}, model="pendulum")
    with pytest.raises(jaxid.UsageError, match="needs a serial arm"):
        identify(None, data)


@pytest.mark.skipif(not (DATA / "ur10e").is_dir(), reason="no recordings at hand")
def test_ur10e_recordings():
    """Torque errors of the recording's own README: 3.90, 4.64, 4.54 %; the over-fitting friction
    law is turned down.
    """
    r = identify(None, jaxid.load_dataset(DATA / "ur10e"))
    errors = [e.relative_error for e in r.experiments]
    assert errors[0] < 0.0395 and errors[1] < 0.047 and errors[2] < 0.046, errors
    assert all(e.unfiltered_relative_error > e.relative_error for e in r.experiments)
    assert r.law == "linear"
    richer = next(t for t in r.laws if t.law == "stribeck")
    assert richer.fit < r.laws[0].fit and richer.held_out[1] > r.laws[0].held_out[1]


# ---- near the file


def test_rows_beside_what_is_known_are_a_ridge():
    """Weights as they end, rows as many as are independent: the minimum of both sums of squares."""
    from jaxid.force.rows import ForceRows
    from jaxid.identification.estimators import independent_share, weighted

    rng = np.random.default_rng(1)
    W, true, known = (
        rng.normal(size=(400, 2, 3)),
        np.array([1.0, -2.0, 0.5]),
        np.array([1.2, -1.5, 0.0]),
    )
    W[:, :, 2] *= 1e-3  # hardly shown
    tau = W @ true + rng.normal(size=(400, 2)) * np.array([0.1, 0.5])
    rows = ForceRows.of([W], [tau])
    spread = np.array([0.1, 0.1, 0.1])
    theta, (w,) = weighted(rows, known, spread=spread)
    H = np.einsum("tji,j,tjk->ik", W, w**2, W) + np.diag(spread**-2)
    b = np.einsum("tji,j,tj->i", W, w**2, tau) + known / spread**2
    assert np.allclose(theta, np.linalg.solve(H, b), rtol=1e-8)
    assert abs(theta[0] - 1.0) < 0.02 and abs(theta[2]) < 0.05, (
        "what the rows show is theirs, the rest is known"
    )
    share = independent_share(rows, theta)[0]
    assert np.all(share > 0.7)
    assert np.allclose(w, share / rows.rms(theta)[0], rtol=0.02)


@pytest.mark.parametrize(("second", "kept"), [(0.2, True), (0.6, False)])
def test_a_file_is_trusted_only_where_every_validation_run_is_predicted_better(second, kept):
    from jaxid.identification.trust import nearer_the_file

    errors = {0.3: np.array([0.2, second]), "free": np.array([0.3, 0.4])}
    near = nearer_the_file(lambda t: t, lambda s: errors.get(s, np.array([9.0, 9.0])), "free", 0.01)
    assert (near == (0.3, 0.3)) == kept
    assert nearer_the_file(lambda t: t, lambda s: np.array([]), "free", 0.01) is None, (
        "nothing to choose by"
    )


@pytest.mark.slow
def test_what_short_recordings_leave_open_stays_near_the_file():
    """Seven joints, 4.7 s that are fitted: by that alone another recording is predicted worse than
    by nothing.
    """
    if not (DATA / "kinova_gen3").is_dir():
        pytest.skip(f"{DATA / 'kinova_gen3'} is not here; set JAXID_DATA")
    found = identify(None, jaxid.load_dataset(DATA / "kinova_gen3"), friction="linear")
    assert "count as known to within" in " ".join(found.notes)
    rows = {(r["experiment"], r["joint"]): r for r in found.per_joint}
    moving = rows[
        "joint_2_trapez", "q2"
    ]  # neither fitted nor chosen on; the one joint that moves in it
    assert moving["retuned"] < 0.5 * moving["as_it_stands"]
    others = [rows["RunTrajectory1", f"q{k}"] for k in range(1, 8)]
    assert all(r["retuned"] < r["as_it_stands"] for r in others)
    assert sum(r["retuned"] < 0.5 * r["as_it_stands"] for r in others) >= 6


@pytest.mark.parametrize("joint", [1, 9, 10, 12])
def test_a_standard_parameter_is_that_of_its_own_joint(joint):
    arm = SimpleNamespace(Ixx=np.arange(1.0, 13.0))
    assert standard_values(arm, [f"Ixx{joint}"]) == [joint]


def test_a_joint_that_stands_still_has_no_relative_error():
    torque = np.array([[2.0, 0.05], [-2.0, 0.05]])
    modelled = np.array([[1.5, 2.0], [-1.5, 2.0]])
    _, each, _ = _errors(torque, modelled, np.array([1.0, 0.0]))
    assert each[0] == pytest.approx(0.25) and np.isnan(each[1])
    assert error(each[1]) == "stands still"
