"""Gaps between what the papers fit and what they (or physics) say of their own rigs, as cases of
the diagnosis.

Tracker: the motors' measured torques (paper 003, Table 1) against its formula (6). Joint: friction
that grows with a power of the speed against a linear law (paper 001). Flexible link (paper 002): a
beam stiffened by its rotation against the paper's equations, in slow and in fast moves; and a hub
with dry friction whose frequency response is read as that of a linear system. Twins are separately
written equations. The number that is compared is the one that the gap bends most in the re-tuned
model.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp


sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from jaxid.runtime import prepare  # noqa: E402


prepare()

from jaxid.api import diagnose, fit  # noqa: E402
from jaxid.benchmark import link_twin, numpy_twin as twins, plants  # noqa: E402
from jaxid.data.dataset import Dataset  # noqa: E402
from jaxid.models import FlexibleLink, Joint, Tracker  # noqa: E402
from jaxid.problem.frequency_response import FrequencyResponseError  # noqa: E402


SPLITS = ("fit", "fit", "validation", "report")


def recorded(
    plant: plants.TwinPlant, u: np.ndarray, y: np.ndarray, units: dict[str, str] | None = None
) -> Dataset:
    """Runs [runs samples channels], the commands named and measured as in `units`."""
    inputs = units or dict(plant.inputs)
    t = np.arange(u.shape[1]) / plant.rate
    return Dataset.from_arrays(
        [t] * len(u),
        inputs={n: list(u[:, :, i]) for i, n in enumerate(inputs)},
        outputs={n: list(y[:, :, i]) for i, (n, _) in enumerate(plant.outputs)},
        units=inputs | dict(plant.outputs),
        split=SPLITS,
        at_rest=True,
        noise_std={
            n: plant.noise if i < plant.n else 0.05 for i, (n, _) in enumerate(plant.outputs)
        },
        resolution={n: plant.resolution for n, _ in plant.outputs[: plant.n] if plant.resolution},
    )


def tracker() -> Dataset:
    """Stepped in volts, one axis after the other as in paper 003, on motors as its Table 1 has
    them; 0.1 degree noise.
    """
    plant = dataclasses.replace(plants.PLANTS["tracker"], noise=np.deg2rad(0.1), resolution=0.0)
    t = np.arange(1000) / 100
    u = np.zeros((4, 1000, 2))
    for run, (axis, first, second) in enumerate(
        [(0, 3.6, 2.4), (1, 3.6, 2.4), (0, 3.2, 2.0), (1, 3.0, 2.2)]
    ):
        u[run, :, axis] = np.where(
            (t >= 1) & (t < 4), first, np.where((t >= 4) & (t < 7), second, 0.0)
        )
    torque = np.sign(u) * np.interp(abs(u), (0, 1.68, 2.4, 3.6), (0, 0, 0.0882, 0.1176))
    numbers = {"J": np.array((0.117, 0.1)), "viscous": np.array((1.9, 1.495))}
    y = twins.recorded(
        plant, torque, {k: np.tile(x, (4, 1)) for k, x in numbers.items()}, np.random.default_rng(0)
    )
    return recorded(plant, u, y, {"u_theta": "V", "u_alpha": "V"})


def joint() -> Dataset:
    """Dry friction, and 0.09 N m (s/rad)^0.5 that the model takes for viscous friction."""
    plant, rng = plants.PLANTS["joint"], np.random.default_rng(1)
    t = np.arange(int(8 * plant.rate)) / plant.rate

    def waves():
        return sum(
            a * np.sin(2 * np.pi * f * rng.uniform(0.8, 1.2) * t + 2 * np.pi * rng.uniform())
            for a, f in ((0.25, 0.25), (0.1, 0.9))
        )

    u = np.array([waves() for _ in SPLITS])[:, :, None]
    numbers: dict[str, float] = {"J": 0.06, "coulomb": 0.04, "power": 0.09, "exponent": 0.5}
    y = twins.recorded(plant, u, {k: np.full((4, 1), x) for k, x in numbers.items()}, rng)
    return recorded(plant, u, y)


LINK = {k: v for k, v in plants.LINK.items() if k != "coulomb"}


def turning_link(torque: float) -> Dataset:
    """Pulses of a size, kicks while the hub turns and brakes; the full nonlinear beam with its
    tension.
    """
    plant, rng = (
        dataclasses.replace(plants.PLANTS["flexible_link"], resolution=0.0),
        np.random.default_rng(2),
    )
    t = np.arange(int(4 * plant.rate)) / plant.rate
    u = np.zeros((4, len(t)))
    for run in u:
        for start, length, size in (
            (0.1, 0.3, 1.0),
            (1.2, 0.06, 0.4),
            (2.2, 0.3, -1.0),
            (3.2, 0.06, -0.4),
        ):
            begin = start + rng.uniform(0, 0.1)
            run[(t >= begin) & (t < begin + length * rng.uniform(0.7, 1.1))] = (
                size * torque * rng.uniform(0.8, 1.2)
            )
    y = np.array([beam(t, run) for run in u])
    y += np.array([plant.noise, 0.05]) * rng.standard_normal(y.shape)
    return recorded(plant, u[:, :, None], y)


def beam(t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Hub angle and tip acceleration [samples 2] under held torques: Lagrange's equations with the
    tension's foreshortening.
    """
    Mp, Kp, c, rigid, G = link_twin.link_matrices(0.0)
    S, n = Mp - G, len(c)
    C, K = LINK["alpha"] * Mp + LINK["beta"] * LINK["E"] * Kp, LINK["E"] * Kp

    def acceleration(x: np.ndarray, tau: float) -> np.ndarray:
        psi, w, psid = x[1 : n + 1], x[n + 1], x[n + 2 :]
        M = np.block(
            [[np.array([[LINK["I_m"] + rigid + psi @ S @ psi]]), c[None]], [c[:, None], Mp]]
        )
        hub = tau - LINK["viscous"] * w - 2 * w * (psi @ S @ psid)
        return np.linalg.solve(M, np.append(hub, w * w * S @ psi - C @ psid - K @ psi))

    x, out = np.zeros(2 * n + 2), np.empty((len(t), 2))
    edges = [0, *(np.flatnonzero(np.diff(u)) + 1), len(t) - 1]
    for a, b in zip(edges, edges[1:], strict=False):
        tau = float(u[a])

        def field(_, x, tau=tau):
            return np.concatenate([x[n + 1 :], acceleration(x, tau)])

        path = solve_ivp(field, (t[a], t[b]), x, "Radau", t[a : b + 1], rtol=1e-8, atol=1e-10).y
        for k in range(a, b + 1):
            now = acceleration(path[:, k - a], float(u[k]))
            out[k] = path[0, k - a], link_twin.LONG * now[0] + now[n - 1]
        x = path[:, -1]
    return out


