"""Inverse-dynamics identification of a serial arm: base parameters, friction, payload; `jaxid
identify`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.deadline import answered_in_time, search_is_over
from jaxid.base.errors import nearest, UsageError
from jaxid.base.progress import Callback, tell, telling
from jaxid.base.wording import stem_and_number
from jaxid.conventions.checking import run_check
from jaxid.data.capacity import need, refuse_too_large
from jaxid.data.dataset import Dataset
from jaxid.data.joint_names import in_chain_order, joint_names, names_of_joints
from jaxid.dynamics.base_parameters import BaseParameters
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.fitters.short_fit import free_motion, left_by_short_fit
from jaxid.force.covariance import RowCovariance
from jaxid.identification import regression
from jaxid.identification.commanded import commanded
from jaxid.identification.paper001 import as_printed, by_algorithm, P0, PAPER, unloaded, XI
from jaxid.identification.payload import (
    payload_by_difference,
    PayloadEstimate,
    read_reference,
    usual_gain_std,
)
from jaxid.identification.recursive import converged_after
from jaxid.identification.regression import (
    FrictionLaw,
    instruments,
    LAWS,
    names_of,
    read_run,
    RegressionRun,
    torques,
)
from jaxid.identification.result import Identification, LawTrial, RunScore
from jaxid.identification.solving import fit_law, law_problem, LawFit
from jaxid.identification.stated import answered, values_of
from jaxid.identification.trust import NEAR_THE_FILE, nearer_the_file
from jaxid.problem.binding import resolve_model
from jaxid.robots.arms import as_arm
from jaxid.robots.floating import refuse_free
from jaxid.robots.origin import origin_on


MOTIONS = ("measured", "commanded", "fourier")
METHODS = ("ls", "wls", "iv", "rls", "tls", "constrained", *PAPER)
#: A richer friction law is taken only if it is better by this share on every held-out run.
BETTER = 0.01


def identify(
    model: object,
    dataset: Dataset,
    *,
    method: str = "wls",
    friction: str = "auto",
    cutoff_hz: float = 5.0,
    motion_hz: float | None = None,
    reference: Identification | Mapping[str, Any] | str | Path | None = None,
    gain_std: float | None = None,
    as_recorded: bool = False,
    motion: str = "measured",
    seconds: float | None = None,
    progress: Callback | None = None,
) -> Identification:
    """Base parameters and friction of a serial arm from recorded motion and torque.

    `method` is ls, wls, iv, rls (wls sample by sample; with a reference it also says after which
    time the payload has converged), tls, constrained, or one of paper 001's: paper001 (its
    recursion as printed), algorithm1, algorithm2, which find the payload of a `reference` (see
    `jaxid.identification.paper001`); `friction` linear, power, stribeck, or auto: the simplest that
    no richer law beats on every held-out run. Torque and columns are low-passed at `cutoff_hz`,
    positions at `motion_hz` (twice that) before they are differentiated. `reference`, the
    identification of the unloaded arm (or its JSON), gives the payload; `gain_std` is the relative
    standard deviation of the drive gains, which moves payload and torque alike (None: 0.05 where
    torques are made of currents, else 0). Decisive findings of `jaxid.check` are applied unless
    `as_recorded`. `motion` is measured, commanded (channels `q1_cmd` …), or fourier: the measured
    one as the Fourier series of runs that hold whole periods, whose derivatives keep every harmonic
    up to `motion_hz`. After `seconds` no further friction law is tried: the answer is the best of
    those that were, with `complete` false. Raises `UsageError` for a model that is no serial arm,
    data that lack its channels, and where nothing is known after `seconds`.
    """

    def answer() -> Identification:
        return _identification(
            model=model,
            dataset=dataset,
            method=method,
            friction=friction,
            cutoff_hz=cutoff_hz,
            motion_hz=motion_hz or 2 * cutoff_hz,
            reference=reference,
            gain_std=gain_std,
            as_recorded=as_recorded,
            motion=motion,
        )

    with telling(progress):
        return answered_in_time(seconds, answer)


def _identification(
    *,
    model: object,
    dataset: Dataset,
    method: str,
    friction: str,
    cutoff_hz: float,
    motion_hz: float,
    reference: Identification | Mapping[str, Any] | str | Path | None,
    gain_std: float | None,
    as_recorded: bool,
    motion: str,
) -> Identification:
    """The whole of `identify`, however long it takes; a deadline leaves out friction laws."""
    began = time.perf_counter()
    for kind, value, choices in (
        ("method", method, METHODS),
        ("friction law", friction, (*LAWS, "auto")),
        ("motion", motion, MOTIONS),
    ):
        if value not in choices:
            raise UsageError(f"there is no {kind} {value!r}{nearest(value, choices)}")
    refuse_free("identify", dataset)
    if motion == "commanded":
        dataset = commanded(dataset)
    checked = run_check(model, dataset, (), as_recorded, left_by_short_fit, free_motion)
    dataset = checked.mended or dataset
    robot = origin_on(model, dataset)
    recorded = _recorded(model, dataset, cutoff_hz, motion_hz, motion == "fourier")
    chain, base, runs, arm = recorded.chain, recorded.base, recorded.runs, recorded.arm
    n = chain.nq
    gain_std = usual_gain_std(chain) if gain_std is None else gain_std
    before = None if reference is None else read_reference(reference)
    known = unloaded(before, method, base, n) if method in PAPER else None
    fits, near, met = _fits(recorded, method, friction, known, bool(robot) and before is None)
    tried = list(fits)
    tell("how far", 0, 1, "every run by every law")
    scores, predicted = _scored(runs, [(LAWS[k], f.theta, f.exponent) for k, f in fits.items()])
    trials = [_trial(LAWS[name], own) for name, own in zip(tried, scores, strict=True)]
    chosen = _choose(trials)
    law, fit = LAWS[tried[chosen]], fits[tried[chosen]]
    names = names_of(base, law, n)
    found = fit.covariance
    result = Identification(
        model=arm.name,
        method=method,
        law=law.name,
        names=tuple(names),
        expressions=base.expressions(_lengths(arm)),
        units=tuple(_units(chain, base, law)),
        theta=fit.theta,
        covariance=found.matrix,
        identifiable=found.identifiable[: len(names)],
        base_count=len(base.kept),
        exponents=fit.exponent if law.nonlinear else None,
        condition_number=found.condition,
        condition_number_scaled=found.condition_scaled,
        filter=_filter_told(motion, motion_hz, cutoff_hz),
        weights=np.mean(fit.weights, 0),
        experiments=tuple(scores[chosen]),
        laws=tuple(LawTrial(t.law, t.fit, t.held_out, t.law == law.name) for t in trials),
        standard=_by_name(base.standard, fit.bodies),
        dataset=dataset.name,
        dataset_sha256=dataset.sha256,
        notes=(
            *recorded.data.notes,
            *_notes(found, names, method, law),
            *_of_splits(recorded, motion),
            *regression.held_joints(runs),
            *_of_trust(near.get(law.name)),
        ),
        wall_time_s=time.perf_counter() - began,
        labels=names_of_joints(arm, recorded.data, n),
        traces=tuple(
            (r.name, r.split, r.t, r.tau, own[chosen])
            for r, own in zip(runs, predicted, strict=True)
        ),
        data=checked.findings,
        robot=robot,
    )
    result = replace(result, **answered(arm, recorded.data.stated, base, law, runs, result))
    if before is None:
        return result
    payload = _payload(
        recorded=recorded,
        method=method,
        law=law,
        fit=fit,
        result=result,
        before=before,
        known=known,
        gain_std=gain_std,
        met=met,
    )
    return replace(result, payload=payload)


@dataclass(frozen=True)
class RecordedArm:
    """A serial arm with its recordings as rows of the torque equation; of the fit runs those along
    the commanded motion too, where these are asked for. `held_out`: whether some recording is kept
    from the fit as it was given.
    """

    data: Dataset
    held_out: bool
    chain: Chain
    base: BaseParameters
    runs: Sequence[RegressionRun]
    instruments: Callable[[], list[RegressionRun]]

    @property
    def arm(self) -> Any:
        return self.chain.mechanism


def _recorded(
    model: object, dataset: Dataset, cutoff_hz: float, motion_hz: float, fourier: bool
) -> RecordedArm:
    """Raises `UsageError` for a model that is no serial arm."""
    model, dataset = as_arm(model, dataset)
    held_out = any(e.split != "fit" for e in dataset.experiments)
    data = dataset if held_out or fourier else dataset.with_splits()
    chain = _stated(resolve_model(model, data), data)
    arm: Any = chain.mechanism
    data = in_chain_order(data, joint_names(arm))
    if not hasattr(arm, "base"):
        raise UsageError(
            f"identify needs a serial arm (ur10, ur10e, panda, serial_arm); {arm.name} is none. Use"
            " jaxid fit"
        )
    refuse_too_large(need("identify", data, chain.nq))
    base = arm.base()
    runs = [read_run(data, e, chain, base, cutoff_hz, motion_hz, fourier) for e in data.experiments]

    def along_commands() -> list[RegressionRun]:
        pairs = zip(data.experiments, runs, strict=True)
        return [instruments(data, e, chain, base, r) for e, r in pairs if r.split == "fit"]

    return RecordedArm(data, held_out, chain, base, runs, along_commands)


def _fits(
    recorded: RecordedArm,
    method: str,
    friction: str,
    known: tuple[FrictionLaw, np.ndarray, np.ndarray] | None,
    of_a_file: bool,
) -> tuple[dict[str, LawFit], dict[str, float], float | None]:
    """The laws that are tried, by name; how near the file those stay that do (`of_a_file`); and the
    seconds after which paper 001's recursion has converged. `known`: law, exponents and numbers of
    the unloaded arm.
    """
    chain, base, runs = recorded.chain, recorded.base, recorded.runs
    if known is not None and method == "paper001":
        # The friction law of the unloaded arm, its exponents kept.
        law, exponent, _ = known
        theta, P, met = as_printed(runs, *known, base)
        plain = fit_law(law_problem(law, runs, chain, base), "wls", kept=exponent)
        P = np.pad(P, (0, chain.nq * law.nonlinear))
        covariance = replace(plain.covariance, matrix=P)
        return {law.name: replace(plain, theta=theta, covariance=covariance)}, {}, met
    by = recorded.instruments() if method == "iv" else None
    tried = list(LAWS) if friction == "auto" else [friction]
    fits: dict[str, LawFit] = {}
    for number, name in enumerate(tried):
        if fits and search_is_over():
            break
        tell("friction law", number, len(tried) + 1, name)
        fits[name] = fit_law(law_problem(LAWS[name], runs, chain, base), method, by)
    near: dict[str, float] = {}
    if of_a_file and method == "wls":
        for name, free in fits.items():
            if search_is_over():
                break
            if (found := _nearer_the_file(LAWS[name], free, recorded)) is not None:
                fits[name], near[name] = found
    return fits, near, None


def _nearer_the_file(
    law: FrictionLaw, free: LawFit, recorded: RecordedArm
) -> tuple[LawFit, float] | None:
    by = [r for r in recorded.runs if r.split == "validation"]

    def error(fit: LawFit) -> np.ndarray:
        found = []
        for r in by:
            smooth, _ = next(iter(torques(r, [(law, fit.theta, fit.exponent)])))
            found.append(_errors(r.tau, smooth, r.moves)[0])
        return np.array(found)

    def solved(trust: float) -> LawFit:
        problem = law_problem(law, recorded.runs, recorded.chain, recorded.base, trust)
        return fit_law(problem, "wls")

    return nearer_the_file(solved, error, free, BETTER)


def _payload(
    recorded: RecordedArm,
    method: str,
    law: FrictionLaw,
    fit: LawFit,
    result: Identification,
    before: Mapping[str, Any],
    known: tuple[FrictionLaw, np.ndarray, np.ndarray] | None,
    gain_std: float,
    met: float | None,
) -> PayloadEstimate:
    """The load by the difference to the unloaded arm, or by one of the paper's algorithms."""
    base, arm, runs = recorded.base, recorded.arm, recorded.runs
    payload = payload_by_difference(result, before, base, np.asarray(arm.prismatic), gain_std)
    if method == "rls":
        after = converged_after(runs, law, fit.exponent, result, before, base, fit.weights)
        return replace(payload, converged_after_s=after)
    if method == "paper001":
        return replace(payload, converged_after_s=met)
    if known is not None:
        spread = np.array(before["covariance"], float)[: len(known[2]), : len(known[2])]
        return by_algorithm(method, runs, arm, *known, spread, gain_std)
    return payload


