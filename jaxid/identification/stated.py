"""The numbers of an arm's own file, or of its dataset, beside those that were identified: which are
wrong, and by how much.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxid.base.wording import listed, number, percent
from jaxid.data.dataset import ModelSpec
from jaxid.dynamics.base_parameters import BaseParameters
from jaxid.fitting.result import Covariance, Estimate
from jaxid.fitting.stated import judged, StatedNumber
from jaxid.identification.regression import FrictionLaw, RegressionRun, torques
from jaxid.numerics.stated_numbers import apart


#: Standard deviations from which a difference is worth a sentence.
MANY = 3.0


def answered(
    arm: Any,
    spec: ModelSpec | None,
    base: BaseParameters,
    law: FrictionLaw,
    runs: Sequence[RegressionRun],
    result: Any,
) -> dict[str, Any]:
    """What a file states, or else the dataset under [model.parameters] and [model.constants],
    beside what was identified: fields of an identification.
    """
    if getattr(arm, "friction", ()):
        return beside_the_file(arm, base, law, runs, result)
    known = values_of(spec)
    rows = [
        _answer(name, value, known, base, result)
        for name, value in known.items()
        if name in (*base.standard, *result.names)
    ]
    rows = _together(rows, result, plain=True)
    rows.sort(key=lambda row: -abs(row["deviation"] or 0.0))
    said = [row["text"] for row in rows if abs(row["deviation"] or 0.0) > MANY]
    return {"stated": tuple(rows), "answers": tuple(said)}


def values_of(spec: ModelSpec | None) -> dict[str, float]:
    """The constants and the values of parameters that a dataset states, by name."""
    if spec is None:
        return {}
    values = {k: p.value for k, p in spec.parameters.items() if p.value is not None}
    return {**spec.constants, **values}


def _beside_found(what: str, deviation: float, found: str) -> str:
    """What is stated, so many standard deviations from what was found."""
    far = f"{number(abs(deviation), 2)} standard deviations from {found}"
    if abs(deviation) > MANY:
        return f"{what} is {far}"
    return f"{what} agrees with the data: it is {far}"


def _answer(
    name: str, value: float, known: dict[str, float], base: BaseParameters, result: Any
) -> dict[str, Any]:
    """One stated number beside what was identified of it: of a body's, the base parameter that it
    leads, where nothing regroups with it that is not stated, too.
    """
    members = {name: 1.0}
    if name in base.names:
        row = base.K[base.names.index(name)]
        members = {base.standard[k]: float(row[k]) for k in np.flatnonzero(row)}
    alone = name in result.names and all(k in known for k in members)
    stated = sum(weight * known[k] for k, weight in members.items()) if alone else value
    at = result.names.index(name) if name in result.names else None
    found = float(result.theta[at]) if at is not None else float("nan")
    std = float(result.std()[at]) if at is not None else float("nan")
    deviation = apart(found, stated, std) if alone else None
    unit = result.units[at] if at is not None else ""
    joint = name[len(name.rstrip("0123456789")) :]
    text = f"your stated {name} {number(value)} {unit}".rstrip()
    if not alone:
        text += (
            " can be neither confirmed nor refuted: the motion shows it only together with"
            " other numbers of the arm"
        )
    elif deviation is None:
        text += " can be neither confirmed nor refuted: the data do not determine it"
    else:
        if len(members) > 1:
            text += f" (with what regroups with it {number(stated)})"
        text = _beside_found(text, deviation, f"{number(found)} ± {number(std, 2)} {unit}")
    return {
        "joint": f"q{joint}",
        "link": f"link {joint}",
        "parameter": name,
        "stated": stated,
        "unit": unit,
        "text": text,
        "fitted": found if alone else None,
        "std": std if alone and std > 0 else None,
        "deviation": deviation,
    }


def beside_the_file(
    arm: Any, base: BaseParameters, law: FrictionLaw, runs: Sequence[RegressionRun], result: Any
) -> dict[str, Any]:
    """Fields `stated`, `per_joint` and `answers` of an identification whose arm comes from a file.

    A base parameter's stated value is the file's own combination. Torque errors are relative, of
    the filtered torque.
    """
    n = len(arm.prismatic)

    def split(name):
        return (
            name.rstrip("0123456789"),
            int(name[len(name.rstrip("0123456789")) :]) - 1,
        )

    phi = np.array(
        [float(np.asarray(getattr(arm, kind))[j]) for kind, j in map(split, base.standard)]
    )
    level, viscous = np.array(arm.friction).T
    own = {"F_c": level, "F_v": viscous}
    theta = np.concatenate(
        [base.values(phi), *(own.get(p, np.zeros(n)) for p, _ in law.parameters)]
    )
    std, rows = result.std(), []
    for i, name in enumerate(result.names):
        kind = name.rstrip("0123456789")
        if kind not in own and i >= result.base_count:
            continue
        deviation = apart(float(result.theta[i]), float(theta[i]), float(std[i]))
        joint = int(name[len(kind) :])
        rows.append(
            {
                "joint": f"q{joint}",
                "link": f"link {joint}",
                "parameter": name,
                "stated": float(theta[i]),
                "fitted": float(result.theta[i]),
                "std": float(std[i]),
                "deviation": deviation,
                "unit": result.units[i],
                "text": (
                    f"{name}: {result.theta[i]:.4g} {result.units[i]}, the file says {theta[i]:.4g}"
                ),
            }
        )
    joints = []
    for run in runs:
        predicted = next(torques(run, [(law, theta, np.ones(n))]))[0]
        size = np.maximum(np.linalg.norm(run.tau, axis=0), 1e-300)
        before = np.linalg.norm(run.tau - predicted, axis=0) / size
        after = next(e for e in result.experiments if e.file == run.name).relative_error_per_joint
        joints += [
            {
                "joint": f"q{j + 1}",
                "split": run.split,
                "experiment": run.name,
                "as_it_stands": float(before[j]),
                "retuned": float(after[j]),
                "unit": "1",
                "text": "torque error over the torque, with the file as it stands",
            }
            for j in range(n)
        ]
    worst = [max(r["as_it_stands"] for r in joints if r["joint"] == f"q{j + 1}") for j in range(n)]
    said = [
        *_first_moments(
            rows,
            n,
            {k: int(np.count_nonzero(r)) > 1 for k, r in zip(base.names, base.K, strict=True)},
        ),
        "with the file as it stands the torque is off by "
        + listed([f"{percent(w)} at {name}" for name, w in zip(result.labels, worst, strict=True)]),
    ]
    rows = _together(rows, result, plain=False)
    return {"stated": tuple(rows), "per_joint": tuple(joints), "answers": tuple(said)}


def _together(rows: Sequence[dict[str, Any]], result: Any, plain: bool) -> list[dict[str, Any]]:
    """The rows, those that were identified judged all together by their one covariance: see
    `jaxid.fitting.stated.judged`.
    """
    at = {name: i for i, name in enumerate(result.names)}
    told = {at[r["parameter"]]: r for r in rows if r["fitted"] is not None and r["std"]}
    std = result.std()
    found = {
        i: Estimate(float(result.theta[i]), float(std[i]), result.units[i], -np.inf, np.inf)
        for i in range(len(result.names))
    }
    size = len(result.names)
    covariance = Covariance(tuple(result.names), np.asarray(result.covariance)[:size, :size])
    each = {i: StatedNumber(**row) for i, row in told.items()}
    new = judged(each, result.names, found, covariance, plain)
    others = [r for r in rows if at.get(r["parameter"], -1) not in told]
    return [*(s.to_dict() for s in new), *others]


def _first_moments(rows: Sequence[dict[str, Any]], n: int, regrouped: dict[str, bool]) -> list[str]:
    """One sentence for each link whose first moment differs, along where the file has it."""
    found = {r["parameter"]: r for r in rows}
    out = []
    for j in range(1, n + 1):
        own = [found[k] for k in (f"mx{j}", f"my{j}", f"mz{j}") if k in found]
        was, now, std = (np.array([r[k] for r in own], float) for k in ("stated", "fitted", "std"))
        size = float(was @ was)
        if size < 1e-12 or not np.isfinite(std).all():
            continue
        share, doubt = (
            float((now - was) @ was / size),
            float(np.sqrt(np.sum((was * std) ** 2)) / size),
        )
        if abs(share) > MANY * doubt and abs(share) > 0.01:
            more = f"{100 * abs(share):.0f} % {'more' if share > 0 else 'less'}"
            who = f"link {j}" + (
                " with what hangs on it" if any(regrouped[r["parameter"]] for r in own) else ""
            )
            out.append(
                f"{who} carries {more} first moment than the file says (± {196 * doubt:.0f} %)"
            )
    return out
