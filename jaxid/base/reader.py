"""The one door from a recording's plain values to what makes them of arrays and frames: it reads
them against the model that they state, and so stands above them.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


def arrays_reader() -> Any:
    """The module `jaxid.data.reading.arrays`: `from_arrays`, `from_frame`."""
    return import_module("jaxid.data.reading.arrays")
