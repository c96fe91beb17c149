"""Mechanical systems, each with its default effects. A new one: its file, and one line here."""

# Imported as bare `models`, every class would exist twice and isinstance would fail.
if __name__ != "jaxid.models":
    raise ImportError("import jaxid.models, not models")

from .arm_presets import Panda, UR10, UR10e
from .joint import Joint
from .pendulum import Pendulum
from .planar_arm import PlanarArm
from .serial_arm import SerialArm


MODELS = (Joint, Pendulum, PlanarArm, SerialArm, UR10, UR10e, Panda)

__all__ = ["MODELS", "Joint", "Panda", "Pendulum", "PlanarArm", "SerialArm", "UR10", "UR10e"]
