"""The effect library: what a nominal model can lack. One line of registration per effect."""

if __name__ != "jaxid.models.effects":
    raise ImportError("import jaxid.models.effects, not models.effects")

from .input import DeadZone, InputDelay, InputHold
from .joint import (
    AsymmetricFriction,
    ConstantTorque,
    CoulombFriction,
    LoadDependentFriction,
    QuadraticDrag,
    StribeckFriction,
    ViscousFriction,
)
from .power_law import PowerLawFriction


LIBRARY = (
    DeadZone,
    ViscousFriction,
    PowerLawFriction,
    CoulombFriction,
    AsymmetricFriction,
    StribeckFriction,
    LoadDependentFriction,
    QuadraticDrag,
    ConstantTorque,
    InputDelay,
    InputHold,
)

__all__ = [
    "LIBRARY",
    "AsymmetricFriction",
    "ConstantTorque",
    "CoulombFriction",
    "DeadZone",
    "InputDelay",
    "InputHold",
    "LoadDependentFriction",
    "PowerLawFriction",
    "QuadraticDrag",
    "StribeckFriction",
    "ViscousFriction",
]
