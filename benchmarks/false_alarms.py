"""Clean recordings in odd forms: what does the check find in them though nothing is wrong?

    python benchmarks/false_alarms.py [--seed N] [--count N] [--model NAME] [--show]

Six machines whose model lacks nothing, under uneven clocks, rounded time stamps, lost rows, coarse
encoders, long standstill, repeats, short runs, speeds beside positions and torques that are
measured. The equations are those of jaxid.benchmark, which imports nothing of the product. A
finding that is applied is a false alarm; so is one that is asked with a gap.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.benchmark.laws import torque_of  # noqa: E402
from jaxid.benchmark.plants import NEUTRAL, PLANTS, TwinPlant  # noqa: E402
from jaxid.data.dataset import Dataset  # noqa: E402


STEP = 2.5e-4  # s, of the simulation; every true sample lies on its grid
SECONDS = 6.0


def _closed_loop() -> TwinPlant:
    """A joint that a position law with a limited torque drives, recorded by that torque."""
    numbers = PLANTS["joint"].nominal | {"k_t": (0.1,), "k_e": (0.05,), "gain": (4e-3,)}
    return replace(
        PLANTS["servo"], matrices=PLANTS["joint"].matrices, nominal=numbers, torque=(0.5,)
    )


def _cart() -> TwinPlant:
    ports = {"inputs": (("force", "N"),), "outputs": (("position", "m"),)}
    numbers = {"J": (1.5,), "viscous": (2.0,), "coulomb": (1.0,), "offset": (0.1,)}
    return replace(PLANTS["joint"], **ports, nominal=numbers, torque=(8.0,), speed=(1.0,))


#: Machine -> the model that it is recorded for, and its plant.
MACHINES: dict[str, tuple[str, TwinPlant]] = {
    "joint": ("joint", PLANTS["joint"]),
    "cart": ("joint", _cart()),
    "pendulum": ("pendulum", PLANTS["pendulum"]),
    "servo": ("servo", PLANTS["servo"]),
    "closed_loop": ("joint", _closed_loop()),
    "planar_arm": ("planar_arm", PLANTS["planar_arm"]),
}
CLOCKS = (
    "even",
    "alternating",
    "jitter",
    "drift",
    "lost_rows",
    "gaps",
    "rounded",
    "blurred_stamps",
    "two_rates",
    "bursts",
)
COMMANDS = ("multisine", "steps", "sweep", "triangle", "pulses", "slow", "flicks")
SENSORS = ("fine", "noisy", "coarse", "very_coarse", "no_noise", "few_digits")
FRICTION = "viscous", "coulomb"
SPEEDS = ("none", "none", "beside", "coarse_beside")


@dataclass(frozen=True)
class Form:
    """How one twin is made; `repeats` runs share their command, `spread` is what friction differs
    by between runs (share).
    """

    machine: str
    clock: str
    command: str
    sensor: str
    speed: str
    rate: float
    seconds: float
    runs: int
    repeats: bool
    spread: float
    still: float  # share of the run without a command, at its beginning and its end
    late: float  # s of the run's beginning that are not recorded
    measured: float  # noise of the input, share of its size
    seed: int


@dataclass
class Twin:
    """A recording with its form: times [runs][time], inputs and outputs by name."""

    form: Form
    t: list[np.ndarray]
    inputs: dict[str, list[np.ndarray]] = field(default_factory=dict)
    outputs: dict[str, list[np.ndarray]] = field(default_factory=dict)

    def dataset(self) -> Dataset:
        """As a dataset of its model."""
        model, plant = MACHINES[self.form.machine]
        ports = MACHINES["joint" if self.form.machine == "closed_loop" else self.form.machine][1]
        units = dict((*ports.inputs, *ports.outputs)) | {
            n: "rad/s" for n in self.outputs if n.startswith("qd")
        }
        splits = ["fit", "fit", "validation", "report"][: self.form.runs]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return Dataset.from_arrays(
                self.t,
                inputs=self.inputs,
                outputs=self.outputs,
                units=units,
                split=splits,
                at_rest=self.form.late == 0 and plant.n == 1,
                model=model,
            )


def forms(
    count: int, seed: int, machines: Sequence[str] = tuple(MACHINES), longest: float = SECONDS
) -> list[Form]:
    """Of runs of up to `longest` s, drawn so that every machine, clock and sensor comes as often as
    the others.
    """
    rng = np.random.default_rng(seed)
    drawn = []
    for k in range(count):

        def pick(options):
            return options[int(rng.integers(len(options)))]

        short = rng.random() < 0.15
        drawn.append(
            Form(
                machine=machines[k % len(machines)],
                clock=CLOCKS[(k // len(machines)) % len(CLOCKS)],
                command=pick(COMMANDS),
                sensor=pick(SENSORS),
                speed=pick(SPEEDS),
                rate=float(pick((50, 100, 100, 200, 200, 400))),
                seconds=float(
                    rng.uniform(0.8, 2.0) if short else rng.uniform(longest / 2, longest)
                ),
                runs=int(pick((1, 2, 3, 3, 4))),
                repeats=bool(rng.random() < 0.4),
                spread=float(pick((0.0, 0.02, 0.1))),
                still=float(pick((0.0, 0.0, 0.1, 0.3))),
                late=float(pick((0.0, 0.0, 0.5))),
                measured=float(pick((0.0, 0.0, 0.005))),
                seed=int(rng.integers(2**31)),
            )
        )
    return drawn


# ---- clocks


def instants(form: Form, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """True instants of the samples, s, on the grid of the simulation, and the time stamps that are
    written beside them.
    """
    step = 1 / form.rate
    count = int(form.seconds * form.rate)
    steps = np.full(count, step)
    if form.clock == "alternating":
        steps[1::2] *= 1.2
    elif form.clock == "jitter":
        steps *= rng.uniform(0.6, 1.4, count)
    elif form.clock == "drift":
        steps *= np.linspace(0.9, 1.1, count)
    elif form.clock == "two_rates":
        steps[count // 2 :] *= 2
    elif form.clock == "bursts":  # a buffer that is read out late
        steps[::10] *= 3
    elif form.clock == "gaps":
        steps[rng.choice(count, 4)] *= 15
    grid = np.maximum(np.diff(np.round(np.cumsum(steps) / STEP), prepend=-1).astype(int), 2)
    t = np.cumsum(grid) * STEP
    t = t[t < form.seconds] - t[0]
    if form.clock == "lost_rows":
        t = t[(rng.random(len(t)) > 0.03) | (np.arange(len(t)) < 5)]
    stamps = t.copy()
    if form.clock == "rounded":
        stamps = np.round(t, 3)
    elif form.clock == "blurred_stamps":
        stamps = t + 0.02 * step * rng.standard_normal(len(t))
    stamps, kept = np.unique(stamps, return_index=True)
    return t[kept], stamps


# ---- commands


def command(form: Form, n: int, size: float, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """[time n], in units of the plant's torque, or rad of a servo's goal."""
    out = np.stack([_wave(form.command, t, form.seconds, rng) for _ in range(n)], 1)
    quiet = (t < form.still * form.seconds) | (t > (1 - form.still) * form.seconds)
    return size * np.where(quiet[:, None], 0.0, out)


def _wave(kind: str, t: np.ndarray, seconds: float, rng: np.random.Generator) -> np.ndarray:
    if kind == "steps":
        levels = rng.uniform(-1, 1, int(seconds / 0.35) + 2)
        return levels[(t / 0.35).astype(int)]
    if kind == "sweep":
        return np.sin(2 * pi * (0.3 * t + 2.0 * t**2 / seconds))
    if kind == "triangle":
        f = rng.uniform(0.3, 1.0)
        return 2 * np.abs(2 * ((f * t) % 1) - 1) - 1
    if kind == "flicks":  # short moves between rests
        levels = np.cumsum(rng.choice([-1, 1], int(seconds / 0.2) + 2) * rng.uniform(0.3, 1.0))
        levels = np.abs((levels + 1) % 4 - 2) - 1
        return levels[(t / 0.2).astype(int)]
    if kind == "pulses":
        on = (t % 1.2) < 0.3
        sign = np.where((t // 1.2) % 2 == 0, 1.0, -1.0)
        return on * sign
    f = rng.uniform(0.15, 0.5 if kind == "slow" else 2.5, 6)
    phase = rng.uniform(0, 2 * pi, 6)
    return np.sin(2 * pi * f * t[:, None] + phase).sum(1) / 2.5


# ---- twins


def twins(chosen: Sequence[Form]) -> list[Twin]:
    """Simulated together, machine by machine."""
    made: dict[int, Twin] = {}
    for machine in dict.fromkeys(f.machine for f in chosen):
        own = [k for k, f in enumerate(chosen) if f.machine == machine]
        for at in range(0, len(own), 200):
            part = own[at : at + 200]
            made |= dict(zip(part, _simulated(machine, [chosen[k] for k in part]), strict=True))
    return [made[k] for k in range(len(chosen))]


def _simulated(machine: str, chosen: Sequence[Form]) -> list[Twin]:
    _, plant = MACHINES[machine]
    goals = plant.model == "servo"
    lanes: list[
        tuple[int, np.ndarray, np.ndarray, np.ndarray]
    ] = []  # form, instants, stamps, command
    numbers: list[dict[str, np.ndarray]] = []
    randoms = [np.random.default_rng(f.seed) for f in chosen]
    for k, (form, rng) in enumerate(zip(chosen, randoms, strict=True)):
        size = rng.uniform(0.5, 1.2) * (np.ones(plant.n) if goals else np.array(plant.torque))
        of_twin = {
            name: np.array(x) * np.exp(rng.uniform(-0.4, 0.4, plant.n))
            for name, x in plant.nominal.items()
        }
        t, stamps = instants(form, rng)
        u = command(form, plant.n, 1.0, t, rng) * size
        for _ in range(form.runs):
            if not form.repeats:
                t, stamps = instants(form, rng)
                u = command(form, plant.n, 1.0, t, rng) * size
            varied = {
                name: x * (1 + form.spread * rng.uniform(-1, 1))
                for name, x in of_twin.items()
                if name in FRICTION
            }
            lanes.append((k, t, stamps, u))
            numbers.append(of_twin | varied)
    steps = int(max(t[-1] for _, t, _, _ in lanes) / STEP) + 100
    table = np.zeros((len(lanes), steps, plant.n))
    for row, (_, t, _, u) in zip(table, lanes, strict=True):
        held = np.searchsorted(t, np.arange(steps) * STEP + 1e-9, side="right") - 1
        row[:] = u[np.maximum(held, 0)]
    names = {*NEUTRAL, *plant.nominal}
    p = {
        n: np.stack(
            [np.broadcast_to(x.get(n, NEUTRAL.get(n, 0.0)), (plant.n,)) for x in numbers]
        ).astype(float)
        for n in names
    }
    q = _motion(plant, table, p)
    twins = [Twin(form, []) for form in chosen]
    for lane, (k, t, stamps, u) in enumerate(lanes):
        rows = np.round(t / STEP).astype(int)
        own = {n: x[lane : lane + 1] for n, x in p.items()}
        acted = _torque(plant, own, table[lane], q[lane], rows) if machine == "closed_loop" else u
        _record(twins[k], plant, machine, t, stamps, acted, q[lane], rows, randoms[k])
    return twins


def _motion(plant: TwinPlant, u: np.ndarray, p: dict[str, np.ndarray]) -> np.ndarray:
    """Positions [lanes steps n] from rest at zero, under commands u [lanes steps n] on the
    simulation's grid.

    The midpoint rule; dry friction is the impulse that the joints can hold, joint by joint, from
    that of the step before.
    """
    lanes, steps, n = u.shape
    q, v, a, f = (np.zeros((lanes, n)) for _ in range(4))
    level = p["coulomb"]
    out = np.empty(u.shape)
    for k in range(steps):
        out[:, k] = q
        middle, speed = q + STEP / 2 * v, v + STEP / 2 * a
        M, bias = plant.matrices(middle, speed, p)
        inverse = 1 / M if n == 1 else np.linalg.inv(M)
        push = (
            torque_of(plant, p, u[:, k], middle, speed) - p["viscous"] * speed - p["offset"] - bias
        )
        free = v + STEP * (inverse @ push[..., None])[..., 0]
        for _ in range(1 if n == 1 else 4):
            for j in range(n):
                now = free[:, j] - STEP * (inverse[:, j] * f).sum(1)
                f[:, j] = np.clip(
                    f[:, j] + now / (STEP * inverse[:, j, j]), -level[:, j], level[:, j]
                )
        new = free - STEP * (inverse @ f[..., None])[..., 0]
        a = (new - v) / STEP
        q, v = middle + STEP / 2 * new, new
    return out


def _torque(
    plant: TwinPlant, p: dict[str, np.ndarray], goal: np.ndarray, q: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """What a position law made, as the mean from each sample to the next [time n]."""
    v = np.gradient(q, STEP, axis=0)
    torque = torque_of(plant, p, goal, q, v)
    total = np.concatenate([np.zeros((1, torque.shape[1])), np.cumsum(torque, axis=0)])
    ends = np.append(rows[1:], 2 * rows[-1] - rows[-2])
    ends = np.minimum(ends, len(torque))
    return (total[ends] - total[rows]) / (ends - rows)[:, None]


def _record(
    twin: Twin,
    plant: TwinPlant,
    machine: str,
    t: np.ndarray,
    stamps: np.ndarray,
    u: np.ndarray,
    q: np.ndarray,
    rows: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Adds a run to a twin: what its sensors wrote."""
    form = twin.form
    kept = t >= form.late
    twin.t.append(stamps[kept])
    ports = MACHINES["joint" if machine == "closed_loop" else machine][1]
    for j, (name, _) in enumerate(ports.inputs):
        noise = form.measured * np.max(np.abs(u[:, j])) * rng.standard_normal(len(u))
        twin.inputs.setdefault(name, []).append((u[:, j] + noise)[kept])
    v = np.gradient(q, STEP, axis=0)
    for j, (name, unit) in enumerate(ports.outputs):
        twin.outputs.setdefault(name, []).append(_read(form.sensor, q[rows, j], 1.0, rng)[kept])
        if form.speed != "none" and unit == "rad":
            sensor = "coarse" if form.speed == "coarse_beside" else "noisy"
            read = _read(sensor, v[rows, j], 10.0, rng)[kept]
            twin.outputs.setdefault(f"qd{name.removeprefix('q')}", []).append(read)


