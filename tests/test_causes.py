"""A cause in its own terms: every effect of the library says where it acts, what it is, and what to
look for.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from jaxid.diagnosis.cause import on_slide, span, variable, words
from jaxid.diagnosis.result import MissingForce
from jaxid.dynamics import catalogue
from jaxid.dynamics.parameter import specs
from jaxid.fitting.result import EffectEstimate, Estimate
from jaxid.report import binned
from jaxid.report.missing_force import law_sentence


def estimate(name: str, value: float = 0.25, std: float | None = 0.01) -> EffectEstimate:
    own = specs(catalogue.effect_class(name))
    return EffectEstimate(name, "q", {k: Estimate(value, std, "N m", -1e9, 1e9) for k in own})


@pytest.mark.parametrize("name", catalogue.effect_names())
def test_every_effect_speaks(name):
    kind, found = catalogue.effect_class(name), estimate(name)
    assert variable(found) in (
        "speed",
        "position",
        "load",
        "command",
        "acceleration",
        "reading",
        "time",
    )
    for field in ("seen", "plain", "check"):
        told = words(found, field)
        assert told and "{" not in told and "0.25000" not in told
        used = {part.split(":")[0] for part in re.findall(r"{([^}]*)}", getattr(kind, field))}
        assert used <= set(found.parameters), field
    assert (
        words(found, "plain")[-1] == words(found, "check")[-1] == "."
        and words(found, "seen")[-1] != "."
    )
    assert words(EffectEstimate("of_my_own", "q", found.parameters), "plain") == ""
    limits = span(found)
    assert limits is None or limits[0] is None or limits[1] is None or limits[0] < limits[1]


def test_numbers_bear_as_many_digits_as_are_known():
    def known(value, std):
        return words(estimate("dead_zone", value, std), "plain")

    for value, std, told in (
        (0.2969, 0.0026, "0.297"),
        (0.31, 0.15, "0.3"),
        (0.0999951, 7e-6, "0.1000"),
        (0.25, None, "0.250"),
    ):
        assert f"needs {told} N m" in known(value, std)


def test_a_wave_number_is_said_as_its_period():
    ten = EffectEstimate(
        "torque_ripple", "q", {"order": Estimate(10.0, 0.01, "rad/rad", 0.0, 400.0)}
    )
    assert "once every 0.6283 rad" in words(ten, "seen")
    rail = EffectEstimate(
        "torque_ripple", "x", {"order": Estimate(10.0, 0.01, "rad/m", 0.0, 400.0)}
    )
    assert "once every 0.6283 m" in words(rail, "seen")


@pytest.mark.parametrize(
    ("variable", "law", "told"),
    [
        (
            "position",
            lambda q, qd: (0.3 + 0.1 * q) * np.sign(qd),
            (0.2, -1.0, 0.4, 1.0, -0.2, -1.0, -0.4, 1.0),
        ),
        ("speed", lambda q, qd: 0.1 * qd, (-0.1, -1.0, 0.1, 1.0)),
    ],
)
def test_what_the_effects_supply_is_said_with_its_size_and_place(variable, law, told):
    t = np.linspace(0, 200, 20001)
    q, qd = np.sin(t), np.cos(t)
    before = law(q, qd)
    force = MissingForce("q1", "N m", "rad", "rad/s", "run", t, q, qd, 0 * t, before, 0 * t, 0 * t)
    sentence = law_sentence([force], variable)
    found = [float(x.replace("−", "-")) for x in re.findall(r"[-−]?\d+\.\d+", sentence)]
    assert np.allclose(found, told, atol=0.08) and sentence.count("N m at") == len(told) // 2
    assert (
        law_sentence([replace(force, after=before)], variable)
        == ""
        == law_sentence([force], "reading")
    )


def test_means_count_visits_not_samples():
    """A law is found within its intervals, which do not shrink because neighbours in time say the
    same.
    """
    rng = np.random.default_rng(0)
    slow = np.repeat(rng.standard_normal(300), 20)  # noise that lasts twenty samples
    x = np.sin(np.arange(6000) / 150)
    edges = np.linspace(-0.95, 0.95, 11)
    m = binned.means([(x, np.tanh(4 * x) + slow, np.ones(6000, bool))], edges)
    assert len(m.x) == 10 and np.mean(np.abs(m.mean - np.tanh(4 * m.x)) < m.half) >= 0.7
    once = binned.means([(np.linspace(-0.95, 0.94, 6000), slow, np.ones(6000, bool))], edges)
    assert (
        len(once.x) == 10 and np.isnan(once.half).all()
    )  # a mean that was seen once has no interval
    none = binned.means([(x, slow, np.zeros(6000, bool))], edges)
    assert len(none.x) == len(none.mean) == len(none.half) == 0


@pytest.mark.parametrize(("force", "wave", "turns"), [("N m", "1", True), ("N", "rad/m", False)])
@pytest.mark.parametrize("name", ["position_dependent_friction", "torque_ripple"])
def test_a_slide_has_no_turns(name, force, wave, turns):
    numbers = {
        "sine": Estimate(1.0, 0.1, force, -9.0, 9.0),
        "cosine": Estimate(0.0, 0.1, force, -9.0, 9.0),
        "order": Estimate(12.0, 0.1, wave, 0.0, 99.0),
    }
    effect = EffectEstimate(name, "x", numbers)
    said = f"{words(effect, 'plain')} {words(effect, 'check')}".lower()
    assert on_slide(effect) == (not turns)
    assert any(word in said for word in ("turn", "revolution", "eccentric")) == turns
