"""What the diagnosis decides by, in one place: each number with its unit, why it is what it is, and
the case that it came from.

Numbers that only bound work (starts, iterations, samples) stand beside the loop that they bound.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any


def _of(value: float, unit: str, reason: str, case: str) -> Any:
    return field(default=value, metadata={"unit": unit, "reason": reason, "case": case})


@dataclass(frozen=True)
class Thresholds:
    """The numbers that the diagnosis decides by; `table` lists them with unit, reason and case."""

    # selection
    decisive: float = _of(
        9.0,
        "chi-square units",
        "A difference of held-out evidence below this many chi-square units (3 sigma) decides"
        " nothing.",
        "convention: three standard deviations",
    )
    halved: float = _of(
        0.5,
        "share of what is left",
        "What leaves less than this share of what another model leaves changed something at large:"
        " that other model was in a local minimum, or is asked with anything beside it.",
        "two controls of the servo, seeds 28 and 29, that were named out of a local minimum",
    )
    alike: float = _of(
        1.02,
        "ratio of mean squares",
        "What leaves less than so much more leaves as much, and what leaves less than so much more"
        " than the noise is at the noise: it is not known better.",
        "not recorded",
    )
    near_noise: float = _of(
        1.5,
        "mean square, noise 1",
        "What is left near the noise: sums of squares count as they are, and what may still be"
        " found is small.",
        "blind cases of four models at the noise; pairs with a small second effect",
    )
    three_sigma: float = _of(
        3.0,
        "standard deviations",
        "What differs by less is not told apart: two simulations, two predictions, a start and one"
        " that was moved.",
        "convention: three standard deviations",
    )
    # evidence
    at_noise: float = _of(
        1.1,
        "mean square, noise 1",
        "What leaves no more is at the noise, however many samples there are. A model that leaves"
        " more is refitted to the fit runs and those of a split at once.",
        "not recorded",
    )
    # verdict
    named: float = _of(
        0.97,
        "share of the gap",
        "What is `named` closes at least this share of the gap (mean square above the floor) on"
        " validation data.",
        "not recorded",
    )
    partly: float = _of(
        0.5,
        "share of the gap",
        "What is said `partly` closes at least this share of the gap (mean square above the floor)"
        " on validation data.",
        "convention: more than half",
    )
    seen: float = _of(
        1.2,
        "times the noise",
        "Gap of the re-tuned model on report data, times the noise, above which they can withdraw a"
        " verdict.",
        "recordings whose report runs alone showed a gap",
    )
    left: float = _of(
        1.5,
        "times the noise",
        "Near the noise: what is `named` closes that share of the gap on fit and report data too,"
        " or leaves no more than this many times the noise there; with `none` no run and no"
        " direction of motion of the report data leaves more. A model without a gap on the other"
        " data is told of a larger one on report data.",
        "flexible link with an effect of no library that got a name; a tracker of paper_gaps.py",
    )
    still: float = _of(
        2.0,
        "times the noise",
        "A channel stands still where it scatters by less than this many times its noise.",
        "a geared pendulum at rest for most of its recording",
    )
    # believable
    switched_off: float = _of(
        0.2,
        "share of the command",
        "A drive that is said to give no more than this share of what it is told is one that is all"
        " but switched off.",
        "a pendulum whose zero was horizontal: a drive reduced by 89.5 % took that in",
    )
    # run
    remainder: float = _of(
        10.0,
        "times the noise",
        "Free runs that forget how they began are not trusted where they find no answer, or one"
        " that leaves this many times the noise.",
        "planar arms that swing over the top",
    )
    # search
    standing_out: float = _of(
        25.0,
        "chi-square units",
        "What is refitted where a model is close above the noise already: candidates that explain"
        " so much of the sum of squares.",
        "blind pairs with a small second effect, as `near_noise`",
    )
    far: float = _of(
        10.0,
        "mean square, noise 1",
        "A model that leaves more is not worth descending to the end yet, and may be in a local"
        " minimum; of candidates beside it those in front are asked first.",
        "not recorded",
    )
    followed: float = _of(
        1.5,
        "ratio of mean squares",
        "What leaves at most this many times what the best of a batch leaves of the fit runs is"
        " followed on validation runs.",
        "not recorded",
    )
    followed_near: float = _of(
        6.0,
        "mean square, noise 1",
        "Of what is `followed`, only what leaves at most this may turn out to be right elsewhere.",
        "not recorded",
    )
    left_open: float = _of(
        0.3,
        "mean square, noise 1",
        "Validation runs that are so much further away than they need be with what the fit runs"
        " leave open (mean squares) settle it.",
        "not recorded",
    )
    # prior pull
    pull_cost: float = _of(
        2.0,
        "half of a chi-square unit",
        "A direction is left open where going all the way back costs less than this (half of the"
        " sum of squares, in noise variances).",
        "servo cases of seed 26, whose fit runs left a delay and a scale of the sensor open",
    )
    pull_short: float = _of(
        1.0,
        "typical changes",
        "A way back that is shorter than this, in typical changes of a parameter, is not gone.",
        "convention: one typical change is the unit of a change",
    )
    pull_hopeless: float = _of(
        10.0,
        "ratio of mean squares",
        "A path that leaves this many times what the best of them leaves is not moved: nothing"
        " comes of it.",
        "not recorded",
    )
    # shortlist
    screen_share: float = _of(
        0.02,
        "share of the best",
        "Candidates within this share of the best screen value are refitted, at least MINIMUM and"
        " at most MAXIMUM of them.",
        "not recorded",
    )
    # unseen
    sign: float = _of(
        8.0,
        "standard deviations",
        "A candidate that stands out by this many is a sign: a fine encoder and what steps leave"
        " behind reach 6.",
        "stepped commands to a joint with a fine encoder: 6 without anything missing",
    )
    chance: float = _of(
        1e-12,
        "probability",
        "A number that differs between parts of the recordings with less than this by chance is a"
        " sign: steps reach 1e-7.",
        "stepped commands to a joint: 1e-7 without anything missing",
    )
    hidden_share: float = _of(
        0.05,
        "share of a number",
        "An effect hides in a number that it moves by this share of its value, or of its typical"
        " change, and by `hidden_beyond`.",
        "not recorded",
    )
    hidden_beyond: float = _of(
        2.0,
        "standard deviations",
        "An effect hides in a number that it moves by this many of those that the fit states, and"
        " by `hidden_share`.",
        "convention: 95 %",
    )
    # where
    own_energy: float = _of(
        0.3,
        "share of its energy",
        "What named effects supply is what was missing if taking it away leaves less by this many"
        " times its own energy.",
        "not recorded",
    )
    own_share: float = _of(
        0.5,
        "share of what is missing",
        "Taking away what named effects supply has to leave less by that share of what is missing"
        " above the noise, too.",
        "convention: more than half",
    )
    own_regime: float = _of(
        0.9,
        "share of its energy",
        "What a named effect supplies lies in a regime if that share of it does; else it lies"
        " wherever the effect acts.",
        "not recorded",
    )
    # equivalence
    absorbed: float = _of(
        5e-4,
        "share of a weak effect",
        "An effect is absorbed where re-tuning leaves less than this share of what a weak one (WEAK"
        " of a probe) changes: as much as a first-order re-tuning leaves of one that is absorbed"
        " exactly goes with its strength, what it cannot absorb does not.",
        "not recorded",
    )
    parallel: float = _of(
        0.999,
        "cosine",
        "Two effects whose weak changes point this much the same way are each fitted to the other's"
        " recording.",
        "not recorded",
    )
    equivalent: float = _of(
        0.02,
        "share of what re-tuning leaves",
        "An effect of which re-tuning leaves less than this share is taken up; two are alike where"
        " each leaves less of the other.",
        "not recorded",
    )
    # goals, limits
    limit_leaves: float = _of(
        0.7,
        "share of the missing force",
        "A limit of a drive that leaves at most this of the force which the file lacks at its joint"
        " is simulated, which decides: a filter of the motion smears where a drive meets its"
        " limit.",
        "two saturated joints of blind_robots.py; tuned on one of them",
    )
    # torque, run
    different: float = _of(
        2.0,
        "ratio of errors",
        "Held-out runs that are this many times further away than those that were fitted are asked"
        " what is different in them.",
        "a loaded against an unloaded arm",
    )
    # torque, answer
    determined: float = _of(
        0.5,
        "share of what is known",
        "A number whose standard deviation is more than this share of what is known of it"
        " beforehand is not determined.",
        "convention: more than half",
    )
    # torque, algebra
    correlated: float = _of(
        0.05,
        "correlation",
        "Rows that are correlated by less than this share no noise.",
        "not recorded",
    )

    def table(self) -> list[tuple[str, float, str, str, str]]:
        """Name, value, unit, reason and case of each."""
        rows = []
        for f in fields(self):
            about = f.metadata
            rows.append(
                (f.name, getattr(self, f.name), about["unit"], about["reason"], about["case"])
            )
        return rows


LIMITS = Thresholds()
