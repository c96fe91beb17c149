"""The first table of a robot's result: each joint's error with its file as it stands, re-tuned and
with the effects; then what differs from the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from jaxid.report import text
from jaxid.report.page import Section


def section(joints: Sequence[Mapping[str, Any]], stated: Sequence[Any]) -> Section | None:
    """None for what is no robot."""
    if not joints:
        return None
    head, rows = text.joint_rows(joints)
    return Section("yardstick.html", {"head": head, "rows": rows, "stated": stated})
