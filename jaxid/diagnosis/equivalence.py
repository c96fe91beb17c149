"""Which effects of the library a model cannot tell apart, and which its own parameters absorb.

Nothing is listed by hand: the model moves under a rich command of its own, each effect is switched
on at its probe strengths, and what re-tuning the model's parameters and its unknown start could do
to first order is taken out of the change. Effects whose changes are parallel are then fitted to
each other's recordings.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import names_of
from jaxid.data.dataset import Dataset
from jaxid.diagnosis.goals.equivalence import alike_under_goals
from jaxid.diagnosis.goals.run import led
from jaxid.diagnosis.hypothesis import Candidate, candidates, probes_of
from jaxid.diagnosis.last_resort import first_asked
from jaxid.diagnosis.screen import probe_residuals, Retuning
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.mechanism import Signature
from jaxid.fitting.effect_starts import probes
from jaxid.fitting.many_starts import search
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import bind, Binding
from jaxid.problem.problem import FitProblem, rows
from jaxid.problem.residual import OutputError
from jaxid.robots.match import is_file, robot_from


#: A weak effect is this share of a probe: what a first-order re-tuning leaves of one that is
#: absorbed exactly goes with its strength, what it cannot absorb does not.
WEAK = 5e-5
#: Re-tuning to first order leaves less than this share of a weak effect that it absorbs exactly.
ABSORBED = 10 * WEAK
RATE, SECONDS = 200, 5.0
#: The motion that is compared on travels so far at most (rad, m).
TRAVEL = 2.5


@dataclass(frozen=True)
class Place:
    """An effect at a location, and the share of its change that re-tuning leaves."""

    effect: str
    location: str
    left: float

    def __str__(self) -> str:
        return f"{self.effect} at {self.location}"


@dataclass(frozen=True)
class Equivalences:
    """What `jaxid effects --model M` says. Effects that are in no list can be told from every other
    one.
    """

    model: str
    excitation: str
    absorbed: tuple[Place, ...]
    invisible: tuple[Place, ...]
    classes: tuple[tuple[Place, ...], ...]

    def to_dict(self) -> dict[str, Any]:
        def plain(places):
            return [{"effect": p.effect, "location": p.location, "left": p.left} for p in places]

        return {
            "schema": 1,
            "kind": "equivalences",
            "model": self.model,
            "excitation": self.excitation,
            "absorbed": plain(self.absorbed),
            "invisible": plain(self.invisible),
            "equivalent": [plain(c) for c in self.classes],
        }

    def __str__(self) -> str:
        lines = [
            f"{self.model}: {self.excitation}",
            "",
            "cannot be told apart (each line one class):",
        ]
        lines += [f"  {', '.join(map(str, c))}" for c in self.classes] or ["  none"]
        lines += ["", "absorbed by the model's own parameters or its unknown start:"]
        lines += [f"  {p} ({100 * (1 - p.left):.1f} %)" for p in self.absorbed] or ["  none"]
        lines += ["", "without any influence here:"]
        lines += [f"  {p}" for p in self.invisible] or ["  none"]
        lines += [
            "",
            "Weak effects are alike more often, and a poor excitation makes more classes.",
        ]
        return "\n".join(lines)


def equivalences(model: str, without: Sequence[str] = ()) -> Equivalences:
    """Equivalent and absorbed effects of a model at its default parameters, without controller,
    every output measured; `without` takes built-in ones out of the model, which are then candidates
    too.

    Raises `UsageError` for an unknown model and for one that has no moderate motion at its
    defaults.
    """
    from jaxid.dynamics import catalogue

    if is_file(model):
        owner = robot_from(model, getattr(model, "tip", None))
    else:
        owner = catalogue.model_class(model)()
    chain = Chain(owner).without(*without)
    kinds = [catalogue.effect_class(n, owner) for n in first_asked() if n not in chain.contents]
    library = [k for k in kinds if chain.offers(k)]
    data, text = _rich_motion(chain, model, owner)
    if led(chain):
        return _under_goals(bind(owner, data, without=without, splits=False), library, model, text)
    binding = bind(owner, data, without=without, candidates=library, splits=False)
    bench = ProblemBuilder(binding)
    theta = _with_friction(binding)
    p = bench.problem(OutputError(), "fit", binding.free, theta)
    z = p.z(theta)
    pool = candidates(bench, tuple(names_of(library)))
    absorbed, invisible = [], []
    seen: dict[Place, tuple[np.ndarray, Candidate]] = {}
    for c, reaction in zip(pool, _reactions(bench, p, z, theta, pool), strict=True):
        place = Place(c.effect, c.location, max(reaction.left, default=1.0))
        if not reaction.acts:
            invisible.append(Place(c.effect, c.location, 0.0))
        elif reaction.left and place.left < ABSORBED:
            absorbed.append(place)
        else:
            seen[place] = np.array(reaction.directions), c
    pairs = dict.fromkeys((*_parallel(seen), *_resembling(bench, seen)))
    alike = set()
    for first, second in pairs:
        a, b = seen[first][1], seen[second][1]
        if _explains(bench, p, z, a, b) and _explains(bench, p, z, b, a):
            alike.add(frozenset((first, second)))
    return Equivalences(model, text, tuple(absorbed), tuple(invisible), _classes(list(seen), alike))


class _Reaction(NamedTuple):
    """What probes of an effect change: whether anything at all, and of weak ones what re-tuning
    leaves: the direction of each [samples] and its share of the change.
    """

    acts: bool
    directions: list[np.ndarray]
    left: list[float]


def _reactions(
    bench: ProblemBuilder,
    p: FitProblem,
    z: np.ndarray,
    theta: np.ndarray,
    pool: Sequence[Candidate],
) -> list[_Reaction]:
    """How the recording reacts to each of the effects."""
    parts = list(rows([(p, z)]))
    base = np.concatenate([part.r.ravel() for part in parts])
    remaining = Retuning(parts, p.size).remaining
    weight = float(np.mean([part.w.max() for part in parts]))
    sigma = float(np.max(bench.binding.sigma))
    noise = 1e-7 * np.sqrt(base.size) * weight * sigma * 1e3
    shapes = bench.binding.layout.shapes
    thetas: list[np.ndarray] = []
    counts = []
    for c in pool:
        probed = probes_of(bench, c, theta)
        counts.append(len(probed))
        for full in probed:
            thetas += [full, np.where(shapes, full, theta + WEAK * (full - theta))]
    found = iter(probe_residuals(p, z, thetas))
    reactions = []
    for count in counts:
        acts, directions, left = False, [], []
        for _ in range(count):
            strong, weak = next(found) - base, next(found) - base
            acts |= noise <= np.linalg.norm(strong) < np.inf
            size = float(np.linalg.norm(weak))
            if noise * WEAK <= size < np.inf:
                rest = remaining(weak)
                length = float(np.linalg.norm(rest))
                directions.append(rest / max(length, 1e-300))
                left.append(length / size)
        reactions.append(_Reaction(bool(acts), directions, left))
    return reactions


def _under_goals(
    binding: Binding, library: Sequence[type[Effect]], model: str, text: str
) -> Equivalences:
    """Of a robot that goals drive."""
    left, alike, apart = alike_under_goals(binding, library)
    places = {key: Place(*key, share) for key, share in left.items()}
    pairs = {frozenset(map(places.__getitem__, pair)) for pair in alike}
    absorbed = tuple(p for p in places.values() if p.left <= LIMITS.equivalent)
    text += (
        "; to first order; not compared, for they have a motion of their own:"
        f" {', '.join(apart) or 'none'}"
    )
    return Equivalences(
        model,
        text,
        absorbed,
        (),
        _classes([p for p in places.values() if p.left > LIMITS.equivalent], pairs),
    )


def _parallel(seen: dict[Place, tuple[np.ndarray, Candidate]]) -> list[tuple[Place, Place]]:
    """Pairs whose weak changes [probes samples] point the same ways."""
    out = []
    for first, second in itertools.combinations(seen, 2):
        a, b = seen[first][0], seen[second][0]
        if a.size and b.size:
            cosines = np.abs(a @ b.T)
            if min(cosines.max(1).min(), cosines.max(0).min()) > 1 - LIMITS.equivalent:
                out.append((first, second))
    return out


def _resembling(
    bench: ProblemBuilder, seen: dict[Place, tuple[np.ndarray, Candidate]]
) -> list[tuple[Place, Place]]:
    """Pairs that say of themselves that they may be alike when they are strong."""
    others = {e.name: e.resembles for e in bench.binding.chain.effects}
    pairs = itertools.combinations(seen, 2)
    return [
        (a, b)
        for a, b in pairs
        if a.location == b.location
        and (b.effect in others[a.effect] or a.effect in others[b.effect])
    ]


def _explains(
    bench: ProblemBuilder, p: FitProblem, z: np.ndarray, truth: Candidate, other: Candidate
) -> bool:
    """Whether the model with one effect follows the recording that the other one makes."""
    made = p.runs.engine.outputs(
        np.array([probes_of(bench, truth, p.theta(z))[-1]]), p.starts(z), np.array(p.records)
    )[0]
    (number,) = p.records
    record = p.runs.record(number)
    targets = p.runs.targets.copy()
    targets[record.offset : record.offset + record.count] = made[: record.count]
    left = []
    for free, starts in (
        (list(p.free), [p.theta(z)]),
        ([*p.free, *other.index], probes_of(bench, other, p.theta(z))),
    ):
        problem = bench.problem(OutputError(), "fit", free, starts[0])
        problem.targets = targets
        (path,), _ = search([[(problem, problem.z(theta)) for theta in starts]], 25, 1e-10)
        left.append(path.cost)
    return bool(left[1] < LIMITS.equivalent**2 * left[0])


def _classes(places: list[Place], alike: set[frozenset[Place]]) -> tuple[tuple[Place, ...], ...]:
    """Groups of places that are alike, one by one or through others."""
    out = []
    while places:
        group = [places.pop(0)]
        for member in group:
            mates = [p for p in places if frozenset((member, p)) in alike]
            group += mates
            places = [p for p in places if p not in mates]
        if len(group) > 1:
            out.append(tuple(group))
    return tuple(out)


def _rich_motion(chain: Chain, model: str, owner: Any) -> tuple[Dataset, str]:
    """A command of sines, steps and rests as strong as keeps the motion within about a radian (or
    metre), and its recording.
    """
    from jaxid.fitting.simulate import own_numbers, simulate_dataset

    t = np.arange(int(RATE * SECONDS)) / RATE
    signature = chain.signature
    shape = _shape(t, signature.input_names)
    content = own_numbers(chain) | {"effects": []}
    best, limit = None, TRAVEL
    for strength in 10.0 ** np.arange(-3, 4.1, 0.5) if shape else [1.0]:
        inputs = _command(t, shape, signature, strength)
        still = {n: np.sin(t) for n in dict(signature.outputs)}
        run = simulate_dataset(content, _recording(t, inputs, still, chain, model), owner).runs[0]
        y = {n: np.asarray(run[n]) for n in dict(signature.outputs)}
        spread = max(float(np.ptp(y[j])) for j in signature.joints if j in y)
        if best is None:  # what falls by itself moves more
            limit = max(limit, 1.2 * min(spread, 2 * np.pi))
        if not np.isfinite(spread) or spread > limit:
            break
        best = inputs, y, spread
    if best is None or best[2] < 1e-6:
        raise UsageError(
            f"{model} has no moderate motion at its default parameters, so nothing can be compared"
        )
    law = getattr(owner, "drive_law", None)
    how = "open loop" if law is None else law.text
    text = (
        f"sines of 0.3 to 8 Hz, steps and rests, {SECONDS:g} s at {RATE} Hz, travel {best[2]:.2g},"
        f" {how}, from rest"
    )
    # What stands still by design has another signature without it.
    moving = {n: v for n, v in best[1].items() if np.ptp(v)}
    return _recording(t, best[0], moving, chain, model), text


def _shape(t: np.ndarray, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Sines, steps and rests [time] of about 1 for each input."""
    rng = np.random.default_rng(0)
    shape = {}
    for name in names:
        frequencies = rng.uniform(0.3, 8.0, 10)
        sines = [
            np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) / np.sqrt(f) for f in frequencies
        ]
        u = np.sum(sines, 0) / 2.5
        for _ in range(4):
            a = int(rng.integers(40, t.size - 120))
            u[a : a + int(rng.integers(30, 100))] = rng.choice([-1.0, 0.0, 0.0, 1.0])
        u[:20] = 0.0
        shape[name] = u
    return shape