def _by_name(names: Sequence[str], numbers: np.ndarray | None) -> dict[str, float] | None:
    return None if numbers is None else dict(zip(names, numbers.ravel().tolist(), strict=True))


def _lengths(arm: Any) -> dict[str, float]:
    """Lengths of the arm's geometry by name, m."""
    out = {}
    for kind in ("a", "d", "b"):
        for joint, value in enumerate(np.asarray(getattr(arm, kind))):
            out[f"{kind}{joint + 1}"] = float(value)
    return out


def _filter_told(motion: str, motion_hz: float, cutoff_hz: float) -> str:
    way = f"positions: zero-phase Butterworth of order 4, {motion_hz:g} Hz, central differences"
    if motion == "fourier":
        way = f"positions: harmonics of each run up to {motion_hz:g} Hz, differentiated one by one"
    low_pass = f"torque and columns alike: the same at {cutoff_hz:g} Hz"
    return f"{way}; {low_pass}; sign(qd) as tanh(qd / 0.01)"


def _of_trust(near: float | None) -> list[str]:
    return [] if near is None else [NEAR_THE_FILE.format(near)]


def _of_splits(recorded: RecordedArm, motion: str) -> list[str]:
    if recorded.held_out or motion != "fourier":
        return []
    return ["a part of a period has no Fourier series: no run was cut for validation"]


