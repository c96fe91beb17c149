"""Whether the models, effects and fitters of a study exist and fit its data: asked before anything
runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from jaxid.base.errors import DatasetError, DatasetProblem, UsageError
from jaxid.data.dataset import Dataset
from jaxid.data.io import load_dataset
from jaxid.data.model_names import is_model_file
from jaxid.data.schema import Places
from jaxid.diagnosis.hypothesis import check_asked
from jaxid.dynamics import catalogue
from jaxid.fitters.by_name import fitter_of
from jaxid.problem.added_effects import parse_effect
from jaxid.problem.binding import resolve_model
from jaxid.robots.match import is_file
from jaxid.study.plan import dataset_problems, parse_study, PlannedRuns, Study, StudyError, Task


def check_study(path: str | Path) -> Study:
    """Reads a study and everything it names. Raises `StudyError` with every mistake at once."""
    study, problems = parse_study(path)
    data: dict[str, Dataset] = {}
    for folder, label in {t.dataset: t.label for t in study.tasks.values()}.items():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # each stands in the result of a fit
                data[folder] = load_dataset(folder)
        except DatasetError as error:
            problems += dataset_problems(error, label)
    places = Places(study.path.name, study.path.read_text(encoding="utf-8-sig"))
    for runs in study.runs:
        problems += _Check(runs, places).problems(data)
    if problems:
        each = dict.fromkeys(problems)
        own = [p for p in each if p.file == study.path.name]
        others = [p for p in each if p.file != study.path.name]
        raise StudyError([*sorted(own, key=lambda p: p.row or 0), *others])
    return study


class _Check:
    """The questions about one `[[runs]]`."""

    def __init__(self, runs: PlannedRuns, places: Places):
        self.runs, self.places, self.found = runs, places, []

    def problems(self, data: dict[str, Dataset]) -> list[DatasetProblem]:
        entry = self.runs.entry
        effects = self._effects()
        without = [e for e in entry.without if self.ask("without", catalogue.effect_class, e)]
        models = {m for m in entry.models or [] if self._is_model(m)}
        self._check_fitters()
        for task in {(t.dataset, t.model): t for t in self.runs.tasks}.values():
            named = task.model is not None and task.model_sha256 is None
            if task.dataset not in data or (named and task.model not in models):
                continue
            where = "datasets" if task.model is None else "models"
            chain = self.ask(
                where, resolve_model, task.model, data[task.dataset], without, of=task.label
            )
            if chain is not None:
                self._check_effects(effects, chain, task)
        return self.found

    def _effects(self) -> list[str]:
        """Each effect that is asked for, once, of those that there are."""
        ids: set[str] = set()
        for group in self.runs.entry.effects or []:
            ids |= set(group)
        known = []
        for effect in sorted(ids):
            # A fit names an effect with its joint.
            name = effect.partition("@")[0] if self.runs.entry.command == "fit" else effect
            if self.ask("effects", catalogue.effect_class, name):
                known.append(effect)
        return known

    def _is_model(self, model: str) -> bool:
        if is_file(model) or is_model_file(model):
            return True
        return bool(self.ask("models", catalogue.model_class, model))

    def _check_fitters(self) -> None:
        entry = self.runs.entry
        for name in entry.fitters or []:
            kind = self.ask("fitters", fitter_of, name)
            wanted = getattr(kind, "residual_name", None)
            if wanted is not None and entry.residual not in (None, wanted):
                self.say(
                    "fitters",
                    f"{name} solves {wanted}, not {entry.residual}",
                    "Leave it out or change `residual`",
                )

    def _check_effects(self, effects: Sequence[str], chain: Any, task: Task) -> None:
        """Whether a model can have the effects."""
        entry = self.runs.entry
        for effect in effects:
            if entry.command == "fit":
                self.ask("effects", parse_effect, effect, chain, of=task.label)
            else:
                asked, residual = [effect], entry.residual or ""
                self.ask("effects", check_asked, chain, asked, residual, of=task.label)

    def ask(self, field: str, question: Callable[..., Any], *arguments: Any, of: str = "") -> Any:
        """The answer; None and a problem where it is refused."""
        try:
            return question(*arguments)
        except (UsageError, DatasetError) as error:
            message = f"dataset {of!r}: {error}" if of else str(error)
            self.say(field, message, "Correct the name or leave it out")
            return None

    def say(self, field: str, message: str, remedy: str) -> None:
        self.found.append(
            self.places.problem(("runs", self.runs.index, field), message.rstrip("."), remedy)
        )
