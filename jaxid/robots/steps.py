"""What the steps of the simulator that a robot's file is of make of its numbers.

MuJoCo's steps are of first order: velocity first, then position by the new velocity. In a step of h
seconds, damping d that is taken at its end acts like an inertia h d / 2 more, and at its beginning
like as much less; a command that jumps acts h / 2 early. A motion simulated without such steps
tells an inertia with that share, and a delay without it. Runge and Kutta's steps have none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


#: Whose steps a robot takes that gives way as its file says, in steps that leave nothing behind.
EXACT_STEPS = "mujoco_rk4"
#: Integrator -> signs of what a joint's damping and a drive's add to the inertia.
SIGNS = {"EULER": (1.0, -1.0), "IMPLICIT": (1.0, 1.0), "IMPLICITFAST": (1.0, 1.0)}


@dataclass(frozen=True)
class Steps:
    """Steps of `step` s by an `integrator` that is not exact; `damping` and `drive`: 1 where it
    takes a joint's damping, and that of its drive, at the end of a step, -1 at its beginning.
    """

    step: float
    integrator: str
    damping: float
    drive: float

    def inertia(self, damping: float, kd: float) -> float:
        """What a joint's inertia appears to be more, with damping and its drive's gain kd."""
        return self.step / 2 * (self.damping * damping + self.drive * kd)

    @property
    def delay(self) -> float:
        """By how many seconds a command that jumps acts early."""
        return self.step / 2

    @property
    def said(self) -> str:
        return f"{self.integrator.lower()} steps of {self.step:g} s"


def steps_of(mj: Any, model: Any) -> Steps | None:
    """Those of a compiled model, None where they are exact enough or not known."""
    name = mj.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_")
    if name not in SIGNS:
        return None
    damping, drive = SIGNS[name]
    if name == "EULER" and int(model.opt.disableflags) & int(mj.mjtDisableBit.mjDSBL_EULERDAMP):
        damping = -1.0
    return Steps(float(model.opt.timestep), name, damping, drive)


def nearest(stated: float, found: float, added: float) -> float:
    """What a file would have to state for what was `found`, where steps add something between
    nothing and `added` to it: as near to what is `stated` as that allows.
    """
    low, high = sorted((found - added, found))
    if stated < low:
        return low
    return min(stated, high)
