"""Cells that hold lists of numbers, as Python, NumPy and JSON print them, as one column an
element.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np


def with_list_elements(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Columns whose cells are lists of one length (`[0.1, -0.2]`) as one column an element too:
    `positions[0]` …
    """
    out = dict(columns)
    for name, cells in columns.items():
        rows = _lists(cells)
        if rows is not None and rows.ndim >= 2:
            out |= {
                f"{name}[{']['.join(map(str, k))}]": rows[(slice(None), *k)]
                for k in np.ndindex(rows.shape[1:])
            }
    return out


def _lists(cells: Any) -> np.ndarray | None:
    if not isinstance(cells, list):
        return None
    first = next((c for c in cells if c is not None and c != ""), None)
    if isinstance(first, str) and not re.match(r"(array|tensor)?[\[(]", first.strip()):
        return None
    if not isinstance(first, str | list | tuple):
        return None
    parsed = []
    try:
        for cell in cells:
            parsed.append(json.loads(_list_text(cell)) if isinstance(cell, str) else cell)
        return np.array(parsed, dtype=float)
    except (ValueError, TypeError):
        return None


def _list_text(cell: str) -> str:
    """A list as JSON writes it, of one that Python or NumPy wrote: `(1, 2)`, `[1. 2.]`, `array([1,
    2], dtype=float32)`.
    """
    text = cell.strip()
    if wrapped := re.fullmatch(
        r"(?:array|tensor)\((?:'\w', *)?(.*?)(?:, *dtype=[\w.']+)?\)", text, re.DOTALL
    ):
        text = wrapped[1]
    text = text.replace("(", "[").replace(")", "]")
    if "," not in text:
        text = re.sub(r"(?<=[\d.\]])\s+(?=[-+.\d\[])", ", ", text)
    return re.sub(r"(\d)\.(?=[,\s\]eE]|$)", r"\1", text)
