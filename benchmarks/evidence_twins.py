"""Claims by torque on twins with misfits on purpose, and how well their probabilities hold.

A twin is a joint, a pendulum or a two-link arm, made by numpy, so that its equations are not those
of the package. It has none, one or two effects of a library, with shapes beside the grid that is
asked, and in 70 % of the cases a force from outside the library, of 0.03 to 2 times their size. The
library and the twins are the benchmark's; free laws, evidence, search and claims are the package's.
Seeds below 10,000 are for tuning, with fewer kinds of outsiders; the report has seeds of its own.
The constants of the rule were chosen on twins of the same kinds from another generator.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt
from scipy.stats import beta

from jaxid.diagnosis.torque.algebra import ColumnPrior, memory_of
from jaxid.diagnosis.torque.claims import claims
from jaxid.diagnosis.torque.free_laws import free_units, OVER
from jaxid.diagnosis.torque.held_out import HeldOutRows, JudgedRun
from jaxid.diagnosis.torque.library import Unit
from jaxid.diagnosis.torque.weigh import Scales, weigh


RATE, SECONDS, CUTOFF, ENDS = 100.0, 16.0, 5.0, 50
KEPT = slice(ENDS, int(RATE * SECONDS) - ENDS, int(RATE / (4 * CUTOFF)))
#: Seeds of the report, and how many cases it has by default.
REPORT, CASES = 60_000, 60
KNOWN = ("position_damping", "bump", "noise_in_colour", "drift", "end_stop", "step")
FRESH = (*KNOWN, "square_friction", "reversal", "ripple_by_speed", "random_law", "pushes")
#: Outsiders that say an effect of the library in other words: their claims count neither way.
SAME = {"square_friction": ("position_dependent_friction", "coulomb_friction")}
#: Gravity, and the length of a link of a chain.
GRAVITY, LINK = 9.81, 0.4
#: Share of the joints of a chain that have a force from outside the library.
STRANGE = 0.5
EDGES = (0.0, 0.3, 0.5, 0.7, 0.95, 1.0)


@dataclass(frozen=True)
class Motion:
    """One run: time [samples], and motion [samples n]."""

    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    moves: np.ndarray

    def rows(self, x: np.ndarray) -> np.ndarray:
        """Through the low-pass, at the rows."""
        return smooth(x, CUTOFF)[KEPT]

    def at_joint(self, x: np.ndarray, joint: int) -> np.ndarray:
        """A force [time k] of one joint as rows of all [rows n k]."""
        own = self.rows(x)
        out = np.zeros((len(own), self.q.shape[1], own.shape[1]))
        out[:, joint] = own
        return out


@dataclass(frozen=True)
class Law:
    """An effect at a joint (-1: at all of them) with one shape: its columns of each run [samples n
    k].
    """

    effect: str
    joint: int
    shape: str
    signed: bool
    columns: list[np.ndarray]


@dataclass(frozen=True)
class Twin:
    scales: Scales
    truth: set[tuple[str, str]]
    outsider: str


def smooth(x: np.ndarray, cutoff: float) -> np.ndarray:
    return sosfiltfilt(butter(4, cutoff / (RATE / 2), output="sos"), x, axis=0)


def moved(rng: np.random.Generator, n: int, style: str) -> np.ndarray:
    """Positions [samples n]: sines, steps or a chirp."""
    t = np.arange(int(SECONDS * RATE)) / RATE
    q = np.zeros((len(t), n))
    for j in range(n):
        if style == "sines":
            first = rng.uniform(0.08, 0.15)
            for h in range(1, 7):
                phase = 2 * np.pi * h * first * t + rng.uniform(0, 6.3)
                q[:, j] += rng.normal() / h**0.8 * np.sin(phase)
        elif style == "steps":
            ends = np.cumsum(rng.uniform(0.9, 2.2, 30))
            levels = rng.uniform(-1, 1, 31)
            q[:, j] = smooth(levels[np.searchsorted(ends, t)], 0.6)
        else:
            q[:, j] = np.sin(2 * np.pi * (0.1 + (0.5 + 0.2 * j) * t / SECONDS / 2) * t)
        q[:, j] *= rng.uniform(0.6, 1.6) / max(float(np.ptp(q[:, j])) / 2, 1e-9)
        q[:, j] += rng.uniform(-0.4, 0.4)
    return q


def motion(q: np.ndarray) -> Motion:
    qd = np.gradient(q, 1 / RATE, axis=0)
    t = np.arange(len(q)) / RATE
    return Motion(t, q, qd, np.gradient(qd, 1 / RATE, axis=0), np.ones(q.shape[1], bool))


def model_columns(kind: str, m: Motion, turn: np.ndarray) -> tuple[np.ndarray, int]:
    """Columns of the nominal model [samples n p], and how many are those of its bodies."""
    n = m.q.shape[1]
    if kind == "arm":
        body = arm_columns(m)
    elif kind == "chain":
        body = chain_columns(m)
    elif kind == "pendulum":
        body = np.stack([m.qdd, np.sin(m.q)], -1)
    else:
        body = m.qdd[:, :, None]
    each = np.stack([m.qd, np.tanh(m.qd / turn), np.ones_like(m.qd)], -1)
    friction = (each[:, :, :, None] * np.eye(n)[:, None, :]).reshape(len(m.q), n, -1)
    return np.concatenate([body, friction], -1), body.shape[2]


def arm_columns(m: Motion) -> np.ndarray:
    """Inertias, coupling and gravity of two links in a plane [samples 2 5]."""
    out = np.zeros((len(m.q), 2, 5))
    cos, sin = np.cos(m.q[:, 1]), np.sin(m.q[:, 1])
    both, (v1, v2), (a1, a2) = m.q.sum(1), m.qd.T, m.qdd.T
    coupling = (2 * a1 + a2) * cos - (2 * v1 * v2 + v2**2) * sin
    out[:, 0] = np.stack([a1, a1 + a2, coupling, np.sin(m.q[:, 0]), np.sin(both)], -1)
    out[:, 1] = np.stack([0 * a1, a1 + a2, a1 * cos + v1**2 * sin, 0 * a1, np.sin(both)], -1)
    return out


def chain_columns(m: Motion) -> np.ndarray:
    """Inertia and first moment of each link of a chain in a plane [samples n 2n]."""
    n = m.q.shape[1]
    q, qd, qdd = (np.cumsum(x, axis=1) for x in (m.q, m.qd, m.qdd))
    out = np.zeros((len(q), n, 2 * n))
    for k in range(n):
        out[:, k, k] = qdd[:, k]
        out[:, k, n + k] = GRAVITY * np.sin(q[:, k])
        for i in range(k):
            apart = q[:, i] - q[:, k]
            cos, sin = LINK * np.cos(apart), LINK * np.sin(apart)
            out[:, i, n + k] += cos * qdd[:, k] + sin * qd[:, k] ** 2
            out[:, k, n + k] += cos * qdd[:, i] - sin * qd[:, i] ** 2
    return joint_torques(out)


def joint_torques(x: np.ndarray) -> np.ndarray:
    """Torques about joints of those that turn links against the ground, [samples n ...]."""
    return np.cumsum(x[:, ::-1], axis=1)[:, ::-1]


def askew(m: Motion, moments: np.ndarray) -> np.ndarray:
    """What a base that stands askew changes, to first order [samples n], at these first moments."""
    return joint_torques(GRAVITY * moments * np.cos(np.cumsum(m.q, axis=1)))


def numbers_of_chain(n: int, rng: np.random.Generator) -> np.ndarray:
    outer = 0.6 ** np.arange(n)
    body = np.concatenate([0.5 * outer, 1.2 * outer]) * rng.uniform(0.7, 1.3, 2 * n)
    friction = np.concatenate([size * 3.0 * outer for size in (0.15, 0.3, 0.03)])
    return np.concatenate([body, friction * rng.uniform(0.6, 1.4, 3 * n)])


def numbers(kind: str, rng: np.random.Generator) -> np.ndarray:
    body = {"joint": [0.08], "pendulum": [0.06, 1.9], "arm": [0.45, 0.09, 0.10, 12.0, 2.4]}[kind]
    n, factor = (2, 3.0) if kind == "arm" else (1, 1.0)
    friction = np.repeat([0.15, 0.3, 0.03], n) * factor * rng.uniform(0.6, 1.4, 3 * n)
    return np.concatenate([np.array(body) * rng.uniform(0.7, 1.3, len(body)), friction])


def warmed(qd: np.ndarray, seconds: float) -> np.ndarray:
    keeps = np.exp(-1 / RATE / seconds)
    return qd * lfilter([1 - keeps], [1, -keeps], qd**2, axis=0)


def hysteresis(qd: np.ndarray, width: float) -> np.ndarray:
    out, z = np.zeros_like(qd), np.zeros(qd.shape[1])
    for i, v in enumerate(qd):
        z = np.clip(z + (v - np.abs(v) * z) / RATE / width, -1, 1)
        out[i] = z
    return out


def laws(
    runs: list[Motion], rigid: list[np.ndarray], turn: np.ndarray, top: np.ndarray, off: float
) -> list[Law]:
    """The library along some runs; `off`: how far shapes lie beside the grid."""
    out: list[Law] = []
    by = np.exp(0.3 * off)

    def add(effect: str, made: Any, shape: str = "", signed: bool = False) -> None:
        series = [made(m, load) for m, load in zip(runs, rigid, strict=True)]
        for j in range(len(turn)):
            columns = []
            for each in series:
                x = np.zeros((*each[0].shape, len(each)))
                x[:, j] = np.stack([c[:, j] for c in each], -1)
                columns.append(x)
            out.append(Law(effect, j, shape, signed, columns))

    def way(m: Motion) -> np.ndarray:
        return np.tanh(m.qd / turn)

    for share in np.geomspace(0.02, 0.5, 6):
        speed = share * by * top
        add(
            "stribeck",
            lambda m, _, s=speed: [way(m) * np.exp(-((m.qd / s) ** 2))],
            f"{share:.2g}",
            True,
        )  # noqa: E501
    add("asymmetric", lambda m, _: [np.abs(m.qd)])
    add("drag", lambda m, _: [m.qd * np.abs(m.qd)], signed=True)
    for p in (0.3, 0.6, 1.5):
        add("power_law", lambda m, _, p=p * by: [way(m) * (np.abs(m.qd) / top) ** p], f"{p}", True)
    for k in (1, 2, 4):
        add(
            "position_dependent_friction",
            lambda m, _, k=k * by: [way(m) * np.sin(k * m.q), way(m) * np.cos(k * m.q)],
            f"{k}",
        )  # noqa: E501
    for k in np.arange(3, 25, 1.5):
        add("ripple", lambda m, _, k=k + 0.5 * off: [np.sin(k * m.q), np.cos(k * m.q)], f"{k:.3g}")
    add("load", lambda m, load: [np.abs(load) * way(m)], signed=True)
    for seconds in (0.13, 1.0, 6.0):
        add("warmth", lambda m, _, s=seconds * by: [warmed(m.qd, s)], f"{seconds}")
    add("spring", lambda m, _: [m.q], signed=True)
    for width in (0.02, 0.1):
        add("hysteresis", lambda m, _, w=width * by: [hysteresis(m.qd, w)], f"{width}", True)
    add("delay", lambda _, load: [np.gradient(load, 1 / RATE, axis=0)])
    return out


def outsider(
    kind: str, rng: np.random.Generator, runs: list[Motion], j: int, turn: float, top: float
) -> list[np.ndarray]:
    """A force from outside the library at joint j of each run [samples]."""
    every = np.concatenate([m.q[:, j] for m in runs])
    phase, k = rng.uniform(0, 6.3), rng.uniform(1, 3)
    middle, wide = rng.choice(every), rng.uniform(0.08, 0.3) * np.ptp(every)
    waves = rng.normal(size=(12, 2)) * [2.0, 1.5 / top]
    height, offset = rng.normal(size=12), rng.uniform(0, 6.3, 12)
    slow = min(1 / (2 * np.pi * np.exp(rng.uniform(np.log(0.05), 0.0))) + 0.05, 40.0)
    out = []
    for m in runs:
        q, v, t = m.q[:, j], m.qd[:, j], m.t
        sign, when = np.tanh(v / turn), rng.uniform(0.2, 0.8) * SECONDS
        pushes = rng.uniform(1, SECONDS - 1, 3)
        noise = rng.normal(size=len(t))
        turned = np.maximum.accumulate(
            np.where(np.diff(np.sign(v), prepend=0) != 0, np.arange(len(v)), 0)
        )  # noqa: E501
        drift = np.cumsum(noise) / 50
        made = {
            "position_damping": v * np.cos(k * q + phase),
            "bump": np.exp(-(((q - middle) / wide) ** 2)),
            "noise_in_colour": smooth(noise, slow),
            "drift": drift - drift.mean(),
            "end_stop": np.maximum(q - np.quantile(every, 0.8), 0),
            "step": (t > when) * (1.0 if phase > 3 else sign),
            "square_friction": sign * (q - middle) ** 2,
            "reversal": np.sign(v) * np.exp(-np.abs(q - q[turned]) / (0.3 * wide)),
            "ripple_by_speed": v * np.sin(6 * k * q + phase),
            "random_law": np.cos(np.stack([q, v], 1) @ waves.T + offset) @ height,
            "pushes": np.exp(-(((t[:, None] - pushes) / 0.25) ** 2)).sum(1),
        }
        out.append(made[kind])
    return out


def twin(seed: int, joints: int | None = None) -> Twin:
    """`joints`: of a chain of three or more; None draws what has one or two."""
    rng = np.random.default_rng(seed if joints is None else [seed, joints])
    kind = str(rng.choice(["joint", "pendulum", "arm"], p=[0.3, 0.4, 0.3]))
    n = 2 if kind == "arm" else 1
    if joints is not None:
        kind, n = "chain", joints
    styles = rng.permutation(["sines", "steps", "chirp"])
    true = [motion(smooth(moved(rng, n, s), 4)) for s in (*styles[:2], rng.choice(styles))]
    top = np.percentile(np.abs(np.concatenate([m.qd for m in true])), 99, axis=0)
    turn = 0.005 * top
    theta = numbers(kind, rng) if joints is None else numbers_of_chain(n, rng)
    off, reading = rng.uniform(-1, 1), 10 ** rng.uniform(-4.3, -3)
    seen = [motion(smooth(m.q + reading * rng.normal(size=m.q.shape), 2 * CUTOFF)) for m in true]

    def columns(runs: list[Motion]) -> tuple[list[np.ndarray], list[np.ndarray]]:
        made = [model_columns(kind, m, turn) for m in runs]
        return [x for x, _ in made], [x[:, :, :b] @ theta[:b] for x, b in made]

    (model, rigid), (measured, seen_rigid) = columns(true), columns(seen)
    there = laws(true, rigid, turn, top, off)
    asked = laws(seen, seen_rigid, turn, top, 0.0)
    if kind == "chain":
        moments = theta[n : 2 * n]
        there += [Law("tilt", -1, "", False, [askew(m, moments)[:, :, None] for m in true])]
        asked += [Law("tilt", -1, "", False, [askew(m, moments)[:, :, None] for m in seen])]
    tau = [x @ theta for x in model]
    white = rng.uniform(0.005, 0.05) * np.std(np.concatenate(tau), axis=0)
    errors = [
        m.rows(a @ theta - b + white * rng.normal(size=b.shape))
        for m, a, b in zip(seen, measured, tau, strict=True)
    ]
    noise = np.std(np.concatenate(errors), axis=0)
    beside = np.concatenate([m.rows(x) for m, x in zip(true, model, strict=True)])
    flat = (beside / noise[:, None]).reshape(-1, beside.shape[2])

    def shows(force: list[np.ndarray]) -> float:
        """Root mean square beside the model's own numbers, in noise."""
        y = np.concatenate([m.rows(x) for m, x in zip(true, force, strict=True)])
        y = (y / noise).ravel()
        return float(np.sqrt(np.mean((y - flat @ np.linalg.lstsq(flat, y, rcond=1e-9)[0]) ** 2)))

    truth, size = set(), np.exp(rng.uniform(np.log(1.5), np.log(60)))
    count = int(rng.choice([0, 1, 2], p=[0.3, 0.45, 0.25]))
    names = sorted({(law.effect, law.joint) for law in there})
    while len(truth) < count:
        effect, joint = names[rng.integers(len(names))]
        same = [law for law in there if (law.effect, law.joint) == (effect, joint)]
        law = same[rng.integers(len(same))]
        weight = rng.normal(size=law.columns[0].shape[2])
        force = [x @ (np.abs(weight) if law.signed else weight) for x in law.columns]
        alone = np.sqrt(np.mean(np.concatenate(force) ** 2)) / np.mean(noise)
        if (place := (effect, place_of(joint))) in truth or shows(force) < 0.03 * alone:
            continue
        share = size * np.exp(rng.uniform(-0.9, 0.9)) / shows(force)
        tau = [a + share * b for a, b in zip(tau, force, strict=True)]
        truth.add(place)
    beyond = "none"
    strange = [j for j in range(n) if kind == "chain" and rng.random() < STRANGE]
    for j in strange:
        beyond = str(rng.choice(KNOWN if seed < 10_000 else FRESH))
        own = outsider(beyond, rng, true, j, float(turn[j]), float(top[j]))
        force = [x[:, None] * np.eye(n)[j] for x in own]
        strength = np.exp(rng.uniform(np.log(0.03), np.log(2.0)))
        tau = [a + strength * size / shows(force) * b for a, b in zip(tau, force, strict=True)]
    if kind != "chain" and rng.random() < 0.7:
        beyond = str(rng.choice(KNOWN if seed < 10_000 else FRESH))
        j = int(rng.integers(n))
        own = outsider(beyond, rng, true, j, float(turn[j]), float(top[j]))
        force = [x[:, None] * np.eye(n)[j] for x in own]
        strength = np.exp(rng.uniform(np.log(0.03), np.log(2.0))) if truth else 1.0
        tau = [a + strength * size / shows(force) * b for a, b in zip(tau, force, strict=True)]
    tau = [x + white * rng.normal(size=x.shape) for x in tau]
    scales = prepared(seen, measured, asked, tau, noise, turn)
    return Twin(scales, truth, "none" if len(strange) > 1 else beyond)


