"""Design of experiments."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.base.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.excitation.design import excite as excite


__getattr__, __dir__, __all__ = _attach(__name__, {"excite": "jaxid.excitation.design"})
