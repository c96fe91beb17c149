"""A cause in its own terms: every effect of the library says where it acts, what it is, and what to look for."""

from __future__ import annotations

import re

import numpy as np
import pytest

from jaxid import catalogue
from jaxid.diagnosis.cause import span, variable, words
from jaxid.dynamics.parameter import specs
from jaxid.fitting.result import EffectEstimate, Estimate
from jaxid.report import binned


def estimate(name: str, value: float = 0.25, std: float | None = 0.01) -> EffectEstimate:
    own = specs(catalogue.effect_class(name))
    return EffectEstimate(name, "q", {k: Estimate(value, std, "N m", -1e9, 1e9) for k in own})


@pytest.mark.parametrize("name", catalogue.effect_names())
def test_every_effect_speaks(name):
    kind, found = catalogue.effect_class(name), estimate(name)
    assert variable(found) in ("speed", "position", "load", "command", "acceleration", "reading", "time")
    for field in ("seen", "plain", "check"):
        told = words(found, field)
        assert told and "{" not in told and "0.25000" not in told
        used = {part.split(":")[0] for part in re.findall(r"{([^}]*)}", getattr(kind, field))}
        assert used <= set(found.parameters), field
    assert words(found, "plain")[-1] == words(found, "check")[-1] == "." and words(found, "seen")[-1] != "."
    assert words(EffectEstimate("of_my_own", "q", found.parameters), "plain") == ""
    limits = span(found)
    assert limits is None or limits[0] is None or limits[1] is None or limits[0] < limits[1]


def test_numbers_bear_as_many_digits_as_are_known():
    known = lambda value, std: words(estimate("dead_zone", value, std), "plain")
    for value, std, told in ((0.2969, 0.0026, "0.297"), (0.31, 0.15, "0.3"), (0.0999951, 7e-6, "0.1000"), (0.25, None, "0.250")):
        assert f"needs {told} N m" in known(value, std)


def test_means_count_visits_not_samples():
    """A law is found within its intervals, which do not shrink because neighbours in time say the same."""
    rng = np.random.default_rng(0)
    slow = np.repeat(rng.standard_normal(300), 20)  # noise that lasts twenty samples
    x = np.sin(np.arange(6000) / 150)
    edges = np.linspace(-0.95, 0.95, 11)
    m = binned.means([(x, np.tanh(4 * x) + slow, np.ones(6000, bool))], edges)
    assert len(m.x) == 10 and np.mean(np.abs(m.mean - np.tanh(4 * m.x)) < m.half) >= 0.7
    once = binned.means([(np.linspace(-0.95, 0.94, 6000), slow, np.ones(6000, bool))], edges)
    assert len(once.x) == 10 and np.isnan(once.half).all()  # a mean that was seen once has no interval
    none = binned.means([(x, slow, np.zeros(6000, bool))], edges)
    assert len(none.x) == len(none.mean) == len(none.half) == 0
