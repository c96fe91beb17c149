"""Where a study's tasks run: threads of this process with a solver process each, or a running dask
cluster.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import uuid
from collections.abc import Callable, Iterator
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.base.extras import needed
from jaxid.study import supervisor


#: How long a scheduler may take to answer.
CONNECT_S = 10.0
#: How long the parts of a cluster in this process may take to close.
CLOSE_S = 2.0


class Cluster:
    """A dask client, and a session of solvers on its workers; `hopeless` says why no worker will
    come where there is none.
    """

    def __init__(
        self,
        client: Any,
        everywhere: Callable[..., Any],
        hopeless: Callable[[], str | None] = lambda: None,
    ):
        self.client, self.session, self._everywhere, self.hopeless = (
            client,
            uuid.uuid4().hex,
            everywhere,
            hopeless,
        )
        self.patience = CLOSE_S  # seconds for each of its parts to close

    def drain(self) -> None:
        """Batches that have not begun return at once."""
        self._everywhere(supervisor.drain, self.session)

    def close(self) -> None:
        """Ends the solvers."""
        self._everywhere(supervisor.close, self.session)


def distributed_() -> Any:
    """dask.distributed. Where this is its first import it keeps to itself in which order its parts
    closed, or failed to.
    """
    config = needed("dask.config")
    with config.set({"logging": {"distributed": "critical", "distributed.client": "critical"}}):
        return needed("distributed")


@contextlib.contextmanager
def dask_cluster(**settings: Any) -> Iterator[Any]:
    """A scheduler in this process, and workers as set; no part of it serves pages."""
    distributed = distributed_()
    config = needed("dask.config")
    with config.set(
        {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
    ):
        parts = distributed.LocalCluster(
            processes=False,
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address="127.0.0.1:0",
            memory_limit=0,
            silence_logs=50,
            **settings,
        )
    parts.patience = CLOSE_S
    try:
        parts.sync(_stop_listening, parts)
        yield parts
    finally:
        with contextlib.suppress(TimeoutError):
            parts.close(timeout=parts.patience)
        parts.shutdown_on_close = False  # what is not closed by now would hold up the end of Python


@contextlib.contextmanager
def local_cluster(workers: int, threads: int = 1) -> Iterator[Cluster]:
    """Workers in this process, each thread with a solver process of its own; nothing listens on any
    network.
    """
    with dask_cluster(n_workers=workers, threads_per_worker=threads) as parts:
        client = distributed_().Client(parts, set_as_default=False)
        cluster = Cluster(client, lambda function, session: function(session))
        try:
            yield cluster
        finally:
            parts.patience = cluster.patience
            cluster.close()
            close_client(client, cluster.patience / 2)


def close_client(client: Any, seconds: float) -> None:
    """Closes a client; where a crowded computer is too slow for that, its destructor would try
    again for a minute.
    """
    with contextlib.suppress(TimeoutError):
        client.close(timeout=seconds)
    client.status = "closed"


async def _stop_listening(parts: Any) -> None:
    """dask opens an HTTP server (here on loopback, without pages) for each of its parts; nobody asks them."""
    for part in (parts.scheduler, *parts.workers.values()):
        part.http_server.stop()


@contextlib.contextmanager
def running_cluster(address: str) -> Iterator[Cluster]:
    """The cluster of the scheduler at an address. Raises `UsageError` where none answers."""
    if not re.fullmatch(
        r"((tcp|tls|ws|wss|ucx|ucxx)://)?(\[[0-9a-fA-F:.]+\]|[^\s:/@\[\]]+):\d{1,5}", address
    ):
        raise UsageError(
            f"--scheduler {address}: no address of a scheduler; write it as in tcp://10.0.0.1:8786"
        )
    distributed = distributed_()
    try:
        kind = asyncio.run(asyncio.wait_for(_kind(address), CONNECT_S))
    except Exception as error:  # what is no scheduler answers anything
        silent = isinstance(error, TimeoutError | asyncio.TimeoutError)
        why = (
            f"nothing within {CONNECT_S:g} s"
            if silent
            else str(error)
            if isinstance(error, OSError)
            else "it speaks otherwise"
        )
        raise UsageError(
            f"--scheduler {address}: no scheduler answers there ({why}); start one with `dask"
            " scheduler`"
        ) from None
    if kind != "Scheduler":
        raise UsageError(
            f"--scheduler {address}: that is a {kind.lower()}, no scheduler; `dask scheduler` tells"
            " its address"
        )
    client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    cluster = Cluster(client, client.run)
    try:
        yield cluster
    finally:
        with contextlib.suppress(Exception):
            cluster.close()
        close_client(client, cluster.patience)


async def _kind(address: str) -> str:
    """What part of a cluster answers there. A client that meets silence would go on waiting when it is closed."""
    distributed = distributed_()
    security = distributed.Security().get_connection_args("client")
    async with distributed.rpc(address, connection_args=security, timeout=CONNECT_S) as part:
        return str((await part.identity()).get("type"))
