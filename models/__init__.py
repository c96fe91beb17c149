"""Mechanical systems, each with its default effects. A new one: its file, and one line here."""

# Imported as bare `models`, every class would exist twice and isinstance would fail.
if __name__ != "jaxid.models":
    raise ImportError("import jaxid.models, not models")

from .joint import Joint
from .pendulum import Pendulum
from .planar_arm import PlanarArm


MODELS = (Joint, Pendulum, PlanarArm)

__all__ = ["MODELS", "Joint", "Pendulum", "PlanarArm"]
