"""Every effect that the torque of a measured motion can show, as columns: one unit is one effect at
one place with one shape.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.diagnosis.torque.plant import ArmPlant, Beside, Plant
from jaxid.diagnosis.torque.rows import TorqueRun
from jaxid.dynamics.base_parameters import standard_torque
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import BodyEffect, Effect, InputEffect, JointEffect, neutral
from jaxid.dynamics.parameter import resolve, specs, with_fields
from jaxid.dynamics.rigid_body import INERTIA
from jaxid.force.effects import (
    at_every_joint,
    coupled,
    Load,
    shapes,
    strengths,
    with_numbers,
)
from jaxid.numerics.kept import shared
from jaxid.numerics.precision import float64
from jaxid.problem.binding import Binding


#: What a body at a link adds: a mass, then its first moments and inertia about the origin of the
#: link's frame.
BODY = ("mass", "mx", "my", "mz", *INERTIA[:6])
#: What a field of a unit begins with that is a mass times where it sits.
MOMENT = "mass "
#: Tilt (rad) over which the derivative of gravity is taken, and inertia (kg m^2, kg) over which
#: that of a load.
TILT = 1e-3


@dataclass(frozen=True, eq=False)
class Unit:
    """An effect at a place: rows of its columns [samples n k] in each run, one for each of
    `fields`. `least`, `most`: bounds of each; `spread`: what is known of its size beforehand,
    infinite where nothing is; `hidden`: numbers that only make room.
    """

    effect: str
    location: str
    fields: tuple[str, ...]
    least: np.ndarray
    most: np.ndarray
    spread: np.ndarray
    shape: dict[str, float]
    joints: tuple[int, ...]
    columns: list[np.ndarray]
    hidden: tuple[str, ...] = ()
    #: Of how many shapes it is the one that explains most.
    tried: int = 1

    @property
    def place(self) -> tuple[str, str]:
        return self.effect, self.location

    @property
    def owner(self) -> tuple[str, str]:
        """The effect and the place that its numbers are called by: of two joints that share a gear
        the first.
        """
        return self.effect, self.location.partition(" and ")[0]

    def __str__(self) -> str:
        return f"{self.effect} at {self.location}"


def shows(kind: type[Effect], chain: Chain) -> bool:
    """Whether the torque of a measured motion can show an effect."""
    if issubclass(kind, JointEffect):
        return any(s.value == 0 for s in specs(kind).values())
    if issubclass(kind, BodyEffect):
        return not chain.with_effects(neutral(kind)).stateful()[-1]
    return issubclass(kind, InputEffect) and kind.column is not None and chain.direct


def units(
    plant: Plant,
    kinds: Iterable[type[Effect]],
    runs: Sequence[TorqueRun],
    theta: np.ndarray,
    payloads: bool,
    beside: Sequence[Beside] | None = None,
) -> list[Unit]:
    """All units of these effects, along what the model takes with the numbers theta and beside what
    is known of each run's gears; `payloads`: whether bodies at the links of an arm can be told from
    the arm's own, because its own are known.
    """
    known = [None] * len(runs) if beside is None else beside
    load = [plant.load(r, theta, own) for r, own in zip(runs, known, strict=True)]
    out: list[Unit] = []
    for kind in kinds:
        places = plant.binding.chain.offers(kind)
        if issubclass(kind, JointEffect):
            of_joints = _shared if kind.couples else laws
            out += of_joints(plant, kind, places, runs, load)
        elif issubclass(kind, BodyEffect):
            out += _bodies(plant, kind, places, runs, theta, payloads)
        else:
            out += _driven(plant, kind, places, runs, theta)
    return out


def _unit(
    kind: type[Effect],
    place: str,
    fields: Sequence[str],
    shape: dict[str, float],
    joints: Sequence[int],
    columns: list[np.ndarray],
    binding: Binding,
) -> Unit:
    reference = binding.reference(kind, joints[0])
    own = specs(kind)
    low, high = np.zeros(len(fields)), np.full(len(fields), np.inf)
    for k, field in enumerate(fields):
        if field in own:
            low[k] = resolve(own[field].lower, reference)
            high[k] = resolve(own[field].upper, reference)
    return Unit(
        effect=kind.name,
        location=place,
        fields=tuple(fields),
        least=low,
        most=high,
        spread=np.full(len(fields), np.inf),
        shape=shape,
        joints=tuple(joints),
        columns=columns,
    )


def _placed(rows: Sequence[np.ndarray], joint: int) -> list[np.ndarray]:
    """Columns [samples n k] of each run that act on one joint alone, where rows [samples n k] have
    those of every joint.
    """
    placed = []
    for every in rows:
        own = np.zeros(every.shape)
        own[:, joint] = every[:, joint]
        placed.append(own)
    return placed


def laws(
    plant: Plant,
    kind: Any,
    places: Sequence[str],
    runs: Sequence[TorqueRun],
    load: Sequence[Load],
    grids: Sequence[Sequence[dict[str, float]]] | None = None,
    tried: int = 1,
) -> list[Unit]:
    """A law of each joint's own motion, at every point of its grid, or of each joint's in `grids`,
    each of which is the best of so many that were `tried`.
    """
    b, n = plant.binding, plant.binding.chain.nq
    joints = [b.chain.signature.joints.index(p) for p in places]
    if not (linear := strengths(kind, n, runs[0].room)):
        return []
    if grids is None:
        grids = [shapes(kind, b.references[j], linear) for j in range(n)]
    out = []
    for k, made in enumerate(at_every_joint(kind, grids, runs, load, plant.turn)):
        room = _rotor(kind, grids, k, runs, load, plant.turn) if kind.transmits else {}
        made |= room
        rows = []
        for r, *series in zip(runs, *made.values(), strict=True):
            rows.append(np.stack([r.rows(x) for x in series], -1))
        free = np.array([field in room for field in made])
        for j, place in zip(joints, places, strict=True):
            if k < len(grids[j]):
                own = _placed(rows, j)
                unit = _unit(kind, place, list(made), grids[j][k], [j], own, b)
                least = np.where(free, -np.inf, unit.least)
                out.append(replace(unit, least=least, hidden=tuple(room), tried=tried))
    return out


def _rotor(
    kind: Any,
    grids: Sequence[Sequence[dict[str, float]]],
    k: int,
    runs: Sequence[TorqueRun],
    load: Sequence[Load],
    turn: np.ndarray,
) -> dict[str, list[np.ndarray]]:
    """Room [time n] of each run for what of an inertia is the rotor's, which a motion alone does
    not tell from the link's; none where a law looks at the drive alone.
    """
    one = [[g[min(k, len(g) - 1)]] for g in grids]

    def at(inertia: float) -> list[np.ndarray]:
        moved = [
            f._replace(transmitted=f.transmitted - inertia * r.qdd)
            for r, f in zip(runs, load, strict=True)
        ]
        ((made,),) = (found.values() for found in at_every_joint(kind, one, runs, moved, turn))
        return made

    slopes = [(b - a) / TILT for a, b in zip(at(-TILT / 2), at(TILT / 2), strict=True)]
    return {"rotor": slopes} if any(map(np.any, slopes)) else {}


def _shared(
    plant: Plant, kind: Any, places: Sequence[str], runs: Sequence[TorqueRun], load: Sequence[Load]
) -> list[Unit]:
    """A gear that a joint shares with the next: its friction, and the inertia of what turns with
    both.
    """
    b = plant.binding
    linear, out = strengths(kind, b.chain.nq, runs[0].room), []
    for place in places:
        j = b.chain.signature.joints.index(place)
        shape = shapes(kind, b.references[j], linear)[0]
        own = [coupled(kind, shape, j, r, f, plant.turn) for r, f in zip(runs, load, strict=True)]
        columns = []
        for r, x in zip(runs, own, strict=True):
            both = np.zeros_like(r.qdd)
            both[:, [j, j + 1]] = (r.qdd[:, j] + r.qdd[:, j + 1])[:, None]
            columns.append(r.rows(np.concatenate([x, both[:, :, None]], 2)))
        both = f"{place} and {b.chain.signature.joints[j + 1]}"
        out.append(_unit(kind, both, [*linear, "inertia"], shape, [j, j + 1], columns, b))
    return out


def _driven(
    plant: Plant, kind: Any, places: Sequence[str], runs: Sequence[TorqueRun], theta: np.ndarray
) -> list[Unit]:
    """What a drive makes of its command, seen from the torque that the model needs: the measured
    one would explain itself. A drive that gives nothing in any run makes nothing otherwise: a gain
    of none of it would meet any motion.
    """
    rows = [r.rows(kind.column(plant.rigid(r, theta), r.step)) for r in runs]
    field = next(iter(specs(kind)))
    names = plant.binding.chain.signature.input_names
    driven = [np.any(plant.drive(r, theta), axis=0) for r in runs]
    asked = [place for place in places if np.any(driven, axis=0)[names.index(place)]]
    return _one_by_one(kind, asked, names, field, rows, plant.binding)


def _one_by_one(
    kind: type[Effect],
    places: Sequence[str],
    names: Sequence[str],
    field: str,
    rows: Sequence[np.ndarray],
    binding: Binding,
) -> list[Unit]:
    """A unit of one column at each place, of rows [samples n] of each run that have those of every
    place in `names`.
    """
    out = []
    for place in places:
        j = names.index(place)
        columns = _placed([x[..., None] for x in rows], j)
        out.append(_unit(kind, place, [field], {}, [j], columns, binding))
    return out


def _bodies(
    plant: Plant,
    kind: type[BodyEffect],
    places: Sequence[str],
    runs: Sequence[TorqueRun],
    theta: np.ndarray,
    payloads: bool,
) -> list[Unit]:
    joints = plant.binding.chain.signature.joints
    if kind.quantity() == "armature":
        rows = [r.rows(r.qdd) for r in runs]
        return _one_by_one(kind, places, joints, "inertia", rows, plant.binding)
    if isinstance(plant, ArmPlant) and kind.quantity() == "inertial":
        links = {p: joints.index(p) for p in places}
        return _payloads(plant, kind.name, links, runs, theta) if payloads else []
    if isinstance(plant, ArmPlant) and kind.quantity() == "gravity":
        return [_tilt(plant, kind.name, joints[0], runs, theta)]
    return _derivatives(plant, kind, places, runs, theta)


def _payloads(
    plant: ArmPlant,
    effect: str,
    links: dict[str, int],
    runs: Sequence[TorqueRun],
    theta: np.ndarray,
) -> list[Unit]:
    """Any body at each of these links, by its ten numbers."""
    mass, reach = _size(plant, theta)
    spread = mass * np.array([1.0, *[reach] * 3, *[reach**2] * 6])
    free = np.full(10, np.inf)
    every = [r.rows(plant.columns(r)) for r in runs]

    def at(place: str, link: int) -> Unit:
        first = 11 * link
        order = [first + 9, *range(first + 6, first + 9), *range(first, first + 6)]
        columns = [rows[:, :, order] for rows in every]
        return Unit(
            effect=effect,
            location=place,
            fields=BODY,
            least=-free,
            most=free,
            spread=spread,
            shape={},
            joints=tuple(range(link + 1)),
            columns=columns,
        )

    return [at(place, link) for place, link in links.items()]


def _size(plant: ArmPlant, theta: np.ndarray) -> tuple[float, float]:
    """Mass (kg) and length (m) that are large for a load of this arm."""
    table = plant.arm
    reach = float(sum(np.sum(np.abs(np.asarray(getattr(table, k)))) for k in ("a", "d", "b")))
    return 30.0, max(0.3 * reach, 0.1)


def _tilt(
    plant: ArmPlant, effect: str, place: str, runs: Sequence[TorqueRun], theta: np.ndarray
) -> Unit:
    """A base that stands askew, by two angles; the first link's own moments begin to show in it."""
    n = plant.binding.chain.nq
    phi = plant.phi(theta)

    def torque(r: TorqueRun, field: str, tilt: float, numbers: np.ndarray) -> np.ndarray:
        tilted = with_fields(plant.arm, {field: np.asarray(getattr(plant.arm, field)) + tilt})
        return standard_torque(tilted, numbers, r.q, 0 * r.qd, 0 * r.qd)

    def slope(r: TorqueRun, field: str, numbers: np.ndarray) -> np.ndarray:
        rise = torque(r, field, 0.5 * TILT, numbers) - torque(r, field, -0.5 * TILT, numbers)
        return rise / TILT

    mx, my = np.eye(len(phi))[6:8]
    columns = []
    for r in runs:
        both = [slope(r, "base_roll", phi), slope(r, "base_pitch", phi)]
        moments = [slope(r, "base_roll", mx), slope(r, "base_roll", my)]
        columns.append(r.rows(np.stack([*both, *moments], -1)))
    infinite = np.full(4, np.inf)
    return Unit(
        effect=effect,
        location=place,
        fields=("roll", "pitch", "mx", "my"),
        least=-infinite,
        most=infinite,
        spread=infinite,
        shape={},
        joints=tuple(range(n)),
        columns=columns,
        hidden=("mx", "my"),
    )


