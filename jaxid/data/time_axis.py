"""The time column of a table in seconds: units, dates, clocks that count from 1970, and times that
cannot be seconds.
"""

from __future__ import annotations

import datetime
import re
from typing import Any

import numpy as np


PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
LONGEST_STEP, SHORTEST_STEP = 1.0, 1e-6  # s, of recordings whose unit of time nobody stated
EPOCH, LATEST = 1e8, 1e10  # s: a clock, not a stopwatch; none counts further (the year 2286)
#: A time of day, after a date or alone: `12:03:04.5`, `01.03.2024 12:03:04,5`, `3/1/2024 12:03:04`.
CLOCK = re.compile(
    r"(?:(\d{1,4}[./-]\d{1,2}[./-]\d{1,4})[ T]+)?(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)"
)


def seconds(cells: Any, numbers: np.ndarray, unit: str | None) -> tuple[np.ndarray, str]:
    """Seconds [time] from a column's cells (`numbers [time]` are the same as float64), and what was
    done, or "".

    Dates, ISO texts and clocks that count from 1970 count from the first sample of the column,
    exactly.
    """
    t, start = since_start(cells, numbers, unit)
    if start is None:
        counted = len(t) > 0 and np.isfinite(t).any() and not np.isfinite(numbers).any()
        return t, (
            "the time is a duration"
            if counted or getattr(getattr(cells, "dtype", None), "kind", "") == "m"
            else ""
        )
    return t, f"time counts from the first sample, {_when(np.datetime64(start, 'ns'))}"


