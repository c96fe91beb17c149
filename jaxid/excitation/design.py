"""Design of experiments: motion or input that shows what a model's data are to determine; `jaxid
excite`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.base.numbers import parameter_value
from jaxid.base.wording import names_of
from jaxid.data.dataset import ModelSpec
from jaxid.data.limits import Limits
from jaxid.data.model_names import is_model_file
from jaxid.dynamics import catalogue
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.excitation.bounds import bounds_of
from jaxid.excitation.input_design import design_input
from jaxid.excitation.motion_design import design_motion
from jaxid.excitation.result import Excitation
from jaxid.excitation.trajectories import (
    CRITERIA,
)
from jaxid.identification.regression import LAWS
from jaxid.robots.match import is_file, robot_from, spec_of_file


FRICTIONS = ("model", *LAWS)


def excite(
    model: object,
    *,
    harmonics: int = 8,
    base_frequency_hz: float | None = None,
    duration_s: float = 10.0,
    rate_hz: float = 125.0,
    limits: Limits | None = None,
    criterion: str | None = None,
    friction: str = "model",
    starts: int = 16,
    iterations: int = 400,
    seed: int = 0,
    floor: float = 0.0,
    radius: float = 0.06,
    amplitude: Sequence[float] | None = None,
    gain: Sequence[float] | None = None,
    parameters: Mapping[str, Any] | None = None,
    progress: Callable[[str, int, int, str], None] | None = None,
) -> Excitation:
    """An experiment for a model: `model` an id, the path of a URDF, or a mechanism.

    An arm gets a periodic motion that starts and ends at rest, within its limits (`limits`, else
    those of the model), its links (capsules of `radius` m) apart and above `floor` m; `friction`
    names the law whose columns are to be told apart (`model`: the model's own). Any other model
    gets an input, at most `amplitude` in the input's unit, chosen by simulation with the values of
    `parameters` (as in fit.json; else the model's). `criterion` is condition (the default for
    motions), d_optimal or, of a serial arm, paper001 (its objective (18)). `gain` N m/A adds the
    currents to command. Raises `UsageError` for what does not fit or cannot be kept.
    """
    began = time.perf_counter()
    _check_counts(harmonics=(harmonics, 2), starts=(starts, 1), iterations=(iterations, 1))
    _check_words(criterion, friction)
    if not (duration_s > 0 and rate_hz > 0 and duration_s * rate_hz <= 1e6):
        raise UsageError(
            f"{duration_s:g} s at {rate_hz:g} Hz: give a positive duration and rate, at most a"
            " million samples"
        )
    base = base_frequency_hz if base_frequency_hz is not None else 1 / duration_s
    _check_lines(harmonics, base, duration_s, rate_hz)
    mechanism, table = mechanism_of(model)
    chain = _with(Chain(mechanism), parameters)
    if criterion == "paper001" and (not hasattr(mechanism, "base") or harmonics < 3):
        raise UsageError(
            "criterion paper001 sorts the columns of a serial arm (ur10, panda, a URDF …) and needs"
            " 3 harmonics, for its sums take two of each joint; use condition or d_optimal"
        )
    bounds = bounds_of(mechanism.name, chain.signature, limits, table)
    t = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    plan = {
        "harmonics": harmonics,
        "base_frequency_hz": base,
        "duration_s": duration_s,
        "rate_hz": rate_hz,
        "seed": seed,
    }
    if hasattr(mechanism, "base") or mechanism.name == "planar_arm":
        made = design_motion(
            chain=chain,
            bounds=bounds,
            t=t,
            plan=plan,
            criterion=criterion or "condition",
            friction=friction,
            starts=starts,
            iterations=iterations,
            floor=floor,
            radius=radius,
            progress=progress,
        )
    else:
        made = design_input(
            chain=chain,
            bounds=bounds,
            t=t,
            plan=plan,
            criterion=criterion or "d_optimal",
            starts=starts,
            amplitude=amplitude,
            gain=gain,
            limits=limits,
            progress=progress,
        )
    made.content["wall_time_s"] = time.perf_counter() - began
    if is_file(model) and mechanism.name == "robot":
        return replace(made, dataset=replace(made.dataset, model=spec_of_file(model)))
    if is_model_file(model):
        spec = ModelSpec(mechanism.name, file=str(Path(model).resolve()))
        return replace(made, dataset=replace(made.dataset, model=spec))
    return made


def _check_counts(**counts: tuple[int, int]) -> None:
    """(value, least) by the names of the settings."""
    for name, (value, least) in counts.items():
        if value < least:
            raise UsageError(f"{name} is {value}; give at least {least}")


def _check_words(criterion: str | None, friction: str) -> None:
    if criterion is not None and criterion not in CRITERIA:
        raise UsageError(f"there is no criterion {criterion!r}{nearest(criterion, CRITERIA)}")
    if friction not in FRICTIONS:
        raise UsageError(f"there is no friction law {friction!r}{nearest(friction, FRICTIONS)}")


def _check_lines(harmonics: int, base: float, duration_s: float, rate_hz: float) -> None:
    """Whole periods of the base frequency, and samples enough for the highest line."""
    periods = duration_s * base
    if base <= 0 or round(periods) < 1 or abs(periods - round(periods)) > 1e-6:
        raise UsageError(
            f"{duration_s:g} s hold {periods:.4g} periods of {base:g} Hz; a motion ends"
            " at rest after whole ones"
        )
    if harmonics * base > rate_hz / 8:
        raise UsageError(
            f"the highest line, {harmonics * base:.3g} Hz, needs a rate of at least"
            f" {8 * harmonics * base:.3g} Hz"
        )


def chain_of(path: str) -> bool:
    """Whether the joints of a URDF, up to its tip, are one chain without mimics, as a serial arm
    has them.
    """
    tree = robot_from(path, getattr(path, "tip", None)).tree.tree
    return not tree.couplings and all(up == k - 1 for k, up in enumerate(tree.parent))


def mechanism_of(model: object) -> tuple[Any, Any]:
    """(mechanism, table with the maker's limits or None)."""
    if is_file(model) and not (model.lower().endswith(".urdf") and chain_of(model)):
        robot = robot_from(model, getattr(model, "tip", None))
        return robot, robot.limits()
    if isinstance(model, str) and model.lower().endswith(".urdf"):
        from jaxid.robots.urdf_tree import read_urdf

        table = read_urdf(model, getattr(model, "tip", None))
        return catalogue.model_class("serial_arm")(table), table
    if isinstance(model, str):
        return catalogue.model_class(model)(), None
    if not hasattr(model, "signatures"):
        raise UsageError(
            f"a model is an id, the path of a URDF or a mechanism, not {type(model).__name__}"
        )
    return model, None


def _with(chain: Chain, content: Mapping[str, Any] | None) -> Chain:
    """The chain with the values of a fit."""
    if content is None:
        return chain
    present = set(names_of(chain.effects))
    added = []
    for e in content.get("effects", []):
        kind = catalogue.effect_class(e["effect"], chain.mechanism)
        if kind.name not in present:
            added.append(kind())
    chain = chain.with_effects(*added)
    layout = ParameterVector(chain)
    theta = layout.values.copy()
    for name, value in content.get("parameters", {}).items():
        theta[layout.index(name)] = parameter_value(name, value)
    for e in content.get("effects", []):
        for name, value in e.get("parameters", {}).items():
            for i in layout.of_effect(e["effect"], e.get("location")):
                if layout.entries[i].field == name:
                    theta[i] = parameter_value(name, value)
    return layout.model(theta)
