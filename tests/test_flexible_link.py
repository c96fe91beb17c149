"""The flexible link against separately written finite elements, the analytic beam, and SciPy and
diffrax integrations.
"""

from __future__ import annotations

import warnings
from math import pi
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import jaxid
from jaxid.data.dataset import Channel, Experiment, FrequencyResponse, ModelSpec
from jaxid.dynamics import beam
from jaxid.models import FlexibleLink
from jaxid.models.effects import GeometricStiffening, ViscousFriction
from jaxid.numerics.precision import float64
from jaxid.problem.frequency_response import FrequencyResponseError
from jaxid.problem.response_lines import merged
from jaxid.simulation.transfer import transfer
from jaxid.study.papers.twins.flexible_link import (
    AREA,
    DE,
    direct,
    elements,
    full,
    L,
    OWN,
    PAYLOAD,
    pulses,
    RHO,
    SECOND,
    zero_order_hold,
)
from simulated import flow, relative, Simulator


T = np.arange(2001) * 1e-3


# ---- matrices, energies, frequencies


def test_the_assembled_matrices_are_those_of_the_energies():
    """Lagrange by automatic differentiation is the definition; the closed forms and a separate
    assembly equal it.
    """
    with float64():
        values: dict[str, Any] = OWN | {"J_p": 2e-5}
        b = FlexibleLink(**values).beam()
        m = beam.matrices(b, 3)
        psi, psid = jnp.asarray(np.random.default_rng(1).normal(size=(2, 6)) * 1e-2)
        turning = jax.hessian(lambda x: beam.kinetic_energy(b, x[0], psi, x[1:], rotating=False))(
            jnp.ones(7)
        )
        bending = jax.hessian(lambda p: beam.strain_energy(b, p))(psi)
        geometric = jax.hessian(lambda p: beam.foreshortening_energy(b, 1.0, p))(psi)
        # The part that only a deflection's rotation adds is quadratic in it, with the beam's own
        # mass matrix.
        rotation = jax.hessian(
            lambda p: (
                beam.kinetic_energy(b, 1.0, p, psid) - beam.kinetic_energy(b, 1.0, p, psid, False)
            )
        )(psi)

    def close(a, b):
        return np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-12 * np.abs(b).max())

    close(turning[0, 0], m.inertia)
    close(turning[0, 1:], m.coupling)
    close(turning[1:, 1:], m.M)
    close(bending, m.K)
    close(geometric, m.geometric)
    with float64():
        slopeless = beam.matrices(b._replace(payload_inertia=0.0), 3)
    close(rotation, slopeless.M)
    Mp, Kp, c, J, G = elements(3, 2e-5)
    for own, ours in (
        (Mp, m.M),
        (OWN["E"] * Kp, m.K),
        (c, m.coupling),
        (J, m.inertia),
        (G, m.geometric),
    ):
        close(np.asarray(ours), own)


def frequencies(link: FlexibleLink) -> np.ndarray:
    """Coupled frequencies in Hz with a free hub, from the product's matrices."""
    with float64():
        m = [np.asarray(a) for a in beam.matrices(link.beam(), link.n_elements)]
    M = np.block([[np.array([[link.I_m + m[3]]]), m[2][None]], [m[2][:, None], m[0]]])
    K = np.zeros_like(M)
    K[1:, 1:] = m[1]
    return np.sqrt(np.abs(scipy.linalg.eigvalsh(K, M))) / 2 / pi


