"""What a dataset states of a model's numbers, beside what the data say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, TYPE_CHECKING

from jaxid.wording import number, value_with_std


if TYPE_CHECKING:
    from jaxid.fitting.result import Estimate
    from jaxid.problem.binding import Binding


#: A stated number is refuted beyond so many standard deviations.
REFUTED = 3.0


@dataclass(frozen=True)
class Stated:
    """One number as it is stated and as it was fitted; `deviation` in standard deviations of the fit, None where the data do not
    determine it."""

    joint: str
    link: str
    parameter: str
    stated: float
    fitted: float
    std: float | None
    deviation: float | None
    text: str
    unit: str = ""

    @property
    def refuted(self) -> bool:
        return self.deviation is not None and abs(self.deviation) > REFUTED

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def stated_numbers(binding: Binding, found: Mapping[int, Estimate]) -> tuple[Stated, ...]:
    """The fitted numbers (by position in the layout) for which the dataset states a value, those that are furthest off first."""
    spec, out = binding.dataset.model, []
    for name, prior in spec.parameters.items() if spec is not None else ():
        i = binding.layout.index(name)
        if prior.value is None or i not in found or i in binding.priors:
            continue
        entry, estimate = binding.layout.entries[i], found[i]
        joint = entry.location or (binding.chain.signature.joints[0] if binding.chain.nq == 1 else "")
        std = estimate.std if estimate.identifiable and not estimate.at_bound else None
        deviation = (estimate.value - prior.value) / std if std else None
        out.append(
            Stated(
                joint, "", name, prior.value, estimate.value, std, deviation, sentence_of(name, prior.value, estimate, deviation)
            )
        )
    return tuple(sorted(out, key=lambda s: -abs(s.deviation or 0.0)))


def sentence_of(name: str, value: float, estimate: Estimate, deviation: float | None) -> str:
    """What the data say of one number as it is stated."""
    own = f"your stated {name} {number(value)}{'' if estimate.unit in ('', '1') else ' ' + estimate.unit}"
    if deviation is None:
        return f"{own} can be neither confirmed nor refuted: the data do not determine it"
    off = number(abs(deviation), 2)
    far = f"{off} standard deviation{'' if off == '1.0' else 's'} from {value_with_std(estimate)}"
    return f"{own} is {far}" if abs(deviation) > REFUTED else f"{own} agrees with the data: it is {far}"
