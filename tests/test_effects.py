"""Every effect against separately written equations, at its neutral value, in fits, and its
gradients.
"""

from __future__ import annotations

import importlib
import shutil
import subprocess
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings as limits, strategies as st
from scipy.integrate import solve_ivp

import jaxid
import reference as ref
import reference_states as states
from jaxid.data.dataset import ModelSpec
from jaxid.dynamics.catalogue import effect_class
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import InputEffect, JointEffect, OutputEffect, Signals
from jaxid.dynamics.export_law import ExportLaw, FUNCTIONS, in_python, SIGNALS
from jaxid.dynamics.law_in_c import in_c
from jaxid.dynamics.parameter import resolve, specs, TypicalMagnitudes, with_fields
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.fitters import LevenbergMarquardt
from jaxid.fitting.covariance import covariance
from jaxid.fitting.effect_starts import probe_starts
from jaxid.fitting.problem_builder import ProblemBuilder, start_values
from jaxid.models import Joint, Pendulum, PlanarArm
from jaxid.models.effects import LIBRARY
from jaxid.problem.binding import bind
from jaxid.problem.residual import OutputError
from simulated import REFERENCE, relative, Simulator, within_bounds


def law_of(kind: Any) -> Any:
    """The expression by which an effect is exported, None where it has none."""
    law = kind.export_law
    return law if isinstance(law, ExportLaw) and law.text else None


CASES: dict[str, Any] = {
    "pendulum": (Pendulum, Pendulum.signatures[0]),
    "joint": (Joint, Joint.signatures[1]),
    "planar_arm": (PlanarArm, PlanarArm.signatures[0]),
}
TORQUE = {"pendulum": np.ones(1), "joint": np.ones(1), "planar_arm": np.array([14.0, 5.0])}
SPEED = 3.0
INERTIA = {
    "pendulum": np.array([0.08]),
    "joint": np.array([0.1]),
    "planar_arm": np.array([0.5, 0.1]),
}
ONLY = {"planar_arm": ("coupled_friction", "payload", "reflected_inertia")}

#: Effects of one model alone, tested with it: tests/test_flexible_link.py, tests/test_models.py;
#: and tests/test_late_effects.py.
ELSEWHERE = {"geometric_stiffening", "base_motion", "actuator_curve", "step_change"}
#: What is compared with its equation here.
TESTED = [e.name for e in LIBRARY if e.name not in ELSEWHERE]
#: What a diagnosis asks first.
FIRST = tuple(e for e in LIBRARY if not e.last_resort)
#: What has events within a step, or a motor that rings against its link, needs finer steps for the
#: same accuracy; with what is dry by its law.
FINE = (
    "asymmetric_friction",
    "backlash",
    "joint_elasticity",
    *(e.name for e in LIBRARY if (law := law_of(e)) is not None and law.port == "dry"),
)
FINER = 5
#: Relative L2 error of the outputs; steps are 0.2 ms (arm: 0.1 ms), or these divided by FINER.
TOLERANCE = 1e-6


def references(case: str) -> list[TypicalMagnitudes]:
    """Typical magnitudes of each joint, with the travel of which its inertia is made."""
    joints = zip(TORQUE[case], INERTIA[case], strict=True)
    return [TypicalMagnitudes(t, SPEED, j * SPEED**2 / t, 0.6, 0.01) for t, j in joints]


def settings_of(effect: str, case: str) -> list[dict[str, np.ndarray]]:
    """The examples of an effect, or its first probes where it has none; each number by joint."""
    kind = effect_class(effect)
    at = references(case)

    def by_joint(value):
        return np.array([resolve(value, r) for r in at])

    examples = kind.examples or kind.probes[:3]
    return [{name: by_joint(value) for name, value in one.items()} for one in examples]


def named(layout: ParameterVector, effect: str, values: dict[str, np.ndarray]) -> dict[str, float]:
    """The same with the model's own names; dry friction that varies has a mean level beside it."""
    out = {}
    for i in layout.of_effect(effect):
        e = layout.entries[i]
        if e.field in values:
            out[e.name] = values[e.field][e.place]
    if effect == "position_dependent_friction":
        out |= {
            n: 0.1 * t
            for n, t in zip(
                [layout.names[i] for i in layout.of_effect("coulomb_friction")],
                mean_level(layout),
                strict=True,
            )
        }
    return out


