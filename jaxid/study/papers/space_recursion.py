"""Paper 000's problems and recursions: torque errors of a plane arm, blocks of data, and methods
that follow them.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxid import fitters
from jaxid.data.dataset import Dataset, ModelSpec, ParameterPrior
from jaxid.fitting.fitter import Minimum
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.sequential import follow, stretches
from jaxid.problem.binding import bind
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import InverseDynamics
from jaxid.study.papers.searches import numbers_of, random_start
from jaxid.study.papers.twins import space_arm as twin


#: The paper's intervals are lost.
BOUNDS = {
    "m2": (5, 100),
    "hx": (0, 60),
    "hy": (-20, 20),
    "I2": (1, 60),
    "F_c": (0.1, 5),
    "F_s": (0.1, 6),
    "v_s": (0.005, 0.3),
    "F_v": (0, 6),
}
UNITS = {"m2": "kg", "hx": "kg m", "hy": "kg m", "I2": "kg m²"}
#: Samples off-line and of a recursion, and recursions: 8 of 5 generations of 1 s are the paper's 40
#: s.
FIRST, BLOCK, RECURSIONS, LOOPS = 100, 50, 8, 5
NOISE = 0.01
#: Of the rms torque: where a search without noise has arrived.
GOAL = 1e-3


# ---- data and problems


def problem_of(
    motions: Sequence[twin.Motion], torques: Sequence[np.ndarray], noise: float, seed: int = 0
) -> FitProblem:
    """The torque error of the fixed-base model, a piece a motion. Torques without friction are
    those of a model without.
    """
    rng = np.random.default_rng(seed)
    size = np.sqrt(np.mean(np.concatenate(list(torques)) ** 2, 0))
    noisy = [tau + noise * size * rng.standard_normal(tau.shape) for tau in torques]
    return built(dataset(motions, noisy))


def dataset(
    motions: Sequence[twin.Motion], torques: Sequence[np.ndarray], friction: bool = True
) -> Dataset:
    own = {k: ParameterPrior(None, *BOUNDS[k]) for k in BOUNDS if k in twin.BODY}
    known: dict[str, Any] = {k: twin.LINK[k] for k in ("l1", "I1")}
    for j in ("1", "2"):
        if friction:
            of_joint = [k for k in BOUNDS if k not in twin.BODY]
            own |= {k + j: ParameterPrior(None, *BOUNDS[k]) for k in of_joint}
        else:
            known |= {k + j: 0.0 for k in twin.FRICTION} | {f"v_s{j}": 1.0}
    inputs, outputs = {}, {}
    for j in (0, 1):
        inputs[f"tau{j + 1}"] = [tau[:, j] for tau in torques]
        outputs[f"q{j + 1}"] = [m[1][:, j] for m in motions]
    return Dataset.from_arrays(
        [m[0] for m in motions],
        inputs,
        outputs,
        split="fit",
        noise_std={"q1": 1e-6, "q2": 1e-6},
        model=ModelSpec("space_manipulator", constants=known, parameters=own),
    )


def built(data: Dataset) -> FitProblem:
    binding = bind(None, data, splits=False)
    return ProblemBuilder(binding).problem(InverseDynamics(), "fit", binding.free, binding.theta)


def streamed(friction: bool, seed: int = 0, path: int = 1) -> tuple[FitProblem, list[twin.Motion]]:
    """A problem of blocks, 1 % torque noise."""
    motion = twin.path(path, (FIRST + RECURSIONS * BLOCK) / 20.0 - 0.05)
    blocks = twin.cut(motion, BLOCK)
    rng = np.random.default_rng(seed)
    laws = twin.FRICTION if friction else None
    torques = [twin.torque(m, friction=laws) for m in blocks]
    size = np.sqrt(np.mean(np.concatenate(torques) ** 2, 0))
    noisy = [tau + NOISE * size * rng.standard_normal(tau.shape) for tau in torques]
    return built(dataset(blocks, noisy, friction)), blocks


def off(numbers: Mapping[str, float], truth: Mapping[str, float] = twin.BODY) -> float:
    """Largest error of the body's numbers, a share of their range."""
    return max(
        abs(numbers[k] - truth[k]) / (BOUNDS[k][1] - BOUNDS[k][0]) for k in truth if k in twin.BODY
    )


