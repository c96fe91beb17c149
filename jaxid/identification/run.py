"""Inverse-dynamics identification of a serial arm: base parameters, friction, payload; `jaxid
identify`.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.conventions.checking import run_check
from jaxid.data.capacity import need, refuse_too_large
from jaxid.data.dataset import Dataset
from jaxid.data.joint_names import in_chain_order, joint_names, names_of_joints
from jaxid.dynamics.base_parameters import BaseParameters
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.errors import nearest, UsageError
from jaxid.fitters.short_fit import free_motion, left_by_short_fit
from jaxid.identification import estimators as solve, regression
from jaxid.identification.bodies import constrained
from jaxid.identification.commanded import commanded
from jaxid.identification.estimators import LinearEstimate
from jaxid.identification.paper001 import as_printed, by_algorithm, P0, PAPER, unloaded, XI
from jaxid.identification.payload import payload_by_difference, read_reference, usual_gain_std
from jaxid.identification.regression import (
    every_row,
    exponent_slopes,
    FrictionLaw,
    full_rows,
    instruments,
    LAWS,
    names_of,
    power,
    read_run,
    RegressionRun,
    spacing,
    torques,
)
from jaxid.identification.result import Identification, LawTrial, RunScore
from jaxid.identification.stated import answered
from jaxid.identification.trust import NEAR_THE_FILE, nearer_the_file, spread_of
from jaxid.problem.binding import resolve_model
from jaxid.robots.arms import as_arm
from jaxid.robots.floating import refuse_free
from jaxid.robots.origin import origin_on


MOTIONS = ("measured", "commanded", "fourier")
METHODS = ("ls", "wls", "iv", "rls", "tls", "constrained", *PAPER)
#: Variance of a parameter that nothing is known of, in units of the square of what one unit of
#: noise in every row makes of it.
UNKNOWN = 1e10
#: Sampling rate for which paper 001 states its stopping rule.
PAPER_HZ = 125.0
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
    up to `motion_hz`. Raises `UsageError` for a model that is no serial arm and data that lack its
    channels.
    """
    began = time.perf_counter()
    if method not in METHODS:
        raise UsageError(f"there is no method {method!r}{nearest(method, METHODS)}")
    if friction not in (*LAWS, "auto"):
        raise UsageError(
            f"there is no friction law {friction!r}{nearest(friction, (*LAWS, 'auto'))}"
        )
    if motion not in MOTIONS:
        raise UsageError(f"there is no motion {motion!r}{nearest(motion, MOTIONS)}")
    refuse_free("identify", dataset)
    dataset = commanded(dataset) if motion == "commanded" else dataset
    dataset = (
        checked := run_check(model, dataset, (), as_recorded, left_by_short_fit, free_motion)
    ).mended or dataset
    robot = origin_on(model, dataset)
    model, dataset = as_arm(model, dataset)
    held_out = any(e.split != "fit" for e in dataset.experiments)
    fourier = motion == "fourier"
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
    gain_std = usual_gain_std(chain) if gain_std is None else gain_std
    motion_hz = motion_hz or 2 * cutoff_hz
    runs = [read_run(data, e, chain, base, cutoff_hz, motion_hz, fourier) for e in data.experiments]
    by = None
    if method == "iv":
        by = [
            instruments(data, e, chain, base, r)
            for e, r in zip(data.experiments, runs, strict=True)
            if r.split == "fit"
        ]

    before = None if reference is None else read_reference(reference)
    tried = [friction] if friction != "auto" else list(LAWS)
    known = unloaded(before, method, base, chain.nq) if method in PAPER else None
    met: float | None = None
    solved: dict[str, Any]
    trusted: dict[str, Any] = {}
    if (
        known is not None and method == "paper001"
    ):  # the friction law of the unloaded arm, its exponents kept
        tried = [known[0].name]
        theta, P, met = as_printed(runs, *known, base)
        plain = _solve(known[0], runs, None, "wls", chain, base, known[1])
        P = np.pad(P, (0, chain.nq * known[0].nonlinear))  # of the exponents, which are kept
        solved = {
            known[0].name: (
                theta,
                known[1],
                plain[2],
                None,
                replace(plain[4], theta=theta, covariance=P),
            )
        }
    else:
        solved = {name: _solve(LAWS[name], runs, by, method, chain, base) for name in tried}
        if robot and method == "wls" and before is None:
            near = {
                name: _nearer_the_file(LAWS[name], solved[name], runs, chain, base)
                for name in tried
            }
            trusted = {name: found for name, found in near.items() if found is not None}
            solved |= {name: own for name, (own, _) in trusted.items()}
    scores, predicted = _scored(runs, [(LAWS[name], *solved[name][:2]) for name in tried])
    trials = [_trial(LAWS[name], own) for name, own in zip(tried, scores, strict=True)]
    chosen = _choose(trials)
    law = LAWS[tried[chosen]]
    theta, exponent, weights, phi, found = solved[law.name]
    names = names_of(base, law, len(arm.prismatic))
    symbols = {
        f"{k}{j + 1}": float(v)
        for k in ("a", "d", "b")
        for j, v in enumerate(np.asarray(getattr(arm, k)))
    }
    way = f"positions: zero-phase Butterworth of order 4, {motion_hz:g} Hz, central differences"
    if fourier:
        way = f"positions: harmonics of each run up to {motion_hz:g} Hz, differentiated one by one"
    result = Identification(
        model=arm.name,
        method=method,
        law=law.name,
        names=tuple(names),
        expressions=base.expressions(symbols),
        units=tuple(_units(chain, base, law)),
        theta=theta,
        covariance=found.covariance,
        identifiable=found.identifiable[: len(names)],
        base_count=len(base.kept),
        exponents=exponent if law.nonlinear else None,
        condition_number=found.condition,
        condition_number_scaled=found.condition_scaled,
        filter=way
        + f"; torque and columns alike: the same at {cutoff_hz:g} Hz; sign(qd) as tanh(qd / 0.01)",
        weights=np.mean(weights, 0),
        experiments=tuple(scores[chosen]),
        laws=tuple(LawTrial(t.law, t.fit, t.held_out, t.law == law.name) for t in trials),
        standard=(
            None if phi is None else dict(zip(base.standard, phi.ravel().tolist(), strict=True))
        ),
        dataset=dataset.name,
        dataset_sha256=dataset.sha256,
        notes=(
            *data.notes,
            *_notes(found, names, method, law),
            *(
                ["a part of a period has no Fourier series: no run was cut for validation"]
                if fourier and not held_out
                else ()
            ),
            *regression.held_joints(runs),
            *([NEAR_THE_FILE.format(trusted[law.name][1])] if law.name in trusted else ()),
        ),
        wall_time_s=time.perf_counter() - began,
        labels=names_of_joints(arm, data, len(arm.prismatic)),
        traces=tuple(
            (r.name, r.split, r.t, r.tau, own[chosen])
            for r, own in zip(runs, predicted, strict=True)
        ),
        data=checked.findings,
        robot=robot,
    )
    result = replace(result, **answered(arm, data.model, base, law, runs, result))
    if before is None:
        return result
    payload = payload_by_difference(result, before, base, np.asarray(arm.prismatic), gain_std)
    if method == "rls":
        after = converged_after(runs, law, exponent, result, before, base, weights)
        payload = replace(payload, converged_after_s=after)
    elif method == "paper001":
        payload = replace(payload, converged_after_s=met)
    elif known is not None:
        spread = np.array(before["covariance"], float)[: len(known[2]), : len(known[2])]
        payload = by_algorithm(method, runs, arm, *known, spread, gain_std)
    return Identification(**{**result.__dict__, "payload": payload})


