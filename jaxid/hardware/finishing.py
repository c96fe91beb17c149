"""From the rows of a recording to a dataset folder: clocks, gaps, channels. Nothing is smoothed
over, and nothing is lost.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.errors import UsageError
from jaxid.hardware.channels import channel_map
from jaxid.hardware.clock import ClockMap, from_arrivals, from_signals, within_tick
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
        raise UsageError(f"{folder} is no recording that could be finished ({error})") from error
    events = read_events(folder)
    closed = next((e for e in reversed(events) if e["kind"] == "end"), None)
    if end_reason is None:
        unknown = "the recording process ended without closing the recording"
        end_reason = unknown if closed is None else str(closed["text"])
    complete = closed is not None and bool(closed.get("complete"))
    streams = [Stream.from_dict(s) for s in about["streams"]]
    main = streams[0]
    rows = read_rows(folder, main)
    notes: list[str] = [str(e["text"]) for e in events if e["kind"] == "note"]
    if rows.damaged:
        notes.append(f"{rows.damaged} damaged rows of {main.name} were left out")
    if len(rows.device) == 0:
        raise UsageError(f"{folder} holds no row of {main.name}: {end_reason}")
    timed = _timed(main, rows)
    notes += timed.notes
    table: dict[str, np.ndarray] = {
        "t": timed.t,
        "t_host": rows.host[timed.keep] - timed.host(np.array([timed.zero]))[0],
    }
    table |= {c.name: rows.values[timed.keep, k] for k, c in enumerate(main.columns)}
    columns, clocks = (
        [_blurred(c, table, timed) for c in main.columns],
        {main.name: timed.host.text},
    )
    out, number = folder.parent, folder.name.removeprefix("run_").removesuffix(SUFFIX)
    extra: dict[str, dict[str, np.ndarray]] = {}
    inside = np.ones(len(timed.t), bool)
    for stream in streams[1:]:
        other = read_rows(folder, stream)
        if stream.clock == COMMANDS:
            extra[stream.name] = _told(table, stream, other, timed)
            clocks[stream.name] = (
                "sent by the host, and as late as a question; in the table, means from each row to"
                " the next"
            )
            continue
        if len(other.device) < 4:
            notes.append(f"sensor {stream.name} gave {len(other.device)} rows; it is left out")
            continue
        host = (
            from_arrivals(other.device, other.host)
            if stream.clock != "arrival at the host"
            else None
        )
        to_main = timed.host.inverted() if host is None else timed.host.inverted().after(host)
        at = to_main(other.device) - timed.zero
        extra[stream.name] = {"t": at} | {
            c.name: other.values[:, k] for k, c in enumerate(stream.columns)
        }
        clocks[stream.name] = (
            f"against {main.name}: {'arrival time' if host is None else to_main.text}"
        )
        inside &= _onto(table, stream, extra[stream.name], notes)
        columns += stream.columns
    for description in about.get("sensor_files", []):
        spec = SensorSpec.model_validate(description)
        stream = spec.stream()
        try:
            found, clock = _matched(spec, table, timed)
        except (ValueError, UsageError) as error:
            notes.append(f"sensor file {spec.file} is left out: {error}")
            continue
        extra[spec.name], clocks[spec.name] = found, f"against {main.name}: {clock.text}"
        inside &= _onto(table, stream, found, notes)
        columns += stream.columns
    if not inside.all():
        notes.append(f"{int(np.sum(~inside))} rows without every sensor were left out of the table")
        table = {k: v[inside] for k, v in table.items()}
    window = _window(events, timed, table)
    entry = _experiment(f"run_{number}.parquet", about, table, window, timed)
    report = {
        "schema": 1,
        "kind": "recording",
        "complete": complete,
        "end_reason": end_reason,
        "rows": len(table["t"]),
        "rate_nominal_hz": None if main.period is None else 1 / main.period,
        "rate_measured_hz": timed.rate,
        "lost": timed.lost,
        "duplicated": timed.duplicated,
        "gaps": timed.gaps,
        "clocks": clocks,
        "channels": {
            c.name: {"raw_unit": c.raw_unit, "scale": c.scale} for c in columns if c.raw_unit
        },
        "events": [
            {**e, "t": float(timed.host.inverse(np.array([e["host"]]))[0] - timed.zero)}
            for e in events
        ],
        "notes": notes,
        "raw_sha256": {s.name: _sha256(folder / f"{s.name}.rows") for s in streams},
        **{k: v for k, v in about.items() if k not in ("streams", "sensor_files")},
        "devices": {s.name: {"clock": s.clock, **s.info} for s in streams},
    }
    _write(
        out=out,
        number=number,
        table=table,
        extra=extra,
        columns=columns,
        entry=entry,
        about=about,
        report=report,
    )
    shutil.rmtree(folder)
    return Recording(
        folder=out,
        file=entry["file"],
        rows=len(table["t"]),
        seconds=float(table["t"][-1] - table["t"][0]),
        rate=timed.rate,
        lost=timed.lost,
        duplicated=timed.duplicated,
        gaps=tuple(timed.gaps),
        complete=complete,
        end_reason=end_reason,
        notes=tuple(notes),
    )


@dataclass(frozen=True)
class _Timed:
    """The main stream's own time: `keep` which rows, `t` from 0, `zero` device time of t = 0,
    `host` the host against it.
    """

    keep: np.ndarray
    t: np.ndarray
    zero: float
    host: ClockMap
    rate: float
    lost: int
    duplicated: int
    gaps: list[tuple[float, float, int]]
    notes: list[str]
    blur: float  # standard deviation of each time (s)
    asked: ClockMap  # host time of sending against the device time of arrival


def _timed(stream: Stream, rows: StreamRows) -> _Timed:
    device, notes, blur = rows.device, [], 0.0
    asked: ClockMap | None = None
    if stream.info.get("tick_s"):
        names = [c.name for c in stream.columns]
        sent, answered = (rows.values[:, names.index(n)] for n in ("t_sent", "t_received"))
        rising = _rising(device)
        host: ClockMap | None = None
        fine = device.copy()
        if rising.sum() >= 4:
            fine[rising], host, blur, asked = within_tick(
                device[rising], stream.info["tick_s"], sent[rising], answered[rising]
            )
        device = fine
    else:
        rising = _rising(device)
        host = from_arrivals(device[rising], rows.host[rising]) if rising.sum() >= 4 else None
    keep = np.flatnonzero(rising)
    keep = keep[_rising(device[keep])]
    back = int(np.sum(np.diff(rows.device) < 0))
    if back:
        notes.append(f"the device's clock went backwards {back} times; those rows were left out")
    t = device[keep]
    zero = float(t[0])
    if host is None:
        host = ClockMap(
            float(rows.host[0] - rows.device[0]), 0.0, 0.0, 0.0, "too few samples to compare clocks"
        )
    step = np.diff(t)
    median = float(np.median(step)) if len(step) else 0.0
    period = stream.period or median
    if period and median > 1.5 * period:
        notes.append(
            f"the device sends {1 / median:.1f} samples a second where {1 / period:.1f} were"
            " asked for"
        )
        period = median
    # A device that sends by itself has lost what is not there; one that is asked may have been
    # asked late.
    polled = bool(stream.info.get("tick_s"))
    missing = (
        np.maximum(np.round(step / period).astype(int) - 1, 0)
        if period
        else np.zeros(len(step), int)
    )
    missing[step < 2.5 * period] *= not polled
    gaps = [
        (round(float(t[k] - zero), 6), round(float(t[k + 1] - zero), 6), int(missing[k]))
        for k in np.flatnonzero(missing)
    ]
    rate = (len(t) - 1) / float(t[-1] - t[0]) if len(t) > 1 else 0.0
    if gaps:
        worst = max(gaps, key=lambda g: g[2])
        notes.append(
            f"{len(gaps)} gaps of {missing.sum()} samples together, the longest from {worst[0]:.3f}"
            f" to {worst[1]:.3f} s"
        )
    repeated = len(rows.device) - len(keep) - back
    return _Timed(
        keep=keep,
        t=np.round(t - zero, 9),
        zero=zero,
        host=host,
        rate=rate,
        lost=int(missing.sum()),
        duplicated=max(repeated, 0),
        gaps=gaps,
        notes=notes,
        blur=blur,
        asked=asked or host,
    )


def _blurred(column: Column, table: Mapping[str, np.ndarray], timed: _Timed) -> Column:
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


def _rising(t: np.ndarray) -> np.ndarray:
    """Which samples are later than every one before them."""
    top = np.maximum.accumulate(t)
    return np.concatenate([[True], t[1:] > top[:-1]])


def _told(
    table: dict[str, np.ndarray], stream: Stream, rows: StreamRows, timed: _Timed
) -> dict[str, np.ndarray]:
    """The commands at their own times; the table's become the mean of what was told from each row
    to the next.

    A held mean drives a mechanism like the commands it is the mean of, wherever between two rows
    they came, also where answers were lost.
    """
    at = timed.asked.inverse(rows.host) - timed.zero
    if (
        "t_sent" in table
    ):  # what went out just before a question arrived just before its answer was made, however late both were
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
    order = np.flatnonzero(_rising(at))
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
    spec: SensorSpec, table: Mapping[str, np.ndarray], timed: _Timed
) -> tuple[dict[str, np.ndarray], ClockMap]:
    assert spec.match is not None
    t, values = spec.rows()
    names = list(spec.channels)
    channel = next((n for n, c in spec.channels.items() if c.column == spec.match.column), None)
    if channel is None:
        raise ValueError(f"`match` names the column {spec.match.column!r}, which is no channel")
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


def _window(events, timed: _Timed, table: Mapping[str, np.ndarray]) -> list[float] | None:
    """The part of a played run that is data: from just before the path to just after it."""
    at = {
        e.get("name"): float(timed.host.inverse(np.array([e["at"]]))[0] - timed.zero)
        for e in events
        if e["kind"] == "mark"
    }
    if "play_start" not in at:
        return None
    begin = max(at["play_start"] - 0.05, float(table["t"][0]))
    end = min(at.get("play_end", np.inf) + 0.2, float(table["t"][-1]) + 1e-6)
    return [round(begin, 6), round(float(end), 6)]


def _experiment(
    file: str, about, table: Mapping[str, np.ndarray], window, timed: _Timed
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


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _write(out: Path, number: str, table, extra, columns, entry, about, report) -> None:
    """Each file appears whole or not at all; `dataset.toml` comes last, so that it never names a
    file that is not there.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq
    import tomlkit

    text = json.dumps(report, indent=1)

    def parquet(name: str, content: Mapping[str, np.ndarray]) -> None:
        data = pa.table({k: pa.array(v) for k, v in content.items()})
        partial = out / f"{name}.partial"
        pq.write_table(data.replace_schema_metadata({"jaxid": text}), partial)
        partial.replace(out / name)

    parquet(entry["file"], table)
    for name, content in extra.items():
        parquet(f"run_{number}.{name}.parquet", content)
    _replace(out / f"run_{number}.json", text)
    path = out / "dataset.toml"
    if path.is_file():
        document = tomlkit.parse(path.read_text(encoding="utf-8"))
        array = document["experiments"]
        for c in columns:  # an output that stood still so far, and moves now
            known = document["channels"].get(c.name)
            if (
                about.get("model") is None
                and c.role == "output"
                and known is not None
                and np.ptp(table[c.name]) > 0
            ):
                known["role"] = "output"
        if entry["file"] not in [str(e["file"]) for e in array]:  # pyright: ignore[reportGeneralTypeIssues, reportIndexIssue, reportCallIssue, reportArgumentType]
            array.append(tomlkit.item(entry))  # pyright: ignore[reportAttributeAccessIssue]
        _replace(path, tomlkit.dumps(document))
        return
    content: dict[str, Any] = {
        "name": about["name"],
        "description": about["description"],
        "source": about["source"],
    }
    if about.get("model"):
        content["model"] = {"name": about["model"]} | (
            {"constants": about["model_constants"]} if about.get("model_constants") else {}
        )
    content["channels"] = channel_map(
        about.get("model"), columns, about.get("joint"), about.get("gain")
    )
    for name, channel in content["channels"].items():
        # An output that never moves would make the whole dataset unreadable, and a robot is rarely
        # moved in all joints.
        if about.get("model") is None and channel["role"] == "output" and np.ptp(table[name]) == 0:
            channel["role"] = "auxiliary"
    content["experiments"] = [entry]
    _replace(path, tomlkit.dumps(content))


def _replace(path: Path, text: str) -> None:
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
