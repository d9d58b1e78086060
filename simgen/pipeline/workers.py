"""Workers that solve tasks: a local cluster, the workers of a dask scheduler, or this process.

Only this file imports dask.
"""

import json
import logging
import os
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent import futures
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import cached_property
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any

import psutil

from simgen.config.job_schema import Job
from simgen.config.warp_device import check_device
from simgen.errors import InputError
from simgen.pipeline.forked_imports import CAN_FORK, start_imports
from simgen.pipeline.presser import Presser, fem_presser
from simgen.pipeline.shard import prepare

# Threads of a GPU's process. Each solves a task, and the presses of all tasks share the device (see ``pool``). A task
# of the paired job is one shard, so finished shards are written early. With 128 threads, 74 s of the paired job's
# 377 s went into its last presses (2b75018, one H200), because hard presses of the last shards began late.
TASKS_PER_GPU_PROCESS = 256
TASKS_PER_THREAD = 2  # submitted tasks: one runs, one waits
LONGEST_SILENCE = "1 hour"  # of a process before it counts as lost; one call of the mesher can take minutes
ANSWER_S = 10.0  # timeout for the scheduler's answer
LONGEST_WAIT_S = 300.0  # for the wanted number of workers
LONGEST_END_S = 10.0  # for the processes of GPUs to end
STARTS = 3  # attempts to start a process that is killed as it starts

