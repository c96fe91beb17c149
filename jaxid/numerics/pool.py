"""Threads that compute as their caller would: JAX's and NumPy's settings belong to a thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

import jax
import numpy as np

from jaxid.base.computer import cores
from jaxid.numerics.precision import float64


T = TypeVar("T")


def default_device() -> Any:
    """The device that the caller chose with `jax.default_device` or JAX's own setting; None: JAX
    chooses.
    """
    return jax.config.values["jax_default_device"]


def default_platform() -> str:
    """What programs without placed arguments run on here: cpu, gpu, ..."""
    chosen = default_device()
    return jax.default_backend() if chosen is None else getattr(chosen, "platform", str(chosen))


class Pool:
    """Threads, one per core or this many; jobs run in float64, with the default device and NumPy's
    warnings as they are set where they are handed in.
    """

    def __init__(self, name: str, size: int | None = None):
        self._threads = ThreadPoolExecutor(
            max_workers=size or cores(), thread_name_prefix=f"jaxid-{name}"
        )

    def submit(self, job: Callable[..., T], *args: Any) -> Future[T]:
        return self._threads.submit(_on, default_device(), np.geterr(), job, *args)

    def map(self, job: Callable[..., T], items: Iterable[Any]) -> Iterator[T]:
        """Results in the items' order; all are handed in at once."""
        begun = [self.submit(job, item) for item in items]
        return (b.result() for b in begun)

    def ahead(self, jobs: Sequence[Callable[[], T]]) -> Iterator[T]:
        """The same, no more than a few ahead of what is taken: what was need not be kept; a single
        job runs here.
        """
        if len(jobs) < 2:
            yield from (job() for job in jobs)
            return
        waiting: deque[Future[T]] = deque()
        for job in jobs:
            waiting.append(self.submit(job))
            if len(waiting) > 2 * cores():
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()

    def close(self) -> None:
        """Waits for jobs that have begun; none is handed in any more."""
        self._threads.shutdown(wait=True)


def _on(device: Any, warnings: Any, job: Callable[..., T], *args: Any) -> T:
    with float64(), jax.default_device(device), np.errstate(**warnings):
        return job(*args)
