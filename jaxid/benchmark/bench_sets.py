"""Sets of a cart with a pole, by SciPy, and of recordings whose conventions are broken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from inspect import getsource
from typing import Any

import numpy as np

from jaxid.benchmark import broken, cart_pole
from jaxid.benchmark.case import (
    asked_rows,
    BlindCase,
    CONVENTIONS,
    depends_on,
    Draft,
    Exam,
    SPLITS,
    WithheldEffect,
)
from jaxid.benchmark.rigs import chain_of
from jaxid.benchmark.scipy_twin import CartPoleTwin, motion
from jaxid.data.dataset import Dataset
from jaxid.dynamics import catalogue


# ---- the cart

RATE, SECONDS, EXAM_S = 50, 6.0, 3.0
NOISE = {"x": 5e-5, "theta": 5e-4}
#: Numbers of it that are stated.
STATED = {"cart": 0.82, "J": 0.0335, "viscous_x": 3.0, "coulomb_x": 0.6, "viscous_theta": 0.0024}
#: Effects of the cart and their medium strength, in the unit of their number.
OF_CART = {
    "dead_zone": 0.4,
    "quadratic_drag": 4.0,
    "spring_torque": 6.0,
    "constant_torque": 0.3,
    "stribeck_friction": 0.5,
    "viscous_friction": 2.0,
    "input_delay": 0.02,
    "sensor_bias": 0.05,
}
AT_POLE = ("sensor_bias",)


class LackingCart(CartPoleTwin):
    """The cart and pole with one effect of a size at the cart."""

    def __init__(self, effect: str = "", size: float = 0.0):
        super().__init__(dead_zone=size if effect == "dead_zone" else 0.0)
        self.effect, self.size = effect, size

    def __call__(self, q, v, u):
        M, force = super().__call__(q, v, u)
        forces = {
            "quadratic_drag": v[0] * abs(v[0]),
            "spring_torque": q[0],
            "constant_torque": 1.0,
            "viscous_friction": v[0],
        }
        force[0] -= self.size * forces.get(self.effect, 0.0)
        return M, force

    def dry(self, speed: float) -> float:
        more = 0.0
        if self.effect == "stribeck_friction":
            more = self.size * float(np.exp(-((speed / 0.05) ** 2)))
        return super().dry(speed) + more


def cart_drafts(name: str, seed: int, numbers: Sequence[int]) -> list[Draft]:
    """Carts that a motor's volts move on a rail; a pole hangs from each."""
    return [Draft(name, seed, number, f"{name} {number % 16}", _carts) for number in numbers]


def _carts(group: Sequence[Draft]) -> list[BlindCase]:
    return [_cart(draft) for draft in group]


