"""Dask workers for whole stacks: a local cluster, one core a worker, or a scheduler that runs."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import dask
from distributed import Client, LocalCluster, Worker, WorkerPlugin


class OneCore(WorkerPlugin):
    """Keeps a worker on one core of its own, where the operating system can do that.

    Mitsuba, JAX, OpenCV and BLAS start as many threads as a process has cores. With one core a
    worker they neither wait for each other nor take what another worker needs.

    Args:
        first: number of the first worker's core.
    """

    def __init__(self, first: int) -> None:
        self.first = first

    def setup(self, worker: Worker) -> None:
        """Run in the worker before its first stack."""
        if not hasattr(os, "sched_setaffinity"):
            return
        cores = sorted(os.sched_getaffinity(0))
        core = cores[(self.first + int(worker.name)) % len(cores)]
        # Linux counts affinity by thread; those that start later inherit it.
        for thread in os.listdir("/proc/self/task"):
            os.sched_setaffinity(int(thread), {core})


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def local_workers(count: int, *, first_core: int = 0) -> Iterator[Client]:
    """A cluster on this machine; a worker that dies is started again.

    Args:
        count: of workers.
        first_core: of the first worker, counted among those that this process may use.
    """
    with (
        # Dask has malloc return freed memory at once: every image's pages would be made anew.
        dask.config.set({"distributed.nanny.pre-spawn-environ": {}}),
        LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            processes=True,
            dashboard_address=":0",  # any free port: 8787 may belong to another cluster
            # Shared by the number of cores, memory would be too little for Mitsuba on large
            # machines, and Dask would stop workers that need no more than any other process.
            memory_limit=0,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        client.register_plugin(OneCore(first_core))
        cluster.scale(count)
        yield client


@contextmanager
def running_scheduler(address: str, *, patience: str = "20s") -> Iterator[Client]:
    """The workers of a scheduler that runs already.

    Args:
        address: as `dask scheduler` prints it: tcp://HOST:PORT, or the path of its scheduler file.
        patience: how long to wait for an answer, as Dask writes it.

    Raises:
        ValueError: nothing answers there.
    """
    where: dict[str, Any] = {"address": address}
    if "://" not in address and os.path.isfile(address):
        where = {"scheduler_file": address}
    try:
        client = Client(**where, timeout=patience)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"no Dask scheduler answers at {address} ({error}). Start one with `dask scheduler`, "
            "or leave --scheduler out for workers on this machine."
        ) from error
    with client:
        yield client
