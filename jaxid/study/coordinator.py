"""The one process that hands out tasks and writes the store.

Tasks go in batches to the workers of a dask cluster: at most two batches a thread, so that none
waits for the coordinator. Tasks that run in the same compiled programs stay on the same worker and
form batches of about a second.
"""

from __future__ import annotations

import asyncio
import collections
import concurrent.futures
import contextlib
import json
import queue
import signal
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from jaxid.base.stopping import ending
from jaxid.study import supervisor
from jaxid.study.cluster import Cluster
from jaxid.study.outcome import of_message, Outcome
from jaxid.study.plan import Task
from jaxid.study.store import Store, StoreError


#: How long a batch should take, the share of that for each thread of the cluster (the coordinator
#: needs some 5 ms a batch, and should have half its time left), and its largest size.
BATCH_S, BATCH_THREAD_S, BATCH_MOST = 1.0, 0.01, 128
#: Below this many seconds a task, batches are filled up with tasks of other groups: sending them
#: one by one would cost more.
QUICK_S = 0.02
#: A task that was at work when its process died this many times is `crashed`.
DEATHS = 2
#: Solvers that die before they are ready, in a row, until the study gives up.
STARTS = 4
RENEW_S, WORKERS_S = 5.0, 1.0
#: After the first Ctrl-C running batches may finish for so long; then their processes are ended,
#: and what they had finished may arrive. Both count from the signal, so that a crowded computer
#: leaves in time too.
GRACE_S, ARRIVE_S = 0.7, 0.35
#: How long the parts of a cluster may take to close after Ctrl-C, when everything is saved.
HURRY_S = 0.3

GONE = "the scheduler has gone; what was finished is saved, start the same command again"

Heard = Callable[["Coordinator"], None]


class StudyFailed(RuntimeError):
    """The study cannot go on, through no fault of a task."""


@dataclass
class Group:
    """Tasks that share their compiled programs."""

    waiting: collections.deque[Task] = field(default_factory=collections.deque)
    seconds: float | None = None  # of a task, as seen so far
    size: int = 1  # of the next batch


@dataclass
class Batch:
    """Tasks that were handed to a worker."""

    tasks: dict[str, Task]
    worker: str
    group: str


class StopSignal:
    """Ctrl-C, SIGTERM or SIGHUP: `count` of them, the first at `since`. Also where a shell had a
    background job ignore Ctrl-C: what is sent to it is meant.
    """

    def __init__(self):
        self.count = 0
        self.since = 0.0  # time.monotonic() of the first
        self._before: dict[int, Any] = {}

    def __enter__(self) -> StopSignal:
        if threading.current_thread() is threading.main_thread():
            for number in {signal.SIGINT, *ending()}:
                self._before[number] = signal.signal(number, self._heard)
        return self

    def _heard(self, number: int, frame: Any) -> None:
        self.since = self.since or time.monotonic()
        self.count += 1

    def __exit__(self, *exception) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)


