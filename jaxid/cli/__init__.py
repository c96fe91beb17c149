"""The command line."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from jaxid.base.lazy import attach as _attach


if _TYPE_CHECKING:
    from jaxid.cli.app import main as main


__getattr__, __dir__, __all__ = _attach(__name__, {"main": "jaxid.cli.app"})