def place_of(joint: int) -> str:
    return "base" if joint < 0 else f"q{joint + 1}"


def prepared(
    runs: list[Motion],
    model: list[np.ndarray],
    asked: list[Law],
    tau: list[np.ndarray],
    noise: np.ndarray,
    turn: np.ndarray,
) -> Scales:
    """Rows of the package's kind, with its free laws."""
    joints = [f"q{j + 1}" for j in range(len(turn))]
    every: Any = runs
    free = free_units(every, joints, turn)
    units = [unit_of(law) for law in asked] + free
    rows = []
    for k, m in enumerate(runs):
        own = [law.columns[k] for law in asked]
        made = m.rows(np.concatenate([model[k], *own, tau[k][:, :, None]], 2))
        more = [u.columns[k] for u in free]
        rows.append(np.concatenate([made[:, :, :-1], *more, made[:, :, -1:]], 2))
    size, p = model[0].shape[2], rows[0].shape[2] - 1
    A = np.concatenate([(x / noise[:, None]).reshape(-1, p + 1) for x in rows])
    theta = np.linalg.lstsq(A[:, :size], A[:, -1], rcond=1e-7)[0]
    left = [x[:, :, -1] - x[:, :, :size] @ theta for x in rows]
    memory = max(memory_of([r[:, j] for r in left]) for j in range(len(turn)))
    level = np.maximum(np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)), noise)
    judged = []
    for x in rows:
        ones = np.ones(x.shape[:2])
        judged.append(JudgedRun(x, ones / level, ones * noise, np.ones(len(turn), bool)))
    data = HeldOutRows(judged, ColumnPrior(np.zeros((p, p)), np.zeros(p)), max(memory, 4.0))
    return Scales(data, units, size)


