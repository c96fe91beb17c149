"""Separately written equations for the tests: mechanisms, friction, drives, and an event-exact
simulator (SciPy).

Nothing here imports the product. Dry friction is integrated in modes (a joint slides one way, the
other way, or sticks); the moments at which a joint stops or breaks away are located by the
integrator, so there is no step to converge in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, sin
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp


#: Longest and shortest of the steps that look for events while dry friction acts, s.
LONGEST_STEP, SHORTEST_STEP = 1e-3, 1e-7
#: By so much, in N m or N, friction may be exceeded by rounding before a joint breaks away.
SLACK = 1e-11

Plant = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


# ---- mechanisms: (q, v) -> mass matrix, everything else that stands on its side of the equation


def pendulum(inertia: float = 0.08, gravity_torque: float = 1.5, tilt: float = 0.0) -> Plant:
    M = np.array([[inertia]])
    return lambda q, v: (M, gravity_torque * np.sin(q + tilt))


def joint(inertia: float = 0.1) -> Plant:
    M = np.array([[inertia]])
    return lambda q, v: (M, np.zeros(1))


def planar_arm(
    m1=4.0, m2=2.5, c1=0.25, c2=0.2, I1=0.12, I2=0.05, l1=0.5, gravity=9.81, tilt=0.0
) -> Plant:
    """Two links by virtual power: M = sum m J'J + I w'w, bias = sum m J'(Jdot v + g); `tilt` turns
    the base under gravity.
    """
    gx, gy = gravity * sin(tilt), gravity * cos(tilt)

    def plant(q, v):
        a, b = float(q[0]), float(q[0] + q[1])
        ca, sa, cb, sb = cos(a), sin(a), cos(b), sin(b)
        # Velocity of the second centre of mass per joint rate: (x1, y1) and (x2, y2).
        x2, y2 = c2 * cb, c2 * sb
        x1, y1 = l1 * ca + x2, l1 * sa + y2
        # Its acceleration at constant rates, and gravity; the first link's is radial and does no
        # work.
        first, both = float(v[0]) ** 2, float(v[0] + v[1]) ** 2
        ax = -l1 * sa * first - c2 * sb * both + gx
        ay = l1 * ca * first + c2 * cb * both + gy
        M12 = m2 * (x1 * x2 + y1 * y2) + I2
        M11 = m1 * c1 * c1 + I1 + I2 + m2 * (x1 * x1 + y1 * y1)
        M22 = m2 * (x2 * x2 + y2 * y2) + I2
        bias = [m2 * (x1 * ax + y1 * ay) + m1 * c1 * (sa * gy + ca * gx), m2 * (x2 * ax + y2 * ay)]
        return np.array([[M11, M12], [M12, M22]]), np.array(bias)

    return plant


def loaded_arm(payload1: float, payload2: float, l2: float = 0.4) -> Plant:
    """The arm with point masses at the ends of both links: each a link of its own without inertia,
    at c = l.
    """
    bare = planar_arm()
    first = planar_arm(m1=payload1, m2=0.0, c1=0.5, c2=0.0, I1=0.0, I2=0.0)
    second = planar_arm(m1=0.0, m2=payload2, c1=0.0, c2=l2, I1=0.0, I2=0.0)

    def plant(q, v):
        parts = [f(q, v) for f in (bare, first, second)]
        return np.sum([M for M, _ in parts], 0), np.sum([b for _, b in parts], 0)

    return plant


def heavier(plant: Plant, inertia: Any) -> Plant:
    """More inertia on the diagonal."""

    def heavy(q, v):
        M, bias = plant(q, v)
        return M + np.diag(np.broadcast_to(inertia, len(q))), bias

    return heavy


def spring_cart(mass: float = 2.0, stiffness: float = 40.0) -> Plant:
    M = np.array([[mass]])
    return lambda q, v: (M, stiffness * q)


PLANTS: dict[str, Callable[..., Plant]] = {
    "pendulum": pendulum,
    "joint": joint,
    "planar_arm": planar_arm,
}


# ---- drive and friction


@dataclass(frozen=True)
class Truth:
    """What acts besides the mechanism; each number for all joints or one per joint, 0 where it is
    absent.
    """

    viscous: Any = 0.0
    coulomb: Any = 0.0
    dry_asymmetry: Any = 0.0
    viscous_asymmetry: Any = 0.0
    stribeck: Any = 0.0
    stribeck_speed: Any = 1.0
    load: Any = 0.0
    drag: Any = 0.0
    power: Any = 0.0
    exponent: Any = 1.0
    offset: Any = 0.0
    dead_zone: Any = 0.0
    delay: Any = 0.0
    other_hold: Any = 0.0
    lag_s: Any = 0.0
    scale: Any = 0.0
    droop: Any = 0.0
    limit: Any = np.inf
    back_emf: Any = 0.0
    ripple: Any = 0.0  # amplitude of the sine, of the cosine, order
    ripple_cosine: Any = 0.0
    ripple_order: Any = 1.0
    spring: Any = 0.0
    uneven: Any = 0.0  # dry friction over position: sine, cosine, order
    uneven_cosine: Any = 0.0
    uneven_order: Any = 1.0
    shared_viscous: Any = 0.0
    shared_dry: Any = 0.0
    shared_speed: Any = 1.0
    # Laws that have no numbers here: (q, v) -> torque against motion, (q, v, drive) -> dry level,
    # command -> what arrives of it.
    force: Callable[[np.ndarray, np.ndarray], Any] = lambda q, v: 0.0
    level: Callable[[np.ndarray, np.ndarray, np.ndarray], Any] | None = None
    arrives: Callable[[np.ndarray], Any] = lambda u: u

    def smooth(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Torque against motion that is continuous in v."""
        f = (
            (self.viscous + self.back_emf) * v
            + self.viscous_asymmetry * abs(v)
            + self.drag * abs(v) * v
            + self.offset
        )
        f = (
            f
            + self.ripple * np.sin(self.ripple_order * q)
            + self.ripple_cosine * np.cos(self.ripple_order * q)
        )
        f = f + self.spring * q + self.thinning(v) + self.force(q, v)
        if np.any(self.shared_viscous) or np.any(self.shared_dry):
            w = v[0] + v[1]
            f = f + np.ravel(self.shared_viscous)[0] * w
            f = f + np.ravel(self.shared_dry)[0] * np.tanh(w / np.ravel(self.shared_speed)[0])
        return f

    def thinning(self, v: np.ndarray) -> np.ndarray:
        """Power law, rounded off below 1 mrad/s."""
        return self.power * (v * v + 1e-6) ** ((self.exponent - 1) / 2) * v

    def dry(self, q: np.ndarray, v: np.ndarray, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Levels of dry friction (backwards, forwards)."""
        level = (
            self.coulomb
            + self.stribeck * np.exp(-((v / self.stribeck_speed) ** 2))
            + self.load * abs(drive)
        )
        level = (
            level
            + self.uneven * np.sin(self.uneven_order * q)
            + self.uneven_cosine * np.cos(self.uneven_order * q)
        )
        if self.level is not None:
            level = level + self.level(q, v, drive)
        return np.maximum(level - self.dry_asymmetry, 0), np.maximum(level + self.dry_asymmetry, 0)

    @property
    def is_dry(self) -> bool:
        numbers = (self.coulomb, self.stribeck, self.load, self.dry_asymmetry)
        return self.level is not None or any(np.any(x) for x in numbers)


#: effect -> {its parameter: name in Truth}
EFFECTS: dict[str, dict[str, str]] = {
    "dead_zone": {"width": "dead_zone"},
    "saturation": {"limit": "limit"},
    "torque_scale": {"gain": "scale"},
    "supply_droop": {"droop": "droop"},
    "back_emf": {"constant": "back_emf"},
    "actuator_lag": {"lag": "lag_s"},
    "input_delay": {"delay": "delay"},
    "input_hold": {"share": "other_hold"},
    "torque_ripple": {"sine": "ripple", "cosine": "ripple_cosine", "order": "ripple_order"},
    "viscous_friction": {"coefficient": "viscous"},
    "coulomb_friction": {"level": "coulomb"},
    "asymmetric_friction": {"dry": "dry_asymmetry", "viscous": "viscous_asymmetry"},
    "stribeck_friction": {"extra": "stribeck", "speed": "stribeck_speed"},
    "load_dependent_friction": {"mu": "load"},
    "power_law_friction": {"coefficient": "power", "exponent": "exponent"},
    "quadratic_drag": {"coefficient": "drag"},
    "position_dependent_friction": {
        "sine": "uneven",
        "cosine": "uneven_cosine",
        "order": "uneven_order",
    },
    "coupled_friction": {"viscous": "shared_viscous", "dry": "shared_dry", "speed": "shared_speed"},
    "constant_torque": {"torque": "offset"},
    "spring_torque": {"stiffness": "spring"},
}


@dataclass(frozen=True)
class Piece:
    """A stretch of time over which the torque at the joints is one smooth function."""

    begin: float
    end: float
    torque: Callable[[float], np.ndarray]


def drive(t: np.ndarray, u: np.ndarray, truth: Truth, hold: str = "zero") -> list[Piece]:
    """Torque of the recorded command u [time nu] after hold, delay, lag and drive, exact in
    time.
    """
    shares = {"zero": 1 - truth.other_hold, "linear": truth.other_hold}
    if hold == "linear":
        shares = {"zero": truth.other_hold, "linear": 1 - truth.other_hold}
    edges = t
    if truth.delay > 0:
        later = t + truth.delay
        near = np.min(np.abs(later[:, None] - t[None]), 1) < 1e-12
        edges = np.union1d(t, later[(later < t[-1]) & ~near])
    out, lagged = [], u[0].astype(float)
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        k = int(np.searchsorted(t, (a + b) / 2 - truth.delay, side="right")) - 1
        if k < 0:
            base, slope, origin = u[0], 0 * u[0], 0.0
        else:
            origin = t[k] + truth.delay
            base = u[k].astype(float)
            slope = (
                shares["linear"]
                * (u[min(k + 1, len(u) - 1)] - u[k])
                / (t[min(k + 1, len(t) - 1)] - t[k])
            )

        def command(x, base=base, slope=slope, origin=origin):
            return base + slope * (x - origin)

        arriving = command
        if np.any(truth.lag_s > 0):  # first order, exact for a constant command

            def lagging(x, z=lagged, u=base, a=a):
                return u + (z - u) * np.exp(-(x - a) / truth.lag_s)

            arriving = lagging
            lagged = lagging(b)
        out.append(Piece(a, b, lambda x, c=arriving: driven(c(x), truth)))
    return out


def driven(u: np.ndarray, truth: Truth) -> np.ndarray:
    """Torque that the drive gives for a command: scale, droop, limit, dead zone, one after the
    other.
    """
    u = (1 + truth.scale) * u
    u = u - truth.droop * abs(u) * u
    u = np.minimum(np.maximum(u, -np.asarray(truth.limit)), truth.limit)
    u = truth.arrives(u)
    return np.where(
        u > truth.dead_zone,
        u - truth.dead_zone,
        np.where(u < -truth.dead_zone, u + truth.dead_zone, 0.0),
    )


# ---- the simulator


def simulate(
    plant: Plant,
    truth: Truth,
    t: np.ndarray,
    u: np.ndarray,
    q0: Any = None,
    v0: Any = None,
    *,
    hold: str = "zero",
    nq: int | None = None,
    rtol: float = 1e-10,
    atol: float = 1e-13,
) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions and velocities [time nq] at the samples; u [time nu], no column for free
    motion.
    """
    n = nq or u.shape[1]
    u = np.zeros((len(t), n)) if u.shape[1] == 0 else u
    q = np.zeros(n) if q0 is None else np.array(q0, float).reshape(n)
    v = np.zeros(n) if v0 is None else np.array(v0, float).reshape(n)
    mode = np.sign(v).astype(int)
    at = {float(x): i for i, x in enumerate(t)}
    Q, V = np.empty((len(t), n)), np.empty((len(t), n))
    Q[0], V[0] = q, v
    for piece in drive(t, u, truth, hold):
        q, v, mode = _through(plant, truth, piece, q, v, mode, rtol, atol)
        if piece.end in at:
            Q[at[piece.end]], V[at[piece.end]] = q, v
    return Q, V


def _acceleration(plant, truth, tau, q, v, mode):
    """Acceleration in a mode, and the friction that sticking joints need."""
    M, bias = plant(q, v)
    minus, plus = truth.dry(q, v, tau)
    rest = tau - bias - truth.smooth(q, v)
    r = rest - np.where(mode > 0, plus, -minus)
    a, moving = np.zeros(len(q)), [j for j in range(len(q)) if mode[j]]
    if len(moving) == 1:
        a[moving] = r[moving] / M[moving[0], moving[0]]
    elif moving:
        a[:] = np.linalg.solve(M, r)  # of two joints both
    return a, rest - M @ a, minus, plus


def _settled(plant, truth, tau, q, v, mode):
    """Modes that hold from here on: joints at rest leave if friction cannot hold them."""
    mode = np.array(mode)
    for _ in range(8):
        _, need, minus, plus = _acceleration(plant, truth, tau, q, v, mode)
        leaves = (mode == 0) & ((need > plus + SLACK) | (need < -minus - SLACK))
        if not leaves.any():
            break
        mode[leaves] = np.sign(need[leaves]).astype(int)
    return mode


def _stops(position, direction):
    """Positive while a joint slides on in its direction."""
    return lambda x, s: s[position] * direction


def _breaks_away(plant, truth, piece, n, j, held):
    """Positive while friction can hold joint j."""

    def reserve(x, s):
        _, need, minus, plus = _acceleration(plant, truth, piece.torque(x), s[:n], s[n:], held)
        return min(plus[j] - need[j], need[j] + minus[j]) + SLACK

    return reserve


def _through(plant, truth, piece, q, v, mode, rtol, atol):
    n, t = len(q), piece.begin
    if not truth.is_dry:

        def free(x, s):
            return np.concatenate(
                [s[n:], _acceleration(plant, truth, piece.torque(x), s[:n], s[n:], np.ones(n))[0]]
            )

        s = solve_ivp(
            free, (t, piece.end), np.concatenate([q, v]), "DOP853", rtol=rtol, atol=atol
        ).y[:, -1]
        return s[:n], s[n:], np.ones(n, int)
    longest = LONGEST_STEP
    for _ in range(200):
        mode = _settled(plant, truth, piece.torque(t), q, v, mode)
        if (
            not mode.any()
            and np.all(truth.other_hold == 0)
            and np.all(truth.lag_s == 0)
            and np.all(v == 0)
        ):
            return q, v, mode  # everything sticks under a constant torque
        held = mode.copy()

        def f(x, s, held=held):
            a = _acceleration(plant, truth, piece.torque(x), s[:n], s[n:], held)[0]
            return np.concatenate([np.where(held != 0, s[n:], 0.0), a])

        events = []
        for j in range(n):
            event: Any = (
                _stops(n + j, held[j]) if held[j] else _breaks_away(plant, truth, piece, n, j, held)
            )
            event.terminal, event.direction = True, -1
            events.append(event)
        until = piece.end if longest == LONGEST_STEP else min(piece.end, t + 20 * longest)
        found = solve_ivp(
            f,
            (t, until),
            np.concatenate([q, v]),
            "DOP853",
            rtol=rtol,
            atol=atol,
            events=events,
            max_step=longest,
        )
        # A joint that leaves from rest and returns within one step crosses zero once as the steps
        # see it, and the event is found at its own beginning: look again with finer steps.
        if found.status == 1 and found.t[-1] - t < 1e-13 and longest > SHORTEST_STEP:
            longest /= 8
            continue
        longest = LONGEST_STEP
        t, s = float(found.t[-1]), found.y[:, -1]
        q, v = s[:n].copy(), s[n:].copy()
        v[held == 0] = 0.0
        if found.status != 1:
            mode = held
        for j, when in enumerate(found.t_events):
            if len(when) and held[j]:
                v[j], mode[j] = 0.0, 0
            elif len(when):
                _, need, _, _ = _acceleration(plant, truth, piece.torque(t), q, v, held)
                mode[j] = int(np.sign(need[j]))
        if t >= piece.end - 1e-14:
            return q, v, mode
    raise RuntimeError(f"friction changes its mode without end at {t} s")


# ---- signals and recordings


def multisine(
    t: np.ndarray, amplitudes: Any, seed: int = 0, periods: float = 1.0, lines: int = 6
) -> np.ndarray:
    """A command [time nu] of some sines with random phases, `periods` of the lowest in the
    record.
    """
    rng = np.random.default_rng(seed)
    u = np.zeros((len(t), len(amplitudes)))
    for j, amplitude in enumerate(amplitudes):
        for k in range(1, lines + 1):
            f = k * periods / (t[-1] - t[0]) * rng.uniform(0.7, 1.3)
            u[:, j] += (
                amplitude * np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) / np.sqrt(lines)
            )
    return u


def measured(q: np.ndarray, noise: float, seed: int, resolution: float = 0.0) -> np.ndarray:
    """A recording of q by a noisy encoder."""
    y = q + noise * np.random.default_rng(seed).standard_normal(q.shape)
    return np.round(y / resolution) * resolution if resolution else y
