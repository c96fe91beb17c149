"""The experiments of the four papers, re-done on twins: data from separately written equations at the published parameters.

Nobody's recordings of the four rigs are published, so nothing here claims agreement with them. What can be compared: which
parameters come back, how the algorithms rank, and how large the published differences are beside the scatter of our own runs.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jax  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402

from jaxid import fitters  # noqa: E402
from jaxid.data.dataset import Channel, Dataset, Experiment, FrequencyResponse, ModelSpec, ParameterPrior  # noqa: E402
from jaxid.fitting.fitter import AbstractFitter  # noqa: E402
from jaxid.fitting.problem_builder import Bench, start_values  # noqa: E402
from jaxid.fitting.run import Benches, fit_seeds  # noqa: E402
from jaxid.problem.binding import bind  # noqa: E402
from jaxid.problem.frequency_response import FrequencyResponseError  # noqa: E402
from jaxid.problem.problem import Problem  # noqa: E402
from jaxid.study.papers.twins import flexible_link as link  # noqa: E402


# ---- paper 002: one flexible link, DE against GA against PSO

LINK_BOUNDS = {
    "E": (20e9, 100e9), "I_m": (1e-3, 0.2), "v": (1e-5, 0.3), "tau_c": (1e-3, 0.2), "alpha": (1e-3, 4.0), "beta": (1e-7, 2e-4),
}  # fmt: skip
LINK_RESIDUAL = FrequencyResponseError(magnitude=True, linear=True, timed=("phi",))
PAPER_LINK = {"DE": (5.7002e10, 0.0053, 0.1071), "GA": (6.0665e10, 0.0073, 0.0589), "PSO": (5.6597e10, 0.0048, 0.0902)}


def link_data(modes: int = 4) -> Dataset:
    """A rectangular pulse of 0.241 N m for 0.3 s (80 degrees), 2 s at 1 kHz, 1.5 mrad noise; 250 lines of the linear response
    with 2 % noise in magnitude."""
    rng = np.random.default_rng(0)
    t = np.arange(2000) * 1e-3
    u = np.where(t < 0.3, 0.241, 0.0)
    y = link.zero_order_hold(u, 1e-3, 10, link.DE["v"], link.DE["tau_c"])
    y[:, 0] += 1.5e-3 * rng.standard_normal(2000)
    f = np.arange(0.2, 50.01, 0.2)
    response = link.direct(f) * (1 + 0.02 * rng.standard_normal(f.size))
    channels = (
        Channel("tau", "input", "N m"),
        Channel("phi", "output", "rad", noise_std=1.5e-3),
        Channel("tip_acceleration", "output", "m/s^2", noise_std=0.3),
    )
    run = Experiment("pulse", "fit", t, u[:, None], y, at_rest=True, initial={"phi": 0.0, "qd": 0.0})
    short = run.piece(0, 100, name="held", split="validation"), run.piece(0, 100, name="report", split="report")
    priors = {k: ParameterPrior(None, *b) for k, b in LINK_BOUNDS.items()}
    model = ModelSpec("flexible_link", constants={"n_modes": modes}, parameters=priors)
    lines = FrequencyResponse("response", "fit", 2 * np.pi * f, response, "tau", "tip_acceleration")
    return Dataset("paper_002", channels, (run, *short), (lines,), model)


def link_problem(modes: int = 4) -> Problem:
    """The paper's loss (6) of this recording; its numbers are where a fit would begin."""
    binding = bind(None, link_data(modes))
    bench = Bench(binding)
    return bench.problem(LINK_RESIDUAL, "fit", binding.free, start_values(bench, binding.free, 0)[0], loss="sum_of_norms")


