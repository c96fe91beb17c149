"""Rows and clocks: by how many rows the inputs are late against the motion, and whether that
grows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from jaxid.base.wording import listed
from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import ALIKE, ASKED, FLOOR, GONE
from jaxid.conventions.mending import lines, Mending
from jaxid.conventions.missing_force import ForceFit, ReadingFit
from jaxid.conventions.readings import Names
from jaxid.conventions.samples import Shown
from jaxid.data.retimed import FINEST
from jaxid.force.sampled_motion import SampledMotion
from jaxid.models.effects import InputDelay, SensorDelay
from jaxid.problem.binding import Binding


#: A delay is one of whole rows if it is known so well (rows) and lies so close to them.
KNOWN, CLOSE = 0.12, 0.25
#: Standard deviations from which a drift is said, and from which it is tried: nothing fits well,
#: and is known well, before it.
SURE, LIKELY = 6.0, 2.0
#: A clock's drift moves the input by at least this many rows within a run.
DRIFT = 0.7
MOST_ROWS, MOST_DRIFT = 6.0, 0.02
#: A motion comes before its cause from this many rows on: an input that is held or runs on from
#: sample to sample is half a row.
EARLY = 0.75
#: How well a lateness of many rows is known, as a share of it; steps to each side in which one is
#: looked for.
SHARE, WIDEST = 0.1, 12


@dataclass(frozen=True)
class Late:
    """By how many rows an input stands later than it acts, and how fast that grows (s/s), with
    standard deviations.
    """

    rows: float
    std: float
    drift: float
    drift_std: float


def lateness(
    fit: ForceFit, m: SampledMotion, as_one: bool = False
) -> tuple[list[Late], SampledMotion]:
    """Of each input, or of all of them `as_one`, beside any law of the joint's own motion (what a
    model lacks there is no delay); and the motion without.
    """
    nu, nq, size = len(m.mix), fit.nq, len(fit.free)
    begun = m.rows
    late: list[Late] = []
    for least in (LIKELY, LIKELY, SURE, SURE):
        fitted = fit.fit(replace(m, held=np.zeros(len(m.held), bool)))
        theta = fit.binding.theta.copy()
        theta[fit.free] = fitted.x[:size]
        weight, base = m.weight / fit.norm(m), fit.missing(theta, m)
        own = _own_laws(m) * weight[..., None]
        parts = [fitted.slopes[..., :size]]
        for j in range(nq):
            laws = np.zeros((*weight.shape, own.shape[2]))
            laws[:, j] = own[:, j]
            parts.append(laws)
        columns = []
        for k in range(nu):
            pushed = replace(m, rows=m.rows + 0.05 * (np.arange(nu) == k))
            columns.append((fit.missing(theta, pushed) - base) * weight / 0.05)
        if as_one:
            columns = [np.sum(columns, axis=0)]
        growing = [c * ((m.since - m.since.mean()) / m.step)[:, None] for c in columns]
        whole = replace(
            fitted, slopes=np.concatenate([*parts, np.stack([*columns, *growing], -1)], -1)
        )
        first = whole.slopes.shape[-1] - 2 * len(columns)
        steps = [fit.spread(whole, m, first + k) for k in range(2 * len(columns))]
        told = 1 if as_one else nu  # as often as there is something told
        steps = [*steps[:1] * nu, *steps[1:] * nu] if as_one else steps

        def good(pair, most):
            return float(np.clip(pair[0], -most, most)) if np.isfinite(pair[1]) else 0.0

        drift = np.array([good(p, MOST_DRIFT) for p in steps[nu:]])
        sure = (
            together((m.drift + drift)[:told], np.array([s for _, s in steps[nu:]])[:told], least)
            is not None
        )
        change = drift if sure else -m.drift
        rows = np.array([good(p, 2.0) for p in steps[:nu]]) - change * m.since.mean() / m.step
        late = [
            Late(
                float(m.rows[k] + rows[k]),
                steps[k][1],
                float(m.drift[k] + change[k]),
                steps[nu + k][1],
            )
            for k in range(nu)
        ]
        m = replace(
            m,
            rows=np.clip(m.rows + rows, begun - MOST_ROWS, begun + MOST_ROWS),
            drift=m.drift + change,
        )
    return late, m


def together(
    values: np.ndarray, stds: np.ndarray, least: float = SURE
) -> tuple[float, float] | None:
    """Mean and standard deviation of what several inputs say, where that is surely not zero and
    they agree.
    """
    known = np.isfinite(stds) & (stds > 0)
    if not known.any():
        return None
    weight = np.where(known, 1 / np.where(known, stds, 1.0) ** 2, 0.0)
    mean, std = float(np.sum(weight * values) / weight.sum()), float(1 / np.sqrt(weight.sum()))
    agree = bool(np.all(np.abs(values - mean)[known] <= 3 * stds[known] + 0.02 * abs(mean)))
    return (mean, std) if agree and abs(mean) > least * std else None


def _own_laws(m: SampledMotion) -> np.ndarray:
    """Any force of the joint's own motion [rows nq laws], whatever its sign."""
    parts = [
        np.ones_like(m.q),
        m.q,
        m.qd,
        m.qdd,
        np.sign(m.qd),
        m.qd * np.abs(m.qd),
        np.sin(m.q),
        np.cos(m.q),
    ]
    return np.stack(
        [a / max(1e-300, float(np.sqrt(np.mean(a**2)))) for a in map(m.mean, parts)], -1
    )


