"""What the diagnosis decides by, in one place: each number with its unit and why it is what it is.

Numbers that only bound work (starts, iterations, samples) stand beside the loop that they bound.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any


def _of(value: float, unit: str, reason: str) -> Any:
    return field(default=value, metadata={"unit": unit, "reason": reason})


@dataclass(frozen=True)
class Thresholds:
    """The numbers that the diagnosis decides by; `table` lists them with unit and reason."""

    # selection
    decisive: float = _of(
        9.0,
        "chi-square units",
        "A difference of held-out evidence below this many chi-square units (3 sigma) decides nothing.",
    )
    conflict: float = _of(
        0.5,
        "share of what is left",
        "A hypothesis that leaves less than this share of what the best one on validation data leaves of the fit "
        "runs, and less over both (mean logarithm), is preferred to it: validation runs may go where the fit runs "
        "tell little of any hypothesis.",
    )
    alike: float = _of(
        1.02,
        "ratio of mean squares",
        "A law of fewer numbers is as good if it leaves less than so much more: the noise itself is not known better.",
    )
    gain: float = _of(
        0.02,
        "share of the gap",
        "An effect must remove at least this share of what is left of the gap on validation data.",
    )
    white: float = _of(
        1.5,
        "mean square, noise 1",
        "Residuals of fit runs at the noise, and white: their sums of squares count as they are.",
    )
    explained: float = _of(
        1.1,
        "mean square, noise 1",
        "Validation runs, refitted together with fit runs that show no gap, are explained where an effect leaves less.",
    )
    overwhelming: float = _of(
        200.0,
        "chi-square units",
        "So much higher do `explained` validation runs have to stand without the effect, where fit runs show no gap at all.",
    )
    at_floor: float = _of(
        1.02,
        "mean square, noise 1",
        "Nothing worth another effect is left below this.",
    )
    close_above: float = _of(
        1.5,
        "mean square, noise 1",
        "Above `at_floor` and below this, only something small may be left.",
    )
    form: float = _of(
        1e-5,
        "share of a mean square",
        "Two simulations of one law differ by so much of what it does (0.3 % of its size, in mean square).",
    )
    as_good: float = _of(
        0.99,
        "share of what is explained",
        "A hypothesis that explains so much of what another one explains is as good, where both are at the noise.",
    )
    # evidence
    plausible_start: float = _of(
        3.0,
        "standard deviations",
        "A start may be moved by so many of its own standard deviations to take its uncertainty out of a comparison.",
    )
    refit_together: float = _of(
        1.1,
        "mean square, noise 1",
        "A model that leaves more than so many times the noise (mean square) is refitted to the fit runs and "
        "those of a split at once, in so many iterations.",
    )
    # verdict
    named: float = _of(
        0.97,
        "share of the gap",
        "What is `named` closes at least this share of the gap (mean square above the floor) on validation data.",
    )
    partly: float = _of(
        0.5,
        "share of the gap",
        "What is said `partly` closes at least this share of the gap (mean square above the floor) on validation data.",
    )
    seen: float = _of(
        1.2,
        "times the noise",
        "Gap of the re-tuned model on report data, times the noise, above which they can withdraw a verdict.",
    )
    left: float = _of(
        1.5,
        "times the noise",
        "Near the noise: what is `named` closes that share of the gap on fit and report data too, or leaves no "
        "more than so many times the noise there; with `none` no run and no direction of motion of the report "
        "data leaves more.",
    )
    still: float = _of(
        2.0,
        "times the noise",
        "A channel stands still where it scatters by less than so many times its noise.",
    )
    # believable
    switched_off: float = _of(
        0.2,
        "share of the command",
        "A drive that is said to give no more than this share of what it is told is one that is all but switched off.",
    )
    # how far
    unseen_gap: float = _of(
        1.5,
        "times the noise",
        "A model without a gap on fit and validation data is told of one this large (in multiples of the noise) on report data.",
    )
    # run
    remainder: float = _of(
        10.0,
        "times the noise",
        "Free runs that forget how they began are not trusted where they find no answer, or one that leaves so "
        "many times the noise.",
    )
    # search
    standing_out: float = _of(
        25.0,
        "chi-square units",
        "What is refitted where a model is close above the noise already: candidates that explain so much of the sum of squares.",
    )
    far: float = _of(
        10.0,
        "mean square, noise 1",
        "A model that leaves more is not worth descending to the end yet, and may be in a local minimum.",
    )
    local_minimum: float = _of(
        0.5,
        "share of what is left",
        "A model was in a local minimum if less than this share is left from where a richer one ended.",
    )
    followed: float = _of(
        1.5,
        "ratio of mean squares",
        "What leaves at most so many times what the best of a batch leaves of the fit runs is followed on validation runs.",
    )
    followed_near: float = _of(
        6.0,
        "mean square, noise 1",
        "Of what is `followed`, only what leaves at most this may turn out to be right elsewhere.",
    )
    left_open: float = _of(
        0.3,
        "mean square, noise 1",
        "Validation runs that are so much further away than they need be with what the fit runs leave open (mean "
        "squares) settle it.",
    )
    # prior pull
    pull_cost: float = _of(
        2.0,
        "half of a chi-square unit",
        "A direction is left open where going all the way back costs less than this (half of the sum of squares, "
        "in noise variances).",
    )
    pull_short: float = _of(
        1.0,
        "typical changes",
        "A way back that is shorter than this, in typical changes of a parameter, is not gone.",
    )
    pull_hopeless: float = _of(
        10.0,
        "ratio of mean squares",
        "A path that leaves so many times what the best of them leaves is not moved: nothing comes of it.",
    )
    # shortlist
    screen_share: float = _of(
        0.02,
        "share of the best",
        "Candidates within this share of the best screen value are refitted, at least MINIMUM and at most MAXIMUM of them.",
    )
    # unseen
    told: float = _of(
        3.0,
        "standard deviations",
        "Closer simulations than this (standard deviations of the noise, all samples together) are not told apart.",
    )
    sign: float = _of(
        8.0,
        "standard deviations",
        "A candidate that stands out by so many is a sign: a fine encoder and what steps leave behind reach 6.",
    )
    chance: float = _of(
        1e-12,
        "probability",
        "A number that differs between parts of the recordings with less than this by chance is a sign: steps reach 1e-7.",
    )
    hidden_share: float = _of(
        0.05,
        "share of a number",
        "An effect hides in a number that it moves by this share of its value, or of its typical change, and by `hidden_beyond`.",
    )
    hidden_beyond: float = _of(
        2.0,
        "standard deviations",
        "An effect hides in a number that it moves by so many of those that the fit states, and by `hidden_share`.",
    )
    # where
    own_energy: float = _of(
        0.3,
        "share of its energy",
        "What named effects supply is what was missing if taking it away leaves less by so many times its own energy.",
    )
    own_share: float = _of(
        0.5,
        "share of what is missing",
        "Taking away what named effects supply has to leave less by that share of what is missing above the noise, too.",
    )
    own_regime: float = _of(
        0.9,
        "share of its energy",
        "What a named effect supplies lies in a regime if that share of it does; else it lies wherever the effect acts.",
    )
    # equivalence
    absorbed: float = _of(
        5e-4,
        "share of a weak effect",
        "An effect is absorbed where re-tuning leaves less than this share of what a weak one (WEAK of a probe) "
        "changes: as much as a first-order re-tuning leaves of one that is absorbed exactly goes with its "
        "strength, what it cannot absorb does not.",
    )
    parallel: float = _of(
        0.999,
        "cosine",
        "Two effects whose weak changes point this much the same way are each fitted to the other's recording.",
    )
    equivalent: float = _of(
        0.02,
        "share of what re-tuning leaves",
        "Of two `parallel` effects both fits have to leave less than this of what re-tuning alone leaves, for them to be alike.",
    )
    # goals, equivalence
    equivalent_goals: float = _of(
        0.02,
        "share of what re-tuning leaves",
        "An effect of which re-tuning leaves less than this share is taken up; two are alike where each leaves "
        "less of the other.",
    )
    # torque, choose
    sure: float = _of(
        3.0,
        "standard errors",
        "By so many do more effects have to predict better.",
    )
    missed: float = _of(
        2.0,
        "standard errors",
        "By so many may fewer effects predict worse.",
    )
    shows_itself: float = _of(
        1e-6,
        "share of a column",
        "A column of which less than this share lies outside of what is there already shows nothing of its own.",
    )
    # torque, run
    different: float = _of(
        2.0,
        "ratio of errors",
        "Held-out runs that are so many times further away than those that were fitted are asked what is different in them.",
    )
    # torque, answer
    determined: float = _of(
        0.5,
        "share of what is known",
        "A number whose standard deviation is more than this share of what is known of it beforehand is not determined.",
    )
    # torque, rows
    standing: float = _of(
        12.0,
        "times the noise",
        "A joint whose readings span less than so many times their noise stands still.",
    )
    # torque, algebra
    correlated: float = _of(
        0.05,
        "correlation",
        "Rows that are correlated by less than this share no noise.",
    )

    def table(self) -> list[tuple[str, float, str, str]]:
        """Name, value, unit and reason of each."""
        return [(f.name, getattr(self, f.name), f.metadata["unit"], f.metadata["reason"]) for f in fields(self)]


LIMITS = Thresholds()