def _command(
    t: np.ndarray, shape: dict[str, np.ndarray], signature: Signature, strength: float
) -> dict[str, np.ndarray]:
    """The inputs [time] at a strength; a switch is on."""
    command = {}
    for name, unit in signature.inputs:
        command[name] = np.ones_like(t) if unit == "1" else strength * shape[name]
    return command


def _recording(
    t: np.ndarray,
    inputs: dict[str, np.ndarray],
    outputs: dict[str, np.ndarray],
    chain: Chain,
    model: str,
) -> Dataset:
    """A run from rest, as a dataset."""
    units = dict((*chain.signature.inputs, *chain.signature.outputs))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a switch that stays on is meant
        return Dataset.from_arrays(
            t,
            inputs,
            outputs,
            units={n: units[n] for n in (*inputs, *outputs)},
            noise_std={n: max(1e-3 * float(np.std(v)), 1e-9) for n, v in outputs.items()},
            at_rest=True,
            split="fit",
            check_model=False,
            model=None if is_file(model) else model,
        )


def _with_friction(binding: Binding) -> np.ndarray:
    """Default numbers, with a little of the friction that the model has."""
    theta = binding.theta.copy()
    for effect in filter(lambda e: e.probes, binding.chain.effects):
        for place in binding.chain.places(effect):
            index = binding.layout.of_effect(effect.name, place)
            starts_the_run = np.any(binding.lower[index] < 0)  # an offset, by itself
            own = index and set(index) <= binding.nominal
            if own and not starts_the_run and not np.any(theta[index]):
                theta = probes(binding, effect, place, theta)[0]
    return theta
