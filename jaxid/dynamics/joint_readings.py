"""Which outputs read the positions and speeds of joints, and what they tell of the motion: angles
and lengths by encoders, speeds by tachometers, gyroscopes and wheels. A joint whose speed alone is
read has its position from the start of the run on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple, TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.dynamics.mechanism import Signature, speed_names
from jaxid.numerics.precision import float64


if TYPE_CHECKING:
    from jaxid.data.dataset import Experiment
    from jaxid.dynamics.chain import Chain


class JointOutputs(NamedTuple):
    """Positions among the outputs of a joint's coordinate and of its speed; None where it is not
    read.
    """

    q: int | None
    qd: int | None


def with_speeds(signature: Signature, outputs: Mapping[str, str]) -> Signature:
    """The signature that also takes the speeds of its joints among these outputs (name -> SI unit),
    and leaves out positions that are not there; unchanged where a position is missing whose speed
    is missing, too.
    """
    own = dict(signature.outputs)
    speeds: list[tuple[str, str, int]] = []
    for j, joint in enumerate(signature.joints):
        unit = signature.unit("{X}", j) + "/s"
        candidates = [n for n in speed_names(signature.joints, j) if n not in own]
        names = [n for n in candidates if outputs.get(n) == unit]
        if names:
            speeds.append((names[0], unit, j))
        elif joint in own and joint not in outputs:
            return signature
    if not speeds:
        return signature
    missing = set(signature.joints) - outputs.keys()
    kept = [k for k, name in enumerate(own) if name not in missing]
    read = [signature.outputs[k] for k in kept] + [(name, unit) for name, unit, _ in speeds]
    return signature._replace(
        outputs=tuple(read),
        shown=None if len(kept) == len(own) else tuple(kept),
        speeds=tuple(j for _, _, j in speeds),
    )


_OWN_SPEEDS: dict[Any, dict[int, int]] = {}


def _own_speeds(chain: Chain) -> dict[int, int]:
    """Joint -> output of the mechanism's own outputs in rad/s or m/s that are a joint's speed,
    found by reading some states.
    """
    s = chain.signature
    asked = [
        k
        for k, (_, unit) in enumerate(s.outputs[: len(s.outputs) - len(s.speeds)])
        if unit in ("rad/s", "m/s")
    ]
    if not asked:
        return {}
    key = s, jax.tree.structure(chain.mechanism)
    if key not in _OWN_SPEEDS:
        qd, y = _read(chain, np.linspace(0.1, 0.9, 3))

        def same(j, k):
            return np.allclose(y[:, k], qd[:, j], rtol=1e-12, atol=0)

        pairs = product(range(chain.nq), asked)
        _OWN_SPEEDS[key] = {j: k for j, k in pairs if same(j, k)}
    return _OWN_SPEEDS[key]


def _read(chain: Chain, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joint velocities and outputs of a few states."""
    velocities, outputs = [], []
    with float64():
        body = chain.body().prepare(None)
        for s in seeds:
            q, qd = (jnp.asarray(np.cos(s * np.arange(a, a + chain.nq))) for a in (1, 101))
            x = body.start(q, qd)
            velocities.append(np.asarray(qd))
            outputs.append(
                np.asarray(chain.signature.read(body, x, jnp.zeros_like(q), jnp.ones_like(q, bool)))
            )
    return np.array(velocities), np.array(outputs)


def joint_readings(chain: Chain) -> list[JointOutputs]:
    """What reads each joint."""
    s = chain.signature
    names = [n for n, _ in s.outputs]
    first = len(names) - len(s.speeds)
    speeds = {**_own_speeds(chain), **{j: first + k for k, j in enumerate(s.speeds)}}
    positions = {name: k for k, name in enumerate(names)}
    return [JointOutputs(positions.get(n), speeds.get(j)) for j, n in enumerate(s.joints)]


def read_by(chain: Chain) -> list[int]:
    """The output that tells each joint's motion: its position, or its speed where that alone is
    read. Every joint is read.
    """
    outputs = []
    for reading in joint_readings(chain):
        outputs.append(reading.qd if reading.q is None else reading.q)
    return [k for k in outputs if k is not None]


def all_read(chain: Chain) -> bool:
    """Whether every joint's position or speed is read."""
    return all(r != (None, None) for r in joint_readings(chain))


