"""What a blind case is: a question that anybody gets, and a truth that the scorer keeps."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxid.data.dataset import Dataset


#: Splits of the runs of a case; a further run is the exam.
SPLITS = ("fit", "fit", "validation")
#: Readings of each output that the exam asks for.
ASKED = 40
#: What a missing effect may depend on: the words that an answer's `where` may use.
VARIABLES = (
    "position",
    "speed",
    "acceleration",
    "load",
    "command",
    "time",
    "constant",
    "reading",
)
#: Effect -> the words that are right of it.
DEPENDS_ON: dict[str, tuple[str, ...]] = {
    "dead_zone": ("command", "load"),
    "saturation": ("command", "load"),
    "supply_droop": ("command", "load"),
    "torque_scale": ("command", "load"),
    "actuator_lag": ("command", "time"),
    "input_delay": ("command", "time"),
    "input_hold": ("command", "time"),
    "back_emf": ("speed",),
    "torque_ripple": ("position",),
    "viscous_friction": ("speed",),
    "coulomb_friction": ("speed",),
    "asymmetric_friction": ("speed",),
    "stribeck_friction": ("speed",),
    "load_dependent_friction": ("load", "speed"),
    "quadratic_drag": ("speed",),
    "power_law_friction": ("speed",),
    "lugre_friction": ("speed", "position"),
    "position_dependent_friction": ("position", "speed"),
    "temperature_dependent_friction": ("time", "speed"),
    "coupled_friction": ("speed",),
    "backlash": ("position", "load"),
    "joint_elasticity": ("load", "position"),
    "hysteresis": ("position",),
    "payload": ("acceleration", "position", "load"),
    "constant_torque": ("constant",),
    "gravity_offset": ("position",),
    "spring_torque": ("position",),
    "reflected_inertia": ("acceleration",),
    "flexible_mode": ("acceleration",),
    "sensor_bias": ("reading", "constant"),
    "sensor_scale": ("reading", "position"),
    "sensor_lag": ("reading", "time"),
    "sensor_delay": ("reading", "time"),
    "timestamp_jitter": ("reading", "time"),
}
#: Effect -> the one number that is asked as its size, and what it is. Others have no size.
SIZES: dict[str, tuple[str, str]] = {
    "dead_zone": ("width", "threshold below which the drive gives nothing, unit of the input"),
    "saturation": ("limit", "most that the drive gives, unit of the input"),
    "supply_droop": ("droop", "u becomes u - droop |u| u"),
    "torque_scale": ("gain", "u becomes (1 + gain) u"),
    "actuator_lag": ("lag", "time constant, s"),
    "input_delay": ("delay", "s"),
    "viscous_friction": ("coefficient", "N m s/rad (N s/m)"),
    "coulomb_friction": ("level", "N m (N)"),
    "stribeck_friction": ("extra", "dry friction that is gone at speed, N m (N)"),
    "load_dependent_friction": ("mu", "dry friction per drive torque"),
    "quadratic_drag": ("coefficient", "N m s^2/rad^2"),
    "backlash": ("play", "whole play, rad"),
    "joint_elasticity": ("compliance", "rad/(N m)"),
    "hysteresis": ("level", "N m"),
    "payload": ("mass", "kg"),
    "constant_torque": ("torque", "N m"),
    "gravity_offset": ("tilt", "rad"),
    "spring_torque": ("stiffness", "N m/rad"),
    "reflected_inertia": ("inertia", "kg m^2"),
    "sensor_bias": ("bias", "unit of the output"),
    "sensor_scale": ("gain", "reading becomes (1 + gain) times itself"),
    "sensor_lag": ("lag", "s"),
    "sensor_delay": ("delay", "s"),
}
#: Broken conventions that the set of that name may hold, as `jaxid check` calls them.
CONVENTIONS = (
    "sign",
    "zero",
    "scale",
    "row_shift",
    "swapped_channels",
    "wrapped",
    "glitch",
    "repeated_rows",
    "clock",
    "time_unit",
    "not_at_rest",
    "does_not_move",
    "unsigned",
    "filtered",
    "saturated",
)


@dataclass(frozen=True)
class WithheldEffect:
    """One thing that the model of a case lacks: an effect, or a convention that is broken, at a
    joint. `alike`: others ("effect@joint") that no recording of that case tells from it. `size`: of
    the number in `SIZES`.
    """

    effect: str
    joint: str
    size: float | None = None
    alike: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return f"{self.effect}@{self.joint}"


@dataclass(frozen=True)
class Exam:
    """One further run: `given` (t and inputs, or what the model is told) is published, what the
    sensors read at `rows` is not; `stated` is what the model as stated says there.
    """

    given: dict[str, np.ndarray]
    rows: np.ndarray
    truth: dict[str, np.ndarray]
    stated: dict[str, np.ndarray]
    noise: dict[str, float]


@dataclass(frozen=True)
class BlindCase:
    """`question` is what anybody is told besides the dataset and `files`; `outside` names what is
    of no library; `over`: right words for what the gap depends on.
    """

    question: dict[str, Any]
    dataset: Dataset
    simulator: str
    missing: tuple[WithheldEffect, ...] = ()
    outside: str = ""
    over: tuple[str, ...] = ()
    exam: Exam | None = None
    files: dict[str, str] = field(default_factory=dict)
    #: Lines of [model] of dataset.toml, where the dataset itself states no model.
    model_toml: str = ""
    #: What the runs hold instead of the dataset's samples, which a dataset would refuse.
    tables: tuple[dict[str, np.ndarray], ...] = ()


@dataclass(frozen=True)
class Draft:
    """A case before it is simulated; `simulate` makes the cases of all drafts of one group side by
    side.
    """

    set: str
    seed: int
    number: int
    group: str
    simulate: Callable[[Sequence[Draft]], list[BlindCase]]
    plan: dict[str, Any] = field(default_factory=dict)

    def rng(self, *more: int) -> np.random.Generator:
        """Random numbers of this case alone."""
        return generator(self.seed, self.set, self.number, *more)


def generator(seed: int, name: str, *more: int) -> np.random.Generator:
    """Random numbers of a seed for one purpose."""
    return np.random.default_rng([seed, zlib.crc32(name.encode()), *more])


def asked_rows(count: int, first: int) -> np.ndarray:
    """Rows of the exam, spread over its time, but for its beginning and its end, where filters and
    derivatives are no measure.
    """
    return np.linspace(first, count - 1 - first, ASKED).astype(int)


def depends_on(missing: Sequence[WithheldEffect]) -> tuple[str, ...]:
    """Right words for what the gap of these effects depends on."""
    words: dict[str, None] = {}
    for one in missing:
        words |= dict.fromkeys(DEPENDS_ON.get(one.effect, ()))
    return tuple(words)
