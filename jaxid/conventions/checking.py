"""Before physics: what a recording says about itself. `jaxid.check`, and the first step of fit,
diagnose and identify.

What the samples show by themselves comes first (`runs`, `samples`), then what a model tells
(`decide`, `readings`, `timing`) by regression on the missing force, without a simulation; a
decisive finding that needs the model is confirmed by one.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from jaxid.base.errors import DatasetError, DatasetWarning, UsageError
from jaxid.base.wording import names_of
from jaxid.conventions import bodies, runs, samples
from jaxid.conventions.beside_joints import FreeRuns, signals_beside
from jaxid.conventions.by_limb import force_fit
from jaxid.conventions.copies import copies
from jaxid.conventions.decide import judged
from jaxid.conventions.finding import Checked, DataFinding
from jaxid.conventions.late_speed import late_speeds
from jaxid.conventions.law import is_open, law_reading, OTHER, read_as
from jaxid.conventions.leading import before_its_goal, or_led
from jaxid.conventions.limits import ALIKE, GONE
from jaxid.conventions.mending import mended, Mending
from jaxid.conventions.missing_force import LAWS, LONGEST, measured, NEIGHBOURS
from jaxid.conventions.play import plays
from jaxid.conventions.rates import contradictions
from jaxid.conventions.registers import register, told_once
from jaxid.conventions.samples import Shown
from jaxid.data.capacity import give_back
from jaxid.data.dataset import Dataset, Experiment
from jaxid.data.noise import noise_floor
from jaxid.data.repeats import one_way_sentences
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.model_file import sha256_of
from jaxid.models.effects import VelocityFeedforward
from jaxid.problem.binding import bind, Binding
from jaxid.robots.floating import wanted
from jaxid.robots.limbs import limbs_of
from jaxid.robots.match import prepared
from jaxid.robots.stops import sentences_of


#: What a short fit of a bound model, with more effects, leaves of a dataset, times the noise; None
#: where nothing is simulated.
Gap = Callable[[Binding, Dataset, tuple[str, ...]], float | None]

#: Numbers of a model beyond which readings are gone through on few samples, and nothing is
#: simulated.
MOST_NUMBERS = 15
#: Kinds that a model tells, and that its simulation has to confirm.
BY_MODEL = ("sign", "zero", "scale", "swapped_channels", "row_shift", "clock")


def run_check(
    model: object,
    dataset: Dataset,
    without: Iterable[str] = (),
    as_recorded: bool = False,
    gap: Gap | None = None,
    free: FreeRuns | None = None,
) -> Checked:
    """See `jaxid.check`; with `gap`, findings that need the model are confirmed by simulations, as
    recorded and mended. With `free`, outputs that read no joint are compared with a free run.
    """
    began = time.perf_counter()
    found, data, change = _by_itself(dataset, as_recorded)
    notes = one_way_sentences(data)
    data = replace(data, notes=(*data.notes, *notes))
    name = digest = ""
    if dataset.experiments and wanted(dataset):
        name = "robot"
        found += bodies.impossible(prepared(model, dataset)[0])
        notes.append(
            "a robot on a free base is not compared with its recording: found is what the samples"
            " show by themselves"
        )
    elif dataset.experiments and _has_model(model, dataset):
        binding, why = _bound(model, data, tuple(without))
        name = binding.chain.mechanism.name if binding is not None else ""
        digest = sha256_of(binding.chain.mechanism) if binding is not None else ""
        notes += [why] if why else []
        if binding is not None:
            try:
                read = _law_read(model, binding, data, tuple(without), gap)
                if read is not None:
                    found.append(replace(read, applied=read.decisive and not as_recorded))
                    if found[-1].applied:
                        data = read_as(data, OTHER)
                        binding = _bound(model, data, tuple(without))[0] or binding
                found += bodies.impossible(binding.chain.mechanism)
                notes += sentences_of(binding.chain.mechanism, binding.dataset)
                more, data = _by_model(model, binding, data, as_recorded, gap, free)
                found = told_once(found, more)
            except (
                UsageError
            ) as error:  # what these data do not allow is not the end of what comes after
                notes.append(
                    f"the model's readings of the recording could not be compared: {error}"
                )
            give_back()
    return Checked(
        dataset=dataset.name,
        dataset_sha256=dataset.sha256,
        findings=tuple(found),
        mended=data,
        model=name,
        usable=_usable(found, dataset),
        notes=tuple(notes),
        wall_time_s=time.perf_counter() - began,
        model_sha256=digest,
    )


def check_folder(
    model: object,
    path: str | os.PathLike[str],
    without: Iterable[str] = (),
    as_recorded: bool = False,
    gap: Gap | None = None,
    free: FreeRuns | None = None,
) -> Checked:
    """The check of a dataset's folder; one that is refused for what a finding says is a result, not
    an error.

    Raises `DatasetError` for a folder with other faults.
    """
    from jaxid.data.io import load_dataset

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DatasetWarning)
            dataset = load_dataset(path)
    except DatasetError as error:
        found = runs.refused(error)
        if not found:
            raise
        name = os.path.basename(os.path.abspath(path))
        return Checked(name, "", tuple(found), None, usable=False)
    return run_check(model, dataset, without, as_recorded, gap, free)


def _usable(found: list[DataFinding], dataset: Dataset) -> bool:
    """Whether any output moves in any run of the recording."""
    names = names_of(dataset.experiments[:4])
    still = set()
    for finding in found:
        if finding.kind == "does_not_move" and all(name in finding.text for name in names):
            still.add(finding.channel)
    return any(c.name not in still for c in dataset.outputs)


def _has_model(model: object, dataset: Dataset) -> bool:
    return model is not None or dataset.stated.name is not None


def _by_itself(dataset: Dataset, as_recorded: bool) -> tuple[list[DataFinding], Dataset, Mending]:
    """What needs no model; each is looked for in what those before it mend."""
    found: list[DataFinding] = []
    total = Mending()
    data = dataset

    def take(shown: Shown) -> None:
        nonlocal data, total
        applied = bool(shown.mending) and shown.finding.decisive and not as_recorded
        found.append(replace(shown.finding, applied=applied))
        if shown.mending:
            data, total = mended(data, shown.mending), total.then(shown.mending)

    for shown in (*runs.time_unit(data), *copies(data)):
        take(shown)
    for channel in runs.outputs_first(data):
        for look in LOOKS:
            if (shown := look(data, channel)) is not None:
                take(shown)
    if data.experiments:
        noise = noise_floor(data, readings=True)  # what repeats differ by is motion
        for look in RUN_LOOKS:
            for shown in look(data, noise):
                take(shown)
    return found, (dataset if as_recorded else data), total


def _filtered(dataset: Dataset, channel):
    if not dataset.experiments:
        return None
    step = float(np.median([np.median(np.diff(e.t)) for e in dataset.experiments]))
    return samples.filtered(dataset, channel, step)


#: Every look at a channel, and at whole runs, in the order in which they are taken.
LOOKS: tuple[Callable, ...] = (
    register,
    samples.wrapped,
    samples.glitch,
    samples.repeated_rows,
    samples.saturated,
    _filtered,
)
RUN_LOOKS: tuple[Callable, ...] = (
    runs.not_at_rest,
    runs.does_not_move,
    lambda data, noise: runs.constant_inputs(data),
    lambda data, noise: late_speeds(data),
    lambda data, noise: plays(data),
)


def _bound(model: object, data: Dataset, without: tuple[str, ...]) -> tuple[Binding | None, str]:
    """The model on as much of each run as is looked at."""
    try:
        return bind(model, _beginnings(data.with_splits()), without=without), ""
    except UsageError as error:
        return None, f"the model was not asked: {error}"


def _beginnings(data: Dataset) -> Dataset:
    if all(len(e.t) <= LONGEST for e in data.experiments):
        return data
    part = slice(0, LONGEST)

    def cut(x):
        return None if x is None else x[part]

    def beginning(e: Experiment) -> Experiment:
        return replace(
            e,
            t=e.t[part],
            u=e.u[part],
            y=e.y[part],
            auxiliary={k: v[part] for k, v in e.auxiliary.items()},
            past=None,
            scatter=cut(e.scatter),
            left_out=cut(e.left_out),
        )

    return replace(data, experiments=tuple(map(beginning, data.experiments)))


def _law_read(
    model: object, binding: Binding, data: Dataset, without: tuple[str, ...], gap: Gap | None
) -> DataFinding | None:
    """What simulations say of a law that [controller] leaves open."""
    if gap is None or len(binding.free) > MOST_NUMBERS or not is_open(binding, data):
        return None

    def left(data: Dataset, effects: tuple[str, ...]) -> float | None:
        own, _ = _bound(model, data, without)
        return None if own is None else gap(own, data, effects)

    return law_reading(data, left, tuple(binding.chain.signature.input_names))


def _by_model(
    model: object,
    binding: Binding,
    data: Dataset,
    as_recorded: bool,
    gap: Gap | None,
    free: FreeRuns | None,
) -> tuple[list[DataFinding], Dataset]:
    """What the model tells, confirmed by a simulation, applied."""
    # Along a free motion every reading fits with another scale; where something touches, forces of
    # the ground are not known along it.
    driven = bool(binding.dataset.inputs) and not binding.chain.mechanism.touches
    many = len(binding.free) > MOST_NUMBERS
    motion = measured(binding, NEIGHBOURS) if driven and binding.free else None
    fit = None
    if motion is not None:
        fit = force_fit(binding, motion, limbs_of(model, _beginnings(data.with_splits())))
    plain, motion = contradictions(
        binding, data, fit, motion
    )  # which no simulation has to bear out
    shown = [] if fit is None or motion is None else list(judged(binding, fit, motion, many))
    first, total = _together(plain), _together(shown)
    if (
        total and gap is not None and not many
    ):  # the free run of an arm that was held by its controller says nothing
        shown = _confirmed(binding, mended(data, first), total, shown, gap)
    every = [*plain, *shown]
    marked, data = _applied(every, data, as_recorded)
    if free is None:
        return marked, data
    asked = _bound_again(binding, data) if any(f.applied for f in marked) else binding
    beside = signals_beside(asked, data, inputs_agree=fit is not None, free=free)
    more, data = _applied(beside, data, as_recorded)
    return [*marked, *more], data


def _bound_again(binding: Binding, data: Dataset) -> Binding:
    """The same model on a recording that was mended."""
    return bind(binding.chain, _beginnings(data.with_splits()))


def _applied(
    shown: list[Shown], data: Dataset, as_recorded: bool
) -> tuple[list[DataFinding], Dataset]:
    """The findings, marked where they are applied, and the recording with those applied."""
    applied = [bool(s.mending) and s.finding.decisive and not as_recorded for s in shown]
    found = [replace(s.finding, applied=taken) for s, taken in zip(shown, applied, strict=True)]
    change = _together([s for s, taken in zip(shown, applied, strict=True) if taken])
    return found, mended(data, change)


def _together(shown: Iterable[Shown]) -> Mending:
    total = Mending()
    for s in shown:
        total = total.then(s.mending)
    return total


def _confirmed(
    binding: Binding, data: Dataset, total: Mending, shown: list[Shown], gap: Gap
) -> list[Shown]:
    """Gaps by simulation as recorded and mended; what does not hold there is a question, and
    none where nothing is missing as recorded. What was found beside any law that the model may lack
    is simulated beside these laws, as recorded and mended alike: their gap is not the finding's.
    """
    laws = _laws(binding.chain) if any(s.beside for s in shown if s.mending) else ()
    before, after = gap(binding, data, laws), gap(binding, mended(data, total), laws)
    if before is None or after is None:
        return shown
    if _nothing_to_mend(before, after):
        return [s for s in shown if not s.mending]
    held = after <= GONE * before
    leads = _leads(binding, shown)
    led = gap(binding, data, (*laws, *leads)) if leads and held else None
    out = []
    for s in shown:
        if led is not None and after > GONE * led and before_its_goal(binding, s.finding):
            out.append(Shown(or_led(s.finding, before, after, led), Mending()))
        elif s.mending:
            out.append(_borne_out(s, before, after, beside_laws=bool(laws)))
        else:
            out.append(s)
    return out


def _borne_out(s: Shown, before: float, after: float, beside_laws: bool) -> Shown:
    """What was shown with the gaps by simulation; a question where these do not bear it out."""
    held = after <= GONE * before
    said = ""
    if not held:
        said = f" A simulation does not bear it out ({before:.3g} to {after:.3g} times the noise)."
    if beside_laws:
        said += " It was simulated beside any friction and spring that the model may lack."
    finding = replace(
        s.finding,
        gap_before=before,
        gap_if_mended=after,
        text=s.finding.text + said,
        decisive=held,
    )
    return Shown(finding, s.mending if held else Mending())


def _leads(binding: Binding, shown: Iterable[Shown]) -> list[str]:
    """The effects that look like goals which are recorded late, where those are found."""
    late = [s.finding.channel for s in shown if before_its_goal(binding, s.finding)]
    return [f"{VelocityFeedforward.name}@{channel}" for channel in late]


def _nothing_to_mend(before: float, after: float) -> bool:
    """Whether the recording is at the noise as it stands, and leaves more when mended: gaps by
    simulation, times the noise. Then no gap is left that a finding could be the answer to.
    """
    return before <= ALIKE and after > before


def _laws(chain: Chain) -> tuple[str, ...]:
    """The laws of `ForceFit` that a model lacks, as effects at each place."""
    laws: list[str] = []
    for kind in LAWS:
        if kind.name not in chain.contents:
            laws += [f"{kind.name}@{place}" for place in chain.offers(kind)]
    return tuple(laws)


__all__ = ["Checked", "DataFinding", "run_check"]
