"""A periodic motion of an arm that shows its numbers, clear of itself and of the floor."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Channel, Dataset, Experiment, ModelSpec
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.drive_torque import drive_gains
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.excitation.bounds import Bounds
from jaxid.excitation.clearance import gaps, heights, nodes
from jaxid.excitation.paper001 import column_groups, objective_18
from jaxid.excitation.result import content, coverage, Excitation, reached, stds
from jaxid.excitation.trajectories import (
    ArmTask,
    chain_task,
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


#: Where the torque's noise is unknown it counts as this share of the joint's nominal torque.
NOISE_SHARE = 0.05


def design_motion(
    *,
    chain: Chain,
    bounds: Bounds,
    t: np.ndarray,
    plan: dict[str, Any],
    criterion: str,
    friction: str,
    starts: int,
    iterations: int,
    floor: float,
    radius: float,
    progress: Any,
) -> Excitation:
    """A periodic motion of an arm. See `jaxid.excitation.design.excite`."""
    arm: Any = chain.mechanism
    harmonics = plan["harmonics"]
    task, names, inertial = _task(chain, friction)
    geometry, links = geometry_of(arm)
    omega = 2 * np.pi * plan["base_frequency_hz"]
    noise, stated = _torque_noise(chain, bounds, omega)
    # The condition number of literature is that of rows as they are.
    weight = np.ones(chain.nq) if criterion == "condition" else 1 / noise
    groups = column_groups(names, inertial) if criterion == "paper001" else ()
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
        W = np.asarray(task.columns(jnp.asarray(q), jnp.asarray(qd), jnp.asarray(qdd)))
        tau = np.asarray(_torques(chain, q, qd, qdd))
    rows, weighted = W.reshape(-1, W.shape[2]), (W / noise[:, None]).reshape(-1, W.shape[2])
    joints = chain.signature.joints
    limits = reached(joints, chain.signature, bounds, q, qd, qdd, tau)
    about = content(chain, plan, criterion, bounds, limits) | {
        "kind_of_excitation": "motion",
        "friction": friction,
        "starts": starts,
        "iterations": iterations,
        **_conditions(rows, weighted),
        "condition_number_of_starts": None,
        "columns": len(names),
        "torque_noise": {"std": noise.tolist(), "source": stated},
        "expected_std": dict(zip(names, stds(weighted.T @ weighted).tolist(), strict=True)),
        "clearance": None,
        "speed_coverage": coverage(joints, bounds, qd),
        "fourier": {
            "a": fourier.a,
            "b": fourier.b,
            "middle": fourier.middle,
            "omega": fourier.omega,
        },
        "notes": list(_NOTES),
    }
    if criterion == "condition":
        about["condition_number_of_starts"] = [float(np.exp(value)) for value, _ in found]
    if criterion == "paper001":
        about["paper001"] = objective_18(weighted, groups, fourier)
    if geometry is not None:
        about["clearance"] = {
            "links_m": clear["links"],
            "height_m": clear["height"],
            "radius_m": radius,
        }
        about["notes"].append(
            "clearance is that of straight lines between joints, not of housings and cables"
        )
    commands = {f"{joint}_cmd": q[:, k] for k, joint in enumerate(joints)}
    rates = {f"qd{k + 1}": qd[:, k] for k in range(chain.nq)}
    rates |= {f"qdd{k + 1}": qdd[:, k] for k in range(chain.nq)}
    experiment = Experiment(
        name="excitation",
        split="fit",
        t=t,
        u=tau,
        y=q,
        auxiliary=dict(commands),
        at_rest=True,
        source="designed, not measured",
    )
    return Excitation(_planned(chain, experiment), commands, rates, tuple(limits), about, fourier)


_NOTES = (
    "q_j = middle_j + sum_l a_lj / (omega l) sin(omega l t) - b_lj / (omega l) cos(omega l t)",
    "torques in run_1 are the model's own, nothing here was measured",
)


def _task(chain: Chain, friction: str) -> tuple[Any, list[str], int]:
    """What the motion is to determine, the names of its columns, and how many are of inertia."""
    arm: Any = chain.mechanism
    n = chain.nq
    if not hasattr(arm, "base"):
        if friction != "model":
            raise UsageError(f"{arm.name} is designed for its own friction; leave out --friction")
        task = chain_task(chain)
        names = ParameterVector(chain).names
        return task, [names[i] for i in task.kept], 0
    law = LAWS["power"]._replace(nonlinear=False) if friction == "model" else LAWS[friction]
    exponent, level = np.ones(n), np.ones(n)
    for effect in chain.effects:
        if isinstance(effect, PowerLawFriction):
            exponent = np.asarray(effect.exponent, float)
            level = np.asarray(effect.coefficient, float)
            break
    base = arm.base()
    names = names_of(base, law, n)
    if law.nonlinear:
        names = names + [f"exponent{j + 1}" for j in range(n)]
    task = ArmTask(arm, exponent, level, tuple(map(int, base.kept)), law)
    return task, names, len(base.kept)


def _conditions(rows: np.ndarray, weighted: np.ndarray) -> dict[str, float]:
    """Condition numbers of the regressor `[rows, columns]`: as it is, by noise, by column."""
    size = np.linalg.norm(rows, axis=0)
    return {
        "condition_number": float(np.linalg.cond(rows)),
        "condition_number_weighted": float(np.linalg.cond(weighted)),
        "condition_number_scaled": float(np.linalg.cond(rows / np.where(size > 0, size, 1.0))),
    }


def _planned(chain: Chain, experiment: Experiment) -> Dataset:
    inputs, outputs = chain.signature.inputs, chain.signature.outputs
    name = chain.mechanism.name
    units = ", ".join(sorted({unit for _, unit in outputs}))
    return Dataset(
        f"{name}_excitation",
        (
            *(Channel(channel, "input", unit) for channel, unit in inputs),
            *(Channel(channel, "output", unit) for channel, unit in outputs),
            *(Channel(f"{channel}_cmd", "auxiliary", unit) for channel, unit in outputs),
        ),
        (experiment,),
        model=ModelSpec(name),
        description=(
            f"Designed motion for {name} ({units}); torques are the model's own: a plan, not a"
            " recording"
        ),
    )


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
