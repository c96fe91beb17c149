"""Models that are named by a file of Python: `duffing.py`, or `duffing.py:Duffing` where the file
holds several.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TypeGuard


def is_model_file(model: object) -> TypeGuard[str]:
    """Whether a model is named by a file of Python, `FILE.py` or `FILE.py:CLASS`."""
    return isinstance(model, str) and parts_of(model) is not None


def parts_of(text: str) -> tuple[str, str | None] | None:
    """(file, class or None) of such a name; None for another one."""
    found = re.fullmatch(r"(.+\.py)(?::([^:/\\]*))?", text, re.DOTALL | re.IGNORECASE)
    return None if found is None else (found[1], found[2] or None)


def called(model: str) -> str:
    """What a model named by a file is called in tables: the class, where one was named, else the
    file.
    """
    own = parts_of(model)
    return own[1] if own is not None and own[1] is not None else Path(model).stem
