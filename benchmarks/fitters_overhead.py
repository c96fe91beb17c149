"""What an optimiser costs besides the loss: CPU time of a generation on a loss that costs next to
nothing.

Interleaved in one process, medians of several runs with their spread. Compiling is left out on our
side. SciPy's DE calls the same compiled loss once a generation (`vectorized=True`) and does no
polishing.
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
import jax.numpy as jnp  # noqa: E402
from scipy.optimize import differential_evolution  # noqa: E402

from jaxid.fitters import (  # noqa: E402
    CMAES,
    DifferentialEvolution,
    GeneticAlgorithm,
    ParticleSwarm,
    RandToBestDE,
    Shade,
)
from jaxid.fitting.population import AbstractPopulation, CHUNK  # noqa: E402
from jaxid.numerics.precision import float64  # noqa: E402
from jaxid.problem.objective import FunctionProblem  # noqa: E402


SIZES = ((6, 100), (60, 100), (6, 1000))


def valley(dim: int) -> FunctionProblem:
    """Rosenbrock's function as a sum of squares."""

    def residual(z):
        return jnp.concatenate([10 * (z[1:] - z[:-1] ** 2), 1 - z[:-1]])

    return FunctionProblem(residual, np.full(dim, -2.0), np.full(dim, 2.0))


def spent(
    fitter: AbstractPopulation, problem: FunctionProblem, generations: int, seed: int
) -> float:
    """CPU seconds a generation."""
    start = [np.zeros(problem.size)]
    began = time.process_time()
    found = fitter.minimise(
        problem, start, jax.random.key(seed), fitter.popsize + generations * fitter.offspring
    )
    return (time.process_time() - began) / ((found.evaluations - fitter.popsize) / fitter.offspring)


def peer(problem: FunctionProblem, popsize: int, generations: int, seed: int) -> float:
    """The same for SciPy's differential evolution."""
    dim = problem.size
    program = jax.jit(lambda x: problem.pure_losses(x.T, problem.data))

    def loss(x: np.ndarray) -> np.ndarray:
        with float64():
            return np.asarray(program(x))

    population: Any = np.random.default_rng(seed).uniform(-2, 2, (popsize, dim))
    loss(population.T)
    began = time.process_time()
    found = differential_evolution(
        loss,
        [(-2, 2)] * dim,
        init=population,
        maxiter=generations,
        tol=0,
        atol=0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=seed,
    )
    return (time.process_time() - began) / found.nit


def evosax(problem: FunctionProblem, popsize: int) -> Any:
    """(generations, seed) -> CPU seconds a generation of evosax's differential evolution,
    generations as one program; None where it is not installed. It keeps no bounds.
    """
    try:
        from evosax.algorithms import DifferentialEvolution as Peer  # pyright: ignore[reportMissingImports]
    except ImportError:
        return None
    dim, loss = problem.size, lambda z: problem.pure_losses(z, problem.data)
    with float64():
        method = Peer(population_size=popsize, solution=jnp.zeros(dim))

    def run(key, population, count):
        first, key = jax.random.split(key)
        state = method.init(first, population, loss(population), method.default_params)

        def generation(k, carry):
            state, key = carry
            key, ask, tell = jax.random.split(key, 3)
            candidates, state = method.ask(ask, state, method.default_params)
            state, _ = method.tell(tell, candidates, loss(candidates), state, method.default_params)
            return state, key

        return jax.lax.fori_loop(0, count, generation, (state, key))[0].best_fitness

    program = jax.jit(run)

    def spent(generations: int, seed: int) -> float:
        with float64():
            population = jnp.asarray(np.random.default_rng(seed).uniform(-2, 2, (popsize, dim)))
            program(jax.random.key(seed), population, 1).block_until_ready()  # compiles
            began = time.process_time()
            program(jax.random.key(seed), population, generations).block_until_ready()
            return (time.process_time() - began) / generations

    return spent


def main(repeats: int = 5) -> dict:
    rows = []
    for dim, popsize in SIZES:
        problem = valley(dim)
        settings: dict[str, Any] = {
            "popsize": popsize,
            "generations": 10**6,
            "stall": 0,
            "restarts": 0,
        }
        fitters = [
            k(**settings)
            for k in (
                DifferentialEvolution,
                RandToBestDE,
                ParticleSwarm,
                GeneticAlgorithm,
                CMAES,
                Shade,
            )
        ]
        fitters.insert(1, DifferentialEvolution(crossover="exp", F=(0.5, 0.5), CR=0.8, **settings))
        names = [f.name for f in fitters]
        names[1] = "de, rand/1/exp"
        for f in fitters:
            spent(f, problem, 600, 0)  # compiles
        ours: dict[str, list[float]] = {n: [] for n in names}
        theirs: list[float] = []
        batched, batches = evosax(problem, popsize), list[float]()
        for seed in range(repeats):
            for n, f in zip(names, fitters, strict=True):
                ours[n].append(spent(f, problem, 4 * CHUNK, seed))
            theirs.append(peer(problem, popsize, 20, seed))
            batches += [] if batched is None else [batched(CHUNK, seed)]
        reference = float(np.median(theirs))
        for n in names:
            low, middle, high = np.quantile(ours[n], [0, 0.5, 1]) * 1e6
            rows.append(
                {
                    "fitter": n,
                    "variables": dim,
                    "population": popsize,
                    "us a generation": f"{middle:.0f} ({low:.0f} to {high:.0f})",
                    "SciPy DE, us": f"{reference * 1e6:.0f}",
                    "SciPy / ours": f"{reference * 1e6 / middle:.0f}",
                    "evosax DE, us": f"{np.median(batches) * 1e6:.0f}"
                    if batches
                    else "not installed",
                    "evosax / ours": f"{np.median(batches) * 1e6 / middle:.0f}" if batches else "",
                }
            )
    text = (
        f"CPU time of a generation, loss included (Rosenbrock). Whole generations run as one program; median of {repeats} "
        "interleaved runs, with the lowest and highest. Required: at most 50 us at 6 variables and a population of 100."
    )
    return {"title": "Optimiser overhead", "text": text, "rows": rows}


if __name__ == "__main__":
    import json

    print(json.dumps(main(), indent=1))
