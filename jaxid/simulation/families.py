"""Families of effects: those of one module, which a program holds together or not at all."""

from __future__ import annotations

import numpy as np

from jaxid.dynamics.parameter_vector import ParameterVector


def families(layout: ParameterVector) -> dict[str, np.ndarray]:
    """Family of effects -> positions of its numbers, for effects that are no part of the mechanism
    by default. A family is the module that defines its effects.
    """
    builtin = {kind.name for kind, _ in layout.chain.mechanism.builtin}
    out: dict[str, list[int]] = {}
    for i, e in enumerate(layout.entries):
        if e.owner >= 0 and (effect := layout.chain.effects[e.owner]).name not in builtin:
            out.setdefault(type(effect).__module__, []).append(i)
    return {name: np.array(index) for name, index in out.items()}


def with_states(layout: ParameterVector) -> list[int]:
    """The numbers of the effects that have states."""
    stateful = layout.chain.stateful()
    return [i for i, e in enumerate(layout.entries) if e.owner >= 0 and stateful[e.owner]]


def restricted(layout: ParameterVector, kept: frozenset[str]) -> tuple[ParameterVector, np.ndarray]:
    """The layout without the families that are not kept, and the positions of its numbers in the
    whole.
    """
    gone: set[int] = set()
    for name, index in families(layout).items():
        if name not in kept:
            gone |= {layout.entries[i].owner for i in index}
    small = layout.without(frozenset(layout.chain.effects[k].name for k in gone))
    return small, np.array([layout.index(n) for n in small.names])
