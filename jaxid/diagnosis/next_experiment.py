"""What to record next so that what cannot be told apart now can be told apart then."""

from __future__ import annotations

from collections.abc import Sequence

from jaxid import catalogue


def advice(verdict: str, named: Sequence[str], mates: Sequence[str]) -> str:
    """A sentence a person can act on; effects by id."""
    if verdict == "none":
        return "No further experiment is needed for this model: it reaches the noise floor on data that were not fitted."
    wanted = list(dict.fromkeys([*named, *mates]))
    if mates:
        parts = [f"for {name}: {catalogue.effect_class(name).excitation}" for name in wanted]
        return "To tell apart what the data leave open, record " + "; ".join(parts) + "."
    if verdict == "named":
        return "No further experiment is needed to separate causes; repeat one run to learn the repeatability of the machine."
    return (
        "Something remains that no effect of the library explains. Repeat one run unchanged (repeatability), record slow "
        "ramps through zero speed, a standstill under several loads, and one run each at half and full speed."
    )
