"""What a dataset or a robot's file states of a model's numbers, beside what the data say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TYPE_CHECKING

import numpy as np

from jaxid.base.wording import listed, number, percent, unit_after, value_with_std
from jaxid.numerics.stated_numbers import (
    apart,
    BoundedEstimates,
    REFUTED,
    smallest_change,
    SmallestChange,
)
from jaxid.robots import yardstick
from jaxid.robots.match import is_robot


if TYPE_CHECKING:
    from jaxid.fitting.result import Covariance, Estimate
    from jaxid.problem.binding import Binding


#: By so much of itself a number has to be another beside the others as stated, for both to be said.
SHOWN = 0.01


#: How numbers of links and shapes begin.
OF_BODIES = ("mass", "com_", "gyration_", "sliding_friction")


@dataclass(frozen=True)
class StatedNumber:
    """One number as it is stated and as it was fitted, or what two of them come to where the data
    tell only that.

    `deviation` is in standard deviations, None where the data do not refute the number by itself
    and do not determine it; `beside` what it is with the other stated numbers as they are, where it
    is refuted.
    """

    joint: str
    link: str
    parameter: str
    stated: float
    fitted: float
    std: float | None
    deviation: float | None
    text: str
    unit: str = ""
    beside: float | None = None

    @property
    def refuted(self) -> bool:
        return self.deviation is not None and abs(self.deviation) > REFUTED

    @property
    def place(self) -> str:
        """The joint of a number, or the link or shape of a body's; empty for what two numbers come
        to.
        """
        if " " in self.parameter:  # "kp of lift / armature of lift"
            return ""
        of_body = self.parameter.startswith(OF_BODIES)
        return self.link if of_body and self.link else self.joint

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def stated_numbers(
    binding: Binding, found: Mapping[int, Estimate], covariance: Covariance | None = None
) -> tuple[StatedNumber, ...]:
    """The fitted numbers (by position in the layout) for which the dataset states a value, those
    that are furthest off first.
    """
    out = {}
    for name, prior in binding.dataset.stated.parameters.items():
        i = binding.layout.index(name)
        if prior.value is None or i not in found or prior.prior is not None:
            continue
        entry, estimate = binding.layout.entries[i], found[i]
        joint = entry.location or (
            binding.chain.signature.joints[0] if binding.chain.nq == 1 else ""
        )
        std = estimate.std if estimate.identifiable else None
        deviation = apart(estimate.value, prior.value, std)
        text = sentence_of(name, prior.value, estimate, deviation)
        out[i] = StatedNumber(
            joint=joint,
            link="",
            parameter=name,
            stated=prior.value,
            fitted=estimate.value,
            std=std,
            deviation=deviation,
            text=text,
            unit=estimate.unit,
        )
    told = judged(out, binding.layout.names, found, covariance, plain=True)
    return tuple(sorted(told, key=lambda s: -abs(s.deviation or 0.0)))


def stated_or_of_the_file(
    binding: Binding, found: Mapping[int, Estimate], covariance: Covariance | None
) -> tuple[StatedNumber, ...]:
    """The numbers that a robot's file or the dataset states, judged by what was found (by position
    in the layout).
    """
    if not is_robot(binding.chain.mechanism):
        return stated_numbers(binding, found, covariance)
    rows = {i: StatedNumber(**row) for i, row in yardstick.stated(binding, found).items()}
    return judged(rows, binding.layout.names, found, covariance)


def judged(
    rows: Mapping[int, StatedNumber],
    names: Sequence[str],
    found: Mapping[int, Estimate],
    covariance: Covariance | None,
    plain: bool = False,
) -> tuple[StatedNumber, ...]:
    """The rows (by position in the layout), judged all together: only what the smallest change
    takes is refuted.

    Where another number might be changed in place of one, what the two come to is judged, in a row
    of its own. `names` are those of the layout, `covariance` that of the fitted numbers; without
    one they count as independent. With `plain` a number is called by its name alone, else by its
    joint or link, too.
    """
    at, known = _known(names, found, covariance)
    stated = np.full(len(at), np.nan)
    for k, i in enumerate(at):
        row = rows.get(i)
        if row is None:
            continue
        stated[k] = row.stated
        if (
            row.deviation is not None and row.std
        ):  # of an armature what steps add may be in it, or not: what lies nearest
            known.value[k] = row.stated + row.deviation * row.std
    change = smallest_change(known, stated)
    place = {i: k for k, i in enumerate(at)}

    def called(i):
        return _label(rows[i], plain)

    either: dict[int, str] = {}
    for k, others in change.instead.items():
        group = [at[m] for m in (k, *others)]
        for i in group:
            either[i] = listed(called(j) for j in group if j != i)
    out = []
    for i, row in rows.items():
        k = place.get(i, -1)
        if i in either:
            out.append(_undecided(row, called(i), either[i]))
        elif k in change.refuted:
            out.append(_refuted(row, called(i), found[i], change, k, plain))
        else:
            out.append(row)
    for k, others in change.instead.items():
        i, j = at[k], at[others[0]]
        out.append(
            _together(
                (rows[i], rows[j]), (called(i), called(j)), (k, others[0]), known, stated, change
            )
        )
    return tuple(out)


def _known(
    names: Sequence[str], found: Mapping[int, Estimate], covariance: Covariance | None
) -> tuple[list[int], BoundedEstimates]:
    """The positions of the numbers that were fitted, and what is known of these."""
    if covariance is None:
        at = [i for i, e in found.items() if e.std]
        matrix = np.diag([(found[i].std or 0.0) ** 2 for i in at])
    else:
        by_name = {name: k for k, name in enumerate(covariance.names)}
        at = [i for i in found if names[i] in by_name]
        own = [by_name[names[i]] for i in at]
        matrix = covariance.matrix[np.ix_(own, own)]
    return at, BoundedEstimates(
        value=np.array([found[i].value for i in at], float),
        covariance=matrix.reshape(len(at), len(at)),
        lower=np.array([found[i].lower for i in at], float),
        upper=np.array([found[i].upper for i in at], float),
    )


def _refuted(
    row: StatedNumber, called: str, estimate: Estimate, change: SmallestChange, k: int, plain: bool
) -> StatedNumber:
    """A row of a number that is wrong by itself; what it is with the others as stated, where that
    is not what was fitted.
    """
    value, std, deviation = float(change.value[k]), float(change.std[k]), change.deviation[k]
    own = unit_after(estimate.unit)
    off = f"{number(abs(deviation), 2)} standard deviations"
    if abs(value - row.fitted) > max(std, SHOWN * abs(row.fitted)):
        told = value_with_std(replace(estimate, value=value, std=std))
        text = (
            f"{called}: {told} with the other numbers as stated, stated"
            f" {number(row.stated, 4)}{own} ({off})"
        )
    elif plain:
        text = sentence_of(row.parameter, row.stated, estimate, deviation)
    else:
        text = f"{row.text.rpartition(' (')[0] or row.text} ({off})"
    return replace(row, deviation=deviation, text=text, beside=value)


def _undecided(row: StatedNumber, called: str, others: str) -> StatedNumber:
    """A row of a number that the data refute only together with others."""
    text = (
        f"{called} as stated can be neither confirmed nor refuted by itself: the data tell it only"
        f" together with {others}"
    )
    return replace(row, deviation=None, text=text)


def _label(row: StatedNumber, plain: bool) -> str:
    """`inertia`, or with its place `kp of steer`."""
    kind = row.parameter.replace("_", " ")
    of_link = row.parameter.startswith(("com_", "mass", "gyration_")) and row.link
    place = row.link if of_link else row.joint
    return kind if plain or not place else f"{kind} of {place}"


@dataclass(frozen=True)
class _Form:
    """What two numbers come to: `slope` [2] by which it changes with them."""

    sign: str
    name: str
    value: float
    stated: float
    slope: np.ndarray


def _together(
    rows: tuple[StatedNumber, StatedNumber],
    called: tuple[str, str],
    at: tuple[int, int],
    known: BoundedEstimates,
    stated: np.ndarray,
    change: SmallestChange,
) -> StatedNumber:
    """What two numbers come to, of which either may be wrong: of ratio, product, sum and difference
    what the data tell best.
    """
    k, m = at
    row = rows[0]
    told = map(int, np.flatnonzero(np.isfinite(stated)))
    kept = [i for i in told if i not in change.refuted and i != m]
    value, covariance, _ = known.beside(kept, stated[kept])
    pair = np.ix_([k, m], [k, m])
    form = min(
        _forms(value[[k, m]], stated[[k, m]], rows[0].unit == rows[1].unit),
        key=lambda f: float(f.slope @ covariance[pair] @ f.slope) / max(f.value**2, 1e-300),
        default=None,
    )
    if form is None:
        return _either(rows, called, at, kept, known, stated, change)
    std = float(np.sqrt(max(form.slope @ covariance[pair] @ form.slope, 0.0)))
    if abs(form.value - form.stated) <= REFUTED * std:
        return _either(rows, called, at, kept, known, stated, change)
    deviation = change.deviation[k]
    name = f"{called[0]} {form.sign} {called[1]}"
    only = f"the data tell only the {form.name}, not which of the two differs"
    off = f"{number(abs(deviation), 2)} standard deviations"
    if form.name in ("ratio", "product") and form.stated:
        share = form.value / form.stated - 1
        text = (
            f"{name} is {percent(abs(share))} {'higher' if share > 0 else 'lower'} than stated"
            f" ({off}): {only}"
        )
    else:
        text = (
            f"{name} is {number(form.value)} ± {number(std, 2)}{unit_after(row.unit)}, stated"
            f" {number(form.stated)} ({off}): {only}"
        )
    unit = row.unit if form.name in ("sum", "difference") else ""
    signed = float(np.copysign(deviation, form.value - form.stated))
    return StatedNumber(
        joint=row.joint,
        link=row.link,
        parameter=name,
        stated=form.stated,
        fitted=form.value,
        std=std,
        deviation=signed,
        text=text,
        unit=unit,
    )


def _either(
    rows: tuple[StatedNumber, StatedNumber],
    called: tuple[str, str],
    at: tuple[int, int],
    kept: Sequence[int],
    known: BoundedEstimates,
    stated: np.ndarray,
    change: SmallestChange,
) -> StatedNumber:
    """Two numbers of which either may be wrong, where the data do not tell what both come to: what
    each would be with the other as stated.
    """
    k, m = at
    beside_m, spread_m, _ = known.beside([*kept, m], stated[[*kept, m]])
    beside_k, spread_k, _ = known.beside([*kept, k], stated[[*kept, k]])
    std = float(np.sqrt(max(spread_m[k, k], 0.0)))
    other_std = float(np.sqrt(max(spread_k[m, m], 0.0)))
    first = _alone(called[0], float(beside_m[k]), std, rows[0])
    second = _alone(called[1], float(beside_k[m]), other_std, rows[1])
    off = f"{number(abs(change.deviation[k]), 2)} standard deviations"
    signed = float(np.copysign(change.deviation[k], beside_m[k] - stated[k]))
    return StatedNumber(
        joint=rows[0].joint,
        link=rows[0].link,
        parameter=f"{called[0]} or {called[1]}",
        stated=float(stated[k]),
        fitted=float(beside_m[k]),
        std=std,
        deviation=signed,
        text=f"either {first} or {second} ({off}): the data do not tell which of the two",
        unit=rows[0].unit,
    )


def _alone(called: str, value: float, std: float, row: StatedNumber) -> str:
    """What a number would be by itself, and as what it is stated."""
    unit = unit_after(row.unit)
    return f"{called} is {number(value)} ± {number(std, 2)}{unit}, not {number(row.stated)}"


def _forms(value: np.ndarray, stated: np.ndarray, alike: bool) -> list[_Form]:
    """Ways in which two numbers (values [2], as stated [2]) may go together: ratio and product of
    what is not stated as 0, sum and difference of what has the same unit.
    """
    (a, b), (c, d) = map(float, value), map(float, stated)
    out = []
    if c and d and b:
        out.append(_Form("/", "ratio", a / b, c / d, np.array([1 / b, -a / b**2])))
    if c and d:
        out.append(_Form("·", "product", a * b, c * d, np.array([b, a])))
    if alike:
        out.append(_Form("+", "sum", a + b, c + d, np.array([1.0, 1.0])))
        out.append(_Form("-", "difference", a - b, c - d, np.array([1.0, -1.0])))
    return out


def sentence_of(name: str, value: float, estimate: Estimate, deviation: float | None) -> str:
    """What the data say of one number as it is stated."""
    own = f"your stated {name} {number(value)}{unit_after(estimate.unit)}"
    if deviation is None or not np.isfinite(deviation):
        return f"{own} can be neither confirmed nor refuted: the data do not determine it"
    off = number(abs(deviation), 2)
    far = f"{off} standard deviation{'' if off == '1.0' else 's'} from {value_with_std(estimate)}"
    return (
        f"{own} is {far}"
        if abs(deviation) > REFUTED
        else f"{own} agrees with the data: it is {far}"
    )