# ---- findings


def timed(binding: Binding, fit: ForceFit, m: SampledMotion, names: Names) -> Iterator[Shown]:
    """What the times of inputs and motion say: rows and clocks, else a motion that comes before its
    cause by any time.
    """
    rows = list(_rows_and_clocks(binding, fit, m, names))
    yield from rows
    if names.inputs and not any(shown.finding.decisive for shown in rows):
        yield from _before_causes(binding, fit, m, names)


def _before_causes(
    binding: Binding, fit: ForceFit, m: SampledMotion, names: Names
) -> Iterator[Shown]:
    """Inputs that are recorded later than they act, by any time: the motion comes before its cause,
    as in no machine.
    """
    plain = fit.fit(m)
    noise = fit.noise(plain, binding, m)
    if plain.worst <= ALIKE * noise:
        return
    near = _nearest_rows(fit, m, plain.worst)
    late, common, _ = _told(fit, near)
    told = [(x.rows, x.std) for x in late] if common is None else [common] * len(late)
    rows = np.zeros(len(told))
    for k, (value, std) in enumerate(told):
        if value >= EARLY and value > SURE * std:
            rows[k] = value
            if std > max(KNOWN, SHARE * value):
                return
    if not rows.any():
        return
    left = fit.fit(replace(m, rows=m.rows + rows)).worst
    if left > GONE * plain.worst:
        return
    # A fraction of a row has no value of its own that would speak for it: it has to be the answer
    # as a whole.
    sure = left <= max(ASKED * plain.worst, ALIKE * noise)
    for k in np.flatnonzero(rows):
        yield _early(binding, m.step, names, int(k), *told[k], sure)


def _nearest_rows(fit: ForceFit, m: SampledMotion, before: float) -> SampledMotion:
    """The motion with all inputs taken later or earlier by what leaves least of it, on a grid that
    no oscillation of theirs slips through.
    """
    change = np.concatenate([np.diff(s.u, axis=0) for s in m.sources])
    size = np.concatenate([s.u - s.u.mean(0) for s in m.sources])
    swing = float(np.mean(size**2)) / max(float(np.mean(change**2)), 1e-300)
    apart = max(1.0, np.pi / 8 * np.sqrt(swing))
    grid = apart * np.arange(-WIDEST, WIDEST + 1)
    tried = [(fit.fit(replace(m, rows=m.rows + k), hopeless=before).worst, abs(k), k) for k in grid]
    return replace(m, rows=m.rows + min(tried)[2])


