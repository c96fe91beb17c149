"""From the rows of a recording to a dataset folder: clocks, gaps, channels. Nothing is smoothed
over, and nothing is lost.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.hardware.clock import ClockMap, from_arrivals, from_signals
from jaxid.hardware.recorder import (
    Column,
    COMMANDS,
    read_about,
    read_events,
    read_rows,
    Stream,
    StreamRows,
    SUFFIX,
)
from jaxid.hardware.row_times import is_rising, row_times, RowTimes
from jaxid.hardware.run_files import write_run
from jaxid.hardware.sensor import SensorSpec


@dataclass(frozen=True)
class Recording:
    """What was recorded: `complete` is False where it ended before its time, `end_reason` says why.
    `lost` and `duplicated` count samples of the main device; `gaps` (t0, t1, samples missing);
    `notes` are sentences for a person. Of a dry run nothing is there but its length and what it
    found, in `end_reason`.
    """

    folder: Path
    file: str
    rows: int
    seconds: float
    rate: float
    lost: int
    duplicated: int
    gaps: tuple[tuple[float, float, int], ...]
    complete: bool
    end_reason: str
    notes: tuple[str, ...]
    dry_run: bool = False

    @property
    def text(self) -> str:
        """What a person wants to read of it."""
        if self.dry_run:
            return self.end_reason
        pace = f"{self.rows} rows in {self.seconds:.2f} s ({self.rate:.1f} a second)"
        lines = [
            f"{pace}, {self.lost} lost, {self.duplicated} duplicated: {self.folder / self.file}",
            f"complete: {self.end_reason}" if self.complete else f"NOT complete: {self.end_reason}",
        ]
        return "\n".join([*lines, *(f"- {n}" for n in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        return {
            "schema": 1,
            "kind": "dry_run" if self.dry_run else "recording",
            **self.__dict__,
            "folder": str(self.folder),
        }


def finish(folder: str | os.PathLike[str], end_reason: str | None = None) -> Recording:
    """Makes a run of the dataset beside it from a recording folder `run_N.recording`, then removes
    it.

    `end_reason` None is for a recording whose process died: what is known of its end is taken from
    its events. Raises `UsageError` where there is nothing to finish.
    """
    folder = Path(folder)
    try:
        about = read_about(folder)
    except (OSError, ValueError) as error:
        raise UsageError(f"{folder} is not a recording that could be finished ({error})") from error
    events = read_events(folder)
    unknown = {"text": "the recording process ended without closing the recording"}
    closed = next((e for e in reversed(events) if e["kind"] == "end"), unknown)
    if end_reason is None:
        end_reason = str(closed["text"])
    complete = bool(closed.get("complete"))
    streams = [Stream.from_dict(s) for s in about["streams"]]
    main = streams[0]
    rows = read_rows(folder, main)
    if len(rows.device) == 0:
        raise UsageError(f"{folder} holds no row of {main.name}: {end_reason}")
    timed = row_times(main, rows)
    run = _of_main(main, rows, timed)
    run.notes = [str(e["text"]) for e in events if e["kind"] == "note"] + run.notes
    for stream in streams[1:]:
        _add_stream(run, stream, read_rows(folder, stream), timed, main.name)
    for description in about.get("sensor_files", []):
        _add_file(run, SensorSpec.model_validate(description), timed, main.name)
    if not run.inside.all():
        left = int(np.sum(~run.inside))
        run.notes.append(f"{left} rows without every sensor were left out of the table")
        run.table = {k: v[run.inside] for k, v in run.table.items()}
    out, number = folder.parent, folder.name.removeprefix("run_").removesuffix(SUFFIX)
    t = run.table["t"]
    window = _window(events, timed, run.table)
    entry = _experiment(f"run_{number}.parquet", about, run.table, window, timed)
    report = {
        "schema": 1,
        "kind": "recording",
        "complete": complete,
        "end_reason": end_reason,
        "rows": len(t),
        "rate_nominal_hz": None if main.period is None else 1 / main.period,
        "rate_measured_hz": timed.rate,
        "lost": timed.lost,
        "duplicated": timed.duplicated,
        "gaps": timed.gaps,
        "clocks": run.clocks,
        "channels": _raw_units(run.columns),
        "events": [{**e, "t": timed.since_start(e["host"])} for e in events],
        "notes": run.notes,
        "raw_sha256": {s.name: _sha256(folder / f"{s.name}.rows") for s in streams},
        **{k: v for k, v in about.items() if k not in ("streams", "sensor_files")},
        "devices": {s.name: {"clock": s.clock, **s.info} for s in streams},
    }
    _keep_robot(folder, about)
    write_run(
        out=out,
        number=number,
        table=run.table,
        extra=run.extra,
        columns=run.columns,
        entry=entry,
        about=about,
        report=report,
    )
    shutil.rmtree(folder)
    return Recording(
        folder=out,
        file=entry["file"],
        rows=len(t),
        seconds=float(t[-1] - t[0]),
        rate=timed.rate,
        lost=timed.lost,
        duplicated=timed.duplicated,
        gaps=tuple(timed.gaps),
        complete=complete,
        end_reason=end_reason,
        notes=tuple(run.notes),
    )


def _keep_robot(folder: Path, about: Mapping[str, Any]) -> None:
    """The file of the robot that the recording is meant for, from the recording's folder into that
    of the dataset.
    """
    if about.get("robot"):
        shutil.copyfile(folder / about["robot"], folder.parent / about["robot"])


@dataclass
class _Run:
    """What becomes of a recording: `table` at the times of the main device, `extra` with the own
    rows of other streams, and `inside`, which rows of the table every sensor has.
    """

    table: dict[str, np.ndarray]
    extra: dict[str, dict[str, np.ndarray]]
    columns: list[Column]
    clocks: dict[str, str]
    notes: list[str]
    inside: np.ndarray

    def add_sensor(self, stream: Stream, rows: dict[str, np.ndarray], clock: str) -> None:
        """A sensor's own rows, whose `t` are main times, and its channels in the table."""
        self.extra[stream.name] = rows
        self.clocks[stream.name] = clock
        self.inside &= _onto(self.table, stream, rows, self.notes)
        self.columns += stream.columns


