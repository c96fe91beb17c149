"""Paper 001's own estimators of a payload, on torque by Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest


pytest.importorskip("pinocchio")

from jaxid.base.errors import UsageError  # noqa: E402
from jaxid.cli.app import main  # noqa: E402
from jaxid.data.dataset import Dataset  # noqa: E402
from jaxid.data.io import save_dataset  # noqa: E402
from jaxid.identification.regression import every_row, LAWS, read_run  # noqa: E402
from jaxid.identification.run import identify  # noqa: E402
from jaxid.problem.binding import bind, resolve_model  # noqa: E402
from test_identification import excitation, LOAD, NOISE, recording, torque  # noqa: E402


def rows_of(data: Dataset, law: str, exponent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unfiltered columns and torque of the first run."""
    chain = resolve_model(None, data)
    run = read_run(data, data.experiments[0], chain, chain.mechanism.base(), 5.0, 10.0)  # type: ignore[attr-defined]
    return np.concatenate([W for _, _, W in every_row(run, LAWS[law], exponent)]), run.tau_raw


@pytest.fixture(scope="module")
def empty():
    return identify(None, recording(None, 0.05, 11), friction="power")


@pytest.fixture(scope="module")
def loaded():
    return recording(LOAD, 0.05, 12)


def test_the_recursion_is_the_ridge_regression_that_is_printed(empty, loaded):
    """(7) to (11) minimise |tau - W theta|^2 / 100 + |theta - unloaded|^2 / 10, solved here at
    once.
    """
    found: Any = identify(None, loaded, method="paper001", reference=empty)
    assert found.law == "power" and np.array_equal(found.exponents, empty.exponents)
    W, tau = rows_of(loaded, "power", empty.exponents)
    A, b = W.reshape(-1, W.shape[2]), tau.ravel()
    exact = np.linalg.solve(
        A.T @ A / 100 + np.eye(A.shape[1]) / 10, A.T @ b / 100 + empty.theta / 10
    )
    assert np.abs(found.theta - exact).max() < 1e-8
    assert found.payload.published is not None
    assert found.payload.published[9] == pytest.approx(LOAD[9], rel=0.05)
    assert found.payload.converged_after_s is None or 2.4 <= found.payload.converged_after_s <= 10
    assert "standard deviations are those of its P" in " ".join(found.notes)


def test_algorithm_1_on_the_same_trajectory(empty, loaded):
    found: Any = identify(None, loaded, method="algorithm1", reference=empty).payload
    assert abs(found.mass[0] - LOAD[9]) < 4 * found.mass[1] + 1e-3 and found.mass[1] < 0.2
    assert found.phi.shape == (10,) and found.published is None


