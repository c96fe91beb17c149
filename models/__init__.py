"""Mechanical systems, each with its default effects. A new one: its file, and one line here."""

# Imported as bare `models`, every class would exist twice and isinstance would fail.
if __name__ != "jaxid.models":
    raise ImportError("import jaxid.models, not models")

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


MODELS = (
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

__all__ = [
    "MODELS",
    "FlexibleArm",
    "FlexibleLink",
    "Joint",
    "Panda",
    "Pendulum",
    "PlanarArm",
    "Robot",
    "SerialArm",
    "Servo",
    "SpaceManipulator",
    "Tracker",
    "UR10",
    "UR10e",
]