def analytic(count: int) -> list[float]:
    """Uniform beam, hub inertia at one end, point mass at the other: zeros of the boundary
    determinant, in Hz.
    """
    EI, m = DE["E"] * SECOND, RHO * AREA

    def determinant(f: float) -> float:
        w2 = (2 * pi * f) ** 2
        k = (m * w2 / EI) ** 0.25
        c, s, ch, sh = np.cos(k * L), np.sin(k * L), np.cosh(k * L), np.sinh(k * L)
        # y = a cos + b sin + p cosh + q sinh in a frame at rest: y(0) = 0, EI y'' = -I_m w2 y' at
        # 0, free end with a mass.
        rows = [
            [1, 0, 1, 0],
            [-EI * k**2, DE["I_m"] * w2 * k, EI * k**2, DE["I_m"] * w2 * k],
            [-c, -s, ch, sh],
            [
                EI * k**3 * s + PAYLOAD * w2 * c,
                -EI * k**3 * c + PAYLOAD * w2 * s,
                EI * k**3 * sh + PAYLOAD * w2 * ch,
                EI * k**3 * ch + PAYLOAD * w2 * sh,
            ],
        ]
        return float(
            np.linalg.det(
                np.array(rows) / np.array([[1], [EI * k**2 * ch], [ch], [EI * k**3 * ch]])
            )
        )

    grid, found = np.linspace(0.5, 500, 5000), []
    values = [determinant(f) for f in grid]
    for a, b, x, y in zip(grid, grid[1:], values, values[1:], strict=False):
        if x * y < 0:
            found.append(float(brentq(determinant, a, b)))  # type: ignore[arg-type]
    return found[:count]


def test_frequencies():
    exact = analytic(4)
    np.testing.assert_allclose(exact, [4.6512, 55.6944, 177.7266, 369.4368], rtol=2e-5)
    four, many = (frequencies(FlexibleLink(**OWN, n_elements=n))[1:5] for n in (4, 32))
    np.testing.assert_allclose(four[:2], [4.6512, 55.7294], rtol=2e-5)
    np.testing.assert_allclose(four[:2], exact[:2], rtol=1e-3)
    assert abs(four[0] / exact[0] - 1) < 1e-5
    np.testing.assert_allclose(many, exact, rtol=1e-5)


def test_centrifugal_terms_change_the_clamped_frequency():
    """Softening without, stiffening with the geometric term, by the figures derived for this
    link.
    """
    Mp, Kp, _, _, G = elements()
    with float64():
        for stiff, table in (
            (False, {3: 3.466, 5: 3.407, 10: 3.116}),
            (True, {3: 3.505, 5: 3.517, 10: 3.569}),
        ):
            values: dict[str, Any] = OWN | {"stiffening": float(stiff), "nonlinear": True}
            link = FlexibleLink(**values).prepare(None)
            for speed, f in table.items():
                still = jnp.zeros(8)
                K = -np.asarray(jax.jacfwd(link.pull, 1)(jnp.array([float(speed)]), still, still))
                assert np.sqrt(np.linalg.eigvals(K).real.min()) / 2 / pi == pytest.approx(
                    f, abs=6e-4
                )
                dense = DE["E"] * Kp - speed**2 * (Mp - stiff * G)
                assert np.sqrt(scipy.linalg.eigvalsh(dense, Mp)[0]) / 2 / pi == pytest.approx(
                    f, abs=6e-4
                )


@pytest.mark.parametrize("stiffening", [0.0, 1.0])
def test_energy_is_kept_for_20_seconds(stiffening):
    """Without damping and friction: hub at 8 rad/s, bent beam; kinetic and strain energy from the
    elements' integrals.
    """
    undamped: dict[str, Any] = OWN | {
        "alpha": 0.0,
        "beta": 0.0,
        "stiffening": stiffening,
        "n_elements": 1,
        "nonlinear": True,
    }
    with float64():
        model = FlexibleLink(**undamped).prepare(None)
        shapes = np.asarray(model.prepared[0].shapes)
        x0 = (jnp.zeros(1), jnp.array([8.0]), jnp.array([2e-3, 0.0]), jnp.zeros(2))
        end = flow(lambda x: model.vector_field(0.0, x, jnp.zeros(1)), x0, 20.0)

        def energy(x) -> float:
            _, w, e, z = x
            psi, psid = jnp.asarray(shapes @ np.asarray(e)), jnp.asarray(shapes @ np.asarray(z))
            b = model.beam()
            kinetic = beam.kinetic_energy(b, w[0], psi, psid) + DE["I_m"] * w[0] ** 2 / 2
            # Foreshortening lowers the inertia: it counts against the kinetic energy.
            return float(
                kinetic
                + beam.strain_energy(b, psi)
                - stiffening * beam.foreshortening_energy(b, w[0], psi)
            )

        assert abs(energy(end) - energy(x0)) < 1e-8 * energy(x0)


