"""What the equations of a traced program of JAX mean, in every form that its versions give them.

JAX keeps that form private and changes it. It is read here alone, and checked: what is not as it is
known raises `UnknownForm`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TYPE_CHECKING

import numpy as np


if TYPE_CHECKING:
    from jax.extend.core import ClosedJaxpr, JaxprEqn


class UnknownForm(Exception):
    """An equation says in another form than the known ones what it does."""


#: What a primitive that is done element by element is told; anything else that it is told has to be
#: empty.
TOLD = {
    "broadcast_in_dim": "shape broadcast_dimensions",
    "reshape": "new_sizes",
    "squeeze": "dimensions",
    "transpose": "permutation",
    "slice": "start_indices limit_indices strides",
    "stack": "axis",
    "concatenate": "dimension",
    "rev": "dimensions",
    "split": "sizes axis",
    "dot_general": "dimension_numbers precision preferred_element_type",
    **dict.fromkeys(
        ("reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "reduce_and", "reduce_or"), "axes"
    ),
}


def plain(eqn: JaxprEqn) -> bool:
    """Whether an equation is told nothing but what `TOLD` says (no sharding, no other accuracy)."""
    told = TOLD.get(eqn.primitive.name, "").split()
    missing = [key for key in told if key not in eqn.params]
    return not missing and all(
        key in told or value is None or value is False for key, value in eqn.params.items()
    )


def is_program(x: Any) -> bool:
    """Whether x is a program with its constants."""
    return hasattr(x, "jaxpr") and hasattr(x, "consts")


def is_literal(v: Any) -> bool:
    """Whether an argument of an equation is a number in place of a variable."""
    return hasattr(v, "val")


def called(eqn: JaxprEqn) -> ClosedJaxpr | None:
    """The program that an equation only calls."""
    for names, key in (
        (("jit", "pjit"), "jaxpr"),
        (("custom_jvp_call", "closed_call", "core_call"), "call_jaxpr"),
    ):
        if eqn.primitive.name in names:
            return _program(eqn, key, len(eqn.invars), len(eqn.outvars))
    return None


def _program(eqn: JaxprEqn, key: str, arguments: int, results: int) -> ClosedJaxpr:
    program: Any = eqn.params.get(key)
    if not is_program(program) or (len(program.jaxpr.invars), len(program.jaxpr.outvars)) != (
        arguments,
        results,
    ):
        raise UnknownForm(
            f"`{key}` of {eqn.primitive.name} is not a program of {arguments} arguments and"
            f" {results} results"
        )
    return program


def scan_counts(eqn: JaxprEqn) -> tuple[int, int]:
    """How many of a scan's arguments are constants, and how many are its state."""
    p = eqn.params
    known = {"jaxpr", "length", "reverse", "unroll", "linear", "_split_transpose"}
    if p.keys() - known == {"num_consts", "num_carry"}:
        consts, carry = p["num_consts"], p["num_carry"]
    elif p.keys() - known == {"ft_in", "ft_out"}:  # since JAX 0.11
        consts, carry, _ = (len(part) for part in p["ft_in"].unpack())
        if carry != len(p["ft_out"].unpack()[0]):
            raise UnknownForm("a scan gives another state than it takes")
    else:
        raise UnknownForm(f"scan is told {', '.join(sorted(p))}")
    body = _program(eqn, "jaxpr", len(eqn.invars), len(eqn.outvars))
    _same_state(eqn, body.in_avals[consts : consts + carry], body.out_avals[:carry])
    return consts, carry


def while_counts(eqn: JaxprEqn) -> tuple[int, int]:
    """How many of a loop's arguments are constants of its condition, and how many of its body; the
    others are its state.
    """
    p = eqn.params
    if p.keys() != {"cond_jaxpr", "cond_nconsts", "body_jaxpr", "body_nconsts"}:
        raise UnknownForm(f"while is told {', '.join(sorted(p))}")
    asked, done, state = p["cond_nconsts"], p["body_nconsts"], len(eqn.outvars)
    if len(eqn.invars) != asked + done + state:
        raise UnknownForm(f"while has {len(eqn.invars)} arguments, not {asked + done + state}")
    _program(eqn, "cond_jaxpr", asked + state, 1)
    body = _program(eqn, "body_jaxpr", done + state, state)
    _same_state(eqn, body.in_avals[done:], body.out_avals)
    return asked, done


def _same_state(eqn: JaxprEqn, before: Sequence[Any], after: Sequence[Any]) -> None:
    if [(a.shape, a.dtype) for a in before] != [(a.shape, a.dtype) for a in after]:
        raise UnknownForm(f"the state of {eqn.primitive.name} is not where it is looked for")


def bound(eqn: JaxprEqn, args: Sequence[Any]) -> list[Any]:
    """The results of an equation for other arguments."""
    given: Any = eqn.primitive.get_bind_params(eqn.params)
    functions, params = given if isinstance(given, tuple) else ((), given)  # a pair before JAX 0.10
    out = eqn.primitive.bind(*functions, *args, **params)
    return list(out) if eqn.primitive.multiple_results else [out]


def rearranged(
    name: str, params: dict[str, Any], arrays: list[np.ndarray]
) -> list[np.ndarray] | None:
    """Results of a primitive that only moves elements; None: it is none of them."""
    x = arrays[0]
    if name == "broadcast_in_dim":
        shape = params["shape"]
        wide = [1] * len(shape)
        for place, size in zip(params["broadcast_dimensions"], x.shape, strict=True):
            wide[place] = size
        return [np.broadcast_to(x.reshape(wide), shape)]
    if name == "reshape":
        return [x.reshape(params["new_sizes"])]
    if name == "squeeze":
        return [x.squeeze(tuple(map(int, params["dimensions"])))]
    if name == "transpose":
        return [x.transpose(params["permutation"])]
    if name == "slice":
        strides = params["strides"] or (1,) * x.ndim
        return [
            x[
                tuple(
                    slice(*s)
                    for s in zip(
                        params["start_indices"], params["limit_indices"], strides, strict=True
                    )
                )
            ]
        ]
    if name == "stack":
        return [np.stack(arrays, params["axis"])]
    if name == "concatenate":
        return [np.concatenate(arrays, params["dimension"])]
    if name == "rev":
        return [np.flip(x, params["dimensions"])]
    if name == "split":
        return np.split(x, np.cumsum(params["sizes"])[:-1], params["axis"])
    return None
