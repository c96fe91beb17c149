"""Design of experiments: motion or input that shows what a model's data are to determine; `jaxid
excite`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxid import catalogue
from jaxid.data.dataset import Channel, Dataset, Experiment, ModelSpec
from jaxid.data.limits import Limits
from jaxid.data.model_names import is_model_file
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.drive_torque import drive_gains
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.errors import nearest, UsageError
from jaxid.excitation.bounds import Bounds, bounds_of
from jaxid.excitation.clearance import gaps, heights, nodes
from jaxid.excitation.inputs import choose, determined, Family, InputDesign, largest_inputs, settled
from jaxid.excitation.paper001 import column_groups, objective_18
from jaxid.excitation.result import content, coverage, Excitation, reached, stds
from jaxid.excitation.trajectories import (
    ArmTask,
    chain_task,
    CRITERIA,
    Fourier,
    geometry_of,
    GRID,
    optimise,
    required,
    SearchSetting,
)
from jaxid.identification.regression import LAWS, names_of
from jaxid.models.effects import PowerLawFriction
from jaxid.numerics.precision import float64
from jaxid.robots.match import is_file, robot_from, spec_of_file


FRICTIONS = ("model", *LAWS)
#: Where the torque's noise is unknown it counts as this share of the joint's nominal torque.
NOISE_SHARE = 0.05
#: Noise of outputs by unit, one standard deviation, where a design needs it.
SENSOR = {"rad": 1e-3, "m": 1e-4, "m/s^2": 0.05}


def excite(
    model: object,
    *,
    harmonics: int = 8,
    base_frequency_hz: float | None = None,
    duration_s: float = 10.0,
    rate_hz: float = 125.0,
    limits: Limits | None = None,
    criterion: str | None = None,
    friction: str = "model",
    starts: int = 16,
    iterations: int = 400,
    seed: int = 0,
    floor: float = 0.0,
    radius: float = 0.06,
    amplitude: Sequence[float] | None = None,
    gain: Sequence[float] | None = None,
    parameters: Mapping[str, Any] | None = None,
    progress: Callable[[str, int, int, str], None] | None = None,
) -> Excitation:
    """An experiment for a model: `model` an id, the path of a URDF, or a mechanism.

    An arm gets a periodic motion that starts and ends at rest, within its limits (`limits`, else
    those of the model), its links (capsules of `radius` m) apart and above `floor` m; `friction`
    names the law whose columns are to be told apart (`model`: the model's own). Any other model
    gets an input, at most `amplitude` in the input's unit, chosen by simulation with the values of
    `parameters` (as in fit.json; else the model's). `criterion` is condition (the default for
    motions), d_optimal or, of a serial arm, paper001 (its objective (18)). `gain` N m/A adds the
    currents to command. Raises `UsageError` for what does not fit or cannot be kept.
    """
    began = time.perf_counter()
    for value, least, name in (
        (harmonics, 2, "harmonics"),
        (starts, 1, "starts"),
        (iterations, 1, "iterations"),
    ):
        if value < least:
            raise UsageError(f"{name} is {value}; give at least {least}")
    if criterion is not None and criterion not in CRITERIA:
        raise UsageError(f"there is no criterion {criterion!r}{nearest(criterion, CRITERIA)}")
    if friction not in FRICTIONS:
        raise UsageError(f"there is no friction law {friction!r}{nearest(friction, FRICTIONS)}")
    if not (duration_s > 0 and rate_hz > 0 and duration_s * rate_hz <= 1e6):
        raise UsageError(
            f"{duration_s:g} s at {rate_hz:g} Hz: give a positive duration and rate, at most a"
            " million samples"
        )
    base = base_frequency_hz if base_frequency_hz is not None else 1 / duration_s
    if (
        base <= 0
        or abs(duration_s * base - round(duration_s * base)) > 1e-6
        or round(duration_s * base) < 1
    ):
        raise UsageError(
            f"{duration_s:g} s hold {duration_s * base:.4g} periods of {base:g} Hz; a motion ends"
            " at rest after whole ones"
        )
    if harmonics * base > rate_hz / 8:
        raise UsageError(
            f"the highest line, {harmonics * base:.3g} Hz, needs a rate of at least"
            f" {8 * harmonics * base:.3g} Hz"
        )
    mechanism, table = mechanism_of(model)
    chain = _with(Chain(mechanism), parameters)
    if criterion == "paper001" and (not hasattr(mechanism, "base") or harmonics < 3):
        raise UsageError(
            "criterion paper001 sorts the columns of a serial arm (ur10, panda, a URDF …) and needs"
            " 3 harmonics, for its sums take two of each joint; use condition or d_optimal"
        )
    bounds = bounds_of(mechanism.name, chain.signature, limits, table)
    t = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    plan = {
        "harmonics": harmonics,
        "base_frequency_hz": base,
        "duration_s": duration_s,
        "rate_hz": rate_hz,
        "seed": seed,
    }
    settings = (chain, bounds, t, plan)
    if hasattr(mechanism, "base") or mechanism.name == "planar_arm":
        made = _motion(
            *settings,
            criterion or "condition",
            friction,
            starts,
            iterations,
            floor,
            radius,
            progress,
        )
    else:
        made = _input(
            *settings, criterion or "d_optimal", starts, amplitude, gain, limits, progress
        )
    made.content["wall_time_s"] = time.perf_counter() - began
    if is_file(model) and mechanism.name == "robot":
        made = replace(made, dataset=replace(made.dataset, model=spec_of_file(model)))
    elif is_model_file(model):
        spec = ModelSpec(mechanism.name, file=str(Path(model).resolve()))
        made = replace(made, dataset=replace(made.dataset, model=spec))
    return made


def chain_of(path: str) -> bool:
    """Whether the joints of a URDF, up to its tip, are one chain without mimics, as a serial arm
    has them.
    """
    tree = robot_from(path, getattr(path, "tip", None)).tree.tree
    return not tree.couplings and all(up == k - 1 for k, up in enumerate(tree.parent))


def mechanism_of(model: object) -> tuple[Any, Any]:
    """(mechanism, table with the maker's limits or None)."""
    if is_file(model) and not (model.lower().endswith(".urdf") and chain_of(model)):
        robot = robot_from(model, getattr(model, "tip", None))
        return robot, robot.limits()
    if isinstance(model, str) and model.lower().endswith(".urdf"):
        from jaxid.dynamics.urdf import read_urdf

        table = read_urdf(model, getattr(model, "tip", None))
        return catalogue.model_class("serial_arm")(table), table
    if isinstance(model, str):
        return catalogue.model_class(model)(), None
    if not hasattr(model, "signatures"):
        raise UsageError(
            f"a model is an id, the path of a URDF or a mechanism, not {type(model).__name__}"
        )
    return model, None


def _with(chain: Chain, content: Mapping[str, Any] | None) -> Chain:
    """The chain with the values of a fit."""
    if content is None:
        return chain
    kinds = [
        catalogue.effect_class(e["effect"], chain.mechanism)
        for e in content.get("effects", [])
        if isinstance(e, Mapping)
    ]
    chain = chain.with_effects(
        *(k() for k in kinds if k.name not in {e.name for e in chain.effects})
    )
    layout = ParameterVector(chain)
    theta = layout.values.copy()
    for name, value in content.get("parameters", {}).items():
        theta[layout.index(name)] = _number(name, value)
    for e in content.get("effects", []):
        for name, value in e.get("parameters", {}).items():
            for i in layout.of_effect(e["effect"], e.get("location")):
                if layout.entries[i].field == name:
                    theta[i] = _number(name, value)
    return layout.model(theta)


def _number(name: str, value: Any) -> float:
    value = value.get("value") if isinstance(value, Mapping) else value
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise UsageError(f"parameter {name}: {value!r} is not a finite number")
    return float(value)


# ---- motion of an arm


def _motion(
    chain, bounds, t, plan, criterion, friction, starts, iterations, floor, radius, progress
) -> Excitation:
    arm: Any = chain.mechanism
    n, harmonics = chain.nq, plan["harmonics"]
    inertial = 0  # columns of inertia
    if hasattr(arm, "base"):
        powers = [e for e in chain.effects if isinstance(e, PowerLawFriction)]
        exponents = [np.asarray(e.exponent, float) for e in powers]
        levels = [np.asarray(e.coefficient, float) for e in powers]
        law = LAWS["power"]._replace(nonlinear=False) if friction == "model" else LAWS[friction]
        base = arm.base()
        inertial = len(base.kept)
        exponent = exponents[0] if exponents else np.ones(n)
        task = ArmTask(
            arm,
            exponent,
            levels[0] if levels else np.ones(n),
            tuple(int(i) for i in base.kept),
            law,
        )
        names = names_of(base, law, n) + (
            [f"exponent{j + 1}" for j in range(n)] if law.nonlinear else []
        )
    else:
        if friction != "model":
            raise UsageError(f"{arm.name} is designed for its own friction; leave out --friction")
        task = chain_task(chain)
        names = [ParameterVector(chain).names[i] for i in task.kept]
    geometry, links = geometry_of(arm)
    omega = 2 * np.pi * plan["base_frequency_hz"]
    weight = np.ones(n)  # the condition number of literature is that of rows as they are
    noise, stated = _torque_noise(chain, bounds, omega)
    if criterion == "d_optimal":
        weight = 1 / noise
    groups = ()
    if criterion == "paper001":
        weight, groups = 1 / noise, column_groups(names, inertial)
    setting = SearchSetting(
        bounds=bounds,
        weight=weight,
        arm=geometry,
        radius=radius,
        floor=floor,
        omega=omega,
        links=links,
        criterion=criterion,
        grid=GRID * harmonics,
        groups=groups,
    )
    found = optimise(task, setting, harmonics, starts, plan["seed"], iterations, progress)
    fine = np.linspace(0, 2 * np.pi / omega, 200 * harmonics + 1)
    tried = [_checked(f, fine, arm, geometry, links, radius, floor) for _, f in found]
    fit = [i for i, c in enumerate(tried) if c["fits"]]
    if not fit:
        best = tried[0]
        raise UsageError(
            "no start kept the arm clear of itself and of the floor (nearest links"
            f" {best['links']:.3g} m apart, lowest point at {best['height']:.3g} m): tighten the"
            " ranges with --limits, or state where the floor is with --floor"
        )
    fourier, clear = found[fit[0]][1], tried[fit[0]]
    q, qd, qdd = fourier(t)
    with float64():
        W = np.asarray(task.columns(*(jnp.asarray(x) for x in (q, qd, qdd))))
        tau = np.asarray(_torques(chain, q, qd, qdd))
    rows, weighted = W.reshape(-1, W.shape[2]), (W / noise[:, None]).reshape(-1, W.shape[2])
    size = np.linalg.norm(rows, axis=0)
    std = stds(weighted.T @ weighted)
    joints = chain.signature.joints
    limits = reached(joints, chain.signature, bounds, q, qd, qdd, tau)
    inputs, outputs = chain.signature.inputs, chain.signature.outputs
    channels = tuple(
        [Channel(name, "input", unit) for name, unit in inputs]
        + [Channel(name, "output", unit) for name, unit in outputs]
        + [Channel(f"{name}_cmd", "auxiliary", unit) for name, unit in outputs]
    )
    commands = {f"{j}_cmd": q[:, k] for k, j in enumerate(joints)}
    experiment = Experiment(
        "excitation",
        "fit",
        t,
        tau,
        q,
        dict(commands),
        at_rest=True,
        source="designed, not measured",
    )
    about = content(chain, plan, criterion, bounds, limits) | {
        "kind_of_excitation": "motion",
        "friction": friction,
        "starts": starts,
        "iterations": iterations,
        "condition_number": float(np.linalg.cond(rows)),
        "condition_number_weighted": float(np.linalg.cond(weighted)),
        "condition_number_scaled": float(np.linalg.cond(rows / np.where(size > 0, size, 1.0))),
        "condition_number_of_starts": (
            [float(np.exp(v)) for v, _ in found] if criterion == "condition" else None
        ),
        **(
            {} if criterion != "paper001" else {"paper001": objective_18(weighted, groups, fourier)}
        ),
        "columns": len(names),
        "torque_noise": {"std": noise.tolist(), "source": stated},
        "expected_std": {name: float(s) for name, s in zip(names, std, strict=True)},
        "clearance": (
            None
            if geometry is None
            else {"links_m": clear["links"], "height_m": clear["height"], "radius_m": radius}
        ),
        "speed_coverage": coverage(joints, bounds, qd),
        "fourier": {
            "a": fourier.a,
            "b": fourier.b,
            "middle": fourier.middle,
            "omega": fourier.omega,
        },
        "notes": [
            (
                "q_j = middle_j + sum_l a_lj / (omega l) sin(omega l t) - b_lj / (omega l)"
                " cos(omega l t)"
            ),
            "torques in run_1 are the model's own, nothing here was measured",
            *(
                []
                if geometry is None
                else [
                    "clearance is that of straight lines between joints, not of housings and cables"
                ]
            ),
        ],
    }
    units = _rate_units(chain)
    rates = {f"qd{k + 1}": qd[:, k] for k in range(n)} | {
        f"qdd{k + 1}": qdd[:, k] for k in range(n)
    }
    dataset = Dataset(
        f"{arm.name}_excitation",
        channels,
        (experiment,),
        model=ModelSpec(arm.name),
        description=(
            f"Designed motion for {arm.name} ({units}); torques are the model's own: a plan, not a"
            " recording"
        ),
    )
    return Excitation(dataset, commands, rates, tuple(limits), about, fourier)


def _rate_units(chain: Chain) -> str:
    return ", ".join(sorted({u for _, u in chain.signature.outputs}))


def _torques(chain: Chain, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> Any:
    import jax

    run = jax.jit(jax.vmap(lambda q, qd, qdd: required(chain, q, qd, qdd)))
    tau = run(*(jnp.asarray(x) for x in (q, qd, qdd)))
    return tau / drive_gains(chain)


def _torque_noise(chain: Chain, bounds: Bounds, omega: float) -> tuple[np.ndarray, str]:
    if np.isfinite(bounds.torque_noise).all():
        return bounds.torque_noise, "published for this arm"
    t = np.linspace(0, 2 * np.pi / omega, 100)[:, None]
    half = 0.4 * (bounds.upper - bounds.lower)
    k = 1 + np.arange(chain.nq) % 3
    q = (bounds.upper + bounds.lower) / 2 + half * np.sin(k * omega * t)
    with float64():
        tau = np.asarray(
            _torques(
                chain,
                q,
                half * k * omega * np.cos(k * omega * t),
                -half * (k * omega) ** 2 * np.sin(k * omega * t),
            )
        )
    size = np.maximum(np.sqrt(np.mean(tau**2, 0)), 1e-9)
    return NOISE_SHARE * size, f"{100 * NOISE_SHARE:g} % of the nominal torque"


def _checked(f: Fourier, t, arm, geometry, links, radius: float, floor: float) -> dict[str, Any]:
    if geometry is None:
        return {"fits": True, "links": np.inf, "height": np.inf}
    node = nodes(arm, f(t)[0])
    apart = float(gaps(links, node).min(initial=np.inf)) - 2 * radius
    height = float(heights(links, node).min(initial=np.inf)) - radius
    return {"fits": apart >= 0 and height >= floor, "links": apart, "height": height}


# ---- input of any other model


def _input(
    chain, bounds, t, plan, criterion, starts, amplitude, gain, limits, progress
) -> Excitation:
    signature = chain.signature
    # The fewest inputs: a switch that releases the motor is no excitation.
    plain = [s for s in chain.mechanism.signatures if all(u != "1" for _, u in s.inputs)]
    if signature not in plain and plain:
        chain = Chain(chain.mechanism, chain.effects, signature=plain[0])
        signature = chain.signature
    nu = len(signature.inputs)
    top = (
        widened("amplitude", amplitude, nu)
        if amplitude is not None
        else largest_inputs(chain, bounds)
    )
    gains = None if gain is None else widened("gain", gain, nu)
    if gains is not None and limits is not None and limits.current is not None:
        top = np.minimum(top, gains * np.array(limits.widened(nu).current))
    positions = all(u in ("rad", "m") for _, u in signature.inputs)
    start = settled(chain, bounds.home)
    if not ((start >= bounds.lower) & (start <= bounds.upper)).all():
        bounds = bounds._replace(
            lower=bounds.lower + start - bounds.home,
            upper=bounds.upper + start - bounds.home,
            home=start,
        )
    slew = (0.75 * bounds.speed[:nu], 0.75 * bounds.acceleration[:nu]) if positions else None
    family = Family(
        t,
        plan["harmonics"],
        2 * np.pi * plan["base_frequency_hz"],
        top,
        start[:nu] if positions else np.zeros(nu),
        slew,
    )
    noise = np.array([SENSOR.get(u, 1e-3) for _, u in signature.outputs])
    bench = InputDesign(chain, start, family, bounds, noise)
    u, _ = choose(bench, criterion, starts, plan["seed"], progress)
    return described(bench, u, plan, criterion, gains)


def described(
    bench: InputDesign,
    u: np.ndarray,
    plan: dict[str, Any],
    criterion: str,
    gains: np.ndarray | None,
) -> Excitation:
    """A designed input [time nu] as what it does to the model of a bench, and what it shows of its
    parameters.
    """
    chain, family, bounds, noise, start = (
        bench.chain,
        bench.family,
        bench.bounds,
        bench.noise,
        bench.start,
    )
    signature, top, t = chain.signature, family.top, family.t
    plain = [s for s in chain.mechanism.signatures if all(u != "1" for _, u in s.inputs)]
    y, dy = bench.run(u[None])
    moving = {name for k, (name, _) in enumerate(signature.outputs) if np.ptp(y[0, :, k]) > 0}
    smaller = [
        s
        for s in plain
        if s.inputs == signature.inputs and {name for name, _ in s.outputs} <= moving
    ]
    if (
        len(moving) < len(signature.outputs) and smaller
    ):  # a sensor that shows nothing here, such as a base that stands still
        chain = Chain(chain.mechanism, chain.effects, signature=smaller[0])
        kept = [
            k for k, (name, _) in enumerate(signature.outputs) if name in dict(smaller[0].outputs)
        ]
        signature, noise = smaller[0], noise[kept]
        bench = InputDesign(chain, start, family, bounds, noise)
        y, dy = bench.run(u[None])
    F = bench.fisher(dy)[0]
    condition, dark = determined(F)
    std = stds(F) * bench.unit[bench.free]
    q = y[0][:, chain.joint_outputs]
    qd = np.gradient(q, float(t[1] - t[0]), axis=0)
    used = reached(signature.joints, signature, bounds, q, qd, None)
    for k, (name, unit) in enumerate(signature.inputs):
        high = float(np.abs(u[:, k] - family.center[k]).max())
        used.append(
            {
                "joint": name,
                "quantity": "input",
                "unit": unit,
                "highest": high,
                "limit": float(top[k]),
                "share": high / float(top[k]) if top[k] else 0.0,
            }
        )
    commands = {name: u[:, k] for k, (name, _) in enumerate(signature.inputs)}
    auxiliary: dict[str, np.ndarray] = {}
    if gains is not None:
        if family.slew is not None:
            raise UsageError(
                f"{chain.mechanism.name} takes positions: a gain (N m/A) has no meaning; leave out"
                " --gain"
            )
        auxiliary = {
            _current(name): u[:, k] / gains[k] for k, (name, _) in enumerate(signature.inputs)
        }
    channels = tuple([*bench.channels] + [Channel(name, "auxiliary", "A") for name in auxiliary])
    experiment = Experiment(
        "excitation", "fit", t, u, y[0], auxiliary, at_rest=True, source="designed, not measured"
    )
    values = [bench.layout.values[i] for i in bench.free]
    zero = [
        name for name, v in zip(bench.names, values, strict=True) if v == 0 and "offset" not in name
    ]
    about = content(chain, plan, criterion, bounds, used) | {
        "kind_of_excitation": "input",
        "condition_number": condition,
        "condition_number_scaled": condition,
        "directions_not_shown": dark,
        "assumed_noise": {
            name: float(s) for (name, _), s in zip(signature.outputs, noise, strict=True)
        },
        "expected_std": {name: float(s) for name, s in zip(bench.names, std, strict=True)},
        "assumed_values": {name: float(v) for name, v in zip(bench.names, values, strict=True)},
        "speed_coverage": coverage(signature.joints, bounds, qd),
        "notes": [
            (
                "outputs in run_1 are simulated at the assumed values, nothing here was measured; a"
                " drive played in open loop moves as the machine does, not as the simulation: begin"
                " with a small --amplitude"
            ),
            *(
                [f"assumed to be 0: {', '.join(zero)}. State a guess with --parameters FIT.json"]
                if zero
                else []
            ),
            *(
                [
                    f"{dark} combinations of the parameters show in no output: fix some under"
                    " [model.constants]"
                ]
                if dark
                else []
            ),
        ],
    }
    spec = ModelSpec(chain.mechanism.name)
    text = (
        f"Designed input for {chain.mechanism.name}; outputs are simulated: a plan, not a recording"
    )
    dataset = Dataset(
        f"{chain.mechanism.name}_excitation", channels, (experiment,), model=spec, description=text
    )
    return Excitation(dataset, commands | auxiliary, {}, tuple(used), about)


def widened(name: str, values: Sequence[float], count: int) -> np.ndarray:
    if len(values) not in (1, count) or min(values) <= 0:
        raise UsageError(
            f"--{name} has {len(values)} numbers for {count} inputs; write 1 or {count}, all"
            " above 0"
        )
    return np.broadcast_to(np.asarray(values, float), (count,)).copy()


def _current(name: str) -> str:
    """`tau2` is commanded as `current2_cmd`, `tau` as `current_cmd`."""
    number = name[len(name.rstrip("0123456789")) :]
    return f"current{number}_cmd"
