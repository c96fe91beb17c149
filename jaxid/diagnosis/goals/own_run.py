"""The run of a robot's file as it stands, in the steps that are simulated; and beside it the run of
MuJoCo itself, which tells whether something acts that is not simulated here: contacts, joints that
were not recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.diagnosis.goals.changes import changes, StatedDifference
from jaxid.diagnosis.verdict import level
from jaxid.dynamics.effect import Effect
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.replay import in_mujoco
from jaxid.problem.binding import Binding
from jaxid.problem.residual import OutputError
from jaxid.robots import stops
from jaxid.robots.tree import Tree
from jaxid.robots.yardstick import added_by_steps, as_it_stands


@dataclass(frozen=True)
class FileRun:
    """What the free runs of a file leave of the readings, [samples n] of each run, by split; and
    where those of the fit runs began [runs 2 n].
    """

    left: dict[str, list[np.ndarray]]
    starts: np.ndarray

    def accounts(self, binding: Binding) -> bool:
        """Whether the file is the recording, down to the noise."""
        for runs in self.left.values():
            every = np.concatenate(runs)
            if not np.mean((every / binding.sigma) ** 2) <= level(every.size):
                return False
        return True


def run_of_file(bench: ProblemBuilder) -> FileRun | None:
    """Those of fit and validation runs; None where joints are not what is read, or a run does not
    come to its end.
    """
    b, n = bench.binding, bench.binding.chain.nq
    if b.chain.joint_outputs != list(range(len(b.sigma))):
        return None
    theta, found, begun = as_it_stands(b)[0], {}, {}
    for split in ("fit", "validation"):
        runs = b.experiments(split)
        if not runs:
            continue
        starts = begun[split] = estimate_starts(bench, split, [theta])[0]
        made = bench.runs(OutputError(), split)
        repeated = np.repeat(theta[None], len(runs), 0)
        lanes = made.engine.outputs(repeated, starts, np.array(made.records))
        left = []
        for k, (e, lane) in enumerate(zip(runs, lanes, strict=True)):
            own = made.record(made.records[k])
            left.append(e.y[:, :n] - lane[own.samples - own.offset, :n])
        if not all(np.isfinite(x).all() for x in left):
            return None
        found[split] = left
    return FileRun(found, begun["fit"])


def not_this_file(binding: Binding, run: FileRun | None) -> str:
    """Where MuJoCo's run of the file is nearer to the recording than to the one that is simulated
    here, and that shows above the noise: something acts that no model of this simulation has. Empty
    where it is not so, or MuJoCo has no run of the file.
    """
    theirs = None if run is None else _in_mujoco(binding, run.starts)
    if run is None or theirs is None:
        return ""
    experiments, n = binding.experiments("fit"), binding.chain.nq
    ours, left = run.left["fit"], []
    for e, y in zip(experiments, theirs, strict=True):
        left.append(e.y[:, :n] - y[-len(e.t) :])
    apart = [x - y for x, y in zip(ours, left, strict=True)]
    sizes = [float(np.mean((np.concatenate(x) / binding.sigma) ** 2)) for x in (apart, left)]
    count = sum(x.size for x in left)
    if not sizes[0] > max(sizes[1], level(count)):
        return ""
    worst = int(np.argmax(rms(apart) / binding.sigma))
    name = binding.chain.signature.output_names[worst]
    unit = binding.noise[name].unit
    text = (
        f"MuJoCo's run of the file leaves {rms(left)[worst]:.2g} {unit} of {name}, and jaxid's run"
        f" of the same file lies {rms(apart)[worst]:.2g} {unit} from that one: something that the"
        " file says and jaxid does not simulate acts in this recording, and what is left says"
        " nothing of the robot."
    )
    stopped = stops.sentences_of(binding.chain.mechanism, binding.dataset)
    return " ".join((text, *(f"{sentence}." for sentence in stopped)))


def rms(series: Sequence[np.ndarray]) -> np.ndarray:
    return np.sqrt(np.mean(np.concatenate(series) ** 2, 0))


def file_of(binding: Binding) -> Path | None:
    """The robot's file where it lies; None where it lies no more."""
    tree: Tree = binding.chain.mechanism.tree.tree  # type: ignore[attr-defined]
    spec = binding.dataset.model
    stated = spec.geometry.path if spec is not None and spec.geometry is not None else ""
    return next((Path(p) for p in (stated, tree.file) if p and Path(p).is_file()), None)


def _in_mujoco(b: Binding, starts: np.ndarray) -> list[np.ndarray] | None:
    """MuJoCo's free runs of the file in the fit runs; None where it has none."""
    tree: Tree = b.chain.mechanism.tree.tree  # type: ignore[attr-defined]
    path, runs = file_of(b), b.experiments("fit")
    if path is None or any(e.past is not None for e in runs):
        return None
    data = replace(b.dataset, experiments=runs)
    try:
        found = in_mujoco(data, path, tree, None, list(starts), [])
    except UsageError:
        return None
    return found if all(np.isfinite(y).all() for y in found) else None


def stepped_changes(binding: Binding, kinds: Sequence[type[Effect]]) -> list[StatedDifference]:
    """Single changes of a model, by columns that know no steps. Where it steps as its file,
    armatures are those that appear in such steps, and readings are seen as late as they were asked
    for.
    """
    tree: Tree = binding.chain.mechanism.tree.tree  # type: ignore[attr-defined]
    added, early = np.zeros_like(binding.theta), 0.0
    if binding.chain.mechanism.integrator and tree.steps is not None:
        added, early = _added(binding, tree), tree.steps.delay
    apart = []
    for e in binding.experiments("fit"):
        apart.append(early * binding.motions[e.name].qd[-len(e.t) :])
    found = []
    for change in changes(binding, kinds, apart, binding.theta + added):
        theta = change.proposal.theta - added
        found.append(replace(change, proposal=replace(change.proposal, theta=theta)))
    return found


def _added(binding: Binding, tree: Tree) -> np.ndarray:
    """What the file's steps make armatures appear to be more, by position in the layout."""
    added = np.zeros_like(binding.theta)
    for joint in binding.chain.signature.joints:
        own = binding.layout.index(f"armature@{joint}")
        added[own] = added_by_steps(binding, {}, tree, joint)
    return added
