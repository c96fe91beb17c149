"""The joint torque that a drive makes of recorded inputs along a measured motion."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxid.dynamics.chain import Chain
from jaxid.dynamics.drive_torque import drive_gains, driven
from jaxid.dynamics.effect import Command, Signals
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.numerics.export_cache import ExportedFunction, key_of
from jaxid.numerics.kept import shared
from jaxid.numerics.precision import float64
from jaxid.simulation.sample_buffers import bucket


#: Length of a step in which nothing changes, s.
MOMENT = 1e-9


def drive_torque(
    layout: ParameterVector,
    theta: Float[np.ndarray, " numbers"] | None,
    u: Float[np.ndarray, "time nu"],
    motion: Float[np.ndarray, "time motion"],
) -> Float[np.ndarray, "time nq"]:
    """Joint torque (N m, N) that the drive makes of recorded inputs u [time nu], each in the unit
    of its channel, in a measured motion (q, qd, ...) [time 2 nq or more], with the numbers theta
    (None: those of the layout), [time nq]. Whatever compares recorded inputs with torques takes
    them from here.
    """
    chain, nq = layout.chain, layout.chain.nq
    if chain.direct and not chain.signature.beside:
        model = chain if theta is None else layout.model(theta)
        return u * np.asarray(drive_gains(model), float)
    form = layout.form

    def made():
        return ExportedFunction(
            lambda theta, *args: _driven(form.model(theta), *args), key_of(_driven, form.bare)
        )

    room = bucket(len(u)) - len(u)  # runs of other lengths meet the same program
    args = [np.pad(a, ((0, room), (0, 0))) for a in (u, motion[:, :nq], motion[:, nq : 2 * nq])]
    with float64():
        return np.asarray(
            shared("drive", form, made)(layout.values if theta is None else theta, *args)
        )[: len(u)]


def _driven(chain: Chain, u: Any, q: Any, qd: Any) -> Any:
    body = chain.body()
    return jax.vmap(lambda u, q, qd: _torque(chain, body, u, q, qd))(u, q, qd)


def _torque(chain: Chain, body: Any, u: Any, q: Any, qd: Any) -> Any:
    """Of a law that which it makes of a goal that has been there for long; of other inputs what the
    drive is known to make.
    """
    if getattr(chain.mechanism, "drive_law", None) is None:
        return driven(chain, body, u, q, qd)
    command = Command(jnp.zeros(()), jnp.asarray(MOMENT), u, u, lambda delay: u)
    signals = Signals(command.t, q, qd, jnp.zeros_like(q), command.h, command, qd)
    asked = chain.commanded(signals, chain.start(q, qd, u, body).z)[0]
    return body.drive(chain.signature, asked, q, qd)
