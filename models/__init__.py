"""Mechanical systems, each with its default effects. A new one: its file, and one line here."""

# Imported as bare `models`, every class would exist twice and isinstance would fail.
if __name__ != "jaxid.models":
    raise ImportError("import jaxid.models, not models")

from .flexible_link import FlexibleLink
from .joint import Joint
from .pendulum import Pendulum
from .planar_arm import PlanarArm
from .servo import Servo
from .space_manipulator import SpaceManipulator
from .tracker import Tracker


MODELS = (Joint, Pendulum, PlanarArm, FlexibleLink, Tracker, Servo, SpaceManipulator)

__all__ = ["MODELS", "FlexibleLink", "Joint", "Pendulum", "PlanarArm", "Servo", "SpaceManipulator", "Tracker"]
