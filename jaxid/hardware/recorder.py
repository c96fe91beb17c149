"""Append-only recording: rows go to disk as they come, so that a crash costs at most the last
fraction of a second.

A recording in progress is a folder `run_N.recording` with `about.json` (what the rows mean), one
`STREAM.rows` per device (fixed-size rows, each with its own checksum) and `events.jsonl`.
`jaxid.hardware.dataset.finish` makes a dataset of it.
"""

from __future__ import annotations

import json
import os
import struct
import threading
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


ABOUT, EVENTS, SUFFIX = "about.json", "events.jsonl", ".recording"
FORMAT_VERSION = 1
#: Clock of a stream of commands: the host's time when each was sent; they hold until the next.
COMMANDS = "sent by the host"
_HEAD = struct.Struct("<II")  # checksum of what follows, number of the row


@dataclass(frozen=True)
class Column:
    """One recorded signal: its name by the dataset's convention, role and SI unit, and how the
    device counts it.
    """

    name: str
    unit: str
    role: str = (
        "auxiliary"  # "input" | "output" | "auxiliary" | "clock": recorded for the clocks only
    )
    resolution: float | None = None
    noise_std: float | None = None
    hold: str = "zero"
    raw_unit: str = ""
    scale: float | None = None  # SI value of one raw count


@dataclass(frozen=True)
class Stream:
    """Rows of one device with one clock. `clock` says what the device's time is; `period` s is the
    expected step.
    """

    name: str
    columns: tuple[Column, ...]
    clock: str
    period: float | None = None
    info: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Stream:
        return cls(**{**content, "columns": tuple(Column(**c) for c in content["columns"])})


class Recorder:
    """Writes the rows of several streams; a thread brings them to disk every `flush_s`.

    A row is host time (s, monotonic), device time (s), then the stream's columns. Use it as a
    context; `event` notes what happened. Raises `OSError` where the folder cannot be written.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        streams: Sequence[Stream],
        about: Mapping[str, Any],
        flush_s: float = 0.5,
    ):
        self.folder, self.streams = Path(folder), tuple(streams)
        self.folder.mkdir(parents=True)
        content = {
            "format_version": FORMAT_VERSION,
            "streams": [asdict(s) for s in self.streams],
            **about,
        }
        content["started_monotonic"] = time.monotonic()
        _write_synced(self.folder / ABOUT, json.dumps(content, indent=1).encode())
        self._files = [
            open(self.folder / f"{s.name}.rows", "ab", buffering=0) for s in self.streams
        ]
        self._rows = [struct.Struct(f"<{2 + len(s.columns)}d") for s in self.streams]
        self._events = open(self.folder / EVENTS, "ab", buffering=0)
        self._pending = [bytearray() for _ in self.streams]
        self.counts = [0] * len(self.streams)
        self._lock, self._done = threading.Lock(), threading.Event()
        self.fault: OSError | None = None
        self._flush_s = flush_s
        self._thread = threading.Thread(target=self._run, name="jaxid-recorder", daemon=True)
        self._thread.start()

    def append(self, stream: int, host: float, device: float, values: Sequence[float]) -> None:
        """One row; raises the `OSError` that a write met (a full disk), so that nobody records into
        nothing.
        """
        if self.fault is not None:
            raise self.fault
        payload = self._rows[stream].pack(host, device, *values)
        number = struct.pack("<I", self.counts[stream] & 0xFFFFFFFF)
        with self._lock:
            self._pending[stream] += (
                struct.pack("<I", zlib.crc32(number + payload)) + number + payload
            )
        self.counts[stream] += 1

    def event(self, kind: str, text: str = "", **more: Any) -> None:
        """Something that happened, now; on disk at once."""
        line = {"host": time.monotonic(), "kind": kind, "text": text, **more}
        os.write(self._events.fileno(), json.dumps(line).encode() + b"\n")

    def close(self) -> None:
        """Brings everything to disk; safe to call twice."""
        if self._done.is_set():
            return
        self._done.set()
        self._thread.join()
        self._write(sync=True)
        for f in (*self._files, self._events):
            f.close()
        if self.fault is not None:
            raise self.fault

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def _run(self) -> None:
        while not self._done.wait(self._flush_s):
            self._write(sync=True)

    def _write(self, sync: bool) -> None:
        try:
            for i, file in enumerate(self._files):
                with self._lock:
                    block, self._pending[i] = self._pending[i], bytearray()
                view = memoryview(block)
                while view:
                    view = view[file.write(view) :]
                if block and sync:
                    os.fsync(file.fileno())
        except OSError as error:
            self.fault = error


def _write_synced(path: Path, content: bytes) -> None:
    partial = path.with_name(path.name + ".partial")
    with open(partial, "wb") as f:
        f.write(content)
        f.flush()
        os.fsync(f.fileno())
    partial.replace(path)


@dataclass(frozen=True)
class StreamRows:
    """What of a stream is on disk: `host [rows]`, `device [rows]`, `values [rows columns]`;
    `damaged` rows were left out.
    """

    host: np.ndarray
    device: np.ndarray
    values: np.ndarray
    damaged: int


def read_rows(folder: Path, stream: Stream) -> StreamRows:
    """The rows of a recording, each checked; a torn row at the end does not count as damaged."""
    width = 2 + len(stream.columns)
    path = folder / f"{stream.name}.rows"
    content = path.read_bytes() if path.is_file() else b""
    size = _HEAD.size + 8 * width
    kept, damaged = [], 0
    for start in range(0, len(content) - size + 1, size):
        row = content[start : start + size]
        if _HEAD.unpack_from(row)[0] == zlib.crc32(row[4:]):
            kept.append(row[_HEAD.size :])
        else:
            damaged += 1
    table = np.frombuffer(b"".join(kept), "<f8").reshape(-1, width)
    return StreamRows(table[:, 0], table[:, 1], table[:, 2:], damaged)


def read_about(folder: Path) -> dict[str, Any]:
    return json.loads((folder / ABOUT).read_text(encoding="utf-8"))


def read_events(folder: Path) -> list[dict[str, Any]]:
    """The events of a recording; a torn last line is left out."""
    path = folder / EVENTS
    events = []
    for line in path.read_bytes().splitlines() if path.is_file() else []:
        try:
            events.append(json.loads(line))
        except ValueError:
            continue
    return events