def _early(
    binding: Binding, step: float, names: Names, k: int, rows: float, std: float, sure: bool
) -> Shown:
    """A finding of an input that is recorded by this many rows later than it acts."""
    name, joints = names.inputs[k], listed(tuple(names.joints))
    forms = {"delay_s": float(f"{rows * step:.4g}")}
    std = float(np.hypot(std, FINEST))
    by = f"{1e3 * rows * step:.3g} ± {1.96e3 * std * step:.1g} ms ({rows:.2g} rows)"
    moves = "moves" if len(names.joints) == 1 else "move"
    text = (
        f"{joints} {moves} {by} before {name}, the cause, and no machine does that: {name} is"
        " reported late, by a filter, a bus or a log."
    )
    finding = DataFinding(
        "row_shift",
        name,
        rows,
        text,
        lines(binding.dataset, name, forms),
        (rows - 1.96 * std, rows + 1.96 * std),
        decisive=sure,
        headline=(
            f"{name} is reported {1e3 * rows * step:.3g} ms late; everything below takes it that"
            " much earlier"
        ),
    )
    return Shown(finding, Mending({name: forms}) if sure else Mending(), True)


def _rows_and_clocks(
    binding: Binding, fit: ForceFit, m: SampledMotion, names: Names
) -> Iterator[Shown]:
    """Whole rows and drifting clocks, where they close a share of what is missing: a load that is
    lost half-way looks late too.
    """
    plain = fit.fit(m)
    shown = False
    if plain.worst > GONE or not names.inputs:  # what is missing is something else
        drifting = _far_drift(fit, m, plain)
        if drifting is None:
            return
        m, shown = drifting, True
    times = _OtherTimes(binding, fit, m, plain.worst, shown)
    late, common, drift = _told(fit, m)
    if drift is not None and times.may_drift(drift[0]) and times.grows(late, common, drift[0]):
        yield _clock(binding, m, names, *drift)
        return
    for k, x in enumerate(late):
        rows, std = common or (x.rows, x.std)
        if not _is_whole(rows, std):
            continue
        whole = round(rows)
        # A cause that comes early is a question at most.
        if whole < 0 or times.close(replace(m, rows=m.rows + whole), plain.worst):
            yield _shifted(binding, names, k, whole, rows, std)


@dataclass(frozen=True)
class _OtherTimes:
    """What a motion leaves where its inputs have other times. `shown`: nothing fits without the
    drift that it has, which has shown it.
    """

    binding: Binding
    fit: ForceFit
    m: SampledMotion
    plain: float
    shown: bool

    def close(self, moved: SampledMotion, before: float) -> bool:
        """Whether what is left is much less, or noise."""
        if self.shown:
            return True
        left = self.fit.fit(moved)
        noise = self.fit.noise(left, self.binding, moved)
        return left.worst <= max(GONE * before, ALIKE * noise)

    def may_drift(self, drift: float) -> bool:
        """Whether a drift is one that shows within the recording, and a clock may have."""
        return DRIFT * self.m.step < abs(drift) * float(self.m.since.max()) and abs(drift) < 0.015

    def grows(self, late: list[Late], common: Told, drift: float) -> bool:
        """Whether a drift closes what is missing, beside what is late all the time (`common`) and
        may be a delay.
        """
        m = self.m
        drifts = drift * np.ones(len(late))
        if common is None:
            return self.close(replace(m, drift=drifts), self.plain)
        rows = np.array([x.rows for x in late])
        delayed = rows + drift * float(m.since.mean()) / m.step
        without = self.fit.fit(replace(m, rows=delayed, drift=0 * drifts))
        return self.close(replace(m, rows=rows, drift=drifts), without.worst)


def _is_whole(rows: float, std: float) -> bool:
    """Whether a lateness is a few whole rows, and known well enough for that."""
    whole = round(rows)
    if not 0 < abs(whole) <= 3:
        return False
    return std <= KNOWN and abs(rows - whole) <= CLOSE and abs(rows) > SURE * std


Told = tuple[float, float] | None


def _told(fit: ForceFit, m: SampledMotion) -> tuple[list[Late], Told, Told]:
    """Lateness of each input; by how many rows all are late, and how fast that grows, with standard
    deviations, where sure.
    """
    late, _ = lateness(fit, m)
    told = late
    if len(late) > 1 and not any(
        x.std <= KNOWN for x in late
    ):  # chambers of one cylinder, motors of one belt
        late, _ = lateness(fit, m, as_one=True)
        told = late[:1]

    def column(name):
        return np.array([getattr(x, name) for x in told])

    return (
        late,
        together(column("rows"), column("std")),
        together(column("drift"), column("drift_std")),
    )


