"""What there is: models, effects, residuals by id, with their equations, parameters, units and
sources.

Fitters stand in `jaxid.fitters.by_name`.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TYPE_CHECKING

from jaxid.base.errors import nearest, UsageError


if TYPE_CHECKING:
    from jaxid.dynamics.mechanism import Signature


class ParameterInfo(NamedTuple):
    name: str
    unit: str
    neutral: float
    lower: str
    upper: str
    meaning: str


class ModelInfo(NamedTuple):
    name: str
    text: str
    equations: str
    source: str
    signatures: tuple[Signature, ...]
    parameters: tuple[str, ...]
    constants: tuple[str, ...]
    builtin_effects: tuple[str, ...]
    states: tuple[str, ...]
    parameter_info: tuple[ParameterInfo, ...]
    constant_info: tuple[ParameterInfo, ...]


class EffectSetting(NamedTuple):
    name: str
    default: str
    values: str
    meaning: str


class EffectInfo(NamedTuple):
    name: str
    text: str
    family: str
    port: str
    equation: str
    signature: str
    what_to_record: str
    source: str
    locations: str
    parameters: tuple[ParameterInfo, ...]
    settings: tuple[EffectSetting, ...] = ()


#: Constant that every model has besides its own.
SMOOTHING = ParameterInfo(
    "smoothing_velocity",
    "rad/s or m/s",
    0.0,
    "0",
    "inf",
    "0: Coulomb friction with true sticking; v > 0: tanh(qd / v), which is another model",
)


def _models() -> dict[str, type]:
    from jaxid.models import MODELS

    return {m.name: m for m in MODELS}


def _effects() -> dict[str, type]:
    from jaxid.models.effects import LIBRARY

    return {e.name: e for e in LIBRARY}


def enrolled(effect: Any) -> str:
    """The name of an effect given as such (it may go on with `@LOCATION`), as its class, as one
    with other settings, or as one of the user's own, which is known by it from then on.

    Raises `UsageError` for what is no effect, and for one of the user's own that takes the name of
    another one.
    """
    from jaxid.dynamics.effect import Effect, OWN_EFFECTS
    from jaxid.dynamics.parameter import kind_with, settings

    if isinstance(effect, str):
        return effect
    kind = effect if isinstance(effect, type) else type(effect)
    if not issubclass(kind, Effect):
        raise UsageError(
            "an effect is an id (`dead_zone@tau`), a class or one of an effect, not"
            f" {kind.__name__}"
        )
    if not isinstance(effect, type):
        kind = kind_with(kind, tuple((k, getattr(effect, k)) for k in settings(kind)))
    library = _effects()
    if (
        library.get(kind.name) is not kind
        and library.get(kind.name.partition("(")[0]) not in kind.__mro__
    ):
        if kind.name in library:
            raise UsageError(
                f"{kind.__name__} has the name {kind.name!r} of an effect of the library: give it"
                " another one"
            )
        OWN_EFFECTS[kind.name] = kind
    return kind.name


def pick(kind: str, table: dict[str, type], name: str) -> type:
    """What `name` stands for in a table; raises `UsageError` with the nearest name for an unknown
    one.
    """
    if name not in table:
        own = (
            "; a model of your own is named by its file: mymodel.py, or mymodel.py:MyModel"
            if kind == "model"
            else ""
        )
        raise UsageError(f"there is no {kind} {name!r}{nearest(name, table)}{own}")
    return table[name]


def model_names() -> tuple[str, ...]:
    return tuple(_models())


def effect_names() -> tuple[str, ...]:
    return tuple(_effects())


def model_class(name: str) -> Any:
    """The class of a model by its id, or by the file of one of the user's own
    (`duffing.py:Duffing`), which is run.

    Raises `UsageError` with the nearest name for an unknown one, and for a file that holds no
    model.
    """
    from jaxid.data.model_names import is_model_file
    from jaxid.dynamics.model_file import own_model

    return own_model(name) if is_model_file(name) else pick("model", _models(), name)


def effect_class(name: str, mechanism: Any = None) -> Any:
    """The class of an effect, on a mechanism where that has its own variant of it, with the
    settings that its id states: `load_dependent_friction(load=drive)`.
    """
    from jaxid.dynamics.effect import OWN_EFFECTS
    from jaxid.dynamics.parameter import kind_with

    plain, bracket, stated = name.partition("(")
    kind = pick(
        "effect", {**_effects(), **OWN_EFFECTS, **getattr(mechanism, "variants", {})}, plain
    )
    if not bracket:
        return kind
    pairs = [p.partition("=") for p in stated.removesuffix(")").split(",")]
    if not stated.endswith(")") or not all(sign for _, sign, _ in pairs):
        raise UsageError(
            f"{name!r}: settings are written as in `load_dependent_friction(load=drive)`"
        )
    return kind_with(kind, tuple((k.strip(), v.strip().strip("'\"")) for k, _, v in pairs))


def describe(name: str, model: Any = None) -> ModelInfo:
    """What a user and the checks of a dataset need to know of a model; `model` one of it where they
    differ (a `serial_arm`).
    """
    from jaxid.dynamics.chain import Chain
    from jaxid.dynamics.mechanism import speed_names
    from jaxid.dynamics.parameter import settings
    from jaxid.dynamics.parameter_vector import ParameterVector

    kind = model_class(name)
    parameters: dict[str, ParameterInfo] = {}
    constants: dict[str, ParameterInfo] = {}
    one = kind() if model is None else model
    for signature in one.signatures:
        for e in ParameterVector(Chain(one, signature=signature)).entries:
            info = ParameterInfo(
                e.name, e.unit, e.spec.value, str(e.spec.lower), str(e.spec.upper), e.spec.meaning
            )
            table = constants if e.spec.fixed else parameters
            if e.name in table and table[e.name].unit != e.unit:
                info = info._replace(unit=f"{table[e.name].unit} or {e.unit}")
            table[e.name] = info
    for setting, spec in settings(kind).items():
        default, lower, upper = (str(v).lower() for v in (spec.default, spec.lower, spec.upper))
        bounds = ("false", "true") if isinstance(spec.default, bool) else (lower, upper)
        constants[setting] = ParameterInfo(
            setting, "1", float(spec.default), *bounds, f"{spec.meaning} (default {default})"
        )
    constants[SMOOTHING.name] = SMOOTHING
    states: list[str] = []
    for signature in one.signatures:
        for j, joint in enumerate(signature.joints):
            number = "" if len(signature.joints) == 1 else str(j + 1)
            states += [joint, f"q{number}", *speed_names(signature.joints, j)]
    return ModelInfo(
        name=kind.name,
        text=text_of(kind),
        equations=kind.equations,
        source=kind.source,
        signatures=tuple(one.signatures),
        parameters=tuple(parameters),
        constants=tuple(constants),
        builtin_effects=tuple(e.name for e, _ in kind.builtin),
        states=tuple(dict.fromkeys(states)),
        parameter_info=tuple(parameters.values()),
        constant_info=tuple(constants.values()),
    )


_PORTS = {
    "InputEffect": ("actuator", "input", "an input channel"),
    "JointEffect": ("friction and forces at the joint", "joint", "a joint"),
    "BodyEffect": ("mechanism", "body", "a joint"),
    "OutputEffect": ("sensor", "output", "an output channel"),
    "RecordEffect": ("sensor", "output", "an output channel"),
    "NumberEffect": ("change in time", "number", "the id of a number of the model"),
}


def describe_effect(name: str) -> EffectInfo:
    from jaxid.dynamics.parameter import settings, specs

    kind = effect_class(name)
    own = [
        EffectSetting(
            k,
            str(s.default),
            ", ".join(s.words) or f"{s.lower} to {s.upper}",
            f"{s.meaning}; {kind.name}({k}=…)",
        )
        for k, s in settings(kind).items()
    ]
    family, port, locations = next(_PORTS[b.__name__] for b in kind.__mro__ if b.__name__ in _PORTS)
    units = {
        "{F}": "N m or N",
        "{X}": "rad or m",
        "{I}": "kg m^2 or kg",
        "{u}": "unit of the input",
        "{y}": "unit of the output",
        "{p}": "unit of the number",
    }
    parameters = []
    for field, spec in specs(kind).items():
        unit = spec.unit
        for token, text in units.items():
            unit = unit.replace(token, f"({text})" if unit != token else text)
        parameters.append(
            ParameterInfo(field, unit, spec.value, str(spec.lower), str(spec.upper), spec.meaning)
        )
    return EffectInfo(
        name=name,
        text=text_of(kind),
        family=family,
        port=port,
        equation=kind.equation,
        signature=kind.signature,
        what_to_record=kind.excitation,
        source=kind.source,
        locations=locations,
        parameters=tuple(parameters),
        settings=tuple(own),
    )


def text_of(kind: type) -> str:
    """The docstring of a class in one line."""
    return " ".join((kind.__doc__ or "").split())


#: Each residual by its name: its module and its class. A new one has its file and a line here.
RESIDUALS = {
    "output_error": "jaxid.problem.residual:OutputError",
    "multiple_shooting": "jaxid.problem.residual:MultipleShooting",
    "inverse_dynamics": "jaxid.problem.residual:InverseDynamics",
    "frequency_response": "jaxid.problem.frequency_response:FrequencyResponseError",
    "closed_loop": "jaxid.problem.closed_loop:ClosedLoopOutputError",
    "momentum": "jaxid.problem.momentum:Momentum",
}


LOSSES = ("sum_of_squares", "sum_of_norms", "sum_of_abs")


#: What `jaxid export` writes for: names of `jaxid.robots.export.targets`.
TARGETS = ("mjcf", "mjlab", "isaaclab", "urdf", "sdf", "drake", "ros2_control", "genesis")
