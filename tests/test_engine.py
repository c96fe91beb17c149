"""Programs of the engine: a process that simulates model after model keeps those it used last."""

import numpy as np

from jaxid import engine
from jaxid.chain import Chain
from jaxid.models import Pendulum
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
