"""Limbs on a base that does not move are robots of their own: fitted one by one, put together again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from jaxid.data.dataset import Controller, Dataset, Experiment
from jaxid.fitting.result import Covariance, Fit, Score
from jaxid.robots.beside import rates_of
from jaxid.robots.drives import NUMBERS
from jaxid.robots.match import is_robot, prepared, recorded
from jaxid.robots.origin import joined
from jaxid.robots.tree import Tree


def limbs_of(model: object, dataset: Dataset) -> list[tuple[Any, Dataset]]:
    """(robot, dataset) of each limb that a recording shows; none for a model that is no robot."""
    model, dataset = prepared(model, dataset)
    if not is_robot(model):
        return []
    whole: Any = model
    if whole.tree.tree.floats:  # its limbs move each other through the base
        return [(whole, dataset)]
    tree, _ = recorded(whole.tree.tree, dataset)
    groups = tree.limbs()
    return [(type(whole)(tree.only(joints), driven=False), part(dataset, tree, joints)) for joints in groups]


def part(dataset: Dataset, tree: Tree, joints: Sequence[str]) -> Dataset:
    """The channels and statements of some joints."""
    own, links = tree.only(joints), tree.only(joints).links
    names = {*own.joints, *links}
    mine = lambda name: name in own.joints or name.rsplit("_", 1)[0] in own.joints
    stray = lambda name: not any(name == j or name.rsplit("_", 1)[0] == j for j in tree.joints)
    law = None if dataset.controller is None else _law(dataset.controller, tree.leading, joints)
    rates = _rates(law, own.leading)
    also = lambda c: c.name.startswith("base_") or (c.role == "auxiliary" and stray(c.name))
    keep = [c for c in dataset.channels if mine(c.name) or c.name in rates or also(c)]
    kept = {c.name for c in keep}
    iu = [i for i, c in enumerate(dataset.inputs) if c.name in kept]
    iy = [i for i, c in enumerate(dataset.outputs) if c.name in kept]

    def cut(e: Experiment) -> Experiment:
        return replace(
            e,
            u=e.u[:, iu],
            y=e.y[:, iy],
            scatter=None if e.scatter is None else e.scatter[:, iy],
            left_out=None if e.left_out is None else e.left_out[:, iy],
            auxiliary={k: v for k, v in e.auxiliary.items() if k in kept},
            initial=None if e.initial is None else {k: v for k, v in e.initial.items() if mine(k)},
            constants=_own(e.constants, names),
            past=None if e.past is None else cut(e.past),
        )

    model = dataset.model
    if model is not None:
        model = replace(model, constants=_own(model.constants, names), parameters=_own(model.parameters, names), joints={})
    return replace(
        dataset,
        channels=tuple(keep),
        experiments=tuple(map(cut, dataset.experiments)),
        model=model,
        controller=law,
    )


def _own(numbers: Mapping[str, Any], names: set[str]) -> dict[str, Any]:
    """Numbers that belong to no joint or link, or to one of these."""
    return {k: v for k, v in numbers.items() if "@" not in k or k.split("@", 1)[1].removesuffix("_cmd") in names}


def _law(controller: Controller, every: Sequence[str], joints: Sequence[str]) -> Controller:
    settings: dict[str, Any] = dict(controller.settings)
    for key, value in settings.items():
        if key not in (*NUMBERS, "kv", "reference_velocity"):
            continue
        if isinstance(value, Mapping):
            settings[key] = {k: v for k, v in value.items() if k in joints or k not in every}
        elif isinstance(value, list) and len(value) == len(every):
            settings[key] = [v for v, j in zip(value, every, strict=True) if j in joints]
    return Controller(controller.kind, settings)


def _rates(law: Controller | None, joints: Sequence[str]) -> tuple[str, ...]:
    """Channels of the goals' rates that a law names."""
    stated = None if law is None else law.settings.get("reference_velocity")
    return () if stated in (None, "none", "difference") else rates_of(stated, joints)


def effects_at(effects: Sequence[Any], robot: Any) -> tuple[Any, ...]:
    """Those effects (`dead_zone@NAME_cmd`) that have no place, or one in this limb."""
    joints = robot.tree.tree.joints
    at = lambda e: e.partition("@")[2] if isinstance(e, str) else ""
    return tuple(e for e in effects if not at(e) or at(e) in joints or at(e).rsplit("_", 1)[0] in joints)


def together(fits: Sequence[Fit], dataset: Dataset) -> Fit:
    """One result of the fits of all limbs."""
    first = fits[0]
    weight = np.array([max(1, len(next(iter(f.scores.values()), {}))) for f in fits], float)
    scores: dict[str, dict[str, Score]] = {}
    for f in fits:
        for split, table in f.scores.items():
            scores.setdefault(split, {}).update(table)
    windows = {k: v for f in fits for k, v in f.windowed.items()}
    stopped = next((f for f in fits if f.failed), next((f for f in fits if not f.converged), first))
    notes = dict.fromkeys(n for f in fits for n in f.notes)
    return replace(
        first,
        effects=tuple(e for f in fits for e in f.effects),
        converged=all(f.converged for f in fits),
        failed=any(f.failed for f in fits),
        stopped_because=stopped.stopped_because,
        loss=float(np.sum(weight * [f.loss for f in fits]) / weight.sum()),
        parameters={k: v for f in fits for k, v in f.parameters.items()},
        scores=scores,
        windowed=windows,
        evaluations=sum(f.evaluations for f in fits),
        wall_time_s=sum(f.wall_time_s for f in fits),
        compile_time_s=sum(f.compile_time_s for f in fits),
        dataset=dataset.name,
        dataset_sha256=dataset.sha256,
        notes=(*notes, f"{len(fits)} limbs that do not move each other were fitted one by one"),
        correlated=tuple(g for f in fits for g in f.correlated),
        history=tuple(h for f in fits for h in f.history),
        traces=tuple(t for f in fits for t in f.traces),
        theta=np.zeros(0),
        stated=tuple(r for f in fits for r in f.stated),
        per_joint=tuple(r for f in fits for r in f.per_joint),
        robot=joined([f.robot for f in fits]),
        covariance=_side_by_side(fits),
    )


def _side_by_side(fits: Sequence[Fit]) -> Covariance | None:
    own = [f.covariance for f in fits if f.covariance is not None]
    if len(own) < len(fits):
        return None
    return Covariance(tuple(n for c in own for n in c.names), np.asarray(block_diag(*(c.matrix for c in own))))


def each(limbs: Sequence[tuple[Any, Dataset]], work: Callable[[Any, Dataset], Fit], dataset: Dataset) -> Fit:
    """The work done for each limb, put together."""
    fits = [work(robot, data) for robot, data in limbs]
    return together(fits, dataset) if len(fits) > 1 else fits[0]
