"""What a twin may lack: effects at medium strength, what no effect of the library is, and the
commands under which they show.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxid.benchmark.plants import TwinPlant


#: Seconds of a run, where they are not 8.
SECONDS = {"flexible_link": 4.0}

EITHER = (
    "asymmetric_friction",
    "torque_ripple",
    "constant_torque",
    "gravity_offset",
    "sensor_bias",
    "sensor_scale",
    "position_dependent_friction",
    "torque_scale",
)
BUILTIN = ("viscous_friction", "coulomb_friction")
AT_INPUT = (
    "dead_zone",
    "saturation",
    "supply_droop",
    "torque_scale",
    "actuator_lag",
    "input_delay",
    "input_hold",
    "back_emf",
)
AT_OUTPUT = ("sensor_bias", "sensor_scale", "sensor_lag", "sensor_delay", "timestamp_jitter")


def medium(plant: TwinPlant, j: int, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """effect -> numbers of the twin at medium strength, at joint j; what has no strength (speeds,
    widths, orders) is a tuple.
    """
    T, V, J = plant.torque[j], plant.speed[j], plant.inertia[j]
    U = 1.0 if plant.model == "servo" else T  # size of a command

    def any_of(a, b):
        return (rng.uniform(a, b),)

    out: dict[str, Any] = {
        "dead_zone": {"dead_zone": 0.08 * U},
        "saturation": {"limit": 0.35 * U},
        "supply_droop": {"droop": 0.15 / U},
        "torque_scale": {"scale": 0.1},
        "actuator_lag": {"lag": 0.015},
        "input_delay": {"delay": 0.008},
        "input_hold": {"linear": (1.0,)},
        "back_emf": {"back_emf": 0.1 * T / V},
        "torque_ripple": {"ripple": 0.08 * T, "ripple_order": any_of(5.0, 12.0)},
        "coulomb_friction": {"coulomb": 0.08 * T},
        "asymmetric_friction": {"dry_asymmetry": 0.05 * T, "viscous_asymmetry": 0.03 * T / V},
        "stribeck_friction": {"stribeck": 0.12 * T, "stribeck_speed": any_of(0.04 * V, 0.1 * V)},
        "load_dependent_friction": {"load": 0.12},
        "quadratic_drag": {"drag": 0.15 * T / V**2},
        "power_law_friction": {"power": 0.1 * T / np.sqrt(V), "exponent": any_of(0.4, 0.6)},
        "lugre_friction": {"lugre": 0.12 * T, "presliding": any_of(0.03, 0.08)},
        "position_dependent_friction": {"uneven": 0.05 * T, "uneven_order": any_of(2.0, 5.0)},
        "temperature_dependent_friction": {"warm": 0.3 * T / V**3, "warm_time": any_of(1.5, 3.0)},
        "coupled_friction": {
            "shared_viscous": 0.1 * T / V,
            "shared_dry": 0.03 * T,
            "shared_speed": (0.05 * V,),
        },
        "backlash": {"play": 0.03, "motor_share": (0.4,), "compliance": (0.02 / T,)},
        "joint_elasticity": {
            "compliance": 0.03 / T,
            "motor_share": any_of(0.3, 0.5),
            "spring_damping": (0.1,),
        },
        "hysteresis": {"loop": 0.1 * T, "loop_width": any_of(0.05, 0.15)},
        "payload": {"payload": 0.3 * J / 0.1},
        "constant_torque": {"offset": 0.06 * T},
        "gravity_offset": {"tilt": 0.05},
        "spring_torque": {"spring": 0.2 * T},
        "reflected_inertia": {"reflected": 0.2 * J},
        "flexible_mode": {
            "swing": 0.25 * J,
            "swing_frequency": any_of(3.0, 8.0),
            "swing_damping": (0.05,),
        },
        "sensor_bias": {"bias": 0.03},
        "sensor_scale": {"gain_error": 0.05},
        "sensor_lag": {"sensor_lag": 0.012},
        "sensor_delay": {"sensor_delay": 0.009},
        "timestamp_jitter": {"jitter": 0.003},
    }
    out["viscous_friction"] = {
        "viscous": plant.nominal["viscous"][min(j, len(plant.nominal["viscous"]) - 1)]
    }
    if "coulomb" in plant.nominal:
        out["coulomb_friction"] = {"coulomb": plant.nominal["coulomb"][j]}
    if "offset" in plant.nominal:
        out["constant_torque"] = {"offset": 5 * plant.nominal["offset"][j]}
    if plant.model == "flexible_link":  # a motor behind a spring is not in its twin
        del out["backlash"], out["joint_elasticity"]
    return out


def outsiders(plant: TwinPlant, j: int, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """What no effect of the library is."""
    T, V, end = plant.torque[j], plant.speed[j], SECONDS.get(plant.model, 8.0)
    found = {
        "a periodic torque from outside": {
            "outside": 0.08 * T,
            "outside_hz": rng.uniform(0.6, 2.0),
        },
        "a push of 0.6 s": {
            "outside": 0.3 * T,
            "outside_hz": 0.01,
            "outside_from": 0.4 * end,
            "outside_until": 0.4 * end + 0.6,
        },
        "damping that depends on position": {"bent_damping": 0.25 * T / V},
        "damping that changes at half time": {
            "later_damping": 0.2 * T / V,
            "outside_from": end / 2,
        },
    }
    if plant.n > 1:
        found["a torque that follows the other joint"] = {"other_joint": 0.2 * T}
    return found


def commands(plant: TwinPlant, rng: np.random.Generator, runs: int, before: int = 0) -> np.ndarray:
    """A multisine with steps and rests for each input, [runs samples nu], by so many samples longer
    than usual.
    """
    count = before + int(plant.rate * SECONDS.get(plant.model, 8.0))
    t = np.arange(count) / plant.rate
    u = np.zeros((runs, count, plant.n))
    for r in range(runs):
        for j in range(plant.n):
            reach = 1.2 if plant.model == "servo" else plant.torque[j]
            lines, base = rng.integers(5, 10), rng.uniform(0.15, 0.4)
            for k in range(1, lines + 1):
                f = k * base * rng.uniform(0.7, 1.3)
                u[r, :, j] += (
                    reach * np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) / np.sqrt(lines)
                )
            for _ in range(4):
                a = rng.integers(0, count - count // 8)
                part = slice(a, a + rng.integers(count // 40, count // 10))
                u[r, part, j] = rng.uniform(-reach, reach) if rng.uniform() < 0.6 else 0.0
            if plant.model in (
                "joint",
                "flexible_link",
            ):  # nothing holds them: keep them from running away
                u[r, :, j] -= u[r, :, j].mean()
    return u


def steps(plant: TwinPlant, rng: np.random.Generator, run: int) -> np.ndarray:
    """The papers' own excitation: two levels after each other at one joint, the others without
    drive, [samples nu].
    """
    count = int(plant.rate * SECONDS.get(plant.model, 8.0))
    u = np.zeros((count, plant.n))
    j = run % plant.n
    reach = 1.2 if plant.model == "servo" else plant.torque[j]
    first, second = rng.uniform(0.6, 1.0), rng.uniform(0.3, 0.8)
    sign = rng.choice([-1, 1])
    u[count // 16 : 6 * count // 16, j] = sign * first * reach
    u[6 * count // 16 : 11 * count // 16, j] = -sign * second * reach
    return u
