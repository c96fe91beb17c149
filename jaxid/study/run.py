"""A study from its file to its tables: `run_study` and `study_status`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxid.base.computer import own_cores
from jaxid.base.errors import NotSaved, UsageError
from jaxid.base.extras import required
from jaxid.study.cluster import Cluster, local_cluster, running_cluster
from jaxid.study.coordinator import Coordinator, StopSignal
from jaxid.study.outcome import FAILURES, of_row, Outcome
from jaxid.study.plan import read_study, Study, StudyError
from jaxid.study.store import NotBegun, Store
from jaxid.study.supervisor import SOLVER


@dataclass(frozen=True)
class Status:
    """How far a study is. `done` are tasks with a result, `failed` those that ended without one,
    `running` those handed out.
    """

    total: int
    done: int
    failed: int
    running: int

    def to_dict(self) -> dict[str, int]:
        return {
            "total": self.total,
            "done": self.done,
            "failed": self.failed,
            "running": self.running,
        }


@dataclass(frozen=True)
class StudyProgress:
    """What a study shows while it runs."""

    study: Study
    outcomes: dict[str, Outcome]
    running: int
    seconds: float
    new: int  # finished since this start


@dataclass(frozen=True)
class StudyResult:
    """A study and the outcomes it has, by the key of their task."""

    study: Study
    outcomes: dict[str, Outcome]
    complete: bool
    interrupted: bool = False
    new: int = 0
    seconds: float = 0.0
    notes: tuple[str, ...] = ()
    unsaved: str = ""  # why the tables could not be written

    @property
    def status(self) -> Status:
        return status_of(self.study, self.outcomes, 0)


def status_of(study: Study, outcomes: dict[str, Outcome], running: int) -> Status:
    failed = sum(o.failed for o in outcomes.values())
    left = len(study.tasks) - len(outcomes)
    return Status(len(study.tasks), len(outcomes) - failed, failed, min(running, left))


def study_status(path: str | Path) -> tuple[Study, dict[str, Outcome], Status]:
    """How far a study is, also while another process runs it and before anything has run; changes
    nothing.
    """
    study = read_study(path)
    if not (study.store / "study.sqlite").exists():
        return study, {}, status_of(study, {}, 0)
    try:
        with Store(study.store, writable=False) as store:
            outcomes = known(study, store)
            return study, outcomes, status_of(study, outcomes, store.running())
    except NotBegun:  # another process is just making it
        return study, {}, status_of(study, {}, 0)


def known(study: Study, store: Store) -> dict[str, Outcome]:
    """Outcomes of the study's tasks that the store holds."""
    return {row.key: of_row(row) for row in store.rows() if row.key in study.tasks}


