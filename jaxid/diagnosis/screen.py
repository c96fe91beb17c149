"""The screen: what each candidate could explain of a residual, from one simulation of each of its
probes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from jaxid.diagnosis.hypothesis import Candidate, Hypothesis, probes_of_all, read_off_of
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.problem import FitProblem, ResidualRows, rows
from jaxid.problem.residual import InverseDynamics


#: (share explained, candidate, starts of a refit: each probe re-tuned and as it is, best first)
Screened = tuple[float, Candidate, list[np.ndarray]]


#: This many probes of long records are simulated side by side.
FEW = 16


def screened(
    bench: ProblemBuilder,
    p: FitProblem,
    z: np.ndarray,
    theta0: np.ndarray,
    pool: Sequence[Candidate],
) -> list[Screened]:
    """Share of the sum of squares at z that each candidate explains, to first order in everything
    but itself.

    Each finite probe is simulated, what re-tuning could do is projected out, and the probe is
    scaled within [0, 4] (or [-4, 4] where its parameters may have either sign). Best first.
    """
    parts = list(rows([(p, z)]))
    retuning = Retuning(parts, p.size)
    remaining = retuning.remaining
    before = np.concatenate([part.r.ravel() for part in parts])
    total = float(before @ before)
    r0 = remaining(before)
    shapes, lower = bench.binding.layout.shapes, bench.binding.lower
    owners, thetas = probes_of_all(bench, pool, theta0)
    residuals = each_probe(p, z, thetas, once=True)
    best: dict[str, list[tuple[float, np.ndarray, np.ndarray]]] = {}
    who: dict[str, Candidate] = {}
    for c, theta, r in zip(owners, thetas, residuals, strict=True):
        change = r - before
        if not np.all(np.abs(change) < 1e100):  # the probe diverged
            continue
        d = remaining(change)
        power = float(d @ d)
        if power <= 1e-12 * max(total, 1.0) * 1e-6 or power < 1e-6:
            continue  # the data do not react to this effect
        index = np.array(c.index, int)
        is_shape = shapes[index]
        either_sign = np.all(lower[index][~is_shape] < 0)
        scale = float(np.clip(-(r0 @ d) / power, -4.0 if either_sign else 0.0, 4.0))
        gain = float(-2 * scale * (r0 @ d) - scale**2 * power)
        strength = max(scale, 0.05) if scale >= 0 else min(scale, -0.05)
        start = theta0 + strength * (theta - theta0)
        start[index[is_shape]] = theta[index[is_shape]]
        tuned = start.copy()  # and with what re-tuning then does to the other numbers
        moved = z + np.clip(
            retuning.step(before + strength * change),
            -0.2 * (p.upper - p.lower),
            0.2 * (p.upper - p.lower),
        )
        tuned[p.free] = p.theta(np.clip(moved, p.lower, p.upper))[p.free]
        best.setdefault(str(c), []).append((gain / max(total, 1e-300), tuned, start))
        who[str(c)] = c
    ranked = []
    for name, found in best.items():
        found.sort(key=lambda f: -f[0])
        starts: list[np.ndarray] = []
        for _, tuned, start in found:
            starts += [tuned, start]
        ranked.append((found[0][0], who[name], starts))
    return sorted(ranked, key=lambda f: -f[0])


def torque_tells(bench: ProblemBuilder) -> bool:
    """Whether the torque of the measured motion says something."""
    return bool(bench.binding.motions) and not bench.binding.chain.mechanism.hidden_states


def torque_screened(
    bench: ProblemBuilder, h: Hypothesis, pool: Sequence[Candidate]
) -> list[Screened]:
    """What each candidate explains beside `h` of the torque that the measured motion lacks. It is
    blind to what has no place in an inverse (play, springs, sensors) and biased by the noise of
    derivatives, but it does not depend on how far the free run has gone astray.
    """
    if not torque_tells(bench):
        return []
    p = bench.problem(InverseDynamics(decimate=1), "fit", h.path.problem.free, h.theta)
    path = levenberg_marquardt([(p, p.z(h.theta))], 12, 1e-6)[0]
    if not np.isfinite(path.cost):
        return []
    found = screened(bench, p, path.z, p.theta(path.z), pool)
    return [(share, c, [*read_off_of(bench, p, path.z, c), *starts]) for share, c, starts in found]


class Retuning:
    """What re-tuning the free numbers can do to a residual vector, to first order."""

    def __init__(self, parts: Sequence[ResidualRows], size: int):
        J = np.zeros((sum(part.r.size for part in parts), size))
        k = 0
        for part in parts:
            J[k : k + part.r.size, part.z_columns] = part.J.reshape(
                part.r.size, len(part.z_columns)
            )
            k += part.r.size
        norm = np.linalg.norm(J, axis=0)
        self._kept = np.flatnonzero(norm > 0)
        self._norm, self._size = norm[self._kept], size
        Q, s, Vt = np.linalg.svd(J[:, self._kept] / self._norm, full_matrices=False)
        good = s > 1e-9 * s[0] if s.size else np.zeros(0, bool)
        self._Q, self._inverse = Q[:, good], (Vt[good] / s[good, None]).T

    def remaining(self, r: np.ndarray) -> np.ndarray:
        """What it cannot take out."""
        return r - self._Q @ (self._Q.T @ r)

    def step(self, r: np.ndarray) -> np.ndarray:
        """The change of z that takes out the rest."""
        out = np.zeros(self._size)
        out[self._kept] = -(self._inverse @ (self._Q.T @ r)) / self._norm
        return out


def probe_residuals(
    p: FitProblem, z: np.ndarray | Sequence[np.ndarray], thetas: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Weighted residual vectors at the samples for full parameter vectors, from the starts of z
    (one, or one for each).
    """
    return list(each_probe(p, z, thetas))


def each_probe(
    p: FitProblem,
    z: np.ndarray | Sequence[np.ndarray],
    thetas: Sequence[np.ndarray],
    once: bool = False,
) -> Iterator[np.ndarray]:
    """`probe_residuals` one after the other; of long records a few are simulated at a time. `once`:
    they are not refitted.
    """
    some = FEW if p.runs.engine.long else max(1, len(thetas))
    for first in range(0, len(thetas), some):
        own = slice(first, first + some)
        yield from _probes(p, z if isinstance(z, np.ndarray) else z[own], thetas[own], once)


def _probes(
    p: FitProblem, z: np.ndarray | Sequence[np.ndarray], thetas: Sequence[np.ndarray], once: bool
) -> Iterator[np.ndarray]:
    runs, n = p.runs, len(p.records)
    record = np.tile(np.array(p.records), len(thetas))
    if isinstance(z, np.ndarray):
        starts = np.tile(p.starts(z), (len(thetas), 1))
    else:
        starts = np.concatenate([p.starts(x) for x in z])
    y = runs.engine.outputs(np.repeat(np.array(thetas), n, 0), starts, record, once=once)
    for k in range(0, len(record), n):
        each = []
        for number, own in zip(record[k : k + n], y[k : k + n], strict=True):
            at = runs.record(number).samples
            with np.errstate(over="ignore", invalid="ignore"):  # a probe that diverges
                each.append(
                    (p.weights[at] * (runs.sample_prediction(number, own) - p.targets[at])).ravel()
                )
        yield np.concatenate(each)