def unit_of(law: Law) -> Unit:
    count = law.columns[0].shape[2]
    open_ = np.full(count, np.inf)
    return Unit(
        effect=law.effect,
        location=place_of(law.joint),
        fields=tuple(f"number_{k}" for k in range(count)),
        least=np.zeros(count) if law.signed else -open_,
        most=open_,
        spread=open_,
        shape={"shape": 0.0} if law.shape else {},
        joints=(law.joint,) if law.joint >= 0 else tuple(range(law.columns[0].shape[1])),
        columns=[],
    )


@dataclass(frozen=True)
class Count:
    """Of one twin: every answer (probability, whether it is true), sure claims and wrong ones among
    them, families and wrong ones, effects that are there, found, and in a claim or its family.
    """

    answers: list[tuple[float, bool]]
    sure: int
    wrong: int
    families: int
    families_wrong: int
    there: int
    found: int
    in_set: int


def counted(case: Twin) -> Count:
    weighed = weigh(case.scales)
    other = SAME.get(case.outsider, ())
    found = [c for c in claims(weighed) if case.scales.units[c.unit].effect not in other]
    sure, families = set(), []
    for claim in found:
        own = {case.scales.units[u].place for u in (claim.unit, *claim.instead)}
        if claim.instead:
            families.append(own)
        else:
            sure |= own
    places = dict.fromkeys(case.truth, 0.0) | weighed.places
    answers = [
        (p, place in case.truth)
        for place, p in places.items()
        if place[0] not in OVER and place[0] not in other
    ]
    said = sure.union(*families)
    wrong_families = [own for own in families if not own & case.truth]
    return Count(
        answers=answers,
        sure=len(sure),
        wrong=len(sure - case.truth),
        families=len(families),
        families_wrong=len(wrong_families),
        there=len(case.truth),
        found=len(sure & case.truth),
        in_set=len(said & case.truth),
    )


