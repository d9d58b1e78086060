"""Compression and writing of results while presses are solved.

Threads write beside a CPU, and processes beside a GPU. A thread that writes takes Python's lock, and the threads that
feed a GPU wait for it.
"""

import multiprocessing
import multiprocessing.util
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from simgen.dataset.atomic_files import Aside
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import write_aside
from simgen.errors import NOT_WRITABLE, InputError

BY_PROCESSES = False  # set in workers that `simgen.pipeline.workers` starts for a GPU
# Shards that a process writes at once; each takes 0.2 s of a core and 0.1 GB for a sensor. A GPU ends a shard of the
# paired job every two seconds, and some ten together at its end.
THREADS, PROCESSES = min(16, os.cpu_count() or 1), 4


@dataclass(frozen=True)
class Failure:
    """An exception as text, with the operating system's number if it has one.

    final : a second try would fail too, because of a bad input or a full disk
    """

    sentence: str
    errno: int | None
    final: bool = False

    @classmethod
    def of(cls, error: Exception) -> "Failure":
        """Describe an exception."""
        number = getattr(error, "errno", None)
        return cls(f"{type(error).__name__}: {error}", number, isinstance(error, InputError) or number in NOT_WRITABLE)


Written = dict[str, Aside] | Failure


class WritingThreads:
    """Threads that write files of shards' arrays."""

    def __init__(self, count: int = THREADS):
        self._threads = ThreadPoolExecutor(count)

    def submit(self, dataset: Dataset, shard: int, values: Mapping[str, Sequence], folder: Path) -> "Future[Written]":
        """Begin to write files, not in their places yet. The result has them by path, or a failure.

        values : see `simgen.dataset.writer.write_aside`
        """
        return self._threads.submit(self._try, dataset, shard, values, folder)

    def _try(self, *given) -> Written:
        try:
            return self._write(*given)
        except Exception as error:
            return Failure.of(error)

    def _write(self, dataset: Dataset, shard: int, values: Mapping[str, Sequence], folder: Path) -> Written:
        return write_aside(dataset, shard, values, folder)

    def close(self):
        """Drop what waits to be written, and wait for the rest."""
        self._threads.shutdown(cancel_futures=True)


class WritingProcesses(WritingThreads):
    """Processes that write for this one, each for one of its threads. They end with this process."""

    def __init__(self, count: int = PROCESSES):
        super().__init__(count)
        self._own = threading.local()
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload([__name__])  # otherwise each process takes a second for its imports

    def _write(self, dataset: Dataset, shard: int, values: Mapping[str, Sequence], folder: Path) -> Written:
        """Send the values to this thread's process, without a copy that would take Python's lock, and let it write."""
        arrays = {name: np.stack(of_presses) for name, of_presses in values.items()}
        kinds = {name: (array.dtype.str, array.shape) for name, array in arrays.items()}
        contents = [array.view(np.uint8).reshape(-1) for array in arrays.values()]
        connection = self._connection()
        try:
            connection.send((dataset.path, shard, kinds, folder))
            for content in contents:
                connection.send_bytes(content)
            return connection.recv()
        except (EOFError, ConnectionError):
            self._own.close()
            self._own.process.join()
            raise RuntimeError("the process that wrote it died, killed or out of memory") from None

    def _connection(self):
        """The connection to this thread's process, which starts now if there is none."""
        if not hasattr(self._own, "process") or not self._own.process.is_alive():
            connection, there = self._context.Pipe()
            process = self._context.Process(target=_serve, args=(there,))
            try:
                process.start()
            except OSError as error:  # no error of the dataset's disk
                raise RuntimeError(f"no process to write: {error}") from None
            there.close()
            self._own.connection, self._own.process = connection, process
            # The process ends when the pipe is closed. Python would otherwise wait for it at its own end.
            self._own.close = multiprocessing.util.Finalize(None, connection.close, exitpriority=1)
        return self._own.connection


def _serve(connection):
    """Write the values of one shard after another, until the other end of the connection is closed."""
    while True:
        try:
            path, shard, kinds, folder = connection.recv()
            values = {name: np.frombuffer(connection.recv_bytes(), kind).reshape(shape)
                      for name, (kind, shape) in kinds.items()}  # fmt: skip
        except EOFError:
            return
        try:
            connection.send(write_aside(_opened(path, version_of(path)), shard, values, folder))
        except Exception as error:
            connection.send(Failure.of(error))


@lru_cache(maxsize=1)
def _opened(path: Path, version: tuple[int, int] | None) -> Dataset:
    return Dataset(path)


def version_of(path: Path) -> tuple[int, int] | None:
    """Inode and time of change of a dataset's zarr.json; None without such a file, which `Dataset` then reports.

    Another run may have put another dataset at the same path.
    """
    found = os.stat(file) if (file := path / "zarr.json").is_file() else None
    return found and (found.st_ino, found.st_mtime_ns)


@contextmanager
def writing() -> Iterator[WritingThreads]:
    """Yield what writes a task's results: threads that end with the task, or the processes of all tasks."""
    if BY_PROCESSES:
        yield processes()
        return
    threads = WritingThreads()
    try:
        yield threads
    finally:
        threads.close()


@cache
def processes() -> WritingProcesses:
    """Processes that write for all tasks of this process."""
    return WritingProcesses()
