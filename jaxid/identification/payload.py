"""The payload of an arm from two identifications, with and without it: base parameters differ by
what the load adds to them.

A body at the last link adds K_L phi_L to the base parameters, with K_L the last link's ten columns
of the regrouping. Two ways:

- all rows: generalised least squares of the whole difference with the covariance of both identifications, then the nearest body
  that can exist (positive definite pseudo-inertia) in the metric of that covariance;
- the rows of paper 001, equations (12) to (16): mass from three of them, then the rest one after the other.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.small_files import read_small
from jaxid.dynamics.base_parameters import BaseParameters
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.drive_torque import records_torque
from jaxid.dynamics.rigid_body import INERTIA, pseudo_inertia
from jaxid.identification.bodies import consistent_bodies


Z95 = 1.959963984540054
#: How far the torque constant of a motor's data sheet is off, more or less.
USUAL_GAIN_STD = 0.05
#: A mass below this, kg, has no centre.
NO_MASS = 1e-12


def usual_gain_std(chain: Chain) -> float:
    """Relative standard deviation of the drive gains where nobody states one: the usual one where
    torques are made of currents, none where torques were recorded.
    """
    return 0.0 if records_torque(chain) else USUAL_GAIN_STD


def centre(first: np.ndarray, mass: float) -> np.ndarray:
    """Centre of mass [3] of a body by its first moments; not a number without a mass."""
    return np.asarray(first, float) / mass if abs(mass) > NO_MASS else np.full(3, np.nan)


@dataclass(frozen=True)
class PayloadEstimate:
    """Load in the last link's frame: `phi` ten inertial parameters about its origin with
    `covariance` (least squares, all rows), `body` the nearest that can exist, `published` by the
    rows of paper 001 (None for another kind of arm).
    """

    phi: np.ndarray
    covariance: np.ndarray
    body: np.ndarray
    published: np.ndarray | None
    gain_std: float
    rows: int
    converged_after_s: float | None = None

    @property
    def mass(self) -> tuple[float, float]:
        """Mass and its standard deviation (kg), that of the drive gains included."""
        m = float(self.phi[9])
        return m, float(np.hypot(np.sqrt(self.covariance[9, 9]), self.gain_std * m))

    @property
    def exact_gains(self) -> str:
        """What the interval leaves out, in words; nothing where it counts the error of the drive
        gains.
        """
        if self.gain_std > 0:
            return ""
        with_gains = replace(self, gain_std=USUAL_GAIN_STD).mass[1]
        return (
            "the interval takes the drive gains, which make torque of current, as exact: their"
            f" relative error is one of the mass (gain_std = {USUAL_GAIN_STD:g} would make it ±"
            f" {with_gains:.2g} kg)"
        )

    @property
    def counted_gains(self) -> str:
        """What share of the gains the interval holds, in words; nothing where it takes them as
        exact.
        """
        if not self.gain_std > 0:
            return ""
        return (
            "the interval counts the drive gains, which make torque of current, as known to within"
            f" {100 * self.gain_std:g} % (--gain-std states another tolerance)"
        )

    def com(self) -> list[tuple[float, float]]:
        """Centre of mass and standard deviations (m); gains cancel in first order."""
        m, out = self.phi[9], []
        if not abs(m) > NO_MASS:
            return [(0.0, float("inf"))] * 3
        for k in (6, 7, 8):
            slope = np.array([1 / m, -self.phi[k] / m**2])
            out.append(
                (
                    float(self.phi[k] / m),
                    float(np.sqrt(slope @ self.covariance[np.ix_([k, 9], [k, 9])] @ slope)),
                )
            )
        return out

    def to_dict(self) -> dict[str, Any]:
        def quantity(v, s, unit):
            return {
                "value": v,
                "std": s,
                "interval_95": [v - Z95 * s, v + Z95 * s],
                "unit": unit,
            }

        std = np.hypot(np.sqrt(np.diag(self.covariance)), self.gain_std * np.abs(self.phi))
        out: dict[str, Any] = {
            "mass": quantity(*self.mass, "kg"),
            "com": [quantity(v, s, "m") for v, s in self.com()],
            "inertia": [
                {"name": INERTIA[k], **quantity(float(self.phi[k]), float(std[k]), "kg m^2")}
                for k in range(6)
            ],
            "nearest_body": {
                "mass": self.body[9],
                "com": centre(self.body[6:9], float(self.body[9])),
                "inertia": self.body[:6],
            },
            "frame": "last link; inertia about its origin",
            "gain_std": self.gain_std,
            "gains": self.exact_gains or self.counted_gains,
            "rows": self.rows,
            "converged_after_s": self.converged_after_s,
        }
        if self.published is not None:
            m = self.published[9]
            out["paper_001"] = {
                "mass": m,
                "com": centre(self.published[6:9], float(m)),
                "inertia": self.published[:6],
            }
        return out


def read_reference(reference: Any) -> dict[str, Any]:
    """Names, values and covariance of an identification, from itself, its dictionary or its JSON
    file.
    """
    if hasattr(reference, "to_dict"):
        reference = reference.to_dict()
    if isinstance(reference, str | Path):
        try:
            reference = json.loads(read_small(reference).decode())
        except OSError as error:
            raise UsageError(
                f"--reference {reference}: cannot be read ({error.strerror})"
            ) from error
        except ValueError as error:
            raise UsageError(f"--reference {reference}: not JSON ({error})") from error
    if (
        not isinstance(reference, Mapping)
        or reference.get("kind") != "identification"
        or "covariance" not in reference
    ):
        raise UsageError(
            "a reference is the identification.json of the unloaded arm (jaxid identify … --out"
            " UNLOADED)"
        )
    return dict(reference)


def payload_by_difference(
    loaded: Any,
    reference: Mapping[str, Any],
    base: BaseParameters,
    prismatic: np.ndarray,
    gain_std: float = 0.0,
) -> PayloadEstimate:
    """Payload from an `Identification` of the loaded arm and the dictionary of the unloaded one's.

    Raises `UsageError` where the two are not of the same arm.
    """
    p = len(base.kept)
    if list(reference["names"])[: len(base.names)] != list(base.names):
        raise UsageError(
            f"the reference identifies {reference.get('model')}, not {loaded.model} with the same"
            " geometry; use the same model"
        )
    before = np.array([entry["value"] for entry in reference["base_parameters"]], float)
    spread = np.array(reference["covariance"], float)[:p, :p]
    difference = np.asarray(loaded.theta[:p]) - before
    return payload_of(difference, loaded.covariance[:p, :p] + spread, base, gain_std)


def payload_of(
    difference: np.ndarray, covariance: np.ndarray, base: BaseParameters, gain_std: float = 0.0
) -> PayloadEstimate:
    """Payload from a difference of base parameters and its covariance."""
    n = len(base.standard) // 11
    K = base.K[:, 11 * (n - 1) : 11 * (n - 1) + 10]
    scale = np.sqrt(np.diag(covariance)) + 1e-300
    L = np.linalg.cholesky(covariance / scale / scale[:, None] + 1e-10 * np.eye(len(scale)))
    A, b = np.linalg.solve(L, K / scale[:, None]), np.linalg.solve(L, difference / scale)
    H = A.T @ A
    size = np.sqrt(np.diag(H))
    if (size <= 0).any() or np.linalg.eigvalsh(H / size / size[:, None]).min() < 1e-12:
        raise UsageError(
            "the last link's parameters do not all show in this arm's base parameters: the payload"
            " is not determined"
        )
    inverse = np.linalg.inv(H / size / size[:, None]) / size / size[:, None]
    phi = inverse @ (A.T @ b)
    rows = int(np.sum(np.abs(K).max(1) > 1e-9))
    return PayloadEstimate(
        phi, inverse, nearest_body(phi, H), published_rows(difference, base), gain_std, rows
    )


def nearest_body(phi: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """Ten numbers of the body that can exist nearest to phi, (phi - body)' metric (phi - body)
    least.
    """
    if np.linalg.eigvalsh(pseudo_inertia(phi)).min() > 0:
        return phi
    from scipy.optimize import least_squares

    m = max(float(phi[9]), 1e-3)
    r = 0.1
    start = np.array([m * r * r, 0, 0, m * r * r, 0, m * r * r, 0, 0, 0, m])[None]
    R = np.linalg.cholesky(metric).T
    found = least_squares(
        lambda x: R @ (consistent_bodies(x[None], start)[0] - phi),
        np.zeros(10),
        x_scale="jac",
        max_nfev=500,
    )
    return consistent_bodies(found.x[None], start)[0]


def published_rows(difference: np.ndarray, base: BaseParameters) -> np.ndarray | None:
    """Equations (12) to (16) of paper 001: (Ixx … m) about the last origin from 13 rows; None where
    an arm lacks them.
    """
    rows = dict(zip(base.names, range(len(base.names)), strict=True))
    needed = (
        "mx2",
        "mx3",
        "my4",
        "my5",
        "Ixx5",
        "Izz5",
        "Ixx6",
        "Ixy6",
        "Ixz6",
        "Iyz6",
        "Izz6",
        "mx6",
        "my6",
    )
    if len(base.standard) != 66 or any(name not in rows for name in needed):
        return None
    e = {name: float(difference[rows[name]]) for name in needed}

    def k(row, name):
        return float(base.K[rows[row], base.standard.index(name)])

    a = np.array([k(row, "m6") for row in ("mx2", "mx3", "my4")])
    if not np.any(a) or not k("my5", "mz6"):
        return None
    m = float(a @ [e["mx2"], e["mx3"], e["my4"]] / (a @ a))  # (12), (13)
    mz = (e["my5"] - k("my5", "m6") * m) / k("my5", "mz6")  # (14)
    both = [e[row] - k(row, "mz6") * mz - k(row, "m6") * m for row in ("Ixx5", "Izz5")]
    Iyy = float(
        np.mean([v / k(row, "Iyy6") for v, row in zip(both, ("Ixx5", "Izz5"), strict=True)])
    )  # (15)
    Ixx = e["Ixx6"] - k("Ixx6", "Iyy6") * Iyy  # (16)
    return np.array(
        [Ixx, e["Ixy6"], e["Ixz6"], Iyy, e["Iyz6"], e["Izz6"], e["mx6"], e["my6"], mz, m]
    )
