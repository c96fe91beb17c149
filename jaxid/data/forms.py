"""What `dataset.toml` may say of how a channel was recorded, applied to its samples: unwrapping,
glitches, rows that repeat, rows and times it is late by, a clock that drifts.

The forms compose in one order: raw (a column, or weighted columns), the sign of a register
(`sign_bit`, `signed_bits`), `scale` and `offset`, `unwrap`, `drop_glitches` and `sampled_every`,
the unit's SI value, then `shift`, and `delay_s` with `clock_ppm` at last. Nothing is filled in: a
reading of an output that is left out counts in no loss, and an input or auxiliary channel holds its
last good sample there, as it does between samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxid.data import registers
from jaxid.data.units import Conversion


#: A glitch lies off both sides by this many times what the curve bends nearby; white noise does so
#: once in 1e9 samples.
OFF = 8.0
LONGEST_GLITCH = 3  # samples
_BESIDE = 7  # samples on each side that say what is usual


@dataclass(frozen=True)
class Signal:
    """A channel at the samples of a run, SI: `values [time]`, `left_out [time]`, and `known
    [time]`: where it has a value; `held` counts the samples of an input or auxiliary channel at
    which the last good one holds.
    """

    values: np.ndarray
    left_out: np.ndarray
    known: np.ndarray
    held: int = 0


class FormError(ValueError):
    """A form that these samples contradict: what is wrong, and what to do."""

    def __init__(self, message: str, remedy: str):
        super().__init__(message)
        self.remedy = remedy


def signal(
    raw: np.ndarray, t: np.ndarray, valid: np.ndarray, entry: Any, conversion: Conversion
) -> Signal:
    """A channel's samples `raw [time]` (recorded at `t [time]` s) by its entry in `dataset.toml`.

    Raises `FormError` where a form does not fit the samples.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        values = entry.scale * _with_sign(raw, valid, entry) + entry.offset
        period = _period(entry, conversion)
        values, left_out = _without_glitches(values, t, ~valid, period, entry.drop_glitches)
        if entry.sampled_every > 1:
            left_out = left_out | ~_fresh(values, entry.sampled_every)
        values = conversion.factor * values + conversion.shift
    if left_out.all():
        raise FormError(
            "every sample would be left out", "Correct `valid`, `drop_glitches` or `sampled_every`"
        )
    count = 0 if entry.role == "output" else int(np.sum(left_out))
    if count:
        values, left_out = (
            _held(values, left_out, t, entry.hold == "linear"),
            np.zeros(len(values), bool),
        )
    found = Signal(values, left_out, np.ones(len(values), bool), count)
    if entry.shift:
        found = _shifted(found, entry.shift)
    if entry.delay_s or entry.clock_ppm:
        found = _resampled(
            found, t, t[0] + (t - t[0]) / (1 + 1e-6 * entry.clock_ppm) - entry.delay_s, entry
        )
    return found


def _with_sign(raw: np.ndarray, valid: np.ndarray, entry: Any) -> np.ndarray:
    """Raw samples with the sign that their register holds beside their size."""
    if entry.sign_bit is None and entry.signed_bits is None:
        return raw
    try:
        return registers.signed(np.where(valid, raw, 0.0), entry.sign_bit, entry.signed_bits)
    except ValueError as error:
        raise FormError(str(error), "Remove it, or state the bits of this register") from None


def _period(entry: Any, conversion: Conversion) -> float:
    """After how much a wrapped value starts again, in the channel's stated unit; 0 where it does
    not wrap.
    """
    if entry.unwrap is False:
        return 0.0
    if entry.unwrap is not True:
        return abs(entry.unwrap * entry.scale)
    if conversion.si != "rad":
        raise FormError(
            f"unwrap = true means one turn, and the unit {entry.unit!r} is not an angle",
            "Write the range after which the recorded value starts again: unwrap = 4096",
        )
    return 2 * np.pi / conversion.factor


def unwrapped(values: np.ndarray, period: float) -> np.ndarray:
    """Without jumps of a period between neighbours."""
    return np.unwrap(values, period=period)


