"""Gains of the law under which a robot runs: stated numbers like any other, which may be wrong.

A fit holds them as they are stated. A diagnosis has them as near to that as numbers of a file are
trusted, and asks them where they alone would explain a recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

from jaxid.base.wording import listed
from jaxid.fitting.ending import LAW_KD
from jaxid.problem.binding import Binding
from jaxid.problem.trust import trusting


#: Numbers of a law that are asked. Of a cascade `kd` is what [controller] calls `kv`.
GAINS = ("kp", "kd")
#: A gain is at most this many times what is stated.
ROOM = 10.0
#: Seconds in which damping stops a joint against kp at the most: room of a kd stated as nothing.
SLOW = 1.0
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


def known_loosely(binding: Binding, inflation: float = 1.0) -> Binding:
    """The binding with its gains and masses fitted too, and every number that is stated as near to
    that as trust has it. Residuals that count `inflation` times too often are met by priors that
    count as often.
    """
    held = [binding.layout.names[i] for i in held_gains(binding)]
    masses = [name for name in binding.layout.names if name.startswith("mass@")]
    wide = trusting(freed(binding, [*held, *masses]), inflation)
    nothing = {*map(wide.layout.index, [*held, *masses])} - wide.priors.keys()
    return replace(wide, free=[i for i in wide.free if i not in nothing])


def freed(binding: Binding, names: Sequence[str]) -> Binding:
    """The binding with gains of these names fitted."""
    index = {binding.layout.index(name) for name in names}
    return replace(binding, free=sorted({*binding.free, *index}))


def asked_for(binding: Binding, names: Sequence[str]) -> str:
    """That gains were fitted which nobody asked for, and how to ask a fit for them."""
    return (
        f"{listed(names)} of the law {'was' if len(names) == 1 else 'were'} fitted too, for as "
        f"stated {'it does' if len(names) == 1 else 'they do'} not fit the recording;"
        f" {_asks(binding, names)}"
    )


def _asks(binding: Binding, names: Sequence[str]) -> str:
    kind = binding.chain.mechanism.drive_law.kind  # type: ignore[attr-defined]
    called = {"kd": LAW_KD.get(kind, "kd")}
    gains = dict.fromkeys(name.partition("@")[0] for name in names)
    own = ", ".join(f'"{called.get(gain, gain)}"' for gain in gains)
    return f"[controller] fit = [{own}] has a fit do so"
