"""Recording from robots and servos, and moving them: `record(UR(host), "folder", seconds=10)`.

The limits protect against mistakes in a trajectory; they do not protect people. Keep the emergency
stop in reach.
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.base.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.data.limits import Limits as Limits
    from jaxid.hardware.dynamixel.servo import Dynamixel as Dynamixel
    from jaxid.hardware.errors import HardwareError as HardwareError
    from jaxid.hardware.finishing import Recording as Recording
    from jaxid.hardware.sensor import SensorSpec as SensorSpec
    from jaxid.hardware.session import record as record, recover as recover
    from jaxid.hardware.trajectory import Trajectory as Trajectory
    from jaxid.hardware.ur.robot import UR as UR


__getattr__, __dir__, __all__ = _attach(
    __name__,
    {
        "Dynamixel": "jaxid.hardware.dynamixel.servo",
        "HardwareError": "jaxid.hardware.errors",
        "Limits": "jaxid.data.limits",
        "Recording": "jaxid.hardware.finishing",
        "SensorSpec": "jaxid.hardware.sensor",
        "Trajectory": "jaxid.hardware.trajectory",
        "UR": "jaxid.hardware.ur.robot",
        "record": "jaxid.hardware.session",
        "recover": "jaxid.hardware.session",
    },
)