def _without_glitches(
    values: np.ndarray, t: np.ndarray, left: np.ndarray, period: float, drop: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Unwrapped values, and which are left out. A glitch must not turn what follows it, so it is
    found before it is unwrapped.
    """
    values = values.copy()
    good = np.flatnonzero(~left)
    if drop:
        straight = unwrapped(values[good], period) if period else values[good]
        left = left.copy()
        left[good[glitches(straight, t[good])]] = True
        good = np.flatnonzero(~left)
    if period:
        values[good] = unwrapped(values[good], period)
    return values, left


def glitches(values: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Which of `values [time]` at `t [time]` s are glitches [time]: up to three samples that lie
    off both what came before and what follows, by far more than the curve bends nearby. A jump or
    an impact agrees with one side, a flicker by the resolution is usual.

    A clock may be uneven, and time stamps may scatter about an even clock: a glitch is one by the
    times and by the rows.
    """
    by_rows = _off_both_sides(values, np.arange(len(values), dtype=float))
    return by_rows & _off_both_sides(values, t) if by_rows.any() else by_rows


def _off_both_sides(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The same along one axis `at [time]`."""
    found = np.zeros(len(values), bool)
    if len(values) < 2 * _BESIDE:
        return found
    step = np.diff(at)
    slope = np.diff(values) / step
    before = np.concatenate(
        [[0.0, 0.0], np.diff(slope) * step[1:]]
    )  # off the line through the two samples before
    after = np.concatenate(
        [np.diff(slope) * step[:-1], [0.0, 0.0]]
    )  # off the line through the two samples after
    bend = np.maximum(np.abs(before[2:]), np.abs(after[:-2]))
    bending = bend[bend > 0]
    if not len(bending):
        return found
    usual = np.maximum(_median_around(bend), np.median(bending))
    scale = np.concatenate([usual[:1], usual, usual[-1:]])
    for length in range(1, LONGEST_GLITCH + 1):
        first, last = before[: len(values) - length + 1], after[length - 1 :]
        off = (first * last > 0) & (
            np.minimum(np.abs(first), np.abs(last)) > OFF * scale[: len(first)]
        )
        for k in np.flatnonzero(off):
            found[k : k + length] = True
    return found


def _median_around(values: np.ndarray) -> np.ndarray:
    from numpy.lib.stride_tricks import sliding_window_view

    padded = np.pad(values, _BESIDE, mode="reflect" if len(values) > _BESIDE else "edge")
    return np.median(sliding_window_view(padded, 2 * _BESIDE + 1), axis=1)


def _fresh(values: np.ndarray, every: int) -> np.ndarray:
    """The samples [time] at which a channel that is sampled every n-th row has a new value."""
    changes = np.flatnonzero(np.diff(values) != 0) + 1
    counts = np.bincount(changes % every, minlength=every)
    first = int(np.argmax(counts)) if len(changes) else 0
    if len(changes) and counts[first] < 0.9 * len(changes):
        usual = int(round(float(np.median(np.diff(changes))))) if len(changes) > 1 else 1
        raise FormError(
            f"it changes at {len(changes)} rows, {len(changes) - counts[first]} of them not every"
            f" {every}th",
            f"Correct sampled_every (its value stays for {usual} rows as a rule), or name the rows"
            " by `valid`",
        )
    return np.arange(len(values)) % every == first


def _held(values: np.ndarray, left_out: np.ndarray, t: np.ndarray, linear: bool) -> np.ndarray:
    """An input or auxiliary channel where samples are left out: as it is between its samples."""
    kept = np.flatnonzero(~left_out)
    if linear:
        return np.interp(t, t[kept], values[kept])
    last = kept[np.maximum(np.searchsorted(kept, np.arange(len(values)), side="right") - 1, 0)]
    return values[last]


def _shifted(s: Signal, rows: int) -> Signal:
    """Each value that many rows earlier; where none comes to lie is not known."""
    moved = Signal(
        np.roll(s.values, -rows), np.roll(s.left_out, -rows), np.roll(s.known, -rows), s.held
    )
    edge = slice(len(s.values) - rows, None) if rows > 0 else slice(0, -rows)
    moved.known[edge] = False
    return moved


def _resampled(s: Signal, t: np.ndarray, own: np.ndarray, entry: Any) -> Signal:
    """A channel whose samples belong to the times `own [time]`, at the times t.

    An input that holds its samples keeps its mean over each interval; anything else lies on the
    line between its samples.
    """
    good = s.known
    known = (t >= own[good][0]) & (t <= own[good][-1])
    if not known.any():
        raise FormError(
            "nothing of it is left within the run", "Correct `delay_s`, `shift` or `clock_ppm`"
        )
    beside = np.interp(t, own, (s.left_out | ~s.known).astype(float)) > 0
    if entry.role == "input" and entry.hold == "zero":
        inside, values = own[good], s.values[good]
        integral = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(inside))])
        ends = np.append(t[1:], t[-1])

        def reach(at):
            return np.interp(at, inside, integral) + np.maximum(at - inside[-1], 0) * values[-1]

        width = np.maximum(ends - t, 1e-300)
        mean = np.where(ends > t, (reach(ends) - reach(t)) / width, values[-1])
        return Signal(mean, np.zeros(len(t), bool), known, s.held)
    return Signal(np.interp(t, own, s.values), beside & s.left_out.any(), known, s.held)
