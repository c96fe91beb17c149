"""Friction that grows with the gear's load: of the drive, of what is transmitted, or of both."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxid.base.errors import UsageError
from jaxid.cli.app import main
from jaxid.dynamics import catalogue
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Command
from jaxid.dynamics.parameter import specs
from jaxid.models import Pendulum, PlanarArm, SerialArm
from jaxid.models.effects import LoadDependentFriction, ReflectedInertia
from jaxid.numerics.precision import float64


SHARE = {"drive": 1.0, "transmitted": 0.0, "combined": 0.4}


def friction(load: str, mu: float = 0.2) -> LoadDependentFriction:
    return LoadDependentFriction(mu=mu, drive_share=SHARE[load], load=load)  # pyright: ignore[reportArgumentType]


def held(u) -> Command:
    return Command(jnp.zeros(()), jnp.asarray(1e-3), u, u, lambda d: u)


def test_the_setting_stands_in_the_id(capsys):
    kind = catalogue.effect_class("load_dependent_friction(load=transmitted)")
    assert (
        list(specs(kind)) == ["mu"]
        and kind().load == "transmitted"
        and kind.contains == ("load_dependent_friction",)
    )
    assert catalogue.effect_class("load_dependent_friction(load=combined)") is LoadDependentFriction
    assert (
        catalogue.enrolled(LoadDependentFriction(load="drive"))
        == "load_dependent_friction(load=drive)"
    )
    for wrong in (
        "load_dependent_friction(load=motor)",
        "load_dependent_friction(lod=drive)",
        "dead_zone(load=drive)",
    ):
        with pytest.raises(UsageError):
            catalogue.effect_class(wrong)
    assert main(["effects", "load_dependent_friction"]) == 0
    assert "drive, transmitted, combined" in capsys.readouterr().out


@pytest.mark.parametrize("load", SHARE)
@pytest.mark.parametrize("rotor", [0.0, 0.3])
@pytest.mark.parametrize("model", [Pendulum, PlanarArm, SerialArm])
def test_a_measured_motion_with_it_lacks_nothing(model, load, rotor):
    """M qdd + bias of a motion is what goes on to the links; the rotor before the gear is no load
    to it.
    """
    mechanism = model()
    n = len(mechanism.signatures[0].joints)
    rng = np.random.default_rng(n)
    q, qdd = rng.uniform(-1, 1, (2, n))
    qd = rng.uniform(0.1, 1, n)
    with float64():
        chain = Chain(mechanism, [ReflectedInertia(inertia=rotor), friction(load)])  # pyright: ignore[reportArgumentType]
        body = chain.body()
        needed = np.asarray(body.inverse(*map(jnp.asarray, (q, qd, qdd))))
        on = (
            np.asarray(mechanism.inverse(*map(jnp.asarray, (q, qd, qdd))))
            - np.asarray(mechanism.rotors()) * qdd
        )
        drive = needed
        for _ in range(80):
            drive = needed + 0.2 * np.abs(SHARE[load] * drive + (1 - SHARE[load]) * on)
        u = jnp.asarray(drive)
        missing, _ = chain.inverse(
            held(u),
            chain.start(jnp.asarray(q), jnp.asarray(qd), u).z,
            *map(jnp.asarray, (q, qd, qdd)),
        )
        assert np.allclose(missing, 0, atol=1e-9 * np.abs(drive).max())


@pytest.mark.parametrize("load", SHARE)
def test_a_simulation_and_the_differential_equation_have_it(load):
    """A pendulum that is pushed one way, against the equation solved for the acceleration."""
    with float64():
        mechanism = Pendulum()
        chain = Chain(mechanism, [friction(load)])
        J = float(mechanism.inverse(jnp.zeros(1), jnp.zeros(1), jnp.ones(1))[0])

        def weight(q):
            return float(mechanism.inverse(jnp.array([q]), jnp.zeros(1), jnp.zeros(1))[0])

        def acceleration(q: float, tau: float) -> float:
            net = tau
            for _ in range(60):
                net = tau - 0.2 * abs(SHARE[load] * tau + (1 - SHARE[load]) * net)
            return (net - weight(q)) / J

        tau = 2.0 * weight(1.0)
        field, smooth = chain.smoothed(1e-4).ode(), jnp.array([0.3])
        dx = field(0.0, (smooth, jnp.array([0.5])), (None, lambda t: jnp.array([tau])))
        assert np.allclose(jax.tree.leaves(dx)[1], acceleration(0.3, tau), rtol=1e-4)
        h, steps, q, v = 1e-3, 200, 0.3, 0.5
        command = held(jnp.array([tau]))
        body = chain.body().prepare(None)
        carry = chain.start(jnp.array([q]), jnp.array([v]), command.u)
        step = jax.jit(lambda carry: chain.step(body, carry, command)[0])
        for _ in range(steps):
            carry = step(carry)
            for _ in range(10):
                a = acceleration(q + 0.05 * h * v, tau)
                q, v = q + 0.1 * h * v + 0.005 * h * h * a, v + 0.1 * h * a
        found = [float(x[0]) for x in body.port(carry.x)]
        assert np.allclose(found, [q, v], rtol=2e-3)


def test_what_is_transmitted_is_worked_out_only_where_it_is_asked_for():
    plain, loaded = Chain(Pendulum(), []), Chain(Pendulum(), [friction("transmitted", 0.0)])
    assert not plain.transmits and loaded.transmits
    with float64():
        command = held(jnp.array([0.7]))
        carries = [c.start(jnp.array([0.2]), jnp.array([0.1]), command.u) for c in (plain, loaded)]
        assert carries[0].net == ()
        for _ in range(50):
            carries = [
                c.step(c.body(), x, command)[0]
                for c, x in zip((plain, loaded), carries, strict=True)
            ]
        plainly, neutrally = (np.asarray(jax.tree.leaves(c.x)) for c in carries)
        assert np.array_equal(plainly, neutrally)  # at no strength it is nothing, bitwise
