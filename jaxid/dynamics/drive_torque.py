"""The way from recorded inputs to joint torque: a channel, its drive gain, and a mechanism's own
drive.

Everything that compares recorded inputs with torques comes through here: a current in A is a torque
only times its gain.
"""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.dynamics.effect import InputEffect
from jaxid.dynamics.mechanism import Mechanism


if TYPE_CHECKING:
    from jaxid.dynamics.chain import Chain


FORCES = "N m", "N"


def records_torque(chain: Chain) -> bool:
    """Whether each input is in the unit of a torque or force."""
    return all(unit in FORCES for _, unit in chain.signature.commands)


def is_direct(chain: Chain) -> bool:
    """Whether each input, times its drive gain, is the drive torque or force of a joint."""
    if len(chain.signature.commands) != chain.nq:
        return False
    return records_torque(chain) or bool(_known_gains(chain))


def _known_gains(chain: Chain) -> list[Array]:
    found = (effect.known_gain() for _, effect in chain.at(InputEffect))
    return [gain for gain in found if gain is not None]


def drive_gains(chain: Chain) -> Any:
    """Joint torque (N m, N) that one unit of each command is known to make, [commands]; 1 where
    nothing says.
    """
    total: Any = np.ones(len(chain.signature.commands))
    for gain in _known_gains(chain):
        total = total * gain
    return total


def driven(
    chain: Chain,
    body: Mechanism,
    u: Float[Array, " nu"],
    q: Float[Array, " nq"],
    qd: Float[Array, " nq"],
) -> Float[Array, " nq"]:
    """Joint torque (N m, N) of inputs in the units of their channels: through the drive gains, then
    through the mechanism's own drive (gears, motors). Effects at the inputs that a fit looks for
    are left out.
    """
    n = len(chain.signature.commands)
    known = jnp.concatenate([drive_gains(chain) * u[:n], u[n:]])
    return body.drive(chain.signature, known, q, qd)
