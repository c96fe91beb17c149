"""Where a search goes on from, which hypotheses the data do not tell apart, and when nothing is
left to explain.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from jaxid.base.wording import listed, times
from jaxid.diagnosis.evidence import level, memory
from jaxid.diagnosis.hypothesis import Candidate, effect_of, Hypothesis, key_of
from jaxid.diagnosis.simulated import log_weight, SIMULATED, told_apart
from jaxid.fitting.problem_builder import ProblemBuilder


#: The evidence of the data and the price of numbers alone.
FLAT = replace(SIMULATED, log_prior=0.0)


def joint_loss(h: Hypothesis) -> float:
    """Mean square over fit and validation samples together."""
    total = h.fit_loss * h.path.count + h.validation.loss * h.validation.count
    return total / (h.path.count + h.validation.count)


def in_lead(known: Iterable[Hypothesis]) -> str:
    """What explains most by now, and what it leaves, as a line of progress says it; nothing before
    anything was refitted.
    """
    lead = min((h for h in known if h.effects), key=joint_loss, default=None)
    if lead is None:
        return ""
    return (
        f"so far {listed(map(str, lead.effects))}: {times(np.sqrt(joint_loss(lead)))} times the"
        " noise left"
    )


def leads_on(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether the data speak for what `after` has beyond `before`. What an effect has beforehand
    counts for what is claimed in the end, not for where the search goes on from.
    """
    return log_weight(after, FLAT) > log_weight(before, FLAT)


def most_probable(found: Iterable[Hypothesis]) -> Hypothesis | None:
    """None of none. A run that diverges says nothing, and has no place in an order."""
    measured = [h for h in found if np.isfinite(joint_loss(h))]
    return max(measured, key=log_weight, default=None)


def step_from(before: Hypothesis, found: Iterable[Hypothesis]) -> Hypothesis | None:
    """The most probable of the refits, where the data speak for it."""
    step = most_probable(found)
    return step if step is not None and leads_on(before, step) else None


def indistinct(chosen: Hypothesis, h: Hypothesis) -> bool:
    """Whether the data do not tell `h` from the chosen hypothesis. One whose losses are no numbers
    is told from nothing, and passes for nothing.
    """
    if not np.isfinite(joint_loss(h)):
        return False
    return not np.isfinite(joint_loss(chosen)) or not told_apart(chosen, h)


def mirrored(
    bench: ProblemBuilder, chosen: Hypothesis, pool: Sequence[Candidate]
) -> list[Candidate]:
    """Effects at the other end of the plant that say the same of any recording (`Effect.mirrors`),
    however their fits ended: a search of one may stop where that of the other goes on. All readings
    that are late say what one input that is late says.
    """
    signature = bench.binding.chain.signature
    inputs, outputs = dict(signature.inputs), dict(signature.outputs)
    named: dict[str, list[str]] = {}
    for c in chosen.effects:
        mirror = effect_of(bench, c).mirrors
        if mirror:
            named.setdefault(mirror, []).append(c.location)
    whole = set()
    for kind, at in named.items():
        side = outputs if outputs.keys() >= set(at) else inputs
        if len(at) == len(side):
            whole.add(kind)
    out = []
    for c in pool:
        side = inputs if c.location in inputs else outputs
        if len(side) == 1 and c.effect in whole and c not in chosen.effects:
            out.append(c)
    return out


def mirror_images(
    bench: ProblemBuilder, chosen: Hypothesis, alike: Sequence[Candidate]
) -> list[Hypothesis]:
    """The chosen hypothesis with an effect in exchange for one that says the same of any recording:
    it leaves as much.
    """
    out = []
    for k, c in enumerate(chosen.effects):
        mirror = effect_of(bench, c).mirrors
        for e in alike:
            if e.effect == mirror and e not in chosen.effects:
                effects = (*chosen.effects[:k], e, *chosen.effects[k + 1 :])
                out.append(replace(chosen, effects=effects))
    return out


def at_floor(h: Hypothesis) -> bool:
    """Nothing is left to explain: the noise, and white."""
    low = h.fit_loss <= level(h.path.count) and h.validation.loss <= level(h.validation.count)
    return bool(low and max(memory(h.validation.settled), memory(h.residuals)) <= 2)


def rivals_among(
    known: Sequence[Hypothesis], chosen: Hypothesis, mates: Sequence[Hypothesis]
) -> tuple[Hypothesis, Hypothesis] | None:
    """The two hypotheses between which further data should decide: the chosen one (else the best)
    and what the data cannot tell from it (else the best of those known that are not the first with
    more or less in it).
    """

    ranked = sorted((h for h in known if h.effects and np.isfinite(h.fit_loss)), key=joint_loss)
    first = chosen
    if not chosen.effects:
        if not ranked or at_floor(chosen):
            return None
        first = ranked[0]
    own = key_of(first.effects)
    others = []
    for h in mates or ranked:
        key = key_of(h.effects)
        if not (key <= own or key >= own):
            others.append(h)
    return (first, min(others, key=joint_loss)) if others else None
