"""Rows of a study's store, and those of a file that is damaged."""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


#: A row as bytes: SQLite takes any bytes for text, and Python stops at those that are none.
COLUMNS = (
    "id, CAST(key AS BLOB), CAST(status AS BLOB), CAST(arrays AS BLOB), CAST(body AS BLOB), crc"
)


@dataclass(frozen=True)
class StudyRow:
    """One finished task: `body` is its outcome as JSON, `arrays` the file that holds its history,
    or empty.
    """

    key: str
    status: str
    body: bytes
    arrays: str = ""

    @property
    def crc(self) -> int:
        return zlib.crc32(
            "\0".join((self.key, self.status, self.arrays)).encode() + b"\0" + self.body
        )


def sound(fields: Sequence[Any]) -> StudyRow | None:
    """The row of (key, status, arrays, body, crc), or None if anything in it was changed."""
    key, status, arrays, body, crc = fields
    try:
        row = StudyRow(key.decode(), status.decode(), body, arrays.decode())
    except (UnicodeDecodeError, AttributeError):  # other bytes, or no bytes at all
        return None
    return row if row.crc == crc else None


def read_damaged(path: Path) -> Iterator[StudyRow]:
    """Every sound row of a file whose structure is damaged: pages that cannot be read are stepped
    over.
    """
    try:
        db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    except sqlite3.Error:
        return
    try:
        at, step, seen = 0, 1, set()
        while step < 1 << 40:
            try:
                cursor = db.execute(
                    f"SELECT {COLUMNS} FROM results NOT INDEXED WHERE id > ? ORDER BY id", (at,)
                )
                for number, *fields in cursor:
                    at, step = max(at, number), 1
                    row = sound(fields)
                    if row is not None and row.key not in seen:
                        seen.add(row.key)
                        yield row
                return
            except sqlite3.Error:
                at, step = at + step, 2 * step
    finally:
        db.close()


def loads(body: bytes) -> dict[str, Any]:
    """The outcome that a row holds."""
    return json.loads(body)
