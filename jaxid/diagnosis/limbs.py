"""Limbs on a base that does not move are diagnosed each by itself: what one lacks moves no other.
The answers become one.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from dataclasses import replace
from typing import Any

import numpy as np

from jaxid.base.stopping import Interrupted
from jaxid.base.wording import listed
from jaxid.data.dataset import Dataset
from jaxid.diagnosis.belief import joined_beliefs
from jaxid.diagnosis.breakdown import Share
from jaxid.diagnosis.budget import shrink
from jaxid.diagnosis.how_far import gap_text
from jaxid.diagnosis.result import Diagnosis, HowFar, Which
from jaxid.fitting.fitter import Progress
from jaxid.fitting.limbs import together
from jaxid.numerics.side_by_side import side_by_side


Limb = tuple[Any, Dataset]
NO_INTERVAL = (
    "limbs were diagnosed one by one: how they scatter together in a further run is not known"
)


def diagnose_each(
    limbs: Sequence[Limb],
    work: Callable[[Any, Dataset, Progress], Diagnosis],
    dataset: Dataset,
    progress: Progress | None,
) -> Diagnosis:
    """The diagnoses of all limbs, `work(robot, data, progress)`, as one, made side by side. On
    Ctrl-C `Interrupted` carries those that are finished.
    """
    began = time.perf_counter()
    names = [robot.signatures[0].joints for robot, _ in limbs]
    words = [f"limb {k + 1} of {len(limbs)} ({', '.join(own)})" for k, own in enumerate(names)]

    def of(k, tell):
        return lambda stage, done, total, text: tell(f"{words[k]}: {stage}", done, total, text)

    jobs = [
        lambda tell, k=k, r=robot, d=data: work(r, d, of(k, tell))
        for k, (robot, data) in enumerate(limbs)
    ]
    made = side_by_side(jobs, progress)
    done: list[tuple[Diagnosis, tuple[str, ...]]] = []
    stop: BaseException | None = None
    for own, b in zip(names, made, strict=True):
        fault = CancelledError() if b.cancelled() else b.exception()
        if fault is None:
            done.append((b.result(), own))
        elif not isinstance(fault, KeyboardInterrupt | CancelledError):
            raise fault
        elif (part := getattr(fault, "partial", None)) is not None:
            done.append((part, own))
        stop = stop or fault
    if not done:
        raise Interrupted() from stop
    whole = joined([d for d, _ in done], [own for _, own in done], dataset)
    whole = replace(whole, wall_time_s=time.perf_counter() - began)
    if stop is not None:
        raise Interrupted(whole) from stop
    return whole


def joined(
    parts: Sequence[Diagnosis], names: Sequence[tuple[str, ...]], dataset: Dataset
) -> Diagnosis:
    """One diagnosis of those of limbs with these joints."""
    which = _which(parts, names)
    how = f"{len(parts)} limbs that do not move each other were diagnosed one by one"
    sentences: list[str] = []
    for d in parts:
        sentences += re.split(r"(?<=[.?!]) ", d.next_experiment)
    return replace(
        parts[0],
        dataset=dataset.name,
        dataset_sha256=dataset.sha256,
        where=tuple(sorted(_every(parts, "where"), key=lambda f: -f.times_noise_floor)),
        which=which,
        how_far=_how_far(parts, which.verdict),
        next_experiment=" ".join(dict.fromkeys(sentences)),
        wall_time_s=sum(d.wall_time_s for d in parts),
        nominal=together([d.nominal for d in parts], dataset),
        final=together([d.final for d in parts], dataset),
        traces=_every(parts, "traces"),
        missing_force=_every(parts, "missing_force"),
        regimes=_every(parts, "regimes"),
        notes=tuple(dict.fromkeys((*_every(parts, "notes"), how))),
        unseen=_every(parts, "unseen"),
        rivals=next((d.rivals for d in parts if d.rivals is not None), None),
        data=_every(parts, "data"),
        complete=all(part.complete for part in parts),
    )


def _every(parts: Sequence[Any], field: str) -> tuple[Any, ...]:
    """What a field of each part holds, one after the other."""
    found: list[Any] = []
    for part in parts:
        found += getattr(part, field)
    return tuple(found)


def _merged(parts: Sequence[Any], field: str) -> dict[str, Any]:
    """The same of a field that holds something by name."""
    found: dict[str, Any] = {}
    for part in parts:
        found |= getattr(part, field)
    return found


def verdict_of(verdicts: Sequence[str]) -> str:
    """Of the whole: `none` and `named` where that holds of every limb with a gap; `partly` where
    something is named and a limb has a remainder; else `unknown`.
    """
    if all(v == "none" for v in verdicts):
        return "none"
    if all(v in ("none", "named") for v in verdicts):
        return "named"
    return "partly" if any(v in ("named", "partly") for v in verdicts) else "unknown"


def _which(parts: Sequence[Diagnosis], names: Sequence[tuple[str, ...]]) -> Which:
    each = [d.which for d in parts]
    ranking = sorted(
        _every(each, "ranking"),
        key=lambda r: -r.evidence if np.isfinite(r.evidence) else np.inf,
    )
    text = " ".join(f"{listed(joints)}: {w.text}" for joints, w in zip(names, each, strict=True))
    return Which(
        verdict=verdict_of([w.verdict for w in each]),
        effects=_every(each, "effects"),
        confusable_with=_every(each, "confusable_with"),
        ranking=tuple(ranking),
        text=text,
        doubts=_merged(each, "doubts"),
        belief=joined_beliefs([w.belief for w in each if w.belief is not None]),
    )


def _mean(parts: Sequence[Any], gap: str, weights: Sequence[float]) -> float:
    """The root of the mean square of a gap over parts."""
    gaps = [getattr(part, gap) for part in parts]
    return float(np.sqrt(np.average(np.square(gaps), weights=weights)))


def _how_far(parts: Sequence[Diagnosis], verdict: str) -> HowFar:
    """Gaps over the channels of all limbs, which have the same samples."""
    fars = [d.how_far for d in parts]
    weights = [max(1, len(f.per_channel)) for f in fars]
    before = _mean(fars, "gap_before", weights)
    retuned = _mean(fars, "gap_retuned", weights)
    after = _mean(fars, "gap_after", weights)
    named = verdict in ("named", "partly")
    shrinkage = None
    if named and before > max(1.0, after):
        shrinkage = min(shrink(before**2, after**2), 1.0)
    split = fars[0].split
    return HowFar(
        gap_before=before,
        gap_retuned=retuned,
        gap_after=after,
        noise_floor=1.0,
        shrinkage=shrinkage,
        shrinkage_interval_95=None,
        interval_reason=NO_INTERVAL if named else fars[0].interval_reason,
        per_channel=_merged(fars, "per_channel"),
        text=gap_text(split, (before, retuned, after), verdict),
        per_run=_runs(fars, weights),
        per_regime=_every(fars, "per_regime"),
        interval_from="",
        split=split,
        per_joint=_every(fars, "per_joint"),
    )


def _runs(fars: Sequence[HowFar], weights: Sequence[float]) -> tuple[Share, ...]:
    """The gaps of each run, over all limbs."""
    if any(len(f.per_run) != len(fars[0].per_run) for f in fars):
        return ()
    runs = []
    for own in zip(*(f.per_run for f in fars), strict=True):
        gaps = {gap: _mean(own, gap, weights) for gap in ("before", "retuned", "after")}
        runs.append(replace(own[0], **gaps))
    return tuple(runs)
