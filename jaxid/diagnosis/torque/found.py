"""What a search by torque found, in all runs or in those alone that were not fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from jaxid.diagnosis.evidence import level
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.against_reference import as_before
from jaxid.diagnosis.torque.algebra import BLOCKS, gram, Weights
from jaxid.diagnosis.torque.answer import Answer, of_model
from jaxid.diagnosis.torque.choose import Chooser, Model
from jaxid.diagnosis.torque.claims import claims, sets_by_place, TorqueClaim
from jaxid.diagnosis.torque.judged import only_in, scales
from jaxid.diagnosis.torque.library import units
from jaxid.diagnosis.torque.study import TorqueRows, TorqueStudy
from jaxid.diagnosis.torque.weigh import weigh, Weighed


#: So often at most the search is done along the torque that what it found implies.
PASSES = 3
#: Effects at places that the ranking shows at most.
RANKED = 40


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found: the model with the effects, the one without, and which runs chose and
    judge.
    """

    chooser: Chooser
    rows: TorqueRows
    weights: Weights
    chosen: Model
    nominal: Answer
    final: Answer
    fit: list[int]
    choose: list[int]
    judge: list[int]
    weighed: Weighed
    claims: tuple[TorqueClaim, ...]
    #: What was found in all runs, where the effects act in those alone that were not fitted.
    base: Found | None = None
    #: The model with the bodies of the reference, where this recording refutes them.
    as_before: Answer | None = None

    @property
    def different(self) -> bool:
        return self.base is not None

    @property
    def held_out(self) -> list[int]:
        """Runs that neither were fitted nor chose, else those that chose, else all."""
        return self.judge or self.choose or self.fit


def searched(study: TorqueStudy, most: int) -> Found:
    fit, choose, judge = study.of("fit"), study.of("validation"), study.of("report")
    theta, found = study.theta, None
    for again in range(PASSES):
        rows, weights = study.rows_with_effects(theta, again > 0)
        chooser = study.chooser(rows, weights, fit, choose)
        nominal = of_model(study, rows, chooser.nominal)
        before = as_before(chooser, nominal, [choose, judge], fit)
        weighed = weigh(scales(study, rows, weights, chooser, [*fit, *choose]))
        claimed = claims(weighed, most)
        if chooser.departs is not None and _as_reference(chooser, nominal, [fit, choose]):
            claimed = []
        chosen = chooser.lively([claim.unit for claim in claimed]) or chooser.nominal
        if before is not None:
            chosen = chooser.different(chosen)
        found = Found(
            chooser=chooser,
            rows=rows,
            weights=weights,
            chosen=chosen,
            nominal=nominal,
            final=of_model(study, rows, chosen),
            fit=fit,
            choose=choose,
            judge=judge,
            weighed=weighed,
            claims=tuple(claim for claim in claimed if claim.unit in chosen.units),
            as_before=before,
        )
        numbers = np.split(
            chosen.solution.theta[study.size :],
            np.cumsum([len(u.fields) for u in found.final.units])[:-1],
        )
        study.settle(
            rows.theta, list(zip(found.final.units, numbers, strict=True)) if chosen.units else ()
        )
        by_torque = {k.name for k in study.kinds if k.by_torque}
        again = any(rows.units[u].effect in by_torque for u in chosen.units)
        if not chosen.units or (study.plant.exact() and not again):
            break
        theta = theta.copy()  # once more, along the motion's torque with what was found
        theta[study.plant.free] = np.clip(
            chosen.solution.theta[: study.plant.size], study.lower, study.upper
        )
    assert found is not None
    _ranked(found)
    return found


def _as_reference(chooser: Chooser, nominal: Answer, split: Sequence[Sequence[int]]) -> bool:
    """Whether nothing differs from a reference: the re-tuned model reaches the noise, at every
    joint and in every set of runs, with numbers that are as near to the reference's as chance lets
    them.
    """
    assert chooser.departs is not None
    count = len(chooser.departs.at)
    near = chooser.nominal.departed <= level(count) * count
    joints = range(len(nominal.study.noise))
    gaps = [nominal.gap(which, j) for which, j in product(split, joints)]
    quiet = nominal.gap(split[0]) ** 2 <= level(round(chooser.fit.rows)) + 0.1
    return near and quiet and not any(gap > LIMITS.near for gap in gaps)


def _ranked(found: Found) -> None:
    """Has the numbers worked out of what the ranking shows."""
    for s in sets_by_place(found.weighed, RANKED):
        found.chooser.model(s)


def differs(found: Found) -> bool:
    inside, outside = found.final.gap(found.fit), found.final.gap(found.choose)
    return LIMITS.half * outside > inside and outside > LIMITS.left


def difference(study: TorqueStudy, found: Found, most: int) -> Found | None:
    """What is different in the runs that were not fitted: effects that act in those alone, beside
    numbers that all runs share. Found on the validation runs, judged on the report runs; None where
    nothing is, and where what is left of them with laws that were found is not what those leave of
    the runs that were fitted: then they are no more than another motion.
    """
    if not found.judge:
        return None
    base = found.final
    loads = [k for k in study.kinds if k.quantity() == "inertial"]
    every = [*found.rows.units, *units(study.plant, loads, study.runs, found.rows.theta, True)]
    mask = np.array([r.split != "fit" for r in study.runs], float)
    acting = [only_in(u, mask) for u in every]
    rows = []
    for k, x in enumerate(found.rows.rows):
        more = [u.columns[k] for u in acting]
        rows.append(np.concatenate([x[:, :, base.at], *more, x[:, :, -1:]], 2))
    own = TorqueRows(found.rows.theta, acting, rows)
    chooser = _second(study, own, found)
    both = [*found.fit, *found.choose]
    weighed = weigh(scales(study, own, found.weights, chooser, both, mask))
    claimed = claims(weighed, most)
    chosen = chooser.lively([claim.unit for claim in claimed])
    if chosen is None:
        return None
    final = of_model(study, own, chosen)
    inside, outside = base.gap(found.fit), final.gap(found.judge)
    if not np.isfinite([inside, outside]).all():
        return None
    if base.units and outside > LIMITS.left * max(1.0, inside):
        return None
    nominal = Answer(study, own, np.arange(len(base.at)), base.numbers, base.units)
    second = Found(
        chooser=chooser,
        rows=own,
        weights=found.weights,
        chosen=chosen,
        nominal=nominal,
        final=final,
        fit=found.fit,
        choose=found.choose,
        judge=found.judge,
        weighed=weighed,
        claims=tuple(claim for claim in claimed if claim.unit in chosen.units),
        base=found,
    )
    _ranked(second)
    return second


def _second(study: TorqueStudy, rows: TorqueRows, found: Found) -> Chooser:
    """The search for what acts in the runs that were not fitted."""
    base, p = found.final, study.plant.size
    both = [*base.units, *rows.units]
    below, above = study.free_bounds()
    start = np.concatenate(
        [
            study.theta[study.plant.free],
            base.numbers[p:],
            np.zeros(sum(len(u.fields) for u in rows.units)),
        ]
    )
    low = np.concatenate([study.lower, below, *(u.least for u in both)])
    high = np.concatenate([study.upper, above, *(u.most for u in both)])
    known = study.known(len(start), rows.theta, both)

    def g(which):
        return gram(*study.some(rows, which), found.weights, BLOCKS)

    both = [*found.fit, *found.choose]
    return Chooser(
        units=rows.units,
        size=len(base.numbers),
        fit=g(both),
        held=g(found.judge),
        known=known,
        start=start,
        lower=low,
        upper=high,
    )