def _of_main(main: Stream, rows: StreamRows, timed: RowTimes) -> _Run:
    """The rows of the main device."""
    notes = []
    if rows.damaged:
        notes.append(f"{rows.damaged} damaged rows of {main.name} were left out")
    table: dict[str, np.ndarray] = {
        "t": timed.t,
        "t_host": rows.host[timed.keep] - timed.host(np.array([timed.zero]))[0],
    }
    table |= {c.name: rows.values[timed.keep, k] for k, c in enumerate(main.columns)}
    return _Run(
        table=table,
        extra={},
        columns=[_blurred(c, table, timed) for c in main.columns],
        clocks={main.name: timed.host.text},
        notes=notes + timed.notes,
        inside=np.ones(len(timed.t), bool),
    )


def _add_stream(run: _Run, stream: Stream, rows: StreamRows, timed: RowTimes, main: str) -> None:
    """The rows of a sensor, or the commands, brought to the main times."""
    if stream.clock == COMMANDS:
        run.extra[stream.name] = _told(run.table, stream, rows, timed)
        run.clocks[stream.name] = (
            "sent by the host, and as late as a question; in the table, means from each row to"
            " the next"
        )
        return
    if len(rows.device) < 4:
        run.notes.append(f"sensor {stream.name} gave {len(rows.device)} rows; it is left out")
        return
    to_main, clock = timed.host.inverted(), "arrival time"
    if stream.clock != "arrival at the host":
        to_main = to_main.after(from_arrivals(rows.device, rows.host))
        clock = to_main.text
    own = {c.name: rows.values[:, k] for k, c in enumerate(stream.columns)}
    at = to_main(rows.device) - timed.zero
    run.add_sensor(stream, {"t": at} | own, f"against {main}: {clock}")


def _add_file(run: _Run, spec: SensorSpec, timed: RowTimes, main: str) -> None:
    """The rows of a file that a sensor wrote, matched with the table by a signal of both."""
    stream = spec.stream()
    try:
        rows, clock = _matched(spec, run.table, timed)
    except (ValueError, UsageError) as error:
        run.notes.append(f"sensor file {spec.file} is left out: {error}")
        return
    run.add_sensor(stream, rows, f"against {main}: {clock.text}")


def _blurred(column: Column, table: Mapping[str, np.ndarray], timed: RowTimes) -> Column:
    """An angle's noise: of its resolution and of what it turns while its time is in doubt, or what
    the samples show if more.
    """
    from jaxid.data.noise import sensor_noise

    rate = table.get("qd" + column.name[1:]) if column.name.rstrip("0123456789") == "q" else None
    if rate is None or column.noise_std is not None or timed.blur == 0:
        return column
    turned = float(np.sqrt(np.mean((timed.blur * rate) ** 2)))
    known = float(np.hypot((column.resolution or 0.0) / np.sqrt(12), turned))
    return replace(column, noise_std=float(f"{max(known, sensor_noise([table[column.name]])):.3g}"))


