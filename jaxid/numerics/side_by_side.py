"""Jobs that take minutes, side by side: what they tell is told in the caller's thread, and Ctrl-C
there reaches them all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from queue import SimpleQueue
from threading import Event
from typing import Any, TypeVar

from jaxid.base.computer import cores
from jaxid.numerics.pool import Pool


T = TypeVar("T")
Tell = Callable[..., None]


def side_by_side(
    jobs: Sequence[Callable[[Tell], T]], tell: Tell | None = None, workers: int | None = None
) -> list[Future[T]]:
    """Jobs that are done, in their order, no more than `workers` at a time (None: one per core).

    Each is called with a function by which it tells how far it is; what it tells reaches `tell` in
    the caller's thread. What interrupts the caller, or fails in `tell` or in a job, is raised in
    the others as `KeyboardInterrupt` where they next tell something; those that have not begun are
    cancelled, all that had begun are waited for.
    """
    told: SimpleQueue[tuple[Any, ...] | Future[T]] = SimpleQueue()
    stopped = Event()

    def say(*words: Any) -> None:
        if stopped.is_set():
            raise KeyboardInterrupt
        told.put(words)

    def stop() -> None:
        stopped.set()
        for b in begun:
            b.cancel()

    pool = Pool("jobs", min(len(jobs), workers or cores()))
    begun = [pool.submit(job, say) for job in jobs]
    for b in begun:
        b.add_done_callback(told.put)
    left = len(begun)
    try:
        while left:
            if isinstance(words := told.get(), Future):
                left -= 1
                if words.cancelled() or words.exception() is not None:
                    stop()
            elif tell is not None and not stopped.is_set():
                tell(*words)
    except KeyboardInterrupt:
        stop()
    except BaseException:
        stop()
        raise
    finally:
        pool.close()
    return begun
