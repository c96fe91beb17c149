"""Limbs on a base that does not move are robots of their own, with their own part of a
recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from jaxid.base.wording import names_of
from jaxid.data.dataset import Controller, Dataset, Experiment
from jaxid.robots.beside import rates_of
from jaxid.robots.drives import NUMBERS
from jaxid.robots.match import is_robot, prepared, recorded
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
    return [
        (type(whole)(tree.only(joints), driven=False), part(dataset, tree, joints))
        for joints in groups
    ]


def part(dataset: Dataset, tree: Tree, joints: Sequence[str]) -> Dataset:
    """The channels and statements of some joints."""
    own, links = tree.only(joints), tree.only(joints).links
    names = {*own.joints, *links}

    def mine(name):
        return not {name, name.rsplit("_", 1)[0]}.isdisjoint(own.joints)

    def stray(name):
        return {name, name.rsplit("_", 1)[0]}.isdisjoint(tree.joints)

    law = None if dataset.controller is None else _law(dataset.controller, tree.leading, joints)
    rates = _rates(law, own.leading)

    def also(c):
        return stray(c.name) and (c.name.startswith("base_") or c.role == "auxiliary")

    keep = [c for c in dataset.channels if mine(c.name) or c.name in rates or also(c)]
    kept = set(names_of(keep))
    iu = [i for i, c in enumerate(dataset.inputs) if c.name in kept]
    iy = [i for i, c in enumerate(dataset.outputs) if c.name in kept]

    def of_outputs(values):
        return None if values is None else values[:, iy]

    def cut(e: Experiment) -> Experiment:
        return replace(
            e,
            u=e.u[:, iu],
            y=e.y[:, iy],
            scatter=of_outputs(e.scatter),
            left_out=of_outputs(e.left_out),
            auxiliary={k: v for k, v in e.auxiliary.items() if k in kept},
            initial=None if e.initial is None else {k: v for k, v in e.initial.items() if mine(k)},
            constants=_own(e.constants, names),
            past=e.past_by(cut),
        )

    model = dataset.model
    if model is not None:
        model = replace(
            model,
            constants=_own(model.constants, names),
            parameters=_own(model.parameters, names),
            joints={},
        )
    return replace(
        dataset,
        channels=tuple(keep),
        experiments=tuple(map(cut, dataset.experiments)),
        model=model,
        controller=law,
    )


def _own(numbers: Mapping[str, Any], names: set[str]) -> dict[str, Any]:
    """Numbers that belong to no joint or link, or to one of these."""
    return {
        k: v
        for k, v in numbers.items()
        if "@" not in k or k.split("@", 1)[1].removesuffix("_cmd") in names
    }


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

    def at(e):
        return e.partition("@")[2] if isinstance(e, str) else ""

    return tuple(
        e for e in effects if not at(e) or at(e) in joints or at(e).rsplit("_", 1)[0] in joints
    )
