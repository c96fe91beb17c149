"""A dataset at a glance, for a notebook: channels, runs, notes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jaxid.base import wording
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.data.dataset import Dataset


ROWS = 12


def section(data: Dataset) -> Section:
    runs = [
        (
            e.name,
            e.split,
            f"{len(e)} samples, {wording.number(e.duration)} s",
            f"{wording.number(_rate(e.t))} Hz",
        )
        for e in data.experiments
    ]
    runs += [
        (r.name, r.split, f"{len(r.omega)} lines of {r.output} / {r.input}", "frequency response")
        for r in data.responses
    ]
    return Section(
        "recorded.html",
        {
            "data": data,
            "model": data.model.name if data.model is not None and data.model.name else "",
            "channels": [(c.name, c.role, c.unit, _noise(c)) for c in data.channels],
            "runs": runs[:ROWS],
            "hidden": max(0, len(runs) - ROWS),
        },
    )


def _rate(t: np.ndarray) -> float:
    return float(1 / np.median(np.diff(t))) if len(t) > 1 else 0.0


def _noise(channel) -> str:
    stated = [
        f"noise {wording.number(channel.noise_std, 2)} {channel.unit}" if channel.noise_std else "",
        (
            f"resolution {wording.number(channel.resolution, 2)} {channel.unit}"
            if channel.resolution
            else ""
        ),
    ]
    return ", ".join(filter(None, stated))
