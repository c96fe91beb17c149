"""What simulates the runs of a binding: jaxid's own stepping, or a solver of diffrax."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.dynamics.ode import check_smooth
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.problem.binding import Binding
from jaxid.problem.residual import Residual


def with_solver(binding: Binding, solver: Any, residual: Residual | None) -> Binding:
    """The binding whose free runs and windows are simulated by a solver of diffrax; None, "own": by
    jaxid's own stepping. Raises `UsageError` for dry friction that sticks, and for residuals that
    are something else.
    """
    if solver is None or solver == "own":
        return binding
    import diffrax

    from jaxid.simulation.diffrax_solver import Diffrax, named

    if isinstance(solver, str):
        solver = named(solver)
    elif isinstance(solver, diffrax.AbstractSolver):
        solver = Diffrax(solver)
    if not isinstance(solver, Diffrax):
        raise UsageError(
            f"a solver is one of diffrax, such as diffrax.Tsit5(), not {type(solver).__name__}"
        )
    if residual is not None and not (residual.free_run or residual.windows):
        raise UsageError(
            f"a solver simulates free runs (output_error, multiple_shooting); {residual.name} has"
            " its own way"
        )
    check_smooth(binding.chain)
    return replace(binding, layout=ParameterVector(binding.layout.chain, solver))


def solver_notes(binding: Binding) -> tuple[str, ...]:
    """What is to be said of a solver that is not jaxid's own stepping."""
    solver = binding.layout.solver
    if solver is None:
        return ()
    errors = f"rtol {solver.rtol:g}, atol {solver.atol:g}"
    return (f"simulated by {solver} ({errors}), not by jaxid's own stepping",)


def solver_name(binding: Binding) -> str:
    """What simulates the runs of a binding."""
    return "own" if binding.layout.solver is None else str(binding.layout.solver)
