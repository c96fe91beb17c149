"""The process that computes: `python -m jaxid.study.solver`, spawned and watched by
`jaxid.study.supervisor`.

It reads batches of tasks as lines of JSON from its standard input and answers in lines of JSON;
nothing is pickled, and what anything prints goes to standard error. It keeps compiled programs from
batch to batch, and it ends when its input is closed: no process is left behind when the one that
started it is killed.
"""

from __future__ import annotations

import faulthandler
import json
import os
import queue
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from typing import Any


#: tasks of one batch -> messages: {"begin": [key, ...]} before tasks are worked on, {"done": key,
#: ...} for each when finished.
Work = Callable[[list[dict[str, Any]]], Iterable[dict[str, Any]]]


def serve(work: Work) -> None:
    """Answers batches until the input is closed."""
    faulthandler.enable()
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)
    batches: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            batches.put(line)
        os._exit(0)  # also out of the middle of a compiled program

    threading.Thread(target=read, daemon=True).start()
    answers.write('{"ready": true}\n')
    while True:
        tasks = json.loads(batches.get())
        for message in answered(work, tasks):
            answers.write(json.dumps(message, allow_nan=False) + "\n")


def answered(work: Work, tasks: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """The messages of `work`, and a failure for each task that an exception left unanswered."""
    left = {t["key"] for t in tasks}
    try:
        for message in work(tasks):
            left.discard(message.get("done", ""))
            yield message
        reason, log = "no result", ""
    except Exception as error:
        reason, log = explained(error), "".join(traceback.format_exception(error))[-4000:]
    for key in sorted(left):
        yield {"done": key, "status": "failed", "reason": reason, "log": log}


def explained(error: Exception) -> str:
    from jaxid.base.errors import explain

    return explain(error)[1]


def main() -> None:
    from jaxid import runtime

    runtime.prepare()
    from jaxid.study.work import Workshop

    serve(Workshop().work)


if __name__ == "__main__":
    main()
