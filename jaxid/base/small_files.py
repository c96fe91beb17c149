"""Files that people or jaxid wrote as text: results, limits, settings. Recordings are read
elsewhere.
"""

from __future__ import annotations

import os
from pathlib import Path


#: No such file is this large; a device, a pipe without end or a recording given by mistake is.
LARGEST_BYTES = 16 * 2**20


class TooLarge(ValueError):
    """The file is larger than any of its kind."""


def read_small(path: str | os.PathLike[str]) -> bytes:
    """The content of a file of at most `LARGEST_BYTES`, which may be a pipe. Raises `OSError`;
    `TooLarge` for a larger one.
    """
    with Path(path).open("rb") as stream:
        content = stream.read(LARGEST_BYTES + 1)
    if len(content) > LARGEST_BYTES:
        raise TooLarge(f"larger than {LARGEST_BYTES // 2**20} MiB, which no such file is")
    return content