# A terminal interrupts the whole process group; only the parent answers, and ends the workers.
IGNORE_INTERRUPTS = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
# Threads that collect and hand over results must not block threads that feed a GPU for Python's usual 5 ms.
SHORT_TURNS = "import sys; sys.setswitchinterval(3e-4)"
WRITE_BY_PROCESSES = "from simgen.pipeline import shard_files; shard_files.BY_PROCESSES = True"
FORK = {
    "distributed.worker.multiprocessing-method": "forkserver",
    "distributed.worker.daemon": False,  # Python does not let a daemon start the processes that write
    # Otherwise dask makes processes return freed memory at once. Getting it back takes half of a sensor's loading time.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}
# Otherwise dask samples the stacks of all threads every 10 ms, for its dashboard.
NO_PROFILE = {"distributed.worker.profile.enabled": False}


class Workers:
    """Processes that solve tasks.

    device : as each process sees it; a process with a GPU of its own sees no other GPU
    count : number of processes
    start : starts them; returns dask's client and futures that prepare the processes. None: solve in this process
    close : ends them
    closing_thread : ends them while the caller goes on
    tasks_at_once : tasks that a process solves at a time
    """

    def __init__(self, device: str, count: int = 1, start: Callable[[], tuple[Any, list]] | None = None,
                 close: Callable[[], None] = lambda: None, closing_thread: ThreadPoolExecutor | None = None,
                 tasks_at_once: int = 1):  # fmt: skip
        self.device, self.count, self.tasks_at_once = device, count, tasks_at_once
        self.close, self._start, self._closing_thread = close, start, closing_thread
        self._closing: list[futures.Future] = []

    @cached_property
    def started(self) -> tuple[Any, list]:
        """dask's client and preparing futures; the first access starts the processes."""
        return self._start()

    def begin_to_close(self):
        """End the processes while the caller goes on. A process that frees a GPU takes a second to end.

        `start_workers` waits for it at its own end.
        """
        if self._closing_thread is not None:
            self._closing.append(self._closing_thread.submit(self.close))

    def wait_until_closed(self):
        """Wait for what `begin_to_close` has begun, if anything. Raises the errors of closing."""
        for closing in self._closing:
            closing.result()

    @property
    def about(self) -> str:
        """Number and address of the workers, and dask's dashboard, which needs bokeh."""
        if self._start is None:
            return "this process alone"
        client = self.started[0]
        count, threads = len(client.nthreads()), sum(client.nthreads().values())
        dashboard = ""
        if find_spec("bokeh") is not None:
            with suppress(KeyError):  # a scheduler without one
                dashboard = f", dashboard {client.dashboard_link}"
        workers = f"{count} worker{'s' if count != 1 else ''} with {threads} threads" if count else "no worker yet"
        return f"{workers} at {client.scheduler.address}{dashboard}"

    def map(
        self, function: Callable, arguments: list, shared: Iterable = (), shared_at_once: int = 1
    ) -> Iterator[tuple[Any, Any]]:
        """Yield arguments with their results as they come; an exception takes the place of a missing result.

        Each worker should have ``shared_at_once`` of the ``shared`` arguments at a time, so that all end together. They
        are handed out when no other argument waits. Workers can join and leave meanwhile. Raises `InputError` if the
        scheduler is lost.
        """
        if not arguments or self._start is None:
            yield from ((argument, function(argument)) for argument in chain(arguments, shared))
            return
        from dask.distributed import CancelledError, KilledWorker, as_completed, wait
        from distributed.comm import CommClosedError

        client, preparing = self.started
        # Otherwise dask gives a ready worker with a free thread the task that prepares another worker.
        wait(preparing)
        preparing.clear()  # do not wait again for a worker that dies
        waiting, sharing, submitted, ended = deque(arguments), iter(shared), {}, as_completed()
        places = {}  # future of a shared argument -> address of the worker that should take it

        def submit_one(argument: Any, **where) -> Any:
            future = client.submit(function, argument, pure=False, **where)
            submitted[future] = argument
            ended.add(future)
            return future

        def submit() -> None:
            """Submit only what workers will soon take, to keep the scheduler's load small."""
            threads = client.nthreads()
            bound = TASKS_PER_THREAD * max(1, sum(threads.values()))
            while waiting and len(submitted) - len(places) < bound:
                submit_one(waiting.popleft())
            while not waiting and (threads or not submitted):
                taken = Counter(places.values())
                address = min(threads, key=lambda each: taken[each], default=None)
                if taken[address] >= shared_at_once or (argument := next(sharing, None)) is None:
                    break
                where = {"workers": [address], "allow_other_workers": True} if threads else {}
                places[submit_one(argument, **where)] = address

        try:
            submit()
            for future in ended:
                try:
                    result = future.result()
                except (CancelledError, CommClosedError):
                    raise
                except KilledWorker as error:
                    died = error.allowed_failures + 1
                    result = RuntimeError(f"{died} processes died while they solved it, killed or out of memory")
                except Exception as error:  # for instance if a worker lacks simgen
                    result = error
                places.pop(future, None)
                yield submitted.pop(future), result
                submit()
        except (CancelledError, CommClosedError, OSError) as error:
            raise InputError(f"the scheduler of the workers is lost ({error})") from None


@contextmanager
def start_workers(
    job: Job,
    device: str = "cpu",
    count: int | None = None,
    scheduler: str | None = None,
    build: Callable[[Job, str, str], Presser] = fem_presser,
) -> Iterator[Workers]:
    """Make workers for a job, and close them at the end.

    Without ``scheduler``, a local cluster of ``count`` processes solves, by default one for each core or GPU, but at
    most one for each shard. Its processes start at once, in a thread, while the caller plans. They load sensors, scenes
    and kernels as soon as they have started.

    With the address of a ``scheduler``, its workers solve once there are ``count`` of them or after `LONGEST_WAIT_S`.
    They must see the same file system. With "sync", this process solves.

    Raises `InputError` for a scheduler that does not answer and, on first use, for a process that does not start.
    Raises it also for a device that this machine lacks, unless a scheduler's workers solve.
    """
    if scheduler is None:
        start_imports()  # while this process looks for GPUs and plans
    if scheduler is None or scheduler == "sync":
        check_device(device)
    if scheduler == "sync":
        yield Workers(device)
        return
    if scheduler is not None:
        from dask.distributed import Client
        from distributed.comm.addressing import parse_address
        from distributed.comm.registry import get_backend
        from distributed.utils import silence_logging_cmgr

        try:
            get_backend(parse_address(scheduler)[0])  # refuses an unknown kind of address, which a client would try
            client = Client(scheduler, timeout=ANSWER_S)
        except Exception as error:  # dask raises many kinds for bad addresses
            allowed = "allowed: the address of one that answers, as tcp://host:8786, or sync"
            raise InputError(f"scheduler {scheduler!r}: {str(error) or type(error).__name__}; {allowed}") from None
        with silence_logging_cmgr("CRITICAL"), client:  # a lost scheduler logs pages of tracebacks

            def joined() -> tuple[Any, list]:
                if count:
                    with suppress(TimeoutError):  # fewer will do
                        client.wait_for_workers(count, timeout=LONGEST_WAIT_S)
                return client, []

            threads = client.nthreads().values()
            yield Workers(device, count or max(1, len(threads)), joined, tasks_at_once=min(threads, default=1))
        return
    gpus = visible_gpus(device) if device != "cpu" else []
    there = "cuda" if gpus else device
    environments = [{"CUDA_VISIBLE_DEVICES": gpu} for gpu in gpus] or [{}] * (count or cores())
    environments = environments[: min(count or job.shards, job.shards)]
    # The executor ends first: it waits for the start, and then this thread closes what has started.
    with ExitStack() as stack, ThreadPoolExecutor(1) as beside:

        def start() -> tuple[Any, list]:
            from dask.distributed import Client  # takes a second

            try:
                cluster = stack.enter_context(local_cluster(environments))
            except RuntimeError as error:
                number, why = len(environments), error.__cause__ or error
                raise InputError(f"one of {number} workers did not start: {why}") from None
            client = Client(cluster)  # not as a context, which would have to be left in this thread
            stack.callback(client.close)
            own = {"allow_other_workers": True, "pure": False}  # others if this one is lost
            addresses = list(client.nthreads())
            return client, [client.submit(prepare, job, there, build, part, len(addresses), workers=[address], **own)
                            for part, address in enumerate(addresses)]  # fmt: skip

        def close() -> None:
            futures.wait([starting])
            stack.close()

        starting = beside.submit(start)
        tasks_at_once = TASKS_PER_GPU_PROCESS if gpus else 1
        started = Workers(there, len(environments), starting.result, close, beside, tasks_at_once)
        yield started
        started.wait_until_closed()


def visible_gpus(device: str) -> list[str]:
    """Names in CUDA_VISIBLE_DEVICES of the GPUs of ``cuda`` (all visible ones) or ``cuda:N``."""
    import warp as wp

    names = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = names.split(",") if names else [str(i) for i in range(wp.get_cuda_device_count())]
    number = device.partition(":")[2]
    return [names[int(number)]] if number else names


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
    with dask.config.set(FORK if CAN_FORK else {}):
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


def scheduler_address(file: Path) -> str:
    """Read the address in a file that `dask scheduler --scheduler-file` wrote. Raises `InputError` without one."""
    try:
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
    except OSError as error:
        raise InputError(f"scheduler file {file}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        address = None
    if not isinstance(address, str):
        allowed = "allowed: what `dask scheduler --scheduler-file` wrote"
        raise InputError(f"scheduler file {file}: no address in it; {allowed}")
    return address


def cores() -> int:
    """Number of cores that this process may use."""
    from dask.system import CPU_COUNT  # respects cgroup limits and affinity

    return CPU_COUNT
