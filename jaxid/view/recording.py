"""A recording while it is made: what came so far, what it says about itself, and which numbers it
tells by now.

The rows on disk are copied and finished as those of a process that died would be, so that all that
is told rests on the dataset that the recording will be. Numbers come from the torque of the motion
so far (`inverse_dynamics`), which needs no simulation.
"""

from __future__ import annotations

import shutil
import tempfile
import threading
import time
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import jaxid
from jaxid.base.errors import DatasetError, UsageError
from jaxid.base.wording import listed, one_line, value_with_std
from jaxid.conventions.runs import refused
from jaxid.data.dataset import Dataset
from jaxid.hardware.finishing import finish
from jaxid.hardware.recorder import COMMANDS, read_about, read_rows, Stream, SUFFIX
from jaxid.view.plots import lines_over_time
from jaxid.view.server import bokeh_files, FILES, page, Site


#: A number is known when its standard deviation is at most this share of it, or of the largest
#: number of its unit where that is more: an offset of nothing is known beside a large torque.
KNOWN = 0.1
#: Samples of a channel that are drawn, and seconds between two looks at what was recorded.
DRAWN, LOOK_S = 1500, 4.0
#: What takes long to find: the last of it stands until there is newer.
LOOKED_FOR = ("numbers", "share", "enough", "findings")
#: Seconds before which nothing is concluded.
FIRST_S = 3.0


