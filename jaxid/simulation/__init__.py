"""Many rollouts of a chain."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.fitting.simulation import Simulation as Simulation


__getattr__, __dir__, __all__ = _attach(__name__, {"Simulation": "jaxid.fitting.simulation"})