def _volts(rng: np.random.Generator, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Time, and volts [time 1]: sines and two steps, around zero."""
    t = np.arange(int(RATE * seconds)) / RATE
    f, phase = rng.uniform(0.3, 2.5, 5), rng.uniform(0, 6.3, 5)
    u = 2.2 * np.sin(2 * np.pi * t[:, None] * f + phase).sum(1)
    u += np.where((t > 0.5 * seconds) & (t < 0.7 * seconds), rng.uniform(-4, 4), 0.0)
    return t, (u - u.mean())[:, None]


def _cart(draft: Draft) -> BlindCase:
    rng = draft.rng()
    effect = str(rng.choice(list(OF_CART))) if rng.uniform() > 0.15 else ""
    size = OF_CART.get(effect, 0.0) * rng.choice([0.5, 1.0, 2.0]) * rng.uniform(0.7, 1.4)
    late = size if effect == "input_delay" else 0.0
    plant = LackingCart(effect, size)

    def read(t: np.ndarray, u: np.ndarray) -> np.ndarray:
        q, _ = motion(plant, t, u, np.zeros(2), np.zeros(2), late)
        q[:, 1] += size * (effect == "sensor_bias")
        return q + np.array(list(NOISE.values())) * rng.standard_normal(q.shape)

    drives = [_volts(rng, SECONDS) for _ in SPLITS]
    readings = [read(t, u) for t, u in drives]
    t, u = _volts(rng, EXAM_S)
    last = read(t, u)
    said, _ = motion(LackingCart(), t, u, np.zeros(2), np.zeros(2))
    data = Dataset.from_arrays(
        [t for t, _ in drives],
        inputs={"u": [u[:, 0] for _, u in drives]},
        outputs={"x": [q[:, 0] for q in readings], "theta": [q[:, 1] for q in readings]},
        units={"u": "V", "x": "m", "theta": "rad"},
        split=list(SPLITS),
        at_rest=True,
        noise_std=NOISE,
        check_model=False,
    )
    rows = asked_rows(len(t), RATE // 10)
    exam = Exam(
        given={"t": t, "u": u[:, 0]},
        rows=rows,
        truth={n: last[rows, k] for k, n in enumerate(NOISE)},
        stated={n: said[rows, k] for k, n in enumerate(NOISE)},
        noise=NOISE,
    )
    missing = ()
    if effect:
        joint = "theta" if effect in AT_POLE else "x"
        missing = (WithheldEffect(effect, joint, float(size)),)
    question = {
        "model": "cart_pole.py",
        "equations": cart_pole.CartPole.equations,
        "without": [],
        "stated": STATED,
        "joints": ["x", "theta"],
    }
    return BlindCase(
        question=question,
        dataset=data,
        simulator="scipy",
        missing=missing,
        over=depends_on(missing),
        exam=exam,
        files={"cart_pole.py": getsource(cart_pole)},
        model_toml=_model_toml(),
    )


def _model_toml() -> str:
    """Lines of [model]: its file, and the numbers that are stated."""
    lines = ['file = "cart_pole.py"']
    lines += [f"[model.parameters.{name}]\nvalue = {value}" for name, value in STATED.items()]
    return "\n".join(lines) + "\n"


# ---- conventions


def convention_drafts(name: str, seed: int, numbers: Sequence[int]) -> list[Draft]:
    """One convention broken in a recording by torque; in one of sixteen none is."""
    return [Draft(name, seed, number, f"{name} {number % 4}", _conventions) for number in numbers]


def _conventions(group: Sequence[Draft]) -> list[BlindCase]:
    return [_convention(draft) for draft in group]


def _convention(draft: Draft) -> BlindCase:
    rng = draft.rng()
    kinds = [*CONVENTIONS, ""]
    model = str(rng.choice(broken.MODELS))
    kind = str(rng.choice(kinds))
    if kind == "swapped_channels" and model == "pendulum":
        kind = ""
    effect = str(rng.choice(["", "drag", "spring"]))
    sound = broken.recording(model, int(rng.integers(2**31)), effect)
    fault, channel = sound, ""
    if kind:
        fault, channel, _ = broken.broken(kind, sound, rng)
    signature = chain_of(model).signature
    joints = list(signature.joints)
    missing = _lacking(kind, channel, sound, joints)
    last = joints[-1]
    beside = {"drag": "quadratic_drag", "spring": "spring_torque"}
    if effect:
        missing += [WithheldEffect(beside[effect], joint) for joint in joints]
    tables = []
    for run in range(len(fault.u)):
        table: dict[str, np.ndarray] = {"t": fault.t}
        table |= {n: fault.u[run, :, i] for i, (n, _) in enumerate(sound.plant.inputs)}
        table |= {n: fault.y[run, :, i] for i, (n, _) in enumerate(sound.plant.outputs)}
        tables.append(table)
    over = depends_on(missing)
    if kind:
        over = ("reading", "command", "time", "constant", *over)
    question: dict[str, Any] = {
        "model": model,
        "equations": catalogue.model_class(model).equations,
        "without": [],
        "stated": {k: list(x) for k, x in sound.plant.nominal.items()},
        "joints": joints,
        "gravity_acts_on": last,
    }
    return BlindCase(
        question=question,
        dataset=replace(sound, at_rest=fault.at_rest).dataset(),
        simulator="numpy (torque of a motion)",
        missing=tuple(missing),
        over=over,
        tables=tuple(tables),
    )


def _lacking(
    kind: str, channel: str, sound: broken.SoundRecording, joints: list[str]
) -> list[WithheldEffect]:
    """The broken convention at its joint; what all channels share may be said of any joint."""
    if not kind:
        return []
    channels = [n for n, _ in (*sound.plant.inputs, *sound.plant.outputs)]
    j = channels.index(channel) % len(joints) if channel in channels else 0
    shared = kind in ("row_shift", "clock", "time_unit", "not_at_rest", "swapped_channels")
    others = [f"{kind}@{joint}" for joint in joints if joint != joints[j]]
    alike = tuple(others) if shared else ()
    return [WithheldEffect(kind, joints[j], None, alike)]