def link_study(seeds: int) -> tuple[list[dict], float]:
    """A row for each method, and the seconds that the three of the paper took together, from reading the data on."""
    began = time.perf_counter()
    problem = link_problem()
    start = problem.z(problem.base)
    size: Any = {"popsize": 100, "generations": 100}
    methods: dict[str, AbstractFitter] = {
        "DE rand/1/exp, F 0.5, CR 0.8 (paper)": fitters.DifferentialEvolution(
            F=(0.5, 0.5), CR=0.8, crossover="exp", stall=0, **size
        ),
        "GA (paper)": fitters.GeneticAlgorithm(stall=0, **size),
        "PSO w 1.4 (paper)": fitters.ParticleSwarm(w=1.4, c1=1.5, c2=2.5, stall=0, **size),
        "DE rand/1/bin, F 0.5 to 0.9, CR 0.9": fitters.DifferentialEvolution(**size),
        "GA, scattered": fitters.GeneticAlgorithm(scheme="scattered", **size),
        "PSO constricted": fitters.ParticleSwarm(**size),
        "SHADE": fitters.Shade(**size),
        "hybrid": fitters.Hybrid(),
    }
    rows, every, papers = [], {}, 0.0
    for label, method in methods.items():
        before = time.perf_counter()
        found = method.minimise_each([(problem, [start], jax.random.key(s)) for s in range(seeds)])
        papers = time.perf_counter() - began if label.endswith("(paper)") else papers
        losses = np.array([f.loss for f in found])
        theta = dict(zip(problem.runs.layout.names, problem.theta(found[int(losses.argmin())].z), strict=True))
        row = {
            "method": label, "J mean": losses.mean(), "J sd": losses.std(ddof=1), "J best": losses.min(), "J worst": losses.max(),
            "within 5 % of the best": "",
            "evaluations": int(np.median([f.evaluations for f in found])),
            "seconds per run": (time.perf_counter() - before) / seeds,
        }  # fmt: skip
        rows.append(row | {"found": ", ".join(f"{k} {theta[k]:.4g}" for k in LINK_BOUNDS)})
        every[label] = losses
    least = min(float(losses.min()) for losses in every.values())
    for row in rows:
        row["within 5 % of the best"] = f"{int((every[row['method']] < 1.05 * least).sum())} of {seeds}"
    return rows, papers


# ---- paper 003: the tracker, GA against PSO

TRACKER = {"J_theta": 0.117, "J_alpha": 0.1, "b_theta": 1.9, "b_alpha": 1.495}
TRACKER_BOUNDS = {"J_theta": (0.01, 0.5), "J_alpha": (0.001, 0.5), "b_theta": (0.1, 5.0), "b_alpha": (0.1, 5.0)}


def tracker_run(u: np.ndarray, t: np.ndarray) -> np.ndarray:
    """theta, alpha [time 2] under voltages u [time 2], equations (4, corrected), (5) and (6) as the paper has them."""
    m, mc, l, c, R, g = 0.043, 0.103, 0.26, 0.036, 0.09, 9.81
    k, J = m * l + 2 * mc * c, TRACKER["J_alpha"]

    def field(time, x, volts):
        th, al, w, v = x
        T = 0.1 * np.sign(volts) * np.maximum(np.abs(volts) - 1.68, 0)
        s, cosine = np.sin(al), np.cos(al)
        bend = k * R * s - 2 * J * s * cosine
        yaw = TRACKER["J_theta"] + (m + mc) * R**2 - k * R * cosine + J * cosine**2
        load = (m * l / 2 + mc * c) * g * cosine
        return [w, v, (T[0] - bend * v * w - TRACKER["b_theta"] * w) / yaw,
                (T[1] + bend * w * w / 2 - TRACKER["b_alpha"] * v - load) / J]  # fmt: skip

    x, out = np.zeros(4), [np.zeros(2)]
    edges = [0, *(np.flatnonzero(np.any(np.diff(u, axis=0) != 0, 1)) + 1), len(t) - 1]
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        part = solve_ivp(field, (t[a], t[b]), x, "LSODA", t[a : b + 1], args=(u[a],), rtol=1e-9, atol=1e-11)
        out += list(part.y[:2, 1:].T)
        x = part.y[:, -1]
    return np.array(out)


def tracker_data() -> Dataset:
    """Test A (base driven) and test B (barrel driven), 3.6 V then 2.4 V, 10 s at 100 Hz, 0.1 degree noise."""
    rng = np.random.default_rng(0)
    t = np.arange(1001) * 0.01
    step = np.where((t >= 1) & (t < 4), 3.6, np.where((t >= 4) & (t < 7), 2.4, 0.0))
    noise = np.deg2rad(0.1)
    runs = []
    for name, column in (("A", 0), ("B", 1)):
        u = np.zeros((t.size, 2))
        u[:, column] = step
        y = tracker_run(u, t) + noise * rng.standard_normal((t.size, 2))
        known = {"theta": 0.0, "alpha": 0.0}
        runs.append(Experiment(name, "fit", t, u, y, at_rest=True, initial=known))
    runs += [runs[0].piece(0, 60, name="held", split="validation"), runs[1].piece(0, 60, name="report", split="report")]
    channels = (
        Channel("u_theta", "input", "V"), Channel("u_alpha", "input", "V"),
        Channel("theta", "output", "rad", noise_std=noise), Channel("alpha", "output", "rad", noise_std=noise),
    )  # fmt: skip
    priors = {k: ParameterPrior(None, *b) for k, b in TRACKER_BOUNDS.items()}
    return Dataset("paper_003", channels, tuple(runs), model=ModelSpec("tracker", parameters=priors))


