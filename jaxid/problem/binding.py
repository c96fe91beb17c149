"""A model bound to a dataset: which channels it uses, what its numbers start from, between which
bounds, and the noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from jaxid import catalogue, wording
from jaxid.data.capacity import Need, need
from jaxid.data.dataset import Dataset, Experiment, ModelSpec, ParameterPrior
from jaxid.data.joint_names import in_chain_order, joint_names
from jaxid.data.noise import Noise, noise_floor, Window
from jaxid.data.time_stamps import scattered_stamps, Stamps, with_scatter
from jaxid.data.units import si_unit
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.drive_torque import FORCES
from jaxid.dynamics.effect import Effect, JointEffect, neutral
from jaxid.dynamics.joint_readings import all_read, with_speeds
from jaxid.dynamics.mechanism import Mechanism, Signature
from jaxid.dynamics.parameter import settings, TypicalMagnitudes, with_settings
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.errors import nearest, UsageError
from jaxid.models.effects import TimestampJitter
from jaxid.problem import measured_motion
from jaxid.problem.added_effects import parse_effect
from jaxid.problem.measured_motion import Motion
from jaxid.problem.named_model import named_model
from jaxid.problem.proposed_model import without_a_model
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
    doubts: dict[str, float] = field(
        default_factory=dict
    )  # what another simulator of the same file makes of numbers
    said: tuple[str, ...] = ()  # what the dataset asks for that changes a result

    def experiments(self, split: str) -> tuple[Experiment, ...]:
        return self.dataset.split(split)

    @property
    def gains(self) -> set[int]:
        """Fitted numbers of a drive law that make the torque itself: no equation of torques can
        tell them.
        """
        known = self.chain.mechanism.known()
        return {
            i
            for i in self.free
            if (name := self.layout.names[i]) in known and not name.startswith("delay@")
        }

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
        names = [e.name for e in experiments]
        return (
            [self.motions[n] for n in names]
            if self.motions and set(names) <= set(self.motions)
            else None
        )

    def by_windows(self, window: Window | None) -> Binding:
        """With the noise of runs that begin anew in each window: what repeats differ by has not
        added up since they began. `self` without windows or repeats.
        """
        if window is None or all(n.source != "repeatability" for n in self.noise.values()):
            return self
        noise = noise_floor(self.dataset, window=window)
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
    spec = dataset.model
    if model is None:
        if spec is None or (spec.name is None and spec.file is None):
            raise UsageError(without_a_model(dataset))
        model = spec.file or spec.name
    smoothing = spec.constants.get("smoothing_velocity", 0.0) if spec is not None else 0.0
    if isinstance(model, str):
        model = named_model(model, spec)
    constants = spec.constants if spec is not None else {}
    if robots.is_robot(model):
        model = cast(Any, model).matched(dataset)
    if isinstance(model, Mechanism):
        model = with_settings(model, constants)
        if not robots.is_robot(model):  # its joints are matched already
            dataset = in_chain_order(dataset, joint_names(model))
        model = Chain(model, signature=_signature(model, dataset), smoothing_velocity=smoothing)
    if not isinstance(model, Chain):
        raise UsageError(f"a model is an id, a mechanism or a chain, not {type(model).__name__}")
    _check_drive(model)
    _check_gains(model, spec)
    if set(constants) & set(settings(model.mechanism)):
        model = model.with_mechanism(with_settings(model.mechanism, constants))
    out = [*(spec.without if spec is not None else ()), *without]
    has = [e.name for e in model.effects]
    for name in out:
        catalogue.effect_class(name)
        builtin = [kind.name for kind, _ in model.mechanism.builtin]
        if name not in has and name not in builtin:
            raise UsageError(
                f"{model.mechanism.name} has no {name} to leave out{nearest(name, has)}"
            )
    return model.without(*out)


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


def _check_gains(chain: Chain, spec: ModelSpec | None) -> None:
    """A command in another unit than its joint's torque needs its drive gain stated, in the dataset
    or in the chain.
    """
    stated = {*spec.constants, *spec.parameters} if spec is not None else set()
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
    inputs, outputs = {c.name for c in dataset.inputs}, {c.name for c in dataset.outputs}
    free = dataset.model is not None and dataset.model.free
    for s in mechanism.signatures:
        s = with_speeds(s, {c.name: c.unit for c in dataset.outputs})
        if outputs >= {n for n, _ in s.outputs} and (free or inputs >= {n for n, _ in s.inputs}):
            _check_units(mechanism.name, dataset, (*s.outputs, *(() if free else s.inputs)))
            return s
    wanted = "; or ".join(
        f"inputs {', '.join(n for n, _ in s.inputs)} and outputs"
        f" {', '.join(n for n, _ in s.outputs)}"
        for s in mechanism.signatures
    )
    raise UsageError(
        f"model {mechanism.name} needs {wanted}; the dataset has inputs"
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
    present = {e.name for e in nominal.effects}
    contents = nominal.contents
    extra = [k for k, _ in added if k.name not in present]
    extra += [k for k in candidates if k.name not in contents and k not in extra]
    chain = nominal.with_effects(*(neutral(k) for k in dict.fromkeys(extra)))
    layout = ParameterVector(chain)
    noise = noise_floor(dataset)
    stamps: dict[str, Stamps] = {}
    if scattered := [
        p
        for k, place in added
        if k.name == JITTER
        for p in ([place] if place else nominal.offers(k))
    ]:
        stamps = {c: s for c, s in scattered_stamps(dataset, noise).items() if c in scattered}
        dataset = with_scatter(dataset, stamps, noise) if stamps else dataset
        noise = noise_floor(dataset)
    names = [n for n, _ in chain.signature.outputs]
    sigma = np.array([noise[n].std for n in names])
    alone = (
        noise_floor(dataset, readings=True)
        if any(n.source == "repeatability" for n in noise.values())
        else noise
    )
    readings = np.array([alone[n].std for n in names])

    theta, stated = layout.values.copy(), set()
    fixed = {i for i, e in enumerate(layout.entries) if e.spec.fixed}
    spec = dataset.model
    priors = dict(spec.parameters) if spec is not None else {}
    for name, value in (spec.constants if spec is not None else {}).items():
        if (
            name != "smoothing_velocity"
            and name not in settings(chain.mechanism)
            and not name.startswith(robots.POSE)
        ):
            i = layout.index(name)
            theta[i] = value
            fixed.add(i)
            stated.add(i)
    priors = chain.mechanism.known() | priors
    for name, prior in priors.items():
        value = (
            prior.value if prior.value is not None or prior.prior is None else prior.prior["mean"]
        )
        if value is not None:
            theta[layout.index(name)] = value
            stated.add(layout.index(name))

    chain = layout.model(theta)  # with what the dataset states
    layout = ParameterVector(chain)
    fixed |= {
        layout.index(name)
        for name in chain.mechanism.held()
        if name in layout.names and name not in priors
    }
    own = {
        i
        for i, e in enumerate(layout.entries)
        if e.owner < 0 or chain.effects[e.owner].name in present
    }
    free = sorted(i for i in own if i not in fixed)
    for kind, place in added:
        places = [place] if place else chain.offers(kind)
        free += [i for p in places for i in layout.of_effect(kind.name, p) if i not in free]

    motions: dict[str, Motion] = {}
    if all_read(chain):
        motions = {
            e.name: measured_motion.motion(dataset, e, chain, readings) for e in dataset.experiments
        }
    references, inputs = typical_magnitudes(dataset, layout, theta, motions)
    lower, upper, scale = layout.boxes(references, inputs)
    for name, prior in priors.items():
        i = layout.index(name)
        lower[i] = prior.lower if prior.lower is not None else min(lower[i], theta[i])
        upper[i] = prior.upper if prior.upper is not None else max(upper[i], theta[i])
        if not lower[i] <= theta[i] <= upper[i]:
            if prior.value is not None:
                raise UsageError(
                    f"{name} = {theta[i]:g} lies outside its bounds [{lower[i]:g}, {upper[i]:g}]"
                )
            theta[i] = np.sqrt(lower[i] * upper[i]) if lower[i] > 0 else (lower[i] + upper[i]) / 2
    known, said = _stated_scales(layout, priors, lower, upper)
    said = (*said, *_held_friction(chain, layout, free, fixed - stated, theta))
    if robots.is_robot(model):
        said = (*robots.notes_of(model, dataset), *said)
    theta[free] = np.clip(theta[free], lower[free], upper[free])
    return Binding(
        dataset=dataset,
        chain=chain,
        layout=layout,
        noise=noise,
        sigma=sigma,
        readings=readings,
        motions=motions,
        references=references,
        inputs=inputs,
        theta=theta,
        lower=lower,
        upper=upper,
        scale=scale,
        free=free,
        stated=stated,
        nominal=own,
        priors=known,
        said=said,
    ).with_stamps(stamps)


def _held_friction(
    chain: Chain, layout: ParameterVector, free: list[int], fixed: set[int], theta: np.ndarray
) -> list[str]:
    """What is to be said of numbers of the model's own friction that a fit leaves as they are,
    effect by effect.
    """
    said = []
    for k, effect in enumerate(chain.effects):
        if not isinstance(effect, JointEffect):
            continue
        own = [
            i
            for i, e in enumerate(layout.entries)
            if e.owner == k and i in fixed and i not in free and not e.spec.fixed
        ]
        own = [
            i for i in own if layout.entries[i].location not in robots.ANGLES
        ]  # nothing brakes a base that floats
        if own and any(i in free for i, e in enumerate(layout.entries) if e.owner == k):
            names = wording.listed([layout.names[i] for i in own])
            values = wording.listed([f"{v:g}" for v in dict.fromkeys(theta[own].tolist())])
            said.append(
                f"held and not fitted: {names} = {values}; --effect {effect.name} fits them,"
                f" [model.parameters.{layout.names[own[0]]}] one by one"
            )
    return said


def _stated_scales(
    layout: ParameterVector,
    priors: Mapping[str, ParameterPrior],
    lower: np.ndarray,
    upper: np.ndarray,
) -> tuple[dict[int, tuple[float, float]], tuple[str, ...]]:
    """Search scales as stated, set in the layout; the Gaussian priors, and sentences about both.
    Bounds that nobody states make room for a prior.
    """
    known, said, alike = {}, [], {}
    layout.log = layout.log.copy()
    for name, prior in priors.items():
        i = layout.index(name)
        if prior.prior is not None:
            known[i] = mean, std = prior.prior["mean"], prior.prior["std"]
            reach = (mean - 5 * std, mean + 5 * std)
            upper[i] = upper[i] if prior.upper is not None else max(upper[i], reach[1])
            least = 0.0 if lower[i] >= 0 else -np.inf
            if prior.lower is None and not (lower[i] > 0 and reach[0] <= 0):
                lower[i] = max(least, min(lower[i], reach[0]))
            alike.setdefault(f"{mean:.4g} ± {std:.4g} {layout.entries[i].unit}", []).append(name)
        if prior.log is not None:
            if prior.log and not lower[i] > 0:
                raise UsageError(
                    f"{name}: log = true searches its logarithm, and its lower bound is"
                    f" {lower[i]:g}: state `lower` above 0 under [model.parameters.{name}]"
                )
            layout.log[i] = prior.log
            said.append(
                f"{name} is searched {'by its logarithm' if prior.log else 'linearly'} (stated)"
            )
    said += [f"prior of {', '.join(names)}: {text} (stated)" for text, names in alike.items()]
    return known, tuple(said)