def whole_rows_tell(fit: ForceFit, m: SampledMotion) -> bool:
    """Whether whole rows between inputs and motion close a share of the gap."""
    before = fit.fit(m, laws=False).worst + FLOOR
    moved = (
        fit.fit(replace(m, rows=m.rows + k), laws=False).worst + FLOOR
        for k in (-3, -2, -1, 1, 2, 3)
    )
    return before > 2 * FLOOR and min(moved) <= GONE * before


def _far_drift(fit: ForceFit, m: SampledMotion, plain: ReadingFit) -> SampledMotion | None:
    """The motion with clocks that drift by so much that nothing fits as recorded; None where that
    explains nothing.
    """
    tried = []
    for ppm in (200, 500, 1000, 2000, 5000, 10000):
        for sign in (1, -1):
            moved = replace(m, drift=m.drift + sign * 1e-6 * ppm)
            tried.append((fit.fit(moved).worst, sign * ppm, moved))
    left, _, moved = min(tried, key=lambda t: t[:2])
    return moved if left < GONE * plain.worst else None


def _clock(binding: Binding, m: SampledMotion, names: Names, drift: float, std: float) -> Shown:
    channels = names.inputs if len(names.inputs) == 1 or len(names.joints) > 1 else names.joints
    way = 1 if channels is names.inputs else -1
    ppm, spread = way * 1e6 * drift, 1e6 * std
    forms = {"clock_ppm": float(f"{ppm:.4g}")}
    text = (
        f"The clocks of {listed(tuple(names.inputs))} and {listed(tuple(names.joints))} drift apart"
        f" by {abs(ppm):.4g} ± {spread:.2g} ppm, {abs(drift) * m.since.max() / m.step:.2g} rows"
        " within a run: no delay grows like that."
    )
    other = names.joints if channels is names.inputs else names.inputs
    told = [lines(binding.dataset, c, forms) for c in channels]
    if len(channels) > 1:
        told = [f"{line}  # of {c}" for line, c in zip(told, channels, strict=True)]
    finding = DataFinding(
        "clock",
        channels[0],
        ppm,
        text,
        "\n".join(told),
        (ppm - 1.96 * spread, ppm + 1.96 * spread),
        decisive=True,
        same_as=tuple(("clock", c) for c in other),
        headline=(
            f"the clock of {listed(tuple(channels))} drifts by {ppm:.4g} ppm; everything below"
            " takes that away"
        ),
    )
    return Shown(finding, Mending({c: dict(forms) for c in channels}), True)


def _shifted(binding: Binding, names: Names, k: int, rows: int, late: float, std: float) -> Shown:
    """Whole rows: the output before its cause is a convention; a cause that comes early is a delay
    as well.
    """
    name = names.inputs[k]
    forms = {"shift": rows}
    interval = (late - 1.96 * std, late + 1.96 * std)
    step = f"{abs(rows)} row{'s' * (abs(rows) > 1)}"
    by = f"{abs(late):.2f} ± {std:.2f} rows"
    if rows > 0:
        moves = "moves" if len(names.joints) == 1 else "move"
        text = (
            f"{listed(tuple(names.joints))} {moves} {by} before {name}, the cause: row k seems to"
            f" hold the {name} of the step before it."
        )
        headline = f"{name} stands {step} late; everything below takes it that much earlier"
        same = tuple(("row_shift", j) for j in names.joints) if len(names.inputs) == 1 else ()
        finding = DataFinding(
            "row_shift",
            name,
            float(rows),
            text,
            lines(binding.dataset, name, forms),
            interval,
            decisive=True,
            same_as=same,
            headline=headline,
        )
        return Shown(finding, Mending({name: forms}), True)
    text = (
        f"The motion follows {name} {by} later: whole rows, as of a log that writes the output"
        f" late, or a delay of the drive or the sensor ({InputDelay.name}, {SensorDelay.name}). The"
        " recording cannot tell; nothing is shifted."
    )
    finding = DataFinding(
        "row_shift",
        name,
        float(rows),
        text,
        lines(binding.dataset, name, forms),
        interval,
        same_as=((InputDelay.name, name), *((SensorDelay.name, j) for j in names.joints)),
    )
    return Shown(finding, Mending())
