"""Sizes at which effects on the way from a goal to its torque are asked for, and their units."""

from __future__ import annotations

import numpy as np

from jaxid.diagnosis.torque.library import Unit
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.parameter import Bound, resolve, specs
from jaxid.problem.binding import Binding


#: A number that is neutral from here on is a limit; shares of the time in which the drive stays
#: below those that are asked for.
ENDLESS, LEVELS = 1e9, (0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999)


def is_level(kind: type[Effect]) -> bool:
    """Whether an effect is a level beyond which a command does not go: it shows at levels that this
    motion reaches.
    """
    own = specs(kind)
    return len(own) == 1 and all(s.log and float(s.value) >= ENDLESS for s in own.values())


def at_levels(kind: type[Effect], levels: np.ndarray) -> list[dict[str, float]]:
    (field,) = specs(kind)
    return [{field: float(x)} for x in levels if x > 0]


def probes_of(b: Binding, kind: type[Effect], place: int) -> list[dict[str, float]]:
    reference = b.reference(kind, place)
    own = specs(kind)

    def within(field: str, value: Bound) -> float:
        """A probe that the bounds allow: the numbers of a law that are not fitted here stay as they
        are probed.
        """
        if field not in own:
            return float(resolve(value, reference))
        lower, upper = resolve(own[field].lower, reference), resolve(own[field].upper, reference)
        return float(np.clip(resolve(value, reference), lower, upper))

    found = [{f: within(f, v) for f, v in probe.items()} for probe in kind.probes]
    return [dict(x) for x in dict.fromkeys(tuple(p.items()) for p in found)]


def scaled(
    kind: type[Effect], place: str, shape: dict[str, float], joint: int, made: list[np.ndarray]
) -> Unit:
    """A unit whose number is the effect's first, or how much of it there is where that is not 0
    where it does nothing.
    """
    field, value = next(iter(shape.items()))
    own = specs(kind)
    strong = own[field].value == 0
    low = -np.inf if strong and _lower(own[field]) < 0 else 0.0
    columns = [x / value if strong else x for x in made]
    rest = {f: v for f, v in shape.items() if f != field or not strong}
    inf = np.full(1, np.inf)
    return Unit(
        effect=kind.name,
        location=place,
        fields=(field if strong else "share",),
        least=np.array([low]),
        most=inf,
        spread=inf,
        shape=rest,
        joints=(joint,),
        columns=columns,
    )


def _lower(spec) -> float:
    lower = spec.lower
    return float(lower) if isinstance(lower, int | float) else -1.0