def mean_level(layout: ParameterVector) -> np.ndarray:
    return TORQUE[layout.chain.mechanism.name]


class Product:
    """One mechanism with the whole library at its neutral values, on a command of 0.6 s; every
    effect at every setting.
    """

    def __init__(self, case: str):
        self.case = case
        kind, signature = CASES[case]
        nq = len(signature.joints)
        self.t = np.arange(61) * 0.01
        self.u = ref.multisine(self.t, 1.5 * TORQUE[case], 5, periods=0.7, lines=4)
        self.bare = Chain(kind(), (), signature=signature)
        self.nominal = Chain(kind(), signature=signature)
        has = [e.name for e in self.nominal.effects]
        self.kinds: list[Any] = [e for e in FIRST if self.nominal.offers(e)]
        chain = self.nominal.with_effects(*(e() for e in self.kinds if e.name not in has))
        self.step = 1e-4 if nq > 1 else 2e-4
        self.s = Simulator(chain, self.t, self.u, self.step, size=8192, whole=True)
        self.layout = self.s.layout
        plain = [e.name for e in self.kinds if e.name not in FINE]
        keys = [(e, k) for e in plain for k in range(len(settings_of(e, case)))]
        values = [named(self.layout, e, settings_of(e, case)[k]) for e, k in keys]
        self.outputs = dict(zip(keys, self.s.outputs(values), strict=True))
        self.neutral = self.s.outputs([{}])[0]
        fine = [e for e in self.kinds if e.name in FINE]
        s = Simulator(
            self.bare.with_effects(*(e() for e in fine)),
            self.t,
            self.u,
            self.step / FINER,
            size=32768,
        )
        for e in fine:
            y = s.outputs([named(s.layout, e.name, v) for v in settings_of(e.name, case)])
            self.outputs |= {(e.name, k): one for k, one in enumerate(y)}


@pytest.fixture(
    scope="module",
    params=[
        "pendulum",
        *(pytest.param(c, marks=pytest.mark.slow) for c in ("joint", "planar_arm")),
    ],
)
def product(request):
    return Product(request.param)


def truth(
    effect: str,
    case: str,
    values: dict[str, np.ndarray],
    t: np.ndarray,
    u: np.ndarray,
    viscous: float = 0.0,
) -> np.ndarray:
    """What the sensors read [time nq] by the separately written equations."""
    plant, n = ref.PLANTS[case], u.shape[1]
    single = {p: v[0] if n == 1 or np.ptp(v) == 0 else v for p, v in values.items()}
    memory = {
        "lugre_friction": states.lugre,
        "hysteresis": states.hysteresis,
        "temperature_dependent_friction": states.warm_friction,
        "flexible_mode": states.swinging_mass,
    }
    free = ref.Truth(viscous=viscous)
    if effect in memory:
        return states.simulate(plant(), free, t, u, t, [memory[effect](**values)])["q"]
    if effect in ("joint_elasticity", "backlash"):
        rename = {"motor_share": "share", "contact_compliance": "compliance"}
        coupling = states.Coupling(**{rename.get(p, p): v for p, v in values.items()})
        return states.simulate(
            plant(),
            free,
            t,
            u,
            t,
            coupling=coupling,
            longest=5e-4 if effect == "backlash" else np.inf,
        )["q"]
    if effect == "sensor_lag":
        return states.simulate(plant(), free, t, u, t, sensor_lag=values["lag"])["y"]
    if effect == "sensor_delay":
        at = np.maximum(t - single["delay"], 0.0)
        return states.simulate(plant(), free, t, u, at)["q"]
    if effect == "timestamp_jitter":
        found = states.simulate(plant(), free, t, u, t)
        bend = found["qdd"].mean(1)
        bend[0], bend[-1] = 0.0, found["qdd"][-1, 0]
        return found["q"] + single["spread"] ** 2 / 2 * bend
    if effect == "payload":
        return ref.simulate(ref.loaded_arm(*values["mass"]), free, t, u)[0]
    if effect == "gravity_offset":
        return ref.simulate(plant(tilt=single["tilt"]), free, t, u)[0]
    if effect == "reflected_inertia":
        return ref.simulate(ref.heavier(plant(), values["inertia"]), free, t, u)[0]
    if effect == "sensor_bias":
        return ref.simulate(plant(), free, t, u)[0] + values["bias"]
    if effect == "sensor_scale":
        return ref.simulate(plant(), free, t, u)[0] * (1 + values["gain"])
    if effect not in ref.EFFECTS:
        return ref.simulate(plant(), by_law(effect, values, viscous), t, u)[0]
    fields: dict[str, Any] = {ref.EFFECTS[effect][p]: v for p, v in values.items()}
    fields |= {
        name: float(np.ravel(fields[name])[0]) for name in ("delay", "other_hold") if name in fields
    }
    if effect == "position_dependent_friction":
        fields["coulomb"] = 0.1 * TORQUE[case]
    known: dict[str, Any] = {"viscous": viscous, **fields}
    return ref.simulate(plant(), ref.Truth(**known), t, u)[0]


