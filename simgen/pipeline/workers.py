"""Workers that solve tasks: a local cluster, the workers of a dask scheduler, or this process.

Only this file and `local_cluster` import dask.
"""

import asyncio
import json
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent import futures
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import cached_property, partial
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any

from simgen.config.job_schema import Job
from simgen.config.warp_device import check_device
from simgen.errors import InputError
from simgen.pipeline.forked_imports import start_imports
from simgen.pipeline.local_cluster import TASKS_PER_GPU_PROCESS, local_cluster
from simgen.pipeline.presser import Presser, fem_presser
from simgen.pipeline.shard import prepare
from simgen.pipeline.sharing import LOOK_S, Sharing

TASKS_PER_THREAD = 2  # submitted tasks: one runs, one waits
ANSWER_S = 10.0  # timeout for the scheduler's answer
LONGEST_WAIT_S = 300.0  # for the wanted number of workers
LONGEST_ANSWER_S = 2.0  # timeout for the answers of all workers
LOOK_FOR_LIFE_S = 1.0  # between two looks whether workers live


class Workers:
    """Processes that solve tasks.

    device : as each process sees it; a process with a GPU of its own sees no other GPU
    count : number of processes
    start : starts them; returns dask's client, and futures that prepare the processes with the processes' addresses.
        None: solve in this process
    close : ends them
    closing_thread : ends them while the caller goes on
    tasks_at_once : tasks that a process solves at a time
    """

    def __init__(self, device: str, count: int = 1, start: Callable[[], tuple[Any, dict]] | None = None,
                 close: Callable[[], None] = lambda: None, closing_thread: ThreadPoolExecutor | None = None,
                 tasks_at_once: int = 1):  # fmt: skip
        self.device, self.count, self.tasks_at_once = device, count, tasks_at_once
        self.close, self._start, self._closing_thread = close, start, closing_thread
        self._closing: list[futures.Future] = []

    @cached_property
    def started(self) -> tuple[Any, dict[Any, str]]:
        """dask's client and preparing futures with addresses; the first access starts the processes."""
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
        self, function: Callable, arguments: list, shared: Iterable = (), room: Callable[[], Any] = lambda: None
    ) -> Iterator[tuple[Any, Any]]:
        """Yield arguments with their results as they come; an exception takes the place of a missing result.

        Any worker can take the ``shared`` arguments. They are handed out when no other argument waits, to workers that
        have ``room``: see `simgen.pipeline.sharing.Sharing`. Workers can join and leave meanwhile. Raises `InputError`
        if the scheduler is lost, or if a process could not be prepared.
        """
        if not arguments or self._start is None:
            yield from ((argument, function(argument)) for argument in chain(arguments, shared))
            return
        from dask.distributed import CancelledError, KilledWorker, as_completed
        from distributed.comm import CommClosedError

        client, preparing = self.started
        # Otherwise dask gives a ready worker with a free thread the task that prepares another worker.
        wait_until_prepared(client, preparing)
        check_prepared(preparing)
        preparing.clear()
        waiting, submitted, ended = deque(arguments), {}, as_completed()
        sharing = Sharing(shared, client.nthreads, partial(ask, client, room))
        places = {}  # future of a shared argument -> address of the worker that should take it

        def submit_one(argument: Any, **where) -> Any:
            future = client.submit(function, argument, pure=False, **where)
            submitted[future] = argument
            ended.add(future)
            return future

        def submit() -> None:
            """Submit only what workers will soon take, to keep the scheduler's load small."""
            bound = TASKS_PER_THREAD * max(1, sum(client.nthreads().values()))
            while waiting and len(submitted) - len(places) < bound:
                submit_one(waiting.popleft())
            if waiting:
                return
            for argument, address in sharing.hand_out(idle=not submitted):
                where = {} if address is None else {"workers": [address], "allow_other_workers": True}
                places[submit_one(argument, **where)] = address

        try:
            submit()
            while submitted:
                look = not waiting and sharing.left
                batch = ended.next_batch(block=not look)
                if not batch:
                    time.sleep(LOOK_S)
                for future in batch:
                    try:
                        result = future.result()
                    except (CancelledError, CommClosedError):
                        raise
                    except KilledWorker as error:
                        died = error.allowed_failures + 1
                        result = RuntimeError(f"{died} processes died while they solved it, killed or out of memory")
                    except Exception as error:  # for instance if a worker lacks simgen
                        result = error
                    if future in places:
                        sharing.end(places.pop(future))
                    yield submitted.pop(future), result
                    submit()
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
        start_imports(as_copy=device != "cpu")  # while this process looks for GPUs and plans; before it loads CUDA
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

            def joined() -> tuple[Any, dict]:
                if count:
                    with suppress(TimeoutError):  # fewer will do
                        client.wait_for_workers(count, timeout=LONGEST_WAIT_S)
                return client, {}

            threads = client.nthreads().values()
            yield Workers(device, count or max(1, len(threads)), joined, tasks_at_once=min(threads, default=1))
        return
    gpus = visible_gpus(device) if device != "cpu" else []
    there = "cuda" if gpus else device
    environments = [{"CUDA_VISIBLE_DEVICES": gpu} for gpu in gpus] or [{}] * (count or cores())
    environments = environments[: min(count or job.shards, job.shards)]
    # The executor ends first: it waits for the start, and then this thread closes what has started.
    with ExitStack() as stack, ThreadPoolExecutor(1) as beside:

        def start() -> tuple[Any, dict]:
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
            return client, {client.submit(prepare, job, there, build, part, len(addresses), workers=[address], **own):
                            address for part, address in enumerate(addresses)}  # fmt: skip

        def close() -> None:
            futures.wait([starting])
            stack.close()

        starting = beside.submit(start)
        tasks_at_once = TASKS_PER_GPU_PROCESS if gpus else 1
        started = Workers(there, len(environments), starting.result, close, beside, tasks_at_once)
        yield started
        started.wait_until_closed()