def since_start(cells: Any, numbers: np.ndarray, unit: str | None) -> tuple[np.ndarray, int | None]:
    """Seconds [time], and the nanoseconds since 1970 from which they count, None where they count
    from nowhere in particular.
    """
    dates = _dates(cells, numbers)
    if dates is not None and dates.dtype.kind == "m":
        return _from(dates, np.timedelta64(0, "ns")), None
    if dates is not None:
        start = _first(dates)
        return _from(dates, start), int(start.astype(np.int64))
    if unit is None:
        return numbers, None
    per_second = PER_SECOND[unit]
    finite = numbers[np.isfinite(numbers)]
    if len(finite) and abs(finite[0]) / per_second > EPOCH:
        whole = _integers(cells)
        exact = whole if whole is not None else numbers
        start = whole[0] if whole is not None else finite[0]
        return (exact - start) / per_second, int(start * (10**9 // per_second))
    return numbers / per_second, None


def impossible(t: np.ndarray, recorded: str = "t") -> tuple[str, str] | None:
    """Why these times [time] of a column without a stated unit can be no seconds, and what to
    write; None where they can.
    """
    step = np.diff(t)
    step = step[step > 0]
    if not len(step):
        return None
    median, size = float(np.median(step)), float(np.min(np.abs(t)))
    if size > EPOCH:
        unit = next((u for u, n in PER_SECOND.items() if size / n < 1e10), "ns")
        return (
            f"{size:.6g} is a clock that counts from 1970",
            f'Say what it counts: time_unit = "{unit}"',
        )
    if median > LONGEST_STEP:
        unit = next((u for u in ("ms", "us", "ns") if median / PER_SECOND[u] <= 0.5), "ns")
        why = f'is {recorded} in {unit}? say time_unit = "{unit}"'
        return f"a median step of {median:.4g} s: {why}", 'If it is seconds, say time_unit = "s"'
    if median < SHORTEST_STEP:
        return (
            f"a median step of {median:.3g} s, shorter than any recording's",
            'Name the column of the time, or say time_unit = "s"',
        )
    return None


def contradicted(numbers: np.ndarray, unit: str | None) -> tuple[str, str] | None:
    """Why a clock [time] cannot count in the unit that is stated for it, and the one it does count
    in; None where it can.
    """
    finite = numbers[np.isfinite(numbers)]
    if unit is None or not len(finite) or abs(finite[0]) / PER_SECOND[unit] <= LATEST:
        return None
    right = next((u for u, n in PER_SECOND.items() if abs(finite[0]) / n <= LATEST), "ns")
    return f"{finite[0]:.6g} {unit} is later than any clock that counts from 1970", right


def _dates(cells: Any, numbers: np.ndarray) -> np.ndarray | None:
    """datetime64[ns] or timedelta64[ns] of a column that holds dates, durations or ISO texts."""
    array = cells if isinstance(cells, np.ndarray) else None
    if array is not None and array.dtype.kind in "Mm":
        return array.astype(f"{array.dtype.kind}8[ns]")
    if len(cells) == 0 or np.isfinite(numbers).any():
        return None
    first = cells[0]
    try:
        if isinstance(first, datetime.timedelta):
            return np.array(cells, dtype="timedelta64[ns]")
        if isinstance(first, datetime.datetime):
            return np.array([_naive(c) for c in cells], dtype="datetime64[ns]")
        if isinstance(first, str):
            return _texts(cells)
    except (ValueError, TypeError, OverflowError):
        return None
    return None


def _texts(cells: Any) -> np.ndarray:
    try:
        return np.array([_iso(c) for c in cells], dtype="datetime64[ns]")
    except ValueError:
        return _clock(cells)


def _clock(cells: Any) -> np.ndarray:
    """Texts of a time of day as durations. Dates before it count where they differ and begin with
    the year, or have dots after the day; which of two numbers between slashes is the day cannot be
    known.
    """
    days: list[str] = []
    clock: list[int] = []
    for cell in cells:
        match = CLOCK.fullmatch(cell.strip())
        if match is None:
            raise ValueError("not a time of day")
        day, hours, minutes, seconds = match[1], match[2], match[3], match[4]
        days.append(day or "")
        of_day = 3600 * int(hours) + 60 * int(minutes) + float(seconds.replace(",", "."))
        clock.append(round(1e9 * of_day))
    times = np.array(clock, "timedelta64[ns]")
    if len(set(days)) < 2:
        return times
    dates = np.array([_day(day) for day in days])
    return times + (dates - dates[0]).astype("timedelta64[D]").astype("timedelta64[ns]")


def _day(text: str) -> np.datetime64:
    parts = re.split(r"[./-]", text)
    if len(parts[0]) != 4 and "." not in text:
        raise ValueError("day and month cannot be told apart")
    year, month, day = parts if len(parts[0]) == 4 else parts[::-1]
    return np.datetime64(f"{int(year):04d}-{int(month):02d}-{int(day):02d}")


def _naive(moment: datetime.datetime) -> datetime.datetime:
    return moment.astimezone(datetime.UTC).replace(tzinfo=None) if moment.tzinfo else moment


def _iso(text: str) -> np.datetime64:
    """An ISO 8601 text to the nanosecond (`datetime` keeps microseconds, and alone knows zones)."""
    text = text.strip().replace(",", ".")
    moment = datetime.datetime.fromisoformat(text)
    found = re.search(r"\.(\d{1,9})", text)
    digits = found[1] if found else ""
    whole = np.datetime64(_naive(moment).replace(microsecond=0), "s").astype("datetime64[ns]")
    return whole + np.timedelta64(int(digits.ljust(9, "0")) if digits else 0, "ns")


def _integers(cells: Any) -> np.ndarray | None:
    """The cells as exact integers: float64 holds nanoseconds since 1970 to 256 ns only."""
    try:
        if isinstance(cells, np.ndarray):
            return cells.astype(np.int64) if cells.dtype.kind in "iu" else None
        return np.array([int(c) for c in cells], dtype=np.int64)
    except (ValueError, TypeError, OverflowError):
        return None


def _first(dates: np.ndarray) -> np.datetime64:
    good = dates[~np.isnat(dates)]
    return good[0] if len(good) else np.datetime64(0, "ns")


def _from(dates: np.ndarray, start: Any) -> np.ndarray:
    return np.where(np.isnat(dates), np.nan, (dates - start).astype(np.int64) * 1e-9)


def _when(start: Any) -> str:
    return str(np.datetime64(start, "ms")).replace("T", " ") + " UTC"