def run_study(
    path: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    cluster: str | None = None,
    interface: str | None = None,
    retry: bool = False,
    heard: Callable[[StudyProgress], None] = lambda progress: None,
    solver: Sequence[str] = SOLVER,
    check: bool = True,
) -> StudyResult:
    """Runs what of a study has no result yet, and writes its tables and report when all is there.

    `workers` are processes on this computer (default: one a core); `scheduler` is the address of a
    dask cluster instead; `cluster` is "local" (this computer) or "slurm": `workers` jobs of one
    core, on the network `interface`; `retry` runs failed tasks again; `heard` is called a few times
    a second; `solver` is what computes, behind the name of the Python, and `check` whether models
    and data are looked at first. Ctrl-C, SIGTERM and SIGHUP save what was finished: `interrupted`.

    Raises `StudyError` for a study with mistakes, `StoreError` where the store cannot be used or
    another process runs it, `StudyFailed` where no task can be run at all.
    """
    from jaxid.study.tables import write_tables

    _check_places(scheduler, cluster, interface)
    for package in ("distributed", "psutil"):
        required(package)
    study = _read(path, check)
    began, notes = time.monotonic(), []
    with Store(study.store) as store:
        notes += _acquired(store)
        outcomes = known(study, store)
        if retry:
            again = [k for k, o in outcomes.items() if o.status in FAILURES]
            store.forget(again)
            outcomes = {k: o for k, o in outcomes.items() if o.status not in FAILURES}
        left = [t for t in study.tasks.values() if t.key not in outcomes]
        if left and check and store.recall("checked") != study.digest:
            from jaxid.study.check import check_study

            check_study(path)
            store.remember("checked", study.digest)
        new, complete = 0, not left
        if left:
            place = _place(study.store, len(left), workers, scheduler, cluster, interface)
            with StopSignal() as stop, place as found:
                coordinator = Coordinator(store, left, found, solver)

                def tell(c: Coordinator) -> None:
                    now = time.monotonic() - began
                    heard(
                        StudyProgress(study, outcomes | c.outcomes, c.running, now, len(c.outcomes))
                    )

                complete = coordinator.run(stop, tell)
            new, outcomes = len(coordinator.outcomes), outcomes | coordinator.outcomes
        ordered = {k: outcomes[k] for k in study.tasks if k in outcomes}
        result = StudyResult(
            study, ordered, complete, not complete, new, time.monotonic() - began, tuple(notes)
        )
        if complete:
            try:
                write_tables(result, store)
            except NotSaved as error:
                text = (
                    f"{error}. All results are in study.sqlite: make room, start the same"
                    " command again"
                )
                return replace(result, unsaved=text)
        return result


def _acquired(store: Store) -> list[str]:
    """Takes the store for this process; notes of what was damaged in it."""
    notes = []
    damaged = store.acquire()
    if store.salvaged is not None:
        notes.append(
            f"the store was damaged: {store.salvaged} results were saved from it, the old file"
            " lies beside it"
        )
    if damaged:
        notes.append(f"{damaged} results were damaged on the disk; their tasks run again")
    store.sweep()
    return notes


def _read(path: str | Path, check: bool) -> Study:
    """The study; where it has faults, `check` adds those of the names in it, so that they are told
    all at once.
    """
    try:
        return read_study(path)
    except StudyError:
        if check:
            from jaxid.study.check import check_study

            check_study(path)
        raise


def _place(
    store: Path,
    tasks: int,
    workers: int | None,
    scheduler: str | None,
    cluster: str | None,
    interface: str | None,
) -> AbstractContextManager[Cluster]:
    """Where the tasks run."""
    if cluster == "slurm":
        from jaxid.study.slurm import slurm_cluster

        return slurm_cluster(store, workers and min(workers, tasks), interface)
    return (
        running_cluster(scheduler)
        if scheduler is not None
        else local_cluster(min(workers or own_cores(), tasks))
    )


def _check_places(scheduler: str | None, cluster: str | None, interface: str | None) -> None:
    """Settings that would be ignored are refused."""
    if cluster not in (None, "local", "slurm"):
        raise UsageError(f"--cluster {cluster}: there is local and slurm")
    if scheduler is not None and cluster is not None:
        raise UsageError(
            "--cluster starts workers, --scheduler uses those that run: leave one of them out"
        )
    if interface is not None and cluster != "slurm":
        raise UsageError(
            "--interface is for --cluster slurm: on one computer nothing listens on any network"
        )


def summary(result: StudyResult) -> dict[str, Any]:
    """The result as `--json` prints it."""
    from jaxid.base.serialise import SCHEMA
    from jaxid.study.tables import rankings

    return {
        "schema": SCHEMA,
        "kind": "study",
        "name": result.study.name,
        **result.status.to_dict(),
        "new": result.new,
        "complete": result.complete,
        "wall_time_s": result.seconds,
        "store": str(result.study.store),
        "fitters": [r.to_dict() for r in rankings(result)],
        "failures": [
            {"task": k, "status": o.status, "reason": o.reason}
            for k, o in result.outcomes.items()
            if o.failed
        ],
        "notes": list(result.notes),
    }
