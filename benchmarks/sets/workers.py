"""Dask workers: a local cluster with one core per worker, or those of a running scheduler."""

import logging
import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any

import dask
from distributed import Client, LocalCluster, Worker, WorkerPlugin

from eyespot.formats.inputs import InputError


class OneCore(WorkerPlugin):
    """Binds each worker to its own core, if the operating system supports that.

    Mitsuba, JAX, OpenCV and BLAS start as many threads as a process has cores; with one core, the
    threads of different workers do not compete.
    """

    def __init__(self, first: int) -> None:
        self.first = first

    def setup(self, worker: Worker) -> None:
        """Run in the worker before its first stack."""
        if not hasattr(os, "sched_setaffinity"):
            return
        cores = sorted(os.sched_getaffinity(0))
        core = cores[(self.first + int(worker.name)) % len(cores)]
        # Linux sets affinity per thread; threads that start later inherit it.
        for thread in os.listdir("/proc/self/task"):
            os.sched_setaffinity(int(thread), {core})


@contextmanager
def local_workers(count: int, *, first_core: int = 0) -> Iterator[Client]:
    """A cluster on this machine; a worker that fails is started again.

    The first worker gets the core with this index among those that this process may use.
    """
    # By default Dask makes malloc return freed memory at once, which is slow for images.
    with dask.config.set({"distributed.nanny.pre-spawn-environ": {}}):
        with _threads_that_ignore_ctrl_c():
            cluster = LocalCluster(
                n_workers=0,
                threads_per_worker=1,
                processes=True,
                # It has no password. Any free port: another cluster may use 8787.
                dashboard_address="127.0.0.1:0",
                # By default each worker gets an equal share of the memory. On machines with many
                # cores that is too little for Mitsuba, and Dask would stop the workers.
                memory_limit=0,
                silence_logs=logging.CRITICAL,
            )
        with cluster, Client(cluster) as client:
            client.register_plugin(OneCore(first_core))
            cluster.scale(count)
            try:
                yield client
            except KeyboardInterrupt:
                # A worker would finish its stack first. The next run continues a stopped stack.
                for worker in multiprocessing.active_children():
                    worker.kill()
                raise


@contextmanager
def _threads_that_ignore_ctrl_c() -> Iterator[None]:
    """Threads started here, and the processes that they start, never get Ctrl-C.

    A terminal sends it to all processes of a command. This one stops the workers, which would
    report their end as an error.
    """
    resource_tracker.ensure_running()  # its start would unblock the signal again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def running_scheduler(address: str, *, patience: str = "20s") -> Iterator[Client]:
    """The workers of a running scheduler; InputError if none answers in time.

    Args:
        address: tcp://HOST:PORT, as `dask scheduler` prints it, or the path of its scheduler file.
    """
    where: dict[str, Any] = {"address": address}
    if "://" not in address and os.path.isfile(address):
        where = {"scheduler_file": address}
    try:
        client = Client(**where, timeout=patience)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {address} ({error}). Start one with `dask scheduler`, "
            "or omit --scheduler to use workers on this machine."
        ) from error
    with client:
        yield client
