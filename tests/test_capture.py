"""A target that is caught by a robot on a free base, found by angular momentum."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import jaxid
from benchmarks import capture
from floating_twin import catch
from jaxid.fitting.change import ParameterChange, Series, suspected, unexplained
from jaxid.fitting.problem_builder import ProblemBuilder, start_values
from jaxid.problem.binding import bind, resolve_model
from jaxid.problem.momentum import Momentum, of_a_body, sides


KNOWN: dict[str, Any] = {"mass@a2": (1.1,), "com_x@a2": (0.15,)}


@pytest.mark.parametrize("caught", [True, False])
def test_a_catch_is_noticed_and_nothing_else(caught: bool):
    """The target brings momentum: without a word about it the numbers of the whole run would be
    wrong and look sure.
    """
    run = catch(3, caught=caught)
    binding = bind(None, capture.recorded(run, 3, numbers=KNOWN))
    own = [i for i in binding.free if of_a_body(binding.layout, i)]
    found = suspected(Series.of(binding, Momentum()), own, binding.theta)
    assert (found is not None) == caught
    if found is not None:
        assert abs(found[0] - 0.01 * run.at) < 0.2 and found[1] > 0.9


def test_what_momentum_cannot_tell_of_a_change():
    data = capture.recorded(catch(3), 3)
    with pytest.raises(jaxid.UsageError, match="step_change@damping@j1 changes no number of one"):
        ParameterChange.of(bind(None, data, effects=["step_change@damping@j1"], splits=False))
    changed = bind(None, data, effects=["step_change@mass@a2"], splits=False)
    with pytest.raises(jaxid.UsageError, match="jaxid fit finds it"):
        Momentum().runs(data, data.experiments, changed.layout, changed.readings, None)
    change = ParameterChange.of(changed)
    told = unexplained(changed, change, 46.7)
    assert (
        "46.7 times the noise" in told
        and "step_change@com_x@a2" in told
        and "step_change@mass@a2" not in told
    )
    assert (
        start_values(ProblemBuilder(changed), changed.free, 0, residual=Momentum())[0]
        is changed.theta
    )


def test_a_jump_of_speed_is_in_neither_side():
    """Each side is filtered where its own content ends: that of the jump would bring in noise of
    several times the frequency.
    """
    run = catch(5)
    data = capture.recorded(run, 5)
    chain = resolve_model(None, data)
    sigma = np.full(7, capture.NOISE)
    whole, cut = (Momentum(moment=s).rates(data, chain, sigma)[1] for s in (None, 0.01 * run.at))
    assert cut < 0.6 * whole
    assert [len(p) for p in sides(data.experiments[0], 0.01 * run.at, cut)] == [
        run.at,
        len(run.t) - run.at,
    ]
    assert [len(p) for p in sides(data.experiments[0], 0.3, cut)] == [len(run.t) - 30]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", [0, 1])
def test_when_and_what_is_caught(seed: int):
    """All ten numbers of the last body after the catch, and its moment."""
    found = capture.one(seed)
    assert found["state"] == "converged" and abs(found["time"] - found["truth"]) < 0.2
    assert all(abs(v) < 3.5 for v in found["off"].values() if v is not None)
    assert found["std"] < 0.05


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_fit_that_knows_of_no_catch_does_not_say_converged():
    fit = jaxid.fit(
        None,
        capture.recorded(catch(3), 3, numbers=KNOWN),
        residual="momentum",
        fitter="lm(restarts=0)",
    )
    assert fit.state == "stalled" and "something changed" in fit.stopped_because
    assert "--effect step_change@mass@a2 --effect step_change@com_x@a2" in fit.notes[0]
