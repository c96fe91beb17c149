"""The tables of dataset.toml that say what is simulated: model, base, links, priors of parameters,
and the controller.
"""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, FiniteFloat, model_validator

from jaxid.data.schema_fields import Number, plain_text, Strict


class GaussEntry(Strict):
    """A Gaussian prior."""

    mean: FiniteFloat
    std: FiniteFloat = Field(gt=0)


class PriorEntry(Strict):
    """`[model.parameters.NAME]`: start value, bounds, search scale and Gaussian prior of a fitted
    number.
    """

    value: FiniteFloat | None = None
    lower: FiniteFloat | None = None
    upper: FiniteFloat | None = None
    log: bool | None = None
    prior: GaussEntry | None = None

    @model_validator(mode="after")
    def _ordered(self) -> PriorEntry:
        lower = -math.inf if self.lower is None else self.lower
        upper = math.inf if self.upper is None else self.upper
        value = lower if self.value is None else self.value
        if not lower <= value <= upper or lower == upper:
            raise ValueError(
                "lower, value and upper must rise in this order (a known value belongs in"
                " [model.constants])"
            )
        if self.log and self.lower is not None and lower <= 0:
            raise ValueError(
                "log = true searches the logarithm, and lower is not above 0: raise it"
            )
        if self.prior is not None and not lower <= self.prior.mean <= upper:
            raise ValueError("the mean of the prior lies outside of lower and upper")
        return self


class LinksEntry(Strict):
    """`[model.dh]`: a Denavit-Hartenberg table of a `serial_arm`, one number a joint, m and rad."""

    convention: Literal["modified", "standard"] = "modified"
    a: list[FiniteFloat] = Field(min_length=1, max_length=64)
    alpha: list[FiniteFloat]
    d: list[FiniteFloat]
    theta: list[FiniteFloat] | None = None
    prismatic: list[bool] | None = None

    @model_validator(mode="after")
    def _even(self) -> LinksEntry:
        for name in ("alpha", "d", "theta", "prismatic"):
            column = getattr(self, name)
            if column is not None and len(column) != len(self.a):
                raise ValueError(
                    f"{name} has {len(column)} entries and a has {len(self.a)}: one for each joint"
                )
        return self


class BaseEntry(Strict):
    """`[model.base]` of a robot: how its base stands, rad."""

    kind: Literal["fixed", "prescribed", "free"] = "fixed"
    roll: FiniteFloat = 0.0
    pitch: FiniteFloat = 0.0
    yaw: FiniteFloat = 0.0


class ModelEntry(Strict):
    """`[model]`.

    `urdf` (a file of the folder, with the `root` and the `tip` of the chain where it has several)
    or `dh` are the links of a `serial_arm`; `robot` is the file of any robot, MJCF or URDF, with
    its `base`. `file` holds a model of the user's own, `name` its class where there are several.
    `joints` says which joint a channel is of (`q1` and its `tau1`, `q1_cmd` … alike). `trust` says
    how far stated numbers may be off.
    """

    name: str | None = None
    file: str | None = None
    without: list[str] = []
    free: bool = False
    constants: dict[str, Number] = {}
    parameters: dict[str, PriorEntry] = {}
    urdf: str | None = None
    tip: str | None = None
    root: str | None = None
    dh: LinksEntry | None = None
    robot: str | None = None
    base: BaseEntry | None = None
    joints: dict[str, str] = {}
    trust: Literal["exact", "measured", "loose"] | None = None
    simulator: Literal["own", "mujoco", "mujoco_rk4"] | None = None
    contacts: bool | None = None

    @field_validator("joints")
    @classmethod
    def _joints(cls, value: dict[str, str]) -> dict[str, str]:
        for channel, joint in value.items():
            plain_text(joint)
            if sum(joint == other for other in value.values()) > 1:
                raise ValueError(
                    f"{channel!r}: two channels are of joint {joint!r}; one joint has one position"
                )
        return value

    @property
    def _has_links(self) -> bool:
        return self.urdf is not None or self.dh is not None

    @model_validator(mode="after")
    def _apart(self) -> ModelEntry:
        is_robot = self.name in (None, "robot")
        if self.file is not None and (self.robot is not None or self._has_links):
            raise ValueError(
                "file holds a model of your own, beside which robot, urdf and dh do not stand: keep"
                " one of them"
            )
        if self.robot is not None and (self._has_links or not is_robot):
            raise ValueError(
                "robot names the file of a robot, beside which name, urdf and dh do not stand: keep"
                " one of them"
            )
        if self.base is not None and not is_robot:
            raise ValueError(
                'base belongs to a robot: write robot = "robot.xml" (or a URDF) in place of the'
                " name"
            )
        both = sorted(set(self.constants) & set(self.parameters))
        if both:
            raise ValueError(f"{both[0]!r} is both known (constants) and to be fitted (parameters)")
        return self

    @model_validator(mode="after")
    def _links(self) -> ModelEntry:
        if self.urdf is not None and self.dh is not None:
            raise ValueError("the links stand in both urdf and dh: keep one of them")
        if self._has_links and self.name != "serial_arm":
            raise ValueError(
                'urdf and dh are the links of the model "serial_arm": write name = "serial_arm"'
            )
        if self.urdf is not None:
            return self
        if self.root is not None:
            raise ValueError("root names the beginning of a chain in a URDF, and there is no urdf")
        if self.tip is not None and self.robot is None:
            raise ValueError("tip names the end of a chain in a URDF, and there is no urdf")
        return self


class ControllerEntry(BaseModel):
    """`[controller]`: its kind; gains, sample time and saturation as numbers or lists of numbers;
    the names of channels.
    """

    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False)
    __pydantic_extra__: dict[str, FiniteFloat | list[FiniteFloat] | dict[str, FiniteFloat]]
    kind: str
    fit: list[str] | None = None
    spread: FiniteFloat | dict[str, FiniteFloat] | None = None
    velocity: str | None = None
    reference: str | list[str] | None = None
    reference_velocity: str | list[str] | dict[str, str] | None = None
    disturbance: str | list[str] | None = None

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that is stated besides the kind."""
        return {
            name: value
            for name, value in self.model_dump(exclude={"kind"}).items()
            if value is not None
        }
