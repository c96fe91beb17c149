"""The input that tells two fitted models apart: what to record next when a diagnosis leaves two
hypotheses.

A member of the family is worth the distance of the two simulations, in multiples of the noise,
after the second model was re-tuned as far as the recorded data leave it free (to first order): d^2
= min over delta of |r + J delta|^2 + delta' H delta. Limits are those of the recorded runs unless
others are stated: nothing is asked of the machine that it was not seen to do.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Experiment
from jaxid.data.limits import Limits
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.excitation.bounds import Bounds
from jaxid.excitation.input_design import described, widened
from jaxid.excitation.inputs import begun, choose, Family, InputDesign
from jaxid.excitation.result import Excitation


#: Speeds seen in the recordings may be passed by this factor: they come from differences of noisy
#: samples.
ROOM = 1.1
#: Hypotheses further apart than this (standard deviations) are told apart.
TOLD = 3.0
#: The highest line of the design, as a share of the sampling rate.
HIGHEST = 0.1


@dataclass(frozen=True)
class Recorded:
    """What the recorded runs were asked for and did: joints [n], inputs [nu] about `center`, and
    one command over time.
    """

    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray
    home: np.ndarray
    top: np.ndarray
    center: np.ndarray
    t: np.ndarray
    u: np.ndarray


@dataclass(frozen=True)
class Rivals:
    """Two fitted models, `theta` [2 size] in one layout. What re-tuning may still move of the
    second: numbers `free`, by `slope` each, of which the recorded data tell `information` [free
    free].
    """

    names: tuple[str, str]
    layout: ParameterVector
    theta: Float[np.ndarray, "2 size"]
    free: tuple[int, ...]
    slope: np.ndarray
    information: Float[np.ndarray, "free free"]
    noise: Float[np.ndarray, " ny"]
    recorded: Recorded


class Separation(InputDesign):
    """A bench on which an input is worth what it shows of the difference between two models."""

    def __init__(self, rivals: Rivals, start: np.ndarray, family: Family, bounds: Bounds):
        super().__init__(rivals.layout.chain, start, family, bounds, rivals.noise)
        self.rivals = rivals

    def run(self, u: np.ndarray, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Outputs of the first model [members time ny]; difference and slopes of the second
        [members time ny 1 + free].
        """
        r = self.rivals
        k = len(r.free)
        theta = np.repeat(r.theta[[0, 1]], [1, 1 + k], 0)
        directions = np.zeros((2 + k, len(self.layout)))
        directions[2 + np.arange(k), list(r.free)] = r.slope
        y, dy = self.simulated(u, theta, directions)
        return y[:, 0], np.concatenate(
            [np.moveaxis(y[:, 1:2] - y[:, :1], 1, 3), np.moveaxis(dy[:, 2:], 1, 3)], 3
        )

    def distance(self, dy: np.ndarray) -> np.ndarray:
        """Distance of the two models in multiples of the noise, [members]; nan where one of them
        diverges.
        """
        F = self.fisher(dy)
        out = np.full(len(F), np.nan)
        for m, f in enumerate(F):
            G, g = f[1:, 1:] + self.rivals.information, f[1:, 0]
            size = np.sqrt(np.maximum(np.diag(G), 1e-300))
            if np.isfinite(f).all():
                part = g / size
                told = (
                    part @ np.linalg.lstsq(G / size / size[:, None], part, rcond=1e-10)[0]
                    if g.size
                    else 0.0
                )
                out[m] = np.sqrt(max(f[0, 0] - told, 0.0))
        return out

    def worth(self, dy: np.ndarray, criterion: str) -> np.ndarray:
        """What is minimised, [members]: minus the logarithm of the distance."""
        return np.nan_to_num(-np.log(np.maximum(self.distance(dy), 1e-9)), nan=np.inf)


