"""Fitters by their ids: what there is, and the one that a text such as `de(popsize=20)` means."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

from jaxid.base.errors import UsageError
from jaxid.dynamics.catalogue import pick, text_of
from jaxid.fitters import FITTERS
from jaxid.fitting.fitter import AbstractFitter
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.settings import configured, label_of, parsed, SettingInfo, settings_of


#: What `jaxid compare` runs where nothing is named.
COMPARED = ("lm", "hybrid", "de", "rde", "pso", "ga")
_TABLE: dict[str, type] = {f.name: f for f in FITTERS}


class FitterInfo(NamedTuple):
    name: str
    text: str
    settings: tuple[SettingInfo, ...]
    source: str


def fitter_names() -> tuple[str, ...]:
    return tuple(_TABLE)


def fitter_class(name: str) -> Any:
    """Raises `UsageError` with the nearest name for an unknown one."""
    return pick("fitter", _TABLE, name)


def describe_fitter(name: str) -> FitterInfo:
    kind = fitter_class(name)
    return FitterInfo(name, text_of(kind), tuple(settings_of(kind)), kind.source)


def fitter_of(text: str) -> Any:
    """The fitter that a text names, with its settings. Raises `UsageError` for a name or a value
    that does not fit.
    """
    name, values = parsed(text)
    return configured(fitter_class(name), values, text, fitter_of)


def labelled(
    fitters: Iterable[AbstractFitter | str] | None, budget: int | None, seconds: float | None
) -> list[tuple[str, AbstractFitter]]:
    """(label, fitter) of each; a population given by its id goes on for as long as the budget
    lasts. Raises `UsageError` for a name that does not exist, and for a fitter that knows no limit
    of time where one is given.
    """
    out: list[tuple[str, AbstractFitter]] = []
    for given in COMPARED if fitters is None else fitters:
        fitter = fitter_of(given) if isinstance(given, str) else given
        full = label_of(fitter)
        if (
            isinstance(given, str)
            and isinstance(fitter, AbstractPopulation)
            and "generations" not in parsed(given)[1]
        ):
            fitter = replace(
                fitter, generations=10**6 if budget is None else max(1, budget // fitter.offspring)
            )
        if seconds is not None and "seconds" not in inspect.signature(fitter.minimise).parameters:
            raise UsageError(
                f"the fitter {fitter.name} has no limit of time (an argument `seconds` of"
                " minimise): give a budget"
            )
        label, count = (
            full if isinstance(given, str) or fitter.name in dict(out) else fitter.name,
            2,
        )
        while label in dict(out):
            label, count = f"{full} {count}", count + 1
        out.append((label, fitter))
    if not out:
        raise UsageError("there is no fitter to compare; name some, such as lm,de")
    return out
