"""The effect library: what a nominal model can lack. One line of registration per effect."""

if __name__ != "jaxid.models.effects":
    raise ImportError("import jaxid.models.effects, not models.effects")

from .actuator import (
    ActuatorLag,
    BackEmf,
    DeadZone,
    Saturation,
    SupplyDroop,
    TorqueRipple,
    TorqueScale,
)
from .actuator_curve import ActuatorCurve
from .body import (
    BaseMotion,
    ConstantTorque,
    FlexibleMode,
    GeometricStiffening,
    GravityOffset,
    Payload,
    ReflectedInertia,
    SpringTorque,
)
from .friction import (
    AsymmetricFriction,
    CoulombFriction,
    CoupledFriction,
    LoadDependentFriction,
    PositionDependentFriction,
    QuadraticDrag,
    StribeckFriction,
    ViscousFriction,
)
from .lugre import LuGreFriction
from .power_law import PowerLawFriction
from .sensor import SensorBias, SensorDelay, SensorLag, SensorScale, TimestampJitter
from .step_change import StepChange
from .timing import InputDelay, InputHold
from .transmission import Backlash, Hysteresis, JointElasticity
from .warmth import TemperatureDependentFriction


LIBRARY = (
    InputHold,
    InputDelay,
    TorqueScale,
    SupplyDroop,
    Saturation,
    DeadZone,
    BackEmf,
    ActuatorLag,
    ActuatorCurve,
    TorqueRipple,
    ViscousFriction,
    PowerLawFriction,
    CoulombFriction,
    AsymmetricFriction,
    StribeckFriction,
    LoadDependentFriction,
    LuGreFriction,
    QuadraticDrag,
    PositionDependentFriction,
    TemperatureDependentFriction,
    CoupledFriction,
    Backlash,
    JointElasticity,
    Hysteresis,
    Payload,
    ConstantTorque,
    GravityOffset,
    SpringTorque,
    ReflectedInertia,
    FlexibleMode,
    GeometricStiffening,
    BaseMotion,
    SensorBias,
    SensorScale,
    SensorLag,
    SensorDelay,
    TimestampJitter,
    StepChange,
)

__all__ = [
    "LIBRARY",
    "ActuatorCurve",
    "ActuatorLag",
    "AsymmetricFriction",
    "BackEmf",
    "Backlash",
    "BaseMotion",
    "ConstantTorque",
    "CoulombFriction",
    "CoupledFriction",
    "DeadZone",
    "FlexibleMode",
    "GeometricStiffening",
    "GravityOffset",
    "Hysteresis",
    "InputDelay",
    "InputHold",
    "JointElasticity",
    "LoadDependentFriction",
    "PowerLawFriction",
    "LuGreFriction",
    "Payload",
    "PositionDependentFriction",
    "QuadraticDrag",
    "ReflectedInertia",
    "Saturation",
    "SensorBias",
    "SensorDelay",
    "SensorLag",
    "SensorScale",
    "SpringTorque",
    "StepChange",
    "StribeckFriction",
    "SupplyDroop",
    "TemperatureDependentFriction",
    "TimestampJitter",
    "TorqueRipple",
    "TorqueScale",
    "ViscousFriction",
]
