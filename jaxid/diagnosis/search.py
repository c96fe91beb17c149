"""Which effect is missing: screen all candidates from one fit, refit, choose on held-out runs,
abstain when nothing fits.

The screen must rank and the refit must decide: signatures of physically different effects are often
nearly parallel after re-tuning, and some effects have no derivative at their neutral value.
Information criteria alone prefer the richer neighbour of the true effect; runs that were not fitted
do not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from jaxid.base.deadline import search_is_over
from jaxid.diagnosis.hypothesis import (
    Candidate,
    Hypothesis,
    key_of,
    refined_by,
    SearchResult,
    sensible,
    without_each,
)
from jaxid.diagnosis.proposals import beside, left_out, pairs
from jaxid.diagnosis.refits import Refits
from jaxid.diagnosis.screen import Screened, screened, torque_screened
from jaxid.diagnosis.selection import (
    at_floor,
    in_lead,
    indistinct,
    mirror_images,
    mirrored,
    most_probable,
    rivals_among,
    step_from,
)
from jaxid.diagnosis.shortlist import shortlist
from jaxid.diagnosis.simulated import (
    believed,
    claimed,
    log_weight,
    simulated_sets,
    SimulatedSets,
)
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.fitter import Progress


#: After the single effects nothing more is asked once this many steps were simulated (a minute on
#: two cores), and the fit runs so often: what few effects explain is found before; what none of the
#: library explains could be searched for an hour.
MOST_STEPS, MOST_RUNS = 150_000_000, 40_000
#: Rounds of a search, as a line of progress counts them.
ROUNDS = 3


class Searcher:
    """Forward selection with re-evaluation.

    `tried`: hypotheses on the way to what is chosen.
    """

    def __init__(self, fits: Refits, progress: Progress | None = None):
        self.fits, self.progress = fits, progress
        self.tried: list[Hypothesis] = []
        self._cut_short = False

    def run(
        self,
        pool: Sequence[Candidate],
        max_effects: int,
        known: Callable[[SearchResult], None] = lambda search: None,
    ) -> SearchResult:
        """Forward selection up to `max_effects`, then each accepted effect is questioned again;
        `known` is told after each round.
        """
        fits = self.fits
        chosen = self._questioned(self._selected(pool, max_effects, known))
        mates = self._alternatives(chosen, pool)
        top = most_probable([chosen, *mates.values()])
        if top is not None and top is not chosen:
            chosen = self._questioned(top)
            mates = self._alternatives(chosen, pool)
        chosen = fits.taught(fits.put_back(fits.settled(chosen)))
        fits.nominal = fits.taught(fits.nominal) if chosen.effects else chosen
        if at_floor(fits.nominal):  # freed of a local minimum on the way
            chosen, mates = fits.nominal, {}
        alike = list(dict.fromkeys((*mates, *mirrored(fits.bench, chosen, pool))))
        chosen, claims, sets = claimed(chosen, fits.nominal, alike, self._fitted, self._smaller)
        if not chosen.effects:
            mates, alike = {}, []
        rivals = None
        if mates or not alike:  # of a mirrored effect alone no input tells what no recording can
            rivals = rivals_among(list(fits.known.values()), chosen, list(mates.values()))
        return SearchResult(
            nominal=fits.nominal,
            chosen=chosen,
            tried=self.tried,
            confusable=alike,
            rivals=rivals,
            several=len(chosen.effects) > 1,
            without=without_each(chosen, fits.earlier | fits.known),
            cut_short=self._cut_short,
            belief=believed(sets, claims, chosen),
        )

    # ---- forward

    def _selected(
        self,
        pool: Sequence[Candidate],
        max_effects: int,
        known: Callable[[SearchResult], None],
    ) -> Hypothesis:
        """One effect after the other, as long as the data speak for more."""
        fits = self.fits
        chosen = fits.refined(fits.nominal)
        while len(chosen.effects) < max_effects and not at_floor(chosen) and self._goes_on():
            room = max_effects - len(chosen.effects)
            found = self._extend(chosen, [c for c in pool if c not in chosen.effects], room)
            self.tried += found
            step = self._step(chosen, found, pool, room)
            if step is None:
                break
            chosen = fits.refined(step)
            known(SearchResult(fits.nominal, chosen, list(self.tried)))
        return chosen

    def _goes_on(self) -> bool:
        """Whether more may be asked after the first effects; that it may not is said in the end."""
        spent = sum(bench.simulated() for bench in self.fits.benches)
        once = self.fits.nominal.path.problem.work
        too_many = spent > max(MOST_STEPS, MOST_RUNS * once)
        self._cut_short |= bool(self.tried) and (too_many or search_is_over())
        return not self._cut_short

    def _step(
        self,
        chosen: Hypothesis,
        found: Sequence[Hypothesis],
        pool: Sequence[Candidate],
        room: int,
    ) -> Hypothesis | None:
        """The most probable of what was found, else of two effects at once; None where the data
        speak for neither.
        """
        step = step_from(chosen, found)
        if step is not None or room < 2 or not self._goes_on():
            return step
        step = step_from(chosen, self._as_pairs(chosen, found, pool, room))
        if step is not None:
            self.tried.append(step)
        return step

    def _extend(self, h: Hypothesis, rest: Sequence[Candidate], room: int = 1) -> list[Hypothesis]:
        """Refits of `h` with one more effect each, for all that the screen lets pass; one that
        refines another which is missing comes with that one, where there is room for two.
        """
        bench = self.fits.bench
        base: dict[str, list[Candidate]] = {}
        asked = []
        for c in rest:
            alone = sensible((*h.effects, c))
            needed = [] if alone else refined_by(c, rest)
            base[str(c)] = needed
            if sensible((*h.effects, *needed, c)) and len(needed) < room:
                asked.append(c)
        ranked = self._screened(h, asked)
        # A free run that has gone far astray says little to first order: what the torque screen
        # puts first is tried as well.
        by_torque = []
        if asked:
            by_torque = torque_screened(bench, h, [c for _, c, _ in ranked] or asked)
        if not ranked and not by_torque:
            return []
        self._say("screen", h, f"{len(ranked or by_torque)} candidates react to the data")

        def refining(c: Candidate) -> bool:
            return bool(base[str(c)])

        kept = shortlist(bench, ranked, by_torque, refining, not h.effects)
        self._say("refit", h, f"{len(kept)} candidates")
        return self.fits.refit(beside(bench, h, kept, by_torque, base))

    def _screened(self, h: Hypothesis, pool: Sequence[Candidate]) -> list[Screened]:
        """What each candidate explains beside `h` of the residual."""
        if not pool:
            return []
        return screened(self.fits.bench, h.path.problem, h.path.z, h.theta, pool)

    def _say(self, stage: str, h: Hypothesis, detail: str) -> None:
        if not self.progress:
            return
        lead = in_lead(self.fits.known.values())
        told = f"{detail}; {lead}" if lead else detail
        self.progress(stage, len(h.effects), ROUNDS, told)

    def _as_pairs(
        self, h: Hypothesis, found: Sequence[Hypothesis], pool: Sequence[Candidate], room: int
    ) -> list[Hypothesis]:
        """Two effects at once: pairs of those found, and anything beside the one that explains far
        more of the fit runs than `h` does, whatever it makes of validation runs without what else
        is missing; at most `room` more than `h` has.
        """
        most = len(h.effects) + room
        sets = pairs(self.fits.bench, found)
        out = self.fits.refit([(both, starts) for both, starts in sets if len(both) <= most])
        lead = min(found, key=lambda f: f.fit_loss, default=h)
        if lead.fit_loss < LIMITS.half * h.fit_loss and len(lead.effects) < most:
            out += self._extend(lead, [c for c in pool if c not in lead.effects])
        return out

    # ---- back

    def _questioned(self, h: Hypothesis) -> Hypothesis:
        """Takes out effects that are not worth their price beside the others, what one refines as
        well where there is none of it; the smaller set gets every chance, from where the larger one
        ended: an effect may have led out of a local minimum, and be of no other use.
        """
        while h.effects:
            smaller = self.fits.refit([left_out(self.fits.bench, h, c) for c in h.effects], h)
            self.fits.nominal = self.fits.known[frozenset()]
            needless = [s for s in smaller if log_weight(s) >= log_weight(h)]
            if not needless:
                return h
            h = max(needless, key=log_weight)
        return h

    def _alternatives(
        self, chosen: Hypothesis, pool: Sequence[Candidate]
    ) -> dict[Candidate, Hypothesis]:
        """What the data cannot tell from the named effects: other effects in the place of each, the
        others kept.
        """
        fits, out = self.fits, {}
        new = [e for e in pool if e not in chosen.effects]
        for c in chosen.effects:
            others = tuple(e for e in chosen.effects if e is not c)
            done = fits.known.keys() | fits.earlier.keys()
            missing = [e for e in new if key_of((*others, e)) not in done]
            rest = fits.known.get(key_of(others))
            if missing and others and rest is not None and self._goes_on():
                self._extend(rest, missing)
            fits.renew([key_of((*others, e)) for e in new], key_of(chosen.effects))
            for e in new:
                h = fits.known.get(key_of((*others, e)))
                if h is None or e in out or not sensible((*others, e)):
                    continue
                if indistinct(chosen, h):
                    out[e] = h
        return out

    def _fitted(self, chosen: Hypothesis, alike: Sequence[Candidate]) -> SimulatedSets:
        """All sets that were fitted, and what says the same as the chosen one."""
        fits = self.fits
        fitted = [*fits.earlier.values(), *fits.known.values(), fits.nominal, chosen]
        return simulated_sets([*fitted, *mirror_images(fits.bench, chosen, alike)])

    def _smaller(self, h: Hypothesis, c: Candidate) -> Hypothesis:
        (less,) = self.fits.refit([left_out(self.fits.bench, h, c)], h)
        return less