# ---- time


@pytest.fixture(scope="module")
def simulator():
    return Simulator(jaxid.Chain(FlexibleLink()), T, pulses(T)[:, None], 1e-3)


@pytest.mark.parametrize(
    ("tau_c", "phi", "acceleration"), [(0.0, 5e-6, 4e-4), (0.1071, 8e-5, 4e-4)]
)
def test_the_step_against_fine_steps_of_all_states(simulator, tau_c, phi, acceleration):
    y = simulator.outputs([DE | {"tau_c": tau_c}])[0]
    truth = zero_order_hold(pulses(T), 1e-3, 40, DE["v"], tau_c)
    assert relative(y[:, 0], truth[:, 0]) < phi
    assert relative(y[:, 1], truth[:, 1]) < acceleration


def test_the_hub_sticks(simulator):
    """After the pulse the hub stands exactly still while the beam rings at its clamped
    frequency.
    """
    y = simulator.outputs([DE | {"tau_c": 0.2}])[0]
    still = np.flatnonzero(np.diff(y[:, 0]) == 0)
    assert still.size > 300
    assert np.abs(y[still[-200:], 1]).max() > 0.05


@pytest.mark.parametrize("stiffening", [False, True])
def test_the_nonlinear_step_against_an_integration(stiffening):
    """Hub at 10 rad/s, bent beam: SciPy on dense nodal equations with h as the paper's text defines
    it.
    """
    Mp, Kp, c, J, G = elements(2)
    M0, C, K = full(n=2)
    S = Mp - stiffening * G
    t = np.arange(401) * 1e-3
    u = np.where(t < 0.1, 2.0, -0.6)

    def field(time, x):
        w, psi, psid = x[5], x[1:5], x[6:]
        M = M0.copy()
        M[0, 0] += psi @ S @ psi
        h = np.append(2 * w * (psi @ S @ psid), -(w**2) * (S @ psi))
        force = -C @ x[5:] - K @ x[:5] - h
        force[0] += 2.0 if time < 0.1 - 1e-12 else -0.6
        return np.append(x[5:], np.linalg.solve(M, force))

    first = solve_ivp(field, (0, 0.1), np.zeros(10), "Radau", t[:101], rtol=1e-9, atol=1e-12)
    second = solve_ivp(field, (0.1, 0.4), first.y[:, -1], "Radau", t[100:], rtol=1e-9, atol=1e-12)
    truth = np.append(first.y[0, :-1], second.y[0])
    chain = jaxid.Chain(FlexibleLink(n_elements=2, nonlinear=True, stiffening=stiffening))
    linear = jaxid.Chain(FlexibleLink(n_elements=2))
    added = jaxid.Chain(FlexibleLink(n_elements=2, nonlinear=True)).with_effects(
        GeometricStiffening()
    )
    values = [DE | {"v": 0.0, "tau_c": 0.0}]
    errors = [
        relative(Simulator(chain, t, u[:, None], h).outputs(values)[0, :, 0], truth)
        for h in (1e-3, 5e-4)
    ]
    assert errors[1] < 4e-5 and errors[1] < 0.3 * errors[0]
    as_effect = Simulator(added, t, u[:, None], 5e-4).outputs(
        [values[0] | {"geometric_stiffening.share@phi": float(stiffening)}]
    )
    assert relative(as_effect[0], Simulator(chain, t, u[:, None], 5e-4).outputs(values)[0]) < 1e-12
    assert relative(Simulator(linear, t, u[:, None], 5e-4).outputs(values)[0, :, 0], truth) > 0.01
    assert np.abs(np.diff(truth)).max() * 1e3 > 8  # rad/s: the terms count


