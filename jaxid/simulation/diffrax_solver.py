"""Runs simulated by a solver of diffrax instead of jaxid's own stepping: a check by other means, on
the user's own data.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from jaxid.base.errors import nearest, UsageError
from jaxid.dynamics.carry import Carry
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import chosen, Command, OutputEffect
from jaxid.dynamics.mechanism import Mechanism
from jaxid.dynamics.ode import rates
from jaxid.numerics.reverse import reversible
from jaxid.simulation.rollout import Lane, simulate_rollout


@dataclass(frozen=True)
class Diffrax:
    """A solver of diffrax with its tolerances. Each step of a run (none is longer than 2.5 ms) is
    solved anew with its input, which jumps between them, by as many steps as the tolerances take;
    sensors and recordings are as in jaxid's own stepping.

    `adjoint` None: forward mode in fits, `DirectAdjoint` in `make_problem`, which passes both
    modes. A solver without an error estimate takes `steps` equal ones; others at most `steps`.
    """

    solver: Any
    rtol: float = 1e-8
    atol: float = 1e-10
    adjoint: Any = None
    steps: int = 64

    def __str__(self) -> str:
        return f"diffrax:{type(self.solver).__name__}"


def named(text: str) -> Diffrax:
    """The solver that `diffrax:Tsit5` names. Raises `UsageError` for what is none."""
    import diffrax

    kind, _, name = text.partition(":")
    kinds = {
        n: c
        for n, c in vars(diffrax).items()
        if isinstance(c, type) and issubclass(c, diffrax.AbstractSolver)
    }
    usable = [
        n
        for n in kinds
        if not n.startswith("Abstract") and not issubclass(kinds[n], diffrax.AbstractItoSolver)
    ]
    if kind != "diffrax" or not name:
        raise UsageError(f"a solver is `own` or `diffrax:NAME`, as in diffrax:Tsit5, not {text!r}")
    if name not in usable:
        raise UsageError(f"diffrax has no solver {name!r}{nearest(name, usable)}")
    try:
        return Diffrax(kinds[name]())
    except TypeError as error:
        raise UsageError(
            f"diffrax:{name} needs settings: make it in Python, solver=diffrax.{name}(...)"
        ) from error


@cache
def diffrax_lane(solver: Diffrax) -> Lane:
    """The lane that simulates by a solver."""

    def advance(chain: Chain, body: Mechanism, carry: Carry, command: Command) -> tuple[Carry, Any]:
        return solved_step(solver, chain, body, carry, command)

    def lane(chain, samples, where, start, steps, length, reach, burn, body=None, wanted=None):
        return simulate_rollout(
            chain=chain,
            samples=samples,
            where=where,
            start=start,
            steps=steps,
            length=length,
            reach=reach,
            burn=burn,
            body=body,
            wanted=wanted,
            advance=advance,
        )

    return lane


def solved_step(
    solver: Diffrax, chain: Chain, body: Mechanism, carry: Carry, command: Command
) -> tuple[Carry, Any]:
    """`Chain.step` by a solver: state at the end of a step, and what the sensors record at its
    beginning.
    """
    import diffrax

    sensors = [isinstance(e, OutputEffect) for e in chain.effects]
    moving = chosen(sensors, [()] * len(sensors), carry.z)
    y0, unravel = ravel_pytree((carry.x, moving))
    late = command.delayed  # the mean over the step, as of the input itself

    def field(t: Any, y: Any, args: Any) -> Any:
        chain, body, begin, u, other = args
        held = Command(begin + t, jnp.zeros(()), u, other, late)
        x, z = unravel(y)
        dx, dz, _ = rates(chain, body, begin + t, x, z, held)
        return ravel_pytree((dx, dz))[0]

    _, _, tau = rates(chain, body, command.t, carry.x, moving, command)
    adaptive = isinstance(solver.solver, diffrax.AbstractAdaptiveSolver)
    control: Any = (
        diffrax.PIDController(rtol=solver.rtol, atol=solver.atol)
        if adaptive
        else diffrax.ConstantStepSize()
    )
    adjoint = solver.adjoint or (diffrax.DirectAdjoint() if reversible() else diffrax.ForwardMode())
    first = command.h if adaptive else command.h / solver.steps
    found = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        solver.solver,
        jnp.zeros(()),
        command.h,
        first,
        y0,
        (chain, body, command.t, command.u, command.other),
        saveat=diffrax.SaveAt(t1=True),
        stepsize_controller=control,
        max_steps=solver.steps + 1,
        adjoint=adjoint,
        throw=False,
    )
    failed = found.result != diffrax.RESULTS.successful
    x, z = unravel(jnp.where(failed, jnp.nan, jnp.asarray(found.ys)[-1]))  # as where a run diverges
    q, _ = body.port(carry.x)
    y, sensed = chain.sense(body, carry, tau, jnp.zeros(q.shape, bool), command)
    return carry._replace(x=x, z=chosen(sensors, sensed, z)), y
