"""Writes an export into a folder, over nothing that jaxid did not write there itself."""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from jaxid.base.atomic_files import replace_files
from jaxid.base.errors import UsageError
from jaxid.base.serialise import finite, SCHEMA
from jaxid.base.small_files import read_small, TooLarge
from jaxid.robots.export.run import Exported


#: The rows, the ranges, and what the files were made from (with their SHA-256, for `jaxid replay`
#: and the next export).
ROWS, RANGES, SOURCE = "export.json", "ranges.json", "source.json"


def save(exported: Exported, folder: str | Path) -> Path:
    """Puts the files into a folder, made if missing, and returns the path of `export.json`.

    Raises `UsageError` before anything is written where a file of that name stands there that jaxid
    did not write or that was edited since, and `NotSaved`.
    """
    folder = Path(folder)
    files = {name: text.encode() for name, text in exported.files.items()}
    if exported.ranges is not None:
        files[RANGES] = _json(exported.ranges)
    written = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    rows = _json(exported.to_list())
    source = {
        **exported.source,
        "notes": list(exported.notes),
        "files": {**written, ROWS: hashlib.sha256(rows).hexdigest()},
    }
    files |= {ROWS: rows, SOURCE: _json(source)}
    before = source_of(folder)
    for name in files:
        _refuse_overwriting(folder, name, before)
    groups: dict[Path, dict[str, bytes]] = defaultdict(dict)
    for name, content in files.items():
        groups[folder / PurePosixPath(name).parent][PurePosixPath(name).name] = content
    for place, content in groups.items():
        replace_files(place, content)
    return folder / ROWS


def source_of(folder: Path) -> Mapping[str, Any]:
    """What an earlier export in a folder says of its files; empty where there was none."""
    try:
        content = json.loads(read_small(folder / SOURCE)) if (folder / SOURCE).is_file() else {}
    except (OSError, ValueError, TooLarge, RecursionError):
        return {}
    ours = (
        isinstance(content, Mapping)
        and content.get("schema") == SCHEMA
        and content.get("kind") == "export"
    )
    return content if ours and isinstance(content.get("files"), Mapping) else {}


def _refuse_overwriting(folder: Path, name: str, before: Mapping[str, Any]) -> None:
    parts = PurePosixPath(name).parts
    if not parts or PurePosixPath(name).is_absolute() or ".." in parts or "\\" in name:
        raise UsageError(f"{name!r} would lie outside --out {folder}")
    path = folder / name
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise UsageError(f"{path} is not a plain file: name another folder with --out")
    if not path.exists() or (name == SOURCE and before):
        return
    if hashlib.sha256(read_small(path)).hexdigest() != before.get("files", {}).get(name):
        raise UsageError(
            f"{path} was not written by jaxid export, or was edited since: it is left as it is;"
            " name another --out"
        )


def _json(content: Any) -> bytes:
    return (json.dumps(finite(content), indent=1, allow_nan=False) + "\n").encode()