@pytest.mark.slow
def test_the_step_against_an_implicit_solver_on_the_vector_field():
    """diffrax's Kvaerno5 on the model's own ODE, with smoothed friction in both."""
    t = np.arange(301) * 1e-3
    u = pulses(t)
    chain = jaxid.Chain(FlexibleLink(**OWN), smoothing_velocity=0.05)
    values = {"v": DE["v"], "tau_c": DE["tau_c"]}
    s = Simulator(chain, t, u[:, None], 2.5e-4, size=2048)
    y = s.outputs([values])[0, :, 0]
    with float64():
        model = s.layout.model(jnp.asarray(s.theta(values)))

        def held(time):
            return jnp.asarray(u)[jnp.clip(jnp.floor(time / 1e-3 + 1e-9).astype(int), 0, 300)][None]

        ode = model.ode()

        def field(time, x, args):
            return ode(time, x, (None, held))

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Kvaerno5(),
            0.0,
            0.3,
            1e-5,
            model.body().start(jnp.zeros(1), jnp.zeros(1)),
            saveat=diffrax.SaveAt(ts=jnp.asarray(t)),
            max_steps=100_000,
            stepsize_controller=diffrax.ClipStepSizeController(
                diffrax.PIDController(rtol=1e-8, atol=1e-10), jump_ts=jnp.array([0.1])
            ),
        )
        assert solution.ys is not None
        truth = np.asarray(solution.ys[0])[:, 0]
    assert relative(y, truth) < 2e-5


# ---- frequency


def test_frequency_response_against_a_direct_solve():
    f = np.arange(0.2, 50.01, 0.2)
    truth = direct(f)
    assert abs(truth[4]) == pytest.approx(21.98, abs=0.01) and f[
        np.abs(truth).argmax()
    ] == pytest.approx(4.6)
    with float64():
        chain = jaxid.Chain(FlexibleLink(**OWN)).with_effects(ViscousFriction(coefficient=DE["v"]))
        re, im = (np.asarray(a)[:, 1, 0] for a in transfer(chain, jnp.asarray(2 * pi * f)))
        few = jaxid.Chain(FlexibleLink(**OWN, n_modes=4), chain.effects)
        re4, im4 = (np.asarray(a)[:, 1, 0] for a in transfer(few, jnp.asarray(2 * pi * f)))
    assert relative(re + 1j * im, truth) < 1e-10
    assert relative(re4 + 1j * im4, truth) < 1e-5


def response_data(
    response: np.ndarray, f: np.ndarray, repeats: int = 5, noise: float = 0.02
) -> jaxid.Dataset:
    rng = np.random.default_rng(5)
    lines, values = [], []
    for _ in range(repeats):
        lines.append(2 * pi * f)
        part = noise * np.abs(response) / np.sqrt(2)
        values.append(
            response + part * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
        )
    measured = FrequencyResponse(
        "sweep", "fit", np.concatenate(lines), np.concatenate(values), "tau", "tip_acceleration"
    )
    channels = (
        Channel("tau", "input", "N m"),
        Channel("phi", "output", "rad"),
        Channel("tip_acceleration", "output", "m/s^2"),
    )
    model = ModelSpec("flexible_link", constants={"tau_c": 0.0, "v": DE["v"]})
    return jaxid.Dataset("lines", channels, responses=(measured,), model=model)


def test_a_measured_response_is_fitted_and_a_wrong_one_is_not():
    f = np.arange(0.4, 60.01, 0.4)
    fit = jaxid.fit(None, response_data(direct(f), f))
    assert fit.residual == "frequency_response" and 0.7 < fit.loss < 1.4
    for name in ("E", "I_m", "alpha", "beta"):
        p = fit.parameters[name]
        assert p.std is not None and abs(p.value - DE[name]) < 4.5 * p.std, name
    assert jaxid.fit(None, response_data(-direct(f), f)).loss > 100 * fit.loss  # a swapped sign
    assert (
        jaxid.fit(None, response_data(np.conj(direct(f)), f)).loss > 100 * fit.loss
    )  # the phase's convention
    assert jaxid.fit(None, response_data(1e3 * direct(f), f)).loss > 100 * fit.loss  # a wrong unit


def test_repeats_give_weights_that_outliers_do_not_move():
    f = np.arange(0.4, 20.01, 0.4)
    clean = response_data(direct(f), f, repeats=10).responses[0]
    spoilt = clean.response.copy()
    spoilt[:20] *= 50
    lines = merged(FrequencyResponse("s", "fit", clean.omega, spoilt, "tau", "tip_acceleration"))
    assert relative(lines.response, direct(f)) < 0.03
    assert np.median(lines.std / np.abs(lines.response)) == pytest.approx(
        0.02 / np.sqrt(2) * 1.2533 / np.sqrt(10), rel=0.4
    )


