"""The papers done again: their commands with next to nothing to compute, and their twins and
methods against other code.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxid
from jaxid import fitters
from jaxid.base.errors import UsageError
from jaxid.base.stopping import Interrupted
from jaxid.cli.app import main
from jaxid.identification.commanded import commanded
from jaxid.models import Tracker
from jaxid.problem.objective import FunctionProblem
from jaxid.report import write_page
from jaxid.report.result_files import save
from jaxid.study.papers import flexible_link, PAPERS, payload, reproduce, space_manipulator, tracker
from jaxid.study.papers.page import reproduction_page
from jaxid.study.papers.result import (
    FAILS,
    HOLDS,
    judged,
    PaperClaim,
    PaperPart,
    PaperTable,
    Picture,
    Reproduction,
    UNKNOWN,
)
from jaxid.study.papers.searches import mean_sd, race
from jaxid.study.papers.twins import space_arm, tracker as tracker_twin


TINY = {
    "000": (space_manipulator, space_manipulator.SpaceManipulatorSize(5, 5, 1, 1, 400, 6)),
    "001": (payload, 2),
    "002": (flexible_link, flexible_link.FlexibleLinkSize(2, 5e-3, 20, 5)),
    "003": (tracker, tracker.TrackerSize(5, ("actuator_curve", "torque_scale"), 2)),
}


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "paper", [pytest.param(p, marks=[] if p == "001" else pytest.mark.slow) for p in TINY]
)
def test_the_command(paper, tmp_path, monkeypatch, capsys):
    module, size = TINY[paper]
    monkeypatch.setitem(module.SIZES, "small", size)
    assert main(["reproduce", paper, "--out", str(tmp_path), "--json"]) == 0
    printed, kept = (
        json.loads(capsys.readouterr().out),
        json.loads((tmp_path / "result.json").read_text()),
    )
    assert printed == kept and (kept["kind"], kept["paper"], kept["budget"]) == (
        "reproduction",
        paper,
        "small",
    )
    assert len(kept["parts"]) == PAPERS[paper].parts and kept["doi"] == PAPERS[paper].doi
    assert {c["verdict"] for c in kept["claims"]} <= {
        "holds",
        "does not hold",
        "partly",
        "cannot be checked",
    }
    assert all(c["ours"] or c["why"] for c in kept["claims"])
    page = (tmp_path / "report.html").read_text()
    assert (
        all(part["title"] in page for part in kept["parts"])
        and page.count("<svg") >= 1
        and "nan" not in page.lower()
    )


def test_refusals(tmp_path, capsys):
    assert (
        main(["reproduce", "004", "--out", str(tmp_path)]) == 2
        and "'000', '001', '002', '003'" in capsys.readouterr().err
    )
    with pytest.raises(UsageError, match="no paper '02'.*000, 001, 002, 003"):
        reproduce("02")
    with pytest.raises(UsageError, match="no budget 'big'.*small and full"):
        reproduce("001", "big")


def sample() -> Reproduction:
    def draw(figure):
        return figure.add_subplot().plot([0, 1], [1, 2])

    part = PaperPart(
        "A <b>part</b>",
        ("One sentence.",),
        (PaperTable("T", ("a", "b"), (("x", 1.23456), ("y", None)), "a note"),),
        (Picture("p", "drawn", (4, 2), draw),),
        (
            judged("it is so", "4", "5", True),
            judged("and so", "", "no", False),
            PaperClaim("who knows", "", "", UNKNOWN, "lost"),
        ),
    )
    return Reproduction("002", "A title", "10.1/x", "About.", "small", (part,), 1.5)


def test_a_page_says_what_was_found(tmp_path):
    result = sample()
    assert result.counts == {HOLDS: 1, FAILS: 1, "partly": 0, UNKNOWN: 1}
    assert (
        result.headline
        == "Of 2 claims that can be compared 1 hold on the twin, 1 do not; 1 cannot be checked."
    )
    page = reproduction_page(result)
    assert (
        "<b>part</b>" not in page
        and "1.235" in page
        and "who knows" in page
        and "(lost)" in page
        and "<svg" in page
    )
    assert (
        save(result, tmp_path) == tmp_path / "result.json" and (tmp_path / "report.html").is_file()
    )
    write_page(reproduction_page(replace(result, parts=())), tmp_path / "empty.html")


def test_stopped_between_parts(monkeypatch):
    def study(size):
        yield sample().parts[0]
        raise KeyboardInterrupt

    monkeypatch.setattr(payload, "study", study)
    with pytest.raises(Interrupted) as stop:
        reproduce("001")
    assert len(stop.value.partial.parts) == 1


# ---- methods


def bowl() -> FunctionProblem:
    return FunctionProblem(lambda z: z - 0.3, -np.ones(3), np.ones(3))


def test_without_starts_the_first_generation_fills_the_bounds():
    seen = []
    problem = FunctionProblem(lambda z: z - 0.3, np.array([-1.0, 1e-6]), np.array([1.0, 1.0]))
    search = fitters.ParticleSwarm(popsize=200, generations=1).searching(
        problem, [], jax.random.key(0), _Log(problem)
    )
    seen.append(next(search))
    assert seen[0].shape == (200, 2) and np.all(
        np.ptp(seen[0], axis=0) > 0.95 * (problem.upper - problem.lower)
    )


def _Log(problem):
    from jaxid.fitting.fitter import Log

    return Log(problem, "pso")


def test_every_method_of_a_race_meets_the_same_loss():
    problem = bowl()
    runs = race_of(problem)
    for found in runs:
        assert found.loss == problem.loss(found.z) and found.loss < 1e-3
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    batch, single = problem.losses(points), np.array([problem.loss(z) for z in points])
    residual = np.array([np.mean((z - 0.3) ** 2) for z in points])
    np.testing.assert_allclose(batch, single, rtol=1e-13)
    np.testing.assert_allclose(batch, residual, rtol=1e-12)


def race_of(problem):
    methods = [
        fitters.DifferentialEvolution(popsize=20, generations=60),
        fitters.LevenbergMarquardt(),
    ]
    return [m.minimise(problem, [np.zeros(3)], jax.random.key(1)) for m in methods]


def test_the_feasible_mutation_stays_inside_and_grows_with_gain():
    ga: Any = fitters.GeneticAlgorithm(scheme="scattered", mutate="feasible", popsize=40)
    lower, upper = -np.ones(3), np.ones(3)
    points = np.random.default_rng(0).uniform(-1, 1, (40, 3))
    state = ga.init(
        jax.random.key(0), jax.numpy.asarray(points), jax.numpy.asarray(np.sum(points**2, 1))
    )
    children = np.asarray(ga.ask(jax.random.key(1), state, lower, upper))
    assert children.shape == (39, 3) and np.all(np.abs(children) <= 1)
    worse = ga.tell(state, children, np.full(39, 1e3))
    assert (
        float(worse.step) == 0.25 and float(ga.tell(worse, children, np.full(39, 1e-9)).step) == 1.0
    )
    with pytest.raises(ValueError, match="shrinking, feasible"):
        fitters.GeneticAlgorithm(mutate="wild")


def test_numbers_are_written_to_the_digits_that_scatter_leaves():
    assert mean_sd(np.array([0.01737, 0.0166, 0.0181])) == "0.01736 ± 0.00075"
    assert mean_sd(np.array([2.0])) == "2"


@pytest.mark.slow
def test_differential_evolution_as_the_paper_has_it():
    """In the linear box, against a loop written apart, with the paper's settings: each within the
    other's scatter.
    """
    p = flexible_link.problem()
    assert not p.log.any() and np.all(
        p.lower == [flexible_link.BOUNDS[name][0] for name in p.names]
    )
    own = race(p, {"DE": flexible_link.methods()["DE"]}, range(6))[0].losses
    other = np.array([_evolved(p, seed) for seed in range(6)])
    assert (
        abs(own.mean() - other.mean())
        < 3 * np.hypot(own.std(ddof=1), other.std(ddof=1)) / np.sqrt(6) + 2e-3
    )
    assert max(own.max(), other.max()) < 0.03


def _evolved(
    p, seed: int, size: int = 100, generations: int = 100, F: float = 0.5, CR: float = 0.8
) -> float:
    """DE/rand/1/exp (Storn and Price 1997), what leaves the box drawn anew."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(p.lower, p.upper, (size, p.size))
    loss = p.losses(x)
    for _ in range(generations):
        trial = x.copy()
        for i in range(size):
            a, b, c = rng.choice(np.delete(np.arange(size), i), 3, replace=False)
            v, k = x[a] + F * (x[b] - x[c]), rng.integers(p.size)
            for _ in range(p.size):
                trial[i, k % p.size] = v[k % p.size]
                k += 1
                if rng.uniform() >= CR:
                    break
        out = (trial < p.lower) | (trial > p.upper)
        trial = np.where(out, rng.uniform(p.lower, p.upper, trial.shape), trial)
        new = p.losses(trial)
        x, loss = np.where((new <= loss)[:, None], trial, x), np.minimum(new, loss)
    return float(loss.min())


