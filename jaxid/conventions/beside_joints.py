"""Outputs that read no joint, such as an accelerometer on a link: their slow part follows from the
measured motion of the joints, and so does the slow part of the inputs. How it follows, a simulation
of the model tells; that it does so in the recording with the opposite sign, or a thousandfold, is a
slip.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import APART, MISFIT
from jaxid.conventions.mending import lines, Mending
from jaxid.conventions.readings import EFFECT_RANGE, factors_of, nearest_factor
from jaxid.conventions.samples import LONGEST, Shown
from jaxid.data.dataset import Dataset
from jaxid.data.signals import differentiate, filter_ends, zero_phase
from jaxid.dynamics.joint_readings import cutoffs, joint_readings
from jaxid.problem.binding import Binding
from jaxid.simulation.sample_buffers import columns


#: Share of a signal's power that follows from the motion, at least: in the simulation, and in the
#: recording, whose model's numbers may be off.
FOLLOWS, SEEN = 0.9, 0.8
#: Cutoffs at which the slow part is looked at, as shares of the highest frequency of the motion.
SLOW = 1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 32
#: A run holds at least this many periods of a cutoff.
PERIODS = 4


#: Outputs [time ny] of each run to fit, as the model of a binding moves freely under its inputs.
FreeRuns = Callable[[Binding], Sequence[np.ndarray]]


@dataclass(frozen=True)
class Run:
    """A run as recorded or as simulated: t [time], q [time nq], and the signals that read no joint,
    outputs and then inputs [time signals].
    """

    t: np.ndarray
    q: np.ndarray
    signals: np.ndarray


@dataclass(frozen=True)
class Followed:
    """By how many times a recorded signal is what the motion says, and the share of its power that
    follows from it.
    """

    ratio: float
    share: float


def signals_beside(
    binding: Binding, dataset: Dataset, inputs_agree: bool, free: FreeRuns
) -> list[Shown]:
    """Signs and units of the outputs that read no joint; of models with hidden states those of the
    inputs, too. `inputs_agree`: the inputs were compared with the motion before, and mended. `free`
    simulates.
    """
    chain = binding.chain
    hidden = chain.mechanism.hidden_states
    readings = joint_readings(chain)
    positions = [r.q for r in readings if r.q is not None]
    read = set().union(*readings)
    outputs = [k for k in range(len(chain.signature.outputs)) if k not in read]
    if len(positions) < chain.nq or not dataset.inputs or not (outputs or hidden):
        return []
    try:
        recorded, simulated = _runs(binding, outputs, positions, free)
    except UsageError:  # without a free run there is nothing to compare with
        return []
    own = [chain.signature.outputs[k][0] for k in outputs]
    iu, _ = columns(binding.dataset, chain)
    inputs = [binding.dataset.inputs[i].name for i in iu]
    known = _known(binding, recorded, simulated, [*own, *inputs])
    negated = {name for name, f in known.items() if f.ratio < 0}
    against = _among(inputs, negated) if hidden else []
    shown = _signs(
        dataset=dataset,
        joints=list(chain.signature.joints),
        outputs=own,
        opposite=_among(own, negated),
        against=against,
        sure=inputs_agree or set(inputs) <= known.keys() - negated,
        whole=hidden and against == inputs,
    )
    return shown + _units(dataset, own, known)


def _among(names: list[str], chosen: set[str]) -> list[str]:
    """Those names that are chosen, in their order."""
    return [name for name in names if name in chosen]


def _known(
    binding: Binding, recorded: Sequence[Run], simulated: Sequence[Run], names: list[str]
) -> dict[str, Followed]:
    """How each signal follows from the motion, of those that do."""
    cutoff = max(_cutoffs(binding, recorded), default=0.0)
    found = {}
    for k, name in enumerate(names):
        own = followed(recorded, simulated, k, cutoff)
        if own is not None:
            found[name] = own
    return found


def _units(dataset: Dataset, names: list[str], known: dict[str, Followed]) -> list[Shown]:
    """Units of the outputs that are a known factor off."""
    found = []
    for name in _among(names, set(known)):
        shown = _unit(dataset, name, known[name])
        if shown is not None:
            found.append(shown)
    return found


def _runs(
    binding: Binding, outputs: Sequence[int], positions: Sequence[int], free: FreeRuns
) -> tuple[list[Run], list[Run]]:
    """The runs to fit, as recorded and as the model moves freely under their inputs."""
    chain = binding.chain
    iu, iy = columns(binding.dataset, chain)
    runs = binding.experiments("fit")
    recorded, simulated = [], []
    for e, y in zip(runs, free(binding), strict=True):
        part = slice(0, LONGEST)
        t, u, own = e.t[part], e.u[part][:, iu], e.motion()[part][:, iy]
        for out, into in ((own, recorded), (np.asarray(y)[part], simulated)):
            beside = np.concatenate([out[:, list(outputs)], u], 1)
            into.append(Run(t, out[:, list(positions)], beside))
    return recorded, simulated


def _cutoffs(binding: Binding, recorded: Sequence[Run]) -> list[float]:
    """Frequency up to which the joints of each run rise above their noise, Hz."""
    _, iy = columns(binding.dataset, binding.chain)
    found = []
    for e, run in zip(binding.experiments("fit"), recorded, strict=True):
        noise = e.noise_rms(binding.readings, iy)
        y = e.motion()[: len(run.t), iy]
        found += cutoffs(binding.chain, run.t, y, noise)
    return found


def followed(
    recorded: Sequence[Run], simulated: Sequence[Run], signal: int, highest: float
) -> Followed | None:
    """How a signal follows from the motion, at the highest cutoff where the model says that it does
    and, where a run is long enough, at the next one; None where the two differ, or nothing is said.
    """
    told: list[Followed] = []
    for share in SLOW:
        found = _at(recorded, simulated, signal, share * highest)
        if found is not None:
            told.append(found)
        if len(told) == 2 or (told and found is None):
            break
    if not told or any(f.share < SEEN or f.ratio * told[0].ratio < 0 for f in told):
        return None
    return told[-1]


def _at(
    recorded: Sequence[Run], simulated: Sequence[Run], signal: int, cutoff: float
) -> Followed | None:
    """How a signal follows from the motion below a cutoff; None where it does not in the model."""
    long = [k for k, r in enumerate(recorded) if (r.t[-1] - r.t[0]) * cutoff >= PERIODS]
    if not long:
        return None
    parts = [_slow(simulated[k], signal, cutoff) for k in long]
    motion, slow = (np.concatenate(x) for x in zip(*parts, strict=True))
    if not np.all(np.isfinite(motion)) or not np.ptp(slow) or not np.ptp(motion):
        return None
    size = np.sqrt(np.mean(motion**2, axis=0)) + 1e-300
    weights = np.linalg.lstsq(motion / size, slow, rcond=1e-6)[0] / size
    left = slow - motion @ weights
    if np.sum(left**2) > (1 - FOLLOWS) * np.sum(slow**2):
        return None
    parts = [_slow(recorded[k], signal, cutoff) for k in long]
    motion, slow = (np.concatenate(x) for x in zip(*parts, strict=True))
    expected = motion @ weights
    product, power = float(slow @ expected), float(expected @ expected)
    own = float(slow @ slow)
    if not power > 0 or not own > 0:
        return None
    return Followed(product / power, product**2 / (power * own))


def _slow(run: Run, signal: int, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """The slow motion [samples columns] and the slow signal [samples], each about its mean: a
    sensor's zero and the pose are no part of it.
    """
    q, qd, qdd, _ = differentiate(run.t, run.q, cutoff)
    slow = zero_phase(run.t, run.signals[:, signal], cutoff)
    ends = filter_ends(run.t, cutoff)
    inside = slice(ends, len(run.t) - ends)
    motion = np.concatenate([q, qd, qdd, np.sign(qd)], 1)[inside]
    return motion - motion.mean(0), slow[inside] - slow[inside].mean()


def _signs(
    dataset: Dataset,
    joints: list[str],
    outputs: list[str],
    opposite: list[str],
    against: list[str],
    sure: bool,
    whole: bool,
) -> list[Shown]:
    """The fewest signs that explain what goes against the motion. `sure`: all inputs go with it;
    `whole`: all of them go against it.
    """
    if whole and len(joints) == 1 and outputs and opposite == outputs:
        return [_sign(dataset, joints[0], (), "the inputs and all other outputs go against it")]
    found = []
    for name in opposite:
        rivals = () if sure or against or len(outputs) > 1 else tuple(joints)
        found.append(_sign(dataset, name, rivals, _why(joints)))
    for name in against:
        found.append(_sign(dataset, name, () if outputs else tuple(joints), _why(joints)))
    return found


def _why(joints: list[str]) -> str:
    return f"its slow part follows from the measured {', '.join(joints)}, and does so negated"


def _sign(dataset: Dataset, channel: str, rivals: tuple[str, ...], why: str) -> Shown:
    """A channel of opposite sign; decisive where no other channel's sign explains as much."""
    mending = Mending({channel: {"scale": -1.0}})
    finding = DataFinding(
        "sign",
        channel,
        -1.0,
        f"{channel} counts the other way: {why}.",
        lines(dataset, channel, mending.forms[channel]),
        decisive=not rivals,
        same_as=tuple(("sign", name) for name in rivals),
        headline=f"{channel} has the opposite sign; everything below takes it negated",
    )
    return Shown(finding, Mending() if rivals else mending)


def _unit(dataset: Dataset, channel: str, followed: Followed) -> Shown | None:
    """A channel that is a known factor, and no sensor's scale, away from what the motion says."""
    size = abs(followed.ratio)
    factor, what = nearest_factor(size, factors_of(dataset, channel))
    low, high = EFFECT_RANGE
    off = abs(np.log(size / factor))
    if off > MISFIT or low * np.exp(APART) < size < high:
        return None
    mending = Mending({channel: {"scale": 1 / factor}})
    decisive = bool(off <= APART)
    text = (
        f"{channel} is {size:.3g} times what the measured motion makes of its slow part: it seems "
        f"to be recorded {factor:.5g} times as large as it is ({what})."
    )
    finding = DataFinding(
        "scale",
        channel,
        factor,
        text,
        lines(dataset, channel, mending.forms[channel]),
        decisive=decisive,
        headline=(
            f"{channel} is {factor:.5g} times too large ({what}); everything below divides by that"
        ),
    )
    return Shown(finding, mending if decisive else Mending())