def test_without_repeats_a_zero_of_the_response_does_not_outweigh_the_rest():
    f = np.arange(0.4, 20.01, 0.4)
    response = direct(f)
    response[10] = 1e-9
    std = merged(
        FrequencyResponse("s", "fit", 2 * np.pi * f, response, "tau", "tip_acceleration")
    ).std
    assert std[10] == pytest.approx(0.002 * np.median(np.abs(response)))
    assert np.allclose(std[11:20], 0.02 * np.abs(response[11:20]))


def pulse_data(seed: int = 0) -> jaxid.Dataset:
    t = np.arange(2000) * 1e-3
    u = np.where(t < 0.3, 0.241, 0.0)
    y = zero_order_hold(u, 1e-3, 10, DE["v"], DE["tau_c"])
    rng = np.random.default_rng(seed)
    noise = {"phi": 1.3e-3, "tip_acceleration": 0.3}
    return jaxid.Dataset.from_arrays(
        t,
        {"tau": u},
        {n: y[:, k] + s * rng.standard_normal(2000) for k, (n, s) in enumerate(noise.items())},
        units={"tau": "N m", "phi": "rad", "tip_acceleration": "m/s^2"},
        noise_std=noise,
        at_rest=True,
    )


@pytest.mark.slow
def test_the_papers_pulse_is_fitted_by_records_and_biased_by_a_linear_response():
    data = pulse_data()
    model = FlexibleLink(n_modes=4)
    fit = jaxid.fit(model, data)
    assert 0.9 < fit.loss < 1.1
    for name in ("E", "I_m", "tau_c"):
        p = fit.parameters[name]
        assert p.std is not None and abs(p.value - DE[name]) < 4.5 * p.std, name
    band = (0.0, 20.0)
    simulated = jaxid.fit(
        model, data, residual=FrequencyResponseError(timed=("phi",), band_hz=band)
    )
    assert simulated.parameters["E"].value == pytest.approx(DE["E"], rel=0.01)
    linear = jaxid.fit(model, data, residual=FrequencyResponseError(linear=True, band_hz=band))
    assert linear.loss > 20 * simulated.loss  # dry friction does not exist in a linear response
    assert linear.parameters["E"].value < 0.97 * DE["E"]


@pytest.mark.slow
def test_held_out_data_without_a_line_and_steps_finer_than_samples():
    """2 ms samples are one step apart, and two where the step is halved; 0.2 s of a constant input
    hold no line of a response.
    """
    t = np.arange(1000) * 2e-3
    u = np.where(t < 0.3, 0.241, 0.0)
    y = zero_order_hold(u, 2e-3, 20, DE["v"], 0.0) + np.random.default_rng(1).standard_normal(
        (t.size, 2)
    ) * [1.5e-3, 0.3]
    channels = (
        Channel("tau", "input", "N m"),
        Channel("phi", "output", "rad", 1.5e-3),
        Channel("tip_acceleration", "output", "m/s^2", 0.3),
    )
    run = Experiment(
        "pulse", "fit", t, u[:, None], y, at_rest=True, initial={"phi": 0.0, "qd": 0.0}
    )
    held = [run.piece(0, 100, name=n, split=n) for n in ("validation", "report")]
    model = ModelSpec(
        "flexible_link",
        constants={"n_modes": 2, "alpha": DE["alpha"], "beta": DE["beta"], "tau_c": 0.0},
    )
    data = jaxid.Dataset("pulse", channels, (run, *held), (), model)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        fit = jaxid.fit(
            None,
            data,
            residual=FrequencyResponseError(linear=True, timed=("phi",), band_hz=(0.0, 20.0)),
        )
    assert fit.parameters["E"].value == pytest.approx(DE["E"], rel=0.03)
    assert set(fit.scores["validation"]) == {"phi", "tip_acceleration"} < set(fit.scores["fit"])
    assert any("validation data show no line" in n for n in fit.notes)
