"""The missing force of a robot on a base that does not move. Its limbs move each other in nothing:
each is fitted by itself, and where a reading leaves a limb's motion as it is, its fit is kept.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import listed
from jaxid.conventions.missing_force import ForceFit, LAWS, reading_fit, ReadingFit
from jaxid.data.dataset import Dataset
from jaxid.dynamics.joint_readings import read_by
from jaxid.force.sampled_motion import SampledMotion
from jaxid.problem.binding import bind, Binding
from jaxid.simulation.sample_buffers import columns


#: Fits of a limb that are kept.
KEPT = 16


@dataclass(frozen=True)
class LimbPlaces:
    """Where the joints, inputs and free numbers of a limb stand among the robot's."""

    joints: list[int]
    inputs: list[int]
    numbers: list[int]

    def part(self, m: SampledMotion) -> SampledMotion:
        """The limb's part of a motion of the robot."""
        mix = m.mix[:, self.inputs]
        return replace(
            m,
            q=m.q[:, self.joints],
            qd=m.qd[:, self.joints],
            qdd=m.qdd[:, self.joints],
            weight=m.weight[:, self.joints],
            sources=tuple(replace(s, u=s.u @ mix) for s in m.sources),
            mix=np.eye(len(self.inputs)),
            rows=m.rows[self.inputs],
            drift=m.drift[self.inputs],
        )


@dataclass(frozen=True)
class Limb:
    """A limb's own fit, its places among the robot's, and its latest fits by what was fitted."""

    fit: ForceFit
    places: LimbPlaces
    kept: OrderedDict[bytes, ReadingFit] = field(default_factory=OrderedDict)

    def fitted(self, m: SampledMotion, laws: bool) -> ReadingFit:
        """The fit of the limb's part of a motion of the robot."""
        own = self.places.part(m)
        content = hashlib.blake2b(str(laws).encode())
        for values in (own.q, own.qd, own.qdd, own.u, own.weight, own.held):
            content.update(np.ascontiguousarray(values).tobytes())
        key = content.digest()
        found = self.kept.pop(key, None)
        if found is None:
            found = self.fit.fit(own, laws)
        self.kept[key] = found
        while len(self.kept) > KEPT:
            self.kept.popitem(last=False)
        return found


class FitByLimb(ForceFit):
    """Fits of a bound robot limb by limb; those with further numbers of a reading are of the
    whole.
    """

    def __init__(self, binding: Binding, motion: SampledMotion, limbs: Sequence[Limb]):
        super().__init__(binding, motion)
        self.limbs = limbs

    def fit(
        self,
        m: SampledMotion,
        laws: bool = True,
        more: Callable[[np.ndarray], SampledMotion] | None = None,
        size: int = 0,
        hopeless: float = np.inf,
        begin: np.ndarray | None = None,
    ) -> ReadingFit:
        """See `ForceFit.fit`."""
        if more is not None:
            return super().fit(m, laws, more, size, hopeless, begin)
        count = len(LAWS) if laws else 0
        free = len(self.free)
        x = np.zeros(free + self.nq * count)
        residual = np.zeros(m.weight.shape)
        slopes = np.zeros((*m.weight.shape, len(x)))
        for limb in self.limbs:
            joints = limb.places.joints
            own = limb.fitted(m, laws)
            of_laws = free + count * np.array(joints)[:, None] + np.arange(count)
            numbers = [*limb.places.numbers, *of_laws.ravel().tolist()]
            x[numbers] = own.x
            residual[:, joints] = own.residual
            slopes[np.ix_(range(len(residual)), joints, numbers)] = own.slopes
        theta = self.binding.theta.copy()
        theta[self.free] = x[:free]
        share = residual * (self.norm(m) / self.norm(m, theta))
        return reading_fit(m, x, residual, slopes, share)


def force_fit(
    binding: Binding, motion: SampledMotion, limbs: Sequence[tuple[object, Dataset]]
) -> ForceFit:
    """The fit of a bound model; limb by limb where it has several (robot, dataset), each with
    joints, inputs and numbers of its own.
    """
    whole = ForceFit(binding, motion)
    if len(limbs) < 2:
        return whole
    found = []
    try:
        found = [_limb(whole, bind(robot, own)) for robot, own in limbs]
    except UsageError:  # a limb lacks by itself what it has beside the others
        return whole
    taken: list[int] = []
    joints: list[int] = []
    for limb in found:
        taken += limb.places.numbers
        joints += limb.places.joints
    if sorted(taken) != list(range(len(whole.free))) or sorted(joints) != list(range(whole.nq)):
        return whole
    return FitByLimb(binding, motion, found)


def _limb(whole: ForceFit, bound: Binding) -> Limb:
    """A limb bound to its part of the recording. Raises `UsageError` where it has what the robot
    has not.
    """
    places = LimbPlaces(
        joints=_among(_joints(bound), _joints(whole.binding)),
        inputs=_among(_inputs(bound), _inputs(whole.binding)),
        numbers=[],
    )
    fit = ForceFit(bound, places.part(whole.motion))
    numbers = _among(_numbers(fit), _numbers(whole))
    return Limb(fit, replace(places, numbers=numbers))


def _among(own: Sequence[str], every: Sequence[str]) -> list[int]:
    if not set(own) <= set(every):
        raise UsageError(f"a limb has {listed(sorted(set(own) - set(every)))} by itself")
    return [every.index(name) for name in own]


def _joints(binding: Binding) -> list[str]:
    outputs = binding.chain.signature.outputs
    return [outputs[k][0] for k in read_by(binding.chain)]


def _inputs(binding: Binding) -> list[str]:
    used, _ = columns(binding.dataset, binding.chain)
    return [binding.dataset.inputs[i].name for i in used]


def _numbers(fit: ForceFit) -> list[str]:
    return [fit.binding.layout.names[i] for i in fit.free]
