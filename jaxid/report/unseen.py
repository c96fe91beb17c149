"""What the recordings would not show of a model that reaches the noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxid.base import wording
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.diagnosis.unseen import Unseen


def section(unseen: tuple[Unseen, ...]) -> Section | None:
    if not unseen:
        return None
    return Section(
        "unseen.html",
        {
            "hidden": [(u, size(u)) for u in unseen if u.moved and not u.absorbed],
            "unstirred": [(u, size(u)) for u in unseen if not u.moved],
            "absorbed": [(u, size(u)) for u in unseen if u.moved and u.absorbed],
        },
    )


def size(unseen: Unseen) -> str:
    return ", ".join(
        f"{name} {wording.number(value)}{wording.unit_after(unit)}"
        for name, (value, unit) in unseen.parameters.items()
    )
