"""Two flexible links against energies, known frequencies, and a separately written integration in
SciPy.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

import jaxid
from jaxid.data.dataset import ModelSpec
from jaxid.dynamics.mechanism import equations_of_motion
from jaxid.dynamics.parameter import with_fields
from jaxid.models import FlexibleArm
from jaxid.numerics.precision import float64
from simulated import quick_jit


def arm_of(n_elements: int = 3, n_modes: int = 2, **numbers: float) -> FlexibleArm:
    arm = FlexibleArm(n_elements=n_elements, n_modes=n_modes)
    return with_fields(arm, {name: np.float64(value) for name, value in numbers.items()})


class Written:
    """The same arm once more, of point masses in the complex plane: M = sum m J' J, h = sum m J'
    Jdot v.

    Coordinates: q1, q2, and (u, theta) of the free nodes of both links. Nothing of it is taken from
    the product.
    """

    def __init__(self, arm: FlexibleArm):
        self.n, value = arm.n_elements, lambda name: float(getattr(arm, name))
        self.size, self.g = 2 + 4 * self.n, value("gravity")
        self.own = [slice(2 + 2 * k * self.n, 2 + 2 * (k + 1) * self.n) for k in (0, 1)]
        self.x, self.shape, self.slope = (
            [],
            [],
            [],
        )  # of points along each link, the last one its tip
        self.m, self.turning = [], []
        self.K, self.D = np.zeros((2, self.size, self.size))
        nodes, weights = np.polynomial.legendre.leggauss(4)
        for k in (0, 1):
            L, area = value(f"L{k + 1}"), value(f"b{k + 1}") * value(f"h{k + 1}")
            rho, EI = (
                value(f"rho{k + 1}") * area,
                value(f"E{k + 1}") * area * value(f"h{k + 1}") ** 2 / 12,
            )
            x = np.array([*(np.arange(self.n)[:, None] + (nodes + 1) / 2).ravel() * L / self.n, L])
            w = np.array([*np.tile(weights * L / self.n / 2, self.n), 0.0])
            rows = np.stack([self.rows(L / self.n, v) for v in x], 1)
            carried, inertia = (
                (value("m_h"), value("J_h")) if k == 0 else (value("m_p"), value("J_p"))
            )
            self.x.append(x)
            self.shape.append(rows[0])
            self.slope.append(rows[1][-1])
            self.m.append(rho * w + carried * (x == L))
            self.turning.append((value(f"I_m{k + 1}"), inertia))
            bending = EI * (rows[2].T * w) @ rows[2]
            self.K[self.own[k], self.own[k]] = bending
            self.D[self.own[k], self.own[k]] = (
                value("alpha") * rho * (rows[0].T * w) @ rows[0] + value("beta") * bending
            )

    def rows(self, l, x):
        """Deflection, slope and curvature at x over the free nodes."""
        e = min(int(x / l), self.n - 1)
        s = x / l - e
        rows = np.zeros((3, 2 * self.n + 2))
        rows[:, 2 * e : 2 * e + 4] = (
            [1 - 3 * s**2 + 2 * s**3, l * s * (1 - s) ** 2, s**2 * (3 - 2 * s), l * s**2 * (s - 1)],
            [6 * s * (s - 1) / l, (1 - s) * (1 - 3 * s), 6 * s * (1 - s) / l, s * (3 * s - 2)],
            [(12 * s - 6) / l**2, (6 * s - 4) / l, (6 - 12 * s) / l**2, (6 * s - 2) / l],
        )
        return rows[:, 2:]

    def places(self, p):
        """Positions of all points, how they move with each coordinate [points, size], and how what
        turns does [4, size].
        """
        at, angle = 0j, 0.0
        moves, turns = np.zeros(self.size, complex), np.zeros(self.size)
        where, J, T = [], [], []
        for k in (0, 1):
            angle, turns = angle + p[k], turns + np.eye(self.size)[k]
            T.append(turns)
            bent = np.exp(1j * angle) * (self.x[k] + 1j * self.shape[k] @ p[self.own[k]])
            rows = moves + 1j * bent[:, None] * turns
            rows[:, self.own[k]] += 1j * np.exp(1j * angle) * self.shape[k]
            where.append(at + bent)
            J.append(rows)
            at, moves, angle = where[-1][-1], rows[-1], angle + self.slope[k] @ p[self.own[k]]
            turns = turns.copy()
            turns[self.own[k]] += self.slope[k]
            T.append(turns)
        return np.concatenate(where), np.concatenate(J), np.array(T)

    def tip(self, p):
        return self.places(p)[0][-1]

    def force(self, p, v, tau, d=1e-5):
        """M, and tau - h - K psi - D psid."""
        m, inertia = np.concatenate(self.m), np.ravel(self.turning)
        _, J, T = self.places(p)
        M = np.real((J.conj().T * m) @ J) + (T.T * inertia) @ T
        along = (self.places(p + d * v)[1] - self.places(p - d * v)[1]) @ v / (2 * d)
        h = np.real(J.conj().T @ (m * along)) - self.g * np.real(J).T @ m
        return M, np.concatenate([tau, np.zeros(self.size - 2)]) - h - self.K @ p - self.D @ v


def torque(t):
    return np.array([0.8 * np.sin(3 * t) + 0.2, 0.25 * np.sin(5 * t + 1)])


@pytest.mark.parametrize("gravity", [pytest.param(0.0, marks=pytest.mark.slow), 9.81])
def test_the_step_against_an_integration(gravity):
    """Strong bends (tip angles of tenths of a radian), in both planes; the error of a step shrinks
    with its square.
    """
    with float64():
        arm = arm_of(2, 0, gravity=gravity, E1=2e10, E2=2e10)
        peer = Written(arm)
        x0 = [np.asarray(v) for v in arm.start(jnp.array([0.3, -0.5]), jnp.zeros(2))]
        links = arm.links()
        nodal = np.concatenate(
            [np.asarray(l.shapes) @ x0[2].reshape(2, -1)[k] for k, l in enumerate(links)]
        )
        p0 = np.concatenate([x0[0], nodal])

        def slope(t, s):
            p, v = np.split(s, 2)
            M, f = peer.force(p, v, torque(t))
            return np.concatenate([v, np.linalg.solve(M, f)])

        T = 0.3
        fine = solve_ivp(
            slope,
            (0, T),
            np.concatenate([p0, np.zeros_like(p0)]),
            method="Radau",
            rtol=1e-7,
            atol=1e-9,
        )
        end = fine.y[:, -1]
        assert np.abs(end[2 : peer.size]).max() > 0.01

        def ours(steps):
            h = T / steps
            ready = arm.prepare(h)

            def one(x, t):
                free = ready.free(
                    h, x, jnp.stack([0.8 * jnp.sin(3 * t) + 0.2, 0.25 * jnp.sin(5 * t + 1)])
                )
                return ready.close(h, x, free, jnp.zeros(2), free.qd, jnp.zeros(2)), None

            times = (jnp.arange(steps) + 0.5) * h
            x, _ = quick_jit(lambda x: jax.lax.scan(one, x, times))(
                arm.start(jnp.array([0.3, -0.5]), jnp.zeros(2))
            )
            return np.asarray(x[0]), complex(
                *np.asarray(ready.output(x, jnp.zeros(2), jnp.zeros(2, bool))[4:])
            )

        errors = []
        for steps in (300, 600):
            q, tip = ours(steps)
            errors.append(max(np.abs(q - end[:2]).max(), abs(tip - peer.tip(end[: peer.size]))))
        assert errors[1] < 2e-4 and errors[1] < 0.35 * errors[0]


def test_the_matrices_are_those_of_the_energies():
    """Lagrange's equations by automatic differentiation of the energies."""
    rng = np.random.default_rng(0)
    with float64():
        arm = arm_of(gravity=9.81, J_p=1e-3)

        def lagrangian(p, pd):
            return arm.kinetic_energy(p, pd) - arm.potential_energy(p)

        @quick_jit
        def both(p, pd):
            return arm.matrices(p, pd), equations_of_motion(lagrangian, p, pd)

        for _ in range(2):
            p, pd = (
                jnp.array(rng.normal(size=6) * [1, 1, 0.1, 0.02, 0.1, 0.02]),
                jnp.array(rng.normal(size=6) * 3),
            )
            for own, known in zip(*both(p, pd), strict=True):
                np.testing.assert_allclose(
                    np.asarray(own), np.asarray(known), rtol=1e-9, atol=1e-10
                )


