"""A model as one flat vector of numbers with names, units and bounds: what fitters see of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import nearest, UsageError
from jaxid.base.wording import names_of
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.parameter import ParameterSpec, resolve, specs, TypicalMagnitudes


class Entry(NamedTuple):
    """One number of a model. `owner` -1 is the mechanism, else the index of the effect; `place` its
    location there (0 for a field of the mechanism that is not one number per joint).
    """

    name: str
    owner: int
    field: str
    place: int
    location: str
    spec: ParameterSpec
    unit: str

    @property
    def is_shape(self) -> bool:
        """Whether it says how something acts, not how strongly: it has no zero to be scaled from."""
        return self.spec.log or (self.owner >= 0 and self.spec.value != 0)


class ChainForm:
    """A chain without names: chains of one shape, as the limbs of a robot, have equal forms, so
    that a program that takes the numbers of one takes those of the other. Compares and hashes by
    its structure.
    """

    def __init__(self, chain: Chain, leaves: Sequence[tuple[int, str, int | None]]):
        self.chain, self._leaves = chain.nameless(), leaves
        self._structure = jax.tree.structure(self.chain)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ChainForm) and other._structure == self._structure

    def __hash__(self) -> int:
        return hash(self._structure)

    @property
    def bare(self) -> Chain:
        """The chain with all numbers 0."""
        return self.model(np.zeros(sum(_size(width) for _, _, width in self._leaves)))

    def model(self, theta: Any) -> Chain:
        """The chain with these numbers (works on tracers, and on numbers one by one)."""
        return _with_numbers(self.chain, self._leaves, theta)


def _size(width: int | None) -> int:
    """How many numbers a field of this width has."""
    return 1 if width is None else width


def _leaves(chain: Chain) -> list[tuple[int, str, int | None]]:
    """Owner, field and how many numbers each field of a chain has; None is one that is no array."""
    leaves: list[tuple[int, str, int | None]] = []
    for name in specs(chain.mechanism):
        shape = np.shape(getattr(chain.mechanism, name))
        leaves.append((-1, name, shape[0] if shape else None))
    places = chain.places  # equinox makes a module of each method that is looked up
    for i, effect in enumerate(chain.effects):
        count = len(places(effect))
        leaves += [(i, name, count) for name in specs(effect)]
    return leaves


def _with_numbers(chain: Chain, leaves: Sequence[tuple[int, str, int | None]], theta: Any) -> Chain:
    values: list[Any] = []
    position = 0
    for _, _, width in leaves:
        own = theta[position : position + _size(width)]
        position += len(own)
        if width is None:
            own = own[0]
        elif isinstance(own, list):
            own = jnp.stack(own) if own else jnp.zeros(0)
        values.append(own)

    def replaced(chain: Chain) -> list[Any]:
        def owner_of(i):
            return chain.mechanism if i < 0 else chain.effects[i]

        return [getattr(owner_of(owner), name) for owner, name, _ in leaves]

    return eqx.tree_at(replaced, chain, values)


class ParameterVector:
    """Order, names and meaning of all numbers of a model: those of the mechanism, then those of
    each effect by location.
    """

    def __init__(self, chain: Chain, solver: Any = None):
        """`solver` simulates in place of the stepping of chains: a
        `jaxid.simulation.diffrax_solver.Diffrax`.
        """
        self.chain, self.solver = chain, solver
        self.entries = tuple(_entries(chain))
        self.names = names_of(self.entries)
        self.values = np.array([_value(chain, e) for e in self.entries], np.float64)
        self._leaves = _leaves(chain)
        self.log = np.array([e.spec.log for e in self.entries])
        self.shapes = np.array([e.is_shape for e in self.entries], bool)
        self._without: dict[frozenset[str], ParameterVector] = {}

    def __len__(self) -> int:
        return len(self.entries)

    def without(self, names: frozenset[str]) -> ParameterVector:
        """The layout of the model without some effects, made once."""
        if names not in self._without:
            self._without[names] = ParameterVector(self.chain.without(*names))
        return self._without[names]

    @cached_property
    def form(self) -> ChainForm:
        """What programs of this model are made of."""
        return ChainForm(self.chain, self._leaves)

    def model(
        self, theta: Float[Array, " size"] | Float[np.ndarray, " size"] | Sequence[Any]
    ) -> Chain:
        """The same chain with these numbers (works on tracers, and on numbers one by one)."""
        return _with_numbers(self.chain, self._leaves, theta)

    def index(self, name: str) -> int:
        """Position of a parameter by its printed name."""
        if name not in self.names:
            raise UsageError(f"the model has no parameter {name!r}{nearest(name, self.names)}")
        return self.names.index(name)

    @cached_property
    def _by_effect(self) -> dict[tuple[str, str | None], list[int]]:
        found: dict[tuple[str, str | None], list[int]] = {}
        for i, e in enumerate(self.entries):
            if e.owner >= 0:
                for location in (e.location, None):
                    found.setdefault((self.chain.effects[e.owner].name, location), []).append(i)
        return found

    def of_effect(self, effect: str, location: str | None = None) -> list[int]:
        """Positions of an effect's parameters, at one location or all."""
        return list(self._by_effect.get((effect, location), ()))

    def typical(self, name: str, joint: TypicalMagnitudes) -> float:
        """Size of a number of the model by its id: its value, or its scale where that is larger."""
        i = self.index(name)
        return max(abs(float(self.values[i])), resolve(self.entries[i].spec.scale, joint))

    def boxes(
        self, joints: Sequence[TypicalMagnitudes], inputs: Sequence[TypicalMagnitudes] = ()
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(lower, upper, scale) of every number, effects' bounds resolved at their joint or input
        channel.
        """
        boxes = np.zeros((3, len(self.entries)))
        for k, e in enumerate(self.entries):
            r = self._typical_at(e, joints, inputs or joints)
            boxes[:, k] = [resolve(b, r) for b in (e.spec.lower, e.spec.upper, e.spec.scale)]
        lower, upper, scale = boxes
        return lower, upper, scale

    def _typical_at(
        self,
        e: Entry,
        joints: Sequence[TypicalMagnitudes],
        inputs: Sequence[TypicalMagnitudes],
    ) -> TypicalMagnitudes:
        """What is typical where a number acts: at its joint, its input, or of the number that its
        effect changes.
        """
        own = joints
        if e.owner >= 0:
            effect = self.chain.effects[e.owner]
            if effect.location == "number":
                return joints[0]._replace(number=self.typical(e.location, joints[0]))
            if effect.location == "input" and not self.chain.mechanism.behind_law(effect):
                own = inputs
        return own[min(e.place, len(own) - 1)]


def own_entries(chain: Chain) -> list[Entry]:
    """Those of the mechanism and of the effects that it has built in."""
    kinds = tuple(kind for kind, _ in chain.mechanism.builtin)
    return list(_entries(chain, lambda e: isinstance(e, kinds)))


def _short_name(short: str, joint: str, number: int | None) -> str:
    """What a mechanism calls a number of its own effect, of several by joint or number."""
    if "{joint}" in short:
        return short.replace("{joint}", joint)
    return short if number is None else f"{short}{number + 1}"


def _value(chain: Chain, entry: Entry) -> Any:
    """The number of an entry as the chain has it."""
    owner = chain.mechanism if entry.owner < 0 else chain.effects[entry.owner]
    return np.ravel(getattr(owner, entry.field))[entry.place]


def _entries(chain: Chain, wanted: Callable[[Effect], bool] = lambda e: True) -> Iterator[Entry]:
    yield from _of_mechanism(chain)
    ids = {kind.name: names for kind, names in chain.mechanism.builtin}
    for i, effect in enumerate(chain.effects):
        if wanted(effect):
            yield from _of_effect(chain, i, effect, ids.get(effect.name, {}))


def _of_mechanism(chain: Chain) -> Iterator[Entry]:
    """A field is one number, or one per joint: m1 m2 ..."""
    mechanism, joints = chain.mechanism, chain.signature.joints
    for name, spec in specs(mechanism).items():
        value = np.asarray(getattr(mechanism, name))
        for k in range(value.size):
            own = mechanism.spec_of(name, k, spec)._replace(value=float(value.flat[k]))
            unit = chain.signature.unit(own.unit, k)
            called, where = name, ""
            if value.ndim:
                called = mechanism.number_name(name, k)
                where = joints[k] if k < len(joints) else ""
            yield Entry(called, -1, name, k, where, own, unit)


def _of_effect(chain: Chain, i: int, effect: Effect, short: Mapping[str, str]) -> Iterator[Entry]:
    """`short`: field -> what the mechanism calls it."""
    joints = chain.signature.joints
    places = chain.places(effect)
    for field, spec in specs(effect).items():
        for k, place in enumerate(places):
            name = f"{effect.name}.{field}@{place}"
            if short.get(field):
                is_input = effect.location == "input" and k < len(joints)
                joint = joints[k] if is_input else place
                name = _short_name(short[field], joint, k if len(places) > 1 else None)
            unit = chain.signature.unit(channel_unit(chain, effect, k, spec.unit), k)
            yield Entry(name, i, field, k, place, spec, unit)


def channel_unit(chain: Chain, effect: Effect | type[Effect], place: int, template: str) -> str:
    """Fills {u} and {y}, the unit of the channel that the effect acts on, and {p}, that of its
    number.
    """
    if not any(part in template for part in ("{u}", "{y}", "{p}")):
        return template
    if effect.location == "number":
        numbers = chain.numbers
        return template.replace("{p}", numbers[place].unit if place < len(numbers) else "")
    if chain.mechanism.behind_law(effect):
        return template.replace("{u}", chain.signature.unit("{F}", place))
    ports = chain.signature.inputs if effect.location == "input" else chain.signature.outputs
    own = ports[place][1] if place < len(ports) else ""
    return template.replace("{u}", own).replace("{y}", own)
