"""The effect library: what a nominal model can lack. A new one: its file, and the line here that
imports it.
"""

if __name__ != "jaxid.models.effects":
    raise ImportError("import jaxid.models.effects, not models.effects")

from typing import Any

from jaxid.dynamics.effect import Effect

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
from .velocity_feedforward import VelocityFeedforward
from .warmth import TemperatureDependentFriction


#: In this order they stand in a model; what is not named here comes last, by its name.
_FIRST = (
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


def _registered() -> tuple[Any, ...]:
    kinds = {v for v in globals().values() if isinstance(v, type) and issubclass(v, Effect)}
    later = kinds - {Effect, *_FIRST}
    return (*_FIRST, *sorted(later, key=lambda kind: kind.name))


LIBRARY: tuple[Any, ...] = _registered()
