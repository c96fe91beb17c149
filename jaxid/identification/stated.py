"""The numbers of an arm's own file, or of its dataset, beside those that were identified: which are
wrong, and by how much.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxid.base.wording import listed, number, percent, stem_and_number
from jaxid.data.dataset import ModelSpec
from jaxid.dynamics.base_parameters import BaseParameters, standard_values
from jaxid.fitting.result import Covariance, Estimate
from jaxid.fitting.stated import judged, StatedNumber
from jaxid.identification.regression import FrictionLaw, RegressionRun, torques
from jaxid.numerics.stated_numbers import apart


#: Standard deviations from which a difference is worth a sentence.
MANY = 3.0


def answered(
    arm: Any,
    spec: ModelSpec,
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
    identified = {*base.standard, *result.names}
    rows = [_answer(name, known, base, result) for name in known if name in identified]
    rows = _together(rows, result, plain=True)
    rows.sort(key=_far, reverse=True)
    said = [row["text"] for row in rows if _far(row) > MANY]
    return {"stated": tuple(rows), "answers": tuple(said)}


def _far(row: dict[str, Any]) -> float:
    """By how many standard deviations a stated number is off; 0 where that is not known."""
    return abs(row["deviation"] or 0.0)


def values_of(spec: ModelSpec) -> dict[str, float]:
    """The constants and the values of parameters that a dataset states, by name."""
    values = {k: p.value for k, p in spec.parameters.items() if p.value is not None}
    return {**spec.constants, **values}


def _beside_found(what: str, deviation: float, found: str) -> str:
    """What is stated, so many standard deviations from what was found."""
    far = f"{number(abs(deviation), 2)} standard deviations from {found}"
    if abs(deviation) > MANY:
        return f"{what} is {far}"
    return f"{what} agrees with the data: it is {far}"


def _answer(
    name: str, known: dict[str, float], base: BaseParameters, result: Any
) -> dict[str, Any]:
    """One stated number beside what was identified of it: of a body's, the base parameter that it
    leads, where nothing regroups with it that is not stated, too.
    """
    _, joint = stem_and_number(name)
    at = result.names.index(name) if name in result.names else None
    unit = "" if at is None else result.units[at]
    said = f"your stated {name} {number(known[name])} {unit}".rstrip()
    row: dict[str, Any] = {
        "joint": f"q{joint}",
        "link": f"link {joint}",
        "parameter": name,
        "stated": known[name],
        "unit": unit,
        "text": f"{said} can be neither confirmed nor refuted: the motion shows it only together"
        " with other numbers of the arm",
        "fitted": None,
        "std": None,
        "deviation": None,
    }
    members = {name: 1.0}
    if name in base.names:
        weights = base.K[base.names.index(name)]
        members = {base.standard[k]: float(weights[k]) for k in np.flatnonzero(weights)}
    if at is None or not members.keys() <= known.keys():
        return row
    stated = sum(weight * known[k] for k, weight in members.items())
    found, std = float(result.theta[at]), float(result.std()[at])
    deviation = apart(found, stated, std)
    if deviation is None:
        text = f"{said} can be neither confirmed nor refuted: the data do not determine it"
    else:
        if len(members) > 1:
            said += f" (with what regroups with it {number(stated)})"
        text = _beside_found(said, deviation, f"{number(found)} ± {number(std, 2)} {unit}")
    return row | {
        "stated": stated,
        "text": text,
        "fitted": found,
        "std": std if std > 0 else None,
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
    phi = standard_values(arm, base.standard)
    level, viscous = np.array(arm.friction).T
    own = {"F_c": level, "F_v": viscous}
    friction = [own.get(p, np.zeros(n)) for p, _ in law.parameters]
    theta = np.concatenate([base.values(phi), *friction])
    std, rows = result.std(), []
    for i, name in enumerate(result.names):
        kind, joint = stem_and_number(name)
        if kind not in own and i >= result.base_count:
            continue
        deviation = apart(float(result.theta[i]), float(theta[i]), float(std[i]))
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
    worst = np.zeros(n)
    for run in runs:
        predicted = next(torques(run, [(law, theta, np.ones(n))]))[0]
        size = np.maximum(np.linalg.norm(run.tau, axis=0), 1e-300)
        before = np.linalg.norm(run.tau - predicted, axis=0) / size
        after = next(e for e in result.experiments if e.file == run.name).relative_error_per_joint
        before = np.where(run.moves > 0, before, np.nan)  # as those that are identified
        worst = np.fmax(worst, before)
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
    regrouped = {k for k, row in zip(base.names, base.K, strict=True) if np.count_nonzero(row) > 1}
    off = [f"{percent(w)} at {name}" for name, w in zip(result.labels, worst, strict=True)]
    said = [
        *_first_moments(rows, n, regrouped),
        f"with the file as it stands the torque is off by {listed(off)}",
    ]
    rows = _together(rows, result, plain=False)
    return {"stated": tuple(rows), "per_joint": tuple(joints), "answers": tuple(said)}


def _together(rows: Sequence[dict[str, Any]], result: Any, plain: bool) -> list[dict[str, Any]]:
    """The rows, those that were identified judged all together by their one covariance: see
    `jaxid.fitting.stated.judged`.
    """
    each, others = {}, []
    for row in rows:
        if row["fitted"] is not None and row["std"]:
            each[result.names.index(row["parameter"])] = StatedNumber(**row)
        else:
            others.append(row)
    size = len(result.names)
    found = {}
    for i, (value, std) in enumerate(zip(result.theta[:size], result.std()[:size], strict=True)):
        found[i] = Estimate(float(value), float(std), result.units[i], -np.inf, np.inf)
    covariance = Covariance(tuple(result.names), np.asarray(result.covariance)[:size, :size])
    new = judged(each, result.names, found, covariance, plain)
    return [*(s.to_dict() for s in new), *others]


def _first_moments(rows: Sequence[dict[str, Any]], n: int, regrouped: set[str]) -> list[str]:
    """One sentence for each link whose first moment differs, along where the file has it;
    `regrouped` are numbers with which others hang together.
    """
    found = {r["parameter"]: r for r in rows}
    out = []
    for j in range(1, n + 1):
        own = [found[k] for k in (f"mx{j}", f"my{j}", f"mz{j}") if k in found]
        each = np.array([(r["stated"], r["fitted"], r["std"]) for r in own], float)
        was, now, std = each.reshape(-1, 3).T
        size = float(was @ was)
        if size < 1e-12 or not np.isfinite(std).all():
            continue
        share = float((now - was) @ was / size)
        doubt = float(np.sqrt(np.sum((was * std) ** 2)) / size)
        if abs(share) <= max(MANY * doubt, 0.01):
            continue
        more = f"{100 * abs(share):.0f} % {'more' if share > 0 else 'less'}"
        hanging = not regrouped.isdisjoint(r["parameter"] for r in own)
        who = f"link {j} with what hangs on it" if hanging else f"link {j}"
        out.append(f"{who} carries {more} first moment than the file says (± {196 * doubt:.0f} %)")
    return out