def test_welded_and_straight_it_is_one_beam():
    """Cantilever of the double length: (beta L)^2 sqrt(EI / (rho A L^4)), beta L = 1.8751, 4.6941,
    7.8548.
    """
    same = dict(L1=0.5, L2=0.5, h1=0.003, h2=0.003, b1=0.05, b2=0.05, E1=7e10, E2=7e10)
    with float64():
        arm = arm_of(6, 0, **same, m_h=0.0, J_h=0.0, m_p=0.0, I_m1=0.0, I_m2=0.0)
        n = 2 + 2 * 12
        M, _ = arm.matrices(jnp.zeros(n), jnp.zeros(n))
        K, _ = arm._elastic()
    found = np.sqrt(eigh(np.asarray(K), np.asarray(M)[2:, 2:], eigvals_only=True)[:3])
    known = np.array([1.87510407, 4.69409113, 7.85475744]) ** 2 * np.sqrt(
        7e10 * 0.003**2 / 12 / 2700.0
    )
    np.testing.assert_allclose(found, known, rtol=3e-4)


def test_energy_stays_where_nothing_brakes():
    with float64():
        arm = arm_of(alpha=0.0, beta=0.0, gravity=9.81)
        h, ready = 1e-3, arm.prepare(1e-3)

        def energy(x):
            p, v = jnp.concatenate([x[0], x[2]]), jnp.concatenate([x[1], x[3]])
            return ready.kinetic_energy(p, v) + ready.potential_energy(p) + ready.strain_energy(p)

        def one(x, _):
            free = ready.free(h, x, jnp.zeros(2))
            x = ready.close(h, x, free, jnp.zeros(2), free.qd, jnp.zeros(2))
            return x, energy(x)

        start = arm.start(jnp.array([1.2, -0.4]), jnp.zeros(2))
        _, over = jax.jit(lambda x: jax.lax.scan(one, x, None, 2000))(start)
        scale = float(
            ready.potential_energy(jnp.array([np.pi, 0, 0, 0, 0, 0]))
            - ready.potential_energy(jnp.zeros(6))
        )
        before = float(energy(start))
    assert np.abs(np.asarray(over) - before).max() < 2e-3 * scale


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_its_numbers_are_recovered_with_their_intervals():
    """From angles and strains under torque, with noise; the motion is SciPy's."""
    truth = dict(E1=6.2e10, E2=7.9e10, I_m1=0.013, I_m2=0.0014, alpha=0.5, beta=2e-4)
    t = np.arange(0, 2.0, 0.004)
    held = np.stack([torque(s) for s in t])
    viscous = np.array([0.02, 0.01])
    with float64():
        arm = arm_of(3, 2, **truth).prepare(None)
        field = jax.jit(
            lambda s, u: jnp.concatenate(arm.vector_field(0.0, parts(s), u - viscous * parts(s)[1]))
        )
        read = jax.jit(lambda s: arm.output(parts(s), jnp.zeros(2), jnp.zeros(2, bool))[:4])
        states = [np.zeros(12)]
        for a, b, u in zip(t[:-1], t[1:], held[:-1], strict=True):
            got = solve_ivp(
                lambda _, s, u=u: np.asarray(field(s, u)),
                (a, b),
                states[-1],
                method="LSODA",
                rtol=1e-8,
                atol=1e-11,
            )
            states.append(got.y[:, -1])
        y = np.stack([np.asarray(read(s)) for s in states])
    noise = {"q1": 1e-4, "q2": 1e-4, "strain1": 1e-6, "strain2": 1e-6}
    rng = np.random.default_rng(5)
    y = y + rng.normal(size=y.shape) * list(noise.values())
    data = jaxid.Dataset.from_arrays(
        t,
        {"tau1": held[:, 0], "tau2": held[:, 1]},
        dict(zip(noise, y.T, strict=True)),
        at_rest=True,
        noise_std=noise,
        units={"strain1": "1", "strain2": "1"},
        model=ModelSpec("flexible_arm", constants={"coulomb1": 0.0, "coulomb2": 0.0}),
    )
    fit = jaxid.fit(None, data, fitter="lm(restarts=0)")
    assert fit.loss < 1.2
    for name, value in {**truth, "viscous1": viscous[0], "viscous2": viscous[1]}.items():
        found = fit.parameters[name]
        assert found.std is not None and abs(found.value - value) < 3.5 * found.std, (name, found)


def parts(s):
    """q, qd, modes' deflections and speeds of a flat state."""
    return s[:2], s[2:4], s[4:8], s[8:]