def export_of(kind: Any) -> ExportLaw:
    """What an effect says of its export."""
    law = law_of(kind)
    assert law is not None
    return law


def by_text(law: ExportLaw, numbers: dict[str, Any], **signals: Any) -> Any:
    """What the expression of an export is, in NumPy."""
    functions = {name: getattr(np, name) for name in FUNCTIONS}
    return eval(law.text, {"__builtins__": {}}, {**functions, **numbers, **signals})


def by_law(effect: str, values: dict[str, np.ndarray], viscous: float = 0.0) -> ref.Truth:
    """What acts by the expression of an export, of an effect whose equation is written nowhere
    else.
    """
    kind = effect_class(effect)
    law = law_of(kind)
    if law is None or law.port == "reading":
        pytest.skip(f"{effect}: no equation beside its own; write one in tests/reference.py")
    numbers = {name: spec.value for name, spec in specs(kind).items()} | values
    if law.port == "force":

        def force(q, v):
            return by_text(law, numbers, q=q, qd=v)

        return ref.Truth(viscous=viscous, force=force)
    if law.port == "dry":

        def level(q, v, drive):
            return by_text(law, numbers, q=q, qd=v, load=drive)

        return ref.Truth(viscous=viscous, level=level)
    return ref.Truth(viscous=viscous, arrives=lambda u: by_text(law, numbers, u=u))


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_laws_in_c_are_those_in_python(tmp_path):
    """Every expression of an export, compiled, at some signals."""
    at = {"q": 0.4, "qd": -1.3, "load": -0.6, "u": -0.9, "y": 0.7}
    reference = TypicalMagnitudes(torque=1.0, speed=1.0, angle=1.0, duration=1.0, step=0.01)
    lines, expected = [], []
    for kind in [e for e in LIBRARY if law_of(e)]:
        law = export_of(kind)
        numbers = {name: spec.value for name, spec in specs(kind).items()}
        example = (kind.examples or kind.probes)[-1]
        numbers |= {name: resolve(value, reference) for name, value in example.items()}
        expected.append(float(by_text(law, numbers, **{k: at[k] for k in SIGNALS[law.port]})))
        lines.append(f'  printf("%.17g\\n", {in_c(law, numbers)});')
    signals = ", ".join(f"{name} = {value}" for name, value in at.items())
    body = "\n".join(lines)
    text = f"#include <math.h>\n#include <stdio.h>\nint main() {{ double {signals};\n{body}\n}}\n"
    source, program = tmp_path / "laws.c", tmp_path / "laws"
    source.write_text(text)
    subprocess.run(["cc", source, "-o", program, "-lm"], check=True)
    printed = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    np.testing.assert_allclose([float(x) for x in printed.split()], expected, rtol=1e-12)


def as_made(kind: Any, numbers: dict[str, float], signals: dict[str, np.ndarray]) -> np.ndarray:
    """What an effect makes of signals: the force of a joint that slides, else what arrives."""
    nothing: Any = None
    with jax.enable_x64(True):
        q, qd, load, u, y = (jnp.asarray(signals[k]) for k in ("q", "qd", "load", "u", "y"))
        effect = with_fields(kind(), {k: jnp.full(q.shape, v) for k, v in numbers.items()})
        s = Signals(nothing, q, qd, load, nothing, nothing, qd, transmitted=load)
        if isinstance(effect, JointEffect):
            smooth, minus, plus, _ = effect(s, ())
            return np.asarray(smooth + jnp.where(qd > 0, plus, -jnp.asarray(minus)))
        arriving = y if isinstance(effect, OutputEffect) else u
        return np.asarray(effect(arriving, s, ())[0])


