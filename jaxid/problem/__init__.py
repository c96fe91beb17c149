"""A model and data as numbers: residuals, losses, problems."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.base.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.problem.objective import FunctionProblem as FunctionProblem
    from jaxid.problem.pure_problem import Problem as Problem
    from jaxid.problem.residual import (
        InverseDynamics as InverseDynamics,
        MultipleShooting as MultipleShooting,
        OutputError as OutputError,
        Residual as Residual,
    )


__getattr__, __dir__, __all__ = _attach(
    __name__,
    {
        "FunctionProblem": "jaxid.problem.objective",
        "Problem": "jaxid.problem.pure_problem",
        "InverseDynamics": "jaxid.problem.residual",
        "MultipleShooting": "jaxid.problem.residual",
        "OutputError": "jaxid.problem.residual",
        "Residual": "jaxid.problem.residual",
    },
)
