"""Programs of the engine: a process that simulates model after model keeps those it used last."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxid import engine
from jaxid.chain import Chain
from jaxid.models import FlexibleLink, Pendulum, PlanarArm
from jaxid.models.effects import CoulombFriction, InputDelay
from simulated import Simulator


def test_programs_do_not_pile_up(monkeypatch):
    """What was put away is made anew, and gives the same bits."""
    monkeypatch.setattr(engine, "KEPT", 2)
    monkeypatch.setattr(engine, "_PROGRAMS", type(engine._PROGRAMS)())
    t = np.arange(200) / 100
    u = np.sin(3 * t)[:, None]
    sizes = [256, 512, 1024]
    runs = [Simulator(Chain(Pendulum()), t, u, step=1e-2, size=size) for size in sizes]
    before = [run.outputs([{}]) for run in runs]
    assert len(engine._PROGRAMS) == 2
    last = list(engine._PROGRAMS)[-1]
    assert np.array_equal(runs[0].outputs([{}]), before[0]) and len(engine._PROGRAMS) == 2
    assert last in engine._PROGRAMS and np.ptp(before[0]) > 0.1


@pytest.mark.parametrize("model", [Pendulum, PlanarArm, FlexibleLink])
def test_the_width_of_a_block_changes_no_bit(model):
    """A lane comes out the same in a call of few lanes and among many."""
    t = np.arange(200) / 200
    chain = Chain(model(), [CoulombFriction(level=jnp.asarray(0.02)), InputDelay(delay=jnp.asarray(0.01))])
    u = 0.3 * np.sin(7 * t)[:, None] * np.ones(len(chain.signature.inputs))
    run = Simulator(chain, t, u, step=5e-3)
    theta = np.tile(run.layout.values, (engine.LANES + 8, 1))
    theta *= 1 + np.linspace(0.0, 0.2, len(theta))[:, None]
    many, few = run.outputs(theta), run.outputs(theta[:3])
    assert engine.FEW < engine.LANES and np.array_equal(many[:3], few) and np.ptp(many[:, -1]) > 0
