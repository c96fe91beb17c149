"""What runs in a worker of the cluster: it hands batches to a solver process of its own and watches
it from outside.

A solver that dies or exceeds its time costs only the tasks it was working on; the worker of the
cluster lives on. Each thread of a worker has its solver, which keeps its compiled programs from
batch to batch.
"""

from __future__ import annotations

import collections
import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any


#: How a solver is started, behind the Python of the machine it runs on.
SOLVER = ("-m", "jaxid.study.solver")
#: A solver that is not ready by then is taken for dead.
START_S = 300.0
YEAR_S = 3e7
#: Lines of a dead solver's standard error that are kept.
LOG_LINES = 30

#: Every number cruncher on one thread: there is a solver a core.
THREADS = {
    name: "1"
    for name in (
        "OPENBLAS_NUM_THREADS",
        "OMP_NUM_THREADS",
        "MKL_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
    )
}

_SOLVERS: dict[tuple[int, str], Solver] = {}  # (thread, session) -> its solver
_CLOSED: set[str] = set()  # sessions that begin nothing more


class Solver:
    """A solver process with its answers as a queue and the end of its log."""

    def __init__(self, command: Sequence[str]):
        self.process = subprocess.Popen(
            [sys.executable, *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
            env={**os.environ, **THREADS},
            start_new_session=True,  # Ctrl-C in the terminal is the coordinator's to handle
        )
        self.ready = False
        self.log: collections.deque[str] = collections.deque(maxlen=LOG_LINES)
        self.answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self.readers = [
            threading.Thread(target=f, daemon=True) for f in (self._read_answers, self._read_log)
        ]
        for reader in self.readers:
            reader.start()

    def _read_answers(self) -> None:
        assert self.process.stdout is not None
        try:
            for line in self.process.stdout:
                self.answers.put(json.loads(line))
        except ValueError:
            pass  # half a line: it died while writing
        self.answers.put(None)

    def _read_log(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.log.append(line[:500].rstrip("\n"))

    def send(self, tasks: Sequence[dict[str, Any]]) -> None:
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(tasks) + "\n")
            self.process.stdin.flush()
        except (BrokenPipeError, OSError):
            pass  # dead already: its answers end

    def kill(self) -> None:
        self.process.kill()

    def end(self) -> str:
        """Waits for the process, closes its pipes, and says how it died."""
        self.process.kill()
        code = self.process.wait()
        for reader in self.readers:
            reader.join(2.0)
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            try:
                if stream is not None:
                    stream.close()
            except OSError:
                pass
        if code < 0:
            try:
                return f"its process was killed by {signal.Signals(-code).name}"
            except ValueError:
                return f"its process was killed by signal {-code}"
        return f"its process ended with code {code}"

    @property
    def tail(self) -> str:
        return "\n".join(self.log)[-4000:]


def run_batch(session: str, command: Sequence[str], batch: str) -> str:
    """Works on the tasks of a batch (a JSON list) and returns {"host", "seconds", "outcomes"} as
    JSON, with an outcome for each.

    An outcome is what the solver said of a task; or {"key", "died": how, "log", "alone": whether
    only this task can be to blame, "late": whether it was stopped at its time limit}; or {"key",
    "left": true} for one that was not begun. Where the solver did not even start, "failed_to_start"
    says how.
    """
    began = time.monotonic()
    tasks = json.loads(batch)
    outcomes = {t["key"]: {"key": t["key"], "left": True} for t in tasks}
    answer: dict[str, Any] = {"host": socket.gethostname()}
    if session not in _CLOSED:
        answer |= _watch(session, _solver(session, command), tasks, outcomes)
    return json.dumps(
        answer | {"seconds": time.monotonic() - began, "outcomes": list(outcomes.values())}
    )


def _watch(
    session: str, solver: Solver, tasks: Sequence[dict[str, Any]], outcomes: dict[str, Any]
) -> dict[str, Any]:
    """Fills in the outcomes until all tasks are answered or the solver is gone."""
    limits = {t["key"]: t["timeout_s"] for t in tasks if t.get("timeout_s") is not None}
    limit_s = None
    solver.send(tasks)
    waiting, busy, deadline = set(outcomes), [], time.monotonic() + START_S
    while waiting:
        try:
            message = solver.answers.get(timeout=max(0.0, deadline - time.monotonic()))
            late = False
        except queue.Empty:
            message, late = None, True
        if message is None:
            how = _drop(solver)
            if session in _CLOSED:
                return {}
            if not solver.ready:
                return {"failed_to_start": how, "log": solver.tail}
            for key in (busy := [k for k in busy if k in waiting]):
                blamed = {
                    "key": key,
                    "died": f"it took more than {limit_s:g} s" if late and limit_s else how,
                    "log": solver.tail,
                }
                outcomes[key] = blamed | {"alone": len(busy) == 1, "late": late}
            return {}
        solver.ready |= "ready" in message
        if "begin" in message:
            busy = [k for k in message["begin"] if k in waiting]
            limit_s = max((limits[k] for k in busy if k in limits), default=None)
            deadline = time.monotonic() + (YEAR_S if limit_s is None else limit_s)
        elif (key := message.pop("done", None)) in waiting:
            waiting.discard(key)
            outcomes[key] = {"key": key, **message}
    return {}


def _solver(session: str, command: Sequence[str]) -> Solver:
    """The solver of this thread, started anew if there is none."""
    own = threading.get_ident(), session
    solver = _SOLVERS.get(own)
    if solver is not None and solver.process.poll() is not None:
        _drop(solver)
        solver = None
    if solver is None:
        solver = _SOLVERS[own] = Solver(command)
        if session in _CLOSED:  # closed while it was being started: `close` may not have seen it
            solver.kill()
    return solver


def _drop(solver: Solver) -> str:
    how = solver.end()
    for own, other in list(_SOLVERS.items()):
        if other is solver:
            del _SOLVERS[own]
    return how


def drain(session: str) -> None:
    """Batches of a session that have not begun return at once; those that run go on."""
    _CLOSED.add(session)


def close(session: str) -> None:
    """Ends every solver of a session; batches that are running return with what was finished."""
    drain(session)
    for (_, own), solver in list(_SOLVERS.items()):
        if own == session:
            solver.kill()
