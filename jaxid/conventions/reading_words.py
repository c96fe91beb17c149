"""What is said of a reading that a recording may have: a sentence, its headline, and the lines that
mend it.
"""

from __future__ import annotations

from math import pi

import numpy as np

from jaxid.base.wording import listed, number
from jaxid.conventions.mending import exchange_lines, lines, Mending
from jaxid.conventions.readings import Reading
from jaxid.problem.binding import Binding


def mending_lines(binding: Binding, reading: Reading, mending: Mending) -> str:
    if reading.kind == "swapped_channels":
        return exchange_lines(binding.dataset, *reading.channels)
    told = {c: lines(binding.dataset, c, mending.forms[c]) for c in reading.channels}
    if len(told) == 1:
        return "".join(told.values())
    return "\n".join(f"{line}  # of {c}" for c, line in told.items())


def headline(reading: Reading, value: float, binding: Binding, what: str) -> str:
    name = listed(reading.channels)
    if reading.kind == "sign":
        verb = "have" if len(reading.channels) > 1 else "has"
        it = "them" if len(reading.channels) > 1 else "it"
        return f"{name} {verb} the opposite sign; everything below takes {it} negated"
    if reading.kind == "swapped_channels":
        return f"{name} are exchanged; everything below takes each for the other"
    if reading.kind == "zero":
        return f"the zero of {name} is off by {_angle(value)}; everything below takes that away"
    too = f"{_are(reading)} {value:.5g} times too large ({what})"
    return f"{name} {too}; everything below divides by that"


def _are(reading: Reading) -> str:
    """The verb of its channels."""
    return "are" if len(reading.channels) > 1 else "is"


def _angle(value: float) -> str:
    return f"{value:.4f} rad ({np.degrees(value):.4g} deg)"


def sentence(
    reading: Reading, value: float, what: str, gap: tuple[float, float], doubt: str, laws: bool
) -> str:
    name = listed(reading.channels)
    model = "the model, beside any friction and spring that it may lack," if laws else "the model"
    before, after = (number(100 * share, 2) for share in gap)
    of = f"{model} leaves {before} % of the drive as recorded and {after} % so"
    if reading.kind == "sign":
        said = f"{name} seem{'s' * (len(reading.channels) == 1)} to count the other way"
    elif reading.kind == "swapped_channels":
        said = f"{name} seem to be exchanged"
    elif reading.kind == "zero":
        turns = (
            f", {abs(value) / (pi / 2):.0f} quarter turn{'s' * (abs(value) > 2)}"
            if "quarter" in what
            else ""
        )
        said = f"{name} reads {_angle(value)} where its zero should be{turns}"
    else:
        said = f"{name} {_are(reading)} recorded {value:.5g} times as large as in truth ({what})"
    return f"Is it that {said}? {of[0].upper()}{of[1:]}; {doubt}." if doubt else f"{said}: {of}."


def doubt_of(beyond: bool, others: bool, unnamed: bool) -> str:
    if not beyond:
        return "friction or a spring that the model lacks explains as much"
    if others:
        return "other readings come near"
    return "stated numbers of the model that are off as well may be part of it" if unnamed else ""