def as_exported(kind: Any, value: np.ndarray, signals: dict[str, np.ndarray]) -> np.ndarray:
    """The same from what the expression of its export says."""
    port = export_of(kind).port
    if port == "dry":
        return value * np.sign(signals["qd"])
    if port == "force" and issubclass(kind, InputEffect):
        return signals["u"] - value
    return value


@pytest.mark.parametrize("kind", [e for e in LIBRARY if law_of(e)], ids=lambda e: e.name)
def test_what_is_exported_is_the_effect(kind):
    """The expression of an export beside the effect itself, at all its examples and signals."""
    law = export_of(kind)
    drawn = np.random.default_rng(3).normal(size=(5, 50))
    signals: dict[str, Any] = dict(zip(("q", "qd", "load", "u", "y"), drawn, strict=True))
    seen = {k: signals[k] for k in SIGNALS[law.port]}
    reference = TypicalMagnitudes(torque=1.0, speed=1.0, angle=1.0, duration=1.0, step=0.01)
    for example in kind.examples or kind.probes:
        numbers = {name: spec.value for name, spec in specs(kind).items()}
        numbers |= {name: resolve(value, reference) for name, value in example.items()}
        made = as_made(kind, numbers, signals)
        by_name = by_text(law, numbers, **seen)
        np.testing.assert_allclose(as_exported(kind, by_name, signals), made, rtol=1e-9, atol=1e-12)
        code: Any = eval(f"lambda {', '.join(seen)}: {in_python(law, numbers)}", {"xp": np})
        np.testing.assert_allclose(code(**seen), by_name, rtol=1e-12)


