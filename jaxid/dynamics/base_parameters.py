"""Base parameters: the combinations of inertial parameters that the torque of a serial chain can
show at all.

The torque is tau = Y(q, qd, qdd) phi, linear in the standard parameters phi, but columns of Y
depend on each other whatever the motion. Found numerically (Gautier 1991): columns of Y over random
motion, taken in a fixed order of preference, are kept where they are independent of those kept
before; every other column is a combination of the kept ones, which says how the parameters regroup:
base = phi_kept + K phi_others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from jaxid.base.wording import stem_and_number
from jaxid.dynamics.kinematics import free_fall, placements
from jaxid.dynamics.rigid_body import chain_of, INERTIA, inverse_dynamics, regressor, still


#: A column counts as dependent where less than this share of it lies outside the span of the kept
#: ones.
DEPENDENT = 1e-8
#: Order within a link: revolute joints keep what Khalil and Gautier keep (Iyy, mz, m regroup),
#: prismatic ones the mass first.
REVOLUTE = ("Ixx", "Ixy", "Ixz", "Iyz", "Izz", "mx", "my")
PRISMATIC = ("m", "mx", "my", "mz")
#: The numbers of a link in the order of the standard vector here: ten of the body, then the inertia
#: of its drive.
STANDARD = (*INERTIA, "Ia")


@dataclass(frozen=True)
class BaseParameters:
    """`standard` names of the 11 n parameters, `kept` the positions of the base columns, `K` [kept
    standard] with Y = Y[:, kept] K, so that base = K phi.
    """

    standard: tuple[str, ...]
    kept: tuple[int, ...]
    K: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """A base parameter goes by the name of the standard one that leads it."""
        return tuple(self.standard[i] for i in self.kept)

    def values(self, phi: np.ndarray) -> np.ndarray:
        """Base parameters of standard ones [11 n]."""
        return self.K @ phi

    def expressions(self, symbols: dict[str, float] | None = None) -> tuple[str, ...]:
        """The regrouping as text: `Izz3 + 0.3275 m4 + ...`; numbers that equal a product of
        `symbols` (lengths by name, m) are written with them, like `a4^2 (m4 + m5)`.
        """
        return tuple(self._expression(row, symbols or {}) for row in range(len(self.kept)))

    def _expression(self, row: int, symbols: dict[str, float]) -> str:
        groups: dict[
            tuple[bool, str], list[str]
        ] = {}  # members that share a factor stand in one bracket
        for j in np.flatnonzero(self.K[row]):
            if j != self.kept[row]:
                k = float(self.K[row, j])
                groups.setdefault((k < 0, _symbolic(abs(k), symbols)), []).append(self.standard[j])
        text = self.standard[self.kept[row]]
        for (negative, factor), members in groups.items():
            for part in [" + ".join(members)] if factor and len(members) > 1 else members:
                part = f"({part})" if factor and len(members) > 1 else part
                text += f" {'-' if negative else '+'} {factor}{' ' if factor else ''}{part}"
        return text


def _symbolic(k: float, symbols: dict[str, float]) -> str:
    """A factor as a product of two of the symbols, twice one, or a sum of two or three squares;
    else the number.
    """
    if abs(k - 1) < 1e-9:
        return ""
    lengths = [(name, abs(v)) for name, v in symbols.items() if abs(v) > 1e-9]
    options: list[tuple[float, str]] = []
    for i, (a, u) in enumerate(lengths):
        options += [(u, a), (2 * u, f"2 {a}"), (u * u, f"{a}^2")]
        for j, (b, v) in enumerate(lengths[i + 1 :], i + 1):
            options += [(u * v, f"{a} {b}"), (u * u + v * v, f"({a}^2 + {b}^2)")]
            options += [
                (u * u + v * v + w * w, f"({a}^2 + {b}^2 + {c}^2)") for c, w in lengths[j + 1 :]
            ]
    for value, text in options:
        if abs(value - k) < 1e-9 * max(1.0, k):
            return text
    return "2" if abs(k - 2) < 1e-9 else f"{k:.6g}"


def standard_values(arm: Any, names: Sequence[str]) -> np.ndarray:
    """What the model of an arm has of standard parameters such as `Ixx3`, [names]."""
    values = []
    for name in names:
        kind, joint = stem_and_number(name)
        values.append(float(np.asarray(getattr(arm, kind))[int(joint) - 1]))
    return np.array(values)


def standard_names(n: int) -> tuple[str, ...]:
    """Ixx1 ... m1 Ia1 Ixx2 ..., the order of every standard vector [11 n]."""
    return tuple(f"{name}{j}" for j, name in product(range(1, n + 1), STANDARD))


def torque_columns(arm: Any, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Torque per standard parameter [samples n 11 n] of measured motion [samples n], in NumPy.

    `arm` holds the geometry (a, alpha, d, theta, b, gamma), `prismatic`, `gravity`, `base_roll`,
    `base_pitch`.
    """
    n, count = q.shape[1], q.shape[0]
    E, fall, qd_rows, qdd_rows = _joint_rows(arm, q, qd, qdd)
    Y = np.zeros((count, n, n, len(STANDARD)))
    bodies = chain_of(arm.prismatic, batch=1)
    columns = regressor(E, bodies, still(fall), qd_rows, qdd_rows)
    Y[..., :10] = np.moveaxis(columns, 3, 0)
    Y[:, np.arange(n), np.arange(n), 10] = qdd
    return Y.reshape(count, n, -1)


