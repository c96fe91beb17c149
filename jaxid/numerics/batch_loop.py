"""Many lanes of one program side by side, like `jax.vmap`, with the loop over time laid out for
vector code.

`jax.vmap` puts the lanes first: a state [nq] becomes an array [lanes nq], and what picks, stacks
and sums its few elements becomes scalar code. Measured on the two-link arm with dry friction, 32
lanes: 205 ns a lane-step, against 111 as it is done here; its Runge-Kutta step alone 170 against
46. `batched_vmap` evaluates what is marked as a loop over time element by element: every element of a
small array is a vector [lanes] of its own, and picking, stacking and summing happen while tracing.
The arithmetic is the same, number by number. A version of JAX that writes its programs in another
form is served by `jax.vmap`.
"""

from __future__ import annotations

import functools
import itertools
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from jaxid.numerics.fast_math import fence
from jaxid.numerics.lane_values import (
    batched_flags,
    dependent,
    filled,
    LoopState,
    parts_of,
    settled,
    size_of,
    SMALL,
    spread,
    Value,
    whole_of,
)
from jaxid.numerics.program_form import (
    bound,
    called,
    is_literal,
    is_program,
    plain,
    rearranged,
    scan_counts,
    while_counts,
)


if TYPE_CHECKING:
    from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn


#: A step of more operations on elements is taken apart only where that makes no more than this many
#: times as many of them, as of one that is written element by element. Else it is mapped as
#: `jax.vmap` does it: compiling the matrices of an arm of six joints one element after the other
#: takes minutes. (Measured on the tracker with its whole library, 31000 operations: no longer to
#: compile, and 0.7 in place of 1.9 microseconds a lane-step.)
LARGEST_STEP, MOST_TIMES = 6000, 2.5

#: This many operations may be repeated for each reader of their result before it is stored.
DEAREST = 12

_NAME = "loop_over_time"


def loop_over_time(loop: Callable[[], Any]) -> Any:
    """loop(), marked: `batched_vmap` evaluates it element by element. The loop is a
    `lax.while_loop` around one `lax.scan`.
    """

    def named():
        return loop()

    named.__name__ = _NAME
    return jax.jit(named)()


def batched_vmap(
    function: Callable[..., Any], in_axes: Sequence[int | None] | int = 0
) -> Callable[..., Any]:
    """`jax.vmap(function, in_axes)` for axes that are 0 or None, each of a whole argument; every
    output has the lanes first.

    Where the program has a form that is not known here, it is `jax.vmap` itself, and a
    `RuntimeWarning` says so once.
    """

    def mapped(*args: Any) -> Any:
        try:
            return laid_out(function, in_axes)(*args)
        except Exception as error:
            # Whatever is wrong with the function itself, `jax.vmap` says better.
            out = jax.vmap(function, in_axes if isinstance(in_axes, int) else tuple(in_axes))(*args)
            _note(f"{type(error).__name__}: {error}")
            return out

    return mapped


def laid_out(
    function: Callable[..., Any], in_axes: Sequence[int | None] | int = 0
) -> Callable[..., Any]:
    """As `batched_vmap`, but raises where the program has a form that is not known here."""

    def mapped(*args: Any) -> Any:
        axes = [in_axes] * len(args) if isinstance(in_axes, int) else in_axes
        flat, tree = jax.tree.flatten(args)
        batched: list[bool] = []
        for a, axis in zip(args, axes, strict=True):
            batched += [axis is not None] * len(jax.tree.leaves(a))
        flat = [jnp.asarray(a) for a in flat]
        lane = [
            jax.ShapeDtypeStruct(a.shape[b:], a.dtype) for a, b in zip(flat, batched, strict=True)
        ]
        closed, shape = jax.make_jaxpr(
            lambda *x: function(*jax.tree.unflatten(tree, x)), return_shape=True
        )(*lane)
        lanes = next(a.shape[0] for a, b in zip(flat, batched, strict=True) if b)
        out = _Lanes(lanes).run(closed, [Value(a, b) for a, b in zip(flat, batched, strict=True)])
        return jax.tree.unflatten(jax.tree.structure(shape), [spread(v, lanes) for v in out])

    return mapped


_noted: list[str] = []


