"""Where effects act on a robot that goals drive through a law."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from jaxid.dynamics.mechanism import Signature
from jaxid.robots.channels import goal, torque
from jaxid.robots.yielding import Yielding


class GoalDriven(Yielding):
    """Abstract: joints that torques drive, or goals through `drive_law`."""

    drive_law: Any = eqx.field(static=True, default=None)  # a `jaxid.robots.drives.DriveLaw`

    def behind_law(self, effect: Any) -> bool:
        """Whether an effect acts on the torque where a goal drives; the others act on the goal."""
        return self.drive_law is not None and effect.acts_on == "drive"

    def places(self, effect: Any, signature: Signature) -> tuple[str, ...]:
        if self.behind_law(effect):
            return tuple(map(torque, signature.joints))
        return super().places(effect, signature)

    @property
    def idle(self):
        if self.drive_law is None:
            return frozenset()
        names = self.signatures[0].joints
        still = [names[k] for k in self.drive_law.undriven]
        return frozenset((*map(goal, still), *map(torque, still)))