def rubbing_link() -> Dataset:
    """The paper's pulse (0.241 N m for 0.3 s) on a hub whose dry friction, 0.1071 N m, the model
    does not have.
    """
    plant = plants.PLANTS["flexible_link"]
    t = np.arange(int(4 * plant.rate)) / plant.rate
    u = np.array(
        [
            np.where((t >= 0.5) & (t < 0.5 + d), a, 0.0)
            for a, d in ((0.241, 0.3), (0.3, 0.2), (0.27, 0.25), (0.22, 0.3))
        ]
    )
    numbers = {k: np.full((4, 1), v) for k, v in (LINK | {"coulomb": 0.1071}).items()}
    y = twins.recorded(plant, u[:, :, None], numbers, np.random.default_rng(3))
    return recorded(plant, u[:, :, None], y)


def cases() -> list[tuple[str, str, object, Dataset, dict[str, float]]]:
    """Rig and motion, what is withheld, the model, recordings, true numbers."""
    stiff = "a beam that its rotation stiffens"
    link = {"E": LINK["E"], "I_m": LINK["I_m"]}
    yaw = {"J_theta": 0.117, "J_alpha": 0.1}
    full = FlexibleLink(nonlinear=True, n_modes=3)
    return [
        (
            "tracker, steps in volts",
            "motors as in Table 1, not as in formula (6)",
            Tracker(),
            tracker(),
            yaw,
        ),
        (
            "joint",
            "friction with the square root of the speed",
            Joint(),
            joint(),
            {"inertia": 0.06},
        ),
        ("flexible link, up to 1 rad/s", stiff, full, turning_link(0.03), link),
        ("flexible link, up to 9 rad/s", stiff, full, turning_link(0.3), link),
        (
            "flexible link, the paper's pulse",
            "dry friction at the hub",
            FlexibleLink(),
            rubbing_link(),
            link,
        ),
    ]


