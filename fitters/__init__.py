"""Fitters: one algorithm a file. A new one: its file, and one line here."""

# Imported as bare `fitters`, every class would exist twice and isinstance would fail.
if __name__ != "jaxid.fitters":
    raise ImportError("import jaxid.fitters, not fitters")

from .de import DifferentialEvolution
from .linear import InstrumentalVariables, LeastSquares, WeightedLeastSquares
from .lm import descend, LevenbergMarquardt, Path, search


FITTERS = (LevenbergMarquardt, DifferentialEvolution, LeastSquares, WeightedLeastSquares, InstrumentalVariables)

__all__ = [
    "FITTERS",
    "DifferentialEvolution",
    "InstrumentalVariables",
    "LeastSquares",
    "LevenbergMarquardt",
    "Path",
    "WeightedLeastSquares",
    "descend",
    "search",
]
