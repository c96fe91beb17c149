"""The check of a robot whose limbs do not move each other: each is fitted by itself, as the whole
would be.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import jaxid
from jaxid.conventions.by_limb import FitByLimb, force_fit
from jaxid.conventions.checking import run_check
from jaxid.conventions.missing_force import ForceFit, measured, NEIGHBOURS
from jaxid.conventions.readings import exchanged, scaled_joint
from jaxid.problem.binding import bind
from jaxid.robots.limbs import limbs_of
from simulated import Simulator
from test_robot_goals import limb, recording, robot, swinging


TWO = (limb("left"), limb("right", axis="0 1 0.3", x=0.5))


@pytest.fixture(scope="module")
def recorded() -> tuple[object, jaxid.Dataset]:
    model, dt = robot(*TWO), 0.01
    one = swinging(dt=dt)
    goal = np.concatenate([one, 0.7 * np.roll(one, 130)], axis=1)
    chain = bind(model, recording(model, goal, goal, dt), splits=False).chain
    own = Simulator(chain, dt * np.arange(len(goal)), goal)
    (q,) = own.outputs(own.layout.values[None])
    noise = 1e-4 * np.random.default_rng(0).standard_normal(q.shape)
    return model, recording(model, goal, q + noise, dt)


@pytest.mark.slow
def test_limbs_fitted_one_by_one_are_fitted_as_the_whole(recorded, monkeypatch):
    model, data = recorded
    binding = bind(model, data)
    motion = measured(binding, NEIGHBOURS)
    assert motion is not None
    whole, own = ForceFit(binding, motion), force_fit(binding, motion, limbs_of(model, data))
    assert isinstance(own, FitByLimb)
    changed = (scaled_joint(motion, 1, -1.0), exchanged(motion, 0, 1, inputs=True))
    for m in (motion, *changed):
        alike = 0.02 if m is motion else 0.2  # a reading that is wrong may be given up early
        for laws in (False, True):
            one, other = own.fit(m, laws), whole.fit(m, laws)
            assert one.x.shape == other.x.shape
            np.testing.assert_allclose(one.left, other.left, rtol=alike)
            np.testing.assert_allclose(one.held, other.held, rtol=2 * alike)
            assert own.noise(one, binding, m) == pytest.approx(
                whole.noise(other, binding, m), rel=0.05
            )
    fits = []
    plain = ForceFit.fit
    monkeypatch.setattr(
        ForceFit, "fit", lambda self, *a, **k: fits.append(self.nq) or plain(self, *a, **k)
    )
    own.fit(scaled_joint(motion, 1, -2.0))
    assert len(fits) == 2  # of the limb that it changes, on few rows and on all


@pytest.mark.slow
def test_a_sign_within_a_limb_and_joints_of_two_limbs_exchanged_are_found(recorded):
    model, data = recorded
    (run,) = data.experiments
    turned = replace(data, experiments=(replace(run, y=run.y * [1.0, -1.0]),))
    (found,) = [f for f in run_check(model, turned).findings if f.kind == "sign"]
    assert (found.channel, found.decisive) == ("right", True)
    other = replace(data, experiments=(replace(run, y=run.y[:, ::-1].copy()),))
    (found,) = run_check(model, other).findings
    assert found.kind == "swapped_channels"
    assert not [f for f in run_check(model, data).findings]


def test_a_sign_that_stated_numbers_do_not_tell_is_asked_with_its_equal(recorded):
    """The weight may have either sign where the file is as far off with both."""
    _, data = recorded
    unweighted = robot(*(text.replace('pos="0.1 0.02', 'pos="0 0.02') for text in TWO))
    (run,) = data.experiments
    turned = replace(data, experiments=(replace(run, y=run.y * [1.0, -1.0]),))
    (found,) = [f for f in run_check(unweighted, turned).findings if f.kind == "sign"]
    assert not found.decisive and not found.applied
    assert {found.channel, *(channel for _, channel in found.same_as)} == {"right", "right_cmd"}