def worst(parameters: dict[str, Any], truth: dict[str, float], name: str = "") -> tuple[str, str]:
    """The number that is furthest from its true value, or this one, and by how much."""
    wrong = {k: 100 * (parameters[k].value / v - 1) for k, v in truth.items()}
    name = name or max(wrong, key=lambda k: abs(wrong[k]))
    return name, f"{name} {wrong[name]:+.3g} %"


def rubbing(model: object) -> tuple[str, ...]:
    """What the flexible link goes without: the dry friction of its hub."""
    return ("coulomb_friction",) if isinstance(model, FlexibleLink) else ()


def row(
    rig: str, withheld: str, model: object, data: Dataset, truth: dict[str, float]
) -> dict[str, Any]:
    found = diagnose(model, data, without=rubbing(model), seed=0)
    name, before = worst(found.nominal.parameters, truth)

    def numbers(e):
        return ", ".join(f"{k} {p.value:.3g}" for k, p in e.parameters.items())

    def listed(effects):
        return ", ".join(f"{e.effect} at {e.location}" for e in effects)

    unseen = [u for u in found.unseen if not u.absorbed]
    return {
        "rig": rig,
        "withheld": withheld,
        "gap, re-tuned": round(found.how_far.gap_retuned, 3),
        "worst number, re-tuned": before,
        "verdict": found.which.verdict,
        "named": " and ".join(
            f"{e.effect} at {e.location} ({numbers(e)})" for e in found.which.effects
        ),
        "not told apart": listed(found.which.confusable_with),
        "gap after": round(found.how_far.gap_after, 3),
        "the same number after": worst(found.final.parameters, truth, name)[1],
        "said not to show": listed(unseen),
    }


def read_as_linear(data: Dataset, truth: dict[str, float]) -> dict[str, Any]:
    """What a fit of the response as a linear system's makes of a hub that rubs."""
    found = fit(
        FlexibleLink(),
        data,
        without=rubbing(FlexibleLink()),
        residual=FrequencyResponseError(linear=True),
    )
    return {
        "rig": "the same, response read as linear",
        "withheld": "dry friction at the hub",
        "worst number, re-tuned": worst(found.parameters, truth)[1],
        "verdict": "(a fit alone)",
    }


def main() -> dict[str, Any]:
    rows: list[dict[str, Any]] = []
    for rig, withheld, model, data, truth in cases():
        began = time.perf_counter()
        rows.append(
            row(rig, withheld, model, data, truth) | {"s": round(time.perf_counter() - began, 1)}
        )
        print(rows[-1], flush=True)
    rows.append(read_as_linear(rubbing_link(), {"E": LINK["E"], "I_m": LINK["I_m"]}))
    print(rows[-1], flush=True)
    about = (__doc__ or "").split("\n", 2)[2].strip()
    return {"title": "The papers' own gaps", "text": about, "rows": rows}


if __name__ == "__main__":
    main()
