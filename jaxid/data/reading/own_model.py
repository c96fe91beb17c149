"""`[model] file`: a model of the user's own that lies in the dataset's folder, and that runs as
Python code.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxid.base.errors import DatasetProblem, UsageError
from jaxid.data.dataset import Geometry, ModelSpec
from jaxid.data.model_names import parts_of
from jaxid.data.reading.stated_model import model_spec
from jaxid.data.schema import Document, Places
from jaxid.data.schema_model import ModelEntry


KEY = ("model", "file")


def file_of(
    document: Document, places: Places, open_text: Any, problems: list[DatasetProblem]
) -> str | None:
    """The path of the file, with the class that `name` states, as `jaxid.dynamics.model_file` takes
    it. It is read here, so that the dataset's hash has it, and not run. A file outside of the
    folder joins the problems.
    """
    entry = document.model
    if entry is None or entry.file is None:
        return None
    if open_text is None:
        remedy = "Give the model itself: jaxid.fit(MyModel(), data)"
        problems.append(places.problem(KEY, "a file needs a folder", remedy))
        return None
    text = open_text(entry.file, KEY)
    if isinstance(text, DatasetProblem):
        problems.append(text)
        return None
    path = str(open_text.path(entry.file).resolve())
    return path if entry.name is None else f"{path}:{entry.name}"


def info_of_file(file: str | None, places: Places, problems: list[DatasetProblem]) -> Any:
    """What is known of the model, for which its file is run; None where that failed, with the
    reason among the problems.
    """
    from jaxid.dynamics import catalogue

    if file is None:
        return None
    try:
        return catalogue.describe(file)
    except UsageError as error:
        message = str(error)
        remedy = "Correct the file"
        if "several models" in message:
            remedy = 'Write `name = "CLASS"` beside `file`'
        if "has no class" in message:
            remedy = "Correct `name`"
        problems.append(places.problem(KEY, message, remedy))
        return None


def stated(entry: ModelEntry, geometry: Geometry | None, file: str | None, info: Any) -> ModelSpec:
    """What the dataset says of its model; one by its file has the model's own `name`, where that is
    known.
    """
    spec = replace(model_spec(entry), geometry=geometry, file=file)
    return spec if file is None or info is None else replace(spec, name=info.name)


def runs_as_code(file: str | None, info: Any) -> list[str]:
    """The note that a file of the folder was run."""
    parts = parts_of(file or "")
    if parts is None or info is None:
        return []
    return [f"model {info.name}: {Path(parts[0]).name} of the dataset's folder, which runs as code"]