def _stated(chain: Chain, dataset: Dataset) -> Chain:
    """The chain with the constants and start values that the dataset states."""
    layout = ParameterVector(chain)
    theta = layout.values.copy()
    for name, value in values_of(dataset.stated).items():
        if name != "smoothing_velocity":
            theta[layout.index(name)] = value
    return layout.model(theta)


def _scored(
    runs: Sequence[RegressionRun], laws: Sequence[tuple[FrictionLaw, np.ndarray, np.ndarray]]
) -> tuple[list[list[RunScore]], list]:
    """Scores of each law on each run, and of each run the filtered torque of each law [samples
    n].
    """
    scores: list[list[RunScore]] = [[] for _ in laws]
    predicted = []
    for run in runs:
        drawn = []
        for own, (smooth, raw) in zip(scores, torques(run, laws), strict=True):
            filtered = _errors(run.tau, smooth, run.moves)
            unfiltered = _errors(run.tau_raw, raw, run.moves)
            own.append(RunScore(run.name, run.split, *filtered, unfiltered[0], unfiltered[2]))
            drawn.append(smooth.astype(np.float32))  # for pictures
        predicted.append(drawn)
    return scores, predicted


def _errors(
    tau: np.ndarray, modelled: np.ndarray, moves: np.ndarray
) -> tuple[float, tuple[float, ...], tuple[float, ...]]:
    """Relative error of all joints, of each (NaN where it stands still: dry friction holds any
    torque there), and root mean square of each.
    """
    e = tau - modelled
    each = np.linalg.norm(e, axis=0) / np.maximum(np.linalg.norm(tau, axis=0), 1e-300)
    each = np.where(moves > 0, each, np.nan)
    return (
        float(np.linalg.norm(e) / np.linalg.norm(tau)),
        tuple(each.tolist()),
        tuple(np.sqrt(np.mean(e**2, 0)).tolist()),
    )