class Coordinator:
    """Runs tasks on a cluster and saves their outcomes. `done`, `failed`, `running` and `outcomes`
    tell how far it is.
    """

    def __init__(
        self,
        store: Store,
        tasks: Sequence[Task],
        cluster: Cluster,
        command: Sequence[str] = supervisor.SOLVER,
    ):
        self.store, self.cluster, self.client, self.command = (
            store,
            cluster,
            cluster.client,
            tuple(command),
        )
        self.groups: dict[str, Group] = {}
        for task in tasks:
            self.groups.setdefault(task.group, Group()).waiting.append(task)
        self.open = dict.fromkeys(self.groups)  # those with tasks waiting, in the study's order
        self.seconds = 1.0  # of a task, over all groups, as seen lately
        self.suspects: collections.deque[Task] = collections.deque()  # to be tried alone
        self.deaths: collections.Counter[str] = collections.Counter()
        self.starts = 0
        self.batches: dict[str, Batch] = {}  # id of the future
        self.futures: dict[str, Any] = {}
        self.workers: dict[str, int] = {}
        self.last: dict[str, str] = {}  # worker -> group
        self.arrived: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.outcomes: dict[str, Outcome] = {}
        self.unsaved: list[tuple[Outcome, Task, Any]] = []
        self._looked = self._renewed = 0.0

    @property
    def running(self) -> int:
        return sum(len(b.tasks) for b in self.batches.values())

    @property
    def pace(self) -> float:
        """How long a batch should take."""
        return max(BATCH_S, BATCH_THREAD_S * sum(self.workers.values()))

    @property
    def waiting(self) -> int:
        return len(self.suspects) + sum(len(self.groups[name].waiting) for name in self.open)

    def run(self, stop: StopSignal, heard: Heard = lambda coordinator: None) -> bool:
        """Works until every task has an outcome (True) or is told to stop (False); what was
        finished is saved either way.
        """
        try:
            while self.waiting or self.batches:
                if stop.count:
                    self._finish(stop)
                    return False
                self._look()
                self._hand_out()
                self._collect(0.2)
                if time.monotonic() - self._renewed > RENEW_S:
                    self.store.renew(self.running)
                    self._renewed = time.monotonic()
                heard(self)
            return True
        except BaseException:
            with contextlib.suppress(StoreError):
                self._save()
            raise

    # ---- handing out

    def _look(self) -> None:
        """Which workers there are; they may come and go."""
        if time.monotonic() - self._looked < WORKERS_S:
            return
        self.workers = dict(self._asked(self.client.nthreads))
        self._looked = time.monotonic()
        if not self.workers and (why := self.cluster.hopeless()):
            raise StudyFailed(f"{why}; what was finished is saved, start the same command again")

    def _asked(self, question: Callable[..., Any], *arguments: Any, **more: Any) -> Any:
        """The cluster's answer; a scheduler that is gone is no fault of a file or a task."""
        try:
            return question(*arguments, **more)
        except (
            OSError,
            RuntimeError,
            concurrent.futures.CancelledError,
            asyncio.CancelledError,
        ) as error:
            if isinstance(error, StudyFailed):
                raise
            raise StudyFailed(f"{GONE} ({error or type(error).__name__})") from error

    def _hand_out(self) -> None:
        busy = collections.Counter(b.worker for b in self.batches.values())
        slots: list[Any] = []
        for depth in (1, 2):
            for worker, threads in self.workers.items():
                slots += [worker] * (threads * depth - busy[worker])
        room = max(0, 2 * sum(self.workers.values()) - len(self.batches))
        threads = max(1, sum(self.workers.values()))
        counted = collections.Counter(busy)
        for worker in slots[: 2 * room]:
            if len(self.batches) >= 2 * threads or counted[worker] >= 2 * self.workers[worker]:
                continue
            batch = self._next(worker, threads)
            if batch is None:
                return
            counted[worker] += 1
            self._submit(batch)

    def _next(self, worker: str, threads: int) -> Batch | None:
        if self.suspects:
            task = self.suspects.popleft()
            return Batch({task.key: task}, worker, task.group)
        name = self.last.get(worker, "")
        if name not in self.open:
            taken = collections.Counter(self.last.values())
            name = next((n for n in self.open if not taken[n]), None) or next(iter(self.open), "")
            if not name:
                return None
            self.last[worker] = name
        group = self.groups[name]
        tasks = self._draw(name, max(1, min(group.size, self._share(len(group.waiting), threads))))
        if self.seconds < QUICK_S:
            most = min(
                BATCH_MOST, int(self.pace / self.seconds), self._share(self.waiting, threads)
            )
            while self.open and len(tasks) < most:
                name = next(iter(self.open))
                tasks += self._draw(name, most - len(tasks))
        return Batch({t.key: t for t in tasks}, worker, name)

    def _share(self, waiting: int, threads: int) -> int:
        """Towards the end all workers get something."""
        return -(-waiting // (2 * threads))

    def _draw(self, name: str, most: int) -> list[Task]:
        """The next tasks of a group."""
        waiting = self.groups[name].waiting
        tasks = [waiting.popleft() for _ in range(min(most, len(waiting)))]
        if not waiting:
            self.open.pop(name, None)
        return tasks

    def _submit(self, batch: Batch) -> None:
        tasks = list(batch.tasks.values())
        content = json.dumps([t.settings | {"key": t.key, "group": t.group} for t in tasks])
        future = self._asked(
            self.client.submit,
            supervisor.run_batch,
            self.cluster.session,
            self.command,
            content,
            workers=[batch.worker],
            allow_other_workers=True,
            pure=False,
        )
        self.batches[future.key], self.futures[future.key] = batch, future
        future.add_done_callback(lambda f: self.arrived.put(f.key))

    # ---- taking in

    def _collect(self, wait_s: float) -> None:
        """Takes in every batch that has come back, waiting for the first; saves their outcomes in
        one transaction.
        """
        keys = []
        with contextlib.suppress(queue.Empty):
            keys.append(self.arrived.get(timeout=wait_s))
            while True:
                keys.append(self.arrived.get_nowait())
        back = [(self.batches.pop(k), self.futures.pop(k)) for k in keys if k in self.batches]
        good = [f for _, f in back if f.status == "finished"]
        answers = (
            dict(zip([f.key for f in good], self._asked(self.client.gather, good), strict=True))
            if good
            else {}
        )
        for batch, future in back:
            if future.key in answers:
                self._take(batch, json.loads(answers[future.key]))
            else:
                self._lost(batch, future)
        self._save()

    def _take(self, batch: Batch, answer: dict[str, Any]) -> None:
        if "failed_to_start" in answer:
            self.starts += 1
            if self.starts >= STARTS:
                raise StudyFailed(
                    f"no solver can be started: {answer['failed_to_start']}\n{answer['log']}"
                )
        compiling, finished = 0.0, 0
        for message in answer["outcomes"]:
            task = batch.tasks[message["key"]]
            if message.get("left"):
                self.groups[task.group].waiting.appendleft(task)
                self.open[task.group] = None
            elif "died" in message:
                self._died(task, message, answer["host"])
            else:
                self.starts, finished = 0, finished + 1
                compiling += message.get("compile_time_s") or 0.0
                history = message.pop("history", None)
                self.unsaved.append((of_message(message, answer["host"]), task, history))
        if finished == len(batch.tasks):
            self._resize(batch, (answer["seconds"] - compiling) / finished)

    def _resize(self, batch: Batch, seconds: float) -> None:
        """The size of the group's next batches: as many as keep the pace, with some patience for
        one that was slow by chance.
        """
        self.seconds = max(1e-6, (seconds + self.seconds) / 2)
        group = self.groups[batch.group]
        slower = group.seconds is not None and seconds > group.seconds
        group.seconds = (
            (seconds + group.seconds) / 2
            if slower and group.seconds is not None
            else max(seconds, 1e-6)
        )
        group.size = max(1, min(int(self.pace / group.seconds), 8 * len(batch.tasks), BATCH_MOST))

    def _died(self, task: Task, message: dict[str, Any], host: str) -> None:
        """The process died while this task was at work, perhaps with others beside it."""
        if message["alone"] and message["late"]:
            outcome = Outcome(
                task.key,
                "timeout",
                message["died"],
                wall_time_s=task.timeout_s,
                log=message["log"],
                host=host,
            )
            self.unsaved.append((outcome, task, None))
            return
        self.deaths[task.key] += message["alone"]
        if self.deaths[task.key] >= DEATHS:
            reason = f"{message['died']}, {DEATHS} times"
            self.unsaved.append(
                (Outcome(task.key, "crashed", reason, log=message["log"], host=host), task, None)
            )
        else:
            self.suspects.append(task)

    def _lost(self, batch: Batch, future: Any) -> None:
        """The cluster lost the batch: its worker died more often than the scheduler allows, or the
        scheduler is gone.
        """
        if self.client.status not in ("running", "newly-created") or future.status == "cancelled":
            raise StudyFailed(GONE)
        error = future.exception()
        if type(error).__name__ != "KilledWorker":
            raise StudyFailed(f"the cluster cannot run a batch: {type(error).__name__}: {error}")
        message = {
            "died": "its worker of the cluster died",
            "alone": len(batch.tasks) == 1,
            "late": False,
            "log": "",
        }
        for task in batch.tasks.values():
            self._died(task, message, batch.worker)

    def _save(self) -> None:
        """Everything that has come back, on the disk; only then does it count."""
        if not self.unsaved:
            return
        taken = [(o, t, h) for o, t, h in self.unsaved if o.key not in self.outcomes]
        histories = {o.key: h for o, _, h in taken if h}
        name = ""
        if histories:
            name = f"{next(iter(histories))}-{len(histories)}"
            name = self.store.save_arrays(name, histories)
        rows = []
        for outcome, task, history in taken:
            rows.append(outcome.row(task, name if history else ""))
        self.store.save(rows, self.running)
        self._renewed = time.monotonic()
        self.outcomes |= {o.key: o for o, _, _ in taken}
        self.unsaved.clear()

    def _finish(self, stop: StopSignal) -> None:
        """Gives running batches a moment, takes in what came back, leaves the rest for the next
        time.
        """
        self.cluster.drain()
        self._wait(stop.since + GRACE_S, lambda: stop.count < 2)
        self.cluster.close()
        self.cluster.patience = HURRY_S
        self._wait(max(stop.since + GRACE_S, time.monotonic()) + ARRIVE_S, lambda: stop.count < 3)

    def _wait(self, until: float, patient: Callable[[], bool]) -> None:
        while self.batches and time.monotonic() < until and patient():
            self._collect(0.05)