def tracker_study(seeds: int) -> list[dict]:
    binding = bind(None, tracker_data())
    benches = Benches(binding)
    size: Any = {"popsize": 20, "generations": 60}
    methods: dict[str, tuple[AbstractFitter, str]] = {
        "GA (paper: population 20)": (fitters.GeneticAlgorithm(scheme="scattered", **size), "sum_of_abs"),
        "PSO": (fitters.ParticleSwarm(**size), "sum_of_abs"),
        "SHADE": (fitters.Shade(**size), "sum_of_abs"),
        "BFGS on the same F": (fitters.BFGS(), "sum_of_abs"),
        "Levenberg-Marquardt, squares": (fitters.LevenbergMarquardt(), "sum_of_squares"),
    }
    rows = []
    for label, (method, loss) in methods.items():
        count = seeds if loss == "sum_of_abs" and "BFGS" not in label else 1
        fits = fit_seeds(binding, method, None, loss, range(count), None, benches=benches)
        losses = np.rad2deg([f.loss for f in fits])
        best = fits[int(np.argmin([f.loss for f in fits]))]
        row: dict[str, Any] = {"method": label}
        if loss == "sum_of_abs":
            row |= {"F median, deg": float(np.median(losses)), "F range, deg": f"{losses.min():.0f} to {losses.max():.0f}"}
        row["evaluations"] = int(np.median([f.evaluations for f in fits]))
        row["found"] = ", ".join(f"{k} {p.value:.4g}" + (f" ± {p.std:.2g}" if p.std else "") for k, p in best.parameters.items())
        rows.append(row)
    return rows


def claims(rows: list[dict]) -> str:
    """What our own runs say of the ranking in paper 002."""
    de, ga, pso = (next(r for r in rows if r["method"].startswith(m) and "(paper)" in r["method"]) for m in ("DE", "GA", "PSO"))
    tame = next(r for r in rows if r["method"] == "PSO constricted")
    holds = lambda true: "yes" if true else "no"
    return (
        f"DE lowest in mean, {holds(de['J mean'] < min(ga['J mean'], pso['J mean']))}, and in spread, "
        f"{holds(de['J sd'] < min(ga['J sd'], pso['J sd']))}; GA worst mean, {holds(ga['J mean'] > pso['J mean'])}; "
        f"PSO largest spread, {holds(pso['J sd'] > max(de['J sd'], ga['J sd']))}: with its inertia weight of 1.4 it diverges, "
        f"constricted its mean is {tame['J mean']:.2g} instead of {pso['J mean']:.2g}."
    )


def main() -> dict:
    about = (__doc__ or "").split("\n", 2)[2].strip()
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 and sys.argv[1].isdigit() else 10
    link_rows, seconds = link_study(seeds)
    rows = [{"paper": "002, flexible link", **r} for r in link_rows]
    rows += [{"paper": "003, tracker", **r} for r in tracker_study(seeds)]
    text = (
        f"{about}\n\n{seeds} seeds each. The three methods of paper 002 with its settings took {seconds:.1f} s together, from "
        "reading the data to the last loss, programs from the cache or compiled. Truth of 002: E 5.7002e10 Pa, I_m 0.0053 "
        f"kg m^2, tau_c 0.1071 N m; the paper's own answers {PAPER_LINK} (its J is not given; it claims DE lowest in mean and "
        f"spread, GA worst mean, PSO largest spread). Truth of 003: {TRACKER}; the paper's mean F over ten runs is 4195 for GA "
        "and 8496 for PSO, on its own recordings, and counts one angle a test where ours counts both. What holds of the paper's "
        f"claims: {claims(link_rows)}"
    )
    return {"title": "The papers' experiments on twins", "text": text, "rows": rows}


if __name__ == "__main__":
    for row in main()["rows"]:
        print({k: (round(v, 5) if isinstance(v, float) else v) for k, v in row.items()})
