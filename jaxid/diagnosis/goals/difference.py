"""What MuJoCo makes of a robot's file, apart from the simulation that is fitted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jaxid.base.wording import listed
from jaxid.diagnosis.goals.floor import Between, between_simulators, JointNumbers, rms, seen_early
from jaxid.diagnosis.goals.own_run import run_of_file, steps_as_its_file
from jaxid.diagnosis.goals.study import LedStudy
from jaxid.diagnosis.verdict import level
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import Binding
from jaxid.problem.residual import OutputError


TAKEN_OFF = (
    "the recording is compared with the file as MuJoCo runs it: what that and jaxid's run of the"
    " same file differ by is taken off the readings, rms"
)


@dataclass(frozen=True)
class Difference:
    """What MuJoCo's free runs of the file are apart from jaxid's at the numbers theta, by split."""

    by_split: dict[str, Between]
    theta: np.ndarray
    floor: np.ndarray  # what an effect changes of the difference itself, rms [n]

    def accounts(self, binding: Binding) -> bool:
        """Whether MuJoCo's run of the file is the recording, down to the noise."""
        sigma = np.hypot(binding.sigma, self.floor)

        def count(split):
            return len(sigma) * sum(len(e.t) for e in binding.experiments(split))

        left = {
            split: np.mean((between.left / sigma) ** 2)
            for split, between in self.by_split.items()
            if split != "report"
        }
        return all(loss <= level(count(split)) for split, loss in left.items())

    def said(self, binding: Binding) -> str:
        names = binding.chain.signature.output_names
        every = [
            f"{name} {size:.2g} {binding.noise[name].unit}"
            for name, size in zip(names, self.by_split["fit"].size, strict=True)
        ]
        return f"{TAKEN_OFF} {listed(every)}"

    def off(self, bench: ProblemBuilder) -> ProblemBuilder:
        """The bench with readings as jaxid's simulation of the file would have them."""
        for split, between in self.by_split.items():
            runs = bench.runs(OutputError(), split)
            defect = np.zeros_like(runs.targets)
            for k, (x, earlier) in enumerate(zip(between.apart, between.before, strict=True)):
                defect[runs.record(runs.records[k]).samples] = x
                defect[runs.before(k)] = earlier
            bench.take_off(OutputError(), split, defect)
        return bench


def compared(
    bench: ProblemBuilder,
    split: str = "fit",
    theta: np.ndarray | None = None,
    numbers: JointNumbers | None = None,
) -> Between | None:
    """The runs of the file by its own simulator beside those that are fitted: the same where these
    take its steps.
    """
    if steps_as_its_file(bench.binding):
        return run_of_file(bench, split)
    return between_simulators(bench, split, theta, numbers)


def difference(
    bench: ProblemBuilder,
    known: Mapping[str, Between],
    theta: np.ndarray | None = None,
    numbers: JointNumbers | None = None,
) -> Difference | None:
    """None where MuJoCo has no run of some split; what is `known` already by split, and the numbers
    of jaxid's and of MuJoCo's runs.
    """
    b, found = bench.binding, dict(known)
    for split in ("fit", "validation", "report"):
        if b.experiments(split) and split not in found:
            between = compared(bench, split, theta, numbers)
            if between is None:
                return None
            found[split] = between
    share = _changed(b, found["fit"])
    return Difference(found, b.theta if theta is None else theta, share * found["fit"].size)


def _changed(b: Binding, of_fit: Between) -> np.ndarray:
    """By how much of itself [n] the motion is not MuJoCo's: what two simulators make of it changes
    by as much.
    """
    moved = np.std(
        np.concatenate([e.y[:, b.chain.joint_outputs] for e in b.experiments("fit")]), axis=0
    )
    return np.minimum(1.0, of_fit.left / np.maximum(moved, 1e-300))


def by_its_steps(
    bench: ProblemBuilder,
    study: LedStudy,
    plain: Difference,
    numbers: JointNumbers | None = None,
) -> Difference | None:
    """The same with what first-order steps of h do to any motion of the model: they add h / 2 of
    the dampings to the inertias and see the motion h / 2 early. The first goes into the numbers,
    the second into the readings by their own speed; what is left of the difference hardly depends
    on what the file lacks. `numbers`: those of MuJoCo's runs.
    """
    b, theta = bench.binding, plain.theta.copy()
    for name, more in study.inertia_taken_up(plain.by_split["fit"].apart, plain.theta).items():
        i = b.layout.index(name)
        theta[i] = np.clip(theta[i] + more, b.lower[i], b.upper[i])
    found = difference(bench, {}, theta, numbers)
    if found is None:
        return None
    speeds = {
        split: between.speeds(b.experiments(split)) for split, between in found.by_split.items()
    }
    early = seen_early(found.by_split["fit"].apart, speeds["fit"])
    by_split = {}
    for split, between in found.by_split.items():
        own = [b.motions[e.name].qd[-len(e.t) :] for e in b.experiments(split)]
        apart = [
            d + early * (now - then)
            for d, now, then in zip(between.apart, own, speeds[split], strict=True)
        ]
        by_split[split] = replace(between, apart=apart)
    left = rms(found.by_split["fit"].at_once(b.experiments("fit")))
    return Difference(by_split, theta, _changed(b, found.by_split["fit"]) * left)
