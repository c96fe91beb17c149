"""How a robot's file says that MuJoCo simulates it: time step, integrator, soft friction and stops.

What solref and solimp mean is worked out here for the step of the file, so that a simulation is
told numbers of each joint alone.

Source: MuJoCo's documentation, chapter Modeling, "Solver parameters".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxid.base.wording import listed
from jaxid.dynamics.mujoco_step import INTEGRATORS
from jaxid.dynamics.soft_constraints import FAR
from jaxid.robots.steps import EXACT_STEPS


#: Bounds of what solimp may say of an impedance.
LEAST, MOST = 1e-4, 0.9999
#: A number less than this is none.
NOTHING = 1e-15
#: A delay is a multiple of steps to this share of one.
WHOLE = 1e-6
#: Origin of a law that the dataset states.
STATED = "[controller]"
#: Parts of MuJoCo's physics that its step is not taken without.
NEEDED = ("CONSTRAINT", "FRICTIONLOSS", "LIMIT", "SPRING", "DAMPER", "ACTUATION")
#: solref and solimp that a file gets that states none.
SOLREF, SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)
#: solref and solimp of friction with which a joint holds 50 times better than with these.
HARD_SOLREF, HARD_SOLIMP = (0.004, 1.0), (0.99, 0.9999, *SOLIMP[2:])

#: Numbers of a joint, in the order of `jaxid.dynamics.soft_constraints.Slip` and `Stops`.
FIELDS = (
    "slip_rate",
    "slip_share",
    "stop_lower",
    "stop_upper",
    "stop_margin",
    "stop_stiffness",
    "stop_rate",
    "stop_softest",
    "stop_hardest",
    "stop_width",
    "stop_midpoint",
    "stop_power",
)


@dataclass(frozen=True)
class FileStep:
    """Steps of `timestep` s by an `integrator` of `jaxid.dynamics.mujoco_step.INTEGRATORS`, and how
    joints give way: numbers in the order of FIELDS by the joint's name.
    """

    timestep: float
    integrator: str
    joints: Mapping[str, tuple[float, ...]]

    def exact(self) -> FileStep:
        """Steps of that length which leave nothing behind, over joints that give way alike."""
        return replace(self, integrator="RK4")

    @property
    def said(self) -> str:
        name = {"EXPLICIT": "Euler", "RK4": "RK4"}.get(
            self.integrator, self.integrator.capitalize()
        )
        return f"{name} steps of {self.timestep:g} s with MuJoCo's soft friction and stops"

    def of(self, joints: Sequence[str]) -> dict[str, np.ndarray]:
        """Arrays [joints] by the names of FIELDS; of joints of no file as MuJoCo's default."""
        rows = [self.joints.get(joint, self.default()) for joint in joints]
        return dict(zip(FIELDS, np.array(rows, np.float64).reshape(-1, len(FIELDS)).T, strict=True))

    def hard(self, joint: str) -> tuple[float, float]:
        """Rate and share of a joint's friction where it is hardened, or as it is where that is
        harder.
        """
        rate, share, *_ = self.joints.get(joint, self.default())
        hardened = joint_numbers(
            friction=HARD_SOLREF,
            friction_impedance=HARD_SOLIMP,
            stop=SOLREF,
            stop_impedance=SOLIMP,
            ends=(-FAR, FAR),
            margin=0.0,
            quickest=2 * self.timestep,
        )
        return max(rate, hardened[0]), min(share, hardened[1])

    def default(self) -> tuple[float, ...]:
        """A joint without stops, as soft as MuJoCo has it where nothing is said."""
        return joint_numbers(SOLREF, SOLIMP, SOLREF, SOLIMP, (-FAR, FAR), 0.0, 2 * self.timestep)


def asked_of(simulator: str, own: FileStep | None) -> FileStep | None:
    """The steps that a robot takes by a simulator ("own", "mujoco", "mujoco_rk4") whose file has
    steps of its `own`.
    """
    if own is None or simulator == "own":
        return None
    return own.exact() if simulator == EXACT_STEPS else own


