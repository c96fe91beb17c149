"""Universal Robots arms."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.base.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.hardware.ur.robot import UR as UR


__getattr__, __dir__, __all__ = _attach(__name__, {"UR": "jaxid.hardware.ur.robot"})
