"""Cluster of worker processes on this machine: one for each GPU, or one for each core."""

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import psutil

from simgen.pipeline.forked_imports import CAN_FORK, start_imports

# Threads of a GPU's process. Each solves a task, and the presses of all tasks share the device (see ``pool``). A task
# of the paired job is one shard, so finished shards are written early. With 128 threads, 74 s of the paired job's
# 377 s went into its last presses (2b75018, one H200), because hard presses of the last shards began late.
TASKS_PER_GPU_PROCESS = 256
LONGEST_SILENCE = "1 hour"  # of a process before it counts as lost; one call of the mesher can take minutes
LONGEST_WAIT = "5 minutes"  # of a task for a worker that is lost together with all others; then the task fails
LONGEST_END_S = 10.0  # for the processes of GPUs to end
STARTS = 3  # attempts to start a process that is killed as it starts

# A terminal interrupts the whole process group; only the parent answers, and ends the workers.
IGNORE_INTERRUPTS = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
# Threads that collect and hand over results must not block threads that feed a GPU for Python's usual 5 ms.
SHORT_TURNS = "import sys; sys.setswitchinterval(3e-4)"
WRITE_BY_PROCESSES = "from simgen.pipeline import shard_files; shard_files.BY_PROCESSES = True"
PATIENCE = {"distributed.scheduler.no-workers-timeout": LONGEST_WAIT}
FORK = {
    "distributed.worker.multiprocessing-method": "forkserver",
    "distributed.worker.daemon": False,  # Python does not let a daemon start the processes that write
    # Otherwise dask makes processes return freed memory at once. Getting it back takes half of a sensor's loading time.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}
# Otherwise dask samples the stacks of all threads every 10 ms, for its dashboard.
NO_PROFILE = {"distributed.worker.profile.enabled": False}


@contextmanager
def local_cluster(environments: list[dict[str, str]]) -> Iterator[Any]:
    """Make a dask cluster on this machine, with a process for each environment.

    A process that starts again keeps its environment. A process with a GPU of its own has several threads. The presses
    of their tasks are solved together (see ``pool``), and no task waits while another one writes.
    """
    import dask
    from dask.distributed import Nanny, Scheduler, SpecCluster, Status
    from distributed import utils
    from distributed.system import MEMORY_LIMIT

    class QuickNanny(Nanny):
        """Ends its worker after half a second instead of five, because unfinished work is of no use.

        A worker that is killed during its first start is started again; dask would give up all workers.
        """

        async def instantiate(self) -> Status:
            if self.status != Status.init:
                return await super().instantiate()
            for _ in range(STARTS):
                if (status := await super().instantiate()) == Status.running:
                    return status
            raise RuntimeError(f"killed or out of memory {STARTS} times as it started")

        async def close(self, timeout: float = 0.5, reason: str = "nanny-close"):
            with suppress(TimeoutError):  # the worker was killed and has not ended yet
                return await super().close(timeout, reason)

    logging.getLogger("distributed.process").setLevel(logging.WARNING)  # a worker that frees a GPU outlives the cluster
    shared = {"silence_logs": "CRITICAL", "dashboard": False, "config": NO_PROFILE}
    shared["memory_limit"] = MEMORY_LIMIT // max(1, len(environments))  # dask's default is a share by cores
    threads = [TASKS_PER_GPU_PROCESS if environment else 1 for environment in environments]
    of_gpu = [SHORT_TURNS, *([WRITE_BY_PROCESSES] if CAN_FORK else [])]
    preload = [[IGNORE_INTERRUPTS, *(of_gpu if environment else [])] for environment in environments]
    variables = [{**os.environ, **environment} for environment in environments]  # those of now, not of the first fork
    workers = {
        i: {"cls": QuickNanny, "options": {**shared, "nthreads": count, "env": own, "preload": before}}
        for i, (count, own, before) in enumerate(zip(threads, variables, preload, strict=True))
    }
    options = {"host": "127.0.0.1", "port": 0, "dashboard_address": "127.0.0.1:0", "dashboard": None}
    # Two other processes try the tasks of a dead one, then `simgen.pipeline.run` decides.
    options |= {"allowed_failures": 2, "worker_ttl": LONGEST_SILENCE}
    here = {"cls": Scheduler, "options": options}
    with dask.config.set({**PATIENCE, **(FORK if CAN_FORK else {})}):
        utils._forkserver_preload_set = True  # otherwise dask imports pandas here, if it is there
        start_imports()
        processes = []
        try:
            with SpecCluster(workers=workers, scheduler=here, silence_logs="CRITICAL") as cluster:
                try:
                    yield cluster
                finally:
                    processes += processes_of(cluster)
        finally:
            # One that frees a GPU takes a second to end. Another run that starts meanwhile may not get the GPU.
            if any(environments):
                psutil.wait_procs(processes, timeout=LONGEST_END_S)


def processes_of(cluster: Any) -> list[psutil.Process]:
    """Processes of the workers of a local cluster."""
    found = []
    for nanny in cluster.workers.values():
        with suppress(psutil.NoSuchProcess):
            found += [psutil.Process(nanny.pid)] if nanny.pid is not None else []
    return found
