"""Which of a result's numbers stay as the file has them: all but the smallest change that the data
ask for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jaxid.base.wording import value_with_std
from jaxid.numerics.stated_numbers import BoundedEstimates, smallest_change
from jaxid.robots.export.outcome import AS_STATED, ExportOutcome, Named, Number, number, tables


def kept(found: ExportOutcome) -> ExportOutcome:
    """The result with those of the file's numbers that its data do not refute as the file has them,
    and the others as they are beside these, with the digits that they bear: what trades for a
    number that stays is moved along with it.
    """
    stated = _stated(found)
    every = dict(found.parameters)
    for e in found.effects:
        every |= {_name(e, k): n for k, n in e.numbers.items()}
    names, known = _known(found, every)
    change = smallest_change(known, np.array([stated.get(k, np.nan) for k in names], float))
    refuted = {names[k] for k in change.refuted}
    left = {k for k in stated if k in names and k not in refuted}
    if _unexplained(found):
        left |= {k for k in stated if k not in names}
    left |= {k for k, value in stated.items() if found.parameters[k].value == value}
    moved = {}
    for k, name in enumerate(names):
        moved[name] = replace(every[name], value=float(change.value[k]), std=float(change.std[k]))
    numbers = {}
    for k, n in found.parameters.items():
        numbers[k] = _as_stated(n, stated[k]) if k in left else _rounded(moved.get(k, n))
    effects = []
    for e in found.effects:
        own = {k: _rounded(moved.get(_name(e, k), n)) for k, n in e.numbers.items()}
        effects.append(replace(e, numbers=own))
    return replace(found, parameters=numbers, effects=tuple(effects))


def _name(e: Named, field: str) -> str:
    """How the covariance calls a number of an effect."""
    return f"{e.effect}.{field}@{e.location}"


def _stated(found: ExportOutcome) -> dict[str, float]:
    """What the file, or the dataset, states of the numbers that were fitted, by their names."""
    out: dict[str, float] = {}
    for row in tables(found.content.get("stated")):
        kind = row.get("parameter")
        for name in (f"{kind}@{row.get('link')}", f"{kind}@{row.get('joint')}", str(kind)):
            if name in found.parameters and name not in out:
                out[name] = number(f"stated {name}", row.get("stated"))
    return out


def _unexplained(found: ExportOutcome) -> bool:
    which = found.content.get("which")
    return isinstance(which, Mapping) and which.get("verdict") == "unknown"


def _known(found: ExportOutcome, every: Mapping[str, Number]) -> tuple[list[str], BoundedEstimates]:
    """(names, what is known of them): all that the covariance holds, else those with a standard
    deviation, as independent.
    """
    size = np.diag(found.covariance) if found.covariance.size else np.zeros(0)
    held = [
        k
        for k, name in enumerate(found.names)
        if name in every and np.isfinite(size[k]) and size[k] > 0
    ]
    names, matrix = [found.names[k] for k in held], found.covariance[np.ix_(held, held)]
    alone = [name for name, n in every.items() if n.std and name not in names]
    names += alone
    whole = np.zeros((len(names), len(names)))
    whole[: len(held), : len(held)] = matrix
    for k, name in enumerate(alone, start=len(held)):
        whole[k, k] = _variance(every[name])
    value, lower, upper = (_each(every, names, k) for k in ("value", "lower", "upper"))
    return names, BoundedEstimates(value=value, covariance=whole, lower=lower, upper=upper)


def _variance(n: Number) -> float:
    return (n.std or 0.0) ** 2


def _each(every: Mapping[str, Number], names: Sequence[str], field: str) -> np.ndarray:
    return np.array([getattr(every[name], field) for name in names], float)


def _as_stated(n: Number, stated: float) -> Number:
    told = value_with_std(n) if n.std is not None else "nothing"
    return replace(n, value=stated, kept=f"{AS_STATED}: the data say {told}")


def _rounded(n: Number) -> Number:
    """With two digits more than its standard deviation has."""
    if n.std is None or not n.std > 0:
        return n
    return replace(n, value=float(round(n.value, int(2 - np.floor(np.log10(n.std))))))
