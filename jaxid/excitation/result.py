"""What the design of an experiment returns: commands, what they reach of every limit, and
excitation.json.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.serialise import SCHEMA
from jaxid.base.versions import versions
from jaxid.data.dataset import Dataset
from jaxid.dynamics.chain import Chain
from jaxid.excitation.bounds import Bounds
from jaxid.excitation.trajectories import Fourier


#: Speeds (share of the limit) whose coverage is reported.
BANDS = (0.01, 0.03, 0.1, 0.3, 1.0)


@dataclass(frozen=True)
class Excitation:
    """A designed experiment: `dataset` holds its one run as the model expects it, `commands`
    (channel -> [time]) what is to be played; `content` is excitation.json.
    """

    dataset: Dataset
    commands: dict[str, np.ndarray]
    rates: dict[str, np.ndarray] = field(repr=False)  # qd1 ..., qdd1 ... where a motion is designed
    limits: tuple[dict[str, Any], ...]
    content: dict[str, Any] = field(repr=False)
    fourier: Fourier | None = None

    @property
    def t(self) -> np.ndarray:
        return self.dataset.experiments[0].t

    @property
    def condition_number(self) -> float:
        return float(self.content["condition_number"])

    def to_dict(self) -> dict[str, Any]:
        return self.content

    def save(self, folder: str | Path) -> Path:
        """Writes the dataset folder with excitation.json, trajectory.csv, plot, and for a UR what
        it plays.
        """
        from jaxid.excitation.write import write

        return write(self, Path(folder))


def stds(information: np.ndarray) -> np.ndarray:
    """Standard deviations from an information matrix; inf where it says nothing."""
    d = np.sqrt(np.diag(information))
    seen = d > 0
    out = np.full(len(d), np.inf)
    part = information[np.ix_(seen, seen)] / d[seen] / d[seen][:, None]
    out[seen] = (
        np.sqrt(np.maximum(np.diag(np.linalg.pinv(part, rcond=1e-12, hermitian=True)), 0.0))
        / d[seen]
    )
    return out


def reached(joints, signature, bounds: Bounds, q, qd, qdd, tau=None) -> list[dict[str, Any]]:
    """What is reached of every limit."""
    out = []
    for j, joint in enumerate(joints):
        unit = dict(signature.outputs).get(joint, "rad")
        rows = [
            (
                "range",
                float(q[:, j].min()),
                float(q[:, j].max()),
                float(bounds.lower[j]),
                float(bounds.upper[j]),
                unit,
            ),
            ("speed", 0.0, float(np.abs(qd[:, j]).max()), 0.0, float(bounds.speed[j]), f"{unit}/s"),
        ]
        if qdd is not None:
            rows.append(
                (
                    "acceleration",
                    0.0,
                    float(np.abs(qdd[:, j]).max()),
                    0.0,
                    float(bounds.acceleration[j]),
                    f"{unit}/s^2",
                )
            )
        for name, low, high, lower, upper, u in rows:
            entry = {"joint": joint, "quantity": name, "unit": u}
            share = (
                max((high - lower) / (upper - lower), (upper - low) / (upper - lower))
                if name == "range"
                else high / upper
            )
            entry |= (
                {"lowest": low, "highest": high, "lower": lower, "upper": upper}
                if name == "range"
                else {"highest": high, "limit": upper}
            )
            out.append(entry | {"share": share})
        if tau is not None:
            out.append(
                {
                    "joint": joint,
                    "quantity": "nominal torque",
                    "unit": signature.unit("{F}", j),
                    "highest": float(np.abs(tau[:, j]).max()),
                }
            )
    return out


def coverage(joints, bounds: Bounds, qd: np.ndarray) -> dict[str, Any]:
    """Share of the time that each joint spends in each band of speed."""
    edges = np.array([0.0, *BANDS])
    share = np.abs(qd) / bounds.speed
    table: dict[str, list[float]] = {}
    for j, joint in enumerate(joints):
        band = np.searchsorted(edges, share[:, j], side="right") - 1
        table[joint] = [float(np.mean(band == k)) for k in range(len(BANDS))]
    return {"bands_of_speed_limit": edges.tolist(), "share_of_time": table}


def content(
    chain: Chain, plan: dict[str, Any], criterion: str, bounds: Bounds, reached
) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "kind": "excitation",
        "model": chain.mechanism.name,
        **plan,
        "criterion": criterion,
        "limits_from": bounds.source,
        "limits": list(reached),
        "versions": versions(),
    }
