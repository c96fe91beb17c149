"""What to refit next: sets of effects made of the hypotheses at hand, each with its starts (full
parameter vectors).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from jaxid.diagnosis.hypothesis import (
    Candidate,
    effect_of,
    family_of,
    Hypothesis,
    probes_of,
    sensible,
)
from jaxid.diagnosis.screen import each_probe, Screened
from jaxid.fitting.least_squares import levenberg_marquardt, Path
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import InverseDynamics


#: Pairs are made of this many of the best single effects.
PAIRED = 4
#: This many of those that an accepted effect was not clearly better than are tried in its place
#: later on.
RIVALS = 3
#: Starts of each refit that come from the screen: two of the best to first order, and the best of
#: all probes as they simulate.
STARTS = 4
#: This many of the starts also with the numbers of the model as the user gave them.
GIVEN = 1

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
        own = [
            *starts[:1],
            *best.get(str(c), []),
            *starts[1:],
            *as_given(bench, (*h.effects, c), starts),
        ]
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


def exchanged(
    bench: ProblemBuilder,
    found: Sequence[Hypothesis],
    passed_over: Mapping[Candidate, Sequence[Hypothesis]],
) -> list[Proposal]:
    """Each hypothesis with another effect in the place of one that was there before its last: with
    that beside it, what could not be told from the accepted effect (`passed_over`, for each of
    these) may be far better.
    """
    sets: list[Proposal] = []
    for h, (old, rivals) in itertools.product(found, passed_over.items()):
        for rival in rivals:
            new = rival.effects[-1]
            if old not in h.effects[:-1] or new in h.effects:
                continue
            at = h.effects.index(old)
            earlier, later = h.effects[:at], h.effects[at + 1 :]
            effects = (*earlier, new, *later)
            if not sensible(effects):
                continue
            without, beside = h.theta.copy(), rival.theta.copy()
            without[list(old.index)] = bench.binding.theta[list(old.index)]
            for c in later:
                beside[list(c.index)] = h.theta[list(c.index)]
            own = without.copy()
            own[list(new.index)] = rival.theta[list(new.index)]
            sets.append((effects, [beside, own, *probes_of(bench, new, without)[:2]]))
    return sets


def plain_pairs(
    bench: ProblemBuilder, c: Candidate, pool: Sequence[Candidate], theta: np.ndarray
) -> list[Proposal]:
    """Two laws of one number each in the place of one of the same kind with several: dry friction
    and drag, each alone of no use beside a viscous term that stands in for both, look like friction
    that remembers. `theta` is the nominal model's.
    """
    if len(c.index) < 2:
        return []
    own = family_of(bench, c)
    plain = [
        e
        for e in pool
        if e.location == c.location and len(e.index) == 1 and family_of(bench, e) == own
    ]
    sets: list[Proposal] = []
    for a, b in itertools.combinations(plain, 2):
        if sensible((a, b)):
            starts: list[np.ndarray] = []
            for start in probes_of(bench, a, theta):
                starts += probes_of(bench, b, start)
            sets.append(((a, b), starts))
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


def torque_starts(
    bench: ProblemBuilder, base_free: Sequence[int], sets: Sequence[Proposal], tells: bool
) -> list[tuple[float, list[np.ndarray]]]:
    """A start of each set from the torque residual of the measured motion, and its cost: biased by
    the noise of derivatives, but free of the free run's local minima (where a nominal term stands
    in for two missing ones, a descent stays). No cost where an effect is on the way of the command:
    a drive that delivers nothing leaves no torque unexplained. `tells`: whether there is such a
    residual.
    """
    if not tells:
        return [(np.inf, []) for _ in sets]
    jobs: list[tuple[FitProblem, np.ndarray]] = []
    counts = []
    for effects, thetas in sets:
        index = list(itertools.chain.from_iterable(c.index for c in effects))
        p = bench.problem(InverseDynamics(decimate=1), "fit", [*base_free, *index], thetas[0])
        differing = {tuple(theta[index]): theta for theta in reversed(thetas)}
        starts = list(differing.values())[-2:]
        jobs += [(p, p.z(theta)) for theta in starts]
        counts.append(len(starts))
    paths = iter(levenberg_marquardt(jobs, 6, 1e-3))
    out: list[tuple[float, list[np.ndarray]]] = []
    for (effects, _), count in zip(sets, counts, strict=True):
        best = min(itertools.islice(paths, count), key=lambda path: path.cost)
        comparable = all(effect_of(bench, c).location == "joint" for c in effects)
        found = [best.problem.theta(best.z)] if np.isfinite(best.cost) else []
        out.append((best.cost if comparable else np.inf, found))
    return out


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


def as_given(
    bench: ProblemBuilder, effects: Sequence[Candidate], starts: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """The first few starts with the model's own numbers as the user gave them: re-tuning has bent
    those to stand in for what is missing, and the way back may be long.
    """
    out = []
    for start in starts[:GIVEN]:
        theta = bench.binding.theta.copy()
        for c in effects:
            theta[list(c.index)] = start[list(c.index)]
        out.append(theta)
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
