"""Are intervals by profile and by bootstrap honest? Share of twin recordings whose 95 % interval
holds the truth.

A joint with viscous and dry friction and an offset, integrated event-exactly by SciPy, with white
noise and with noise of a memory of ten samples; each recording is fitted on its own. Beside them
the covariance of `jaxid.fitting.covariance`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jaxid  # noqa: E402
from jaxid.fitting.covariance import covariance  # noqa: E402
from jaxid.fitting.least_squares import levenberg_marquardt  # noqa: E402
from jaxid.fitting.problem_builder import ProblemBuilder  # noqa: E402
from jaxid.fitting.profiles import bootstrap, profile_likelihood  # noqa: E402
from jaxid.problem.binding import bind  # noqa: E402
from jaxid.problem.residual import OutputError  # noqa: E402
from tests import reference as ref  # noqa: E402


TRUTH = {"inertia": 0.12, "viscous": 0.1, "coulomb": 0.12, "offset": -0.03}
NOISE, STEP = 1e-3, 1.25e-3


def study(seeds: int, memory: float) -> dict[str, np.ndarray]:
    """Method -> [seeds parameters], whether the 95 % interval holds the truth."""
    t = np.arange(201) * 0.01
    u = ref.multisine(t, [1.0], 0, periods=1)
    u[:10] = 0.0
    truth = ref.Truth(viscous=TRUTH["viscous"], coulomb=TRUTH["coulomb"], offset=TRUTH["offset"])
    q = ref.simulate(ref.joint(TRUTH["inertia"]), truth, t, u)[0][:, 0]
    data = jaxid.Dataset.from_arrays(
        [t],
        {"tau": [u[:, 0]]},
        {"q": [q]},
        at_rest=True,
        noise_std={"q": NOISE},
        model="joint",
        split=["fit"],
        check_model=False,
    )
    binding = bind(None, data, splits=False)
    problem = ProblemBuilder(binding, STEP).problem(
        OutputError(), "fit", binding.free, binding.theta
    )
    names = problem.names[: problem.free.size]
    exact = np.array([TRUTH[n] for n in names])
    record = problem.runs.record(problem.records[0])
    held: dict[str, list[np.ndarray]] = {"covariance": [], "profile": [], "bootstrap": []}
    for seed in range(seeds):
        e = np.random.default_rng(seed).standard_normal(len(t))
        a = np.exp(-1 / memory) if memory else 0.0
        for k in range(1, len(e)):
            e[k] = a * e[k - 1] + np.sqrt(1 - a * a) * e[k]
        targets = problem.targets.copy()
        targets[record.samples, 0] = q + NOISE * e
        own = problem.with_targets(targets)
        z = levenberg_marquardt([(own, own.z(binding.theta))], 60, 1e-10)[0].z
        cov, theta, slope = covariance(own, z), own.theta(z)[own.free], own.dtheta(z)
        held["covariance"].append(np.abs(theta - exact) <= 1.96 * cov.std[: len(names)] * slope)
        profiles = profile_likelihood(own, z)
        low = np.array(
            [-np.inf if p.interval[0] is None else p.interval[0] for p in profiles.values()]
        )
        high = np.array(
            [np.inf if p.interval[1] is None else p.interval[1] for p in profiles.values()]
        )
        held["profile"].append((low <= exact) & (exact <= high))
        intervals = np.array(list(bootstrap(own, z, 120, seed).interval().values()))
        held["bootstrap"].append((intervals[:, 0] <= exact) & (exact <= intervals[:, 1]))
    return {name: np.array(v) for name, v in held.items()} | {"names": np.array(names)}


def main(seeds: int = 60) -> dict:
    table = []
    for memory in (0.0, 10.0):
        found = study(seeds, memory)
        for method in ("covariance", "profile", "bootstrap"):
            share = 100 * found[method].mean(0)
            row = {"noise": f"memory {memory:g} samples" if memory else "white", "method": method}
            table.append(
                row | {str(n): f"{s:.0f} %" for n, s in zip(found["names"], share, strict=True)}
            )
    text = (
        f"Coverage of stated 95 % intervals over {seeds} twin recordings of 201 samples. By chance alone a true 95 % shows as "
        f"{100 * (0.95 - 1.96 * np.sqrt(0.95 * 0.05 / seeds)):.0f} to 100 %. The stated noise is that of one sample."
    )
    return {"title": "Coverage of profiles and bootstrap", "text": text, "rows": table}


if __name__ == "__main__":
    import json

    print(json.dumps(main(int(sys.argv[1]) if len(sys.argv) > 1 else 60), indent=1))
