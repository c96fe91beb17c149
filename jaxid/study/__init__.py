"""Studies: many fits and diagnoses from one file, on one computer or a cluster, that survive kills, crashes and full disks.

The coordinator (`run_study`) hands batches of tasks to the workers of a dask cluster and alone writes the store. A worker passes
them to a solver process of its own and watches it from outside. See docs/batch.md.
"""

from __future__ import annotations

import importlib
from typing import Any


_WHERE = {
    "run_study": "jaxid.study.run",
    "study_status": "jaxid.study.run",
    "read_study": "jaxid.study.plan",
    "check_study": "jaxid.study.check",
}
__all__ = ["check_study", "read_study", "run_study", "study_status"]


def __getattr__(name: str) -> Any:
    if name in _WHERE:
        return getattr(importlib.import_module(_WHERE[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