def _read(sensor: str, x: np.ndarray, size: float, rng: np.random.Generator) -> np.ndarray:
    noise, step = {
        "fine": (1e-4, 2 * pi / 2**14),
        "noisy": (1e-3, 0.0),
        "coarse": (1e-4, 2 * pi / 1000),
        "very_coarse": (1e-4, 2 * pi / 200),
        "no_noise": (0.0, 0.0),
        "few_digits": (1e-4, 1e-3),
    }[sensor]
    read = x + size * noise * rng.standard_normal(len(x))
    return np.round(read / (size * step)) * size * step if step else read


# ---- what the check says


def alarms(
    twin: Twin, simulate: bool = True, model: bool = True
) -> tuple[list[Any], list[Any], str]:
    """Findings that are applied, findings that are asked with a gap, and why the recording was
    refused, or "".
    """
    from jaxid.base.errors import DatasetError
    from jaxid.conventions import checking
    from jaxid.fitters.short_fit import left_by_short_fit

    try:
        data = twin.dataset()
    except DatasetError as error:
        return [], [], str(error).splitlines()[0]
    if not model:
        data = replace(data, model=None)
    checked = checking.run_check(None, data, gap=left_by_short_fit if simulate else None)
    applied = [f for f in checked.findings if f.applied]
    asked = [f for f in checked.findings if not f.applied and f.gap_before is not None]
    return applied, asked, ""


