"""Workers that SLURM starts: TLS with a certificate of this study alone, on the network that is
named.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxid.base.errors import nearest, UsageError
from jaxid.base.extras import needed
from jaxid.study.cluster import close_client, CLOSE_S, Cluster, dask_cluster, distributed_


#: Folders of certificates in a store begin so.
PRIVATE = "tls-"
#: A worker that hears nothing of its scheduler for so long ends; SLURM is asked so often whether
#: its job is still there (s).
DEATH_S, ASK_S = 60, 30.0

SCRIPT = """#!/bin/sh
#SBATCH --job-name=jaxid
#SBATCH --array=1-{count}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --output="{log}"
export DASK_DISTRIBUTED__WORKER__HTTP__ROUTES='[]'
exec {command}
"""


def address_of(interface: str | None) -> str:
    """The IPv4 address of this machine on a network interface. Raises `UsageError` with those that
    there are.
    """
    interfaces = needed("psutil").net_if_addrs()
    found = {}
    for name, addresses in interfaces.items():
        found[name] = [a.address for a in addresses if a.family.name == "AF_INET"]
    usable = {name: a[0] for name, a in found.items() if a}
    if interface is None:
        raise UsageError(
            "--cluster slurm: name the network between the nodes with --interface (there is:"
            f" {', '.join(usable)})"
        )
    if interface not in usable:
        raise UsageError(
            f"--interface {interface}: no network of this machine{nearest(interface, usable)}"
        )
    return usable[interface]


@contextlib.contextmanager
def slurm_cluster(store: Path, workers: int | None, interface: str | None) -> Iterator[Cluster]:
    """A scheduler in this process and `workers` jobs of one core each, by `sbatch`, which takes
    partition, account, time and memory from its usual variables (SBATCH_PARTITION, …). The store
    has to be on a disk that the nodes share.

    Raises `UsageError` where there is no SLURM, no such network, or no library that makes
    certificates.
    """
    if shutil.which("sbatch") is None:
        raise UsageError(
            "--cluster slurm: there is no `sbatch` here; start it on a login node of the cluster,"
            " or use --cluster local"
        )
    if workers is None:
        raise UsageError(
            "--cluster slurm: how many workers? Type --workers N; each is a job of one core"
        )
    host = address_of(interface)
    for left in store.glob(
        f"{PRIVATE}*"
    ):  # of a coordinator that was killed; the store is ours alone
        shutil.rmtree(left, ignore_errors=True)
    private = Path(tempfile.mkdtemp(prefix=PRIVATE, dir=store))
    try:
        security, files = _certificate(private)
        with dask_cluster(host=host, protocol="tls://", security=security, n_workers=0) as parts:
            command = _worker(parts.scheduler_address, str(interface), files)
            job = _submit(private / "workers.sh", workers, store, command)
            client = distributed_().Client(parts, set_as_default=False)
            cluster = Cluster(client, client.run, _JobWatch(job, store))
            try:
                yield cluster
            finally:
                with contextlib.suppress(Exception):
                    cluster.close()
                with contextlib.suppress(Exception):
                    client.retire_workers(close_workers=True)
                if job and shutil.which("scancel"):
                    subprocess.run(["scancel", job], capture_output=True, timeout=60, check=False)
                close_client(client, min(CLOSE_S, cluster.patience))
    finally:
        shutil.rmtree(private, ignore_errors=True)


def _certificate(folder: Path) -> tuple[Any, dict[str, Path]]:
    """dask's settings for TLS with a new certificate, which every party has to show, and its files
    (0600) for the workers.
    """
    needed("cryptography")
    security = distributed_().Security.temporary()
    files = {}
    for name, content in security.get_tls_config_for_role("worker").items():
        if name in ("ca_file", "cert", "key"):
            files[name] = folder / f"{name}.pem"
            with open(
                os.open(files[name], os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w"
            ) as file:
                file.write(content)
    return security, files


def _worker(scheduler: str, interface: str, files: dict[str, Path]) -> list[str]:
    """How a worker is started: its message port on the interface alone and by TLS, its HTTP port on
    loopback, without pages.
    """
    options: dict[str, Any] = {
        "--nthreads": 1,
        "--nworkers": 1,
        "--memory-limit": 0,
        "--interface": interface,
        "--protocol": "tls",
        "--dashboard-address": "127.0.0.1:0",
        "--death-timeout": DEATH_S,
        "--local-directory": tempfile.gettempdir(),
        "--tls-ca-file": files["ca_file"],
        "--tls-cert": files["cert"],
        "--tls-key": files["key"],
    }
    given: list[str] = []
    for option, value in options.items():
        given += [option, str(value)]
    return [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        scheduler,
        "--no-nanny",
        "--no-dashboard",
        *given,
    ]


def _submit(script: Path, workers: int, store: Path, command: list[str]) -> str:
    """The number of the job, as far as `sbatch` tells one."""
    log = str(store.resolve() / "worker-%A_%a.log")
    script.write_text(SCRIPT.format(count=workers, log=log, command=shlex.join(command)))
    done = subprocess.run(["sbatch", str(script)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise UsageError(
            f"--cluster slurm: sbatch refused the workers: {(done.stderr or done.stdout).strip()}"
        )
    number = re.search(r"\d+", done.stdout)
    return number[0] if number else ""


class _JobWatch:
    """Asked while there is no worker: whether SLURM still has the job."""

    def __init__(self, job: str, store: Path):
        self.job, self.store, self._asked = job, store, time.monotonic()

    def __call__(self) -> str | None:
        """Why no worker will come; None while one may."""
        if not self.job or not shutil.which("squeue") or time.monotonic() - self._asked < ASK_S:
            return None
        self._asked = time.monotonic()
        done = subprocess.run(
            ["squeue", "--noheader", f"--jobs={self.job}"],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode == 0 and done.stdout.strip():
            return None
        return (
            f"SLURM has ended the workers (job {self.job}); {self.store / 'worker-*.log'} says why"
        )
