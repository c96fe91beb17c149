"""The excitation of paper 001, equation (18): its objective, its constraints and the sums of its
coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxid.numerics.linalg import array_module


#: Weights of (18): all columns, inertia tensors, first moments, friction.
WEIGHTS_18 = (10.0, 5.0, 1.0, 1.0)


def sums_18(a: Any, b: Any, omega: float) -> dict[str, Any]:
    """The sums over the harmonics that paper 001 constrains, each [n]: three that are 0, and the
    bounds of position (about the middle), speed and acceleration.
    """
    xp = array_module(a)
    w = omega * np.arange(1, len(a) + 1)[:, None]
    size = xp.sqrt(a * a + b * b + (0.0 if xp is np else 1e-24))
    return {
        "-b/(w l)": -xp.sum(b / w, 0),
        "a": xp.sum(a, 0),
        "w l b": xp.sum(w * b, 0),
        "position": xp.sum(size / w, 0),
        "speed": xp.sum(size, 0),
        "acceleration": xp.sum(w * size, 0),
    }


def terms_18(G: Any, groups: tuple[tuple[int, ...], ...]) -> list[Any]:
    """Logarithms of the singular values, rising, of the columns of each term of (18), by the Gram
    matrix of all.
    """
    xp = array_module(G)
    out = []
    for own in groups:
        e = xp.linalg.eigvalsh(G[np.ix_(own, own)])
        out.append(0.5 * xp.log(xp.maximum(e, 1e-14 * e[-1])))
    return out


def column_groups(names: Sequence[str], base: int) -> tuple[tuple[int, ...], ...]:
    """Columns of the terms of paper 001's (18): all, inertia tensors (and drives), first moments
    (and masses), friction.
    """
    kinds = [n.rstrip("0123456789") for n in names]
    tensors = tuple(i for i in range(base) if kinds[i].startswith("I"))
    moments = tuple(i for i in range(base) if not kinds[i].startswith("I"))
    return tuple(range(len(names))), tensors, moments, tuple(range(base, len(names)))


def objective_18(
    W: np.ndarray, groups: tuple[tuple[int, ...], ...], fourier: Any
) -> dict[str, Any]:
    """(18) of weighted rows, its terms, and the sums of the coefficients that it constrains."""
    cond = [float(np.exp(v[-1] - v[0])) for v in terms_18(W.T @ W, groups)]
    sums = sums_18(np.asarray(fourier.a), np.asarray(fourier.b), fourier.omega)
    return {
        "objective": float(np.dot(WEIGHTS_18, cond)),
        "condition_numbers": dict(
            zip(("all", "inertia_tensors", "first_moments", "friction"), cond, strict=True)
        ),
        "sums": {k: v.tolist() for k, v in sums.items()},
    }