def _told(
    table: dict[str, np.ndarray], stream: Stream, rows: StreamRows, timed: RowTimes
) -> dict[str, np.ndarray]:
    """The commands at their own times; the table's become the mean of what was told from each row
    to the next.

    A held mean drives a mechanism like the commands it is the mean of, wherever between two rows
    they came, also where answers were lost.
    """
    at = timed.asked.inverse(rows.host) - timed.zero
    # What went out just before a question arrived just before its answer was made, however late
    # both were.
    if "t_sent" in table:
        k = np.minimum(np.searchsorted(table["t_sent"], rows.host), len(table["t"]) - 1)
        ahead = table["t_sent"][k] - rows.host
        at = np.where((ahead >= 0) & (ahead < 5e-3), table["t"][k] - ahead, at)
        at = np.maximum.accumulate(at)
    out = {"t": at} | {c.name: rows.values[:, k] for k, c in enumerate(stream.columns)}
    t = table["t"]
    for c in stream.columns if len(at) and len(t) > 1 else ():
        edges = np.concatenate([[min(t[0], at[0]) - 1.0], at, [max(t[-1], at[-1]) + 1.0]])
        held = np.concatenate([[table[c.name][0]], out[c.name]])
        total = np.concatenate([[0.0], np.cumsum(held * np.diff(edges))])
        mean = np.diff(np.interp(t, edges, total)) / np.diff(t)
        last = held[np.searchsorted(at, t[-1], side="right")]
        table[c.name] = np.append(mean, last)
    return out


def _onto(
    table: dict[str, np.ndarray], stream: Stream, rows: dict[str, np.ndarray], notes: list[str]
) -> np.ndarray:
    """Adds a sensor's channels at the main times by linear interpolation; returns where it has
    data.
    """
    t, at = table["t"], rows["t"]
    order = np.flatnonzero(is_rising(at))
    at = at[order]
    step = float(np.median(np.diff(at)))
    k = np.clip(np.searchsorted(at, t), 1, len(at) - 1)
    inside = (t >= at[0]) & (t <= at[-1]) & (at[k] - at[k - 1] <= 5 * step)
    for c in stream.columns:
        table[c.name] = np.interp(t, at, rows[c.name][order])
    notes.append(
        f"sensor {stream.name}: {1 / step:.1f} samples a second, interpolated linearly at the main"
        " times; its own samples are kept in a file beside"
    )
    return inside


def _matched(
    spec: SensorSpec, table: Mapping[str, np.ndarray], timed: RowTimes
) -> tuple[dict[str, np.ndarray], ClockMap]:
    assert spec.match is not None
    t, values = spec.rows()
    names = list(spec.channels)
    channel = next((n for n, c in spec.channels.items() if c.column == spec.match.column), None)
    if channel is None:
        raise ValueError(f"`match` names the column {spec.match.column!r}, which is not a channel")
    if spec.match.to not in table:
        raise ValueError(f"`match` names the channel {spec.match.to!r}, which was not recorded")
    clock = from_signals(
        table["t"],
        table[spec.match.to],
        t,
        values[:, names.index(channel)],
        search_s=spec.match.search_s,
        derivative=spec.match.derivative,
    )
    return {"t": clock(t)} | {n: values[:, k] for k, n in enumerate(names)}, clock


def _window(events, timed: RowTimes, table: Mapping[str, np.ndarray]) -> list[float] | None:
    """The part of a played run that is data: from just before the path to just after it."""
    at = {e.get("name"): timed.since_start(e["at"]) for e in events if e["kind"] == "mark"}
    if "play_start" not in at:
        return None
    begin = max(at["play_start"] - 0.05, float(table["t"][0]))
    end = min(at.get("play_end", np.inf) + 0.2, float(table["t"][-1]) + 1e-6)
    return [round(begin, 6), round(float(end), 6)]


def _experiment(
    file: str, about, table: Mapping[str, np.ndarray], window, timed: RowTimes
) -> dict[str, Any]:
    entry: dict[str, Any] = {"file": file, "split": about.get("split", "fit")}
    step = float(np.median(np.diff(table["t"]))) if len(table["t"]) > 1 else 0.0
    if step and np.diff(table["t"]).max() > 20 * step:
        entry["split_at_gaps"] = True
    if window is not None:
        entry["window_s"] = window
        first = (table["t"] >= window[0]) & (table["t"] < window[0] + 0.1)
        angles = [v[first] for k, v in table.items() if k.rstrip("0123456789") == "q"]
        still = about.get("still_rad", 1e-4)
        if first.sum() > 2 and angles and all(np.ptp(a) <= still for a in angles):
            entry["at_rest"] = True
    if about.get("constants"):
        entry["constants"] = about["constants"]
    return entry


def _raw_units(columns: list[Column]) -> dict[str, Any]:
    """What the values of channels were before they were converted."""
    return {c.name: {"raw_unit": c.raw_unit, "scale": c.scale} for c in columns if c.raw_unit}


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
