"""Several machines of one kind: what their numbers have in common, and how far machines differ.

Each dataset of a study is one machine. A number x_i with its standard deviation s_i is taken to be
mean + difference + error, with differences of variance spread^2 between machines and errors of
variance s_i^2: the random effects model of a meta-analysis. Nothing is known beforehand of the mean
and the spread but that the spread is not negative. Everything that is said is of their posterior,
so that few machines give wide ranges.

Source: Gelman, Prior distributions for variance parameters in hierarchical models, Bayesian
Analysis 1, 2006 (uniform on the spread, proper from three groups on).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.stats import chi2, norm

from jaxid.base.serialise import finite


Array = np.ndarray

if TYPE_CHECKING:
    from jaxid.study.outcome import Outcome
    from jaxid.study.plan import Task
    from jaxid.study.run import StudyResult


#: Machines from which on a spread between them can be told.
FEWEST = 3
#: Points of the posterior of a spread.
GRID = 400
#: Machines differ where they would do so by chance less often than this.
BY_CHANCE = 0.01


@dataclass(frozen=True)
class CommonNumber:
    """One number over all machines of a kind.

    `mean` with its standard deviation `std`, `spread` the standard deviation between machines (the
    median of what it may be),
    `by_chance` the probability of such differences where machines are equal, `interval_95` where a
    further machine lies, within the bounds of the number. `each`: machine -> (value, standard
    deviation).
    """

    name: str
    unit: str
    mean: float
    std: float
    spread: float
    by_chance: float
    interval_95: tuple[float, float]
    each: Mapping[str, tuple[float, float]]

    @property
    def value(self) -> float:
        """The mean, as any estimate has its value."""
        return self.mean

    @property
    def differs(self) -> bool:
        """Whether the machines are not equal in it."""
        return self.by_chance < BY_CHANCE

    @property
    def furthest(self) -> str:
        """The machine that is furthest from the mean, in standard deviations of its own and of the
        spread together.
        """

        def away(machine: str) -> float:
            value, std = self.each[machine]
            return abs(value - self.mean) / np.hypot(std, self.spread)

        return max(self.each, key=away)

    def to_dict(self) -> dict[str, Any]:
        """As machines.json holds it."""
        each = {name: {"value": x, "std": s} for name, (x, s) in self.each.items()}
        return finite(vars(self) | {"interval_95": list(self.interval_95), "each": each})


@dataclass(frozen=True)
class Kind:
    """Machines of one kind: datasets with one model and the same effects, and the numbers that are
    known of at least `FEWEST` of them.
    """

    model: str
    effects: tuple[str, ...]
    machines: tuple[str, ...]
    numbers: tuple[CommonNumber, ...]

    def to_dict(self) -> dict[str, Any]:
        """As machines.json holds it; `numbers` by name."""
        return {
            "model": self.model,
            "effects": list(self.effects),
            "machines": list(self.machines),
            "numbers": {n.name: n.to_dict() for n in self.numbers},
        }


def common(
    name: str,
    unit: str,
    each: Mapping[str, tuple[float, float]],
    bounds: tuple[float, float] = (-np.inf, np.inf),
) -> CommonNumber:
    """One number of at least `FEWEST` machines: machine -> (value, standard deviation above 0).

    A number that is above 0 by its bounds differs by factors: its logarithm is looked at.
    """
    factors = bounds[0] > 0
    x, std = np.array(list(each.values()), float).T
    if factors:
        x, std = np.log(x), std / x
    spread, share, mean, variance = _posterior(x, std)
    further = np.sqrt(spread**2 + variance)  # standard deviation of a further machine
    low, high = _quantiles(share, mean, further, (0.025, 0.975))
    one_below, one_above = _quantiles(
        share, mean, np.sqrt(variance), norm.cdf((-1.0, 1.0)).tolist()
    )
    middle = int(np.searchsorted(np.cumsum(share), 0.5))
    alone = 1 / std**2
    apart = float(np.sum(alone * (x - np.sum(alone * x) / np.sum(alone)) ** 2))
    center = float(share @ mean)
    own_std, between = (one_above - one_below) / 2, float(spread[middle])
    if factors:
        center, low, high = np.exp((center, low, high)).tolist()
        own_std, between = center * own_std, center * between
    return CommonNumber(
        name=name,
        unit=unit,
        mean=center,
        std=own_std,
        spread=between,
        by_chance=float(chi2.sf(apart, len(x) - 1)),
        interval_95=(max(bounds[0], low), min(bounds[1], high)),
        each=dict(each),
    )


def _posterior(
    x: Float[np.ndarray, " n"], std: Float[np.ndarray, " n"]
) -> tuple[Array, Array, Array, Array]:
    """Spreads [k] with their probabilities, and the mean with its variance under each of them."""
    scale = np.median(std) + np.std(x)
    angle = (np.arange(GRID) + 0.5) * np.pi / 2 / GRID
    spread = scale * np.tan(angle)
    weight = 1 / (std**2 + spread[:, None] ** 2)
    variance = 1 / np.sum(weight, axis=1)
    mean = variance * (weight @ x)
    squares = np.sum(weight * (x - mean[:, None]) ** 2, axis=1)
    log_density = 0.5 * (np.log(variance) + np.sum(np.log(weight), axis=1) - squares)
    log_share = log_density - 2 * np.log(np.cos(angle))  # d spread / d angle
    share = np.exp(log_share - np.max(log_share))
    return spread, share / np.sum(share), mean, variance


def _quantiles(
    share: Array, mean: Array, std: Array, probabilities: Sequence[float]
) -> list[float]:
    """Quantiles of a mixture of normal distributions."""
    low = float(np.min(mean) - 9 * np.max(std))
    high = float(np.max(mean) + 9 * np.max(std))

    def beyond(value: float, probability: float) -> float:
        return float(share @ norm.cdf((value - mean) / std)) - probability

    near = 1e-13 * (high - low)
    found: list[float] = []
    for p in probabilities:
        root: Any = brentq(beyond, low, high, args=(p,), xtol=near)
        found.append(float(root))
    return found


def kinds(result: StudyResult) -> list[Kind]:
    """The kinds of machines of a study, each with at least `FEWEST` datasets. Of a dataset that was
    fitted several times the run with the lowest loss counts.
    """
    found: dict[tuple[str, tuple[str, ...]], dict[str, Outcome]] = defaultdict(dict)
    for key, outcome in result.outcomes.items():
        if outcome.failed or not outcome.result:
            continue
        task = result.study.tasks[key]
        own = found[task.system, _effects(task, outcome)]
        before = own.get(task.label)
        if before is None or _loss(outcome) < _loss(before):
            own[task.label] = outcome
    return [
        Kind(model, effects, tuple(machines), tuple(_numbers(machines)))
        for (model, effects), machines in found.items()
        if len(machines) >= FEWEST
    ]


def _effects(task: Task, outcome: Outcome) -> tuple[str, ...]:
    """Those of a fit as asked for, those of a diagnosis as named."""
    return tuple(task.effects or ()) if task.command == "fit" else tuple(outcome.named)


def _loss(outcome: Outcome) -> float:
    return np.inf if outcome.loss is None else outcome.loss


def _numbers(machines: Mapping[str, Outcome]) -> Iterator[CommonNumber]:
    each: dict[str, dict[str, tuple[float, float]]] = defaultdict(dict)
    about: dict[str, tuple[str, tuple[float, float]]] = {}
    for machine, outcome in machines.items():
        for name, number in _estimates(outcome.result or {}):
            if not number.get("std"):
                continue
            each[name][machine] = (number["value"], number["std"])
            about[name] = (number["unit"], (_end(number["lower"], -1), _end(number["upper"], 1)))
    for name, values in each.items():
        if len(values) >= FEWEST:
            unit, bounds = about[name]
            yield common(name, unit, values, bounds)


def _end(bound: float | None, side: int) -> float:
    return side * np.inf if bound is None else bound


def _estimates(result: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """(name, estimate) of the numbers of a fit.json or diagnosis.json, those of effects too."""
    yield from result.get("parameters", {}).items()
    effects: Sequence[Mapping[str, Any]] = result.get("effects", ())
    if "which" in result:
        effects = result["which"]["effects"]
    for effect in effects:
        for name, number in effect["parameters"].items():
            yield f"{effect['effect']}.{name}@{effect['location']}", number
