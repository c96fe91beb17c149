"""The page of an identification: how well torque is predicted, friction, base parameters,
payload.
"""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import numpy as np

from jaxid.base import wording
from jaxid.report import plot
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.identification.result import Identification


def section(result: Identification) -> Section:
    return Section(
        "identified.html",
        {
            "result": result,
            "headline": headline(result),
            "error": error,
            "joints": result.labels,
            "friction": friction_rows(result),
            "base": base_rows(result),
            "beside": beside_head(result),
            "payload": None if result.payload is None else payload_rows(result),
            "pictures": [
                (f"Torque in {name} ({split} data)", picture(result, k))
                for k, (name, split, *_) in enumerate(result.traces)
            ],
        },
    )


def headline(result: Identification) -> str:
    """One sentence: the torque error on data that were not fitted, or the payload."""
    if result.payload is not None:
        value, std = result.payload.mass
        more = result.payload.exact_gains or result.payload.counted_gains
        return f"The payload is {pair(value, std)} kg: {more}.{not_predicted(result)}"
    rest = [e for e in result.experiments if e.split != "fit"] or list(result.experiments)
    worst = max(rest, key=lambda e: e.relative_error)
    kind = "held-out motion" if worst.split != "fit" else "the fitted motion"
    if not worst.relative_error < 1:
        return (
            f"Torque is not predicted: on {kind} the model is off by {error(worst.relative_error)}"
            " of it, worse than no model."
        )
    return f"Torque is predicted to {error(worst.relative_error)} on {kind}."


def not_predicted(result: Identification) -> str:
    """A sentence where the model of a loaded arm predicts a run worse than none would; it has a
    blank before it.
    """
    worst = max(result.experiments, key=lambda e: e.relative_error)
    if worst.relative_error < 1:
        return ""
    run, off = f"{worst.file} ({worst.split})", error(worst.relative_error)
    return (
        f" Do not rely on it: in {run} the model is off by {off} of the torque, worse than no"
        " model."
    )


def error(relative: float, decimals: int = 2) -> str:
    """A relative error in percent; of a joint that stands still there is none."""
    if np.isnan(relative):
        return "stands still"
    return wording.percent(relative) if not relative < 10 else f"{100 * relative:.{decimals}f} %"


def pair(value: float, std: float | None) -> str:
    """`3.52 ± 0.03`, rounded to two digits of the standard deviation."""
    if std is None or not np.isfinite(std) or std <= 0:
        return wording.number(value, 4)
    decimals = int(np.clip(1 - np.floor(np.log10(std)), 0, 9))
    return f"{value:.{decimals}f} ± {std:.{decimals}f}"


def friction_rows(result: Identification) -> list[tuple[str, str, list[str]]]:
    """(parameter, unit of the first joint, values by joint)."""
    joints = result.friction()
    keys = [k for k in joints[0] if k != "joint"]

    def told(value, std):
        return pair(value, std) if std is not None and np.isfinite(std) else "not determined"

    rows = []
    for key in keys:
        values = [told(joint[key]["value"], joint[key]["std"]) for joint in joints]
        rows.append((key, joints[0][key]["unit"], values))
    return rows


def beside_head(result: Identification) -> tuple[str, ...]:
    """Heads of the columns that a file or a dataset adds to the base parameters: none where nothing
    is stated.
    """
    return ("stated", "apart, in its std") if _stated(result) else ()


def _stated(result: Identification) -> dict[str, dict[str, Any]]:
    leading = result.names[: result.base_count]
    return {row["parameter"]: row for row in result.stated if row["parameter"] in leading}


def _beside(row: dict[str, Any] | None, known: bool) -> tuple[str, str]:
    """What is stated, and how far that is; nothing is far from a number that is not `known`."""
    if row is None:
        return "", ""
    apart = row["deviation"] if known else None
    return wording.number(row["stated"], 4), "" if apart is None else f"{apart:+.1f}"


def base_rows(result: Identification) -> list[tuple[str, ...]]:
    """Leading parameter, value, what is stated of it and how far that is (where anything is), unit,
    combination, remark.
    """
    std, stated = result.std(), _stated(result)
    rows = []
    for i in range(result.base_count):
        name, value = result.names[i], pair(float(result.theta[i]), float(std[i]))
        known = bool(result.identifiable[i])
        beside = _beside(stated.get(name), known) if stated else ()
        remark = "" if known else "not determined"
        rows.append((name, value, *beside, result.units[i], result.expressions[i], remark))
    return rows


def payload_rows(result: Identification) -> list[tuple[str, str, str]]:
    payload = result.payload
    assert payload is not None
    m, std = payload.mass
    rows = [("mass", f"{pair(m, std)} kg", f"{m - 1.96 * std:.4g} to {m + 1.96 * std:.4g} kg")]
    for axis, (value, spread) in zip("xyz", payload.com(), strict=True):
        rows.append(
            (
                f"centre of mass {axis}",
                f"{pair(value, spread)} m",
                f"{value - 1.96 * spread:.3g} to {value + 1.96 * spread:.3g} m",
            )
        )
    if np.isfinite(payload.body).all():
        rows.append(("mass of the nearest body that can exist", f"{payload.body[9]:.4g} kg", ""))
    if payload.published is not None:
        rows.append(("mass by the three rows of paper 001", f"{payload.published[9]:.4g} kg", ""))
    return rows


def picture(result: Identification, k: int):
    name, split, t, tau, predicted = result.traces[k]
    joints = tau.shape[1]

    def draw(figure):
        columns = 1 if plot.narrow(figure) else 2
        axes = figure.subplots(-(-joints // columns), columns, sharex=True, squeeze=False).ravel()
        for j in range(joints):
            axes[j].plot(
                *plot.thin(t, tau[:, j], 700),
                color=plot.BLACK,
                linewidth=1.4,
                label="measured, filtered",
            )
            axes[j].plot(
                *plot.thin(t, predicted[:, j], 700),
                color=plot.BLUE,
                linewidth=0.9,
                label="predicted",
            )
            axes[j].plot(
                *plot.thin(t, tau[:, j] - predicted[:, j], 700),
                color=plot.VERMILLION,
                linewidth=0.7,
                label="left over",
            )
            axes[j].set_title(
                f"{result.labels[j]} ({result.torque_units[j]})", fontsize="medium", loc="left"
            )
        for left in axes[joints:]:
            left.set_visible(False)
        for lowest in axes[max(0, joints - columns) : joints]:
            lowest.set_xlabel("time (s)")
        plot.legend(figure, axes[0].get_legend_handles_labels()[0], 3, "outside upper right")

    return plot.svg(
        f"torque-{k}", (plot.WIDE, 1.5 * (-(-joints // 2)) + 0.6), draw, 1.4 * joints + 0.8
    )