SIZE: Any = {"popsize": 60, "stall": 0}


def populations(generations: int) -> dict[str, AbstractPopulation]:
    """The algorithms that the paper compares; what it does not state is the library's own."""
    common: Any = SIZE | {"generations": generations}
    return {
        "DE": fitters.DifferentialEvolution(F=(0.5, 0.5), **common),
        "ADE": fitters.RandToBestDE(F=(0.4, 0.9), K=0.5, **common),
        "RDE": fitters.RecursiveDE(**common),
        "GA": fitters.GeneticAlgorithm(**common),
        "PSO": fitters.ParticleSwarm(**common),
    }


def named(p: FitProblem, numbers: Mapping[str, float]) -> np.ndarray:
    theta, names = p.base.copy(), list(p.runs.layout.names)
    for k, v in numbers.items():
        theta[names.index(k)] = v
    return theta


def torque_of(numbers: Mapping[str, float], motion: twin.Motion) -> np.ndarray:
    """Torques [time 2] of a motion with these numbers."""
    friction = {k: (numbers[f"{k}1"], numbers[f"{k}2"]) for k in twin.FRICTION}
    return twin.torque(motion, body=numbers, friction=friction)


# ---- methods that follow data


class SpaceStep(NamedTuple):
    """One recursion: loss on its own data, numbers, evaluations, and seconds it took without
    compiling.
    """

    loss: float
    numbers: dict[str, float]
    evaluations: int
    seconds: float
    loops: int | None = None


def followed(
    method: AbstractPopulation,
    p: FitProblem,
    loops: int,
    window: int | None = None,
    forgetting: float = 1.0,
) -> list[SpaceStep]:
    start = [(p.lower + p.upper) / 2]
    steps = follow(
        method, stretches(p, FIRST // BLOCK, window, forgetting), start, jax.random.key(0), loops
    )
    return [step_of(p, m) for m in steps]


def step_of(p: FitProblem, m: Minimum, loops: int | None = None) -> SpaceStep:
    return SpaceStep(
        m.loss, numbers_of(p, m.z), m.evaluations, m.seconds[-1] if m.seconds else 0.0, loops
    )


def least_squares(p: FitProblem) -> Minimum:
    return fitters.LeastSquares().minimise(p, [(p.lower + p.upper) / 2], jax.random.key(0))


def arrived(m: Minimum, least: float) -> int | None:
    return next((k for k, (_, loss) in enumerate(m.history) if loss <= 1.01 * least), None)


def alone(method: AbstractPopulation, p: FitProblem, ls: Minimum, seed: int) -> SpaceStep:
    m = method.minimise(p, [], jax.random.key(seed))
    return step_of(p, m, arrived(m, p.loss(ls.z)))


def carried(
    method: AbstractPopulation, parts: Sequence[FitProblem], ls: Sequence[Minimum], seed: int
) -> SpaceStep:
    """The last of the recursions."""
    start = [(parts[0].lower + parts[0].upper) / 2]
    *_, last = follow(method, parts, start, jax.random.key(seed), 20)
    return step_of(parts[-1], last, arrived(last, parts[-1].loss(ls[-1].z)))


def descended(p: FitProblem, window: int) -> list[SpaceStep]:
    """Five steps of Levenberg and Marquardt a block, from where the block before ended; the first
    from random starts.
    """
    out, z = [], None
    for own in stretches(p, FIRST // BLOCK, window):
        part: Any = own
        began = time.perf_counter()
        starts = [random_start(part, s) for s in range(8)] if z is None else [z]
        path = min(
            levenberg_marquardt([(own, s) for s in starts], 60 if z is None else LOOPS, 1e-12),
            key=lambda d: d.cost,
        )
        z = path.z
        out.append(
            SpaceStep(
                own.loss(z), numbers_of(p, z), LOOPS * (1 + p.size), time.perf_counter() - began
            )
        )
    return out
