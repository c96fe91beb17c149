"""A diagnosis by torque from beginning to end."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxid.base.wording import listed
from jaxid.diagnosis.next_experiment import advice
from jaxid.diagnosis.result import Diagnosis, Which
from jaxid.diagnosis.torque.answer import (
    Answer,
    estimates,
    how_far,
    places,
    ranking,
    scores,
    traces,
)
from jaxid.diagnosis.torque.ceiling import ceiling
from jaxid.diagnosis.torque.claims import believed, instead
from jaxid.diagnosis.torque.found import difference, differs, Found, searched
from jaxid.diagnosis.torque.judge import astray, judged_by_torque
from jaxid.diagnosis.torque.reference import ReferenceNumbers
from jaxid.diagnosis.torque.rows import MOTION
from jaxid.diagnosis.torque.study import TorqueStudy
from jaxid.diagnosis.torque.worth import worth, worth_sentences
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.model_file import sha256_of
from jaxid.fitting.assemble import fitted_chain
from jaxid.fitting.fitter import Progress
from jaxid.fitting.result import Covariance, EffectEstimate, Estimate, Fit
from jaxid.fitting.stated import stated_or_of_the_file
from jaxid.identification.payload import usual_gain_std
from jaxid.problem.binding import Binding
from jaxid.problem.trust import sentence, told, trusting
from jaxid.robots.yardstick import states


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
    if given is None:
        binding = trusting(binding)
    study = TorqueStudy(binding, kinds, cutoff_hz, given, given is not None)
    say("torque", 1, 4, f"{sum(r.rows(r.q[:, :1]).shape[0] for r in study.runs)} rows, effects")
    found = searched(study, max_effects)
    say("torque", 2, 4, f"{len(found.chooser.tried)} sets of effects compared")
    if given is None and differs(found):
        found = difference(study, found, max_effects) or found
    return _answered(study, found, max_effects, seed, began)


# ---- the answer


def _answered(study: TorqueStudy, found: Found, most: int, seed: int, began: float) -> Diagnosis:
    b = study.binding
    judged = judged_by_torque(study, found)
    verdict = judged.name
    plain, _, plain_spread = estimates(study, found.chooser, found.chooser.nominal)
    nominal_fit = final_fit = _fit(study, found.nominal, plain, plain_spread, (), seed, began)
    final, claims, named, mates, each = found.nominal, (), (), [], {}
    if judged.claims:
        final, claims = found.final, found.claims
        own, named, spread = estimates(study, found.chooser, found.chosen)
        if found.base is not None:  # beside what all runs have
            named = (*estimates(study, found.base.chooser, found.base.chosen)[1], *named)
        mates = instead(found.weighed, claims)
        each = worth(study, found.rows, found.chooser, found.chosen, found.held_out)
        final_fit = _fit(study, final, own, spread, named, seed, began)
    before, note = _before(study, found)
    far = how_far(
        study=study,
        before=before,
        retuned=found.nominal,
        after=final,
        which=found.held_out,
        split="report" if found.judge else "validation",
        verdict=verdict,
        note=note,
        ceiling=_ceiling(study, found) if verdict in ("unknown", "partly") else None,
    )
    looked, ranks = study.of("fit"), found.choose or found.fit
    if found.different:
        looked, ranks = [*found.choose, *found.judge], found.judge
    findings, pictures, regimes = places(study, found.nominal, final, verdict, looked, seed)
    if astray(study, final):
        # What it leaves says where its numbers are wrong, not where the machine is.
        findings = ()
    label = f"with {' and '.join(map(str, named))}" if named else ""
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
            ranking(study, found.chooser, found.rows, ranks),
            " ".join([judged.text, *worth_sentences(each)]),
            belief=believed(found.weighed, claims, each),
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
        trust=told(b),
        accuracy=b.dataset.accuracy,
    )


def _ceiling(study: TorqueStudy, found: Found) -> float:
    """The share of the gap that free laws close."""
    fit = [*found.fit, *found.choose] if found.different else found.fit
    return ceiling(
        study=study,
        rows=found.rows,
        weights=found.weights,
        base=found.nominal,
        fit=fit,
        choose=found.choose or found.fit,
        judge=found.held_out,
    )


def _before(study: TorqueStudy, found: Found) -> tuple[Answer, str]:
    """The model with the bodies of a reference, or with the values that the dataset or a robot's
    file states; what neither states is re-tuned.
    """
    if found.as_before is not None:
        return found.as_before, "The gap before is that of the reference's bodies."
    b, nominal = study.binding, found.nominal
    stated = [k for k, i in enumerate(study.plant.free) if states(b, i)]
    if not stated:
        note = "Nothing states parameter values, so the gap before is that of the re-tuned model."
        return nominal, note
    numbers = nominal.numbers.copy()
    numbers[stated] = b.theta[np.array(study.plant.free)[stated]]
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
    noise = []
    for (channel, unit), size in zip(b.chain.torque_channels, study.noise, strict=True):
        noise.append(f"{channel} {size:.2g} {unit}")
    notes = [*b.dataset.notes, f"noise of rows: {listed(noise)}"]
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
        stated=stated_or_of_the_file(b, at, spread),
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
    notes += filter(None, [sentence(study.binding)])
    joints = study.binding.chain.signature.joints
    for j, joint in enumerate(joints):
        still = [r.experiment.name for r in study.runs if not r.moves[j]]
        if still:
            where = "every run" if len(still) == len(study.runs) else listed(still[:4])
            notes.append(
                f"{joint} stands still in {where}: its torque there says nothing and is left out"
            )
    return notes
