"""Fitters: one algorithm a file. A new one: its file, and one line here."""

# Imported as bare `fitters`, every class would exist twice and isinstance would fail.
if __name__ != "jaxid.fitters":
    raise ImportError("import jaxid.fitters, not fitters")

from typing import Any

from jaxid.fitting.fitter import AbstractFitter as _AbstractFitter

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


#: In this order they are listed; what is not named here comes last, by its name.
_FIRST = (
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


def _registered() -> tuple[Any, ...]:
    """All but the one that has to be given a solver."""
    kinds = {
        v for v in globals().values() if isinstance(v, type) and issubclass(v, _AbstractFitter)
    }
    later = kinds - {_AbstractFitter, *_FIRST, Optimistix}
    return (*_FIRST, *sorted(later, key=lambda kind: kind.name))


FITTERS: tuple[Any, ...] = _registered()