def _note(reason: str) -> None:
    """Says once in a process that lanes are mapped by `jax.vmap`."""
    if not _noted:
        _noted.append(reason)
        told = (
            f"JAX {jax.__version__} writes programs in a form that jaxid does not know"
            f" ({reason.splitlines()[0][:200]})"
        )
        warnings.warn(
            f"{told}; the numbers are the same, but it takes longer", RuntimeWarning, stacklevel=4
        )


ELEMENTWISE = frozenset(
    "add sub mul div rem neg sign abs max min floor ceil round exp exp2 expm1 log log1p sqrt rsqrt"
    " cbrt square pow integer_pow tanh sin cos tan asin acos atan atan2 sinh cosh asinh acosh atanh"
    " logistic erf erfc erf_inv is_finite nextafter not and or xor eq ne lt le gt ge select_n clamp"
    " convert_element_type add_any copy stop_gradient".split()
)
#: What XLA does not work out once more for each reader.
EXPENSIVE = frozenset(
    "div rem sqrt rsqrt cbrt pow exp exp2 expm1 log log1p tanh sin cos tan atan2 logistic erf erfc".split()
)
REDUCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "reduce_sum": lax.add,
    "reduce_prod": lax.mul,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_and": lax.bitwise_and,
    "reduce_or": lax.bitwise_or,
}


def _worth_it(jaxpr: Jaxpr) -> bool:
    """Whether a loop over time is to be taken apart."""
    elements, operations = _work(jaxpr)
    return elements <= max(LARGEST_STEP, MOST_TIMES * operations)


def _work(jaxpr: Jaxpr) -> tuple[int, int]:
    """Operations on elements, were all small arrays taken apart, and operations as they are."""
    elements, operations = 0, len(jaxpr.eqns)
    for eqn in jaxpr.eqns:
        sizes = [size_of(v) for v in eqn.outvars]
        elements += sum(size for size in sizes if size <= SMALL)
        for inner in filter(is_program, eqn.params.values()):
            inside = _work(inner.jaxpr)
            elements += inside[0]
            operations += inside[1]
    return elements, operations