def poses(load: np.ndarray | None, seed: int) -> Dataset:
    """The arm held at 24 poses for half a second each, with moves between them of half a second at
    constant speed.
    """
    rng = np.random.default_rng(seed)
    centre = np.array([0, -np.pi / 2, 0, -np.pi / 2, 0, 0])
    at = centre + np.random.default_rng(5).uniform(-1, 1, (24, 6))
    t = np.arange(24 * 125) / 125.0
    k, phase = (t // 1.0).astype(int), np.clip((t % 1.0) / 0.5, 0, 1)
    before, after = at[np.maximum(k - 1, 0)], at[k]
    s = 3 * phase**2 - 2 * phase**3
    q = before + s[:, None] * (after - before)
    speed = (6 * phase - 6 * phase**2) / 0.5
    qd = np.where(phase < 1, speed, 0.0)[:, None] * (after - before)
    qdd = np.gradient(qd, t, axis=0)
    tau = torque((t, q, qd, qdd), load) + 0.02 * NOISE * rng.normal(size=q.shape)

    def names(k):
        return [f"{k}{j + 1}" for j in range(6)]

    return Dataset.from_arrays(
        t,
        dict(zip(names("tau"), tau.T, strict=True)),
        dict(zip(names("q"), q.T, strict=True)),
        model="ur10",
        split="fit",
    )


def test_algorithm_2_on_static_poses(empty):
    found: Any = identify(None, poses(LOAD, 3), method="algorithm2", reference=empty).payload
    assert abs(found.mass[0] - LOAD[9]) < 4 * found.mass[1] + 0.02
    assert np.isnan(found.phi[:6]).all() and found.rows == 4
    assert abs(found.com()[2][0] - LOAD[8] / LOAD[9]) < 4 * found.com()[2][1] + 0.02


def test_exponents_are_fitted_where_asked_for(empty):
    """A fit holds them and says so; named, they are fitted."""
    data = recording(None, 0.02, 1)
    start = {f"exponent{j + 1}": 1.0 for j in range(6)}
    chain = resolve_model("ur10", data)
    held = bind(chain, data)
    assert not any("exponent" in held.layout.names[i] for i in held.free)
    assert any("held and not fitted: exponent1" in text for text in held.said)
    one = bind(chain, data, effects=["power_law_friction@q3"])
    assert [held.layout.names[i] for i in one.free if i not in held.free] == ["exponent3"]
    every = bind(chain, data, effects=["power_law_friction"])
    assert {every.layout.names[i] for i in every.free if i not in held.free} == set(start)
    assert not any("held and not fitted" in text for text in every.said)


@pytest.mark.slow
def test_what_they_need(empty, loaded):
    with pytest.raises(UsageError, match="--reference"):
        identify(None, loaded, method="paper001")
    with pytest.raises(UsageError, match="static poses"):
        identify(None, loaded, method="algorithm2", reference=empty)


@pytest.mark.slow
def test_the_command(empty, tmp_path, capsys):
    import json

    save_dataset(recording(None, 0.05, 11), tmp_path / "empty")
    save_dataset(poses(LOAD, 3), tmp_path / "loaded")
    assert (
        main(
            [
                "identify",
                str(tmp_path / "empty"),
                "--friction",
                "power",
                "--quiet",
                "--out",
                str(tmp_path / "a"),
            ]
        )
        == 0
    )
    reference = ["--reference", str(tmp_path / "a" / "identification.json")]
    assert (
        main(
            [
                "identify",
                str(tmp_path / "loaded"),
                "--method",
                "algorithm2",
                *reference,
                "--json",
                "--out",
                str(tmp_path / "b"),
            ]
        )
        == 0
    )
    told = json.loads(capsys.readouterr().out)["payload"]
    assert told["mass"]["value"] == pytest.approx(LOAD[9], abs=0.3)
    assert told["inertia"][0]["value"] is None  # gravity does not show it


def test_a_fourier_series_keeps_the_harmonics():
    """Acceleration of a line close to the cutoff: exact by its harmonic, damped by a low-pass
    there.
    """
    from jaxid.data.signals import differentiate
    from jaxid.identification.fourier import harmonic_motion

    t = np.arange(1001) / 100.0
    w = 2 * np.pi * np.array([0.1, 0.7, 9.0])
    size = np.array([0.5, 0.3, 0.01])
    q = (np.sin(np.outer(t, w)) * size).sum(1)[:, None]
    qdd = -(np.sin(np.outer(t, w)) * size * w**2).sum(1)
    rng = np.random.default_rng(0)
    read = q + 1e-6 * rng.standard_normal(q.shape)
    inside = slice(100, 900)

    def rms(x):
        return float(np.sqrt(np.mean((x - qdd)[inside] ** 2)) / np.std(qdd))

    assert rms(harmonic_motion(t, read, 10.0)[2][:, 0]) < 1e-3
    assert rms(differentiate(t, read, 10.0)[2][:, 0]) > 0.1
    with pytest.raises(UsageError, match="whole periods"):
        harmonic_motion(t[:860], read[:860], 10.0)
    with pytest.raises(UsageError, match="whole periods"):
        harmonic_motion(t, read, 5.0)  # a line above it


def test_identification_by_the_harmonics(tmp_path):
    """Runs of whole periods: the base parameters come back, and no run is cut in the middle of
    one.
    """
    from test_identification import truth

    rng = np.random.default_rng(2)
    t, q, qd, qdd = excitation(3)
    step = t[1] - t[0]
    t, q, qd, qdd = np.append(t, t[-1] + step), *(np.concatenate([x, x[:1]]) for x in (q, qd, qdd))
    tau = torque((t, q, qd, qdd)) + 0.02 * NOISE * rng.normal(size=q.shape)

    def names(k):
        return [f"{k}{j + 1}" for j in range(6)]

    read = q + 1e-5 * rng.normal(size=q.shape)
    data = Dataset.from_arrays(
        t,
        dict(zip(names("tau"), tau.T, strict=True)),
        dict(zip(names("q"), read.T, strict=True)),
        model="ur10",
        split="fit",
    )
    found = identify(None, data, motion="fourier", friction="power")
    base = resolve_model("ur10", data).mechanism.base()  # type: ignore[attr-defined]
    error = np.abs(found.theta[:40] - truth(base))
    assert np.all(error < 0.05 + 0.05 * np.abs(truth(base)))
    assert "harmonics of each run" in found.filter and len(found.experiments) == 1
