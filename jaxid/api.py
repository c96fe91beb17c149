"""`jaxid.fit`, `jaxid.diagnose`, `jaxid.compare`, `jaxid.simulate`, `jaxid.replay`: the verbs."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

from jaxid.base.deadline import answered_in_time, share_of_time
from jaxid.base.errors import nearest, UsageError
from jaxid.base.extras import required
from jaxid.base.serialise import with_effects
from jaxid.base.stopping import Interrupted
from jaxid.conventions.finding import Checked
from jaxid.data.capacity import refuse_too_large
from jaxid.data.dataset import Dataset
from jaxid.diagnosis.result import Diagnosis
from jaxid.dynamics import catalogue
from jaxid.dynamics.effect import Effect
from jaxid.fitting.comparison import Comparison
from jaxid.fitting.fitter import AbstractFitter, Progress
from jaxid.fitting.limbs import each
from jaxid.fitting.result import Fit
from jaxid.fitting.simulation import Simulation
from jaxid.problem.accuracy import with_accuracy
from jaxid.problem.added_effects import parse_effect
from jaxid.problem.binding import bind, Binding, foreseen, resolve_model
from jaxid.problem.problem import LOSSES
from jaxid.problem.residual import Residual, resolve_residual
from jaxid.problem.solver import with_solver
from jaxid.robots.floating import refuse_free
from jaxid.robots.limbs import effects_at, limbs_of


if TYPE_CHECKING:
    from jaxid.fitting.nuts import Sampling
    from jaxid.fitting.replay import Replay


def fit(
    model: object,
    dataset: Dataset,
    *,
    fitter: AbstractFitter | str | None = None,
    residual: Residual | str | None = None,
    loss: str | None = None,
    effects: Iterable[str | Effect | type[Effect]] = (),
    without: Iterable[str] = (),
    seed: int = 0,
    budget: int | None = None,
    solver: Any = None,
    progress: Progress | None = None,
    as_recorded: bool = False,
    cutoff_hz: float | None = None,
    window: int | None = None,
    forgetting: float | None = None,
    block_s: float | None = None,
    posterior: Sampling | bool = False,
) -> Fit:
    """Fits the parameters of a model to a dataset.

    `model` is an id, a mechanism, a chain, or None for the one that the dataset names; `effects`
    (`dead_zone@tau`, or one of your own) are added and fitted, `without` takes built-in ones out.
    The recording is checked first, and decisive findings are applied (`data`, `jaxid.check`) unless
    `as_recorded`. `fitter` is one or its text, `de(popsize=20)`; `solver` (a solver of diffrax, or
    `Diffrax`) simulates in place of jaxid's own stepping. Raises `UsageError` for arguments that do
    not fit (`cutoff_hz` is the low-pass of `inverse_dynamics`); a fit that fails is a `Fit` with
    `failed` set and a sentence in `stopped_because`. More rows than there is memory for are refused
    before anything is computed.

    With a `window` (blocks) or `forgetting` (0 to 1, 1 forgets nothing) the fit goes along the fit
    runs block by block, of `block_s` seconds or as `recursion.in_blocks` cuts them, each at the
    same cost: see `jaxid.fitting.recursion`. With `posterior`, true or a `Sampling`, chains are
    drawn about the fit: see `jaxid.fitting.posterior`.
    """
    from jaxid.fitting.recursion import in_blocks, RecursionSettings

    began = time.perf_counter()
    along = None
    if window is not None or forgetting is not None or block_s is not None:
        if window is None and forgetting is None:
            raise UsageError("blocks belong to a window or to forgetting: give one of them")
        along = RecursionSettings(window, 1.0 if forgetting is None else forgetting, block_s)
    if posterior:
        required("blackjax")
        required("arviz")
    if len(limbs := limbs_of(model, dataset)) > 1:
        if posterior:
            raise UsageError("limbs that do not move each other are sampled one by one")
        chosen = tuple(effects)

        def work(robot, data):
            return fit(
                robot,
                data,
                fitter=fitter,
                residual=residual,
                loss=loss,
                effects=effects_at(chosen, robot),
                without=without,
                seed=seed,
                budget=budget,
                progress=progress,
                solver=solver,
                as_recorded=as_recorded,
                cutoff_hz=cutoff_hz,
                window=window,
                forgetting=forgetting,
                block_s=block_s,
            )

        return each(limbs, work, dataset)
    refuse_too_large(foreseen("fit", model, dataset))
    effects, without = tuple(effects), tuple(without)
    _refuse_effects(model, dataset, effects, without)
    checked = _checked(model, dataset, without, as_recorded)
    data = checked.mended or dataset
    if along is not None:
        data = in_blocks(data, block_s)
    binding = bind(model, data, effects=effects, without=without)
    compared = resolve_residual(residual, cutoff_hz) if cutoff_hz is not None else residual
    found = _fit(
        binding=binding,
        fitter=fitter,
        residual=compared,
        loss=loss,
        seed=seed,
        budget=budget,
        progress=progress,
        solver=solver,
        along=along,
    )
    if posterior:
        found = _with_posterior(binding, compared, solver, found, posterior, seed, progress)
    return replace(found, data=checked.findings, wall_time_s=time.perf_counter() - began)


def _with_posterior(
    binding: Binding,
    residual: Residual | str | None,
    solver: Any,
    found: Fit,
    posterior: Sampling | bool,
    seed: int,
    progress: Progress | None,
) -> Fit:
    """The fit with draws about it. On Ctrl-C `Interrupted` carries the fit without."""
    from jaxid.fitting.nuts import Sampling
    from jaxid.fitting.posterior import posterior_of

    compared = resolve_residual(residual)
    sampling = posterior if isinstance(posterior, Sampling) else Sampling()
    bound = with_solver(binding, solver, compared)
    try:
        drawn = posterior_of(bound, compared, found, sampling, seed, progress)
    except KeyboardInterrupt as stop:
        raise Interrupted(found) from stop
    return replace(found, posterior=drawn)


def _refuse_effects(
    model: object,
    dataset: Dataset,
    effects: Sequence[str | Effect | type[Effect]],
    without: Sequence[str],
) -> None:
    """Raises `UsageError`, before anything is computed, for an effect that cannot be added."""
    if not effects:
        return
    nominal = resolve_model(model, dataset, without)
    for effect in effects:
        parse_effect(effect, nominal)


def _checked(
    model: object, dataset: Dataset, without: tuple[str, ...], as_recorded: bool
) -> Checked:
    """The check that comes before every answer."""
    from jaxid.conventions.checking import run_check
    from jaxid.fitters.short_fit import free_motion, left_by_short_fit

    return run_check(model, dataset, without, as_recorded, left_by_short_fit, free_motion)


def _fit(
    binding: Binding,
    fitter,
    residual,
    loss,
    seed: int,
    budget: int | None,
    progress,
    solver: Any = None,
    along: Any = None,
) -> Fit:
    from jaxid.fitting.run import fit_binding

    loss = loss or "sum_of_squares"
    if loss not in LOSSES:
        raise UsageError(f"there is no loss {loss!r}{nearest(loss, LOSSES)}")
    if budget is not None and budget < 1:
        raise UsageError(f"a budget of {budget} evaluations is none; give at least 1")
    chosen = resolve_fitter(fitter, loss)
    residual = residual or getattr(chosen, "residual_name", None)
    resolved = resolve_residual(residual)
    if along is not None:
        from jaxid.fitting.recursion import fit_recursively

        return fit_recursively(
            binding=with_solver(binding, solver, resolved),
            fitter=chosen,
            residual=resolved,
            loss=loss,
            seed=seed,
            budget=budget,
            progress=progress,
            recursion=along,
        )
    return fit_binding(
        with_solver(binding, solver, resolved), chosen, resolved, loss, seed, budget, progress
    )


def diagnose(
    model: object,
    dataset: Dataset,
    *,
    max_effects: int = 3,
    effects: Iterable[str | Effect | type[Effect]] | None = None,
    without: Iterable[str] = (),
    residual: Residual | str | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    as_recorded: bool = False,
    reference: Any = None,
    cutoff_hz: float | None = None,
    seconds: float | None = None,
    accuracy: str | None = None,
) -> Diagnosis:
    """Says where the model is wrong, which effect is missing, and how far the gap shrinks once it
    is added.

    `effects` limits the candidates (ids, and effects of your own; default: all of the library that
    the model lacks), `max_effects` how many may be named. Of recordings that would need more memory
    than there is, or more than about an hour, the first part is looked at, and a note says so. The
    recording is checked first (`jaxid.check`), and decisive findings are applied unless
    `as_recorded`. `reference`, a fit, an identification or a diagnosis of another recording (or its
    JSON file), is what is known beforehand: what is asked is what is different here. `cutoff_hz` is
    the low-pass of `inverse_dynamics`. After `seconds` the answer is what is known by then, with
    `complete` false; a program that is being compiled is waited for. `accuracy`, `"1 mrad"` or
    `"q = 1 mrad, position = 0.1 mm"`, is how near a model has to come: what is left within it is
    not missing. Raises `UsageError` for
    arguments that do not fit, and where nothing is known after `seconds`.
    """
    refuse_free("diagnose", dataset)
    dataset = with_accuracy(dataset, accuracy)
    if max_effects < 1:
        raise UsageError(f"max_effects is {max_effects}; a diagnosis needs at least 1")
    asked = None if effects is None else tuple(effects)
    without = tuple(without)
    limbs = limbs_of(model, dataset)
    if len(limbs) > 1:
        from jaxid.diagnosis.limbs import diagnose_each

        def work(robot: object, data: Dataset, tell: Progress) -> Diagnosis:
            return diagnose(
                robot,
                data,
                max_effects=max_effects,
                effects=asked,
                without=without,
                residual=residual,
                seed=seed,
                progress=tell,
                as_recorded=as_recorded,
                seconds=None if seconds is None else seconds * share_of_time(len(limbs)),
            )

        return diagnose_each(limbs, work, dataset, progress)

    def answer() -> Diagnosis:
        return _diagnosis(
            model=model,
            dataset=dataset,
            max_effects=max_effects,
            effects=asked,
            without=without,
            residual=residual,
            seed=seed,
            progress=progress,
            as_recorded=as_recorded,
            reference=reference,
            cutoff_hz=cutoff_hz,
        )

    return answered_in_time(seconds, answer)


def _diagnosis(
    *,
    model: object,
    dataset: Dataset,
    max_effects: int,
    effects: tuple[str | Effect | type[Effect], ...] | None,
    without: tuple[str, ...],
    residual: Residual | str | None,
    seed: int,
    progress: Progress | None,
    as_recorded: bool,
    reference: Any,
    cutoff_hz: float | None,
) -> Diagnosis:
    """The diagnosis of one mechanism. On Ctrl-C `Interrupted` carries what is known."""
    from jaxid.diagnosis.hypothesis import check_asked
    from jaxid.diagnosis.run import begin_compiling, run_diagnosis
    from jaxid.diagnosis.torque.reference import ReferenceNumbers

    compared = resolve_residual(residual, cutoff_hz)
    if effects:
        asked = [catalogue.enrolled(effect) for effect in effects]
        nominal = resolve_model(model, dataset, without)
        check_asked(nominal, asked, compared.name if compared else "")
    if residual is None:
        begin_compiling(model, dataset, effects, without)
    checked = _checked(model, dataset, without, as_recorded)
    known = None if reference is None else ReferenceNumbers.read(reference)
    try:
        found = run_diagnosis(
            model=model,
            dataset=checked.mended or dataset,
            max_effects=max_effects,
            effects=effects,
            without=without,
            residual=compared,
            seed=seed,
            progress=progress,
            reference=known,
        )
    except Interrupted as stop:
        partial = None if stop.partial is None else replace(stop.partial, data=checked.findings)
        raise Interrupted(partial) from stop
    return replace(found, data=checked.findings)


def check(
    model: object, dataset: Dataset, *, without: Iterable[str] = (), as_recorded: bool = False
) -> Checked:
    """What a recording says about itself before any effect is looked for: signs, zeros, units,
    rows, clocks, glitches …

    `model` as in `fit`; without one, what the samples show by themselves is found alone. The
    result's `mended` is the dataset with the decisive findings applied (`as_recorded`: with none).
    """
    return _checked(model, dataset, tuple(without), as_recorded)


def simulate(
    model: object,
    dataset: Dataset,
    parameters: Fit | Diagnosis | Mapping[str, Any] | None = None,
    *,
    solver: Any = None,
    **old: Any,
) -> Simulation:
    """Free runs of a model on a dataset's inputs.

    `model` as of `fit`, None for the one that the parameters or the dataset name; `parameters` a
    `Fit`, a `Diagnosis` (with the effects that it names) or the content of the JSON of either, None
    for the numbers of the model itself, such as `fit.chain`. `solver` (a solver of diffrax, or
    `Diffrax`) checks jaxid's own stepping. Raises `UsageError` for arguments that do not fit.
    """
    from jaxid.fitting.simulate import simulate_dataset

    if isinstance(model, Fit | Mapping):
        warnings.warn(
            "jaxid.simulate(parameters, dataset, model=...) is now jaxid.simulate(model, dataset,"
            " parameters=...); the old order goes with the next version",
            DeprecationWarning,
            stacklevel=2,
        )
        model, parameters = old.pop("model", None), model
    if old:
        raise TypeError(f"simulate() got an unexpected keyword argument {next(iter(old))!r}")
    if isinstance(parameters, Fit) and parameters.chain is not None and model is None:
        known = parameters.model in catalogue.model_names()
        model, parameters = (None, parameters) if known else (parameters.chain, None)
    content = parameters.to_dict() if isinstance(parameters, Fit | Diagnosis) else parameters
    return simulate_dataset(with_effects(content), dataset, model, solver)


def replay(dataset: Dataset, robot: str | Path, against: str | Path | None = None) -> Replay:
    """A robot's file (MJCF or URDF, patched or not) run in MuJoCo on a recording: each joint's
    error.

    Beside it stands jaxid's own free run, of the result that the file was exported from (where
    `jaxid export` wrote it) or of the file itself; with `against` that file in MuJoCo. Raises
    `UsageError` for a file that cannot be read and for joints that are not recorded.
    """
    from jaxid.fitting.replay import run_replay

    refuse_free("replay", dataset)
    return run_replay(dataset, Path(robot), None if against is None else Path(against))


def compare(
    model: object,
    dataset: Dataset,
    *,
    fitters: Iterable[AbstractFitter | str] | None = None,
    seeds: int = 10,
    budget: int | None = None,
    seconds: float | None = None,
    effects: Iterable[str | Effect | type[Effect]] = (),
    without: Iterable[str] = (),
    residual: Residual | str | None = None,
    loss: str | None = None,
    starts: str = "random",
    tolerance: float = 1e-3,
    seed: int = 0,
    progress: Progress | None = None,
    as_recorded: bool = False,
    cutoff_hz: float | None = None,
) -> Comparison:
    """Runs every fitter with every seed on the same compiled loss, with the same budget of
    evaluations (default 10,000) or `seconds`, whichever ends a run first.

    A seed is a random start within the bounds, the same for all fitters (`starts="guess"`: the
    start that the data suggest). A run has reached the target when its loss is at most the best
    known one times 1 + `tolerance`. The recording is checked first, as by `fit`, and decisive
    findings are applied unless `as_recorded`. `cutoff_hz` is the low-pass of `inverse_dynamics`.
    Raises `UsageError` for arguments that do not fit.
    """
    from jaxid.fitters.by_name import labelled
    from jaxid.fitting.comparison_runs import BUDGET, run_comparison

    budget = BUDGET if budget is None and seconds is None else budget
    effects, without = tuple(effects), tuple(without)
    _refuse_effects(model, dataset, effects, without)
    checked = _checked(model, dataset, without, as_recorded)
    return run_comparison(
        model=model,
        dataset=checked.mended or dataset,
        fitters=labelled(fitters, budget, seconds),
        seeds=seeds,
        budget=budget,
        seconds=seconds,
        effects=effects,
        without=without,
        residual=resolve_residual(residual, cutoff_hz),
        loss=loss or "sum_of_squares",
        starts=starts,
        tolerance=tolerance,
        seed=seed,
        progress=progress,
        data=checked.findings,
    )


def resolve_fitter(
    fitter: AbstractFitter | str | None, loss: str = "sum_of_squares"
) -> AbstractFitter:
    """The fitter given, named by a text, or the default for a loss."""
    from jaxid.fitters.by_name import fitter_of

    if fitter is None:
        fitter = "lm" if loss == "sum_of_squares" else "hybrid"
    return fitter_of(fitter) if isinstance(fitter, str) else fitter
