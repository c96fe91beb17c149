"""Programs of the engine: a process that simulates model after model keeps those it used last."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxid.dynamics.chain import Chain
from jaxid.models import FlexibleLink, Pendulum, PlanarArm
from jaxid.models.effects import Backlash, CoulombFriction, DeadZone, InputDelay, SensorLag
from jaxid.numerics import kept as programs
from jaxid.simulation import batch as engine
from jaxid.simulation.rollout import simulate_rollout
from simulated import Simulator


def test_programs_do_not_pile_up(monkeypatch):
    """What was put away is made anew, and gives the same bits."""
    monkeypatch.setattr(programs, "MOST", 2)
    monkeypatch.setattr(programs, "_KEPT", type(programs._KEPT)())
    t = np.arange(200) / 100
    u = np.sin(3 * t)[:, None]
    sizes = [256, 512, 1024]
    runs = [Simulator(Chain(Pendulum()), t, u, step=1e-2, size=size) for size in sizes]
    before = [run.outputs([{}]) for run in runs]
    assert len(programs._KEPT) == 2
    last = list(programs._KEPT)[-1]
    assert np.array_equal(runs[0].outputs([{}]), before[0]) and len(programs._KEPT) == 2
    assert last in programs._KEPT and np.ptp(before[0]) > 0.1


@pytest.mark.parametrize("model", [Pendulum, PlanarArm, FlexibleLink])
def test_how_many_lanes_there_are_changes_no_bit(model):
    """A lane comes out the same in a call of few lanes and among many."""
    t = np.arange(200) / 200
    chain = Chain(
        model(), [CoulombFriction(level=jnp.asarray(0.02)), InputDelay(delay=jnp.asarray(0.01))]
    )
    u = 0.3 * np.sin(7 * t)[:, None] * np.ones(len(chain.signature.inputs))
    run = Simulator(chain, t, u, step=5e-3)
    theta = np.tile(run.layout.values, (2 * engine.LANES + 8, 1))
    theta *= 1 + np.linspace(0.0, 0.2, len(theta))[:, None]
    many, few = run.outputs(theta), run.outputs(theta[:3])
    assert np.array_equal(many[:3], few) and np.ptp(many[:, -1]) > 0


def test_a_program_is_compiled_once_also_where_the_first_call_was_interrupted():
    """Two threads that need it at once wait for one another; what an interrupt leaves undone, the
    next call does.
    """
    t = np.arange(200) / 200
    run = Simulator(Chain(Pendulum()), t, 0.3 * np.sin(7 * t)[:, None], step=5e-3, size=1024)
    programs, _ = run.engine._programs_of(frozenset())
    name = "outputs"
    programs.ready.clear()
    with pytest.raises(KeyboardInterrupt), programs.first_call(name):
        assert programs.in_hand(name)
        raise KeyboardInterrupt
    assert not programs.in_hand(name) and name not in programs.ready
    with ThreadPoolExecutor(2) as threads:
        one, other = threads.map(lambda _: run.outputs([{}]), range(2))
    assert name in programs.ready and np.array_equal(one, other)
    before = run.engine.compile_time_s
    run.outputs([{}])
    assert run.engine.compile_time_s == before > 0


def test_a_call_that_does_not_come_again_needs_one_program_for_what_would_need_many(monkeypatch):
    """Several effects of two families each run in the program of all, and come out as in programs
    of their own.
    """
    chain = Chain(Pendulum()).with_effects(DeadZone(), Backlash(), SensorLag())
    t = np.arange(200) / 100
    run = Simulator(chain, t, 0.4 * np.sin(3 * t)[:, None], step=1e-2, size=512)
    both = (
        {"dead_zone.width@tau": 0.05, "sensor_lag.lag@q": 0.03},
        {"dead_zone.width@tau": 0.05, "backlash.play@q": 0.02},
    )
    theta = np.array([run.theta(v) for v in ({}, *both)])
    busy = theta != np.array([e.spec.value for e in run.layout.entries])
    none, *mixed = groups = run.engine._at_work(busy)
    steps, everything = np.full(3, 200), frozenset(run.engine._families)
    merged = run.engine._merged(groups, steps)
    assert not none and {k: v.tolist() for k, v in merged.items()} == {
        none: [0],
        everything: [1, 2],
    }
    assert run.engine._merged({mixed[0]: np.array([1])}, steps) == {
        mixed[0]: np.array([1])
    }  # one is compiled as it is
    args = theta, np.zeros((3, 2)), np.zeros(3, int)
    np.testing.assert_allclose(
        run.engine.outputs(*args, once=True), run.engine.outputs(*args), rtol=0, atol=1e-12
    )
    monkeypatch.setattr(engine, "ONCE", 300)
    assert run.engine._merged(groups, steps) is groups


def test_only_what_remembers_follows_the_motion_before_a_record():
    """Lanes of which nothing remembers start at the record itself; they come out as if they had
    followed the motion up to it.
    """
    chain = Chain(Pendulum()).with_effects(DeadZone(), Backlash(), SensorLag())
    t = np.arange(300) / 100
    u = 0.4 * np.sin(3 * t)[:, None]
    run = Simulator(chain, t, u, step=1e-2, size=512)
    x = np.column_stack([0.3 * np.cos(3 * t), -0.9 * np.sin(3 * t)])
    record = replace(
        run.engine.records[0], offset=100, count=200, lead=100, samples=np.arange(100, 300)
    )
    samples = run.engine.samples._replace(
        x=np.pad(x, [(0, len(run.engine.samples.t) - 300), (0, 0)], mode="edge")
    )
    nothing_stated = np.full((1, len(run.layout)), np.nan)
    sparing, whole = (
        engine.BatchSimulator(
            run.layout, samples, [record], nothing_stated, simulate_rollout, 512, w
        )
        for w in (False, True)
    )
    sets = [
        run.theta(v)
        for v in (
            {"dead_zone.width@tau": 0.05},
            {"sensor_lag.lag@q": 0.03},
            {"backlash.play@q": 0.02},
        )
    ]
    theta, start, at = np.array(sets), np.tile(x[100], (3, 1)), np.zeros(3, int)
    busy = theta != np.array([e.spec.value for e in run.layout.entries])
    assert (
        sparing._where(busy, at)[:, 3].tolist() == [0, 0, 100]
        and whole._where(busy, at)[:, 3].tolist() == [100] * 3
    )
    found, expected = (e.outputs(theta, start, at)[:, :200] for e in (sparing, whole))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    assert np.abs(found[2] - found[0]).max() > 1e-3 and np.ptp(found[:, :, 0], 1).min() > 0.1
