"""Where a simulator is wrong, which effect is missing, how far the gap shrinks once it is added."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.base.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.diagnosis.run import run_diagnosis as run_diagnosis


__getattr__, __dir__, __all__ = _attach(__name__, {"run_diagnosis": "jaxid.diagnosis.run"})
