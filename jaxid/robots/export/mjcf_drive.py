"""A drive's numbers in the words of one actuator of an MJCF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxid.robots.export.sheet import JointNumbers


#: A limit that MuJoCo is given where there is none in one direction.
ENDLESS = 1e9
#: Shortest time step, in seconds, at which a delay still fits into the memory that is written for
#: it.
SHORTEST = 1e-4
HISTORY = f"seconds; nsample is enough for time steps of {1e3 * SHORTEST:g} ms and longer"
#: Attributes of <position> that <general> has not.
OWN_WORDS = ("kp", "kv", "dampratio", "timeconst", "inheritrange")

#: Attributes of <general> that say a number of a drive, those of other elements, and of both.
OF_GENERAL = {"kp": "gainprm, biasprm", "kd": "biasprm", "lag": "dyntype, dynprm"}
OF_OTHERS = {"kp": "kp", "kd": "kv", "lag": "timeconst"}
OF_BOTH = {
    "offset": "biasprm",
    "torque": "biasprm",
    "drive": "gear",
    "delay": "delay, nsample, interp",
}
#: Numbers of a position law at one joint.
OF_LAW = ("kp", "kd", "ki", "offset", "lowest", "highest", "delay", "lag")


def attribute_of(number: str, tag: str) -> str:
    """The attributes of an element `tag` that say a number of a drive."""
    own = OF_GENERAL if tag == "general" else OF_OTHERS
    return {**OF_BOTH, **own}.get(number, "forcerange")


@dataclass(frozen=True)
class DriveWords:
    """Attributes of actuator number `actuator` of a compiled `model`; `driven`: goals drive it, and
    not torques.
    """

    model: Any
    actuator: int
    driven: bool

    @property
    def gear(self) -> float:
        """The actuator's gear in the file."""
        return float(self.model.actuator_gear[self.actuator, 0])

    def attributes(
        self, changed: set[str], now: JointNumbers, tag: str
    ) -> tuple[dict[str, Any], str]:
        """(attributes, tag) of the element for the quantities that changed: its own words where it
        has them, else those of <general>.
        """
        own = self.general(changed, now)
        plain = tag == "position" and now.torque + now.offset == 0
        before = tag
        if tag != "general" and not plain and ({"gainprm", "timeconst"} & set(own)):
            tag = "general"
        if tag == "general":
            full = self.general(changed | {"kp"}, now)
            own |= {k: full[k] for k in ("gainprm", "biasprm")}
            own |= {"biastype": "affine"}
            lag = own.pop("timeconst", now.lag)
            own |= {"dyntype": "filterexact", "dynprm": lag} if lag else {}
        elif "gainprm" in own:
            own |= {"kp": own.pop("gainprm"), "kv": -own.pop("biasprm")[2], "dampratio": None}
        if "forcerange" in own:
            own["forcelimited"] = "true"
        if "gear" in own:
            own["gear"] = [own["gear"], *map(float, self.model.actuator_gear[self.actuator, 1:])]
        if "nsample" in own:
            own["nsample"] = str(own["nsample"])
        if tag != before:
            own |= {**dict.fromkeys(OWN_WORDS), "gaintype": "fixed", "biastype": "affine"}
        return own, tag

    def general(self, changed: set[str], now: JointNumbers) -> dict[str, Any]:
        """The quantities that changed in MuJoCo's general terms."""
        gear = self.gear * now.drive
        own: dict[str, Any] = {}
        if changed & {"kp", "kd", "offset", "torque"}:
            own |= self._gains(gear, now)
        if changed & {"lowest", "highest"} or (
            now.torque and np.isfinite([now.lowest, now.highest]).any()
        ):
            limits = (np.array([now.lowest, now.highest]) + now.torque) / gear
            finite = np.nan_to_num(limits, posinf=ENDLESS, neginf=-ENDLESS)
            own |= {"forcerange": sorted(map(float, finite))}
        if "delay" in changed:
            own |= {"delay": now.delay, "nsample": self._samples(now.delay), "interp": "linear"}
        if "lag" in changed:
            own["timeconst"] = now.lag
        if "drive" in changed:
            own["gear"] = gear
        return own

    def _gains(self, gear: float, now: JointNumbers) -> dict[str, Any]:
        if not self.driven:
            gain = float(self.model.actuator_gainprm[self.actuator, 0])
            return {"gainprm": gain, "biasprm": [now.torque / gear, 0.0, 0.0]}
        bias = [(now.offset + now.torque) / gear, -now.kp / gear**2, -now.kd / gear**2]
        return {"gainprm": now.kp / gear**2, "biasprm": bias}

    def _samples(self, delay: float) -> int:
        """MuJoCo remembers commands by their number: with too few of them a delay is cut short
        wherever the file runs at a shorter step.
        """
        step = min(float(self.model.opt.timestep), SHORTEST)
        return int(np.ceil(delay / step)) + 2
