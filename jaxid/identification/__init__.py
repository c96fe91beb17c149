"""Inverse-dynamics identification: base parameters, friction, payload."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.base.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.identification.result import Identification as Identification
    from jaxid.identification.run import identify as identify


__getattr__, __dir__, __all__ = _attach(
    __name__, {"identify": "jaxid.identification.run", "Identification": "jaxid.identification.run"}
)
