"""Fitters: one algorithm a file. A new one: its file, and one line here."""

# Imported as bare `fitters`, every class would exist twice and isinstance would fail.
if __name__ != "jaxid.fitters":
    raise ImportError("import jaxid.fitters, not fitters")

from .ade import RandToBestDE
from .bfgs import BFGS
from .cmaes import CMAES
from .de import DifferentialEvolution
from .ga import GeneticAlgorithm
from .hybrid import Hybrid
from .linear import InstrumentalVariables, LeastSquares, RecursiveLeastSquares, WeightedLeastSquares
from .lm import LevenbergMarquardt
from .optimistix import (
    Optimistix,
    OptimistixBFGS,
    OptimistixDogleg,
    OptimistixLM,
    OptimistixNelderMead,
)
from .pso import ParticleSwarm
from .rde import RecursiveDE
from .shade import Shade


FITTERS = (
    LevenbergMarquardt,
    Hybrid,
    BFGS,
    DifferentialEvolution,
    RandToBestDE,
    RecursiveDE,
    ParticleSwarm,
    GeneticAlgorithm,
    CMAES,
    Shade,
    LeastSquares,
    WeightedLeastSquares,
    RecursiveLeastSquares,
    InstrumentalVariables,
    OptimistixLM,
    OptimistixDogleg,
    OptimistixBFGS,
    OptimistixNelderMead,
)

__all__ = [
    "BFGS",
    "CMAES",
    "FITTERS",
    "DifferentialEvolution",
    "GeneticAlgorithm",
    "Hybrid",
    "InstrumentalVariables",
    "LeastSquares",
    "LevenbergMarquardt",
    "Optimistix",
    "OptimistixBFGS",
    "OptimistixDogleg",
    "OptimistixLM",
    "OptimistixNelderMead",
    "ParticleSwarm",
    "RandToBestDE",
    "RecursiveDE",
    "RecursiveLeastSquares",
    "Shade",
    "WeightedLeastSquares",
]