def share(part: int, whole: int) -> str:
    """In per cent, with the interval of Clopper and Pearson."""
    if not whole:
        return "-"
    low = beta.ppf(0.025, part, whole - part + 1) if part else 0.0
    high = beta.ppf(0.975, part + 1, whole - part) if part < whole else 1.0
    return f"{part} of {whole}: {100 * part / whole:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def rows_of(counts: list[Count]) -> list[dict[str, str]]:
    def total(name: str) -> int:
        return sum(getattr(c, name) for c in counts)

    p = np.array([p for c in counts for p, _ in c.answers])
    y = np.array([y for c in counts for _, y in c.answers])
    told = p > 0.02
    error = 0.0
    bins = []
    for low, high in zip(EDGES, EDGES[1:], strict=False):
        inside = told & (p >= low) & ((p < high) | (high == 1.0))
        if inside.any():
            said, true = float(p[inside].mean()), float(y[inside].mean())
            error += inside.sum() / told.sum() * abs(said - true)
            bins.append(f"{inside.sum()}: {said:.2f} -> {true:.2f}")
    brier = sum(sum((a - b) ** 2 for a, b in c.answers) for c in counts) / len(counts)
    empty = [c for c in counts if not c.there]
    return [
        {"what": "cases", "result": str(len(counts))},
        {"what": "claims of 0.95, wrong", "result": share(total("wrong"), total("sure"))},
        {
            "what": "families, without the effect",
            "result": share(total("families_wrong"), total("families")),
        },  # noqa: E501
        {"what": "effects that are claimed", "result": share(total("found"), total("there"))},
        {
            "what": "effects in a claim or its family",
            "result": share(total("in_set"), total("there")),
        },  # noqa: E501
        {
            "what": "nothing of the library missing, claimed",
            "result": share(sum(c.sure > 0 for c in empty), len(empty)),
        },  # noqa: E501
        {"what": "Brier score of a case", "result": f"{brier:.3f}"},
        {"what": "Brier score, nothing said", "result": f"{total('there') / len(counts):.3f}"},
        {"what": "expected calibration error, answers above 0.02", "result": f"{error:.3f}"},
        {"what": "reliability (answers: said -> true)", "result": "; ".join(bins)},
    ]


def main(first: int = REPORT, cases: int = CASES) -> dict[str, Any]:
    began = time.process_time()
    counts = [counted(twin(seed)) for seed in range(first, first + cases)]
    spent = time.process_time() - began
    rows = [*rows_of(counts), {"what": "CPU time a case", "result": f"{spent / cases:.2f} s"}]
    return {
        "title": "Probabilities by torque, on twins with misfits",
        "text": f"{' '.join((__doc__ or '').split())} Seeds {first} to {first + cases - 1}. Intervals are of 95 %.",
        "rows": rows,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=REPORT)
    parser.add_argument("--cases", type=int, default=CASES)
    given = parser.parse_args()
    for row in main(given.first, given.cases)["rows"]:
        print(f"{row['what']:50s} {row['result']}")