# ---- twins


def test_the_motors_of_the_tracker():
    volts = np.array([-5.0, -3.6, -2.4, -1.0, 0.0, 1.68, 2.4, 3.0, 3.6, 5.0])
    known: Any = {"J_theta": 0.117, "J_alpha": 0.1}
    for table, law in ((False, tracker_twin.formula), (True, tracker_twin.table)):
        model: Any = Tracker(**known, motor_table=table)
        u = np.stack([volts, volts], 1)
        own = [
            np.asarray(model.drive(Tracker.signatures[1], v, np.zeros(2), np.zeros(2))) for v in u
        ]
        np.testing.assert_allclose(own, law(u), atol=1e-7)


def test_the_arm_of_paper_000_conserves_energy_and_moves_its_base():
    """No torque and no friction: qd' M qd / 2 stays; with a base that floats too."""
    for base in (None, (250.0, 60.0)):

        def energy(x, base=base):
            return x[2:] @ space_arm.mass_matrix(x[None, :2], base)[0] @ x[2:] / 2

        def field(t, x, base=base):
            q, qd = x[None, :2], x[None, 2:]
            bias = space_arm.torque((np.zeros(1), q, qd, 0 * qd), base, friction=None)[0]
            return np.concatenate(
                [x[2:], np.linalg.solve(space_arm.mass_matrix(q, base)[0], -bias)]
            )

        x = solve_ivp(field, (0, 3), [0.3, -0.5, 0.4, 0.7], rtol=1e-9, atol=1e-11).y
        assert np.ptp([energy(s) for s in x.T]) < 1e-5 * energy(x[:, 0]) and np.ptp(x[1]) > 0.5


