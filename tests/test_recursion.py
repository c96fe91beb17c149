"""A fit along its data: with a window, or with what earlier blocks say carried on."""

from __future__ import annotations

import json
from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxid
from jaxid import fitters
from jaxid.cli.app import main
from jaxid.data.dataset import Dataset, ModelSpec, ParameterPrior
from jaxid.data.io import save_dataset
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.recursion import absorbed, in_blocks
from jaxid.problem.binding import bind
from jaxid.problem.objective import linearise, rows
from jaxid.problem.residual import InverseDynamics, OutputError


CHANGE = 12.0


@pytest.fixture(scope="module")
def joint() -> Dataset:
    """A joint whose inertia drops from 0.08 to 0.05 kg m^2 at 12 s; torque and motion in closed
    form.
    """
    t = np.arange(2400) * 0.01
    rng = np.random.default_rng(0)
    waves = list(
        zip(
            (0.5, 0.3, 0.2, 0.1),
            2 * np.pi * np.array((0.23, 0.61, 1.07, 1.9)),
            rng.uniform(0, 6, 4),
            strict=True,
        )
    )
    q = sum(a * np.sin(w * t + p) for a, w, p in waves)
    qd = sum(a * w * np.cos(w * t + p) for a, w, p in waves)
    qdd = -sum(a * w * w * np.sin(w * t + p) for a, w, p in waves)
    tau = np.where(t < CHANGE, 0.08, 0.05) * qdd + 0.3 * qd + 2e-3 * rng.standard_normal(t.size)
    return Dataset.from_arrays(
        t,
        {"tau": tau},
        {"q": q + 1e-5 * rng.standard_normal(t.size)},
        noise_std={"q": 1e-5},
        split="fit",
        model=ModelSpec("joint", without=("coulomb_friction", "constant_torque")),
    )


def along(data: Dataset, **settings) -> jaxid.Fit:
    return jaxid.fit(
        None, data, residual="inverse_dynamics", as_recorded=True, block_s=1.0, **settings
    )


@pytest.mark.parametrize("forgetting", [1.0, 0.7])
def test_it_is_recursive_least_squares(joint, forgetting):
    """Of a model that is linear in its numbers the last recursion is least squares over all blocks,
    weighted by their age.
    """
    found = along(joint, forgetting=forgetting)
    b = bind(None, in_blocks(joint, 1.0))
    p = ProblemBuilder(b).problem(InverseDynamics(), "fit", b.free, b.theta)
    z = p.z(b.theta)
    at, slope = (
        p.theta(z)[p.free],
        p.dtheta(z),
    )  # some numbers are searched by their logarithm; the torque is linear in all
    A, y = [], []
    for part in rows([(p, z)]):
        w = np.sqrt(forgetting ** (p.pieces - 1 - part.record))
        J = part.J.reshape(part.r.size, -1) / slope
        A.append(w * J)
        y.append(w * (J @ at - part.r.ravel()))
    exact = np.linalg.lstsq(np.concatenate(A), np.concatenate(y), rcond=None)[0]
    assert len(found.recursion) == p.pieces == 17
    assert [e.value for e in found.parameters.values()] == pytest.approx(exact, rel=1e-6)


def test_starts_of_runs_are_eliminated(joint):
    """What a block says of the parameters is the Schur complement of its Gauss-Newton matrix, its
    unknown start taken out.
    """
    b = bind(None, in_blocks(joint, 1.0))
    p = ProblemBuilder(b).problem(OutputError(), "fit", b.free, b.theta).part([3], [1.0])
    z = p.z(b.theta)
    n = p.free.size
    assert p.size == n + 2
    H = linearise([(p, z)])[0].hessian
    schur = H[:n, :n] - H[:n, n:] @ np.linalg.solve(H[n:, n:], H[n:, :n])
    slope = p.dtheta(z)
    known = absorbed(p.known, p, z)
    assert np.allclose(
        known.R.T @ known.R * slope * slope[:, None],
        schur,
        rtol=1e-6,
        atol=1e-9 * np.abs(schur).max(),
    )
    # and a problem that knows this alone has its gradient there
    twin = p.part([0], [1.0]).knowing(known)
    r, J = twin.known_before(z)
    g = linearise([(p, z)])[0].gradient
    assert np.allclose(
        (J.T @ r)[:n], g[:n] - H[:n, n:] @ np.linalg.solve(H[n:, n:], g[n:]), rtol=1e-6
    )


@pytest.mark.parametrize("fitter", ["lm", "rde(popsize=20, generations=30)"])
@pytest.mark.parametrize("setting", [{"forgetting": 0.5}, {"window": 2}])
def test_it_follows_a_change_at_a_constant_cost(joint, setting, fitter):
    found = along(joint, fitter=fitter, **setting)
    inertia = np.array([s.parameters["inertia"][0] for s in found.recursion])
    t = np.array([s.t for s in found.recursion])
    assert np.all(np.abs(inertia[(t > 4) & (t < CHANGE)] - 0.08) < 0.003)
    assert abs(inertia[-1] - 0.05) < 0.003
    cost = [s.evaluations for s in found.recursion]
    assert max(cost[-5:]) <= 2 * max(cost[1:6])  # nothing grows with the data


def test_growing_data_stay_between(joint):
    """Nothing is forgotten: after 5 s of the new inertia beside 12 s of the old one the answer is
    neither.
    """
    assert 0.055 < along(joint, forgetting=1.0).parameters["inertia"].value < 0.077


def test_a_prior_counts_once(joint):
    """A prior is what is known before the first block, and not anew in each."""
    known = ParameterPrior(prior={"mean": 0.12, "std": 0.02})
    spec = ModelSpec(
        "joint", without=("coulomb_friction", "constant_torque"), parameters={"inertia": known}
    )
    plain, told = (along(d, forgetting=1.0) for d in (joint, replace(joint, model=spec)))
    assert told.parameters["inertia"].value == pytest.approx(
        plain.parameters["inertia"].value, abs=2e-3
    )


def test_the_command(joint, tmp_path, capsys):
    save_dataset(joint, tmp_path / "data")
    arguments = [
        "fit",
        str(tmp_path / "data"),
        "--residual",
        "inverse_dynamics",
        "--forgetting",
        "0.6",
        "--block",
        "2",
        "--json",
    ]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    told = json.loads(capsys.readouterr().out)["recursion"]
    assert len(told) == 8 and {"block", "t", "loss", "evaluations", "parameters"} <= set(told[0])
    assert main([*arguments[:-1], "--out", str(tmp_path / "text")]) == 0
    assert "until (s)" in capsys.readouterr().out
    assert "over the recursions" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"block_s": 1.0}, "give one of them"),
        ({"window": 0}, "holds nothing"),
        ({"forgetting": 1.5}, "at most at 1"),
        ({"forgetting": 0.5, "loss": "sum_of_abs"}, "in squares"),
        ({"forgetting": 0.5, "residual": "multiple_shooting"}, "divides runs by itself"),
        ({"forgetting": 0.5, "block_s": 100.0}, "at least two blocks"),
    ],
)
def test_senseless_settings_are_refused(joint, setting, words):
    with pytest.raises(jaxid.UsageError, match=words):
        jaxid.fit(None, joint, as_recorded=True, **setting)


def test_a_population_keeps_its_members(joint):
    """The second recursion of a population costs a few generations, not a search."""
    found = along(joint, window=3, fitter=fitters.DifferentialEvolution(popsize=20, generations=60))
    assert found.recursion[0].evaluations >= 5 * found.recursion[1].evaluations
    assert jax.numpy.isfinite(found.loss)
