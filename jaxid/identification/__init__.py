"""Inverse-dynamics identification: base parameters, friction, payload."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.identification.run import Identification as Identification, identify as identify


__getattr__, __dir__, __all__ = _attach(
    __name__, {"identify": "jaxid.identification.run", "Identification": "jaxid.identification.run"}
)
