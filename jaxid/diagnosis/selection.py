"""Which of several refitted hypotheses to believe: evidence of fit and validation runs, and the
choice among those alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from jaxid.base.wording import listed, times
from jaxid.diagnosis.evidence import inflation, memory, worth
from jaxid.diagnosis.hypothesis import Candidate, effect_of, family_of, Hypothesis, key_of
from jaxid.diagnosis.shortlist import is_timing
from jaxid.diagnosis.simulated import log_weight, told_apart
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.problem_builder import ProblemBuilder


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


def significant(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether the effects that `after` has beyond `before` are there: fit and validation runs
    together decide, by more where more is added (dozens of candidates are tried), and each of the
    two must agree.
    """
    held = worth(after.validation, before.validation, inflation(after.validation))
    if held <= 0:
        return False
    fitted = (before.fit_loss - after.fit_loss) * after.path.count / after.fit_inflation
    left = max(before.validation.loss - 1.0, 1e-12)
    share = (before.validation.loss - after.validation.loss) / left
    size, more = after.size - before.size, max(1, len(after.effects) - len(before.effects))
    silent = (
        before.fit_inflation < LIMITS.white
        and after.validation.loss < LIMITS.explained
        and fitted > -LIMITS.decisive
    )
    if silent and held > LIMITS.overwhelming * more:
        return True
    # Where the fit runs are at the noise, evidence is exact, and the best of dozens of candidates
    # reaches some by chance.
    chance = LIMITS.decisive if after.fit_inflation < LIMITS.white else 0.0
    enough = fitted > chance + 2 * size and fitted + held > 3 * more * LIMITS.decisive + 2 * size
    return share > LIMITS.gain and enough


def best(
    bench: ProblemBuilder, before: Hypothesis, found: Sequence[Hypothesis]
) -> Hypothesis | None:
    """The choice among refits: best on validation data; of those that it does not beat decisively,
    the one with the fewest parameters, timing before physics, then the best evidence on fit and
    validation data together.
    """
    near = equals(bench, before, found)
    fewest = min((h.size for h in near), default=0)

    def physics(h):
        return not is_timing(bench, h.effects[-1])

    return min(
        (h for h in near if h.size == fewest),
        key=lambda h: (physics(h), joint_loss(h)),
        default=None,
    )


