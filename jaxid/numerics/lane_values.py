"""Values of a program over many lanes: whole arrays, or taken apart element by element; and how
those of a loop's state lie one after the other.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple, TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxid.numerics.program_form import called, is_literal, UnknownForm


if TYPE_CHECKING:
    from jax.extend.core import Jaxpr, JaxprEqn


#: Arrays of more elements (per lane) stay whole.
SMALL = 36


class Value(NamedTuple):
    """What a variable of one lane holds for all of them: an array, [lanes ...] if batched, or
    (object array) its elements, each a vector [lanes] or a number that all lanes share.
    """

    content: Any
    batched: bool

    @property
    def parted(self) -> bool:
        """Whether it is taken apart into elements."""
        return (
            self.batched and isinstance(self.content, np.ndarray) and self.content.dtype == object
        )

    def checked(self, eqn: JaxprEqn, stated: Any) -> None:
        """Raises `UnknownForm` where a value is not of the shape and type that the program
        states.
        """
        shape = np.shape(self.content)[self.batched and not self.parted :]
        some = self.content.flat[0] if self.parted and self.content.size else self.content
        if shape != stated.shape or (some.dtype not in (stated.dtype, object)):
            raise UnknownForm(f"{eqn.primitive.name} gives {some.dtype}{shape} for {stated}")


def spread(v: Value, lanes: int) -> Array:
    whole = whole_of(v, lanes)
    return whole if v.batched else jnp.broadcast_to(whole, (lanes, *whole.shape))


def whole_of(v: Value, lanes: int) -> Array:
    """The array of a value, [lanes ...] if batched."""
    if not v.parted:
        return jnp.asarray(v.content)
    elements = [jnp.broadcast_to(e, (lanes,)) for e in v.content.ravel()]
    return jnp.stack(elements, -1).reshape(lanes, *v.content.shape)


def parts_of(v: Value) -> np.ndarray:
    """The elements of a value as an object array of the lane's shape."""
    if v.parted:
        return v.content
    whole = jnp.asarray(v.content)
    out = np.empty(whole.shape[1:] if v.batched else whole.shape, object)
    for place in np.ndindex(out.shape):
        out[place] = whole[(slice(None), *place)] if v.batched else whole[place]
    return out


def filled(shape: tuple[int, ...], elements: Sequence[Any]) -> np.ndarray:
    out = np.empty(len(elements), object)
    for k, e in enumerate(elements):
        out[k] = e
    return out.reshape(shape)


def size_of(v: Any) -> int:
    return int(np.prod(v.aval.shape))


def dependent(jaxpr: Jaxpr, batched: Sequence[bool]) -> list[bool]:
    """Which results depend on the lane, given which arguments do."""
    env = dict(zip(jaxpr.invars, batched, strict=True))

    def read(v):
        return not is_literal(v) and env.get(v, False)

    for eqn in jaxpr.eqns:
        inner, flags = called(eqn), [read(v) for v in eqn.invars]
        out = (
            dependent(inner.jaxpr, flags) if inner is not None else [any(flags)] * len(eqn.outvars)
        )
        env.update(zip(eqn.outvars, out, strict=True))
    return [read(v) for v in jaxpr.outvars]


def settled(
    jaxpr: Jaxpr, consts: list[bool], carry: list[bool], rest: Sequence[bool] = ()
) -> list[bool]:
    """Which parts of a loop's state depend on the lane: what does at the beginning, and what is
    made of it. `rest` are a step's other arguments; what a step gives besides the state comes last.
    """
    while True:
        after = [
            a or b for a, b in zip(carry, dependent(jaxpr, [*consts, *carry, *rest]), strict=False)
        ]
        if after == carry:
            return carry
        carry = after


class LoopState(NamedTuple):
    """How the values of a loop's state lie as arrays, one after the other."""

    shapes: list[tuple[tuple[int, ...], bool, bool]]  # of a lane, batched, taken apart

    @classmethod
    def of(cls, avals: Sequence[Any], batched: Sequence[bool]) -> LoopState:
        return cls(
            [
                (a.shape, b, b and int(np.prod(a.shape)) <= SMALL)
                for a, b in zip(avals, batched, strict=True)
            ]
        )

    def arrays(self, values: Sequence[Value], lanes: int) -> list[Array]:
        out: list[Array] = []
        for (_, batched, parted), v in zip(self.shapes, values, strict=True):
            if parted:
                out += [jnp.broadcast_to(e, (lanes,)) for e in parts_of(v).ravel()]
            else:
                out.append(spread(v, lanes) if batched else v.content)
        return out

    def values(self, arrays: Sequence[Array]) -> list[Value]:
        left, out = iter(arrays), []
        for shape, batched, parted in self.shapes:
            if parted:
                out.append(
                    Value(filled(shape, list(itertools.islice(left, int(np.prod(shape))))), True)
                )
            else:
                out.append(Value(next(left), batched))
        return out


def batched_flags(values: Sequence[Value]) -> list[bool]:
    return [v.batched for v in values]
