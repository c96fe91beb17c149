"""Which models a dataset could be of, by the names and units of its channels."""

from __future__ import annotations

from dataclasses import dataclass

from jaxid.base.wording import first_sentence
from jaxid.data.dataset import Dataset
from jaxid.dynamics import catalogue
from jaxid.dynamics.joint_readings import with_speeds
from jaxid.dynamics.mechanism import Signature


@dataclass(frozen=True)
class ProposedModel:
    """A model with channels such as a dataset has. `renamed`: the dataset's channel -> what the
    model calls it, where names differ.
    """

    name: str
    says: str
    renamed: dict[str, str]

    def __str__(self) -> str:
        if not self.renamed:
            return f"{self.name} ({self.says})"
        other = ", ".join(f"{own} as {theirs}" for own, theirs in self.renamed.items())
        return f"{self.name} ({self.says}), with {other}"


def proposed_models(dataset: Dataset) -> tuple[ProposedModel, ...]:
    """The built-in models that take the dataset's inputs and give its outputs. Speeds may stand
    beside positions or in their place. Those whose channels have the same names come alone; else
    those whose channels have the same units in the same order.
    """
    inputs = _channels(dataset, "input")
    outputs = _channels(dataset, "output")
    named: list[ProposedModel] = []
    alike: list[ProposedModel] = []
    for name in catalogue.model_names():
        info = catalogue.describe(name)
        for signature in info.signatures:
            renamed = _renamed(inputs, outputs, with_speeds(signature, dict(outputs)))
            if renamed is None:
                continue
            found = ProposedModel(name, first_sentence(info.text), renamed)
            (alike if renamed else named).append(found)
            break
    return tuple(named or alike)


def _renamed(
    inputs: list[tuple[str, str]], outputs: list[tuple[str, str]], signature: Signature
) -> dict[str, str] | None:
    """The dataset's channel -> the model's, where names differ; None where units differ too."""
    same_names = sorted(inputs) == sorted(signature.inputs)
    if same_names and sorted(outputs) == sorted(signature.outputs):
        return {}
    own = [*inputs, None, *outputs]
    theirs = [*signature.inputs, None, *signature.outputs]
    if [c and c[1] for c in own] != [c and c[1] for c in theirs]:
        return None
    pairs = zip([*inputs, *outputs], [*signature.inputs, *signature.outputs], strict=True)
    return {mine: other for (mine, _), (other, _) in pairs if mine != other}


def _channels(dataset: Dataset, role: str) -> list[tuple[str, str]]:
    """(name, unit) of the channels of a role."""
    return [(c.name, c.unit) for c in dataset.channels if c.role == role]


def without_a_model(dataset: Dataset) -> str:
    """What to say and to type where neither the dataset nor the user names a model."""
    said = "the dataset names no model"
    channels = [*_channels(dataset, "input"), *_channels(dataset, "output")]
    listed = ", ".join(f"{name} in {unit}" for name, unit in channels)
    found = proposed_models(dataset)
    if not found:
        names = ", ".join(catalogue.model_names())
        return (
            f"{said}. No built-in model has its channels ({listed}): give a robot's file"
            f" (--model robot.xml), a model of your own (--model mine.py), or one of {names}"
        )
    first = found[0]
    models = "; or ".join(map(str, found))
    if first.renamed:
        lines = [f"[channels.{other}] column = {own!r}" for own, other in first.renamed.items()]
        return (
            f"{said}. Models with channels of the same units ({listed}): {models}. Name the"
            f" channels so in dataset.toml ({', '.join(lines)}), then type --model {first.name}"
        )
    return f"{said}. Its channels ({listed}) are those of: {models}. Type --model {first.name}"
