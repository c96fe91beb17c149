"""A path on its way to a driver: in pieces, the next one when the driver asks for it.

However long a path is, no end of the line has to take more of it at once than it can hold, so
samples, heartbeats and watchdogs go on meanwhile; and nothing is armed before all of it is there.
"""

from __future__ import annotations

import base64
from array import array
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np


PIECE = 24_000  # bytes; what a line holds unread is several times as much


class Sender:
    """In the recording process: announces `table [rows joints]`, then answers each `want` of the
    driver.

    `send(kind, **content)` speaks to the driver.
    """

    def __init__(self, table: np.ndarray, send: Callable[..., None]):
        rows, joints = table.shape
        self._content = np.ascontiguousarray(table, "<f8")
        self._rows, self._send = max(1, PIECE // (8 * joints)), send
        send("path", rows=rows, joints=joints)

    def answer(self, message: Mapping[str, Any]) -> None:
        """The rows that a `want` asks for."""
        piece = self._content[message["at"] : message["at"] + self._rows]
        self._send("rows", at=message["at"], content=base64.b64encode(piece.tobytes()).decode())


class PathTable:
    """In the driver: the rows of a path as they come. `take` a `path` or `rows`, and it says what
    to answer.
    """

    def __init__(self):
        self.rows = self.joints = 0
        self._values = array("d")

    def take(self, order: Mapping[str, Any]) -> tuple[str, dict[str, int]]:
        """The kind and content of the answer: `want` the rows from `at` on, or `loaded`. Raises
        `ValueError` for other rows than those that were asked for.
        """
        if order["kind"] == "path":
            self.rows, self.joints, self._values = (
                int(order["rows"]),
                int(order["joints"]),
                array("d"),
            )
        else:
            content = array("d", base64.b64decode(order["content"], validate=True))
            have = len(self)
            if (
                order["at"] != have
                or not content
                or len(content) % self.joints
                or have + len(content) // self.joints > self.rows
            ):
                raise ValueError(
                    f"{len(content)} numbers of the path came for row {have + 1} of {self.rows}"
                )
            self._values += content
        return (
            ("loaded", {"rows": self.rows})
            if len(self) == self.rows
            else ("want", {"at": len(self)})
        )

    def __len__(self) -> int:
        return len(self._values) // self.joints if self.joints else 0

    def __iter__(self) -> Iterator[list[float]]:
        """The rows; raises `ValueError` where any is missing."""
        if not self.rows or len(self) != self.rows:
            raise ValueError(f"{len(self)} of {self.rows} rows of the path are there")
        return (
            self._values[k : k + self.joints].tolist()
            for k in range(0, len(self._values), self.joints)
        )
