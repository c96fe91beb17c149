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

    # what chance does
    two_sigma: float = _of(
        2.0,
        "standard deviations",
        "What differs by more is not chance, asked once: a channel that moves, a number"
        " that an effect moves, a correlation that is not that of white noise.",
        "convention: 95 %",
    )
    three_sigma: float = _of(
        3.0,
        "standard deviations",
        "What differs by less is not told apart: two simulations, two predictions, a start and one"
        " that was moved. Its square decides about evidence.",
        "convention: three standard deviations",
    )
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
    pull_cost: float = _of(
        2.0,
        "half of a chi-square unit",
        "A direction is left open where going all the way back costs less than this (half of the"
        " sum of squares, in noise variances).",
        "servo cases of seed 26, whose fit runs left a delay and a scale of the sensor open",
    )
    # how far from the noise
    noise_known: float = _of(
        0.06,
        "share of the noise's mean square",
        "How well the noise itself is known: what leaves so much more leaves as much (`alike`).",
        "noise read off 34 blind recordings: 0.93 to 1.07 of the true mean square in 95 % of them",
    )
    near: float = _of(
        1.2,
        "times the noise",
        "Near the noise: sums of squares count as they are, what may still be found is small, and"
        " report data that leave more can withdraw a verdict.",
        "blind cases of four models at the noise; recordings whose report runs alone showed a gap",
    )
    left: float = _of(
        1.5,
        "times the noise",
        "What is `named` closes most of the gap on fit and report data too, or leaves no more than"
        " this there; with `none` no run and no direction of motion of the report data leaves"
        " more.",
        "flexible link with an effect of no library that got a name; a tracker of paper_gaps.py",
    )
    far: float = _of(
        10.0,
        "times",
        "What leaves more is far away. Of a mean square over that of the noise or of another model:"
        " it is not descended to the end yet, may be in a local minimum, and is not what explains"
        " the runs. Of a gap, times the noise: free runs that leave so much are not trusted.",
        "planar arms that swing over the top",
    )
    # shares
    half: float = _of(
        0.5,
        "share",
        "Most of something: of the gap that is closed, of what another model leaves, of a force"
        " that was missing, of what is known of a number.",
        "convention: more than half; two controls of the servo, seeds 28 and 29, that were named"
        " out of a local minimum",
    )
    named: float = _of(
        0.97,
        "share",
        "All but a rest: of the gap that what is `named` closes away from the noise, of what an"
        " effect supplies within a regime.",
        "blind.jsonl, away from the noise: 41 of 43 effects found where one of no library is"
        " missing close less than 95 %, 42 of 54 right ones more than 97 %",
    )
    equivalent: float = _of(
        0.02,
        "share",
        "What is the same but for this share is alike: a number, an effect of which re-tuning"
        " leaves less, two of which each leaves less of the other, and candidates on a screen.",
        "classes of the joint and the pendulum are those of 0.04; at 0.01 a pendulum's two delays,"
        " which no recording tells apart, are not alike",
    )
    # single questions
    switched_off: float = _of(
        0.2,
        "share of the command",
        "A drive that is said to give no more than this share of what it is told is one that is all"
        " but switched off.",
        "a pendulum whose zero was horizontal: a drive reduced by 89.5 % took that in",
    )
    limit_leaves: float = _of(
        0.7,
        "share of the missing force",
        "A limit of a drive that leaves at most this of the force which the file lacks at its joint"
        " is simulated, which decides: a filter of the motion smears where a drive meets its"
        " limit.",
        "two saturated joints of blind_robots.py; tuned on one of them",
    )

    @property
    def decisive(self) -> float:
        """A difference of held-out evidence below this many chi-square units decides nothing."""
        return self.three_sigma**2

    @property
    def alike(self) -> float:
        """What leaves less than this many times as much leaves as much (mean squares)."""
        return 1 + self.noise_known

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
