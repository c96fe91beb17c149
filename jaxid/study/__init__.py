"""Studies: many fits and diagnoses from one file, on one computer or a cluster, that survive kills,
crashes and full disks.

The coordinator (`run_study`) hands batches of tasks to the workers of a dask cluster and alone
writes the store. A worker passes them to a solver process of its own and watches it from outside.
See docs/batch.md.
"""

from __future__ import annotations

import importlib
from typing import Any, TYPE_CHECKING


if TYPE_CHECKING:
    from jaxid.study.check import check_study
    from jaxid.study.plan import read_study
    from jaxid.study.run import run_study, study_status

_WHERE = {"run_study": "run", "study_status": "run", "read_study": "plan", "check_study": "check"}
__all__ = ["check_study", "read_study", "run_study", "study_status"]


def __getattr__(name: str) -> Any:
    if name in _WHERE:
        return getattr(importlib.import_module(f"{__name__}.{_WHERE[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