def test_fourier_derivatives_keep_every_harmonic():
    t, q, qd, qdd = payload.path(3)
    _, v, a = payload.harmonics(t, q)
    np.testing.assert_allclose(v, qd, atol=1e-9)
    np.testing.assert_allclose(a, qdd, atol=1e-8)
    assert np.abs(payload.differenced(q)[2] - qdd).max() > 1e-3


def test_the_recursion_as_printed():
    """Against equations (8) to (11) written out."""
    rng = np.random.default_rng(0)
    W, tau, prior = rng.normal(size=(30, 6, 58)), rng.normal(size=(30, 6)), rng.normal(size=58)
    pi, P = prior.copy(), 10 * np.eye(58)
    for Y, y in zip(W, tau, strict=True):
        K = P @ Y.T @ np.linalg.inv(100 * np.eye(6) + Y @ P @ Y.T)
        pi, P = pi + K @ (y - Y @ pi), P - K @ Y @ P
    base = jaxid.models.UR10().base()
    mass, early, met = payload.as_printed(W, tau, prior, base)
    assert met is None and mass == early
    np.testing.assert_allclose(mass, payload.by_rows(pi - prior, base), rtol=1e-6)


def test_the_commanded_motion_takes_the_place_of_the_measured():
    t = np.arange(50) * 0.01
    q = {f"q{j + 1}": np.sin(t + j) for j in range(2)}
    own = jaxid.Dataset.from_arrays(
        t,
        {f"tau{j + 1}": np.cos(t * (j + 1)) for j in range(2)},
        {k: v + 1e-3 for k, v in q.items()},
        auxiliary={f"{k}_cmd": v for k, v in q.items()},
    )
    found = commanded(own)
    np.testing.assert_array_equal(found.experiments[0].y, np.stack(list(q.values()), 1))
    assert "commanded" in found.notes[-1]
    with pytest.raises(UsageError, match="q1_cmd, q2_cmd"):
        commanded(
            replace(own, experiments=tuple(replace(e, auxiliary={}) for e in own.experiments))
        )


#: Tables and figures of each paper.
PRINTED = {"000": (5, 9), "001": (9, 12), "002": (3, 9), "003": (5, 13)}


@pytest.mark.parametrize("paper", PRINTED)
def test_every_table_and_figure_has_a_row(paper):
    """docs/papers.md has one for each, alone or in a range."""
    text = (Path(__file__).parents[1] / "docs" / "papers.md").read_text()
    section = text.split(f"\n## {paper}:")[1].split("\n## ")[0]
    first = [row.split("|")[1] for row in section.splitlines() if row.startswith("|")]
    tables, figures = PRINTED[paper]
    roman = ["", "I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX"]
    named: dict[str, set[int]] = {"Table": set(), "Figure": set()}
    for cell in first:
        for kind, found in named.items():
            for part in re.findall(
                rf"{kind}s? ((?:[0-9]+[ab]?|[IVX]+)(?:(?:, | and | to )(?:[0-9]+|[IVX]+)(?![a-z]))*)",
                cell,
            ):
                numbers = [
                    roman.index(w) if w in roman else int(w.rstrip("ab"))
                    for w in re.findall(r"[0-9]+|[IVX]+", part)
                ]
                found |= set(range(numbers[0], numbers[-1] + 1)) if " to " in part else set(numbers)
    assert named["Table"] == set(range(1, tables + 1))
    assert named["Figure"] == set(range(1, figures + 1))