def position_matters(chain: Chain) -> bool:
    """Whether the motion or an output depends on where the joints are; else a speed alone tells all
    there is to know.
    """
    with float64():
        body = chain.body().prepare(None)
        if body.hidden_states:
            return True
        n = chain.nq
        q, qd, qdd = (jnp.asarray(np.cos(1.3 * np.arange(a, a + n))) for a in (1, 51, 101))
        u = jnp.asarray(np.cos(0.7 * np.arange(len(chain.signature.inputs))))

        def seen(q: Any) -> list[Any]:
            y = chain.signature.read(
                body, body.start(q, qd), jnp.zeros_like(q), jnp.ones_like(q, bool)
            )
            return [body.inverse(q, qd, qdd), body.drive(chain.signature, u, q, qd), y]

        return any(not np.array_equal(a, b) for a, b in zip(seen(q), seen(q + 0.37), strict=True))


def cutoffs(chain: Chain, t: np.ndarray, y: np.ndarray, noise: np.ndarray) -> list[float]:
    """Frequency up to which the reading of each joint rises above its noise, Hz; y [time ny], noise
    [ny].
    """
    from jaxid.data.signals import content_cutoff

    return [content_cutoff(t, y[:, k], float(noise[k])) for k in read_by(chain)]


def joint_motion(
    chain: Chain,
    t: np.ndarray,
    y: np.ndarray,
    cutoff_hz: Sequence[float],
    q0: Sequence[float] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Smoothed positions, velocities and accelerations of the joints [time nq] from outputs y [time
    ny], and a sentence.

    Positions that are read are differentiated. Where the speed alone is, the position is its
    integral from `q0` (by default 0).
    """
    from jaxid.data.signals import differentiate

    out, said = [], ""
    for j, (r, cutoff) in enumerate(zip(joint_readings(chain), cutoff_hz, strict=True)):
        if r.q is not None:
            q, qd, qdd, said = differentiate(t, y[:, r.q], cutoff)
        else:
            qd, qdd, _, said = differentiate(t, y[:, r.qd], cutoff)
            q = (0.0 if q0 is None else q0[j]) + integral(t, qd)
        out.append((q, qd, qdd))
    q, qd, qdd = (np.stack(columns, -1) for columns in zip(*out, strict=True))
    return q, qd, qdd, said


def integral(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Integral of x from the first time on, by trapezia."""
    from scipy.integrate import cumulative_trapezoid

    return np.asarray(cumulative_trapezoid(x, t, initial=0.0))


def stated_start(
    e: Experiment, signature: Signature, joint: int
) -> tuple[float | None, float | None]:
    """Position and velocity of a joint at the start of a run as `initial` states them."""
    nq, name = len(signature.joints), signature.joints[joint]

    def found(keys):
        return next((e.initial[k] for k in keys if e.initial and k in e.initial), None)

    own = ("q",) if nq == 1 else (f"q{joint + 1}",)
    return found((*own, name)), found(speed_names(signature.joints, joint))


def stated_positions(e: Experiment, signature: Signature) -> list[float]:
    """Where each joint starts, 0 where nothing is stated."""
    return [stated_start(e, signature, j)[0] or 0.0 for j in range(len(signature.joints))]


def start_of(
    chain: Chain, e: Experiment, y: np.ndarray, first: int, until: int
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of the joints at sample `first` [nq], by polynomials through the
    samples up to `until`, or through as many of them as polynomials follow; zero for what is not
    read. `y` [time ny] are the outputs of the whole run.
    """
    from jaxid.data.signals import followed, start_state

    t, own = e.t[first:until], joint_readings(chain)
    q0, qd0 = np.zeros(chain.nq), np.zeros(chain.nq)
    read: list[int] = []
    for reading in own:
        read += [k for k in reading if k is not None]
    window = followed(t, y[first:until, read]) if read else t[-1] - t[0]
    seen = [(j, r.q) for j, r in enumerate(own) if r.q is not None]
    if seen and (len(seen) == chain.nq or any(r.qd is not None for r in own)):
        joints, columns = map(list, zip(*seen, strict=True))
        q0[joints], qd0[joints], _ = start_state(t, y[first:until, columns], window)
    for j, r in enumerate(own):
        if r.qd is not None:
            qd0[j], _, _ = start_state(t, y[first:until, r.qd], window)
            if r.q is None:
                q0[j] = (
                    stated_positions(e, chain.signature)[j]
                    + integral(e.t[: first + 1], y[: first + 1, r.qd])[-1]
                )
    return q0, qd0


def sizes(chain: Chain, t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Travel and largest speed of each joint as its readings show them [nq]; nan where nothing
    does.
    """
    travel, speed = np.full(chain.nq, np.nan), np.full(chain.nq, np.nan)
    for j, r in enumerate(joint_readings(chain)):
        if r.qd is not None:
            travel[j], speed[j] = np.ptp(integral(t, y[:, r.qd])), np.max(np.abs(y[:, r.qd]))
        if r.q is not None:
            travel[j] = np.ptp(y[:, r.q])
    return travel, speed