def standard_torque(
    arm: Any, phi: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> np.ndarray:
    """Torque [samples n] of measured motion [samples n] at standard parameters [11 n]:
    `torque_columns` times them, at a small part of its cost.
    """
    E, fall, qd_rows, qdd_rows = _joint_rows(arm, q, qd, qdd)
    table = phi.reshape(-1, len(STANDARD))
    bodies = chain_of(arm.prismatic, batch=1, inertia=table[:, :10])
    tau = inverse_dynamics(E, bodies, still(fall), qd_rows, qdd_rows)
    return tau.T + table[:, 10] * qdd


def _joint_rows(
    arm: Any, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> tuple[Any, Any, np.ndarray, np.ndarray]:
    """Placements of the links, free fall, and rates [n samples]."""
    fall = free_fall(*(np.float64(getattr(arm, k)) for k in ("gravity", "base_roll", "base_pitch")))
    q, qd, qdd = (np.ascontiguousarray(x.T) for x in (q, qd, qdd))
    return placements(arm, arm.prismatic, q), fall, qd, qdd


def base_parameters(arm: Any, without: Sequence[str] = ()) -> BaseParameters:
    """Base parameters of a chain under random motion; `without` names standard parameters that are
    known to be zero (the drive inertia, where the torque is measured behind the gear).
    """
    n = len(arm.prismatic)
    rng = np.random.default_rng(0)
    count = 12 * n + 20
    q, qd, qdd = (rng.uniform(-k, k, (count, n)) for k in (3.0, 2.0, 5.0))
    W = torque_columns(arm, q, qd, qdd).reshape(count * n, -1)
    names = standard_names(n)
    preferred: list[int] = []
    for j, slides in enumerate(arm.prismatic):
        names_of_link = PRISMATIC if slides else REVOLUTE
        preferred += [j * 11 + STANDARD.index(name) for name in names_of_link]
    drives = [j * 11 + 10 for j in range(n)]
    rest = [i for i in range(11 * n) if i not in preferred and i not in drives]
    out = {i for i, name in enumerate(names) if name in without}
    kept = independent_columns(W, [i for i in (*preferred, *drives, *rest) if i not in out])
    K = np.linalg.lstsq(W[:, kept], W, rcond=None)[0]
    K[np.abs(K) < 1e-9] = 0.0
    K[:, kept] = np.eye(len(kept))
    K[:, sorted(out)] = 0.0
    return BaseParameters(names, tuple(kept), K)


def independent_columns(W: np.ndarray, order: Sequence[int], share: float = DEPENDENT) -> list[int]:
    """Which columns, taken in this order, are independent of those taken before (Gram-Schmidt,
    applied twice).
    """
    size = np.linalg.norm(W, axis=0)
    largest = float(size.max()) if size.size else 0.0
    basis = np.zeros((W.shape[0], 0))
    kept: list[int] = []
    for i in order:
        if size[i] <= 1e-12 * largest or len(kept) == W.shape[0]:
            continue
        v = W[:, i] / size[i]
        for _ in range(2):
            v = v - basis @ (basis.T @ v)
        rest = float(np.linalg.norm(v))
        if rest > share:
            basis = np.column_stack([basis, v / rest])
            kept.append(i)
    return kept
