"""What to refit next: sets of effects made of the hypotheses at hand, each with its starts (full
parameter vectors).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from jaxid.diagnosis.hypothesis import (
    Candidate,
    Hypothesis,
    probes_of,
    sensible,
)
from jaxid.diagnosis.screen import each_probe, Screened
from jaxid.fitting.least_squares import Path
from jaxid.fitting.problem_builder import ProblemBuilder


#: Pairs are made of this many of the best single effects.
PAIRED = 4
#: Starts of each refit that come from the screen: two of the best to first order, and the best of
#: all probes as they simulate.
STARTS = 4

Proposal = tuple[tuple[Candidate, ...], Sequence[np.ndarray]]


def beside(
    bench: ProblemBuilder,
    h: Hypothesis,
    kept: Sequence[Screened],
    by_torque: Sequence[Screened],
    base: Mapping[str, Sequence[Candidate]],
) -> list[Proposal]:
    """Candidates as screened beside a hypothesis, each with what it refines (`base`). Second of its
    starts comes the torque's answer to which probe is right.
    """
    best = {str(c): starts[:1] for _, c, starts in by_torque}
    sets: list[Proposal] = []
    for _, c, starts in kept:
        own = [*starts[:1], *best.get(str(c), []), *starts[1:]]
        sets.append(((*h.effects, *base[str(c)], c), with_refined(bench, base[str(c)], own)))
    return sets


def pairs(bench: ProblemBuilder, found: Sequence[Hypothesis]) -> list[Proposal]:
    """Two effects at once, where one alone brings nothing (a nominal term may stand in for
    both).
    """
    singles = sorted(found, key=lambda h: h.fit_loss)[:PAIRED]
    sets: list[Proposal] = []
    for a, second in enumerate(singles):
        new = second.effects[-1]
        for first in singles[:a]:
            effects = (*first.effects, new)
            if new not in first.effects and sensible(effects):
                theta = first.theta.copy()
                theta[list(new.index)] = second.theta[list(new.index)]
                sets.append((effects, [theta, *probes_of(bench, new, first.theta)[:2]]))
    return sets


def left_out(bench: ProblemBuilder, h: Hypothesis, c: Candidate) -> Proposal:
    """A hypothesis less one of its effects, the others where they end to first order without it,
    and as they are: of numbers that hang together tightly none can go alone without leaving the
    valley.
    """
    theta, index = h.theta.copy(), list(c.index)
    theta[index] = bench.binding.theta[index]
    return tuple(e for e in h.effects if e is not c), [*_retuned(h.path, theta, index), theta]


def _retuned(path: Path, theta: np.ndarray, index: Sequence[int]) -> list[np.ndarray]:
    """The numbers at the end of a path with those at `index` as in theta, all others moved as its
    curvature says.
    """
    p, H = path.problem, path.hessian
    if H is None or not np.all(np.isfinite(H)):
        return []
    gone = np.zeros(p.size, bool)
    gone[: p.free.size] = np.isin(p.free, index)
    z = np.where(gone, p.z(theta, p.starts(path.z)), path.z)
    curvature, way = p.scale[:, None] * H * p.scale, (path.z - z) / p.scale
    move = (
        np.linalg.pinv(curvature[np.ix_(~gone, ~gone)], 1e-14, True)
        @ curvature[np.ix_(~gone, gone)]
        @ way[gone]
    )
    z[~gone] += p.scale[~gone] * move
    return [p.theta(np.clip(z, p.lower, p.upper))]


def promising(
    nominal: Path, sets: Sequence[Proposal]
) -> list[tuple[tuple[Candidate, ...], list[np.ndarray]]]:
    """The first two starts of each set, and those of the others that simulate best: first order
    says little where a resonance or a play has to be found.
    """
    thetas = list(itertools.chain.from_iterable(starts for _, starts in sets))
    found = iter(each_probe(nominal.problem, nominal.z, thetas))
    out = []
    for effects, starts in sets:
        with np.errstate(over="ignore"):  # a start that diverges
            cost = [float(r @ r) for r in itertools.islice(found, len(starts))]
        best = np.argsort(np.nan_to_num(cost, nan=np.inf), kind="stable").tolist()
        first = list(range(len(starts)))[:2]
        chosen = dict.fromkeys([*first, *best])
        out.append((effects, [starts[k] for k in chosen][:STARTS]))
    return out


def with_refined(
    bench: ProblemBuilder, base: Sequence[Candidate], starts: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Starts, and the first of them with each probe of the effects that are refined, which are off
    in them.
    """
    out = list(starts)
    for start, c in itertools.product(starts[:2], base):
        out += probes_of(bench, c, start)
    return out
