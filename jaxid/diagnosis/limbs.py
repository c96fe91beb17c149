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
from jaxid.base.wording import listed, times
from jaxid.data.dataset import Dataset
from jaxid.diagnosis.belief import joined_beliefs
from jaxid.diagnosis.breakdown import Share
from jaxid.diagnosis.budget import shrink
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
    first = parts[0]

    def every(field):
        return tuple(x for d in parts for x in getattr(d, field))

    which = _which(parts, names)
    notes = tuple(
        dict.fromkeys(
            (
                *every("notes"),
                f"{len(parts)} limbs that do not move each other were diagnosed one by one",
            )
        )
    )
    return replace(
        first,
        dataset=dataset.name,
        dataset_sha256=dataset.sha256,
        where=tuple(sorted(every("where"), key=lambda f: -f.times_noise_floor)),
        which=which,
        how_far=_how_far(parts, which.verdict),
        next_experiment=" ".join(
            dict.fromkeys(
                said for d in parts for said in re.split(r"(?<=[.?!]) ", d.next_experiment)
            )
        ),
        wall_time_s=sum(d.wall_time_s for d in parts),
        nominal=together([d.nominal for d in parts], dataset),
        final=together([d.final for d in parts], dataset),
        traces=every("traces"),
        missing_force=every("missing_force"),
        regimes=every("regimes"),
        notes=notes,
        unseen=every("unseen"),
        rivals=next((d.rivals for d in parts if d.rivals is not None), None),
        data=every("data"),
        complete=all(part.complete for part in parts),
    )


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
    def every(field):
        return tuple(x for d in parts for x in getattr(d.which, field))

    ranking = tuple(
        sorted(every("ranking"), key=lambda r: -r.evidence if np.isfinite(r.evidence) else np.inf)
    )
    text = " ".join(
        f"{listed(joints)}: {d.which.text}" for joints, d in zip(names, parts, strict=True)
    )
    verdict = verdict_of([d.which.verdict for d in parts])
    doubts = {k: why for d in parts for k, why in d.which.doubts.items()}
    beliefs = [d.which.belief for d in parts if d.which.belief is not None]
    return Which(
        verdict=verdict,
        effects=every("effects"),
        confusable_with=every("confusable_with"),
        ranking=ranking,
        text=text,
        doubts=doubts,
        belief=joined_beliefs(beliefs),
    )


def _mean(gaps: Sequence[float], weights: Sequence[float]) -> float:
    return float(np.sqrt(np.average(np.square(gaps), weights=weights)))


def _how_far(parts: Sequence[Diagnosis], verdict: str) -> HowFar:
    """Gaps over the channels of all limbs, which have the same samples."""
    fars = [d.how_far for d in parts]
    weights = [max(1, len(f.per_channel)) for f in fars]
    before, retuned, after = (
        _mean([getattr(f, g) for f in fars], weights)
        for g in ("gap_before", "gap_retuned", "gap_after")
    )
    named = verdict in ("named", "partly")
    shrinkage = (
        min(shrink(before**2, after**2), 1.0) if named and before > max(1.0, after) else None
    )
    split = fars[0].split
    text = (
        f"gap on {split} data: {times(before)} times the noise before, {times(retuned)} after"
        " re-tuning the old parameters alone"
    )
    return HowFar(
        gap_before=before,
        gap_retuned=retuned,
        gap_after=after,
        noise_floor=1.0,
        shrinkage=shrinkage,
        shrinkage_interval_95=None,
        interval_reason=NO_INTERVAL if named else fars[0].interval_reason,
        per_channel={k: v for f in fars for k, v in f.per_channel.items()},
        text=text + (f", {times(after)} with the effects added" if named else ""),
        per_run=_runs(fars, weights),
        per_regime=tuple(s for f in fars for s in f.per_regime),
        interval_from="",
        split=split,
        per_joint=tuple(r for f in fars for r in f.per_joint),
    )


def _runs(fars: Sequence[HowFar], weights: Sequence[float]) -> tuple[Share, ...]:
    """The gaps of each run, over all limbs."""
    if any(len(f.per_run) != len(fars[0].per_run) for f in fars):
        return ()

    def mean(own, gap):
        return _mean([getattr(s, gap) for s in own], weights)

    return tuple(
        replace(
            own[0],
            before=mean(own, "before"),
            retuned=mean(own, "retuned"),
            after=mean(own, "after"),
        )
        for own in zip(*(f.per_run for f in fars), strict=True)
    )