def equals(
    bench: ProblemBuilder, before: Hypothesis, found: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """Those of the refits that say more than `before` and that the best of them does not beat
    decisively.
    """
    # A run that diverges says nothing, and has no place in an order.
    found = [h for h in found if np.isfinite(joint_loss(h))]

    # dear, so that it is asked last
    def good(h):
        return significant(before, h)

    def both(h):
        return h.path.count * np.log(h.fit_loss) + h.validation.count * np.log(h.validation.loss)

    top = next(filter(good, sorted(found, key=lambda h: h.validation.loss)), None)
    if top is None:
        return []
    rival = next(filter(good, sorted(found, key=both)))
    if rival.fit_loss < LIMITS.conflict * top.fit_loss:
        top = rival
        found = [h for h in found if LIMITS.conflict * h.fit_loss < top.fit_loss]
    factor = inflation(top.validation)
    near = [
        h
        for h in found
        if worth(top.validation, h.validation, factor) < LIMITS.decisive
        or simpler(bench, before, h, top)
    ]
    return [h for h in near if good(h)]


def simpler(bench: ProblemBuilder, before: Hypothesis, h: Hypothesis, top: Hypothesis) -> bool:
    """Whether `h` has fewer numbers and leaves next to nothing more than `top`: a part of its
    effects, or others that explain all but a hundredth of what it does; or a law in the same place,
    of the same kind or where the larger law ended at a bound (as another one's limit).
    """
    if h.size >= top.size or h.validation.loss >= LIMITS.alike * max(1.0, top.validation.loss):
        return False
    if joint_loss(h) < LIMITS.alike * max(1.0, joint_loss(top)):

        def explained(x):
            return joint_loss(before) - joint_loss(x)

        if set(h.effects) < set(top.effects) or explained(h) > LIMITS.as_good * explained(top):
            return True

    def place(h):
        return (h.effects[-1].location, h.effects[:-1])

    def kind(h):
        return family_of(bench, h.effects[-1])

    p = top.path.problem
    own = np.flatnonzero(np.isin(p.free, top.effects[-1].index))
    at_bound = np.any((top.path.z[own] <= p.lower[own]) | (top.path.z[own] >= p.upper[own]))
    return bool(place(h) == place(top) and (kind(h) == kind(top) or at_bound))


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
    inputs, outputs = ([name for name, _ in side] for side in (signature.inputs, signature.outputs))
    named: dict[str, list[str]] = {}
    for c in chosen.effects:
        if effect_of(bench, c).mirrors:
            named.setdefault(effect_of(bench, c).mirrors, []).append(c.location)
    whole = {
        kind
        for kind, at in named.items()
        if len(at) == len(outputs if set(at) <= set(outputs) else inputs)
    }
    alike = [c for c in pool if c.effect in whole and c not in chosen.effects]
    return [c for c in alike if len(inputs if c.location in inputs else outputs) == 1]


def mirror_images(
    bench: ProblemBuilder, chosen: Hypothesis, alike: Sequence[Candidate]
) -> list[Hypothesis]:
    """The chosen hypothesis with an effect in exchange for one that says the same of any recording:
    it leaves as much.
    """
    out = []
    for c in chosen.effects:
        mirror = effect_of(bench, c).mirrors
        for e in alike:
            if mirror and e.effect == mirror and e not in chosen.effects:
                effects = tuple(e if own is c else own for own in chosen.effects)
                out.append(replace(chosen, effects=effects))
    return out


def next_to_form(nominal: Hypothesis, h: Hypothesis, without: Hypothesis) -> bool:
    """Whether an effect beside others, next to the noise, explains so little that the exact form of
    the others' laws is not known as well.
    """
    gained = joint_loss(without) - joint_loss(h)
    explained = joint_loss(nominal) - joint_loss(h)
    return joint_loss(without) < LIMITS.close_above and gained < LIMITS.form * explained


def needed(nominal: Hypothesis, h: Hypothesis, without: Hypothesis) -> bool:
    """Whether what `h` has beyond a smaller set is there, and worth its price."""
    if not significant(without, h) or next_to_form(nominal, h, without):
        return False
    return log_weight(h) > log_weight(without)


def at_floor(h: Hypothesis) -> bool:
    """Nothing is left to explain: the noise, and white."""

    def level(count):
        return 1 + 4 * np.sqrt(2 / max(1, count))

    low = h.fit_loss <= level(h.path.count) and h.validation.loss <= level(h.validation.count)
    return bool(
        low and max(memory(h.validation.settled), memory(h.path.problem.residuals(h.path.z))) <= 2
    )


def finished(h: Hypothesis) -> bool:
    """Nothing more is to be found. Something small is looked for beside other effects only."""
    return max(h.validation.loss, h.fit_loss) < LIMITS.at_floor if h.effects else at_floor(h)


def close_to_noise(h: Hypothesis) -> bool:
    """White and close above the noise: a stated noise may be a little low, or something small is
    left.
    """
    white = h.fit_inflation < 1.5 * max(1.0, h.fit_loss) and memory(h.validation.settled) <= 2
    return max(h.validation.loss, h.fit_loss) < LIMITS.close_above and white


def rivals_among(
    known: Sequence[Hypothesis], chosen: Hypothesis, mates: Sequence[Hypothesis]
) -> tuple[Hypothesis, Hypothesis] | None:
    """The two hypotheses between which further data should decide: the chosen one (else the best)
    and what the data cannot tell from it (else the best of those known that are not the first with
    more or less in it).
    """

    def nested(a, b):
        return key_of(a.effects) <= key_of(b.effects) or key_of(a.effects) >= key_of(b.effects)

    ranked = sorted((h for h in known if h.effects and np.isfinite(h.fit_loss)), key=joint_loss)
    first = chosen if chosen.effects else next(iter(ranked), None)
    if first is None or (not chosen.effects and at_floor(chosen)):
        return None
    others = [h for h in mates or ranked if not nested(h, first)]
    return (first, min(others, key=joint_loss)) if others else None
