"""A model bound to a dataset: which channels it uses, what its numbers start from, between which
bounds, and the noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from jaxid.base import wording
from jaxid.base.errors import nearest, UsageError
from jaxid.base.wording import names_of
from jaxid.data.capacity import Need, need
from jaxid.data.dataset import Dataset, Experiment, ModelSpec
from jaxid.data.joint_names import in_chain_order, joint_names
from jaxid.data.noise import Noise, noise_floor, Window
from jaxid.data.time_stamps import scattered_stamps, Stamps, with_scatter
from jaxid.data.units import si_unit
from jaxid.dynamics import catalogue
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.drive_torque import FORCES
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.joint_readings import all_read, with_speeds
from jaxid.dynamics.mechanism import Mechanism, Signature
from jaxid.dynamics.parameter import settings, TypicalMagnitudes, with_settings
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.models.effects import TimestampJitter
from jaxid.problem import measured_motion
from jaxid.problem.accuracy import beside_accuracy
from jaxid.problem.added_effects import parse_effect
from jaxid.problem.measured_motion import Motion
from jaxid.problem.named_model import named_model
from jaxid.problem.proposed_model import without_a_model
from jaxid.problem.starting_values import (
    bounded,
    free_numbers,
    held_friction,
    own_numbers,
    stated_scales,
    stated_values,
)
from jaxid.problem.typical import typical_magnitudes
from jaxid.robots import match as robots


#: The effect whose strength is read off the recording: it is noise, which no residual shows the
#: size of.
JITTER = TimestampJitter.name


@dataclass
class Binding:
    """Everything about a model on a dataset that does not depend on a residual or fitter."""

    dataset: Dataset
    chain: Chain
    layout: ParameterVector
    noise: dict[str, Noise]
    sigma: np.ndarray  # [ny]
    readings: (
        np.ndarray
    )  # the sensors' own part of it [ny]: what noise is in the motion, however runs differ
    motions: dict[
        str, Motion
    ]  # experiment name -> smoothed motion; empty where the model does not measure its joints
    references: list[TypicalMagnitudes]  # of each joint
    inputs: list[
        TypicalMagnitudes
    ]  # of each input channel, its own magnitude in place of the torque
    theta: np.ndarray  # start values of every number
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray
    free: list[int]  # what a fit of this model determines
    stated: set[int]  # values that the dataset states itself
    nominal: set[
        int
    ]  # numbers of the model as the user has it, without added effects and candidates
    read: dict[int, float] = field(
        default_factory=dict
    )  # numbers that the recording itself tells: their standard deviation
    priors: dict[int, tuple[float, float]] = field(
        default_factory=dict
    )  # mean and standard deviation of numbers known before
    said: tuple[str, ...] = ()  # what the dataset asks for that changes a result
    #: Kind of stated number -> the spread of its priors: see `jaxid.problem.trust`.
    spreads: dict[str, float] = field(default_factory=dict)
    inflation: float = 1.0  # by so much variances of priors were made smaller

    def experiments(self, split: str) -> tuple[Experiment, ...]:
        return self.dataset.split(split)

    @property
    def gains(self) -> set[int]:
        """Fitted numbers of a drive law that make the torque itself: no equation of torques can
        tell them.
        """
        gains = [name for name in self.chain.mechanism.known() if not name.startswith("delay@")]
        names = self.layout.names
        return {i for i in self.free if names[i] in gains}

    def reference(self, effect: type[Effect] | Effect, place: int) -> TypicalMagnitudes:
        """Typical magnitudes where an effect acts."""
        if effect.location == "number":
            first = self.references[0]
            return first._replace(
                number=self.layout.typical(self.chain.places(effect)[place], first)
            )
        at_input = effect.location == "input" and not self.chain.mechanism.behind_law(effect)
        own = self.inputs if at_input and self.inputs else self.references
        return own[min(place, len(own) - 1)]

    def motions_of(self, experiments: Iterable[Experiment]) -> list[Motion] | None:
        """Motions of these runs, or None where the model does not measure its joints."""
        names = names_of(experiments)
        if not self.motions or not self.motions.keys() >= set(names):
            return None
        return [self.motions[n] for n in names]

    def by_windows(self, window: Window | None) -> Binding:
        """With the noise of runs that begin anew in each window: what repeats differ by has not
        added up since they began. `self` without windows or repeats.
        """
        if window is None or all(n.source != "repeatability" for n in self.noise.values()):
            return self
        noise = noise_floor(self.dataset, window=window)
        noise = beside_accuracy(noise, self.dataset)
        return replace(
            self,
            noise=noise,
            sigma=np.array([noise[n].std for n, _ in self.chain.signature.outputs]),
        )

    def with_stamps(self, stamps: Mapping[str, Stamps]) -> Binding:
        """The spreads of time stamps as numbers of the model that no fit determines; output channel
        -> its stamps.
        """
        theta, read = self.theta.copy(), dict(self.read)
        for channel, found in stamps.items():
            (i,) = self.layout.of_effect(JITTER, channel)
            theta[i], read[i] = found.spread, found.std
        return replace(self, theta=theta, read=read, free=[i for i in self.free if i not in read])


def resolve_model(model: object, dataset: Dataset, without: Iterable[str] = ()) -> Chain:
    """The chain that a dataset and a user mean: by id, by the path of a URDF or of a model of the
    user's own, as a mechanism, or as a chain; None takes the dataset's.
    """
    model, dataset = robots.prepared(model, dataset)
    spec = dataset.stated
    if model is None:
        model = spec.file or spec.name
    if model is None:
        raise UsageError(without_a_model(dataset))
    if isinstance(model, str):
        model = named_model(model, spec)
    constants = spec.constants
    if robots.is_robot(model):
        model = cast(Any, model).matched(dataset)
    if isinstance(model, Mechanism):
        model = with_settings(model, constants)
        if not robots.is_robot(model):  # its joints are matched already
            dataset = in_chain_order(dataset, joint_names(model))
        smoothing = constants.get("smoothing_velocity", 0.0)
        model = Chain(model, signature=_signature(model, dataset), smoothing_velocity=smoothing)
    if not isinstance(model, Chain):
        raise UsageError(f"a model is an id, a mechanism or a chain, not {type(model).__name__}")
    _check_drive(model)
    _check_gains(model, spec)
    if set(constants) & set(settings(model.mechanism)):
        model = model.with_mechanism(with_settings(model.mechanism, constants))
    left_out = (*spec.without, *without)
    _check_left_out(model, left_out)
    return model.without(*left_out)


def _check_left_out(chain: Chain, names: Iterable[str]) -> None:
    has = names_of(chain.effects)
    builtin = [kind.name for kind, _ in chain.mechanism.builtin]
    for name in names:
        catalogue.effect_class(name)
        if name not in has and name not in builtin:
            raise UsageError(
                f"{chain.mechanism.name} has no {name} to leave out{nearest(name, has)}"
            )


def foreseen(work: str, model: object, dataset: Dataset, candidates: int = 0) -> Need:
    """What `work` of a model as it is given to a command will need."""
    return need(work, dataset, resolve_model(model, dataset).nq, candidates)


def _check_drive(chain: Chain) -> None:
    """Without a law of its own each input is the torque of the joint of its number, and there is
    one for each.
    """
    nu, nq = len(chain.signature.inputs), chain.nq
    if nu not in (0, nq) and type(chain.mechanism).drive is Mechanism.drive:
        counted = f"{nu} input{'s' * (nu > 1)}, {nq} joint{'s' * (nq > 1)}"
        raise UsageError(
            f"{counted}: write `drive` in {type(chain.mechanism).__name__}, the law that makes"
            " joint torques of inputs, as in `def drive(self, signature, u, q, qd): return"
            " jnp.stack([...])`, one entry for each joint"
        )


def _check_gains(chain: Chain, spec: ModelSpec) -> None:
    """A command in another unit than its joint's torque needs its drive gain stated, in the dataset
    or in the chain.
    """
    stated = {*spec.constants, *spec.parameters}
    layout = ParameterVector(chain)
    missing = []
    for effect in chain.effects:
        if getattr(effect, "known_gain", lambda: None)() is None:
            continue
        places = dict(chain.signature.commands)
        for i in layout.of_effect(effect.name):
            unit = places[layout.entries[i].location]
            if unit not in FORCES and layout.names[i] not in stated and layout.values[i] == 1.0:
                missing.append((layout.entries[i].location, unit, layout.names[i]))
    if missing:
        channels = wording.listed([channel for channel, _, _ in missing])
        unit = missing[0][1]
        lines = ", ".join(f"{name} = …" for _, _, name in missing)
        raise UsageError(
            f"{channels}: in {unit}, and nothing says how much joint torque one {unit} makes. State"
            f" it in N m/{unit} (torque constant times gear ratio) under [model.constants]: {lines}"
        )


def _signature(mechanism: Mechanism, dataset: Dataset) -> Signature:
    inputs, outputs = set(dataset.input_names), {c.name: c.unit for c in dataset.outputs}
    wanted = []
    for signature in mechanism.signatures:
        s = with_speeds(signature, outputs)
        needed = {} if dataset.stated.free else dict(s.inputs)
        if outputs.keys() >= dict(s.outputs).keys() and inputs >= needed.keys():
            _check_units(mechanism.name, dataset, (*s.outputs, *needed.items()))
            return s
        wanted.append(
            f"inputs {', '.join(dict(signature.inputs))} and outputs"
            f" {', '.join(dict(signature.outputs))}"
        )
    raise UsageError(
        f"model {mechanism.name} needs {'; or '.join(wanted)}; the dataset has inputs"
        f" {', '.join(sorted(inputs)) or 'none'} and outputs"
        f" {', '.join(sorted(outputs)) or 'none'}. {_remedy(mechanism, dataset)}"
    )


def _remedy(mechanism: Mechanism, dataset: Dataset) -> str:
    """What to do about channels that a model lacks: some of them may be there under another
    role.
    """
    beside = {c.name for c in dataset.channels if c.role == "auxiliary"}
    wanted = {"input": mechanism.signatures[0].inputs, "output": mechanism.signatures[0].outputs}
    for role, channels in wanted.items():
        if found := [name for name, _ in channels if name in beside]:
            each = f" (and so {wording.listed(found[1:])})" if len(found) > 1 else ""
            return (
                f'{wording.listed(found)}: recorded as auxiliary; state role = "{role}" under'
                f" [channels.{found[0]}]{each}"
            )
    return "Rename channels with `column`, or choose another model"


def _check_units(model: str, dataset: Dataset, needed: Iterable[tuple[str, str]]) -> None:
    """A current is no torque, whatever its channel is called."""
    units = {c.name: c.unit for c in dataset.channels}
    for name, unit in needed:
        if si_unit(units[name]) != si_unit(unit):
            raise UsageError(
                f"{name!r} is in {units[name]}, but model {model!r} needs {unit}. Correct the unit,"
                " or convert it under "
                f'[channels.{name}]: scale = … (in {unit} per {units[name]}) and unit = "{unit}"'
            )


def bind(
    model: object,
    dataset: Dataset,
    *,
    effects: Iterable[str | Effect | type[Effect]] = (),
    without: Iterable[str] = (),
    candidates: Iterable[type[Effect]] = (),
    splits: bool = True,
) -> Binding:
    """Binds a model to a dataset.

    `effects` are added and fitted, `candidates` are put into the chain at their neutral value and
    stay there. The spread of time stamps is read off the recording where that shows it
    (`time_stamps`), and readings count by it.
    """
    model, dataset = robots.prepared(model, dataset)
    dataset = dataset.with_splits() if splits else dataset
    if not dataset.experiments and not dataset.responses:
        raise UsageError("the dataset holds no experiment")
    nominal = resolve_model(model, dataset, without)
    dataset = in_chain_order(dataset, joint_names(nominal.mechanism))
    added = [parse_effect(e, nominal) for e in effects]
    kinds = [kind for kind, _ in added]
    chain = _with_effects(nominal, kinds, candidates, dataset.sampling_time)
    dataset, noise, stamps = _noise(dataset, nominal, added)
    names = chain.signature.output_names
    alone = noise
    if any(n.source == "repeatability" for n in noise.values()):
        alone = noise_floor(dataset, readings=True)
    readings = np.array([alone[n].std for n in names])
    noise = beside_accuracy(noise, dataset)

    values = stated_values(ParameterVector(chain), dataset.stated)
    chain = ParameterVector(chain).model(values.theta)  # with what the dataset states
    layout = ParameterVector(chain)
    held = chain.mechanism.held() - values.priors.keys()
    fixed = values.fixed | {layout.index(name) for name in held if name in layout.names}
    own = own_numbers(layout, set(names_of(nominal.effects)))
    free = free_numbers(layout, own - fixed, added)
    motions: dict[str, Motion] = {}
    if all_read(chain):
        motions = {
            e.name: measured_motion.motion(dataset, e, chain, readings) for e in dataset.experiments
        }
    references, inputs = typical_magnitudes(dataset, layout, values.theta, motions)
    lower, upper, scale = layout.boxes(references, inputs)
    theta, lower, upper = bounded(layout, values, lower, upper)
    known, said = stated_scales(layout, values.priors, lower, upper)
    said = (*said, *held_friction(chain, layout, free, fixed - values.stated, theta))
    if robots.is_robot(model):
        said = (*robots.notes_of(model, dataset), *said)
        # Bounds go by what was recorded, in units that may be wrong: what a file states stays.
        lower[free] = np.minimum(lower[free], theta[free])
        upper[free] = np.maximum(upper[free], theta[free])
    theta[free] = np.clip(theta[free], lower[free], upper[free])
    return Binding(
        dataset=dataset,
        chain=chain,
        layout=layout,
        noise=noise,
        sigma=np.array([noise[n].std for n in names]),
        readings=readings,
        motions=motions,
        references=references,
        inputs=inputs,
        theta=theta,
        lower=lower,
        upper=upper,
        scale=scale,
        free=free,
        stated=values.stated,
        nominal=own,
        priors=known,
        said=said,
    ).with_stamps(stamps)


def _with_effects(
    nominal: Chain,
    added: Iterable[type[Effect]],
    candidates: Iterable[type[Effect]],
    period: float,
) -> Chain:
    """The chain with what it lacks of the effects, at their neutral values, for commands that are
    recorded every `period` s.
    """
    present = set(names_of(nominal.effects))
    kinds = dict.fromkeys(kind for kind in added if kind.name not in present)
    kinds |= dict.fromkeys(kind for kind in candidates if kind.name not in nominal.contents)
    return nominal.with_effects(*(kind.sampled(period) for kind in kinds))


def _noise(
    dataset: Dataset, nominal: Chain, added: Iterable[tuple[type[Effect], str | None]]
) -> tuple[Dataset, dict[str, Noise], dict[str, Stamps]]:
    """The noise of the readings, with time stamps that scatter where an effect asks for them."""
    noise = noise_floor(dataset)
    scattered: list[str] = []
    for kind, place in added:
        if kind.name == JITTER:
            scattered += [place] if place else nominal.offers(kind)
    if not scattered:
        return dataset, noise, {}
    found = scattered_stamps(dataset, noise)
    stamps = {channel: s for channel, s in found.items() if channel in scattered}
    if stamps:
        dataset = with_scatter(dataset, stamps, noise)
    return dataset, noise_floor(dataset), stamps