def separate(
    rivals: Rivals | None,
    *,
    duration_s: float | None = None,
    limits: Limits | None = None,
    amplitude: Sequence[float] | None = None,
    harmonics: int = 8,
    starts: int = 8,
    seed: int = 0,
    progress: Callable[[str, int, int, str], None] | None = None,
) -> Excitation:
    """The input that best separates two models, as a dataset to play.

    `duration_s` (default: as long as the recorded run, 10 s at most), `limits` and `amplitude` (in
    the inputs' units; default: what the recorded runs reached). content["distance"] is how far
    apart the two are then, in multiples of the noise, after re-tuning, content["distance_recorded"]
    the same for a recorded command. Raises `UsageError` where nothing drives the model, joints are
    not measured, or no input keeps the limits.
    """
    if rivals is None:
        raise UsageError(
            "no input is designed: there are no two hypotheses to tell apart, or torques were"
            " compared (`jaxid excite` designs a motion)"
        )
    began = time.perf_counter()
    chain, seen = rivals.layout.chain, rivals.recorded
    inputs = chain.signature.inputs
    if not inputs or not seen.top.any():
        raise UsageError(
            f"nothing drives the recorded {chain.mechanism.name}: release it from other poses"
            " instead"
        )
    if not chain.joint_outputs:
        raise UsageError(
            "the joints are not all measured: limits cannot be kept by simulation; record them as"
            " outputs too"
        )
    rate = 1 / float(np.median(np.diff(seen.t)))
    duration = duration_s or min(10.0, float(seen.t[-1] - seen.t[0]))
    if duration * rate < 50:
        raise UsageError(
            f"{duration:g} s at {rate:g} Hz are {duration * rate:.0f} samples; give a longer"
            " duration"
        )
    t = np.arange(round(duration * rate) + 1) / rate
    top = (
        np.where(seen.top > 0, widened("amplitude", amplitude, len(inputs)), 0.0)
        if amplitude is not None
        else seen.top
    )
    bounds = _bounds(rivals, limits)
    positions = all(unit in ("rad", "m") for _, unit in inputs)
    slew = (
        (0.75 * bounds.speed[: len(inputs)], 0.75 * bounds.acceleration[: len(inputs)])
        if positions
        else None
    )
    lines = np.unique(np.round(np.geomspace(1, max(harmonics, HIGHEST * rate * t[-1]), harmonics)))
    start, bounds = begun(rivals.layout.model(rivals.theta[0]), bounds)
    middle = np.where(seen.top > 0, start[: len(inputs)] if positions else 0.0, seen.center)
    family = Family(t, len(lines), 2 * np.pi / t[-1], top, middle, slew, lines)
    bench = Separation(rivals, start, family, bounds)
    u, _ = choose(bench, "separation", starts, seed, progress)
    after = bench.distance(bench.run(u[None])[1])[0]
    before = bench.distance(bench.run(_played(seen, t)[None])[1])[0]
    plan = {
        "harmonics": len(lines),
        "base_frequency_hz": 1 / t[-1],
        "duration_s": float(t[-1]),
        "rate_hz": rate,
        "seed": seed,
    }
    plain = InputDesign(rivals.layout.model(rivals.theta[0]), start, family, bounds, rivals.noise)
    made = described(plain, u, plan, "separation", None)
    a, b = rivals.names
    so_far = f"{before:.3g}" if np.isfinite(before) else "unknown"
    far = (
        f'after this run "{a}" and "{b}" are {after:.3g} standard deviations apart, by the recorded'
        f" command {so_far}"
    )
    if not after >= TOLD:
        far += (
            "; no input within these limits tells them apart: allow more (limits, amplitude,"
            " duration), or take the simpler one"
        )
    started = (
        f"outputs in run_1 are simulated with {a}, nothing here was measured; a drive played in"
        " open loop moves as the machine does, not as the simulation: begin with a small amplitude"
    )
    made.content["notes"] = [started, far]
    made.content["separates"] = [a, b]
    made.content["distance"] = float(after)
    made.content["distance_recorded"] = float(before) if np.isfinite(before) else None
    made.content["wall_time_s"] = time.perf_counter() - began
    text = f"Designed to tell {a} from {b}; outputs are simulated with {a}: a plan, not a recording"
    return dataclasses.replace(made, dataset=dataclasses.replace(made.dataset, description=text))


def recorded(
    experiments: Sequence[Experiment], inputs: Sequence[int], joints: Sequence[int]
) -> Recorded:
    """What runs were asked for and did; columns of the inputs and of the joints."""
    u = [e.u[:, list(inputs)] for e in experiments]
    q = [e.y[:, list(joints)] for e in experiments]
    speed = [
        np.abs(_rates(e.t, x)).max(0, initial=0.0) for e, x in zip(experiments, q, strict=True)
    ]
    every, moved = np.concatenate(u), np.concatenate(q)
    center = np.median(every, 0)
    top = np.abs(
        every - (center if not every.size else np.where(np.ptp(every, axis=0) > 0, 0.0, center))
    ).max(0, initial=0.0)
    longest = max(range(len(u)), key=lambda k: len(u[k]))
    first = np.nanmedian(q[0][:5], 0)
    return Recorded(
        lower=np.nanmin(moved, 0),
        upper=np.nanmax(moved, 0),
        speed=np.nanmax(speed, 0),
        home=first,
        top=top,
        center=center,
        t=experiments[longest].t,
        u=u[longest],
    )


def _rates(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Speeds over some 5 samples each, which noise moves little."""
    k = min(5, len(t) - 1)
    return (q[k:] - q[:-k]) / (t[k:] - t[:-k])[:, None]


def _played(seen: Recorded, t: np.ndarray) -> np.ndarray:
    """The recorded command on other times, held between its samples and at its end."""
    at = np.clip(
        np.searchsorted(seen.t - seen.t[0], t + 1e-9, side="right") - 1, 0, len(seen.t) - 1
    )
    return seen.u[at]


def _bounds(rivals: Rivals, limits: Limits | None) -> Bounds:
    seen = rivals.recorded
    n = len(seen.home)
    stated = (limits or Limits()).widened(n)

    def pick(own, default):
        return np.asarray(own if own is not None else default, float)

    wide = np.maximum(seen.upper - seen.lower, 1e-6)
    lower, upper = (
        pick(stated.lower, seen.lower - 0.02 * wide),
        pick(stated.upper, seen.upper + 0.02 * wide),
    )
    speed = pick(stated.speed, np.maximum(ROOM * seen.speed, 1e-6))
    acceleration = pick(stated.acceleration, np.full(n, 1e3) * speed)
    source = (
        "what the recorded runs reached"
        if limits is None
        else "stated limits, else what the recorded runs reached"
    )
    return Bounds(
        home=np.clip(seen.home, lower, upper),
        lower=lower,
        upper=upper,
        speed=speed,
        acceleration=acceleration,
        torque_noise=np.full(n, np.nan),
        source=source,
        stated=np.ones(n, bool),
    )
