"""The first table of a robot's result: each joint's error with its file as it stands, re-tuned and
with the effects; then what differs from the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TYPE_CHECKING

from jaxid.base import wording
from jaxid.report import text
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.diagnosis.result import ChannelGap


def section(
    joints: Sequence[Mapping[str, Any]],
    stated: Sequence[Any],
    channels: Mapping[str, ChannelGap] | None = None,
) -> Section | None:
    """None for what is no robot; `channels` tell the noise of joints that are outputs."""
    if not joints:
        return None
    head, rows = text.joint_rows(joints)
    noise = {name: _noise(gap) for name, gap in (channels or {}).items()}
    if any(row[0] in noise for row in rows):
        head = [*head, "noise"]
        rows = [(*row, noise.get(row[0], "")) for row in rows]
    return Section("yardstick.html", {"head": head, "rows": rows, "stated": stated})


def _noise(gap: ChannelGap) -> str:
    return f"{wording.number(gap.noise)} {gap.unit} ({gap.noise_source})"
