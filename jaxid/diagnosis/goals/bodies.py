"""What changes a robot's mechanism as columns: loads, and a base that stands askew."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxid.diagnosis.goals.plant import CHANGED
from jaxid.diagnosis.torque.library import MOMENT, Unit
from jaxid.diagnosis.torque.plant import inverse_of
from jaxid.diagnosis.torque.rows import TorqueRun
from jaxid.dynamics.effect import Effect, neutral
from jaxid.dynamics.parameter import resolve, specs, with_fields
from jaxid.problem.binding import Binding


#: Distance (m) over which the derivative by where a load sits is taken: exact, for it is quadratic.
ARM = 1e-2
#: A place of a load that shows by less than this share of another one shows by rounding alone.
UNSEEN = 1e-8


def shifts_body(kind: type[Effect]) -> bool:
    """Whether an effect is a load, or a base that stands askew."""
    return kind.quantity() in ("inertial", "gravity")


def body_units(b: Binding, runs: Sequence[TorqueRun], kind: Any, theta: np.ndarray) -> list[Unit]:
    """What changes the mechanism along some runs, to first order in each of its numbers, or in a
    mass times where it sits.
    """
    out, places = [], b.chain.places(kind)
    moments = getattr(kind, "moments", ())
    own = {f: s for f, s in specs(kind).items() if f not in moments}
    mechanism = b.layout.form.model(theta).mechanism
    for place in b.chain.offers(kind):
        j = places.index(place)
        reference = b.reference(kind, j)

        # noqa: B023
        def force(r, **numbers):
            return inverse_of(_with_body(kind, len(places), j, numbers)(mechanism), r)

        steps = {f: CHANGED * float(resolve(s.scale, reference)) for f, s in own.items()}
        columns = []
        for r in runs:
            made = [(force(r, **{f: h}) - force(r)) / h for f, h in steps.items()]
            for f in moments:
                low, high = (force(r, mass=1.0, **{f: h}) for h in (-ARM, ARM))
                made.append((high - low) / (2 * ARM))
            columns.append(np.stack(made, 2))
        size = np.max([np.linalg.norm(c, axis=(0, 1)) for c in columns], 0)
        first = len(own)
        # Where all axes are alike, a load may sit anywhere along them.
        kept = [k for k in range(len(size)) if k < first or size[k] > UNSEEN * size[first:].max()]
        fields = tuple(
            name for k, name in enumerate((*own, *(f"{MOMENT}{f}" for f in moments))) if k in kept
        )
        low, high = (
            np.array([resolve(getattr(s, k), reference) for s in own.values()])
            for k in ("lower", "upper")
        )
        free = np.full(len(fields) - first, np.inf)
        if any(map(np.any, columns)):
            bounds = np.concatenate([low, -free]), np.concatenate([high, free])
            infinite = np.full(len(fields), np.inf)
            shown = [c[:, :, kept] for c in columns]
            out.append(
                Unit(
                    kind.name, place, fields, *bounds, infinite, {}, tuple(range(b.chain.nq)), shown
                )
            )
    return out


def _with_body(kind: Any, n: int, place: int, numbers: dict[str, float]) -> Any:
    """A body effect with some numbers at one place."""
    effect = neutral(kind)
    own = {f: np.full(n, float(s.value)) for f, s in specs(effect).items()}
    for field, value in numbers.items():
        own[field][place] += value
    return with_fields(effect, own)
