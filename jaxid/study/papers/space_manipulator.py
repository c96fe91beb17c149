"""Paper 000: the last body of a space manipulator and the friction of its joints by recursive
differential evolution (RDE).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from jaxid import fitters
from jaxid.api import fit
from jaxid.base.wording import listed, number
from jaxid.fitting.fitter import AbstractFitter
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.sequential import stretches
from jaxid.report import plot
from jaxid.report.compared import COLORS
from jaxid.study.papers.result import (
    FAILS,
    HOLDS,
    judged,
    PaperClaim,
    PaperPart,
    PaperTable,
    Picture,
    UNKNOWN,
)
from jaxid.study.papers.searches import course, lines, numbers_of, race, Searched
from jaxid.study.papers.space_recursion import (
    alone,
    BLOCK,
    carried,
    dataset,
    descended,
    FIRST,
    followed,
    GOAL,
    least_squares,
    LOOPS,
    named,
    NOISE,
    off,
    populations,
    problem_of,
    RECURSIONS,
    SIZE,
    streamed,
    torque_of,
    UNITS,
)
from jaxid.study.papers.twins import space_arm as twin


class SpaceManipulatorSize(NamedTuple):
    """How much is computed: generations off-line, those of a search on the linear part and its
    noise seeds, seeds and evaluations of a race, and blocks of data of which the load changes
    half-way.
    """

    offline: int
    linear: int
    noises: int
    seeds: int
    cap: int
    blocks: int


SIZES = {
    "small": SpaceManipulatorSize(80, 40, 3, 4, 6_000, 12),
    "full": SpaceManipulatorSize(200, 100, 10, 20, 20_000, 14),
}


def study(size: SpaceManipulatorSize) -> Iterator[PaperPart]:
    """Five parts: recursion, Table 5, evaluations, a change, the base."""
    yield recursion(size.offline)
    yield linear_system(size.linear, size.noises)
    yield evaluations(size.seeds, size.cap)
    yield change(size.blocks, size.offline)
    yield base()


def recursion(offline: int) -> PaperPart:
    """Figures 7 to 9, Table 4: RDE while data arrive."""
    p, blocks = streamed(True)
    methods = {k: v for k, v in populations(offline).items() if k in ("DE", "RDE")}
    runs = {k: followed(m, p, LOOPS) for k, m in methods.items()}
    longer = followed(methods["RDE"], p, 5 * LOOPS)

    def whole(s):
        return p.loss(p.z(named(p, s.numbers)))

    objective = {k: np.array(list(map(whole, steps))) for k, steps in runs.items()}
    best = levenberg_marquardt([(p, p.z(named(p, longer[-1].numbers)))], 50, 1e-12)[0]
    least = p.loss(best.z)
    rows = []
    for k, steps in runs.items():
        first, last = steps[0], steps[-1]
        losses = (objective[k][0] / least, objective[k][-1] / least)
        errors = (100 * off(first.numbers), 100 * off(last.numbers))
        spent = (last.evaluations, last.seconds, sum(s.seconds for s in steps))
        rows.append((k, *losses, *errors, *spent))
    table = PaperTable(
        "The objective on all data, as a multiple of its least, and the body's numbers",
        (
            "method",
            "off-line",
            "last recursion",
            "off-line, % of range off",
            "last, % of range off",
            "evaluations a recursion",
            "s, last recursion",
            "s in all",
        ),
        tuple(rows),
        f"{FIRST} samples off-line, {RECURSIONS} recursions of {BLOCK} samples, {LOOPS} generations"
        " each, 1 % torque noise. Times without compiling.",
    )
    end = runs["RDE"][-1].numbers
    found = PaperTable(
        "Table 4: the numbers after the last recursion",
        ("", "truth", "RDE"),
        tuple((k, v, end[k]) for k, v in twin.NUMBERS.items()),
    )
    motion = twin.path(1, 20.0)
    t, real, fitted = motion[0], twin.torque(motion), torque_of(end, motion)
    first = torque_of(runs["RDE"][0].numbers, motion)
    pictures = (
        Picture(
            "objective",
            "Figure 7: the objective on all data over the recursions",
            (9.2, 3.4),
            lambda f: _recursions(f, objective, least),
        ),
        lines(
            "torque",
            "Figures 8 and 9: torques of the two joints",
            [
                (
                    "time (s)",
                    f"torque of joint {j + 1} (N m)",
                    {
                        "real": (t, real[:, j]),
                        "off-line": (t, first[:, j]),
                        "after the last recursion": (t, fitted[:, j]),
                    },
                )
                for j in (0, 1)
            ],
        ),
    )
    more = whole(longer[-1])
    enough = whole(runs["RDE"][-1]) < 1.05 * more
    spent = sum(s.seconds for s in runs["RDE"])
    dry = {k: end[k] / v - 1 for k, v in twin.NUMBERS.items() if k not in twin.BODY}

    def pct(values):
        return ", ".join(f"{k} {100 * v:+.0f} %" for k, v in values.items())

    claims = (
        judged(
            "the objective decreases over the recursions",
            "Figure 7",
            f"RDE's, on all data, from {number(objective['RDE'][0] / least)} to "
            f"{number(objective['RDE'][-1] / least)} times the least",
            bool(objective["RDE"][-1] <= objective["RDE"][0]),
        ),
        judged(
            "five calculation loops a recursion suffice",
            "5",
            f"with five the objective ends at {number(whole(runs['RDE'][-1]) / least)} times the"
            f" least, with {5 * LOOPS} at {number(more / least)} times",
            enough,
        ),
        judged(
            "this is due to RDE's mutation",
            "",
            "with five loops on the carried population DE ends at"
            f" {number(objective['DE'][-1] / least, 4)}, RDE at"
            f" {number(objective['RDE'][-1] / least, 4)} times the least",
            bool(objective["RDE"][-1] * 1.05 < objective["DE"][-1]),
        ),
        judged(
            "about 40 s in all",
            "40 s, 1 s a generation",
            f"{number(spent)} s in all, without compiling",
            spent < 40,
        ),
        judged(
            "the joints' friction is revised at the same time",
            "",
            f"off by {pct(dry)}, while the torque is off by "
            f"{100 * np.linalg.norm(fitted - real) / np.linalg.norm(real):.1f} %",
            max(map(abs, dry.values())) < 0.2,
        ),
    )
    return PaperPart("RDE while data arrive", (), (table, found), pictures, claims)


def _recursions(figure: Figure, objective: Mapping[str, np.ndarray], least: float) -> None:
    axes = figure.add_subplot()
    for (label, values), color in zip(objective.items(), COLORS, strict=False):
        axes.plot(range(len(values)), values / least, "o-", color=color, label=label, markersize=4)
    axes.set(xlabel="recursion (0: off-line)", ylabel="objective / its least")
    plot.legend(figure, axes.get_legend_handles_labels()[0], 4, "outside upper center")


def linear_system(count: int, seeds: int) -> PaperPart:
    """Table 5: the rigid torque alone, which is linear in the body's numbers."""
    errors: dict[str, list[float]] = {}
    loops: dict[str, list[int]] = {}
    cost: dict[str, list[tuple[int, float]]] = {}
    for seed in range(seeds):
        p, _ = streamed(False, seed)
        parts: list[Any] = list(stretches(p, FIRST // BLOCK))
        ls = [least_squares(q) for q in parts]
        errors.setdefault("LS", []).append(off(numbers_of(p, ls[-1].z)))
        cost.setdefault("LS", []).append((ls[-1].evaluations, 0.0))
        for label, method in populations(count).items():
            steps = (
                carried(method, parts, ls, seed)
                if label == "RDE"
                else alone(method, parts[-1], ls[-1], seed)
            )
            errors.setdefault(label, []).append(off(steps.numbers))
            cost.setdefault(label, []).append((steps.evaluations, steps.seconds))
            loops.setdefault(label, []).append(count if steps.loops is None else steps.loops)
    rows = []
    for k, e in errors.items():
        spent, seconds = np.median(cost[k], axis=0)
        needed = int(np.median(loops[k])) if k in loops else 1
        rows.append((k, 100 * float(np.median(e)), needed, int(spent), float(seconds)))
    table = PaperTable(
        "Table 5: the last recursion on the rigid torque alone",
        (
            "method",
            "largest error, % of range",
            "loops to 1 % of the least",
            "evaluations a recursion",
            "s a recursion",
        ),
        tuple(rows),
        f"Medians of {len(errors['LS'])} noise seeds, 1 % torque noise. RDE goes on from the"
        f" recursion before; the others begin anew on all data, at most {count} generations. The"
        " paper's own values are lost.",
    )
    e = {k: float(np.median(v)) for k, v in errors.items()}
    n = {k: int(np.median(v)) for k, v in loops.items()}

    def pct(*names):
        return ", ".join(f"{k} {100 * e[k]:.2g} %" for k in names)

    def said(k):
        return f"{n[k]}" if n[k] < count else f"not in {count}"

    def near(a, b):
        return abs(e[a] - e[b]) <= 0.1 * max(e[a], e[b])

    claims = (
        judged(
            "RDE is more precise than LS and GA (linear part)",
            "values lost",
            pct("RDE", "LS", "GA"),
            e["RDE"] < 0.95 * min(e["LS"], e["GA"]),
        ),
        judged(
            "LS is more accurate than RDE (said three sentences later)",
            "values lost",
            pct("LS", "RDE"),
            e["LS"] < 0.95 * e["RDE"],
        ),
        judged(
            "RDE's error is approximately PSO's",
            "values lost",
            pct("RDE", "PSO"),
            near("RDE", "PSO"),
        ),
        judged(
            "GA needs more loops than RDE",
            "5 for RDE",
            f"GA {said('GA')}, RDE {said('RDE')}",
            n["GA"] > n["RDE"],
        ),
        judged(
            "PSO needs about as many loops as RDE",
            "",
            f"PSO {said('PSO')}, RDE {said('RDE')}",
            n["PSO"] <= 2 * n["RDE"],
        ),
    )
    return PaperPart("The linear part: LS, GA and PSO beside RDE", (), (table,), (), claims)


def evaluations(seeds: int, cap: int) -> PaperPart:
    """Without noise: evaluations to a thousandth of the torque, from random beginnings."""
    motion = twin.path(1)
    tau = twin.torque(motion)
    p = problem_of([motion], [tau], 0.0)
    best = levenberg_marquardt([(p, p.z(named(p, twin.NUMBERS)))], 50, 1e-14)[0]
    goal = p.loss(best.z) + GOAL**2 * float(np.mean((tau / p.runs.noise) ** 2))
    methods: dict[str, AbstractFitter] = dict(populations(10**4))
    methods |= {
        "RDE, target": fitters.RecursiveDE(
            variant="target", F=(0.5, 0.5), generations=10**4, **SIZE
        ),
        "RDE, literal": fitters.RecursiveDE(
            variant="shift", F=(0.5, 0.5), generations=10**4, **SIZE
        ),
        "LM": fitters.LevenbergMarquardt(restarts=2),
    }
    runs = race(p, methods, range(seeds), cap)
    rows = tuple(_reached(r, goal, seeds, cap) for r in runs)
    typical = {r.label: _median(r.reached(goal)) for r in runs}
    table = PaperTable(
        "Evaluations until the torque error is a thousandth of the torque",
        ("method", "reached", "evaluations, median", "range", "s a run"),
        rows,
        f"Twelve unknowns, no noise, {seeds} seeds, at most {cap} evaluations; a residual with its"
        f" derivatives counts {1 + p.size}.",
    )
    order = sorted((k for k in typical if np.isfinite(typical[k])), key=typical.__getitem__)
    said = ", ".join(f"{k} {typical[k]:.0f}" for k in order)
    text = (f"Fewest evaluations first: {said or 'none arrived'}.",)
    claims = (
        judged(
            "RDE converges faster than DE and ADE",
            "",
            said or "none arrived",
            typical["RDE"] < min(typical["DE"], typical["ADE"]),
        ),
        PaperClaim(
            "the literal wording (the step takes the place of the best vector) guides the"
            " population to the optimum",
            "",
            f"reached by {len(runs[[r.label for r in runs].index('RDE, literal')].reached(goal))}"
            f" of {seeds} within {cap} evaluations",
            HOLDS if np.isfinite(typical["RDE, literal"]) else FAILS,
            "as this library reads the words",
        ),
    )
    picture = course(
        "race", "Torque error over evaluations, median and range", runs, "loss, best so far"
    )
    return PaperPart("What a search costs", text, (table,), (picture,), claims)


def _median(counts: Sequence[int]) -> float:
    """Infinite where no run arrived."""
    return float(np.median(counts)) if counts else np.inf


def _reached(r: Searched, goal: float, seeds: int, cap: int) -> tuple[Any, ...]:
    counts = r.reached(goal)
    middle = f"{np.median(counts):.0f}" if counts else f"more than {cap}"
    return (
        r.label,
        f"{len(counts)} of {seeds}",
        middle,
        f"{min(counts)} to {max(counts)}" if counts else "–",
        r.seconds,
    )


def change(count: int, offline: int) -> PaperPart:
    """A load that is dropped in part while data arrive: windows and forgetting against growing
    data.
    """
    blocks = twin.cut(twin.path(4, count * BLOCK / 20.0), BLOCK)[:count]
    part = {k: 0.6 * v for k, v in twin.BODY.items()} | {"m2": 0.8 * twin.BODY["m2"]}
    truths = [twin.BODY] * (count // 2) + [part] * (count - count // 2)
    p = problem_of(
        blocks, [twin.torque(m, body=b) for m, b in zip(blocks, truths, strict=True)], NOISE
    )
    ways: dict[str, tuple[AbstractPopulation, dict[str, Any]]] = {
        "RDE, window of 3 blocks": (populations(offline)["RDE"], {"window": 3}),
        "RDE, forgetting 0.5 a block": (populations(offline)["RDE"], {"forgetting": 0.5}),
        "RDE, growing data (paper)": (populations(offline)["RDE"], {}),
        "DE, window of 3 blocks": (populations(offline)["DE"], {"window": 3}),
        "ADE, window of 3 blocks": (populations(offline)["ADE"], {"window": 3}),
    }
    runs = {k: followed(m, p, LOOPS, **how) for k, (m, how) in ways.items()}
    runs["LM, window of 3 blocks"] = descended(p, 3)
    begins = FIRST // BLOCK
    ends = {k: 100 * off(steps[-1].numbers, part) for k, steps in runs.items()}
    rows = tuple(
        (
            k,
            100 * off(steps[count // 2 - begins].numbers, twin.BODY),
            ends[k],
            steps[-1].evaluations,
        )
        for k, steps in runs.items()
    )
    table = PaperTable(
        "Largest error of the body's numbers, % of their range",
        (
            "method",
            "before the change",
            f"{count - count // 2} blocks after it",
            "evaluations a block",
        ),
        rows,
        f"Blocks of {BLOCK} samples, {LOOPS} generations each; the load drops after block"
        f" {count // 2}.",
    )
    at = np.arange(begins, count + 1)
    curves = {"truth": (np.arange(1, count + 1), np.array([b["I2"] for b in truths]))}
    for k, steps in runs.items():
        curves[k] = (at[: len(steps)], np.array([s.numbers["I2"] for s in steps]))
    picture = lines(
        "change",
        "The inertia of the last body over the blocks",
        [("block of data", "I2 (kg m²)", curves)],
    )
    exact = {k: v for k, v in ends.items() if v < 2.0}
    claims = (
        judged(
            "RDE follows the system's dynamics exactly",
            "",
            "with growing data, as in the paper, it is "
            f"{number(ends['RDE, growing data (paper)'])} % "
            f"of the range off; with a window {number(ends['RDE, window of 3 blocks'])} %",
            ends["RDE, growing data (paper)"] < 2.0,
        ),
        judged(
            "DE and ADE cannot take in new data",
            "",
            f"with a window DE ends {number(ends['DE, window of 3 blocks'])} %, ADE "
            f"{number(ends['ADE, window of 3 blocks'])} % off",
            min(ends["DE, window of 3 blocks"], ends["ADE, window of 3 blocks"]) > 2.0,
        ),
    )
    text = (f"Within 2 % of the range at the end: {listed(list(exact)) or 'none'}.",)
    return PaperPart("Following a change", text, (table,), (picture,), claims)


def base() -> PaperPart:
    """The paper's assumption that torques hardly move the base."""
    motion = twin.path(1)
    rows = []
    for mass, inertia in ((2500.0, 2000.0), (1000.0, 500.0), (500.0, 120.0)):
        tau = twin.torque(motion, (mass, inertia))
        rng = np.random.default_rng(0)
        known = dataset([motion], [tau + 0.003 * tau.std(0) * rng.standard_normal(tau.shape)])
        still = fit(None, known, residual="inverse_dynamics")
        moved = np.linalg.norm(tau - twin.torque(motion)) / np.linalg.norm(tau)
        left = still.scores["fit"]["tau1"].relative_error
        rows.append(
            (
                f"{mass:.0f} kg, {inertia:.0f} kg m²",
                100 * float(moved),
                *(still.parameters[k].value for k in twin.BODY),
                100 * left,
            )
        )
    table = PaperTable(
        "A floating base, fitted as if it stood still",
        (
            "base",
            "its share of the torque, %",
            *(f"{k} ({UNITS[k]})" for k in twin.BODY),
            "error of the first torque left, %",
        ),
        tuple(rows),
        f"Truth: {', '.join(f'{k} {v:g}' for k, v in twin.BODY.items())}; 0.3 % noise.",
    )
    mass = rows[0][2] / twin.BODY["m2"] - 1
    text = (
        (
            f"With the heaviest base the model fits to {rows[0][-1]:.1f} % of the torque and the"
            f" mass is {100 * mass:+.0f} % off: a small residual does not show it."
        ),
    )
    claims = (
        judged(
            "joint torques have little influence on the base, so that a fixed base may be assumed",
            "",
            f"a base of 2500 kg changes the torques by {rows[0][1]:.0f} % and the identified mass"
            f" by {100 * mass:+.0f} %",
            abs(mass) < 0.05,
        ),
        PaperClaim(
            "identified values of Table 4 and Table 5",
            "values lost",
            "",
            UNKNOWN,
            "the tables' values are not in the public copies",
        ),
    )
    return PaperPart("The base that is assumed to stand still", text, (table,), (), claims)