class _Lanes:
    """Evaluates programs of one lane for many: as `jax.vmap` does it at level 0; taken apart at
    level 1, in a loop over time, and at level 2, in its steps.
    """

    def __init__(self, lanes: int, level: int = 0):
        self.lanes, self.level = lanes, level
        #: An element's id -> itself, and how many operations lead to it from what is stored.
        self._costs: dict[int, tuple[Any, int]] = {}

    def run(self, closed: ClosedJaxpr, args: Sequence[Value]) -> list[Value]:
        env: dict[Any, Value] = dict(
            zip(closed.jaxpr.constvars, (Value(c, False) for c in closed.consts), strict=True)
        )
        env.update(zip(closed.jaxpr.invars, args, strict=True))

        def constant(v):
            return Value(jnp.asarray(v.val, v.aval.dtype), False)

        def read(v):
            return constant(v) if is_literal(v) else env[v]

        readers: Counter[Any] = Counter()
        for eqn in closed.jaxpr.eqns:
            readers.update(v for v in eqn.invars if not is_literal(v))
        for eqn in closed.jaxpr.eqns:
            values = self._equation(eqn, [read(v) for v in eqn.invars])
            for v, value in zip(eqn.outvars, values, strict=True):
                value.checked(eqn, v.aval)
                env[v] = self._stored(value) if readers[v] > 1 and value.parted else value
        return [read(v) for v in closed.jaxpr.outvars]

    def _stored(self, v: Value) -> Value:
        """XLA works a cheap value out once for each of its readers: what took many operations is
        stored.
        """
        stored = {
            id(e): fence(e)
            for e in v.content.ravel()
            if self._cost(e) > DEAREST and e.dtype == jnp.float64
        }
        if not stored:
            return v
        return Value(
            filled(v.content.shape, [stored.get(id(e), e) for e in v.content.ravel()]), True
        )

    def _cost(self, element: Any) -> int:
        return self._costs.get(id(element), (None, 0))[1]

    def _equation(self, eqn: JaxprEqn, args: list[Value]) -> list[Value]:
        if not any(a.batched for a in args):
            contents = [a.content for a in args]
            return [Value(x, False) for x in bound(eqn, contents)]
        inner = called(eqn)
        if inner is None:
            return self._primitive(eqn, args)
        marked = self.level == 0 and eqn.params.get("name") == _NAME
        if marked and _worth_it(inner.jaxpr):
            return self._inside(inner, args)
        return self.run(inner, args)

    def _primitive(self, eqn: JaxprEqn, args: list[Value]) -> list[Value]:
        """An operation that is no program of its own, on values of which some have lanes."""
        name = eqn.primitive.name
        if name == "dynamic_update_slice" and not any(a.batched for a in args[2:]):
            return [self._updated(args)]
        if self.level == 0:
            return self._mapped(eqn, args)
        if name == "while":
            return self._while(eqn, args)
        if name == "scan" and self.level == 1:
            return self._scan(eqn, args)
        if all(size_of(v) <= SMALL for v in (*eqn.invars, *eqn.outvars)):
            found = self._by_elements(eqn, args)
            if found is not None:
                return [Value(x, True) for x in found]
        return [self._apart(v) for v in self._mapped(eqn, args)]

    def _inside(self, inner: ClosedJaxpr, args: list[Value]) -> list[Value]:
        """A program whose small arrays are taken apart."""
        inside = _Lanes(self.lanes, 1)
        found = inside.run(inner, [inside._apart(a) for a in args])
        return [Value(whole_of(v, self.lanes), v.batched) for v in found]

    def _updated(self, args: list[Value]) -> Value:
        """An update at the same place in every lane."""
        whole, part = spread(args[0], self.lanes), spread(args[1], self.lanes)
        at = [a.content for a in args[2:]]
        updated = lax.dynamic_update_slice(whole, part, [jnp.zeros_like(at[0]), *at])
        return self._apart(Value(updated, True))

    def _apart(self, v: Value) -> Value:
        small = v.batched and not v.parted and int(np.prod(v.content.shape[1:])) <= SMALL
        return Value(parts_of(v), True) if small and self.level else v

    def _mapped(self, eqn: JaxprEqn, args: list[Value]) -> list[Value]:
        """As `jax.vmap` does it."""
        axes = tuple(0 if a.batched else None for a in args)
        run = jax.vmap(lambda *x: bound(eqn, x), axes)
        found = run(*(whole_of(a, self.lanes) for a in args))
        return [Value(x, True) for x in found]

    def _together(self, operation: Callable[..., Any], *elements: Any) -> Any:
        """An operation on elements, of which some may be the same for all lanes."""
        cost = 1 + sum(map(self._cost, elements))
        if not any(e.ndim for e in elements):
            return operation(*elements)
        result = operation(*(jnp.broadcast_to(e, (self.lanes,)) for e in elements))
        self._costs[id(result)] = result, cost
        return result

    def _by_elements(self, eqn: JaxprEqn, args: list[Value]) -> list[np.ndarray] | None:
        """Results taken apart; None where this primitive is not done that way."""
        name, params = eqn.primitive.name, eqn.params
        if name not in ELEMENTWISE and not plain(eqn):
            return None
        arrays = [parts_of(a) for a in args]
        if name in ELEMENTWISE:
            return [self._elementwise(eqn, arrays)]
        if name in REDUCTIONS:
            axes = tuple(map(int, params["axes"]))
            return [self._reduced(REDUCTIONS[name], arrays[0], axes)]
        if name == "dot_general":
            return self._product(params["dimension_numbers"], arrays)
        return rearranged(name, params, arrays)

    def _elementwise(self, eqn: JaxprEqn, arrays: list[np.ndarray]) -> np.ndarray:
        done: dict[tuple[int, ...], Any] = {}

        def operation(*x):
            return eqn.primitive.bind(*x, **eqn.params)

        out = np.empty(np.broadcast_shapes(*(a.shape for a in arrays)), object)
        wide = [np.broadcast_to(a, out.shape) for a in arrays]
        for place in np.ndindex(out.shape):
            elements = tuple(a[place] for a in wide)
            key = tuple(map(id, elements))  # what was broadcast is worked out once
            if key not in done:
                done[key] = self._together(operation, *elements)
                if eqn.primitive.name in EXPENSIVE:
                    self._costs.pop(id(done[key]), None)
            out[place] = done[key]
        return out

    def _reduced(self, operation: Any, array: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
        fold = functools.partial(self._together, operation)
        kept = tuple(k for k in range(array.ndim) if k not in axes)
        shape = tuple(array.shape[k] for k in kept)
        rows = array.transpose(*kept, *axes).reshape(*shape, -1)
        rows = rows.reshape(-1, rows.shape[-1])
        return filled(shape, [functools.reduce(fold, row) for row in rows])

    def _product(self, dimension_numbers: Any, arrays: list[np.ndarray]) -> list[np.ndarray] | None:
        (left, right), batch = dimension_numbers
        if len(left) != 1 or batch != ((), ()):
            return None
        a, b = np.moveaxis(arrays[0], left[0], -1), np.moveaxis(arrays[1], right[0], -1)
        add = functools.partial(self._together, lax.add)
        multiply = functools.partial(self._together, lax.mul)
        sums = []
        for x, y in itertools.product(a.reshape(-1, a.shape[-1]), b.reshape(-1, b.shape[-1])):
            sums.append(functools.reduce(add, list(map(multiply, x, y))))
        return [filled((*a.shape[:-1], *b.shape[:-1]), sums)]

    def _while(self, eqn: JaxprEqn, args: list[Value]) -> list[Value]:
        p, (nc, nb) = eqn.params, while_counts(eqn)
        asked, done, init = args[:nc], args[nc : nc + nb], args[nc + nb :]
        flags = settled(p["body_jaxpr"].jaxpr, [a.batched for a in done], [a.batched for a in init])
        each = dependent(p["cond_jaxpr"].jaxpr, [*(a.batched for a in asked), *flags])[
            0
        ]  # lanes end one by one
        state = LoopState.of(p["body_jaxpr"].in_avals[nb:], [True] * len(init) if each else flags)

        def goes_on(values: list[Value]) -> Array:
            (v,) = self.run(p["cond_jaxpr"], [*asked, *values])
            return jnp.broadcast_to(whole_of(v, self.lanes), (self.lanes,)) if each else v.content

        def body(carry: tuple[Array, list[Array]]) -> tuple[Array, list[Array]]:
            on, old = carry
            new = state.arrays(self.run(p["body_jaxpr"], [*done, *state.values(old)]), self.lanes)
            if each:
                new = [
                    jnp.where(on.reshape(-1, *[1] * (a.ndim - 1)), a, b)
                    for a, b in zip(new, old, strict=True)
                ]
            going = goes_on(state.values(new))
            return on & going if each else going, new

        first = state.arrays(init, self.lanes)
        return state.values(
            lax.while_loop(lambda c: jnp.any(c[0]), body, (goes_on(state.values(first)), first))[1]
        )

    def _along(self, v: Value) -> Array:
        """A series with time as its first axis."""
        return jnp.moveaxis(whole_of(v, self.lanes), 1, 0) if v.batched else v.content

    def _scan(self, eqn: JaxprEqn, args: list[Value]) -> list[Value]:
        p, (nc, n) = eqn.params, scan_counts(eqn)
        consts, init, xs = args[:nc], args[nc : nc + n], args[nc + n :]
        inside = _Lanes(self.lanes, 2)
        flags = list(map(batched_flags, (consts, init, xs)))
        state = LoopState.of(p["jaxpr"].in_avals[nc : nc + n], settled(p["jaxpr"].jaxpr, *flags))
        series: list[
            tuple[tuple[int, ...], bool]
        ] = []  # of what each step gives: shape if it is taken apart, batched

        def step(carry: list[Array], x: list[Array]) -> tuple[list[Array], list[list[Array]]]:
            now = [inside._apart(Value(a, v.batched)) for a, v in zip(x, xs, strict=True)]
            out = inside.run(p["jaxpr"], [*consts, *state.values(carry), *now])
            given = []
            series.clear()
            for v in out[n:]:
                series.append((v.content.shape if v.parted else (), v.batched))
                given.append(
                    [jnp.broadcast_to(e, (self.lanes,)) for e in v.content.ravel()]
                    if v.parted
                    else [v.content]
                )
            return state.arrays(out[:n], self.lanes), given

        along = [self._along(v) for v in xs]
        first = state.arrays(init, self.lanes)
        last, ys = lax.scan(step, first, along, p["length"], p["reverse"], p["unroll"])
        found = []
        for (shape, batched), y in zip(series, ys, strict=True):
            if batched and (len(y) > 1 or shape):
                whole = jnp.stack(y, 2)  # [time lanes elements]
                found.append(
                    Value(jnp.moveaxis(whole, 1, 0).reshape(self.lanes, p["length"], *shape), True)
                )
            else:
                found.append(Value(jnp.moveaxis(y[0], 1, 0) if batched else y[0], batched))
        return [*state.values(last), *found]
