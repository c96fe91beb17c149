"""The options --model and --tip of every command that takes a model."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import click


class RobotFile(str):
    """The path of a robot's file, with the link up to which its joints move."""

    tip: str | None = None


def MODEL(command: Callable) -> Callable:
    """The options --model and --tip; a command sees the model alone."""

    @functools.wraps(command)
    def with_tip(*args: Any, tip: str | None, model: str | None, **more: Any) -> Any:
        if tip is not None:
            if model is None or not model.lower().endswith((".urdf", ".xml", ".mjcf")):
                raise click.UsageError(
                    "--tip goes with --model FILE; in dataset.toml it stands as `tip` under [model]"
                )
            model = RobotFile(model)
            model.tip = tip
        return command(*args, model=model, **more)

    text = (
        "Model id (see `jaxid models`), a robot's file, or FILE.py[:CLASS] of your own; default:"
        " the dataset's."
    )
    tipped = click.option(
        "--tip", metavar="LINK", help="Of a robot's file, only the joints up to this link move."
    )(with_tip)
    return click.option("--model", metavar="M", help=text)(tipped)