def _slope(kind: type[BodyEffect], field: str) -> Any:
    """One program for all places: which one is an argument."""

    def torque(value: Any, place: Any, mechanism: Any, n: int, q: Any, qd: Any, qdd: Any) -> Any:
        effect: Any = neutral(kind)
        own = {f: jnp.full(n, s.value) for f, s in specs(effect).items()}
        own[field] = own[field].at[place].set(value)
        body = with_fields(with_numbers(effect, {}, n), own)(mechanism)
        return jax.vmap(body.inverse)(q, qd, qdd)

    def slope(place: Any, mechanism: Any, q: Any, qd: Any, qdd: Any) -> Any:
        def at(v):
            return torque(v, place, mechanism, q.shape[1], q, qd, qdd)

        return jax.jvp(at, (jnp.asarray(specs(kind)[field].value),), (jnp.ones(()),))[1]

    return jax.jit(slope)


def _derivatives(
    plant: Plant,
    kind: type[BodyEffect],
    places: Sequence[str],
    runs: Sequence[TorqueRun],
    theta: np.ndarray,
) -> list[Unit]:
    """What changes the mechanism, to first order in each of its numbers."""
    b, out = plant.binding, []
    joints = b.chain.signature.joints
    # Where there is no mass its moments do nothing.
    fields = [f for f in specs(kind) if f not in getattr(kind, "moments", ())]
    with float64():
        mechanism = b.layout.form.model(theta).mechanism
        structure = jax.tree.structure(mechanism)

        def program(f):
            return shared("slope", (kind, f, structure), lambda: _slope(kind, f))

        for place in places:
            columns, j = [], joints.index(place)
            for r in runs:
                series = [r.padded(x) for x in (r.q, r.qd, r.qdd)]
                made = [np.asarray(program(f)(j, mechanism, *series))[: len(r.q)] for f in fields]
                columns.append(r.rows(np.stack(made, -1)))
            if any(map(np.any, columns)):
                out.append(_unit(kind, place, fields, {}, tuple(range(b.chain.nq)), columns, b))
    return out
