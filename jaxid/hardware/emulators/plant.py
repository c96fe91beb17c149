"""What an emulator moves: joints simulated by jaxid's own models, with hidden parameters and
effects, in real time.
"""

from __future__ import annotations

import json
import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from jaxid.base.errors import nearest, UsageError
from jaxid.base.numbers import is_finite
from jaxid.base.wording import names_of


#: Longest step of a simulation (s).
STEP = 5e-4
COUPLED_STEP = 2e-3  # of a whole arm, which has to keep up with real time


class EmulatedPlant(Protocol):
    """Joints and what they move. `q`, `qd`: rad, rad/s, one number a joint."""

    q: list[float]
    qd: list[float]

    def advance(self, duration: float, torque: Sequence[float]) -> None:
        """Moves on by `duration` s under held torques (N m)."""
        ...


class Ideal:
    """inertia qdd + viscous qd + gravity_torque sin q = torque, in plain Python: starts at once,
    for trying a connection.
    """

    def __init__(
        self, inertia: Sequence[float], viscous: Sequence[float], gravity_torque: Sequence[float]
    ):
        self.inertia, self.viscous, self.gravity_torque = (
            list(inertia),
            list(viscous),
            list(gravity_torque),
        )
        self.q, self.qd = [0.0] * len(self.inertia), [0.0] * len(self.inertia)

    def advance(self, duration: float, torque: Sequence[float]) -> None:
        count = max(1, math.ceil(duration / STEP))
        h = duration / count
        for j, u in enumerate(torque):
            q, v = self.q[j], self.qd[j]
            for _ in range(count):
                force = u - self.gravity_torque[j] * math.sin(q)
                v = (v + h * force / self.inertia[j]) / (1 + h * self.viscous[j] / self.inertia[j])
                q += h * v
            self.q[j], self.qd[j] = q, v


class Modelled:
    """Joints stepped by `jaxid.dynamics.chain`: one model of one joint for each of them, or one
    model for all (such as `ur10`), whose joints then know of each other.
    """

    def __init__(
        self,
        model: str,
        parameters: Sequence[Mapping[str, float]],
        effects: Sequence[Mapping[str, Any]],
    ):
        """`parameters` of each joint (of a model for all: `F_v` of joint 3 is its `F_v3`); an
        effect is `{"effect", "parameters", "joint"}`, joint 1 … or None for all.

        Raises `UsageError` for unknown names and for models with another number of joints.
        """
        import jax
        import jax.numpy as jnp

        from jaxid.dynamics.effect import Command
        from jaxid.dynamics.parameter_vector import ParameterVector
        from jaxid.numerics.precision import float64

        count = len(parameters)
        chain = _chain(model, effects, count)
        coupled = chain.nq == count > 1
        layout = ParameterVector(chain)
        theta = _parameter_values(layout, parameters, effects, coupled)
        nq = chain.nq

        def start(theta):
            return layout.model(theta).start(jnp.zeros(nq), jnp.zeros(nq), jnp.zeros(nq))

        def move(theta, carry, u, h, count):
            chain = layout.model(theta)
            body = chain.body()

            def command(k):
                return Command(k * h, h, u, u, lambda d: u)

            carry = jax.lax.fori_loop(
                0, count, lambda k, c: chain.advance(body, c, command(k))[0], carry
            )
            return carry, *body.port(carry.x)

        self._context = float64
        self._shape = (len(theta), nq)
        self._step = COUPLED_STEP if coupled else STEP
        with float64():
            self._theta = jnp.asarray(theta)
            self._carry = jax.jit(jax.vmap(start))(self._theta)
            self._move = jax.jit(jax.vmap(move, (0, 0, 0, None, None)))
        self.q, self.qd = [0.0] * count, [0.0] * count
        start_state = self._carry
        self.advance(self._step, [0.0] * count)  # compiles
        self._carry, self.q, self.qd = start_state, [0.0] * count, [0.0] * count

    def advance(self, duration: float, torque: Sequence[float]) -> None:
        import numpy as np

        if duration <= 0:
            return
        count = max(1, math.ceil(duration / self._step - 1e-9))
        with self._context():
            h, u = np.float64(duration / count), np.asarray(torque, np.float64).reshape(self._shape)
            self._carry, q, qd = self._move(self._theta, self._carry, u, h, np.int64(count))
            self.q, self.qd = np.asarray(q).ravel().tolist(), np.asarray(qd).ravel().tolist()


