"""What became of a task, and how it is kept: as a row of the store and as a row of the tables."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jaxid.study.plan import Task
from jaxid.study.rows import StudyRow


#: A result of these counts as failed; `crashed` killed its process twice, `timeout` took longer
#: than allowed.
FAILURES = ("failed", "crashed", "timeout")


@dataclass(frozen=True)
class Outcome:
    """A finished task. `result` is the content of its fit.json or diagnosis.json; empty where there
    is none.
    """

    key: str
    status: str  # converged | stopped | failed | crashed | timeout
    reason: str = ""
    loss: float | None = None
    evaluations: int | None = None
    wall_time_s: float | None = None
    compile_time_s: float | None = None
    parameters: Mapping[str, float | None] | None = None
    verdict: str = ""  # of a diagnosis
    named: tuple[str, ...] = ()  # effects with locations that it names
    log: str = ""
    host: str = ""
    result: Mapping[str, Any] | None = None

    @property
    def failed(self) -> bool:
        return self.status in FAILURES

    def row(self, task: Task, arrays: str = "") -> StudyRow:
        """For the store; the task's own settings go with it, so that a store can be read without
        its study.
        """
        body = {name: getattr(self, name) for name in FIELDS} | {
            "task": {k: v for k, v in task.settings.items() if v is not None}
        }
        return StudyRow(self.key, self.status, json.dumps(body, allow_nan=False).encode(), arrays)


FIELDS = tuple(name for name in Outcome.__dataclass_fields__ if name not in ("key", "status"))


def of_row(row: StudyRow) -> Outcome:
    """The outcome that a row of the store holds."""
    return _outcome(json.loads(row.body) | {"key": row.key, "status": row.status})


def of_message(message: Mapping[str, Any], host: str = "") -> Outcome:
    """The outcome that a solver has reported."""
    return _outcome({**message, "host": host})


def _outcome(given: Mapping[str, Any]) -> Outcome:
    own: dict[str, Any] = {
        name: given[name] for name in ("key", "status", *FIELDS) if name in given
    }
    own["named"] = tuple(own.get("named", ()))
    return Outcome(**own)
