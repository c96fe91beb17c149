"""The run of a robot's file where its own simulator is the one that is compared.

The simulation steps as the file says, so nothing lies between what is fitted and what its owner
runs. Only the columns of first order know no steps: they are asked about what these make of
inertias and of time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxid.diagnosis.goals.changes import changes, StatedDifference
from jaxid.diagnosis.goals.floor import Between, rms
from jaxid.dynamics.effect import Effect
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.problem.binding import Binding
from jaxid.problem.residual import OutputError
from jaxid.robots.tree import Tree
from jaxid.robots.yardstick import added_by_steps, as_it_stands


def steps_as_its_file(binding: Binding) -> bool:
    """Whether simulations take the steps that the robot's file asks its simulator for."""
    return bool(binding.chain.mechanism.integrator)


def run_of_file(bench: ProblemBuilder, split: str = "fit") -> Between | None:
    """The free runs of the file as it stands in the runs of a split, from which nothing is apart;
    None where they do not come to their end.
    """
    b, runs, n = bench.binding, bench.binding.experiments(split), bench.binding.chain.nq
    if not runs or b.chain.joint_outputs != list(range(len(b.sigma))):
        return None
    theta = as_it_stands(b)[0]
    starts = estimate_starts(bench, split, [theta])[0]
    made = bench.runs(OutputError(), split)
    lanes = made.engine.outputs(
        np.repeat(theta[None], len(runs), 0), starts, np.array(made.records)
    )
    theirs, apart, before, left = [], [], [], []
    for k, (e, lane) in enumerate(zip(runs, lanes, strict=True)):
        own = made.record(made.records[k])
        y = lane[own.samples - own.offset, :n]
        theirs.append(y)
        apart.append(np.zeros_like(y))
        before.append(np.zeros((len(made.before(k)), n)))
        left.append(e.y[:, :n] - y)
    if not all(np.isfinite(y).all() for y in theirs):
        return None
    return Between(apart=apart, left=rms(left), theirs=theirs, before=before)


def stepped_changes(binding: Binding, kinds: Sequence[type[Effect]]) -> list[StatedDifference]:
    """Single changes of a model that steps as its file, by columns that know no steps: armatures
    are those that appear in such steps, and readings are seen as late as they were asked for.
    """
    tree: Tree = binding.chain.mechanism.tree.tree  # type: ignore[attr-defined]
    added = _added(binding, tree)
    early = 0.0 if tree.steps is None else tree.steps.delay
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