def _chain(model: str, effects: Sequence[Mapping[str, Any]], count: int) -> Any:
    """A model with the effects that it does not have already, of one joint or of all `count`."""
    from jaxid.dynamics import catalogue
    from jaxid.dynamics.chain import Chain
    from jaxid.dynamics.effect import RecordEffect

    chain = Chain(catalogue.model_class(model)())
    if not chain.direct or chain.signature.linear or chain.nq not in (1, count):
        raise UsageError(
            f"an emulator of {count} joints takes models with one driven revolute joint, or"
            f" with {count}; {model} is none"
        )
    present = set(names_of(chain.effects))
    added = {}
    for effect in effects:
        kind = catalogue.effect_class(effect["effect"])
        # An emulator lives in the present.
        if kind.acts_on == "timing" or issubclass(kind, RecordEffect):
            raise UsageError(
                f"{effect['effect']} cannot be emulated: it needs the history of the command"
            )
        if kind.name not in present:
            added[kind] = kind()
    return chain.with_effects(*added.values())


def _parameter_values(
    layout: Any,
    parameters: Sequence[Mapping[str, float]],
    effects: Sequence[Mapping[str, Any]],
    coupled: bool,
) -> Any:
    """`[rows, numbers]`: one row of a coupled model, else one a joint."""
    import numpy as np

    count = len(parameters)
    theta = np.tile(layout.values, (1 if coupled else count, 1))
    for j, values in enumerate(parameters):
        row = 0 if coupled else j
        for name, value in values.items():
            own = f"{name}{j + 1}"
            theta[row, layout.index(own if coupled and own in layout.names else name)] = value
    for effect in effects:
        joint = effect.get("joint")
        joints = range(count) if joint is None else [joint - 1]
        numbers = layout.of_effect(effect["effect"])
        for field, value in effect["parameters"].items():
            own = [i for i in numbers if layout.entries[i].field == field]
            if not own:
                fields = [layout.entries[i].field for i in numbers]
                raise UsageError(
                    f"effect {effect['effect']} has no parameter {field!r}{nearest(field, fields)}"
                )
            for j in joints:
                if coupled:
                    theta[0, [i for i in own if layout.entries[i].place == j]] = value
                else:
                    theta[j, own] = value
    return theta


def read_plant(
    path: str | os.PathLike[str] | None, joints: int, defaults: Mapping[str, Sequence[float]]
) -> tuple[EmulatedPlant, dict[str, Any]]:
    """The plant a file describes, and the whole of the file.

    `None` is a pendulum a joint with the `defaults`, `"ideal"` the same equation in plain Python. A
    file is TOML or JSON with `model`, `parameters` (a number, or a list with one a joint; a fit's
    `{"value": …}` is read too) and `effects` as in fit.json.
    """
    if path is None:
        return Modelled("pendulum", _by_joint(defaults, joints, "defaults"), []), {}
    if str(path) == "ideal":
        simple = {name: defaults[name] for name in ("inertia", "viscous", "gravity_torque")}
        return Ideal(**{k: (list(v) * joints)[:joints] for k, v in simple.items()}), {}
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except OSError as error:
        raise UsageError(f"plant {path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise UsageError(f"plant {path}: not readable: {error}") from error
    model = content.get("model", "pendulum")
    given = {name: _value(path, name, v) for name, v in content.get("parameters", {}).items()}
    if model == "pendulum":
        given = {**defaults, **given}
    parameters = _by_joint(given, joints, str(path))
    effects = [_effect(path, e, joints) for e in content.get("effects", [])]
    return Modelled(model, parameters, effects), content


def _effect(path: Path, entry: Any, joints: int) -> dict[str, Any]:
    if not isinstance(entry, Mapping) or "effect" not in entry:
        raise UsageError(f"plant {path}: an effect needs `effect` and `parameters`")
    joint = entry.get("joint")
    if joint is not None and not (isinstance(joint, int) and 1 <= joint <= joints):
        raise UsageError(f"plant {path}: joint is {joint!r}; there are joints 1 to {joints}")
    values = {name: _value(path, name, v) for name, v in entry.get("parameters", {}).items()}
    return {"effect": entry["effect"], "joint": joint, "parameters": values}


def _value(path: Path, name: str, value: Any) -> Any:
    value = value.get("value") if isinstance(value, Mapping) else value
    numbers = value if isinstance(value, list) else [value]
    if not numbers or not all(map(is_finite, numbers)):
        raise UsageError(
            f"plant {path}: {name} is {value!r}; write a finite number, or one a joint"
        )
    return value


def _by_joint(values: Mapping[str, Any], joints: int, where: str) -> list[dict[str, float]]:
    out: list[dict[str, float]] = [{} for _ in range(joints)]
    for name, value in values.items():
        numbers = list(value) if isinstance(value, Sequence) else [value]
        if len(numbers) not in (1, joints):
            raise UsageError(f"plant {where}: {name} has {len(numbers)} values for {joints} joints")
        for j in range(joints):
            out[j][name] = float(numbers[j % len(numbers)])
    return out
