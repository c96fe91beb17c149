"""The input that tells two hypotheses apart: limits kept, and the distance as it is claimed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import jaxid
import reference as ref
from jaxid.base.errors import UsageError
from jaxid.data.dataset import Dataset
from jaxid.data.limits import Limits
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.excitation.discriminate import recorded, Rivals
from jaxid.hardware.trajectory import Trajectory
from jaxid.models import Pendulum
from report_sample import sample_diagnosis


RATE, NOISE = 200, 3e-4
TRUTH = ref.Truth(viscous=0.03, lag_s=0.003)
T = np.arange(4 * RATE) / RATE


def played(u: np.ndarray, seed: int) -> np.ndarray:
    q, _ = ref.simulate(ref.pendulum(0.06, 0.9), TRUTH, T[: len(u)], u[:, None])
    return q[:, 0] + NOISE * np.random.default_rng(seed).normal(size=len(u))


def dataset(runs: list[tuple[np.ndarray, np.ndarray, str]]) -> Dataset:
    return Dataset.from_arrays(
        [T[: len(u)] for u, _, _ in runs],
        inputs={"tau": [u for u, _, _ in runs]},
        outputs={"q": [y for _, y, _ in runs]},
        split=[s for _, _, s in runs],
        at_rest=True,
        noise_std={"q": NOISE},
        model="pendulum",
    )


@pytest.fixture(scope="module")
def recordings():
    """Slow commands, which tell a lag from a delay poorly."""
    found = []
    for seed, split in ((1, "fit"), (2, "validation"), (3, "report")):
        u = ref.multisine(T, [0.5], seed, periods=1.0, lines=3)[:, 0]
        found.append((u, played(u, seed), split))
    return found


@pytest.fixture(scope="module")
def diagnosis(recordings):
    return jaxid.diagnose(
        None,
        dataset(recordings),
        effects=["actuator_lag", "input_delay"],
        without=["coulomb_friction"],
    )


@pytest.fixture(scope="module")
def made(diagnosis):
    return diagnosis.next_run()


@pytest.mark.slow
def test_two_hypotheses_are_left(diagnosis):
    assert {str(e) for e in (*diagnosis.which.effects, *diagnosis.which.confusable_with)} == {
        "actuator_lag at tau",
        "input_delay at tau",
    }
    assert set(diagnosis.rivals.names) == {"actuator_lag at tau", "input_delay at tau"}
    assert "--next" in diagnosis.next_experiment


@pytest.mark.slow
def test_the_input_stays_within_what_was_recorded(made, recordings, tmp_path):
    u, q = made.dataset.experiments[0].u[:, 0], made.dataset.experiments[0].y[:, 0]
    assert np.abs(u).max() <= max(np.abs(r[0]).max() for r in recordings) * (1 + 1e-9)
    low, high = min(r[1].min() for r in recordings), max(r[1].max() for r in recordings)
    room = 0.02 * (high - low) + 1e-6
    assert q.min() >= low - room and q.max() <= high + room
    folder = made.save(tmp_path / "next")
    jaxid.load_dataset(folder)
    assert Trajectory.read(folder).values.shape[0] == len(u)
    assert (
        json.loads((folder / "excitation.json").read_text())["separates"]
        == made.content["separates"]
    )


@pytest.mark.slow
def test_the_distance_is_what_a_recording_shows(diagnosis, made, recordings):
    """The designed run, recorded on the independent twin, sets the two apart by about what was
    claimed.
    """
    c = made.content
    assert c["distance"] > 2 * c["distance_recorded"] and c["distance"] > 3
    u = made.dataset.experiments[0].u[: len(T), 0]
    more = dataset([*recordings[:1], (u, played(u, 9), "fit"), *recordings[1:]])
    loss = {}
    for effect in ("actuator_lag", "input_delay"):
        fit = jaxid.fit(None, more, effects=[effect], without=["coulomb_friction"])
        loss[effect] = fit.loss * 2 * len(T)
    apart = np.sqrt(max(loss["input_delay"] - loss["actuator_lag"], 0.0))
    assert 0.5 * c["distance"] < apart < 2 * c["distance"], (apart, c["distance"])


@pytest.mark.slow
def test_stated_limits_count(diagnosis):
    made = diagnosis.next_run(duration_s=2.0, limits=Limits(speed=(0.3,)), amplitude=[0.2])
    e = made.dataset.experiments[0]
    assert np.abs(e.u).max() <= 0.2 and e.t[-1] == pytest.approx(2.0)
    assert np.abs(np.gradient(e.y[:, 0], e.t)).max() <= 0.3 * (1 + 1e-9)


def test_without_two_hypotheses_there_is_no_run():
    alone = dataclasses.replace(sample_diagnosis(), rivals=None)
    with pytest.raises(UsageError, match="no two hypotheses"):
        alone.next_run()


def test_nothing_is_designed_where_nothing_drives():
    still = dataset([(0 * T, np.sin(T), "fit")]).experiments
    layout = ParameterVector(Chain(Pendulum()))
    quiet = Rivals(
        names=("one", "other"),
        layout=layout,
        theta=np.tile(layout.values, (2, 1)),
        free=(),
        slope=np.zeros(0),
        information=np.zeros((0, 0)),
        noise=np.array([NOISE]),
        recorded=recorded(still, [0], [0]),
    )
    with pytest.raises(UsageError, match="nothing drives"):
        dataclasses.replace(sample_diagnosis(), rivals=quiet).next_run()


@pytest.mark.slow
def test_the_command_writes_it(monkeypatch, diagnosis, tmp_path: Path):
    from click.testing import CliRunner

    from jaxid.cli import record as cli_record  # noqa: F401
    from jaxid.cli.app import cli

    data = tmp_path / "data"
    jaxid.save_dataset(dataset([(T[:50], T[:50], "fit")]), data)
    monkeypatch.setattr(jaxid, "diagnose", lambda *a, **k: diagnosis)
    command = [
        "diagnose",
        str(data),
        "--out",
        str(tmp_path / "out"),
        "--next",
        str(tmp_path / "next"),
    ]
    limits = tmp_path / "limits.toml"
    limits.write_text("speed = [0.5]\n")
    result = CliRunner().invoke(cli, [*command, "--limits", str(limits)], standalone_mode=False)
    assert result.exception is None and result.return_value == 0, result.output
    made = json.loads((tmp_path / "next" / "excitation.json").read_text())
    assert "stated limits" in made["limits_from"] and "standard deviations apart" in result.output
    monkeypatch.setattr(
        jaxid, "diagnose", lambda *a, **k: dataclasses.replace(diagnosis, rivals=None)
    )
    result = CliRunner().invoke(cli, [*command[:-1], str(tmp_path / "none")], standalone_mode=False)
    assert (
        result.return_value == 0
        and "no two hypotheses" in result.output
        and not (tmp_path / "none").exists()
    )
