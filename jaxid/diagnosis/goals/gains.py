"""Gains of the law under which a robot runs: stated numbers like any other, which may be wrong.

A fit holds them as they are stated. A diagnosis asks them where they alone would explain a
recording, and once more where no effect has explained it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, product

import numpy as np

from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis
from jaxid.diagnosis.result import Diagnosis
from jaxid.diagnosis.selection import joint_loss
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.ending import LAW_KD
from jaxid.fitting.stated import StatedNumber
from jaxid.problem.binding import Binding
from jaxid.wording import listed, times


#: Numbers of a law that are asked. Of a cascade `kd` is what [controller] calls `kv`.
GAINS = ("kp", "kd")
#: A gain is at most this many times what is stated.
ROOM = 10.0
#: Seconds in which damping stops a joint against kp at the most: room of a kd stated as nothing.
SLOW = 1.0
#: Standard deviation of a wide prior about a gain, as a share of it.
WIDE = 1.0
#: Steps of a search, as a share of a gain.
STEP = 0.1


def held_gains(binding: Binding) -> list[int]:
    """Positions in the layout of the gains that a fit holds as they are stated."""
    law = getattr(binding.chain.mechanism, "drive_law", None)
    if law is None or law.kind == "pid":
        return []
    own = product(GAINS, binding.chain.signature.joints)
    names = {f"{gain}@{joint}" for gain, joint in own}
    held = set(range(len(binding.theta))) - set(binding.free)
    index = [i for i in sorted(held) if binding.layout.names[i] in names]
    return [i for i in index if binding.theta[i] >= 0]


def with_room(binding: Binding) -> Binding:
    """The binding with bounds within which its held gains may lie."""
    upper, lower, scale = binding.upper.copy(), binding.lower.copy(), binding.scale.copy()
    for i in held_gains(binding):
        name, _, joint = binding.layout.names[i].partition("@")
        kp = binding.theta[binding.layout.index(f"kp@{joint}")]
        stated = binding.theta[i] or SLOW * kp or SLOW
        lower[i], upper[i], scale[i] = 0.0, ROOM * stated, STEP * stated
    return replace(binding, lower=lower, upper=upper, scale=scale)


def freed(binding: Binding, names: Sequence[str]) -> Binding:
    """The binding with gains of these names fitted."""
    index = {binding.layout.index(name) for name in names}
    return replace(binding, free=sorted({*binding.free, *index}))


def about_stated(binding: Binding, names: Sequence[str]) -> Binding:
    """The binding with wide priors about these gains as stated: a fit does not wander off where the
    data tell only what other numbers are to a gain.
    """
    index = [binding.layout.index(name) for name in names]
    priors = {i: (float(binding.theta[i]), WIDE * float(binding.theta[i])) for i in index}
    return replace(binding, priors={**binding.priors, **priors})


def gains_in(binding: Binding, theta: np.ndarray) -> dict[str, tuple[float, float]]:
    """(kp, kd) in `theta` of each joint one of whose gains is fitted though nobody asked for it."""
    asked, out = binding.chain.mechanism.known(), {}
    for joint in binding.chain.signature.joints:
        names = [f"{gain}@{joint}" for gain in GAINS]
        if not all(name in binding.layout.names for name in names):
            continue
        at = [binding.layout.index(name) for name in names]
        if any(i in binding.free and binding.layout.names[i] not in asked for i in at):
            out[joint] = (float(theta[at[0]]), float(theta[at[1]]))
    return out


def sets_of_gains(binding: Binding) -> list[list[Candidate]]:
    """What may be wrong, the fewest numbers first: each gain at all joints, and both."""
    by_name: dict[str, list[Candidate]] = {gain: [] for gain in GAINS}
    for i in held_gains(binding):
        name, _, joint = binding.layout.names[i].partition("@")
        by_name[name].append(Candidate(name, joint, (i,)))
    single = [own for own in by_name.values() if own]
    return [*single, list(chain.from_iterable(single))] if len(single) > 1 else single


def better_gains(decider: Decider, theta: np.ndarray) -> Hypothesis | None:
    """The model with other gains that alone close at least what is said `partly` of the gap, the
    one with the best evidence; None where none do. `theta`: numbers of the re-tuned model.
    """
    binding = decider.bench.binding
    nominal = decider.refit((), theta)
    tried = [decider.refit(own, binding.theta, nominal.path) for own in sets_of_gains(binding)]
    good = [h for h in tried if np.isfinite(joint_loss(h)) and _closed(nominal, h) >= LIMITS.partly]
    return min(good, key=_evidence, default=None)


def _closed(nominal: Hypothesis, h: Hypothesis) -> float:
    """Share of the gap on held-out data."""
    left = nominal.validation.loss - 1.0
    closed = nominal.validation.loss - h.validation.loss
    return closed / left if left > 0 else 0.0


def _evidence(h: Hypothesis) -> float:
    count = h.path.count + h.validation.count
    return float(joint_loss(h) * count / h.fit_inflation + h.size * np.log(count))


def doubted_gains(binding: Binding, stated: Sequence[StatedNumber]) -> list[str]:
    """Names of the kp that a fit holds at joints of which it refutes several numbers."""
    names = {binding.layout.names[i] for i in held_gains(binding)}
    refuted = Counter(row.joint for row in stated if row.refuted)
    own = [f"kp@{joint}" for joint, count in refuted.items() if count > 1]
    return [name for name in own if name in names]


def asked_for(binding: Binding, names: Sequence[str]) -> str:
    """That gains were fitted which nobody asked for, and how to ask a fit for them."""
    return (
        f"{listed(names)} of the law {'was' if len(names) == 1 else 'were'} fitted too, for as "
        f"stated {'it does' if len(names) == 1 else 'they do'} not fit the recording;"
        f" {_asks(binding, names)}"
    )


def would_close(binding: Binding, names: Sequence[str], found: Diagnosis, again: Diagnosis) -> str:
    """What is known of gains that close most of a gap and do not explain it."""
    before, after = (times(d.how_far.gap_after) for d in (found, again))
    return (
        f"with {listed(names)} of the law fitted too, {after} times the noise would be left, not "
        f"{before}: {_asks(binding, names)}"
    )


def _asks(binding: Binding, names: Sequence[str]) -> str:
    kind = binding.chain.mechanism.drive_law.kind  # type: ignore[attr-defined]
    called = {"kd": LAW_KD.get(kind, "kd")}
    gains = dict.fromkeys(name.partition("@")[0] for name in names)
    own = ", ".join(f'"{called.get(gain, gain)}"' for gain in gains)
    return f"[controller] fit = [{own}] has a fit do so"