#: The seed of the kept result: taken once, for it alone.
FRESH, COUNT = 56_1130, 1000


def main(
    seed: int = FRESH,
    count: int = COUNT,
    machines: Sequence[str] = tuple(MACHINES),
    show: bool = False,
    model: bool = True,
) -> dict[str, Any]:
    """Of each machine how many twins there were, and in how many something was applied or asked."""
    chosen = forms(count, seed, machines)
    rows = {
        m: {"machine": m, "twins": 0, "applied": 0, "asked with a gap": 0, "refused": 0, "what": []}
        for m in machines
    }
    made = twins(chosen)
    for k, twin in enumerate(made):
        row = rows[twin.form.machine]
        try:
            applied, asked, refused = alarms(twin, model=model)
        except Exception as error:
            applied, asked, refused = [], [], f"ERROR {error!r}"
        row["twins"] += 1
        row["applied"] += bool(applied)
        row["asked with a gap"] += bool(asked)
        row["refused"] += bool(refused)
        row["what"] += [f"{f.kind} of {f.channel} applied" for f in applied]
        row["what"] += [f"{f.kind} of {f.channel} asked" for f in asked]
        if show and (applied or asked or refused):
            print(k, twin.form, refused)
            for f in (*applied, *asked):
                how = "APPLIED" if f.applied else "asked"
                print("   ", how, f.kind, f.channel, f.value, f.gap_before, f.gap_if_mended, f.text)
        if show and k % 50 == 49:
            told = ("twins", "applied", "asked with a gap", "refused")
            print(k + 1, {m: [row[x] for x in told] for m, row in rows.items()}, flush=True)
    for row in rows.values():
        row["what"] = ", ".join(dict.fromkeys(row["what"])) or "-"
    text = (
        f"{count} recordings with which nothing is wrong, in odd forms, seed {seed}, run once: uneven clocks, rounded stamps, "
        "lost rows, coarse encoders, standstill, repeats, short runs, speeds beside positions. Counted are twins in which the "
        "check applies a finding, and twins in which it asks about one that has a gap."
    )
    return {"title": "False alarms in clean recordings", "text": text, "rows": list(rows.values())}


if __name__ == "__main__":
    from jaxid import runtime

    runtime.prepare()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=120)
    parser.add_argument("--machine", choices=[*MACHINES], default=None)
    parser.add_argument("--without-model", action="store_true")
    arguments = parser.parse_args()
    machines = (arguments.machine,) if arguments.machine else tuple(MACHINES)
    found = main(arguments.seed, arguments.count, machines, True, not arguments.without_model)
    print(*found["rows"], sep="\n")
