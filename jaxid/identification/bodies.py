"""Least squares over bodies that can exist, with friction that brakes."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxid.dynamics.base_parameters import BaseParameters
from jaxid.dynamics.rigid_body import pseudo_inertia
from jaxid.identification.estimators import WEAK


def _of_pseudo(P: np.ndarray) -> np.ndarray:
    """Ten numbers of pseudo-inertia matrices [... 4 4]."""
    t = P[..., 0, 0] + P[..., 1, 1] + P[..., 2, 2]
    six = [
        t - P[..., 0, 0],
        -P[..., 0, 1],
        -P[..., 0, 2],
        t - P[..., 1, 1],
        -P[..., 1, 2],
        t - P[..., 2, 2],
    ]
    return np.stack([*six, P[..., 0, 3], P[..., 1, 3], P[..., 2, 3], P[..., 3, 3]], -1)


def consistent_bodies(
    x: Float[np.ndarray, "links 10"], prior: Float[np.ndarray, "links 10"]
) -> Float[np.ndarray, "links 10"]:
    """Inertial parameters [links 10] of log-Cholesky numbers [links 10], zero at the prior's bodies
    (Rucker, Wensing 2022).

    Pseudo-inertia C U U' C' with C that of the prior and U upper triangular with an exponential
    diagonal: any x is a body.
    """
    return Bodies(prior)(x)[0]


class Bodies:
    """x -> (inertial parameters [links 10], their slopes [links 10 10] by x); see
    `consistent_bodies`.
    """

    def __init__(self, prior: np.ndarray):
        self.C = np.linalg.cholesky(pseudo_inertia(prior))
        row, column = np.triu_indices(4, 1)
        self.row, self.column = (
            np.concatenate([np.arange(4), row]),
            np.concatenate([np.arange(4), column]),
        )

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        size = x.copy()
        size[:, :4] = np.exp(np.clip(x[:, :4], -30, 30))
        U = np.zeros((len(x), 4, 4))
        U[:, self.row, self.column] = size
        A = self.C @ U
        # dU has one entry: C dU A' is column `row` of C times column `column` of A
        weight = np.concatenate([size[:, :4], np.ones_like(size[:, 4:])], 1)
        half = (self.C[:, :, self.row] * weight[:, None]).swapaxes(1, 2)[..., None] * A[
            :, :, self.column
        ].swapaxes(1, 2)[..., None, :]
        slope = _of_pseudo(half + half.swapaxes(-1, -2))  # [links x ten]
        return _of_pseudo(A @ A.swapaxes(1, 2)), slope.swapaxes(1, 2)


def constrained(
    W: Float[np.ndarray, "rows numbers"],
    b: Float[np.ndarray, " rows"],
    base: BaseParameters,
    prior: Float[np.ndarray, "links 11"],
    levels: Bool[np.ndarray, " friction"],
    drives: bool,
    strength: float = 1e-3,
) -> tuple[Float[np.ndarray, " numbers"], Float[np.ndarray, "links 11"]]:
    """(theta, standard parameters [links 11]): least squares over bodies that can exist.

    `prior` [links 11] holds bodies that can exist, from which directions that no motion determines
    are taken: `strength` pulls each log-Cholesky number to it with that share of one row of unit
    residual. `levels` marks columns behind the base ones that may not be negative.
    """
    from scipy.optimize import least_squares as search

    n, p = len(prior), len(base.kept)
    R = np.linalg.qr(np.column_stack([W, b]))[1]
    R, z = R[: W.shape[1] + 1, :-1], R[: W.shape[1] + 1, -1]
    pull = np.sqrt(strength)
    start_friction = np.maximum(
        np.linalg.lstsq(W, b, rcond=WEAK)[0][p:], np.where(levels, 0.0, -np.inf)
    )
    inverse_drive = np.sqrt(np.maximum(prior[:, 10], 1e-3))

    bodies = Bodies(prior[:, :10])

    def unpack(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phi = np.column_stack(
            [bodies(x[: 10 * n].reshape(n, 10))[0], drives * x[10 * n : 11 * n] ** 2]
        )
        return phi, np.concatenate([base.values(phi.ravel()), x[11 * n :]])

    def residual(x: np.ndarray) -> np.ndarray:
        return np.concatenate([R @ unpack(x)[1] - z, pull * x[: 10 * n]])

    def jacobian(x: np.ndarray) -> np.ndarray:
        slope = np.zeros((n, 11, 11 * n))
        link = np.arange(n)
        each = bodies(x[: 10 * n].reshape(n, 10))[1]
        for k in range(10):
            slope[link, :10, 10 * link + k] = each[:, :, k]
        slope[link, 10, 10 * n + link] = 2 * drives * x[10 * n : 11 * n]
        out = np.zeros((len(z) + 10 * n, x.size))
        out[: len(z), : 11 * n] = R[:, :p] @ (base.K @ slope.reshape(11 * n, -1))
        out[: len(z), 11 * n :] = R[:, p:]
        out[len(z) + np.arange(10 * n), np.arange(10 * n)] = pull
        return out

    start = np.concatenate([np.zeros(10 * n), inverse_drive, start_friction])
    lower = np.concatenate(
        [np.full(10 * n, -12.0), np.full(n, -1e3), np.where(levels, -1e-9, -np.inf)]
    )
    upper = np.concatenate([np.full(10 * n, 12.0), np.full(n, 1e3), np.full(levels.size, np.inf)])
    slopes: Any = jacobian  # SciPy's annotation knows only the names of schemes
    found = search(
        residual,
        start,
        jac=slopes,
        bounds=(lower, upper),
        x_scale="jac",
        xtol=1e-8,
        ftol=1e-8,
        max_nfev=200,
    )
    phi, theta = unpack(found.x)
    theta[p:] = np.where(levels, np.maximum(theta[p:], 0.0), theta[p:])
    return theta, phi
