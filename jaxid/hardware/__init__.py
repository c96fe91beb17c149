"""Recording from robots and servos, and moving them: `record(UR(host), "folder", seconds=10)`.

Not a safety function: limits protect against mistakes in a trajectory. Keep the emergency stop in reach.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING


if _TYPE_CHECKING:
    from jaxid.data.limits import Limits as Limits
    from jaxid.hardware.dynamixel.servo import Dynamixel as Dynamixel
    from jaxid.hardware.errors import HardwareError as HardwareError
    from jaxid.hardware.finishing import Recording as Recording
    from jaxid.hardware.sensor import SensorSpec as SensorSpec
    from jaxid.hardware.session import record as record, recover as recover
    from jaxid.hardware.trajectory import Trajectory as Trajectory
    from jaxid.hardware.ur.robot import UR as UR


_HOME = {
    "Dynamixel": "dynamixel",
    "HardwareError": "errors",
    "Limits": "limits",
    "Recording": "finishing",
    "SensorSpec": "sensor",
    "Trajectory": "trajectory",
    "UR": "ur",
    "record": "session",
    "recover": "session",
}

__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'jaxid.hardware' has no attribute {name!r}")
    value = getattr(_import_module(f"jaxid.hardware.{_HOME[name]}"), name)
    globals()[name] = value
    return value