@pytest.mark.parametrize("effect", TESTED)
def test_effect_against_its_equation(product, effect):
    """All three settings on the pendulum, and those of effects that need two joints on the arm; the
    middle one elsewhere.
    """
    case = product.case
    if (effect, 0) not in product.outputs:
        pytest.skip("not on this mechanism")
    every = case == "pendulum" or effect in ONLY.get(case, ())
    examples = settings_of(effect, case)
    for k in range(len(examples)) if every else (len(examples) // 2,):
        values = examples[k]
        y = truth(effect, case, values, product.t, product.u)
        error = relative(product.outputs[effect, k], y)
        print(effect, k, error)
        assert error <= TOLERANCE, (values, error)
        assert relative(product.outputs[effect, k], product.neutral) > 1e-4  # it does something


# ---- neutral


def alike(product: Product, a: np.ndarray, b: np.ndarray) -> bool:
    """Bitwise equal; for the arm but for rounding: some compilers join products and sums in one
    program of it only.
    """
    return np.array_equal(a, b) or (
        product.case == "planar_arm" and np.abs(a - b).max() <= 1e-13 * np.abs(b).max()
    )


def test_neutral_effects_are_absent(product):
    bare = Simulator(product.bare, product.t, product.u, product.step, size=8192)
    assert alike(product, product.s.outputs([{}]), bare.outputs([{}]))


def test_neutral_effects_beside_the_builtin_ones_are_absent(product):
    nominal = Simulator(product.nominal, product.t, product.u, product.step, size=8192)
    torque = float(np.min(TORQUE[product.case]))
    values = {
        n: 0.05 * torque
        for n in nominal.layout.names
        if n.startswith(("viscous", "coulomb", "offset"))
    }
    assert alike(product, product.s.outputs([values]), nominal.outputs([values]))


def test_no_gradient_is_nan(product):
    """At rest without command, with every effect neutral; and anywhere within the bounds where the
    simulation itself holds (all effects at once, at any strength, can be stiffer than the step).
    """
    layout, nq = product.layout, product.layout.chain.nq
    still = Simulator(layout.chain, product.t[:4], 0 * product.u[:4], 2e-3, size=1024, whole=True)
    y, dy = still.tangents(layout.values)
    assert np.all(np.isfinite(dy)) and np.all(y == 0)
    references = [REFERENCE._replace(torque=float(x)) for x in TORQUE[product.case]]
    short = Simulator(layout.chain, product.t, product.u, 2e-3, size=1024, whole=True)
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(8):
        theta = layout.values.copy()
        effects = np.array([e.owner >= 0 for e in layout.entries])
        theta[effects] = within_bounds(layout, references, rng, 6)[effects]
        y, dy = short.tangents(theta, rng.normal(size=2 * nq))
        if np.all(np.abs(y) < 1e3):  # False for nan
            held += 1
            assert np.all(np.isfinite(dy))
    assert held >= 3


# ---- together


def test_effects_of_the_drive_act_in_the_order_given_after_those_of_time():
    """Delay, then scale, droop, limit and dead zone one after the other, however the timing is
    written.
    """
    from jaxid.models import effects as library

    t = np.arange(61) * 0.01
    u = ref.multisine(t, [1.5], 5, periods=0.7, lines=4)
    kinds = (
        library.TorqueScale,
        library.SupplyDroop,
        library.Saturation,
        library.DeadZone,
        library.InputDelay,
    )
    s = Simulator(Chain(Pendulum(), ()).with_effects(*(k() for k in kinds)), t, u, 2e-4, size=4096)
    values = {
        "torque_scale.gain": 0.2,
        "supply_droop.droop": 0.1,
        "saturation.limit": 1.0,
        "dead_zone.width": 0.1,
    }
    y = s.outputs([{f"{n}@tau": v for n, v in (values | {"input_delay.delay": 0.013}).items()}])[0]
    truth = ref.Truth(scale=0.2, droop=0.1, limit=1.0, dead_zone=0.1, delay=0.013)
    assert relative(y, ref.simulate(ref.pendulum(), truth, t, u)[0]) < 1e-6


# ---- found again in fits


NOISE, VISCOUS = 2e-4, 0.05
#: What re-tuning cannot tell from parameters of the pendulum or from its unknown start: those are
#: known here.
KNOWN = (
    "backlash",
    "torque_scale",
    "back_emf",
    "reflected_inertia",
    "sensor_bias",
    "sensor_scale",
    "gravity_offset",
)
FOUND: dict[str, dict[str, float]] = {
    "dead_zone": {"width": 0.1}, "saturation": {"limit": 0.7}, "torque_scale": {"gain": 0.1}, "supply_droop": {"droop": 0.1},
    "back_emf": {"constant": 0.1}, "actuator_lag": {"lag": 0.02}, "input_delay": {"delay": 0.008}, "input_hold": {"share": 0.7},
    "torque_ripple": {"sine": 0.05, "cosine": -0.03, "order": 9.0}, "quadratic_drag": {"coefficient": 0.05},
    "lugre_friction": {"level": 0.1, "presliding": 0.05, "relaxation": 0.01},
    "temperature_dependent_friction": {"change": 0.1, "time": 0.3}, "hysteresis": {"level": 0.15, "width": 0.1},
    "joint_elasticity": {"compliance": 0.03, "motor_share": 0.4, "damping_ratio": 0.1},
    "backlash": {"play": 0.03, "motor_share": 0.4, "contact_compliance": 0.03},
    "gravity_offset": {"tilt": 0.05}, "spring_torque": {"stiffness": 0.5}, "reflected_inertia": {"inertia": 0.02},
    "flexible_mode": {"inertia": 0.02, "frequency": 5.0, "damping_ratio": 0.05}, "sensor_bias": {"bias": 0.05},
    "sensor_scale": {"gain": 0.03}, "sensor_lag": {"lag": 0.02}, "sensor_delay": {"delay": 0.008},
    "timestamp_jitter": {"spread": 0.01},
}  # fmt: skip
#: A free run has many local minima in these, or too little of its beginning tells of them: found
#: again from a start nearby (saturation from afar in 10 or 11 of 12 draws of the noise).
NEAR = ("joint_elasticity", "backlash", "timestamp_jitter", "saturation")
T_FIT = np.arange(201) * 0.01


#: One before, one in and one behind the plant; `make test-all` takes them all.
QUICK = ("input_delay", "quadratic_drag", "sensor_lag")


@pytest.mark.parametrize(
    "effect", [e if e in QUICK else pytest.param(e, marks=pytest.mark.slow) for e in FOUND]
)
def test_an_effect_is_found_again(effect):
    """From noisy data with viscous friction beside it, by a fit that starts without it (dry laws:
    test_diagnosis.py).
    """
    u = ref.multisine(T_FIT, [1.2], 3, periods=2, lines=8)
    u[:10] = 0.0
    values = {p: np.array([v]) for p, v in FOUND[effect].items()}
    y = ref.measured(truth(effect, "pendulum", values, T_FIT, u, VISCOUS), NOISE, 7)
    known = {
        "inertia": 0.08,
        "gravity_torque": 1.5,
        "viscous": VISCOUS,
        "coulomb": 0.0,
        "offset": 0.0,
    }
    data = jaxid.Dataset.from_arrays(
        T_FIT,
        {"tau": u[:, 0]},
        {"q": y[:, 0]},
        units={"tau": "N m", "q": "rad"},
        noise_std={"q": NOISE},
        at_rest=effect not in KNOWN,
        initial={"q": 0.0, "qd": 0.0} if effect in KNOWN else None,
        model=ModelSpec("pendulum", constants=known if effect in KNOWN else {}),
    )
    # The whole library stays in the chain at its neutral values, so that effects of a family share
    # a program.
    binding = bind(None, data, effects=[effect], candidates=FIRST, splits=False)
    bench = ProblemBuilder(binding, 1.25e-3)  # the step of a fit that has checked its step
    guesses = start_values(bench, binding.free, 0)
    problem = bench.problem(OutputError(), "fit", binding.free, guesses[0])
    starts = [problem.z(theta) for theta in (*guesses, *probe_starts(bench, problem, guesses[0]))]
    if effect in NEAR:
        near = guesses[-1].copy()
        for i in binding.layout.of_effect(effect):
            value = FOUND[effect].get(str(binding.layout.entries[i].field))
            near[i] = near[i] if value is None else 1.1 * value
        starts.insert(0, problem.z(near))
    found = LevenbergMarquardt(restarts=0).minimise(problem, starts, jax.random.key(0))
    assert 0.7 < found.loss < 1.3, found.loss
    values, std = (
        problem.theta(found.z),
        covariance(problem, found.z).std[: problem.free.size] * problem.dtheta(found.z),
    )
    for name, value in FOUND[effect].items():
        i = binding.layout.index(
            f"{effect}.{name}@{binding.chain.offers(next(e for e in LIBRARY if e.name == effect))[0]}"
        )
        s = std[list(problem.free).index(i)]
        assert s < 0.5 * abs(value), (name, s)
        bias = 0.03 * abs(value) if effect == "backlash" else 0.0  # contacts shorter than the step
        assert abs(values[i] - value) < 3 * s + bias, (name, value, values[i], s)


@given(steps=st.floats(0.0, 80.0), seed=st.integers(0, 100))
@limits(max_examples=50, deadline=None)
def test_delay_on_equal_steps_is_the_same_interpolation(steps, seed):
    sensor = importlib.import_module("jaxid.models.effects.sensor")
    t = 2.0 + 0.004 * np.arange(64)
    y = np.cumsum(np.random.default_rng(seed).normal(size=64))
    with jax.enable_x64(True):
        by_search = sensor.interpolated(
            jnp.asarray(t), jnp.asarray(y), jnp.asarray(t - 0.004 * steps), jnp.asarray(0.7)
        )
        shifted = sensor.shifted(jnp.asarray(y), jnp.asarray(steps), jnp.asarray(0.7 * 0.004))
        np.testing.assert_allclose(shifted, by_search, atol=1e-9)


@pytest.mark.parametrize("effect", ["sensor_lag", "sensor_delay"])
def test_a_sensor_that_is_late_in_a_run_that_begins_in_motion(effect):
    """Before the run the signal ran straight, with the speed that it begins with."""
    t, late, q0, v0 = np.arange(81) * 0.005, 0.03, 0.4, 2.5

    def swing(t, x):
        return [x[1], -0.9 * np.sin(x[0]) / 0.08, (x[0] - x[2]) / late]

    found = solve_ivp(
        swing, (0, 0.4), [q0, v0, q0 - late * v0], dense_output=True, rtol=1e-11, atol=1e-12
    ).sol
    before = q0 + v0 * (t - late)
    expected = (
        found(t)[2]
        if effect == "sensor_lag"
        else np.where(t < late, before, found(np.maximum(t - late, 0.0))[0])
    )

    kind: Any = next(e for e in LIBRARY if e.name == effect)
    s = Simulator(
        Chain(Pendulum(), (), signature=Pendulum.signatures[0]).with_effects(kind()),
        t,
        np.zeros((81, 1)),
        2e-4,
    )
    field = {"sensor_lag": "lag", "sensor_delay": "delay"}[effect]
    values = {"inertia": 0.08, "gravity_torque": 0.9, f"{effect}.{field}@q": late}
    assert relative(s.outputs([values], (q0, v0))[0], expected[:, None]) < 1e-6
