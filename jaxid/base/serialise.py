"""Results as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.atomic_files import replace_files


SCHEMA = 1


def save_json(result: Any, path: str | Path) -> Path:
    """Writes a result as JSON, whole or not at all; raises `NotSaved`."""
    path = Path(path)
    return replace_files(path.parent, {path.name: json_bytes(result)}) / path.name


def json_bytes(result: Any) -> bytes:
    """A result as its JSON file holds it."""
    return (json.dumps(finite(result.to_dict()), indent=1, allow_nan=False) + "\n").encode()


def model_digest(sha256: str) -> dict[str, str]:
    """What a result says of the file of a model of the user's own, beside the model's name; nothing
    for another model.
    """
    return {"model_sha256": sha256} if sha256 else {}


def with_effects(content: Any) -> Any:
    """The content of a result with the effects that it adds to its model under `effects`, where a
    fit has them: those of a diagnosis stand under what it names.
    """
    if not isinstance(content, dict) or content.get("kind") != "diagnosis" or "effects" in content:
        return content
    which = content.get("which")
    named = which.get("effects") if isinstance(which, dict) else None
    return content if named is None else {**content, "effects": named}


def plain(value: Any) -> Any:
    """The same nested data without values of jaxid's own: what has a `to_dict` as that says, tuples
    as lists.
    """
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, Mapping):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return list(map(plain, value))
    return value


def finite(value: Any) -> Any:
    """The same nested data as JSON can hold: NumPy numbers become Python's, a number that is not
    finite becomes null.
    """
    if isinstance(value, dict):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return list(map(finite, value))
    if isinstance(value, np.ndarray):
        return finite(value.tolist())
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
