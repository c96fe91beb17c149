"""From a problem to a `Fit`."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.base.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.fitting.fitter import AbstractFitter as AbstractFitter


__getattr__, __dir__, __all__ = _attach(__name__, {"AbstractFitter": "jaxid.fitting.fitter"})
