"""Where no effect is missing, but a stated number is another one: that is the answer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxid.base.wording import listed, number, one_line, unit_after


if TYPE_CHECKING:
    from jaxid.diagnosis.result import Diagnosis
    from jaxid.fitting.stated import StatedNumber


#: Numbers in words, where these are not their names.
WORDS = {
    "frictionloss": "dry friction", "armature": "rotor inertia", "kp": "gain kp", "kd": "gain kd", "ki": "gain ki",
    "quadratic_damping": "quadratic damping", "cubic_damping": "cubic damping", "springref": "rest position of the spring",
    "encoder_bias": "encoder offset", "com_x": "centre of mass (x)", "com_y": "centre of mass (y)",
    "com_z": "centre of mass (z)", "lowest": "lower limit", "highest": "upper limit", "timeconst": "time constant",
}  # fmt: skip
#: This many are told one by one.
FEW = 3


def refuted_numbers(diagnosis: Diagnosis) -> list[StatedNumber]:
    """Stated numbers that the data refute where no effect is missing, worst first; none for another
    verdict.
    """
    return _refuted(diagnosis) if diagnosis.which.verdict == "none" else []


def _refuted(diagnosis: Diagnosis) -> list[StatedNumber]:
    refuted = [s for s in diagnosis.final.stated if s.refuted]
    return sorted(refuted, key=lambda s: -abs(s.deviation or 0.0))


def moved_numbers(diagnosis: Diagnosis) -> str:
    """`the shoulder's dry friction at 1.97 N m, not 0.3`, whatever the verdict; empty where the
    data refute no stated number.
    """
    refuted = _refuted(diagnosis)
    told = [_clause(s, "at") for s in refuted[:FEW]]
    if len(refuted) > FEW:
        told.append(f"{len(refuted) - FEW} more numbers re-tuned")
    return listed(told)


def other_numbers(diagnosis: Diagnosis) -> str:
    """`The shoulder's dry friction is 1.97 N m, not 0.3.`; empty where there is no such number."""
    refuted = refuted_numbers(diagnosis)
    if not refuted:
        return ""
    told = [_clause(s) for s in refuted[:FEW]]
    if len(refuted) <= FEW:
        return f"{_capital(listed(told))}."
    rest = len(refuted) - FEW
    return f"{_capital(listed([*told, f'{rest} more stated numbers are not those of the data']))}."


def first_of_all(diagnosis: Diagnosis, verdict: str) -> str:
    """The verdict in plain words; stated numbers that the data refute come before what is not
    missing.
    """
    other = other_numbers(diagnosis)
    return f"{other} No effect is missing beside that." if other else verdict


def other_places(diagnosis: Diagnosis) -> tuple[str, list[str]]:
    """Where these numbers are: the head of a card, and its sentences."""
    refuted = refuted_numbers(diagnosis)
    places = dict.fromkeys(one_line(s.place or _word(s)) for s in refuted[:FEW])
    more = f" and {len(refuted) - FEW} more" if len(refuted) > FEW else ""
    return f"In what is stated of {listed(places)}{more}", [
        other_numbers(diagnosis),
        "Nothing else is above the noise.",
    ]


def _clause(s: StatedNumber, verb: str = "is") -> str:
    unit = unit_after(s.unit)
    place = one_line(s.place)
    what = f"the {place}'s {_word(s)}" if place else _word(s)
    value = number(s.fitted if s.beside is None else s.beside, 3)
    return f"{what} {verb} {value}{unit}, not {s.stated:.4g}"


def _word(s: StatedNumber) -> str:
    return WORDS.get(s.parameter, one_line(s.parameter).replace("_", " "))


def _capital(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"