def wait_until_prepared(client: Any, preparing: Mapping[Any, str]) -> None:
    """Wait for futures that prepare the workers at these addresses.

    If a worker dies, another process takes its place at another address. dask may then never run the worker's task: it
    looks for an address that fits the task only while there are other workers.
    """
    from dask.distributed import wait

    while waiting := [future for future in preparing if not future.done()]:
        there = client.nthreads()
        waiting = [future for future in waiting if preparing[future] in there]
        if not waiting:
            return
        with suppress(TimeoutError):
            wait(waiting, timeout=LOOK_FOR_LIFE_S)


def check_prepared(preparing: Iterable[Any]):
    """Raise `InputError` if a worker could not be prepared, for instance because its GPU has no free memory.

    Otherwise each task of that worker fails at once. The worker then takes and fails the tasks of the other workers. A
    worker that died is replaced, and raises nothing.
    """
    from dask.distributed import KilledWorker

    for future in preparing:
        error = future.exception() if future.status == "error" else None
        if isinstance(error, InputError):
            raise error
        if error is not None and not isinstance(error, KilledWorker):
            raise InputError(f"a worker process could not be prepared: {type(error).__name__}: {error}")


def ask(client: Any, function: Callable[[], Any], addresses: list[str]) -> dict[str, Any]:
    """Call a function in the workers at these addresses. Returns results or errors by address; {} if one is silent."""
    call = client.run(function, workers=addresses, on_error="return", asynchronous=True)
    answers = asyncio.run_coroutine_threadsafe(call, client.loop.asyncio_loop)
    try:
        return answers.result(LONGEST_ANSWER_S)
    except TimeoutError:
        answers.cancel()
        return {}


def visible_gpus(device: str) -> list[str]:
    """Names in CUDA_VISIBLE_DEVICES of the GPUs of ``cuda`` (all visible ones) or ``cuda:N``."""
    import warp as wp

    names = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = names.split(",") if names else [str(i) for i in range(wp.get_cuda_device_count())]
    number = device.partition(":")[2]
    return [names[int(number)]] if number else names


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
