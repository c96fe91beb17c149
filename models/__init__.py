"""Mechanical systems, each with its default effects. A new one: its file, and one line here."""

# Imported as bare `models`, every class would exist twice and isinstance would fail.
if __name__ != "jaxid.models":
    raise ImportError("import jaxid.models, not models")

from typing import Any

from jaxid.dynamics.mechanism import Mechanism as _Mechanism

from .arm_presets import Panda, UR10, UR10e
from .flexible_arm import FlexibleArm
from .flexible_link import FlexibleLink
from .joint import Joint
from .pendulum import Pendulum
from .planar_arm import PlanarArm
from .robot import Robot
from .serial_arm import SerialArm
from .servo import Servo
from .space_manipulator import SpaceManipulator
from .tracker import Tracker


#: In this order they are listed; what is not named here comes last, by its name.
_FIRST = (
    Joint,
    Pendulum,
    Servo,
    Tracker,
    FlexibleLink,
    FlexibleArm,
    PlanarArm,
    SerialArm,
    UR10,
    UR10e,
    Panda,
    Robot,
    SpaceManipulator,
)


def _registered() -> tuple[Any, ...]:
    kinds = {v for v in globals().values() if isinstance(v, type) and issubclass(v, _Mechanism)}
    later = kinds - {_Mechanism, *_FIRST}
    return (*_FIRST, *sorted(later, key=lambda kind: kind.name))


MODELS: tuple[Any, ...] = _registered()
