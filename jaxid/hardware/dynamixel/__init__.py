"""Dynamixel servos."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.base.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.hardware.dynamixel.servo import Dynamixel as Dynamixel


__getattr__, __dir__, __all__ = _attach(__name__, {"Dynamixel": "jaxid.hardware.dynamixel.servo"})
