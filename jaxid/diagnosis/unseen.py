"""What a model without a gap may still lack: effects that the recordings would not show, and signs
below the noise as a whole.

An effect that re-tuning hides, or that the motion never stirs, leaves no residual. Which ones these
are can be computed: each is switched on at its probes, the model with it is re-tuned to the plain
model's own simulation of the same runs, and what is left between the two is compared with the
noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import chdtrc

from jaxid.diagnosis.evidence import knowledge, memory
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis, probes_of_all
from jaxid.diagnosis.screen import each_probe, probe_residuals, Retuning
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.least_squares import levenberg_marquardt, Path
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.problem.problem import FitProblem, ResidualRows, rows
from jaxid.problem.residual import Residual


#: A share of a probe so small that re-tuning takes out what is absorbed exactly but for this share.
WEAK, ABSORBED = 1e-5, 5e-5
#: This many effects are re-tuned in earnest, in this many rounds and iterations, at a size that
#: moves no number further than this (in factors of e, or in this many typical changes), where the
#: first order still leads.
MOST, ROUNDS, ITERATIONS, REACH, CHANGES = 20, 3, 16, 0.7, 5.0
#: Re-tuning ends where what is left did not fall below this share this many times after each other.
ENOUGH, FAILED, SECANTS = 0.9, 4, 6
#: After this many trials it ends where what is left is this often what is told.
HOPELESS = ((8, 10.0), (3, 100.0))
#: A difference as large is that of a run that diverged.
DIVERGED = 1e50


@dataclass(frozen=True)
class MovedNumber:
    """A number of the model, as fitted, and as it would be with an effect beside it."""

    name: str
    unit: str
    without: float
    beside: float


@dataclass(frozen=True)
class Unseen:
    """An effect that the recordings would not show at the size `parameters`: after re-tuning it
    changes what is simulated by `distance` standard deviations, all samples together, and by
    `stirred` without re-tuning. It hides in the numbers `moved`, most changed first; where there is
    none, the motion does not stir it. `absorbed`: the model's own numbers take it in whole, so that
    no motion of this kind would show it.
    """

    effect: str
    location: str
    parameters: dict[str, tuple[float, str]]
    distance: float
    stirred: float
    absorbed: bool
    moved: tuple[MovedNumber, ...]

    def __str__(self) -> str:
        return f"{self.effect} at {self.location}"

    def to_dict(self) -> dict[str, Any]:
        return {
            "effect": self.effect,
            "location": self.location,
            "parameters": {
                k: {"value": v, "unit": unit} for k, (v, unit) in self.parameters.items()
            },
            "distance": self.distance,
            "without_retuning": self.stirred,
            "absorbed": self.absorbed,
            "hides_in": [
                {"parameter": m.name, "unit": m.unit, "fitted": m.without, "with_it": m.beside}
                for m in self.moved
            ],
        }


@dataclass(frozen=True)
class BlindSpots:
    """What the recordings would not show, worst first; signs that something is missing all the
    same; and the first of what they would not show that others could, as a hypothesis to design
    them for.
    """

    unseen: tuple[Unseen, ...] = ()
    signs: tuple[str, ...] = ()
    rival: Hypothesis | None = None


@dataclass(frozen=True, eq=False)
class Probe:
    """A probe of a candidate to first order: parameters with it, the change of z by re-tuning, how
    much it changes what is simulated without and with that, and whether it is absorbed.
    """

    candidate: Candidate
    full: np.ndarray
    step: np.ndarray
    stirred: float
    left: float
    absorbed: bool
    far: float  # the largest change of a number, against how far the first order leads
    most: float  # how many times as large its bounds let it be

    @property
    def largest(self) -> float:
        """As many times as large its bounds let it be, and the first order still leads."""
        return min(self.most, 1 / max(self.far, 1e-300))

    @property
    def size(self) -> float:
        """As many times as large it is not seen, to first order."""
        return min(self.largest, 0.8 * LIMITS.three_sigma / max(self.left, 1e-300))


@dataclass(eq=False)
class Match:
    """A model with an effect, re-tuned to the model without: where it stands, and how far apart the
    two simulate.
    """

    problem: FitProblem
    z: np.ndarray
    distance: float = np.inf
    tried: list[tuple[np.ndarray, np.ndarray]] = field(
        default_factory=list
    )  # z and the difference there: the nearest, the last
    trials: int = 0
    failed: int = 0

    def take(self, z: np.ndarray, difference: np.ndarray) -> None:
        self.trials, distance = self.trials + 1, float(np.linalg.norm(difference))
        if not distance < DIVERGED:
            self.failed = FAILED
            return
        self.failed = 0 if distance < ENOUGH * self.distance else self.failed + 1
        nearer = distance < self.distance
        self.tried.insert(0 if nearer else 1, (z, difference))
        del self.tried[SECANTS + 1 :]
        if nearer:
            self.z, self.distance = z, distance

    @property
    def improving(self) -> bool:
        """Whether more re-tuning may help: neither as good as the same already, nor still far from
        it.
        """
        limit = next((share for count, share in HOPELESS if self.trials >= count), np.inf)
        sigmas = self.distance / LIMITS.three_sigma
        return self.failed < FAILED and 0.1 < sigmas < limit

    def next(self, retuning: Retuning) -> np.ndarray:
        """What is left is made small along the secants first, and then along the slopes without the
        effect.
        """
        (z, rest), *others = self.tried
        if others:
            way = np.stack([there - z for there, _ in others], -1)
            change = np.stack([left - rest for _, left in others], -1)
            size = np.maximum(np.linalg.norm(change, axis=0), 1e-300)
            share = np.linalg.lstsq(change / size, -rest, rcond=1e-6)[0] / size
            z, rest = z + way @ share, rest + change @ share
        return self._near(z + retuning.step(rest))

    def _near(self, z: np.ndarray) -> np.ndarray:
        """No further away than where the first order leads, and half as far after each failure."""
        here, p, n = self.tried[0][0], self.problem, self.problem.free.size
        far = np.max(
            np.abs(z - here)[:n] / np.where(p.log, REACH, CHANGES * p.scale[:n]), initial=0.0
        )
        return here + (z - here) * min(1.0, 0.5**self.failed / max(far, 1e-300))


class BlindSpotSearch:
    """Looks behind a nominal model that reaches the noise, on the runs that fitted and chose."""

    def __init__(
        self,
        bench: ProblemBuilder,
        residual: Residual,
        nominal: Hypothesis,
        settled: Path | None = None,
    ):
        """`settled`: the nominal model as it was already fitted to the runs that fitted and
        chose.
        """
        self.bench, self.residual, self.nominal = bench, residual, nominal
        held = "validation" if bench.binding.experiments("validation") else ""
        self.split = f"fit+{held}" if held else "fit"
        path = settled or self._refitted(held)
        self.p, self.z, self.theta = path.problem, path.z, path.problem.theta(path.z)
        self.parts = list(rows([(self.p, self.z)]))
        self.before = np.concatenate([part.r.ravel() for part in self.parts])
        self.retuning = Retuning(self.parts, self.p.size)
        self.inflation = max(1.0, path.loss) * memory([part.r for part in self.parts])
        self.std = np.full(
            self.p.free.size, np.inf
        )  # of the free numbers; nothing hides in what is not known at all
        if (told := knowledge(path)) is not None:
            self.std = np.sqrt(np.diag(np.linalg.pinv(told[1], hermitian=True)) * self.inflation)

    def _refitted(self, held: str) -> Path:
        own = self.nominal.path.problem
        p = self.bench.problem(self.residual, self.split, own.free, self.nominal.theta)
        starts = p.start0.copy()
        starts[: len(own.records)] = own.starts(self.nominal.path.z)
        if held and self.residual.free_run:
            starts[len(own.records) :] = estimate_starts(self.bench, held, [self.nominal.theta])[0]
        return levenberg_marquardt([(p, p.z(self.nominal.theta, starts))], 12, 1e-6)[0]

    def look(self, pool: Sequence[Candidate]) -> BlindSpots:
        probes, signs = self._probed(pool)
        hiding = sorted(
            (q for q in probes if self._hides(q.size * q.step).size),
            key=lambda q: (q.absorbed, -self._worst(q)),
        )
        found = self._matched(hiding[:MOST])
        found.sort(key=lambda f: f[0].absorbed)
        still = [q for q in probes if q.stirred < LIMITS.three_sigma and q not in hiding]
        unstirred = []
        for q in still:
            c, numbers = q.candidate, self._numbers(q.candidate, q.full)
            unstirred.append(
                Unseen(c.effect, c.location, numbers, q.left, q.stirred, q.absorbed, ())
            )
        rival = next((self._hypothesis(c, end) for u, c, end in found if not u.absorbed), None)
        drift = self._drift()
        return BlindSpots(
            (*(u for u, *_ in found), *unstirred), (*signs, *([drift] if drift else [])), rival
        )

    def _hypothesis(self, c: Candidate, end: Match) -> Hypothesis:
        (path,) = levenberg_marquardt([(end.problem, end.z)], 0, 1e-3)
        return Hypothesis((c,), end.problem.theta(end.z), path, self.nominal.validation)

    def _probed(self, pool: Sequence[Candidate]) -> tuple[list[Probe], list[str]]:
        """For each candidate the probe that hides most (else the largest), and a sign of the one
        that stands out most.
        """
        rest = self.retuning.remaining(self.before)
        owners, probes = probes_of_all(self.bench, pool, self.theta)
        if not owners:
            return [], []
        weak = [self._sized(full, WEAK) for full in probes]
        if self.p.runs.engine.long:
            strong_left = each_probe(self.p, self.z, probes)
            weak_left = each_probe(self.p, self.z, weak)
        else:
            left = probe_residuals(self.p, self.z, probes + weak)
            strong_left, weak_left = left[: len(probes)], left[len(probes) :]
        best: dict[Candidate, Probe] = {}
        told: dict[Candidate, float] = {}

        def share(left, change):
            return float(np.linalg.norm(left) / max(np.linalg.norm(change), 1e-300))

        for c, full, strong, small in zip(owners, probes, strong_left, weak_left, strict=True):
            change, small = self._change(strong), self._change(small)
            stirred = float(np.linalg.norm(change))
            if not stirred < DIVERGED:
                continue
            rest_of = self.retuning.remaining(change)
            distance = float(np.linalg.norm(rest_of))
            # Of a finite probe, second order is left as well.
            tangent = self.retuning.remaining(small)
            absorbed = min(share(rest_of, change), share(tangent, small)) < ABSORBED
            if distance > 1e-3:
                stands_out = abs(float(rest @ rest_of)) / distance / np.sqrt(self.inflation)
                told[c] = max(told.get(c, 0.0), stands_out)
            step = self.retuning.step(change)
            n = self.p.free.size
            reach = np.where(self.p.log, REACH, CHANGES * self.p.scale[:n])
            far = float(np.max(np.abs(step[:n]) / reach, initial=0.0))
            probe = Probe(
                candidate=c,
                full=full,
                step=step,
                stirred=stirred,
                left=min(distance, float(np.linalg.norm(tangent)) / WEAK),
                absorbed=absorbed,
                far=far,
                most=self._room(c, full),
            )
            if c not in best or self._worst(probe) >= self._worst(best[c]):
                best[c] = probe
        signs = []
        strongest = max(told, key=lambda c: told[c], default=None)
        if strongest is not None and told[strongest] > LIMITS.sign:
            signs.append(
                f"{strongest} would explain something that stands out by"
                f" {told[strongest]:.2g} standard deviations, although the gap as a whole is at the"
                " noise."
            )
        return list(best.values()), signs

    def _change(self, residual: np.ndarray) -> np.ndarray:
        """What a probe changes; large where it diverges."""
        return np.nan_to_num(residual - self.before, nan=1e100, posinf=1e100)

    def _sized(self, full: np.ndarray, size: float) -> np.ndarray:
        """Parameters with a share of a probe; shapes stay as they are, and so does a limit that is
        none.
        """
        sized = self.theta.copy()
        moves = full != self.theta
        sized[moves] += size * (full[moves] - self.theta[moves])
        return np.where(self.bench.binding.layout.shapes, full, sized)

    def _room(self, c: Candidate, full: np.ndarray) -> float:
        """How many times as large as a probe an effect may be."""
        b, index = self.bench.binding, np.array(c.index, int)
        at = index[~b.layout.shapes[index] & (full[index] != self.theta[index])]
        if not at.size:
            return 1.0
        way = full[at] - self.theta[at]
        ahead = np.where(way > 0, b.upper[at] - self.theta[at], self.theta[at] - b.lower[at])
        return float(np.min(ahead / np.abs(way)))

    def _hides(self, step: np.ndarray) -> np.ndarray:
        """Positions of the free numbers that a change of z moves by far more than they are said to
        be uncertain.
        """
        n = self.p.free.size
        moved = np.abs(step[:n])
        size = np.where(self.p.log, 1.0, np.maximum(np.abs(self.z[:n]), self.p.scale[:n]))
        surely = moved > LIMITS.two_sigma * self.std
        return np.flatnonzero(surely & (moved > LIMITS.equivalent * size))

    def _worst(self, q: Probe) -> float:
        n = self.p.free.size
        return float(
            np.max(q.size * np.abs(q.step[:n]) / np.maximum(self.std, 1e-300), initial=0.0)
        )

    def _numbers(self, c: Candidate, theta: np.ndarray) -> dict[str, tuple[float, str]]:
        entries = self.bench.binding.layout.entries
        return {entries[i].field: (float(theta[i]), entries[i].unit) for i in c.index}

    def _matched(self, hiding: Sequence[Probe]) -> list[tuple[Unseen, Candidate, Match]]:
        """Those that are not seen after true re-tuning either, to what the model without them
        simulates.
        """
        ends = []
        for q, end in zip(hiding, self._largest_unseen(hiding), strict=True):
            if end is not None:
                ends.append((q, end))
        if not ends:
            return []
        plain = probe_residuals(self.p, self.z, [end.problem.base for _, end in ends])
        out = []
        for (q, end), residual in zip(ends, plain, strict=True):
            moved = self._moved(end)
            if not moved:
                continue
            c, numbers = q.candidate, self._numbers(q.candidate, end.problem.base)
            stirred = float(np.linalg.norm(residual - self.before))
            unseen = Unseen(c.effect, c.location, numbers, end.distance, stirred, q.absorbed, moved)
            out.append((unseen, c, end))
        return out

    def _moved(self, end: Match) -> tuple[MovedNumber, ...]:
        """The numbers in which an effect hides, those that are moved most first."""
        moved = self._hides(end.z - self.z)
        moved = moved[np.argsort(-np.abs(end.z - self.z)[moved] / self.std[moved])]
        entries, theta = self.bench.binding.layout.entries, end.problem.theta(end.z)
        parts = []
        for k in moved:
            i = int(self.p.free[k])
            entry = entries[i]
            parts.append(MovedNumber(entry.name, entry.unit, float(self.theta[i]), float(theta[i])))
        return tuple(parts)

    def _largest_unseen(self, hiding: Sequence[Probe]) -> list[Match | None]:
        """Of each probe the re-tuned end of the largest strength that is not seen, if any is."""
        sizes, steps = [q.size for q in hiding], [q.step for q in hiding]
        kept: list[Match | None] = [None] * len(hiding)
        again = list(range(len(hiding)))
        for _ in range(ROUNDS):
            if not again:
                break
            tried = []
            for k in again:
                problem = self._with(self._sized(hiding[k].full, sizes[k]))
                tried.append(Match(problem, self.z + sizes[k] * steps[k]))
            self._retune(tried)
            for k, end in zip(again, tried, strict=True):
                before = sizes[k]
                if end.distance < LIMITS.three_sigma:
                    kept[k], steps[k] = end, (end.z - self.z) / sizes[k]
                if np.isfinite(end.distance):  # more or less than the first order said
                    factor = 0.8 * LIMITS.three_sigma / max(end.distance, 1e-9)
                    sizes[k] = min(sizes[k] * factor, hiding[k].largest)
                if kept[k] is end and sizes[k] < 1.05 * before:
                    sizes[k] = np.nan  # as large as it goes
            again = [k for k in again if np.isfinite(sizes[k])]
        return kept

    def _with(self, theta: np.ndarray) -> FitProblem:
        """The runs that were looked at and the numbers that are re-tuned, beside other
        parameters.
        """
        return self.bench.problem(self.residual, self.split, self.p.free, theta)

    def _inside(self, z: np.ndarray) -> np.ndarray:
        return np.clip(z, self.p.lower, self.p.upper)

    def _retune(self, matches: Sequence[Match]) -> None:
        """Re-tunes each, all at once, without slopes of their own: by those of the model without an
        effect, and by secants.
        """
        trials, active = [self._inside(m.z) for m in matches], list(matches)
        for _ in range(ITERATIONS):
            found = probe_residuals(
                self.p, trials, [m.problem.theta(z) for m, z in zip(active, trials, strict=True)]
            )
            for m, z, residual in zip(active, trials, found, strict=True):
                m.take(
                    z, np.nan_to_num(residual - self.before, nan=1e100, posinf=1e100, neginf=-1e100)
                )
            active = [m for m in active if m.improving]
            trials = [self._inside(m.next(self.retuning)) for m in active]
            if not active:
                break

    def _drift(self) -> str:
        """The number that differs most between the parts of the recordings (halves of each run), if
        by more than chance.
        """
        rest = self.retuning.remaining(self.before)
        pieces, ends = list(self._halves()), np.cumsum([part.r.size for part in self.parts])[:-1]
        worst: tuple[float, int, np.ndarray] | None = None
        for k in range(self.p.free.size):
            columns = np.zeros((rest.size, len(pieces)))
            for g, (_, inside, part, own) in enumerate(pieces):
                if k in part.z_columns:
                    columns[inside, g] = part.J[own, :, part.z_columns.index(k)].ravel()
            size = np.linalg.norm(columns, axis=0)
            seen = size > 0
            left = self.retuning.remaining(columns[:, seen] / size[seen])
            shift, _, rank, _ = np.linalg.lstsq(left, rest, rcond=1e-6)
            told = left @ shift
            after = [
                x.reshape(part.r.shape)
                for x, part in zip(np.split(rest - told, ends), self.parts, strict=True)
            ]
            level = max(1.0, float(np.mean((rest - told) ** 2)))
            gain = float(told @ told) / (level * memory(after))
            chance = float(chdtrc(max(int(rank), 1), gain))
            if chance < LIMITS.chance / self.p.free.size and (worst is None or chance < worst[0]):
                every = np.full(len(pieces), np.nan)
                every[seen] = -shift / size[seen]
                worst = chance, k, every
        if worst is None:
            return ""
        _, k, shift = worst
        i = int(self.p.free[k])
        entry, slope = self.bench.binding.layout.entries[i], self.p.dtheta(self.z)[k]
        low, high = int(np.nanargmin(shift)), int(np.nanargmax(shift))

        def say(g):
            return f"{self.theta[i] + slope * shift[g]:.5g} {entry.unit} in {pieces[g][0]}"

        return (
            f"{entry.name} is not the same in all of the recordings ({say(low)}, {say(high)}; far"
            " beyond chance): something changed, or the model lacks what acts differently there."
        )

    def _halves(self) -> Iterator[tuple[str, slice, ResidualRows, slice]]:
        """First and second half of each record: name, place in all residuals, and samples of which
        rows.
        """
        start = 0
        for part in self.parts:
            run = self.p.runs.experiments[self.p.runs.record(part.record).experiment].name
            n, columns = part.r.shape
            for half, own in (("first", slice(0, n // 2)), ("second", slice(n // 2, n))):
                yield (
                    f"the {half} half of {run}",
                    slice(start + columns * own.start, start + columns * own.stop),
                    part,
                    own,
                )
            start += part.r.size