class Watcher:
    """The run in the folder of a recording that is being written, or the last one that was."""

    def __init__(self, folder: Path, model: str | None = None, known: float = KNOWN):
        self.folder, self.model, self.known = folder, model, known
        self._found: dict[str, Any] = {}
        self._ended: Dataset | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._look_on, name="jaxid-watch", daemon=True)

    def begin(self) -> None:
        """Starts to look at what is recorded, beside the page."""
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()

    def rows(self) -> dict[str, tuple[np.ndarray, np.ndarray, str]]:
        """Channel -> time (s), values [samples], unit: of the run that is being written, or of the
        last one of a recording that has ended.
        """
        place = self._written()
        if place is None:
            return {} if self._ended is None else last_run(self._ended)
        found = {}
        began = None
        for content in read_about(place)["streams"]:
            stream = Stream.from_dict(content)
            rows = read_rows(place, stream)
            if not len(rows.host):
                continue
            began = rows.host[0] if began is None else began
            step = max(1, -(-len(rows.host) // DRAWN))
            for k, column in enumerate(stream.columns):
                sent = " (sent)" if stream.clock == COMMANDS else ""
                if column.role != "clock":
                    values = rows.values[::step, k]
                    found[f"{column.name}{sent}"] = rows.host[::step] - began, values, column.unit
        return found

    def told(self) -> dict[str, Any]:
        """What the last look found."""
        return self._found or self._nothing()

    def _nothing(self) -> dict[str, Any]:
        return {"state": f"waiting for a recording in {one_line(self.folder)}"}

    def look(self) -> dict[str, Any]:
        """Looks once at all that is there."""
        if not self.folder.is_dir() or not any(self.folder.iterdir()):
            return self._nothing()
        recording = self._written() is not None
        try:
            data = self._dataset()
        except (DatasetError, UsageError, OSError) as error:
            return {"state": _state(recording), "waiting": _waiting(error, recording)}
        self._ended = None if recording else data
        seconds = float(data.experiments[-1].t[-1] - data.experiments[-1].t[0])
        answer: dict[str, Any] = {
            "state": _state(recording),
            "seconds": seconds,
            "excitation": excitation(data),
        }
        if seconds < FIRST_S:
            return answer | {"waiting": f"nothing is concluded from less than {FIRST_S:g} s"}
        if data.model is None and self.model is None:
            checked = jaxid.check(None, data)
            answer["findings"] = [f.text for f in checked.findings]
            return answer | {"waiting": "name a model with --model to see which numbers are known"}
        known = {name: self._found[name] for name in LOOKED_FOR if name in self._found}
        self._found = {"waiting": "numbers are looked for"} | known | answer
        try:
            fit = jaxid.fit(self.model, data, residual="inverse_dynamics")
        except (DatasetError, UsageError) as error:
            return answer | {"waiting": one_line(error)}
        answer["findings"] = [f.text for f in fit.data]
        if fit.failed:
            return answer | {"waiting": f"no fit yet: {fit.stopped_because}"}
        rows = numbers(fit, self.known)
        enough = all(row["known"] for row in rows) and bool(rows)
        return answer | {"numbers": rows, "share": self.known, "enough": enough}

    def _written(self) -> Path | None:
        """The newest folder of a recording that goes on."""
        going = sorted(self.folder.glob(f"run_*{SUFFIX}"), key=lambda p: p.stat().st_mtime)
        return going[-1] if going else None

    def _dataset(self) -> Dataset:
        place = self._written()
        if place is None:
            return jaxid.load_dataset(self.folder)
        with tempfile.TemporaryDirectory() as scratch, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            copy = Path(scratch) / place.name
            shutil.copytree(place, copy)
            finish(copy)
            return jaxid.load_dataset(scratch)

    def _look_on(self) -> None:
        while not self._stop.is_set():
            began = time.monotonic()
            try:
                self._found = self.look()
            except Exception as error:  # what is half written may be anything: look again
                self._found = {"state": "looking", "waiting": one_line(error)}
            self._stop.wait(max(LOOK_S - (time.monotonic() - began), 0.5))


def _state(recording: bool) -> str:
    return "recording" if recording else "the recording has ended"


def _waiting(error: Exception, recording: bool) -> str:
    """What a recording that cannot be read yet waits for: where it goes on, motion may still
    come.
    """
    found = refused(error) if recording and isinstance(error, DatasetError) else []
    if any(f.kind != "does_not_move" for f in found) or not found:
        return one_line(error)
    still = listed(list(dict.fromkeys(one_line(f.channel) for f in found)))
    return f"{still} did not move so far: numbers are known from motion alone"


def last_run(data: Dataset) -> dict[str, tuple[np.ndarray, np.ndarray, str]]:
    """Channel -> time (s), values [samples], unit: of the last run, in at most `DRAWN` samples."""
    run = data.experiments[-1]
    step = max(1, -(-len(run) // DRAWN))
    t = run.t[::step] - run.t[0]
    found = {}
    for channels, columns in ((data.inputs, run.u), (data.outputs, run.y)):
        for channel, values in zip(channels, columns.T, strict=True):
            found[channel.name] = t, values[::step], channel.unit
    return found


def excitation(data: Dataset) -> list[dict[str, Any]]:
    """Of every channel that moved in the last run: its range, and how often it turned round, which
    tells friction from slopes.
    """
    run = data.experiments[-1]
    rows = []
    for channel, values in zip(data.outputs, run.y.T, strict=True):
        finite = values[np.isfinite(values)]
        if not finite.size:
            continue
        rows.append(
            {
                "channel": channel.name,
                "unit": channel.unit,
                "range": float(np.ptp(finite)),
                "turns": turns(finite),
            }
        )
    return rows


def turns(values: np.ndarray) -> int:
    """How often a signal turns round by more than a twentieth of its range."""
    least = 0.05 * np.ptp(values)
    if least == 0:
        return 0
    count, up, extreme = 0, None, values[0]
    for value in values[:: max(1, len(values) // 5000)]:
        if up is None:
            up = bool(value > extreme) if abs(value - extreme) > least else None
        elif (value - extreme) * (1 if up else -1) > 0:
            extreme = value
        elif abs(value - extreme) > least:
            count, up, extreme = count + 1, not up, value
    return count


def numbers(fit: Any, share: float) -> list[dict[str, Any]]:
    """Each fitted number, and whether it is known by now."""
    largest: dict[str, float] = {}
    for p in fit.parameters.values():
        largest[p.unit] = max(largest.get(p.unit, 0.0), abs(p.value))
    rows = []
    for name, p in fit.parameters.items():
        told = p.std is not None and p.identifiable
        known = told and p.std <= share * max(abs(p.value), largest[p.unit])
        text = value_with_std(p) if told else "not determined yet"
        rows.append({"name": name, "text": text, "known": bool(known)})
    return rows


def watch_site(watcher: Watcher) -> Site:
    """The site that shows a recording while it is made. Raises `UsageError` without Bokeh."""

    def channels(_: Mapping[str, str]) -> Any:
        return {name: {"t": t, "y": y} for name, (t, y, _) in watcher.rows().items()}

    def plots(_: Mapping[str, str]) -> Any:
        rows = watcher.rows()
        if not rows:
            return {"item": None}
        t = next(iter(rows.values()))[0]
        drawn = {name: (y, unit) for name, (own, y, unit) in rows.items() if len(own) == len(t)}
        return {"item": lines_over_time(t, drawn)}

    def told(_: Mapping[str, str]) -> Any:
        return watcher.told()

    files = {**bokeh_files(), "watch.js": FILES / "watch.js", "view.css": FILES / "view.css"}
    answers = {"plots": plots, "channels": channels, "told": told}
    return Site(page("Recording", "watch.js"), files, answers)
