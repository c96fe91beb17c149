"""The run of a robot's file as it stands, in the steps that are simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxid.data.dataset import Experiment
from jaxid.diagnosis.evidence import level
from jaxid.diagnosis.goals.changes import changes, StatedDifference
from jaxid.dynamics.effect import Effect
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.problem.binding import Binding
from jaxid.problem.residual import OutputError
from jaxid.robots.tree import Tree
from jaxid.robots.yardstick import added_by_steps, as_it_stands
from jaxid.simulation.sample_buffers import columns


@dataclass(frozen=True)
class FileRun:
    """What the free runs of a file leave of the readings, [samples n] of each run, by split."""

    left: dict[str, list[np.ndarray]]

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
    theta, found = as_it_stands(b)[0], {}
    for split in ("fit", "validation"):
        runs = b.experiments(split)
        if not runs:
            continue
        starts = estimate_starts(bench, split, [theta])[0]
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
    return FileRun(found)


def stepped_changes(binding: Binding, kinds: Sequence[type[Effect]]) -> list[StatedDifference]:
    """Single changes of a model, by columns that know no steps. Where it steps as its file,
    armatures are those that appear in such steps, and readings are seen as late as they were asked
    for.
    """
    tree: Tree = binding.chain.mechanism.tree.tree  # type: ignore[attr-defined]
    added = np.zeros_like(binding.theta)
    if binding.chain.mechanism.first_order_steps is not None:
        added = _added(binding, tree)
    found = []
    for change in changes(without_steps(binding), kinds, binding.theta + added):
        theta = change.proposal.theta - added
        found.append(replace(change, proposal=replace(change.proposal, theta=theta)))
    return found


def without_steps(binding: Binding) -> Binding:
    """The binding with readings as late as columns that know no steps have them: in the file's
    steps a command that jumps acts early.
    """
    steps = binding.chain.mechanism.first_order_steps
    if steps is None:
        return binding
    inputs, _ = columns(binding.dataset, binding.chain)
    jumps = [binding.dataset.inputs[i].hold == "zero" for i in inputs[: binding.chain.nq]]
    early = steps.delay * np.array(jumps)
    runs = []
    for e in binding.dataset.experiments:
        moved = _later(e, early, binding.motions[e.name].qd[-len(e.t) :])
        if e.past is not None:
            before = e.past
            speed = np.gradient(before.y, before.t, axis=0)[:, : binding.chain.nq]
            moved = replace(moved, past=_later(before, early, speed))
        runs.append(moved)
    return replace(binding, dataset=replace(binding.dataset, experiments=tuple(runs)))


def _later(e: Experiment, by: np.ndarray, speed: np.ndarray) -> Experiment:
    """A run whose readings are those of so many seconds before, [n]; `speed` [samples n]."""
    y = e.y.copy()
    y[:, : speed.shape[1]] -= by * speed
    return replace(e, y=y)


def _added(binding: Binding, tree: Tree) -> np.ndarray:
    """What the file's steps make armatures appear to be more, by position in the layout."""
    added = np.zeros_like(binding.theta)
    for joint in binding.chain.signature.joints:
        own = binding.layout.index(f"armature@{joint}")
        added[own] = added_by_steps(binding, {}, tree, joint)
    return added