def _trial(law: FrictionLaw, scores: Sequence[RunScore]) -> LawTrial:
    fit = [s.relative_error for s in scores if s.split == "fit"]
    return LawTrial(
        law.name,
        float(np.mean(fit)),
        tuple(s.relative_error for s in scores if s.split != "fit"),
        False,
    )


def _choose(trials: Sequence[LawTrial]) -> int:
    """The simplest law, or a richer one that is better on every held-out run."""
    best = 0
    for k in range(1, len(trials)):
        pairs = zip(trials[k].held_out, trials[best].held_out, strict=True)
        if trials[k].held_out and all(new < (1 - BETTER) * old for new, old in pairs):
            best = k
    return best


#: Units of standard parameters that are no moments of inertia.
UNITS = {"m": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m"}


def _units(chain: Chain, base: BaseParameters, law: FrictionLaw) -> Iterable[str]:
    arm: Any = chain.mechanism
    for name in base.names:
        kind, joint = stem_and_number(name)
        slides = kind == "Ia" and arm.prismatic[int(joint) - 1]
        yield "kg" if slides else UNITS.get(kind, "kg m^2")
    for _, unit in law.parameters:
        for j in range(len(arm.prismatic)):
            yield chain.signature.unit(unit, j)


def _notes(found: RowCovariance, names: Sequence[str], method: str, law: FrictionLaw) -> list[str]:
    if method == "paper001":
        return [
            "the recursion of paper 001 as printed, over the recorded rows: standard deviations"
            f" are those of its P, which takes xi = {XI:g} for the torque's noise and P0 = {P0:g}"
            " for what the load may change; exponents are the reference's"
        ]
    how = "white" if found.white else f"coloured (memory {found.memory} rows)"
    notes = [
        f"residuals are {how}: standard deviations from the sandwich covariance of the estimator"
    ]
    lost = [n for n, seen in zip(names, found.identifiable, strict=False) if not seen]
    if lost:
        rest = "those combinations of them that the data leave open are as the model has them"
        notes.append(f"not determined one by one by these data: {', '.join(lost)}; {rest}")
    if law.nonlinear:
        notes.append("exponents by variable projection")
    if method == "constrained":
        notes.append(
            "inertial parameters of bodies that can exist; standard deviations are those without"
            " that constraint"
        )
    return notes
