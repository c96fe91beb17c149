"""A realistic diagnosis of a servo-driven pendulum with dry friction, made without fitting
anything.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxid.diagnosis.result import (
    ChannelGap,
    Diagnosis,
    Finding,
    HowFar,
    MissingForce,
    Ranked,
    Regime,
    Which,
)
from jaxid.fitting.result import EffectEstimate, Estimate, Fit, Score, Trace
from jaxid.fitting.simulation import Simulation


NOISE = 4e-4


def sample_fit(effects: tuple[EffectEstimate, ...] = (), samples: int = 4000) -> Fit:
    return Fit(
        model="pendulum",
        effects=effects,
        fitter="lm",
        residual="output_error",
        loss_name="sum_of_squares",
        seed=0,
        converged=True,
        failed=False,
        stopped_because="tolerance",
        loss=1.04,
        parameters={
            "inertia": Estimate(0.08123, 0.00042, "kg m^2", 0.001, 1.0),
            "gravity_torque": Estimate(1.2347, 0.0031, "N m", 0.0, 10.0),
            "viscous": Estimate(0.0, None, "N m s/rad", 0.0, 3.0, at_bound=True),
            "offset": Estimate(-0.013, None, "N m", -1.0, 1.0, identifiable=False),
        },
        scores={
            "fit": {"q": Score(4.1e-4, 0.0011, 0.0011, "rad")},
            "validation": {"q": Score(4.4e-4, 0.0012, 0.0012, "rad")},
        },
        windowed={},
        evaluations=412,
        wall_time_s=1.93,
        compile_time_s=1.12,
        dataset="servo_pendulum",
        dataset_sha256="0f" * 32,
        notes=("The last 30 % of each experiment was kept for validation.",),
        correlated=(("inertia", "gravity_torque"),),
        history=tuple((i * 8, 1.04 + 900 * 0.6**i) for i in range(40)),
        traces=sample_traces(samples, ("fitted model",)),
        theta=np.zeros(4),
    )


def sample_traces(samples: int, labels: tuple[str, ...]) -> tuple[Trace, ...]:
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 18.0, samples)
    q = 0.6 * np.sin(1.9 * t) + 0.3 * np.sin(4.3 * t + 1.0)
    errors = [
        0.004 * np.sign(np.cos(1.9 * t)) * (1 - np.exp(-t)) + 0.002 * np.sin(0.9 * t),
        0.00005 * np.sin(3 * t),
    ]
    picked = errors if len(labels) > 1 else errors[1:]
    simulated = {label: q - error for label, error in zip(labels, picked, strict=True)}
    measured = q + NOISE * rng.standard_normal(samples)
    return tuple(
        Trace(name, split, "q", "rad", t, measured, simulated, NOISE)
        for name, split in (("sweep_1", "fit"), ("step_2", "report"))
    )


def sample_diagnosis(samples: int = 4000) -> Diagnosis:
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 18.0, samples)
    qd = 1.1 * np.cos(1.9 * t) + 1.3 * np.cos(4.3 * t + 1.0)
    q = 0.6 * np.sin(1.9 * t) + 0.3 * np.sin(4.3 * t + 1.0)
    rest = 0.012 * rng.standard_normal(samples)
    before = 0.11 * np.tanh(qd / 0.05) + rest
    coulomb = EffectEstimate(
        "coulomb_friction", "q", {"level": Estimate(0.1123, 0.0016, "N m", 0.0, 3.0)}
    )
    nominal = sample_fit(samples=samples)
    final = replace(nominal, effects=(coulomb,))
    others = (
        ("asymmetric_friction", "q", 1.05, 39.8, "Two more parameters bring nothing."),
        ("viscous_friction", "q", 6.3, 12.0, "Explains the decay, not the reversals."),
        ("quadratic_drag", "q", 7.1, 9.2, "Too weak at low speed."),
        ("dead_zone", "tau", 7.9, 4.1, "Misses the sign of the error."),
        ("input_delay", "tau", 8.6, 1.0, "No better than the nominal model."),
        ("constant_torque", "q", 8.7, -0.4, "No better than the nominal model."),
    )
    return Diagnosis(
        model="pendulum",
        dataset="servo_pendulum",
        dataset_sha256="0f" * 32,
        seed=0,
        residual="output_error",
        where=(
            Finding(
                "q",
                "q",
                "velocity_reversal",
                (3.1, 3.6),
                0.62,
                14.0,
                "The error at q grows each time the velocity changes its sign.",
            ),
            Finding("q", "q", "low_speed", (7.2, 8.4), 0.21, 6.0, ""),
        ),
        which=Which(
            "named",
            (coulomb,),
            (EffectEstimate("stribeck_friction", "q"),),
            (
                Ranked("coulomb_friction", "q", 1.04, -5123.0, 41.2, "Takes the gap to the noise."),
                Ranked(
                    "stribeck_friction",
                    "q",
                    1.04,
                    -5110.4,
                    41.1,
                    "As good; the data hold no slow motion.",
                ),
                *(
                    Ranked(e, loc, gap, -4000.0 - 10 * i, evidence, s)
                    for i, (e, loc, gap, evidence, s) in enumerate(others)
                ),
            ),
        ),
        how_far=HowFar(
            9.31,
            8.84,
            1.08,
            1.0,
            0.9981,
            (0.9922, 0.9993),
            "",
            {"q": ChannelGap("rad", 3.72e-3, 3.54e-3, 4.3e-4, NOISE, "sensor")},
            interval_from="runs",
        ),
        next_experiment="Record slow motion (below 0.05 rad/s) both ways: it separates Stribeck from Coulomb friction.",
        wall_time_s=21.4,
        nominal=nominal,
        final=final,
        traces=sample_traces(samples, ("nominal model", "with coulomb_friction at q")),
        missing_force=(
            MissingForce(
                "q",
                "N m",
                "rad",
                "rad/s",
                "step_2",
                t,
                q,
                qd,
                1.2 * np.sin(q),
                before,
                rest,
                np.full_like(t, 0.012),
            ),
        ),
        regimes=(
            Regime("q", "velocity_reversal", 2.4, (0.8, 1.2), 410),
            Regime("q", "low_speed", 1.6, (0.85, 1.15), 820),
            Regime("q", "high_load", 1.02, (0.9, 1.1), 1200),
            Regime("q", "high_speed", 0.7, (0.9, 1.1), 900),
        ),
        notes=("Without repeats the noise is the sensor's alone.",),
    )


def sample_simulation() -> Simulation:
    t = np.linspace(0.0, 1.0, 11)
    return Simulation(
        "pendulum",
        ({"t": t, "q": np.sin(t)}, {"t": t, "q": np.cos(t)}),
        ({"q": 1e-3}, {"q": 2e-3}),
        {"q": "rad"},
    )


def hostile(diagnosis: Diagnosis) -> Diagnosis:
    """The same diagnosis with names that attack a page, a terminal, math text and a spreadsheet."""
    bad = "<script>alert(1)</script>$\\frac{1$\x1b[31m=cmd()\u202e"
    effect = EffectEstimate(bad, bad, {bad: Estimate(1.0, 0.1, bad, 0.0, 2.0)})
    how_far = replace(
        diagnosis.how_far, per_channel={bad: ChannelGap(bad, 1.0, 1.0, 1.0, 1.0, bad)}, text=bad
    )
    nominal = replace(
        diagnosis.nominal,
        model=bad,
        dataset=bad,
        notes=(bad,),
        parameters={bad: Estimate(1.0, 0.1, bad, 0.0, 2.0)},
    )
    return replace(
        diagnosis,
        dataset=bad,
        model=bad,
        where=(Finding(bad, bad, bad, (0.0, 1.0), 0.5, 3.0, bad),),
        which=Which("named", (effect,), (effect,), (Ranked(bad, bad, 1.0, 1.0, 1.0, bad),), bad),
        how_far=how_far,
        next_experiment=bad,
        nominal=nominal,
        final=nominal,
        traces=tuple(
            replace(x, experiment=bad, channel=bad, unit=bad, simulated={bad: x.measured})
            for x in diagnosis.traces
        ),
        missing_force=tuple(
            replace(m, joint=bad, unit=bad, experiment=bad) for m in diagnosis.missing_force
        ),
        regimes=tuple(replace(r, joint=bad, regime=bad) for r in diagnosis.regimes),
        notes=(bad,),
    )
