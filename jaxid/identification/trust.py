"""How well an arm's file is known beforehand, where short recordings leave open what others
show.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxid.dynamics.base_parameters import BaseParameters
from jaxid.identification.regression import FrictionLaw, RegressionRun


#: To within this many times their size the numbers of a file may be known: validation runs decide.
TRUST = (10.0, 3.0, 1.0, 0.3, 0.1)
NEAR_THE_FILE = (
    "the file's inertial numbers, and friction of nothing, count as known to within {:g} times the"
    " size of such numbers: every validation run is predicted better so than by what the fit runs"
    " alone say"
)
#: Parameter of friction -> with which power of the speed its torque goes.
POWERS = {"F_c": 0, "offset": 0, "F_s": 0, "F_v": 1, "F_3": 3}


def spread_of(
    base: BaseParameters, prior: np.ndarray, law: FrictionLaw, fit: Sequence[RegressionRun]
) -> np.ndarray:
    """Standard deviations [p] of a file that is wrong by as much as it says: of inertial parameters
    the root mean square of those of their kind (masses, first moments, inertias), of friction what
    makes a torque as large as the measured one.
    """
    kinds = np.array([_kind(name) for name in base.names])
    own = prior[: len(kinds)]
    typical = {k: np.sqrt(np.mean(own[kinds == k] ** 2)) for k in set(kinds.tolist())}
    largest = max(typical.values(), default=1.0) or 1.0
    bodies = np.array([max(typical[k], 1e-3 * largest) for k in kinds])

    def rms(series):
        return np.maximum(np.sqrt(np.mean(np.concatenate(series) ** 2, 0)), 1e-9)

    torque, speed = rms([r.tau for r in fit]), rms([r.qd for r in fit])
    return np.concatenate([bodies, *(torque / speed ** POWERS[name] for name, _ in law.parameters)])


def _kind(name: str) -> str:
    plain = name.rstrip("0123456789")
    return "mass" if plain == "m" else "moment" if plain in ("mx", "my", "mz") else "inertia"


def nearer_the_file(
    solve: Callable[[float], Any], error: Callable[[Any], np.ndarray], free: Any, better: float
) -> tuple[Any, float] | None:
    """The solution near the file's numbers that predicts the validation runs best, and how near;
    None where the `free` one predicts one of them about as well: `error` of a solution [runs]. Few
    short recordings leave combinations of numbers open that others show.
    """
    plain = error(free)
    if not len(plain):
        return None
    found = [solve(trust) for trust in TRUST]
    errors = [error(one) for one in found]
    best = int(np.argmin([e.mean() for e in errors]))
    return (found[best], TRUST[best]) if np.all(errors[best] < (1 - better) * plain) else None
