"""The mechanism that a text means: an id, a URDF, a file of the user's own."""

from __future__ import annotations

from typing import Any

from jaxid.data.dataset import ModelSpec
from jaxid.dynamics import catalogue
from jaxid.robots.arm_table import arm_table


def named_model(text: str, stated: ModelSpec) -> Any:
    """A mechanism by its name, with what a dataset states of one of that name: the links of an arm,
    the file of a model of the user's own. Raises `UsageError` for an unknown name and for a file
    that holds no model.
    """
    if text.endswith(".urdf"):
        return catalogue.model_class("serial_arm").from_urdf(text)
    if text != stated.name:
        return catalogue.model_class(text)()
    if stated.geometry is not None:
        return catalogue.model_class(text)(arm_table(stated.geometry))
    return catalogue.model_class(stated.file or text)()
