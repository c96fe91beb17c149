"""From model and data to problems: runs made ready, guesses of numbers, and how runs begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.fitting.least_squares import levenberg_marquardt, Path
from jaxid.fitting.scale_free import shrinking
from jaxid.fitting.secant import residuals
from jaxid.fitting.wide_slopes import descend_widely, is_noise
from jaxid.problem.beginnings import TOUCHING
from jaxid.problem.binding import Binding
from jaxid.problem.frequency_response import FrequencyResponseError
from jaxid.problem.momentum import told_by
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import InverseDynamics, OutputError, Residual, Runs
from jaxid.simulation import sample_buffers as samples


class Begun(NamedTuple):
    """Starts of runs [runs 2 nq], and per run how much its first moments tell about the unknown
    part of its start (J'J).
    """

    starts: np.ndarray
    information: list[np.ndarray]


@dataclass
class ProblemBuilder:
    """Runs of a binding made ready, one set per split and residual, with the same step: that of
    the model's own simulator where it has one.
    `differences`: where its problems take their Jacobians from (see `FitProblem`).

    `defects` (residual, split) -> what finer steps would add to the simulation, at the samples
    [samples columns]: taken off the targets of its problems, so that a search on coarse steps ends
    where one on fine steps would. `together`: one program of all effects runs every lane (of
    runs that touch, every lane with effects). `finer`:
    the model's own simulator takes so many steps in place of one.
    """

    binding: Binding
    step: float = samples.STEP
    differences: int = 0
    defects: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)
    together: bool = False
    finer: int = 1

    def __post_init__(self):
        own = self.binding.chain.mechanism.own_step
        if own is not None:
            own /= self.finer
            self.step = own
        self._runs: dict[tuple[str, str], Runs] = {}
        self._begun: dict[tuple[str, bytes], Begun] = {}
        #: With the defects taken off: one array for all problems.
        self._targets: dict[tuple[str, str], np.ndarray | None] = {}
        self._forgotten = 0.0  # seconds of compiling for runs that were let go
        samples.refuse_endless(self.binding.dataset.experiments, self.step)
        # One shape for all splits, and for the half step that a search may go over to: one program.
        room = min(self.step, samples.STEP / 2) if own is None else own
        self._shape = self._largest(
            {e.name: samples.step_count(e.whole, room) for e in self.binding.dataset.experiments}
        )
        self._rows = self._largest({e.name: len(e.t) for e in self.binding.dataset.experiments})
        if self._shape[1] > samples.LONG:
            # Compiling once more costs less than the memory of buffers that are mostly empty.
            self._shape = self._rows = 0, 0

    def _largest(self, steps: dict[str, int]) -> tuple[int, int]:
        """Steps of the fit runs and a split beside them, and of the longest experiment."""

        def of_split(split: str) -> int:
            return sum(steps[e.name] for e in self.binding.experiments(split))

        most = of_split("fit") + max(of_split("validation"), of_split("report"))
        return most, max(steps.values(), default=0)

    def runs(self, residual: Residual, split: str) -> Runs:
        key = (repr(residual), split)
        if key not in self._runs:
            b = self.binding
            experiments = residual.select(b.dataset, split)
            self._runs[key] = residual.runs(
                b.dataset,
                experiments,
                b.layout,
                b.readings if residual.torques else b.by_windows(residual.window).sigma,
                b.motions_of(experiments),
                self.step,
                self._shape_of(residual),
            )
            if self.together:
                self._runs[key].engine.keep_together(apart=touches(b))
        return self._runs[key]

    def split_of(self, runs: Runs) -> str | None:
        """The split that runs were made of; None for those of another builder."""
        return next((key[1] for key, made in self._runs.items() if made is runs), None)

    def forget_long(self, kept: Residual) -> None:
        """Lets go of the torques of long runs, which only start values were made of, where another
        residual is fitted.
        """
        if kept.torques:
            return
        for key, runs in list(self._runs.items()):
            if runs.setting is not None and runs.engine.long:
                self._forgotten += self._runs.pop(key).engine.compile_time_s

    def compile_ahead(self, residual: Residual, theta: np.ndarray, free: Sequence[int]) -> None:
        """Begins to compile what a descent of one or two fits needs whose numbers equal theta but
        in `free`.
        """
        name = "outputs" if self.differences else "tangents"
        self.runs(residual, "fit").engine.compile_ahead(name, theta, free)

    def _shape_of(self, residual: Residual) -> tuple[int, int]:
        if residual.torques:  # at the samples, whatever the step of simulations
            return self._rows
        return (self._shape[0], 0) if residual.windows else self._shape

    def problem(
        self,
        residual: Residual,
        split: str,
        free: Sequence[int] | np.ndarray,
        theta: np.ndarray,
        records: Sequence[int] | None = None,
        loss: str = "sum_of_squares",
    ) -> FitProblem:
        b = self.binding
        if residual.torques and (own := b.gains & {int(i) for i in free}):
            raise UsageError(
                "inverse_dynamics compares torques, and"
                f" {', '.join(b.layout.names[i] for i in sorted(own))} make the torque: the"
                " smaller, the less is left. Take them out of [controller] fit, or use the"
                " residual output_error"
            )
        if residual.momenta and len(free):
            free = told_by(b.layout, list(free))
        runs = self.runs(residual, split)
        priors = b.priors if "fit" in split.split("+") else None  # they count once
        p = FitProblem(
            runs=runs,
            base=theta,
            free=free,
            lower=b.lower,
            upper=b.upper,
            records=records,
            loss=loss,
            scale=b.scale,
            differences=self.differences,
            priors=priors,
        )
        key = (repr(residual), split)
        if key not in self._targets:
            defect = self.defect(residual, split)
            self._targets[key] = None if defect is None else runs.targets - defect
        targets = self._targets[key]
        return p if targets is None else p.with_targets(targets)

    def defect(self, residual: Residual, split: str) -> np.ndarray | None:
        """What is taken off the targets of a split [samples columns]; None where nothing is."""
        parts = {name: self.defects.get((repr(residual), name)) for name in split.split("+")}
        if len(parts) == 1:
            return parts[split]
        if all(part is None for part in parts.values()):
            return None
        runs = self.runs(residual, split)
        out, numbers = np.zeros_like(runs.targets), iter(runs.records)
        for name, part in parts.items():
            own = self.runs(residual, name)
            for number in own.records:
                at = runs.record(next(numbers)).samples
                out[at] = 0.0 if part is None else part[own.record(number).samples]
        return out

    def take_off(self, residual: Residual, split: str, defect: np.ndarray) -> None:
        """Sets what finer steps would add."""
        self.defects[repr(residual), split] = defect
        self._begun.clear()
        self._targets.clear()

    def begun(self, split: str, thetas: Sequence[np.ndarray]) -> list[Begun]:
        """How the free runs of a split begin with each of several parameter vectors; what was
        estimated before is kept.
        """
        keys = [(split, theta.tobytes()) for theta in thetas]
        new = {k: theta for k, theta in zip(keys, thetas, strict=True) if k not in self._begun}
        if new:
            if touches(self.binding):
                begun = [_begun_touching(self, split, theta) for theta in new.values()]
            else:
                begun = _begun(self, split, list(new.values()))
            self._begun |= dict(zip(new, begun, strict=True))
        return [self._begun[key] for key in keys]

    def begun_before(self, split: str) -> list[Begun]:
        """How the runs of a split begin with all models that were asked so far."""
        return [begun for (name, _), begun in self._begun.items() if name == split]

    def begin_as(self, other: ProblemBuilder) -> None:
        """Takes over how runs begin by models of another builder: those in which candidates that
        are not here do nothing; candidates that are here alone do nothing in them.
        """
        mine, names = self.binding.layout, other.binding.layout.names
        here = np.isin(names, mine.names)
        at = [mine.index(name) for name, shared in zip(names, here, strict=True) if shared]
        neutral = other.binding.theta
        for (split, numbers), begun in other._begun.items():
            own = np.frombuffer(numbers)
            if np.array_equal(own[~here], neutral[~here]):
                theta = self.binding.theta.copy()
                theta[at] = own[here]
                self._begun[split, theta.tobytes()] = begun

    def simulated(self) -> int:
        """Steps that were simulated so far, those of all candidates."""
        return sum(r.engine.simulated for r in self._runs.values() if r.setting is None)

    def compile_time(self) -> float:
        return self._forgotten + sum(r.engine.compile_time_s for r in self._runs.values())


def default_residual(binding: Binding) -> Residual:
    """The free run: it says most about a simulator, and a drift that a wrong law causes is what it
    is asked to show. A dataset of frequency responses alone is compared by them.
    """
    return OutputError() if binding.dataset.experiments else FrequencyResponseError()


def start_values(
    bench: ProblemBuilder,
    free: Sequence[int],
    seed: int,
    runs: Sequence[int] | None = None,
    residual: Residual | None = None,
) -> list[np.ndarray]:
    """Guesses of every number of the model, best first: what inverse dynamics finds (of some of the
    fit runs alone, where `runs` are given), what was stated or is the default. Torques tell a
    `residual` of momentum nothing: none may have been recorded.
    """
    b = bench.binding
    if residual is not None and residual.momenta:
        return [b.theta]
    guesses = [b.theta]
    told = [i for i in free if i not in b.gains]
    linear = [i for i in told if i not in b.stated] or told
    if not b.motions or not linear or b.chain.mechanism.hidden_states:
        return guesses

    def by_torques(numbers: Sequence[int], theta: np.ndarray) -> np.ndarray | None:
        """What inverse dynamics makes of some numbers; None where it finds nothing."""
        p = bench.problem(InverseDynamics(decimate=1), "fit", numbers, b.theta)
        if runs is not None:
            p = p.part(runs, [1.0] * len(runs))
        if shrinking(p, p.z(theta)):
            return None
        (path,) = levenberg_marquardt([(p, p.z(theta))], 15, 1e-8)
        return p.theta(path.z) if np.isfinite(path.cost) else None

    found = by_torques(linear, b.theta)
    if found is not None:
        guesses.insert(0, found)
        if not b.stated.isdisjoint(told):
            found = by_torques(told, found)
            if found is not None:
                guesses.insert(0, found)
    return guesses


def estimate_starts(bench: ProblemBuilder, split: str, thetas: Sequence[np.ndarray]) -> np.ndarray:
    """Starts of the free runs of a split that is not fitted, from their first moments only; [thetas
    runs 2 nq].
    """
    return np.array([b.starts for b in bench.begun(split, thetas)])


def _begun(bench: ProblemBuilder, split: str, thetas: Sequence[np.ndarray]) -> list[Begun]:
    """The start is fitted on the longest of some nested first stretches that the model follows to
    within twice the noise: with a fine encoder a wrong friction law would else bend the start
    within a tenth of a second.
    """
    runs = bench.runs(OutputError(), split)
    jobs, groups = [], []
    for theta in thetas:
        for heads in runs.heads:
            groups.append(range(len(jobs), len(jobs) + len(heads)))  # longest first
            for head in heads:
                p = bench.problem(OutputError(), split, [], theta, [head])
                jobs.append((p, p.z(theta)))
    paths: dict[int, Path] = {}

    def descended(asked: Sequence[int]) -> None:
        unknown = [k for k in asked if jobs[k][0].size]
        if unknown:
            ends = levenberg_marquardt([jobs[k] for k in unknown], 8, 1e-8)
            paths.update(zip(unknown, ends, strict=True))

    def follows(n):
        return n in paths and 2 * paths[n].cost <= 2 * max(1, paths[n].count - jobs[n][0].size)

    descended([own[0] for own in groups])
    shorter: list[int] = []
    for own in groups:
        if not follows(own[0]):
            shorter += own[1:]
    descended(shorter)
    starts = np.zeros((len(thetas), len(runs.heads), jobs[0][0].start0.shape[1]))
    out = [Begun(starts[i], []) for i in range(len(thetas))]
    for k, own in enumerate(groups):
        best = next(filter(follows, own), own[-1])
        p, z = jobs[best]
        information = None
        if best in paths:
            z, information = paths[best].z, paths[best].hessian
        if information is None:
            information = np.zeros((p.size, p.size))
        which, run = divmod(k, len(runs.heads))
        starts[which, run] = p.starts(z)[0]
        out[which].information.append(information)
    return out


#: Rounds of a descent on one stretch of runs that touch.
ROUNDS = 12
#: A round for starts alone, on less than the whole of a run, that gains less is of no account.
ROUGHLY = 1e-2
#: A model that leaves this many times the noise on a stretch does not follow it: what comes after
#: tells nothing of how the run began.
LOST = 10.0


def touches(binding: Binding) -> bool:
    """Whether contacts are simulated."""
    return binding.chain.mechanism.touches


def _begun_touching(bench: ProblemBuilder, split: str, theta: np.ndarray) -> Begun:
    """The start is fitted to the whole of a run: from that of another model, where it is near."""
    starts, information = [], []
    runs, before = bench.runs(OutputError(), split), bench.begun_before(split)
    for run in range(len(runs.heads)):
        path = None
        p = bench.problem(OutputError(), split, [], theta, [runs.records[run]])
        known = [p.z(theta, begun.starts[run][None]) for begun in before]
        near = _nearest(p, known)
        if near is not None:
            path, _ = descend_widely(p, near, ROUNDS)
        if path is None:
            path, _ = descend_over_stretches(bench, split, [], theta, [run])
        assert path.hessian is not None
        starts.append(path.problem.starts(path.z)[0])
        information.append(path.hessian)
    return Begun(np.array(starts), information)


def descend_over_stretches(
    bench: ProblemBuilder,
    split: str,
    free: Sequence[int] | np.ndarray,
    theta: np.ndarray,
    which: Sequence[int],
    most: float = np.inf,
) -> tuple[Path, int]:
    """A fit to runs that touch (`which` of a split), over one nested stretch after the other, and
    how many times they were simulated: what the first of them tell decides where the next ones
    touch. It is given up, at a cost without end, where a stretch leaves more than `most` times the
    noise.
    """
    runs = bench.runs(OutputError(), split)
    starts, path, spent = None, None, 0
    starts_alone, lost = not len(free), False
    for level in reversed(range(len(TOUCHING))):
        stretches = [runs.heads[run][level] for run in which]
        if level == 0:
            stretches = [runs.records[run] for run in which]
        elif lost:
            continue
        else:  # numbers that a stretch does not tell stay where they are
            held = bench.problem(OutputError(), split, [], theta, stretches)
            begun, simulated = _begun_on(held, held.z(theta, starts), known=starts is not None)
            spent += simulated
            followed = is_noise(2 * begun.cost, begun.count)
            if starts_alone or followed or starts is None:
                starts = held.starts(begun.z)
            if starts_alone or followed:
                lost = not begun.loss <= LOST
                continue
        p = bench.problem(OutputError(), split, free, theta, stretches)
        path, simulated = descend_widely(p, p.z(theta, starts), 1 if lost else ROUNDS)
        theta, starts = p.theta(path.z), p.starts(path.z)
        spent += simulated
        if not path.loss <= most:
            return replace(path, cost=np.inf), spent
    assert path is not None
    return path, spent


def _begun_on(p: FitProblem, z: np.ndarray, known: bool) -> tuple[Path, int]:
    """How runs begin by a stretch, roughly, from z, and how many times it was simulated; where
    that is `known` and followed, z itself.
    """
    rounds = 0 if known and _nearest(p, [z]) is not None else ROUNDS
    return descend_widely(p, z, rounds, ROUGHLY)


def _nearest(p: FitProblem, known: Sequence[np.ndarray]) -> np.ndarray | None:
    """The z that follows the runs best, where it does so to their noise; None where none does."""
    if not known:
        return None
    with np.errstate(all="ignore"):
        found = [(float(r @ r), r.size, z) for r, z in zip(residuals(p, known), known, strict=True)]
    followed = [(squares, z) for squares, count, z in found if is_noise(squares, count)]
    return min(followed, key=lambda pair: pair[0])[1] if followed else None
