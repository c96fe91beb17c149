"""Which reading of a recording a model speaks for: decisive, a question, or none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import pi

import numpy as np

from jaxid.conventions.finding import DataFinding
from jaxid.conventions.force_columns import FEW
from jaxid.conventions.mending import exchange_lines, lines, Mending
from jaxid.conventions.missing_force import Fitted, ForceFit, Motion
from jaxid.conventions.readings import (
    exchanges,
    mending_of,
    Names,
    nearest_convention,
    nearest_factor,
    offset_joint,
    Reading,
    refinement,
    scales,
    signs,
    zeros,
)
from jaxid.conventions.samples import Shown
from jaxid.conventions.timing import CLOSE, DRIFT, KNOWN, lateness, SURE, together
from jaxid.problem.binding import Binding


#: A reading is looked at where it leaves that share of what is missing, and decisive where it leaves so much of it.
SHARE, DECISIVE = 0.7, 0.7
#: Factors that are further apart (by their logarithm) are no two estimates of one.
FAR = 0.3
#: Readings that leave nearly the same (by this factor) cannot be told apart.
ALIKE = 1.15
#: Beside any law that the model may lack at its joints, a reading still leaves that share of what is missing.
BEYOND_LAWS = 0.7
#: A reading that leaves no more than that share is not challenged by the many of the next kind.
CLEAR = 0.2
#: What is missing is known to about that share of the drive: filters, friction near rest.
FLOOR = 0.01
MOST = 4


@dataclass(frozen=True)
class Judged:
    """A reading with what it leaves of the drive."""

    reading: Reading
    fitted: Fitted

    @property
    def left(self) -> float:
        return self.fitted.worst + FLOOR


def judged(binding: Binding, fit: ForceFit, motion: Motion, many: bool = False) -> Iterator[Shown]:
    """Findings that need the model, one after another: each is looked for in what the decisive ones before it leave. `many`: the
    model has so many numbers that readings are gone through on few samples first, and times are asked for where one row more or
    less tells."""
    names, m = Names(binding), motion
    for _ in range(MOST):
        shown, changed = _next(binding, fit, m, names, many)
        if shown is not None:
            yield shown
        if changed is None:
            break
        m = changed
    few = m.thinned(FEW) if many else m
    if fit.driven and (not many or _late(fit, few)):
        m = few
        yield from _timed(binding, fit, m, names)
        if (found := _unsigned(binding, fit, m, names)) is not None:
            yield found


def _next(binding: Binding, fit: ForceFit, m: Motion, names: Names, many: bool = False) -> tuple[Shown | None, Motion | None]:
    plain = fit.fit(m, laws=False)
    before = plain.worst + FLOOR
    few = m.thinned(FEW) if many else m
    if before <= 2 * FLOOR or before <= ALIKE * (fit.noise(plain, binding, few) + FLOOR):
        return None, None
    tried: list[Judged] = []
    for readings in _readings(names, before, fit.driven):
        own = _tried(fit, few, readings, before)
        if many:  # on all samples those that may come out on top
            own = [t for t in own if t.left <= min(ALIKE**2 * own[0].left, ALIKE * SHARE * before)]
            own = _tried(fit, m, [t.reading for t in own], before)
        tried = sorted([*tried, *own], key=lambda t: t.left)
        if tried and tried[0].left <= CLEAR * before:
            break
    if not tried or tried[0].left > SHARE * before:
        return None, None
    laws = fit.fit(m)
    best = tried[0]
    near = [t for t in tried[1:] if t.left <= ALIKE * best.left]
    same = [t for t in near if t.reading.kind == best.reading.kind]
    # Of equals the one that changes least, and inputs before outputs (the order in which they were made).
    if best.reading.kind in ("sign", "swapped_channels"):
        order = [r.channels for r in (*signs(names), *exchanges(names))]
        best, *same = sorted([best, *same], key=lambda t: (len(t.reading.channels), order.index(t.reading.channels)))
    value, interval, what = best.reading.value, None, best.reading.what
    others = {t.reading.kind for t in near} - {best.reading.kind}
    change = best.reading.change
    if (refined := _refined(fit, m, best, names, near)) is not None:
        value, interval, what, change, conventional = refined
        if not conventional:
            return None, None
        others |= {"another channel" for t in same if t.reading.channels != best.reading.channels}
    with_laws = fit.fit(change(m))
    left = fit.fit(change(m), laws=False)
    # Effects come near where laws of the joints' own motion close as much of the gap as recorded.
    beyond = left.worst + FLOOR <= ALIKE * (laws.worst + FLOOR) or with_laws.worst + FLOOR <= BEYOND_LAWS * (laws.worst + FLOOR)
    closes = max(best.left, left.worst + FLOOR) <= DECISIVE * before  # with its known value, too
    if not (closes and beyond):
        return None, None
    decisive = not others
    mending = mending_of(best.reading, value, {})
    noise = max(fit.noise(left, binding, few), 1e-6)
    alike = tuple(
        dict.fromkeys((t.reading.kind, c) for t in (near if others else same) for c in t.reading.channels
                      if (t.reading.kind, c) != (best.reading.kind, best.reading.channels[0])))  # fmt: skip
    finding = DataFinding(
        best.reading.kind,
        best.reading.channels[0],
        value,
        _words(best.reading, value, what, binding, before, left.worst + FLOOR, decisive),
        _line(binding, best.reading, mending),
        interval,
        plain.worst / noise,
        left.worst / noise,
        decisive,
        same_as=tuple(a for a in alike if a != (best.reading.kind, best.reading.channels[0])),
        headline=_headline(best.reading, value, binding, what),
    )
    return Shown(finding, mending if decisive else Mending()), (change(m) if decisive else None)


def _tried(fit: ForceFit, m: Motion, readings: list[Reading], before: float) -> list[Judged]:
    """What readings of a motion leave, the least first."""
    found = (Judged(r, fit.fit(r.change(m), laws=False, hopeless=before)) for r in readings)
    return sorted((t for t in found if np.isfinite(t.left)), key=lambda t: t.left)


def _readings(names: Names, before: float, driven: bool) -> Iterator[list[Reading]]:
    """Those that could close a gap of this size, the many last: a wrong unit leaves no small one."""
    yield [*(signs(names) if driven else ()), *(exchanges(names) if driven else ()), *zeros(names)]
    if before > 0.1:
        yield list(scales(names))


def _refined(fit: ForceFit, m: Motion, best: Judged, names: Names, near: list[Judged]):
    """Size with interval, words, change, and whether it is a convention's own value; None for what has no size. A known factor is
    one where it leaves as little as any other and none of those that come `near` is far from it."""
    found = refinement(best.reading, names)
    if found is None:
        return None
    more, size = found
    fitted = fit.fit(m, laws=False, more=lambda x: more(m, x), size=1)
    x = float(fitted.x[len(fit.free)])
    moved = replace(m)
    _, std = fit.spread(fitted, moved, len(fit.free))
    value = size(x)
    ends = (size(x - 1.96 * std), size(x + 1.96 * std)) if std < 1 else None
    travel = float(np.max(np.ptp(m.q, axis=0)))
    if best.reading.kind == "zero":
        travel = float(np.ptp(m.q[:, names.joints.index(best.reading.channels[0])]))
    if best.reading.kind == "scale":
        factor, what = nearest_factor(value, names.unit(best.reading.channels[0]))
        change = _scaled(replace(best.reading, value=factor), names)
        alike = abs(np.log(value / factor)) <= FAR
        alike = alike and fit.fit(change(m), laws=False).worst + FLOOR <= ALIKE * (fitted.worst + FLOOR)
        if alike and not any(
            t.reading.channels == best.reading.channels and abs(np.log(t.reading.value / factor)) > FAR for t in near
        ):
            return factor, ends, what, change, True
    own = nearest_convention(best.reading.kind, names.unit(best.reading.channels[0]), value, std, travel)
    if own is None:
        return value, ends, "", best.reading.change, False
    value, what = own
    if best.reading.kind == "zero":
        j = names.joints.index(best.reading.channels[0])
        return value, ends, what, (lambda m: offset_joint(m, j, -value)), True
    return value, ends, what, _scaled(replace(best.reading, value=value), names), True


def _scaled(reading: Reading, names: Names) -> Callable[[Motion], Motion]:
    again = refinement(reading, names)
    assert again is not None
    return lambda m: again[0](m, np.zeros(1))


def _line(binding: Binding, reading: Reading, mending: Mending) -> str:
    if reading.kind == "swapped_channels":
        return exchange_lines(binding.dataset, *reading.channels)
    several = len(reading.channels) > 1
    told = [(c, lines(binding.dataset, c, mending.forms[c])) for c in reading.channels]
    return "\n".join(f"{line}  # of {c}" if several else line for c, line in told)


def _listed(names: tuple[str, ...]) -> str:
    from jaxid.wording import listed

    return listed(names)


def _headline(reading: Reading, value: float, binding: Binding, what: str) -> str:
    name = _listed(reading.channels)
    if reading.kind == "sign":
        verb = "have" if len(reading.channels) > 1 else "has"
        it = "them" if len(reading.channels) > 1 else "it"
        return f"{name} {verb} the opposite sign; everything below takes {it} negated"
    if reading.kind == "swapped_channels":
        return f"{name} are exchanged; everything below takes each for the other"
    if reading.kind == "zero":
        return f"the zero of {name} is off by {_angle(value)}; everything below takes that away"
    return f"{name} is {value:.5g} times too large ({what}); everything below divides by that"


def _angle(value: float) -> str:
    return f"{value:.4f} rad ({np.degrees(value):.4g} deg)"


def _words(reading: Reading, value: float, what: str, binding: Binding, before: float, left: float, decisive: bool) -> str:
    name = _listed(reading.channels)
    of = f"the model leaves {100 * before:.2g} % of the drive as recorded and {100 * left:.2g} % so"
    if reading.kind == "sign":
        said = f"{name} seem{'s' * (len(reading.channels) == 1)} to count the other way"
    elif reading.kind == "swapped_channels":
        said = f"{name} seem to be exchanged"
    elif reading.kind == "zero":
        turns = f", {abs(value) / (pi / 2):.0f} quarter turn{'s' * (abs(value) > 2)}" if "quarter" in what else ""
        said = f"{name} reads {_angle(value)} where its zero should be{turns}"
    else:
        said = f"{name} is recorded {value:.5g} times as large as it is ({what})"
    return f"{said}: {of}." if decisive else f"Is it that {said}? {of[0].upper()}{of[1:]}; other readings come near."


def _timed(binding: Binding, fit: ForceFit, m: Motion, names: Names) -> Iterator[Shown]:
    """Whole rows and drifting clocks."""
    plain = fit.fit(m)
    if plain.worst > DECISIVE or not names.inputs:  # what is missing is something else
        if (drifting := _far_drift(fit, m, plain)) is None:
            return
        m = drifting
    late, _ = lateness(fit, m)
    column = lambda name: np.array([getattr(x, name) for x in late])
    drifting = together(column("drift"), column("drift_std"))
    if drifting is not None and DRIFT * m.step < abs(drifting[0]) * float(m.since.max()) and abs(drifting[0]) < 0.015:
        yield _clock(binding, m, names, *drifting)
        return
    common = together(column("rows"), column("std"))
    for k, x in enumerate(late):
        rows, std = common if common is not None else (x.rows, x.std)
        whole = round(rows)
        if whole and abs(whole) <= 3 and std <= KNOWN and abs(rows - whole) <= CLOSE and abs(rows) > SURE * std:
            yield _shifted(binding, names, k, whole, rows, std)


def _late(fit: ForceFit, m: Motion) -> bool:
    """Whether whole rows between inputs and motion close a share of the gap."""
    before = fit.fit(m, laws=False).worst + FLOOR
    moved = (fit.fit(replace(m, rows=m.rows + k), laws=False).worst + FLOOR for k in (-3, -2, -1, 1, 2, 3))
    return before > 2 * FLOOR and min(moved) <= SHARE * before


def _far_drift(fit: ForceFit, m: Motion, plain: Fitted) -> Motion | None:
    """The motion with clocks that drift by so much that nothing fits as recorded; None where that explains nothing."""
    tried = []
    for ppm in (200, 500, 1000, 2000, 5000, 10000):
        for sign in (1, -1):
            moved = replace(m, drift=m.drift + sign * 1e-6 * ppm)
            tried.append((fit.fit(moved).worst, sign * ppm, moved))
    left, _, moved = min(tried, key=lambda t: t[:2])
    return moved if left < DECISIVE * plain.worst else None


def _clock(binding: Binding, m: Motion, names: Names, drift: float, std: float) -> Shown:
    channels = names.inputs if len(names.inputs) == 1 or len(names.joints) > 1 else names.joints
    way = 1 if channels is names.inputs else -1
    ppm, spread = way * 1e6 * drift, 1e6 * std
    forms = {"clock_ppm": float(f"{ppm:.4g}")}
    text = (
        f"The clocks of {_listed(tuple(names.inputs))} and {_listed(tuple(names.joints))} drift apart by {abs(ppm):.4g} ± "
        f"{spread:.2g} ppm, {abs(drift) * m.since.max() / m.step:.2g} rows within a run: no delay grows like that."
    )
    other = names.joints if channels is names.inputs else names.inputs
    several = len(channels) > 1
    told = [lines(binding.dataset, c, forms) + (f"  # of {c}" if several else "") for c in channels]
    finding = DataFinding(
        "clock", channels[0], ppm, text, "\n".join(told), (ppm - 1.96 * spread, ppm + 1.96 * spread), decisive=True,
        same_as=tuple(("clock", c) for c in other),
        headline=f"the clock of {_listed(tuple(channels))} drifts by {ppm:.4g} ppm; everything below takes that away",
    )  # fmt: skip
    return Shown(finding, Mending({c: dict(forms) for c in channels}))


def _shifted(binding: Binding, names: Names, k: int, rows: int, late: float, std: float) -> Shown:
    """Whole rows: the output before its cause is a convention; a cause that comes early is a delay as well."""
    name = names.inputs[k]
    forms = {"shift": rows}
    interval = (late - 1.96 * std, late + 1.96 * std)
    step = f"{abs(rows)} row{'s' * (abs(rows) > 1)}"
    by = f"{abs(late):.2f} ± {std:.2f} rows"
    if rows > 0:
        moves = "moves" if len(names.joints) == 1 else "move"
        text = (
            f"{_listed(tuple(names.joints))} {moves} {by} before {name}, the cause: row k seems to hold the {name} of the step "
            "before it."
        )
        headline = f"{name} stands {step} late; everything below takes it that much earlier"
        same = tuple(("row_shift", j) for j in names.joints) if len(names.inputs) == 1 else ()
        finding = DataFinding(
            "row_shift", name, float(rows), text, lines(binding.dataset, name, forms), interval, decisive=True,
            same_as=same, headline=headline,
        )  # fmt: skip
        return Shown(finding, Mending({name: forms}))
    text = (
        f"The motion follows {name} {by} later: whole rows, as of a log that writes the output late, or a delay of the drive "
        "or the sensor (input_delay, sensor_delay). The recording cannot tell; nothing is shifted."
    )
    finding = DataFinding(
        "row_shift", name, float(rows), text, lines(binding.dataset, name, forms), interval,
        same_as=(("input_delay", name), *(("sensor_delay", j) for j in names.joints)),
    )  # fmt: skip
    return Shown(finding, Mending())


def _unsigned(binding: Binding, fit: ForceFit, m: Motion, names: Names) -> Shown | None:
    """An input that never changes its sign where the motion asks for both."""
    if not binding.chain.direct:
        return None
    plain = fit.fit(m)
    if plain.worst < 0.3:
        return None
    inputs = [c.name for c in binding.dataset.inputs]
    raw = {n: np.concatenate([e.u[:, inputs.index(n)] for e in binding.dataset.experiments]) for n in names.inputs}
    one_way = [n for n, u in raw.items() if min(abs(u.min()), abs(u.max())) <= 0.02 * np.percentile(np.abs(u), 99) and u.any()]
    signed = _signed(fit, m, [names.inputs.index(n) for n in one_way]) if one_way else None
    if signed is not None:
        name, left = one_way[0], fit.fit(signed).worst
        if left < DECISIVE * plain.worst:
            text = (
                f"{_listed(tuple(one_way))} never changes its sign, and the motion asks for both: the sensor seems to read its "
                f"size alone (with the signs that the motion asks for, what is missing falls from {100 * plain.worst:.2g} to "
                f"{100 * left:.2g} %). Record the signed reading, or multiply by the sign of the command."
            )
            return Shown(DataFinding("unsigned", name, None, text), Mending())
    return None


def _signed(fit: ForceFit, m: Motion, which: list[int]) -> Motion | None:
    """The motion with these inputs given the signs that the model itself asks for, starting from those of the acceleration."""
    sources, first = [], 0
    sign = np.sign(m.qdd[:, which])
    for _ in range(6):
        sources, first = [], 0
        for s in m.sources:
            own = sign[first : first + len(s.at)]
            first += len(s.at)
            u = np.array(s.u)
            at = np.clip(np.searchsorted(s.at, s.t), 0, len(s.at) - 1)
            u[:, which] = u[:, which] * own[at]
            sources.append(replace(s, u=u))
        now = replace(m, sources=tuple(sources))
        fitted = fit.fit(now, laws=False)
        theta = fit.binding.theta.copy()
        theta[fit.free] = fitted.x[: len(fit.free)]
        asked = -fit.missing(theta, replace(now, mix=0 * now.mix))[:, which]
        new = np.where(asked >= 0, 1.0, -1.0)
        if np.array_equal(new, sign):
            break
        sign = new
    return replace(m, sources=tuple(sources)) if sources else None
