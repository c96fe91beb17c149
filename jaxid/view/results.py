"""Results in their folders, run again on their recording with effects switched on or off."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import jaxid
from jaxid.base.errors import UsageError
from jaxid.base.serialise import with_effects
from jaxid.base.wording import one_line
from jaxid.data.dataset import Dataset


#: Files that tell the numbers of a model.
KINDS = ("diagnosis.json", "fit.json")
#: Samples of a run that are drawn.
DRAWN = 4000


@dataclass(frozen=True)
class SavedResult:
    """One result: its name on the page, the content of its file, and its effects by label."""

    name: str
    content: dict[str, Any]
    effects: dict[str, dict[str, Any]]

    def without(self, off: frozenset[str]) -> dict[str, Any]:
        """The content where these effects are switched off."""
        kept = [effect for label, effect in self.effects.items() if label not in off]
        return {**self.content, "effects": kept}


def read_results(folders: Sequence[Path]) -> list[SavedResult]:
    """The results in these folders. Raises `UsageError` for one that has none."""
    found = []
    for folder in folders:
        files = [folder / kind for kind in KINDS if (folder / kind).is_file()]
        if folder.is_file():
            files = [folder]
        if not files:
            raise UsageError(f"{folder}: neither diagnosis.json nor fit.json is in it")
        try:
            content = with_effects(json.loads(files[0].read_text(encoding="utf-8")))
            content = {**content, "model": content["model"], "parameters": content["parameters"]}
            effects = {f"{e['effect']} at {e['location']}": e for e in content["effects"]}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UsageError(f"{files[0]} is not a result of jaxid ({error})") from error
        found.append(SavedResult(one_line(folder.name or folder), content, effects))
    return found


def recording_of(results: Sequence[Path], saved: Sequence[SavedResult]) -> Dataset:
    """The recording that results were made of: a folder of the name that they tell, beside them,
    here, or up to two folders further down, whose samples are those that they tell.

    Raises `UsageError` where there is none.
    """
    name = str(saved[0].content.get("dataset", ""))
    digest = saved[0].content.get("dataset_sha256")
    for place in _places(name, results[0]):
        try:
            found = jaxid.load_dataset(place)
        except (jaxid.DatasetError, UsageError):
            continue
        if found.sha256 == digest:
            return found
    told = f"{name!r}, which is neither here nor beside it" if name else "a recording that it lacks"
    raise UsageError(
        f"{results[0]} was made of {told}; say where the recording is: --dataset FOLDER"
    )


def _places(name: str, result: Path) -> Iterator[Path]:
    """Folders of recordings of this name, nearest first."""
    bases = dict.fromkeys((Path.cwd(), result.resolve().parent))
    for depth in ("", "*/", "*/*/"):
        for base in bases:
            for header in sorted(base.glob(f"{depth}dataset.toml")):
                if header.parent.name == name or f'"{name}"' in header.read_text(
                    "utf-8", "replace"
                ):
                    yield header.parent


class Viewer:
    """Free runs of results on one recording; each is simulated when it is asked for, and kept."""

    def __init__(self, results: Sequence[SavedResult], dataset: Dataset, model: str | None = None):
        self.results, self.model = list(results), model
        self.dataset = self._as_fitted(dataset)
        self._kept: dict[tuple[int, frozenset[str]], Any] = {}
        self._lock = threading.Lock()

    def _as_fitted(self, dataset: Dataset) -> Dataset:
        """The recording with what its check mended, where a result was made of that."""
        if not any(r.content.get("data") for r in self.results):
            return dataset
        model = self.model or self.results[0].content["model"]
        named = None if dataset.model is not None else model
        return jaxid.check(self.model or named, dataset).mended or dataset

    @property
    def runs(self) -> list[str]:
        return [one_line(f"{e.name} ({e.split})") for e in self.dataset.experiments]

    @property
    def outputs(self) -> dict[str, str]:
        """Name -> unit of what is simulated."""
        return dict(self._simulated(0, frozenset()).units)

    def other_data(self) -> list[str]:
        """Results that were made of another recording than the one that is shown."""
        own = {self.dataset.sha256}
        return [
            r.name
            for r in self.results
            if r.content.get("dataset_sha256") not in own and not r.content.get("data")
        ]

    def series(self, run: int, off: Sequence[frozenset[str]]) -> dict[str, Any]:
        """Of a run, thinned: `t`, and by output what was `measured`, what each result simulates and
        its rms error over all samples.
        """
        experiment = self.dataset.experiments[run]
        step = max(1, -(-len(experiment.t) // DRAWN))
        thin = slice(None, None, step)
        column = {c.name: k for k, c in enumerate(self.dataset.outputs)}
        channels: dict[str, Any] = {}
        for name in self.outputs:
            measured = experiment.y[:, column[name]]
            simulated, errors = [], []
            for number, switched in enumerate(off):
                y = np.asarray(self._simulated(number, switched).runs[run][name])
                simulated.append(y[thin])
                errors.append(float(np.sqrt(np.nanmean((y - measured) ** 2))))
            channels[name] = {
                "measured": measured[thin],
                "simulated": simulated,
                "rms": errors,
            }
        return {"t": experiment.t[thin], "channels": channels}

    def _simulated(self, number: int, off: frozenset[str]) -> Any:
        key = number, off
        with self._lock:  # one simulation at a time: they share programs
            if key not in self._kept:
                content = self.results[number].without(off)
                named = self.model if self.dataset.model is None or self.model else None
                self._kept[key] = jaxid.simulate(named, self.dataset, content)
            return self._kept[key]
