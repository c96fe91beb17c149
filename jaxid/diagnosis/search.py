"""Which effect is missing: screen all candidates from one fit, refit, choose on held-out runs,
abstain when nothing fits.

The screen must rank and the refit must decide: signatures of physically different effects are often
nearly parallel after re-tuning, and some effects have no derivative at their neutral value.
Information criteria alone prefer the richer neighbour of the true effect; runs that were not fitted
do not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from jaxid.base.deadline import search_is_over
from jaxid.diagnosis.evidence import held_out, knowledge, together
from jaxid.diagnosis.hypothesis import (
    Candidate,
    Hypothesis,
    key_of,
    refined_by,
    SearchResult,
    sensible,
    without_each,
)
from jaxid.diagnosis.prior_pull import brought_back, moved_to, put_back
from jaxid.diagnosis.proposals import (
    beside,
    exchanged,
    left_out,
    pairs,
    plain_pairs,
    promising,
    RIVALS,
    torque_starts,
)
from jaxid.diagnosis.screen import Screened, screened, torque_screened, torque_tells
from jaxid.diagnosis.selection import (
    at_floor,
    close_to_noise,
    finished,
    in_lead,
    indistinct,
    joint_loss,
    leads_on,
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
from jaxid.fitting.least_squares import levenberg_marquardt, Path
from jaxid.fitting.many_starts import successive_halving
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import Residual
from jaxid.problem.step_error import defects, step_error, STEP_SHARE


#: This many hypotheses that explain the torque of the measured motion best are refitted to the end,
#: however they do at first.
SURE = 3
#: How often the step may be halved, and how often its defect is worked out anew for a chosen
#: hypothesis.
HALVINGS, CORRECTIONS = 3, 2
#: After the single effects nothing more is asked once this many steps were simulated (a minute on
#: two cores), and the fit runs so often: what few effects explain is found before; what none of the
#: library explains could be searched for an hour.
MOST_STEPS, MOST_RUNS = 150_000_000, 40_000
#: Iterations and tolerance of a descent to the end, and of that of a nominal model to which
#: something better is compared.
THOROUGH, BRIEF = (20, 1e-8), (6, 1e-5)


class Searcher:
    """Forward selection with re-evaluation, on one bench and residual."""

    def __init__(
        self,
        bench: ProblemBuilder,
        residual: Residual,
        nominal: Path,
        progress: Progress | None = None,
    ):
        self.bench, self.residual, self.progress = bench, residual, progress
        self.accurate = bench  # with steps that no longer matter
        self.benches: list[ProblemBuilder] = []  # coarser ones, left behind
        self.base_free = list(nominal.problem.free)
        self.nominal = self._hypotheses([((), nominal)])[0]
        self.known: dict[frozenset[str], Hypothesis] = {frozenset(): self.nominal}
        # refitted before the data were corrected for the step
        self._stale: dict[frozenset[str], Hypothesis] = {}
        self.tried: list[Hypothesis] = []  # on the way to what is chosen
        self._singles: list[Hypothesis] = []  # those of the last step
        self._passed_over: dict[
            Candidate, list[Hypothesis]
        ] = {}  # what an accepted effect was not clearly better than
        self._cut_short = False

    # ---- hypotheses

    def _hypotheses(self, found: Sequence[tuple[tuple[Candidate, ...], Path]]) -> list[Hypothesis]:
        thetas = [path.problem.theta(path.z) for _, path in found]
        # Only what fits as well as the best, and almost down to the noise, may turn out to be right
        # elsewhere.
        losses = [path.loss for _, path in found]
        follow = [
            p if loss <= min(LIMITS.followed * min(losses), LIMITS.followed_near) else None
            for (_, p), loss in zip(found, losses, strict=True)
        ]
        told = [knowledge(path) for _, path in found]
        validations = held_out(self.bench, "validation", thetas, self.residual, told, follow)
        return [
            Hypothesis(e, t, p, v) for (e, p), t, v in zip(found, thetas, validations, strict=True)
        ]

    def problem(self, effects: Sequence[Candidate], theta: np.ndarray) -> FitProblem:
        free = self.base_free + [i for c in effects for i in c.index]
        return self.bench.problem(self.residual, "fit", free, theta)

    def refit(
        self,
        sets: Sequence[tuple[tuple[Candidate, ...], Sequence[np.ndarray]]],
        like: Hypothesis | None = None,
    ) -> list[Hypothesis]:
        """Refits each set of effects from its starts (full parameter vectors), all in one batch,
        the runs begun as in `like` or the nominal model; best start of each.
        """
        if not sets:
            return []
        begun = (like or self.nominal).path
        starts = begun.problem.starts(begun.z)
        sets = promising(self.nominal.path, sets)
        groups, by_torque = (
            [],
            torque_starts(self.bench, self.base_free, sets, torque_tells(self.bench)),
        )
        for (effects, thetas), (_, more) in zip(sets, by_torque, strict=True):
            p = self.problem(effects, thetas[0])
            # The race favours the first two.
            groups.append([(p, p.z(theta, starts)) for theta in [thetas[0], *more, *thetas[1:]]])
        order = sorted(range(len(sets)), key=lambda k: by_torque[k][0])
        sure = [k for k in order if np.isfinite(by_torque[k][0])][:SURE]
        final = brought_back(
            successive_halving(groups, 20, 1e-6, sure), self.bench.binding.theta, self.base_free
        )
        found = self._led(
            self._hypotheses(
                [(effects, path) for (effects, _), path in zip(sets, final, strict=True)]
            )
        )
        for k, h in enumerate(found):
            old = self.known.get(key_of(h.effects))
            if old is not None and old.effects == h.effects and old.fit_loss < h.fit_loss:
                found[k] = old
            self.known[key_of(h.effects)] = found[k]
        return found

    def _led(self, found: list[Hypothesis]) -> list[Hypothesis]:
        """The hypotheses; one that is left far behind by another that contains it begins anew where
        that ended, without what that has more: it may have been in a local minimum.
        """
        jobs: dict[int, tuple[FitProblem, np.ndarray]] = {}
        for k, h in enumerate(found):
            richer = [
                g
                for g in found
                if key_of(h.effects) < key_of(g.effects) and g.fit_loss < LIMITS.halved * h.fit_loss
            ]
            if lead := min(richer, key=lambda g: g.fit_loss, default=None):
                theta, more = (
                    lead.theta.copy(),
                    [i for c in lead.effects if c not in h.effects for i in c.index],
                )
                theta[more] = self.bench.binding.theta[more]
                p = self.problem(h.effects, theta)
                jobs[k] = p, self._z(p, replace(lead, theta=theta))
        ends = zip(
            jobs, levenberg_marquardt(list(jobs.values()), *THOROUGH) if jobs else [], strict=True
        )
        better = {k: end for k, end in ends if end.loss < LIMITS.halved * found[k].fit_loss}
        new = (
            self._hypotheses([(found[k].effects, end) for k, end in better.items()])
            if better
            else []
        )
        return [dict(zip(better, new, strict=True)).get(k, h) for k, h in enumerate(found)]

    def screen(self, h: Hypothesis, pool: Sequence[Candidate]) -> list[Screened]:
        """What each candidate explains beside `h` of the residual."""
        return screened(self.bench, h.path.problem, h.path.z, h.theta, pool)

    # ---- search

    def _goes_on(self) -> bool:
        """Whether more may be asked after the first effects; that it may not is said in the end."""
        spent = sum(bench.simulated() for bench in (*self.benches, self.bench))
        once = self.nominal.path.problem.work
        too_many = spent > max(MOST_STEPS, MOST_RUNS * once)
        self._cut_short |= bool(self.tried) and (too_many or search_is_over())
        return not self._cut_short

    def run(
        self,
        pool: Sequence[Candidate],
        max_effects: int,
        known: Callable[[SearchResult], None] = lambda search: None,
    ) -> SearchResult:
        """Forward selection up to `max_effects`, then each accepted effect is questioned again;
        `known` is told after each round.
        """
        chosen = self._refined(self.nominal)
        while (
            (room := max_effects - len(chosen.effects)) > 0
            and not finished(chosen)
            and self._goes_on()
        ):
            found = self._beside(chosen, pool, room)
            step = step_from(chosen, found)
            if step is None and len(chosen.effects) + 2 <= max_effects and self._goes_on():
                step = step_from(chosen, self._as_pairs(chosen, found, pool, room))
                self.tried += [step] if step else []
            if step is None:
                break
            if (freed := self._freed(chosen, step)) is not chosen:
                self.nominal = self.nominal if chosen.effects else freed
                chosen = freed
                if not leads_on(chosen, step):
                    continue  # look again from there
            if not chosen.effects and max_effects > 1:
                step = self._plainer(step, pool)
            step = self._exchanged(step, found)
            chosen = self._refined(step)
            known(SearchResult(self.nominal, chosen, list(self.tried)))
        chosen = self._questioned(chosen)
        mates = self._alternatives(chosen, pool)
        if (top := most_probable([chosen, *mates.values()])) not in (None, chosen):
            chosen = self._questioned(top)
            mates = self._alternatives(chosen, pool)
        chosen = self._taught(self._put_back(self._settled(chosen)))
        self.nominal = self._taught(self.nominal) if chosen.effects else chosen
        if at_floor(self.nominal):  # freed of a local minimum on the way
            chosen, mates = self.nominal, {}
        alike = list(dict.fromkeys((*mates, *mirrored(self.bench, chosen, pool))))
        chosen, claims, sets = claimed(chosen, self.nominal, alike, self._fitted, self._smaller)
        if not chosen.effects:
            mates, alike = {}, []
        rivals = None
        if mates or not alike:  # of a mirrored effect alone no input tells what no recording can
            rivals = rivals_among(list(self.known.values()), chosen, list(mates.values()))
        return SearchResult(
            self.nominal,
            chosen,
            self.tried,
            alike,
            rivals,
            len(chosen.effects) > 1,
            without_each(chosen, self._stale | self.known),
            cut_short=self._cut_short,
            belief=believed(sets, claims, chosen),
        )

    def _fitted(self, chosen: Hypothesis, alike: Sequence[Candidate]) -> SimulatedSets:
        """All sets that were fitted, and what says the same as the chosen one."""
        fitted = [*self._stale.values(), *self.known.values(), self.nominal, chosen]
        return simulated_sets([*fitted, *mirror_images(self.bench, chosen, alike)])

    def _smaller(self, h: Hypothesis, c: Candidate) -> Hypothesis:
        return self.refit([left_out(self.bench, h, c)], h)[0]

    def _beside(self, chosen: Hypothesis, pool: Sequence[Candidate], room: int) -> list[Hypothesis]:
        """Refits of the chosen hypothesis with more in it, `room` effects at most; after the first
        choice also of two others, which may explain more than it and one beside it.
        """
        found = self._extend(chosen, [c for c in pool if c not in chosen.effects], room)
        if len(chosen.effects) == 1 and not close_to_noise(chosen) and self._goes_on():
            found += self._as_pairs(chosen, self._singles, pool, room)
        self._singles = found
        self.tried += found
        return found

    def _as_pairs(
        self, h: Hypothesis, found: Sequence[Hypothesis], pool: Sequence[Candidate], room: int
    ) -> list[Hypothesis]:
        """Two effects at once: pairs of those found, and anything beside the one that explains far
        more of the fit runs than `h` does, whatever it makes of validation runs without what else
        is missing; at most `room` more than `h` has.
        """
        most = len(h.effects) + room
        sets = pairs(self.bench, found)
        out = self.refit([(effects, starts) for effects, starts in sets if len(effects) <= most])
        lead = min(found, key=lambda f: f.fit_loss, default=h)
        if lead.fit_loss < LIMITS.halved * h.fit_loss and len(lead.effects) < most:
            out += self._extend(lead, [c for c in pool if c not in lead.effects])
        return out

    def _plainer(self, step: Hypothesis, pool: Sequence[Candidate]) -> Hypothesis:
        """The first effect, or two plain laws in its place that are more probable."""
        two = self.refit(plain_pairs(self.bench, step.effects[0], pool, self.nominal.theta))
        self.tried += two
        return most_probable([step, *two]) or step

    def _exchanged(self, step: Hypothesis, found: Sequence[Hypothesis]) -> Hypothesis:
        """The step, or one with other effects in the place of those accepted before, if more
        probable.
        """
        others = [h for h in found if h is not step and h.effects[:-1] == step.effects[:-1]]
        alike = [h for h in others if indistinct(step, h)]
        alike = sorted(alike, key=joint_loss)[:RIVALS]
        other = self.refit(exchanged(self.bench, [step, *alike], self._passed_over))
        self.tried += other
        self._passed_over[step.effects[-1]] = alike
        return most_probable([step, *other]) or step

    @property
    def _quick(self) -> ProblemBuilder:
        """The bench on the steps of the search, whose defects for what was chosen are off its
        data.
        """
        return (*self.benches, self.bench)[0]

    def _put_back(self, h: Hypothesis) -> Hypothesis:
        """The hypothesis with those of the model's own numbers where the user put them that the
        data leave open.
        """
        if not h.effects:
            return h
        path = put_back(
            h.path,
            self.bench.binding.theta,
            self.base_free,
            partial(self._quick.problem, self.residual, "fit"),
        )
        after = h if path is h.path else self._hypotheses([(h.effects, path)])[0]
        return after if after.validation.loss < h.validation.loss * LIMITS.alike else h

    def _taught(self, h: Hypothesis) -> Hypothesis:
        """What the fit runs leave open, as the validation runs have it, for a model that follows
        the fit runs.
        """
        held, theta, far = h.validation, h.validation.theta, h.fit_loss > LIMITS.followed_near
        if (
            theta is None
            and held.gap**2 > held.loss + LIMITS.left_open
            and self.residual.free_run
            and not far
        ):
            starts = estimate_starts(self._quick, "validation", [h.theta])
            theta = (end := together(self._quick, "validation", [h.path], starts)[0]).problem.theta(
                end.z
            )
        if theta is None or far:
            return h
        paths = [brought_back([h.path], theta, h.path.problem.free)[0], moved_to(h.path, theta)]
        moved = [(h.effects, path) for path in paths if path is not h.path]
        good = [
            g
            for g in (self._hypotheses(moved) if moved else [])
            if g.validation.loss < h.validation.loss * LIMITS.alike
        ]
        return min([h, *good], key=lambda g: g.validation.gap)

    def _refined(self, chosen: Hypothesis) -> Hypothesis:
        """The chosen hypothesis descended to the end, with steps so fine that they no longer matter
        against the noise: what the step leaves behind would look like another effect. The search
        itself stays on its steps: what finer ones add to the chosen hypothesis is taken off the
        data.
        """
        chosen = self._descended(
            chosen, THOROUGH if chosen.effects or chosen.fit_loss < LIMITS.far else BRIEF
        )
        error = np.nan
        for _ in range(HALVINGS):
            p = self.accurate.problem(self.residual, "fit", chosen.path.problem.free, chosen.theta)
            finer, before = replace(self.accurate, step=self.accurate.step / 2, defects={}), error
            if (
                error := step_error(p, self._z(p, chosen), finer.runs(self.residual, "fit"))
            ) <= STEP_SHARE:
                break
            self.accurate = finer
            if (
                error * error <= STEP_SHARE / 2 * before
            ):  # as it goes on falling, half of what is allowed is left
                break
        if self.accurate is not self.bench:
            self.accurate.compile_ahead(
                self.residual, self.nominal.theta, self.base_free
            )  # which it is compared with
            for _ in range(CORRECTIONS):
                self._take_off(chosen)
                chosen = self._descended(chosen)
            self.nominal = self._descended(self.nominal, BRIEF) if chosen.effects else chosen
            self._stale |= self.known
            self.known = {frozenset(): self.nominal, key_of(chosen.effects): chosen}
        return chosen

    def _freed(self, h: Hypothesis, richer: Hypothesis) -> Hypothesis:
        """`h` from where a richer one ended, if far less is left there or, as fit runs show no gap,
        nothing for the richer one to add: an effect may have led out of a local minimum, or along
        what the fit runs leave open, and be of no other use.
        """
        quiet = h.fit_inflation < LIMITS.near_noise
        if joint_loss(h) < LIMITS.far and not quiet:
            return h
        theta = richer.theta.copy()
        for c in richer.effects:
            theta[list(c.index)] = (h.theta if c in h.effects else self.bench.binding.theta)[
                list(c.index)
            ]
        p, starts = self.problem(h.effects, theta), richer.path.problem.starts(richer.path.z)
        freed = self._hypotheses(
            [(h.effects, levenberg_marquardt([(p, p.z(theta, starts))], *THOROUGH)[0])]
        )[0]
        share = joint_loss(freed) / joint_loss(h)
        if share > LIMITS.halved and not (
            quiet and share * LIMITS.alike < 1 and not leads_on(freed, richer)
        ):
            return h
        self.known[key_of(h.effects)] = freed
        return freed

    def _z(self, p: FitProblem, h: Hypothesis) -> np.ndarray:
        return p.z(h.theta, h.path.problem.starts(h.path.z))

    def _descended(self, h: Hypothesis, descent: tuple[int, float] = THOROUGH) -> Hypothesis:
        """The hypothesis at its minimum on the bench as it is now."""
        return self._all_descended([h], descent)[0]

    def _all_descended(
        self, hypotheses: Sequence[Hypothesis], descent: tuple[int, float]
    ) -> list[Hypothesis]:
        problems = [self.problem(h.effects, h.theta) for h in hypotheses]
        paths = levenberg_marquardt(
            [(p, self._z(p, h)) for p, h in zip(problems, hypotheses, strict=True)], *descent
        )
        found = self._hypotheses(
            [(h.effects, path) for h, path in zip(hypotheses, paths, strict=True)]
        )
        for h in found:
            self.known[key_of(h.effects)] = h
        return found

    def _take_off(self, h: Hypothesis) -> None:
        """Sets the defects of the bench's steps, as this hypothesis has them."""
        for split in ("fit", "validation"):
            p = self.bench.problem(self.residual, split, [], h.theta)
            starts = h.path.problem.starts(h.path.z) if split == "fit" else None
            if split == "validation" and self.residual.free_run:
                starts = estimate_starts(self.bench, split, [h.theta])[0]
            finer = self.accurate.runs(self.residual, split)
            self.bench.take_off(self.residual, split, defects(p, p.z(h.theta, starts), finer))

    def _settled(self, chosen: Hypothesis) -> Hypothesis:
        """The result on the accurate bench itself."""
        if self.accurate is not self.bench:
            self.benches.append(self.bench)
            self.bench = self.accurate
            self.nominal, *rest = self._all_descended(
                [self.nominal, chosen] if chosen.effects else [self.nominal], THOROUGH
            )
            chosen = rest[0] if rest else self.nominal
        return chosen

    def _extend(self, h: Hypothesis, rest: Sequence[Candidate], room: int = 1) -> list[Hypothesis]:
        """Refits of `h` with one more effect each, for all that the screen lets pass; one that
        refines another which is missing comes with that one, where there is room for two.
        """
        base = {str(c): [] if sensible((*h.effects, c)) else refined_by(c, rest) for c in rest}
        rest = [
            c for c in rest if sensible((*h.effects, *base[str(c)], c)) and len(base[str(c)]) < room
        ]
        ranked = self.screen(h, rest) if rest else []
        if h.effects and close_to_noise(h):
            ranked = [f for f in ranked if f[0] * h.fit_loss * h.path.count > LIMITS.standing_out]
            rest = [c for _, c, _ in ranked]
        # A free run that has gone far astray says little to first order: what the torque screen
        # puts first is tried as well.
        by_torque = (
            torque_screened(self.bench, h, [c for _, c, _ in ranked] or rest) if rest else []
        )
        if not (ranked or by_torque):
            return []
        lead = in_lead(self.known.values())
        if self.progress:
            told = (f"{len(ranked or by_torque)} candidates react to the data", lead)
            self.progress("screen", len(h.effects), 3, "; ".join(filter(None, told)))
        kept = shortlist(self.bench, ranked, by_torque, lambda c: bool(base[str(c)]), not h.effects)
        if self.progress:
            told = (f"{len(kept)} candidates", lead)
            self.progress("refit", len(h.effects), 3, "; ".join(filter(None, told)))
        return self.refit(beside(self.bench, h, kept, by_torque, base))

    def _questioned(self, h: Hypothesis) -> Hypothesis:
        """Takes out effects that are not worth their price beside the others, what one refines as
        well where there is none of it; the smaller set gets every chance, from where the larger one
        ended.
        """
        while len(h.effects) > 1:
            smaller = self.refit([left_out(self.bench, h, c) for c in h.effects], h)
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
        out: dict[Candidate, Hypothesis] = {}
        for c in chosen.effects:
            others = tuple(e for e in chosen.effects if e is not c)
            done = self.known.keys() | self._stale.keys()
            missing = [
                e for e in pool if e not in chosen.effects and key_of((*others, e)) not in done
            ]
            if missing and others and key_of(others) in self.known and self._goes_on():
                self._extend(self.known[key_of(others)], missing)
            self._renew(
                [key_of((*others, e)) for e in pool if e not in chosen.effects],
                key_of(chosen.effects),
            )
            for e in pool:
                h = self.known.get(key_of((*others, e)))
                if e in chosen.effects or h is None or e in out or not sensible((*others, e)):
                    continue
                if indistinct(chosen, h):
                    out[e] = h
        return out

    def _renew(self, keys: Sequence[frozenset[str]], chosen: frozenset[str]) -> None:
        """Brings hypotheses that were close to the chosen one before the data were corrected for
        the step up to date.
        """
        if chosen not in self._stale:
            return
        limit = 1.5 * self._stale[chosen].fit_loss
        old = [
            self._stale[k]
            for k in keys
            if k in self._stale and k not in self.known and self._stale[k].fit_loss <= limit
        ]
        if old:
            self._all_descended(old, (10, 1e-7))