def file_step(mj: Any, model: Any, joints: Mapping[str, int]) -> FileStep | None:
    """That of a compiled model, for joints by name with their numbers in it; None where its
    integrator is not known, or what every step here needs is disabled.
    """
    flags = int(model.opt.disableflags)

    def disabled(name: str) -> bool:
        return bool(flags & int(getattr(mj.mjtDisableBit, f"mjDSBL_{name}")))

    integrator = mj.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_")
    if integrator == "EULER" and disabled("EULERDAMP"):
        integrator = "EXPLICIT"
    if integrator not in INTEGRATORS or any(map(disabled, NEEDED)) or model.opt.noslip_iterations:
        return None
    timestep = float(model.opt.timestep)
    quickest = 0.0 if disabled("REFSAFE") else 2 * timestep
    numbers = {}
    for name, j in joints.items():
        dof = int(model.jnt_dofadr[j])
        ends = tuple(model.jnt_range[j]) if model.jnt_limited[j] else (-FAR, FAR)
        numbers[name] = joint_numbers(
            friction=model.dof_solref[dof],
            friction_impedance=model.dof_solimp[dof],
            stop=model.jnt_solref[j],
            stop_impedance=model.jnt_solimp[j],
            ends=ends,
            margin=float(model.jnt_margin[j]),
            quickest=quickest,
        )
    return FileStep(timestep, integrator, numbers)


def joint_numbers(
    friction: Sequence[float],
    friction_impedance: Sequence[float],
    stop: Sequence[float],
    stop_impedance: Sequence[float],
    ends: Sequence[float],
    margin: float,
    quickest: float,
) -> tuple[float, ...]:
    """Numbers of a joint in the order of FIELDS from its solref and solimp, for friction and for
    stops; time constants are `quickest` s at least.
    """
    _, slip_rate = _reference(friction, friction_impedance, quickest)
    softest, hardest, width, *_ = _impedance(friction_impedance)
    # Friction is always at distance zero: at the softest end, or in the middle of a flat curve.
    flat = softest == hardest or width <= NOTHING
    held = (softest + hardest) / 2 if flat else softest
    stiffness, rate = _reference(stop, stop_impedance, quickest)
    numbers = (
        slip_rate,
        (1 - held) / held,
        *ends,
        margin,
        stiffness,
        rate,
        *_impedance(stop_impedance),
    )
    return tuple(map(float, numbers))


def _impedance(solimp: Sequence[float]) -> tuple[float, float, float, float, float]:
    softest, hardest, width, midpoint, power = map(float, solimp)
    return (
        float(np.clip(softest, LEAST, MOST)),
        float(np.clip(hardest, LEAST, MOST)),
        max(0.0, width),
        float(np.clip(midpoint, LEAST, MOST)),
        max(1.0, power),
    )


def _reference(
    solref: Sequence[float], solimp: Sequence[float], quickest: float
) -> tuple[float, float]:
    """(stiffness 1/s^2, rate 1/s) of a constraint: stated directly by negative numbers, else by a
    time constant and a damping ratio.
    """
    first, second = map(float, solref)
    if (first > 0) != (second > 0):  # MuJoCo takes its default in place of a mixture
        first, second = SOLREF
    hardest = _impedance(solimp)[1]
    if first <= 0:
        return -first / hardest**2, -second / hardest
    constant = max(first, quickest)
    stiffness = 1 / max(NOTHING, (hardest * constant * second) ** 2)
    return stiffness, 2 / max(NOTHING, hardest * constant)


def beyond_its_step(tree: Any, law: Any) -> str:
    """What of a robot's file its step here is not MuJoCo's in, "" where it is; `tree` a
    `jaxid.robots.tree.Tree` and `law` the `DriveLaw` that drives it.
    """
    step = tree.simulator
    if tree.floats:
        return "its base floats"
    if step is None:
        return "its file asks for no steps that are known here"
    if tree.couplings:
        followers = listed([one.follower for one in tree.couplings])
        return f"MuJoCo couples {followers} softly"
    for joint, delay in zip(tree.driven, law.delay, strict=True):
        steps = delay / step.timestep
        if law.origin != STATED and abs(steps - round(steps)) > WHOLE:
            return f"the delay of {joint} is not a multiple of the file's steps"
    return ""