def _stated(chain: Chain, dataset: Dataset) -> Chain:
    """The chain with the constants and start values that the dataset states."""
    layout = ParameterVector(chain)
    theta, spec = layout.values.copy(), dataset.model
    known = dict(spec.constants) if spec is not None else {}
    known |= {
        k: p.value
        for k, p in (spec.parameters if spec is not None else {}).items()
        if p.value is not None
    }
    for name, value in known.items():
        if name != "smoothing_velocity":
            theta[layout.index(name)] = value
    return layout.model(theta)


def _solve(
    law: FrictionLaw,
    runs: Sequence[RegressionRun],
    by: Sequence[RegressionRun] | None,
    method: str,
    chain: Chain,
    base: BaseParameters,
    kept: np.ndarray | None = None,
    trust: float | None = None,
):
    """(theta, exponents, weights per run, standard parameters or None, covariance and condition) of
    one law; `kept` exponents are not searched. `trust`: to within how many times their size the
    model's own numbers are known (see `spread_of`).
    """
    arm: Any = chain.mechanism
    n = len(arm.prismatic)
    fit = [r for r in runs if r.split == "fit"]
    exponent = np.ones(n) if kept is None else kept
    phi0 = np.array(
        [
            float(np.asarray(getattr(arm, name.rstrip("0123456789")))[int(name[-1]) - 1])
            for name in base.standard
        ]
    )
    prior = np.concatenate([base.values(phi0), np.zeros(len(law.parameters) * n)])
    spread = None if trust is None else trust * spread_of(base, prior, law, fit)

    def blocks_of(
        which: Sequence[RegressionRun], exponent: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        return [
            (full_rows(r, law, exponent) * r.moves[:, None], r.tau[:: spacing(r)] * r.moves)
            for r in which
        ]

    blocks = blocks_of(fit, exponent)
    theta, weights = solve.weighted(blocks, prior, spread=spread)
    if law.nonlinear and kept is None:
        for _ in range(3):
            old, exponent = (
                exponent,
                _exponents(
                    fit=fit,
                    law=law,
                    blocks=blocks,
                    weights=weights,
                    p=len(base.kept),
                    n=n,
                    start=exponent,
                    positive=method == "constrained",
                ),
            )
            blocks = blocks_of(fit, exponent)
            theta, weights = solve.weighted(blocks, prior, spread=spread)
            if np.abs(exponent - old).max() < 1e-3:
                break
    if method == "ls":
        weights = [np.ones(n) for _ in fit]
        theta = solve.least_squares(*solve.Triangles.made(blocks).stacked(weights), prior)
    phi, instrument = None, None
    if method == "tls":
        theta = solve.total(
            *solve.stacked(blocks, weights), _column_noise(fit, weights, len(prior)), prior
        )
    elif method == "rls":
        theta = recursive(fit, law, exponent, weights, prior)
    elif method == "iv" and by is not None:
        instrument = blocks_of(by, exponent)
        theta = solve.instrumental(
            *solve.stacked(blocks, weights), solve.stacked(instrument, weights)[0], prior
        )
    elif method == "constrained":
        levels = np.array([p in ("F_c", "F_v") for p, _ in law.parameters for _ in range(n)])
        theta, phi = constrained(
            *solve.stacked(blocks, weights), base, phi0.reshape(n, 11), levels, arm.motor_side
        )
    slopes = None
    if law.nonlinear and kept is None:
        slopes = [exponent_slopes(r, law, theta, exponent) for r in fit]
    return (
        theta,
        exponent,
        weights,
        phi,
        solve.estimate(blocks, weights, theta, instrument, slopes, spread),
    )


def _nearer_the_file(
    law: FrictionLaw, free: Any, runs: Sequence[RegressionRun], chain: Chain, base: BaseParameters
) -> Any:
    by = [r for r in runs if r.split == "validation"]

    def error(s):
        return np.array([_errors(r.tau, next(iter(torques(r, [(law, *s[:2])])))[0])[0] for r in by])

    return nearer_the_file(
        lambda t: _solve(law, runs, None, "wls", chain, base, trust=t), error, free, BETTER
    )


def recursive(
    fit: Sequence[RegressionRun],
    law: FrictionLaw,
    exponent: np.ndarray,
    weights: Sequence[np.ndarray],
    prior: np.ndarray,
) -> np.ndarray:
    """Weighted least squares sample by sample: the recursion over all rows of the fit runs, one run
    after the other, from the model's own values, of which next to nothing is trusted.
    """
    from jaxid.fitting.recursive_least_squares import replay_stretches

    size = np.zeros(len(prior))
    for r, w in zip(fit, weights, strict=True):
        for _, W, _ in every_row(r, law, exponent):
            size = np.hypot(size, np.linalg.norm((W * w[:, None]).reshape(-1, len(prior)), axis=0))
    seen = size > solve.SEEN * size.max()
    scale = np.where(
        seen, size, np.inf
    )  # a column that shows nothing leaves its parameter where it is

    def stretches() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for r, w in zip(fit, weights, strict=True):
            for at, W, _ in every_row(r, law, exponent):
                Y = W * w[:, None]
                yield Y / scale, r.tau[at] * w - Y @ prior

    found = replay_stretches(stretches(), np.zeros_like(prior), noise_var=1.0, prior_var=UNKNOWN)[0]
    return prior + found / scale


def converged_after(
    runs: Sequence[RegressionRun],
    law: FrictionLaw,
    exponent: np.ndarray,
    loaded: Identification,
    before: Mapping[str, Any],
    base: BaseParameters,
    weights: Sequence[np.ndarray],
) -> float | None:
    """Seconds of the first fit run after which the paper's stopping rule holds for the last link's
    parameters, from the unloaded arm's parameters with the paper's P0 = 10; None: never within the
    run.
    """
    from jaxid.fitting.recursive_least_squares import replay_stretches, Rule
    from jaxid.identification.online import watched_of

    first = next(r for r in runs if r.split == "fit")
    friction = {
        f"{k}{entry['joint'][1:]}": v["value"]
        for entry in before["friction"]
        for k, v in entry.items()
        if k != "joint"
    }
    known = {e["name"]: e["value"] for e in before["base_parameters"]} | friction
    prior = np.array(
        [known.get(name, value) for name, value in zip(loaded.names, loaded.theta, strict=True)],
        float,
    )
    step = float(np.median(np.diff(first.t)))
    # Rows between those that say something new hold the same noise: each counts with that much more
    # variance.
    noise = np.asarray(weights[0]) ** -2.0 * spacing(first)
    rule = Rule(samples=round(Rule().samples / PAPER_HZ / step))
    _, _, met = replay_stretches(
        ((W, first.tau[at]) for at, W, _ in every_row(first, law, exponent)),
        prior,
        noise_var=noise,
        prior_var=10.0,
        watched=watched_of(base, loaded.joints),
        rule=rule,
    )
    return None if met is None else met * step


def _exponents(
    fit: Sequence[RegressionRun],
    law: FrictionLaw,
    blocks,
    weights,
    p: int,
    n: int,
    start: np.ndarray,
    positive: bool,
) -> np.ndarray:
    """Exponents at these weights; `positive` keeps F_c and F_v from being negative."""
    dry, viscous = np.arange(p, p + n), np.arange(p + n, p + 2 * n)
    D = solve.stacked(blocks, weights, dry)[0] if positive else None

    def columns(exponent: np.ndarray) -> np.ndarray:
        parts = []
        for r, w in zip(fit, weights, strict=True):
            F = r.solved(lambda at, qd=r.qd: power(qd[at], exponent))
            parts.append((F[:, :, None] * np.eye(n) * w[:, None]).reshape(-1, n))
        V = np.concatenate(parts)
        return V if D is None else np.concatenate([D, V], 1)

    moving = np.concatenate([dry, viscous]) if positive else viscous
    others = np.setdiff1d(np.arange(blocks[0][0].shape[2]), moving)
    return solve.project_exponents(
        *solve.stacked(blocks, weights, others), columns, start, positive
    )


def _column_noise(
    fit: Sequence[RegressionRun], weights: Sequence[np.ndarray], size: int
) -> np.ndarray:
    """One standard deviation of each column's error and of the torque's: what lies above the
    cutoff, as if it were white. Friction columns count as exact: what they hold above the cutoff
    are reversals.
    """
    p = fit[0].Y.shape[2]
    square, count = np.zeros(size + 1), 0
    for r, w in zip(fit, weights, strict=True):
        for _, Y, Y_raw in r.stretches(r.inertia):
            square[:p] += np.sum(((Y_raw - Y) * w[:, None]) ** 2, (0, 1))
        square[-1] += np.sum(((r.tau_raw - r.tau) * w) ** 2)
        count += r.tau.size
    return np.sqrt(square / count)


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
            filtered, unfiltered = _errors(run.tau, smooth), _errors(run.tau_raw, raw)
            own.append(RunScore(run.name, run.split, *filtered, unfiltered[0], unfiltered[2]))
            drawn.append(smooth.astype(np.float32))  # for pictures
        predicted.append(drawn)
    return scores, predicted


def _errors(
    tau: np.ndarray, modelled: np.ndarray
) -> tuple[float, tuple[float, ...], tuple[float, ...]]:
    e = tau - modelled
    each = np.linalg.norm(e, axis=0) / np.maximum(np.linalg.norm(tau, axis=0), 1e-300)
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


def _units(chain: Chain, base: BaseParameters, law: FrictionLaw) -> Iterable[str]:
    arm: Any = chain.mechanism
    for name in base.names:
        kind, j = name.rstrip("0123456789"), int(name[len(name.rstrip("0123456789")) :]) - 1
        slides = kind == "Ia" and arm.prismatic[j]
        yield "kg" if kind == "m" or slides else "kg m" if kind in ("mx", "my", "mz") else "kg m^2"
    for _, unit in law.parameters:
        for j in range(len(arm.prismatic)):
            yield chain.signature.unit(unit, j)


def _notes(found: LinearEstimate, names: Sequence[str], method: str, law: FrictionLaw) -> list[str]:
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
