"""Where a study's tasks run: threads of this process with a solver process each, or a running dask cluster."""

from __future__ import annotations

import contextlib
import os
import uuid
from collections.abc import Callable, Iterator
from typing import Any

from jaxid.errors import UsageError
from jaxid.study import supervisor


#: How long a scheduler may take to answer.
CONNECT_S = 10.0
#: How long the parts of a cluster in this process may take to close.
CLOSE_S = 2.0


class Cluster:
    """A dask client, and a session of solvers on its workers."""

    def __init__(self, client: Any, everywhere: Callable[..., Any]):
        self.client, self.session, self._everywhere = client, uuid.uuid4().hex, everywhere
        self.patience = CLOSE_S  # seconds for each of its parts to close

    def drain(self) -> None:
        """Batches that have not begun return at once."""
        self._everywhere(supervisor.drain, self.session)

    def close(self) -> None:
        """Ends the solvers."""
        self._everywhere(supervisor.close, self.session)


def _distributed() -> Any:
    """dask.distributed. Where this is its first import it keeps to itself in which order its parts closed."""
    from dask import config

    with config.set({"logging.distributed": "critical"}):
        import distributed
    return distributed


@contextlib.contextmanager
def local_cluster(workers: int, threads: int = 1) -> Iterator[Cluster]:
    """Workers in this process, each thread with a solver process of its own; nothing listens on any network."""
    distributed = _distributed()
    from dask import config

    with config.set({"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}):
        parts = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=threads,
            processes=False,
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address="127.0.0.1:0",
            memory_limit=0,
            silence_logs=50,
        )
    patience = CLOSE_S
    try:
        parts.sync(_stop_listening, parts)
        client = distributed.Client(parts, set_as_default=False)
        cluster = Cluster(client, lambda function, session: function(session))
        try:
            yield cluster
        finally:
            patience = cluster.patience
            cluster.close()
            _close(client, patience / 2)
    finally:
        with contextlib.suppress(TimeoutError):
            parts.close(timeout=patience)
        parts.shutdown_on_close = False  # what is not closed by now would hold up the end of Python


def _close(client: Any, seconds: float) -> None:
    """Closes a client; where a crowded computer is too slow for that, its destructor would try again for a minute."""
    with contextlib.suppress(TimeoutError):
        client.close(timeout=seconds)
    client.status = "closed"


async def _stop_listening(parts: Any) -> None:
    """dask opens an HTTP server (here on loopback, without pages) for each of its parts; nobody asks them."""
    for part in (parts.scheduler, *parts.workers.values()):
        part.http_server.stop()


@contextlib.contextmanager
def running_cluster(address: str) -> Iterator[Cluster]:
    """The cluster of the scheduler at an address."""
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(
            f"--scheduler {address}: no scheduler answers there ({error}); start one with `dask scheduler`"
        ) from None
    cluster = Cluster(client, client.run)
    try:
        yield cluster
    finally:
        with contextlib.suppress(Exception):
            cluster.close()
        _close(client, cluster.patience)


def cores() -> int:
    """Cores this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
