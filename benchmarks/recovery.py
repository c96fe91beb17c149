"""Recovery: are the stated 95 % intervals honest, and how wide are they against the Cramér-Rao
bound?

A pendulum with viscous and dry friction and an offset, integrated event-exactly by SciPy from
separately written equations; the same motion is recorded with 200 noise seeds, each recording is
fitted on its own.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

from jaxid.data.dataset import Dataset  # noqa: E402
from jaxid.fitting.covariance import covariance  # noqa: E402
from jaxid.fitting.least_squares import levenberg_marquardt  # noqa: E402
from jaxid.fitting.problem_builder import ProblemBuilder  # noqa: E402
from jaxid.problem.binding import bind  # noqa: E402
from jaxid.problem.problem import linearise  # noqa: E402
from jaxid.problem.residual import OutputError  # noqa: E402
from tests import reference as ref  # noqa: E402


TRUTH = {"inertia": 0.06, "gravity_torque": 1.3, "viscous": 0.04, "coulomb": 0.12, "offset": -0.03}
NOISE, RATE, SECONDS = 1e-3, 100, 5.0
STEP = 1.25e-3  # s; halving it moves the answer by less than a hundredth of the noise


def study(seeds: int) -> dict[str, np.ndarray]:
    """Estimates [seeds parameters], their stated standard deviations, and the Cramér-Rao bound
    [parameters].
    """
    t = np.arange(round(SECONDS * RATE) + 1) / RATE
    u = ref.multisine(t, [1.0], 0, periods=2.5)
    u[:20] = 0.0
    truth = ref.Truth(viscous=TRUTH["viscous"], coulomb=TRUTH["coulomb"], offset=TRUTH["offset"])
    q, _ = ref.simulate(ref.pendulum(TRUTH["inertia"], TRUTH["gravity_torque"]), truth, t, u)
    settings: dict[str, Any] = {"at_rest": True, "noise_std": {"q": NOISE}, "model": "pendulum"}
    settings |= {"split": ["fit", "validation"]}

    def dataset(y: np.ndarray) -> Dataset:
        """The recording, and a piece of it as validation run, so that nothing is cut off the fitted
        one.
        """
        piece = slice(60, 120)
        return Dataset.from_arrays(
            [t, t[:60]], {"tau": [u[:, 0], u[piece, 0]]}, {"q": [y, y[piece]]}, **settings
        )

    binding = bind(None, dataset(ref.measured(q[:, 0], NOISE, 0)))
    benches = []
    for seed in range(seeds):
        fresh = dataset(ref.measured(q[:, 0], NOISE, 1000 + seed)).with_splits()
        benches.append(ProblemBuilder(dataclasses.replace(binding, dataset=fresh), STEP))
    names = [binding.layout.names[i] for i in binding.free]
    start = binding.theta.copy()
    for i, name in zip(binding.free, names, strict=True):
        start[i] = TRUTH[name] * 1.1 + 0.01
    estimates, stds = [], []
    exact = start.copy()
    exact[binding.free] = [TRUTH[n] for n in names]
    for bench in benches:
        problem = bench.problem(OutputError(), "fit", binding.free, start)
        path = levenberg_marquardt([(problem, problem.z(start))], 40, 1e-10)[0]
        cov, slope = covariance(problem, path.z), problem.dtheta(path.z)
        estimates.append(problem.theta(path.z)[binding.free])
        stds.append(cov.std[: len(names)] * slope)
    problem = benches[0].problem(OutputError(), "fit", binding.free, exact)
    z = problem.z(exact)
    z[len(names) :] = 0.0  # the start was at 0
    information = linearise([(problem, z)])[0].hessian
    bounds = np.sqrt(np.diag(np.linalg.inv(information)))[: len(names)] * problem.dtheta(z)
    return {
        "names": np.array(names),
        "estimates": np.array(estimates),
        "stds": np.array(stds),
        "bounds": bounds,
        "truth": np.array([TRUTH[n] for n in names]),
    }


def coverage(found: dict[str, np.ndarray]) -> np.ndarray:
    """Share of the recordings whose 95 % interval holds the truth, per parameter."""
    inside = np.abs(found["estimates"] - found["truth"]) <= 1.96 * found["stds"]
    return inside.mean(0)


def main(seeds: int = 200) -> dict:
    began = time.perf_counter()
    found = study(seeds)
    covered, width = coverage(found), np.median(found["stds"], 0) / found["bounds"]
    bias = (found["estimates"].mean(0) - found["truth"]) / found["bounds"]
    scatter = found["estimates"].std(0) / found["bounds"]
    rows = [
        {
            "parameter": str(n),
            "truth": float(found["truth"][j]),
            "coverage of 95 % intervals": f"{100 * covered[j]:.1f} %",
            "median width / Cramér-Rao": f"{width[j]:.3f}",
            "scatter / Cramér-Rao": f"{scatter[j]:.3f}",
            "bias / Cramér-Rao": f"{bias[j]:+.3f}",
        }
        for j, n in enumerate(found["names"])
    ]
    text = (
        f"{seeds} noise seeds of {NOISE:g} rad on a pendulum with dry friction, integrated event-exactly by SciPy, {SECONDS:g} s "
        f"at {RATE} Hz; {(time.perf_counter() - began) / seeds:.2f} s a fit. Required: coverage 91 to 98 %, width at most 1.3."
    )
    return {"title": "Recovery: coverage and width of the intervals", "text": text, "rows": rows}


if __name__ == "__main__":
    import json

    print(json.dumps(main(int(sys.argv[1]) if len(sys.argv) > 1 else 200), indent=1))
