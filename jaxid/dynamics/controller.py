"""Feedback laws of recordings, as pure functions for a simulation under the same controller.

The controller reads the simulated position (and velocity) at its own sample time, and holds its
output until the next one:

- `pd`: v = kp (q_cmd - q) + kd (qd_cmd - qd)
- `pid`: the same + ki * integral of (q_cmd - q), which stands still while the output is saturated and the error drives it further
- `cascade`: v = kv (kp (q_cmd - q) - qd): a velocity loop inside a position loop

and the input of the model is u = gain * clip(v + offset + disturbance, -saturation, saturation).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import nearest, UsageError
from jaxid.base.numbers import is_number
from jaxid.data.dataset import Controller, Dataset
from jaxid.dynamics.mechanism import Signature


#: Gains that each kind needs and may have.
GAINS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "pd": (("kp", "kd"), ()),
    "pid": (("kp", "ki", "kd"), ()),
    "cascade": (("kp", "kv"), ()),
}
#: Numbers that every kind may state, one for all joints or a list with one per joint.
COMMON = {"gain": 1.0, "saturation": float("inf"), "offset": 0.0}
#: Words that every kind may state: the choices, the first is the default; () is free text.
WORDS: dict[str, tuple[str, ...]] = {
    "velocity": ("difference", "averaged_difference", "measured"),
    "reference_velocity": ("difference", "none"),
    "disturbance": (),
}
SAMPLE_TIME = "sample_time"


@dataclass(frozen=True)
class Law:
    """A checked controller of `n` joints. Gains have one entry per joint; equal laws are equal, so
    that they share programs.

    `references`, `disturbances`: names of auxiliary channels per joint ("" for none). `sample_time`
    s; `every_sample` says that the controller runs at the samples of the recording.
    """

    kind: str
    kp: tuple[float, ...]
    ki: tuple[float, ...]
    kd: tuple[float, ...]  # of the cascade: kv
    gain: tuple[float, ...]
    saturation: tuple[float, ...]
    offset: tuple[float, ...]
    velocity: str
    reference_velocity: str
    references: tuple[str, ...]
    disturbances: tuple[str, ...]
    sample_time: float
    every_sample: bool

    @property
    def text(self) -> str:
        """One sentence for the notes of a result."""

        def values(a):
            return ", ".join(f"{x:g}" for x in a)

        gains = {"kp": self.kp, "ki": self.ki, ("kv" if self.kind == "cascade" else "kd"): self.kd}
        stated = "; ".join(f"{name} = {values(a)}" for name, a in gains.items() if any(a))
        return f"{self.kind} controller, {stated}, sample time {self.sample_time:g} s"


class Memory(NamedTuple):
    """What a controller remembers between its samples: held model input, integral part, the last
    two positions.
    """

    u: Float[Array, " n"]
    integral: Float[Array, " n"]
    last: Float[Array, " n"]
    before: Float[Array, " n"]


class ControllerInput(NamedTuple):
    """What a controller is told besides the measurement: reference, its rate, a disturbance of the
    output.
    """

    q_cmd: Float[Array, " n"]
    qd_cmd: Float[Array, " n"]
    disturbance: Float[Array, " n"]


def begin(
    law: Law,
    q: Float[Array, " n"],
    qd: Float[Array, " n"],
    u: Float[Array, " n"],
    r: ControllerInput,
) -> Memory:
    """Memory at the start of a run from position q, velocity qd under the input u; an integral
    starts where it gives u.
    """
    back = law.sample_time * qd
    empty = Memory(u, jnp.zeros_like(q), q - back, q - 2 * back)
    output = _output(law, empty, q, qd, r)
    integral = jnp.where(jnp.array(law.ki) > 0, u / jnp.array(law.gain) - output, 0.0)
    return empty._replace(integral=integral)


def update(
    law: Law, m: Memory, q: Float[Array, " n"], qd: Float[Array, " n"], r: ControllerInput
) -> Memory:
    """Memory after the controller has read position q; `qd` is used only where the velocity is
    measured.
    """
    limit, ki, error = jnp.array(law.saturation), jnp.array(law.ki), r.q_cmd - q
    output = _output(law, m, q, qd, r) + m.integral
    u = jnp.array(law.gain) * jnp.clip(output, -limit, limit)
    winds_up = (jnp.abs(output) > limit) & (output * error > 0)
    integral = m.integral + jnp.where(winds_up, 0.0, ki * law.sample_time * error)
    return Memory(u, integral, q, m.last)


def _output(law: Law, m: Memory, q: Array, qd: Array, r: ControllerInput) -> Array:
    """Output in the controller's own unit, without saturation and integral."""
    if law.velocity == "difference":
        qd = (q - m.last) / law.sample_time
    elif law.velocity == "averaged_difference":
        qd = (q - m.before) / (2 * law.sample_time)
    kp, kd = jnp.array(law.kp), jnp.array(law.kd)
    if law.kind == "cascade":
        v = kd * (kp * (r.q_cmd - q) + r.qd_cmd - qd)
    else:
        v = kp * (r.q_cmd - q) + kd * (r.qd_cmd - qd)
    return v + jnp.array(law.offset) + r.disturbance


