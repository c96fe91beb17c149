"""A diagnosis by torque from beginning to end."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxid.diagnosis.budget import closed
from jaxid.diagnosis.next_experiment import advice
from jaxid.diagnosis.reasons import (
    NothingPredicts,
    NotMostHeldOut,
    Remark,
    TorqueAtTheNoise,
    TorqueHeldOut,
    Undetermined,
)
from jaxid.diagnosis.result import Diagnosis, Which
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.against_reference import as_before, verdict_against
from jaxid.diagnosis.torque.algebra import BLOCKS, gram, Weights
from jaxid.diagnosis.torque.answer import (
    Answer,
    estimates,
    how_far,
    of_model,
    places,
    ranking,
    scores,
    traces,
)
from jaxid.diagnosis.torque.ceiling import ceiling
from jaxid.diagnosis.torque.choose import Chooser, Model
from jaxid.diagnosis.torque.library import Unit, units
from jaxid.diagnosis.torque.reference import ReferenceNumbers
from jaxid.diagnosis.torque.rows import MOTION
from jaxid.diagnosis.torque.study import TorqueRows, TorqueStudy
from jaxid.diagnosis.verdict import level, Verdict
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.model_file import sha256_of
from jaxid.fitting.assemble import fitted_chain
from jaxid.fitting.fitter import Progress
from jaxid.fitting.result import Covariance, EffectEstimate, Estimate, Fit
from jaxid.fitting.scores import lost
from jaxid.fitting.stated import stated_numbers
from jaxid.identification.payload import usual_gain_std
from jaxid.problem.binding import Binding
from jaxid.wording import listed


#: So often at most the search is done along the torque that what it found implies.
PASSES = 3


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
    #: What was found in all runs, where the effects act in those alone that were not fitted.
    base: Found | None = None
    #: The model with the bodies of the reference, where this recording refutes them.
    as_before: Answer | None = None

    @property
    def different(self) -> bool:
        return self.base is not None


def diagnose_by_torque(
    binding: Binding,
    kinds: Sequence[type[Effect]],
    max_effects: int,
    cutoff_hz: float | None,
    seed: int,
    reference: ReferenceNumbers | None,
    progress: Progress | None,
) -> Diagnosis:
    """See `jaxid.diagnose` with the residual `inverse_dynamics`."""
    began = time.perf_counter()
    given = None if reference is None else reference.known(binding)
    say = progress or (lambda *_: None)
    say("torque", 0, 4, "rows")
    study = TorqueStudy(binding, kinds, cutoff_hz, given, given is not None)
    say("torque", 1, 4, f"{sum(r.rows(r.q[:, :1]).shape[0] for r in study.runs)} rows, effects")
    found = _searched(study, max_effects)
    say("torque", 2, 4, f"{len(found.chooser.tried)} sets of effects compared")
    if given is None and _differs(found):
        found = _difference(study, found, max_effects) or found
    return _answered(study, found, max_effects, seed, began)


def _searched(study: TorqueStudy, most: int) -> Found:
    fit, choose, judge = study.of("fit"), study.of("validation"), study.of("report")
    theta, found = study.theta, None
    for again in range(PASSES):
        rows, weights = study.rows_with_effects(theta, again > 0)
        chooser = study.chooser(rows, weights, fit, choose, most)
        chosen = chooser.nominal if _at_floor(study, rows, chooser, fit, choose) else chooser.run()
        nominal = of_model(study, rows, chooser.nominal)
        before = as_before(chooser, nominal, [choose, judge], fit)
        chosen = chosen if before is None else chooser.different(chosen)
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
    return found


def _at_floor(
    study: TorqueStudy,
    rows: TorqueRows,
    chooser: Chooser,
    fit: Sequence[int],
    choose: Sequence[int],
) -> bool:
    """Whether the re-tuned model reaches the noise, at every joint, on data that were and that were
    not fitted.
    """
    answer = of_model(study, rows, chooser.nominal)
    gaps = [answer.gap(which, j) for which in (fit, choose) for j in range(len(study.noise))]
    if chooser.departs is not None:
        count = len(chooser.departs.at)
        if chooser.nominal.departed > level(count) * count:
            return False
    return (
        all(not gap > LIMITS.seen for gap in gaps)
        and answer.gap(fit) ** 2 <= level(round(chooser.fit.rows)) + 0.1
    )


def _differs(found: Found) -> bool:
    inside, outside = found.final.gap(found.fit), found.final.gap(found.choose)
    return outside > max(LIMITS.different * inside, LIMITS.left)


def _difference(study: TorqueStudy, found: Found, most: int) -> Found | None:
    """What is different in the runs that were not fitted: effects that act in those alone, beside
    numbers that all runs share. Found on the validation runs, judged on the report runs; None where
    nothing is, and where what is left of them with laws that were found is not what those leave of
    the runs that were fitted: then they are no more than another motion.
    """
    if not found.judge:
        return None
    base = found.final
    more = [k for k in study.kinds if k.quantity() == "inertial"]
    every = [*found.rows.units, *units(study.plant, more, study.runs, found.rows.theta, True)]
    mask = np.array([r.split != "fit" for r in study.runs], float)
    acting = [
        replace(u, columns=[c * m for c, m in zip(u.columns, mask, strict=True)]) for u in every
    ]
    rows = [
        np.concatenate([x[:, :, base.at], *(u.columns[k] for u in acting), x[:, :, -1:]], 2)
        for k, x in enumerate(found.rows.rows)
    ]
    own = TorqueRows(found.rows.theta, acting, rows)
    chooser = _second(study, own, found, most)
    chosen = chooser.run()
    if not chosen.units:
        return None
    final = of_model(study, own, chosen)
    inside, outside = base.gap(found.fit), final.gap(found.judge)
    if not np.isfinite([inside, outside]).all():
        return None
    if base.units and outside > LIMITS.left * max(1.0, inside):
        return None
    nominal = Answer(study, own, np.arange(len(base.at)), base.numbers, base.units)
    return Found(
        chooser=chooser,
        rows=own,
        weights=found.weights,
        chosen=chosen,
        nominal=nominal,
        final=final,
        fit=found.fit,
        choose=found.choose,
        judge=found.judge,
        base=found,
    )


def _second(study: TorqueStudy, rows: TorqueRows, found: Found, most: int) -> Chooser:
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

    left = study.by_joint(rows, found.weights, found.judge)
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
        most=most,
        by_joint=left,
    )


# ---- the answer


def _judged(study: TorqueStudy, found: Found) -> Verdict:
    """What is named comes down to the noise on runs that chose and on runs that did not."""
    nominal, final, split = found.nominal, found.final, [found.choose, found.judge]
    sets = [w for w in split if w] or [found.fit]
    before = [nominal.gap(w) for w in sets]
    after = [final.gap(w) for w in sets]
    if astray := _astray(study, final):
        return Verdict("unknown", (Undetermined(astray[0]),))
    if found.as_before is not None and final.units:
        said = tuple(_said(u) for u in final.units)
        usual = max(1.0, nominal.gap(found.fit))
        return verdict_against(said, found.as_before, final, sets, usual)
    if not final.units:
        gaps = [nominal.gap(w) for w in (found.fit, *sets) if w]
        measured = [g for g in gaps if not np.isnan(g)]  # nan where no joint moves in a set of runs
        if measured and max(measured) <= LIMITS.seen:
            return Verdict("none", (TorqueAtTheNoise(),))
        return Verdict("unknown", (NothingPredicts(max(measured, default=float("nan"))),))
    names = tuple(_said(u) for u in final.units)
    base = found.base.final.units if found.base else ()
    beside = (Remark(f"The model lacks {listed(_said(u) for u in base)}."),) if base else ()
    better = all(a < b for a, b in zip(after, before, strict=True))
    share = min(closed(b**2, a**2) for b, a in zip(before, after, strict=True))
    # Where the question is what differs, what the model leaves of the runs that it was fitted to is
    # what repeats would differ by.
    fitted = nominal.gap(found.fit)
    least = max(1.0, fitted) if found.different and np.isfinite(fitted) else 1.0
    held = TorqueHeldOut(
        names, share, max(after), found.different, fitted=least if least > LIMITS.seen else 0.0
    )
    if better and max(after) <= LIMITS.left * least:
        return Verdict("named", (*beside, held))
    if better and share >= LIMITS.partly:
        return Verdict("partly", (*beside, replace(held, whole=False)))
    return Verdict("unknown", (NotMostHeldOut(names, share, max(after)),))


def _astray(study: TorqueStudy, answer: Answer) -> tuple[str, ...]:
    """A sentence where a model predicts held-out torque worse than none would."""
    noise = {
        c: s for (c, _), s in zip(study.binding.chain.torque_channels, study.noise, strict=True)
    }
    return lost(scores(answer), noise)


def _said(unit: Unit) -> str:
    return (
        f"payload at link {unit.joints[-1] + 1} ({unit.location})"
        if unit.effect == "payload"
        else str(unit)
    )


def _answered(study: TorqueStudy, found: Found, most: int, seed: int, began: float) -> Diagnosis:
    b = study.binding
    judged = _judged(study, found)
    verdict, claimed = judged.name, judged.claims
    final = found.final if claimed else found.nominal
    which = found.judge or found.choose or found.fit
    own, effects, spread = estimates(study, found.chooser, found.chosen)
    if found.base is not None:  # beside what all runs have
        effects = (*estimates(study, found.base.chooser, found.base.chosen)[1], *effects)
    plain, _, plain_spread = estimates(study, found.chooser, found.chooser.nominal)
    before, note = _before(study, found.nominal)
    if found.as_before is not None:
        before, note = found.as_before, "The gap before is that of the reference's bodies."
    bound = None
    if verdict in ("unknown", "partly"):
        at = found.nominal
        bound = ceiling(
            study,
            found.rows,
            found.weights,
            at,
            [*found.fit, *(found.choose if found.different else [])],
            found.choose or found.fit,
            which,
        )
    split = "report" if found.judge else "validation"
    far = how_far(
        study=study,
        before=before,
        retuned=found.nominal,
        after=final,
        which=which,
        split=split,
        verdict=verdict,
        note=note,
        ceiling=bound,
    )
    looked = [*found.choose, *found.judge] if found.different else study.of("fit")
    findings, pictures, regimes = places(study, found.nominal, final, verdict, looked, seed)
    if _astray(
        study, final
    ):  # what it leaves says where its numbers are wrong, not where the machine is
        findings = ()
    mates = (
        [found.chooser.units[k] for k in found.chooser.confusable(found.chosen)] if claimed else []
    )
    named = effects if claimed else ()
    nominal_fit = _fit(study, found.nominal, plain, plain_spread, (), seed, began)
    final_fit = nominal_fit
    if claimed:
        final_fit = _fit(study, final, own, spread, named, seed, began)
    label = "with " + " and ".join(str(e) for e in named) if named else ""
    ranked = ranking(
        study,
        found.chooser,
        found.rows,
        found.judge if found.different else found.choose or found.fit,
    )
    return Diagnosis(
        model=b.chain.mechanism.name,
        dataset=b.dataset.name,
        dataset_sha256=b.dataset.sha256,
        seed=seed,
        residual="inverse_dynamics",
        where=findings,
        which=Which(
            verdict,
            named,
            tuple(EffectEstimate(u.effect, u.location) for u in mates),
            ranked,
            judged.text,
        ),
        how_far=far,
        next_experiment=advice(
            verdict,
            [e.effect for e in named],
            [u.effect for u in mates],
            repeated=found.weights.spread.size > 0,
        ),
        wall_time_s=time.perf_counter() - began,
        nominal=nominal_fit,
        final=final_fit,
        traces=traces(study, found.nominal, final, label),
        missing_force=pictures,
        regimes=regimes,
        notes=(*b.dataset.notes, *_notes(study, found), *_of_the_gains(study, named)),
    )


def _before(study: TorqueStudy, nominal: Answer) -> tuple[Answer, str]:
    """The model with the values that the dataset states; what it does not state is re-tuned."""
    b, numbers = study.binding, nominal.numbers.copy()
    stated = [k for k, i in enumerate(study.plant.free) if i in b.stated]
    if not stated:
        return (
            nominal,
            (
                "The dataset states no parameter values, so the gap before is that of the re-tuned"
                " model."
            ),
        )
    numbers[stated] = b.theta[[study.plant.free[k] for k in stated]]
    return replace(nominal, numbers=numbers), ""


def _fit(
    study: TorqueStudy,
    answer: Answer,
    own: dict[str, Estimate],
    spread: Covariance,
    effects: tuple[EffectEstimate, ...],
    seed: int,
    began: float,
) -> Fit:
    b, fit = study.binding, study.of("fit")
    theta = answer.rows.theta.copy()
    theta[study.plant.free] = np.clip(answer.numbers[: study.plant.size], study.lower, study.upper)
    at = {b.layout.index(name): e for name, e in own.items()}
    notes = [
        *b.dataset.notes,
        (
            "noise of rows:"
            f" {listed(f'{c} {s:.2g} {u}' for (c, u), s in zip(b.chain.torque_channels, study.noise, strict=True))}"
        ),
    ]
    open_ = [name for name, e in own.items() if not e.identifiable]
    if open_:
        notes.append(f"not determined by these data: {', '.join(open_)}")
    return Fit(
        model=b.chain.mechanism.name,
        effects=effects,
        fitter="linear",
        residual="inverse_dynamics",
        loss_name="sum_of_squares",
        seed=seed,
        converged=True,
        failed=False,
        stopped_because="least squares",
        loss=answer.gap(fit) ** 2,
        parameters=own,
        scores=scores(answer),
        windowed={},
        evaluations=1,
        wall_time_s=time.perf_counter() - began,
        compile_time_s=0.0,
        dataset=b.dataset.name,
        dataset_sha256=b.dataset.sha256,
        notes=tuple(notes),
        theta=theta,
        simulation="inverse_dynamics",
        stated=stated_numbers(b, at, spread),
        covariance=spread,
        chain=fitted_chain(b, theta, ()),
        model_sha256=sha256_of(b.chain.mechanism),
    )


def _of_the_gains(study: TorqueStudy, named: Sequence[EffectEstimate]) -> list[str]:
    """What intervals of a load hold of the drive gains."""
    if not any(e.effect == "payload" for e in named):
        return []
    if share := usual_gain_std(study.binding.chain):
        return [
            "the payload's interval counts the drive gains, which make torque of current, as known"
            f" to within {100 * share:g} %"
        ]
    return [
        "the payload's interval takes the recorded torques as exact: a relative error of them is"
        " one of the mass"
    ]


def _notes(study: TorqueStudy, found: Found) -> list[str]:
    run = study.runs[0]
    notes = [
        f"torque and every column low-passed without phase at {run.cutoff_hz:.3g} Hz, positions at"
        f" {MOTION * run.cutoff_hz:.3g} Hz before they are differentiated; each joint weighted by"
        " what is left of it; sets of effects compared on runs that were not fitted"
    ]
    joints = study.binding.chain.signature.joints
    for j, joint in enumerate(joints):
        still = [r.experiment.name for r in study.runs if not r.moves[j]]
        if still:
            where = "every run" if len(still) == len(study.runs) else listed(still[:4])
            notes.append(
                f"{joint} stands still in {where}: its torque there says nothing and is left out"
            )
    return notes