def law_of(dataset: Dataset, signature: Signature) -> Law:
    """The dataset's `[controller]`, checked against its channels and a model's signature.

    Raises `UsageError` where the dataset states no controller, for an unknown kind or setting, a
    gain that is missing or not one number per joint, and a reference that is not recorded.
    """
    kind, settings = _stated(dataset, signature)
    n = len(signature.joints)

    def number(key, default=0.0):
        return _per_joint(settings, key, default, n)

    saturation, gain = number("saturation", COMMON["saturation"]), number("gain", COMMON["gain"])
    if min(saturation) <= 0 or 0.0 in gain:
        raise UsageError("[controller]: saturation is positive, gain is not zero")
    period = settings.get(SAMPLE_TIME)
    if period is not None and (not isinstance(period, int | float) or period <= 0):
        raise UsageError(
            f"[controller]: sample_time is {period!r}; it is a positive number of seconds"
        )
    first = dataset.to_fit[0]
    cascade = kind == "cascade"
    reference_velocity = "none"
    if not cascade or "reference_velocity" in settings:
        reference_velocity = _word(settings, "reference_velocity")
    return Law(
        kind=kind,
        kp=number("kp"),
        ki=number("ki"),
        kd=number("kv" if cascade else "kd"),
        gain=gain,
        saturation=saturation,
        offset=number("offset"),
        velocity=_word(settings, "velocity"),
        reference_velocity=reference_velocity,
        references=_channels(dataset, settings, "reference", signature, True),
        disturbances=_channels(dataset, settings, "disturbance", signature, False),
        sample_time=float(period) if period is not None else float(np.median(np.diff(first.t))),
        every_sample=period is None,
    )


def _stated(dataset: Dataset, signature: Signature) -> tuple[str, dict[str, Any]]:
    """The kind and the settings of `[controller]`, each of which the kind knows."""
    if dataset.controller is None:
        raise UsageError(
            "the dataset states no controller. State it under [controller] (kind, gains,"
            " sample_time) with the reference q_cmd as an auxiliary channel, or use the residual"
            " output_error, which needs none"
        )
    joints = signature.joints
    if tuple(dict(signature.outputs)) != joints or len(signature.inputs) != len(joints):
        raise UsageError(
            "a controller needs one input and one measured position per joint of the model"
        )
    if dataset.stated.free:
        raise UsageError(
            "the dataset is of free motion and states a controller: take one of them out"
        )
    kind, settings = dataset.controller.kind, dict(dataset.controller.settings)
    if kind not in GAINS:
        raise UsageError(f"there is no controller of kind {kind!r}{nearest(kind, GAINS)}")
    needed, optional = GAINS[kind]
    allowed = (*needed, *optional, *COMMON, *WORDS, SAMPLE_TIME, "reference")
    for key in settings:
        if key not in allowed:
            raise UsageError(
                f"[controller]: kind {kind!r} has no setting {key!r}{nearest(key, allowed)}"
            )
    lacking = [key for key in needed if key not in settings]
    if lacking:
        raise UsageError(
            f"[controller]: kind {kind!r} needs {' and '.join(needed)}; {lacking[0]!r} is missing"
        )
    return kind, settings


def _per_joint(settings: Mapping[str, Any], key: str, default: float, n: int) -> tuple[float, ...]:
    value = settings.get(key, default)
    values = [value] * n
    if isinstance(value, Sequence) and not isinstance(value, str):
        values = list(value)
    if len(values) != n or not all(map(is_number, values)):
        raise UsageError(
            f"[controller]: {key} is {value!r}; it is a number, or a list of {n} (one per joint)"
        )
    return tuple(map(float, values))


def _word(settings: Mapping[str, Any], key: str) -> str:
    value = settings.get(key, WORDS[key][0])
    if value not in WORDS[key]:
        raise UsageError(
            f"[controller]: {key} = {value!r} is unknown{nearest(str(value), WORDS[key])}"
        )
    return value


def _channels(
    dataset: Dataset, settings: Mapping[str, Any], key: str, signature: Signature, required: bool
) -> tuple[str, ...]:
    """Auxiliary channels per joint: as stated, else by the naming convention of references, else ""
    where not required.
    """
    have = [c.name for c in dataset.channels if c.role == "auxiliary"]
    stated, n = settings.get(key), len(signature.joints)
    if stated is None:
        return _references(have, key, signature) if required else ("",) * n
    names = [stated] if isinstance(stated, str) else list(stated)
    if len(names) != n:
        raise UsageError(
            f"[controller]: {key} names {len(names)} channels; it needs {n}, one per joint"
        )
    for name in names:
        if name not in have and name:
            raise UsageError(
                f"[controller]: {key} names {name!r}, no auxiliary"
                f" channel{nearest(str(name), have)}"
            )
    return tuple(map(str, names))


def _references(have: Sequence[str], key: str, signature: Signature) -> tuple[str, ...]:
    """The references that are called after their joints."""
    alone = ("q_cmd", "q1_cmd") if len(signature.joints) == 1 else ()
    found = []
    for joint in signature.joints:
        candidates = [f"{joint}_cmd", *alone]
        there = [name for name in candidates if name in have]
        if not there:
            raise UsageError(
                f"the controller's reference is not recorded: add an auxiliary channel"
                f" {candidates[0]!r}, or name one by [controller] {key} (auxiliary channels:"
                f" {', '.join(have) or 'none'})"
            )
        found.append(there[0])
    return tuple(found)


__all__ = ["Controller", "Law", "Memory", "ControllerInput", "begin", "law_of", "update"]
