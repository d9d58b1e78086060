"""Compression and writing of results while presses are solved: in threads beside a CPU, in processes beside a GPU.

A thread that writes takes Python's lock, and the threads that feed a GPU wait for it. A shard of the paired job takes
0.16 s of the lock (one core of an AMD EPYC), and a GPU ends a shard every two seconds.
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
from tempfile import NamedTemporaryFile

import numpy as np

from simgen.dataset.atomic_files import Aside
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import write_aside
from simgen.errors import NOT_WRITABLE, InputError
from simgen.pipeline.forked_imports import CAN_FORK

WRITTEN_AT_ONCE = min(16, os.cpu_count() or 1)  # shards; each takes 0.2 s of a core and 0.1 GB for a sensor


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

    def __init__(self):
        self._threads = ThreadPoolExecutor(WRITTEN_AT_ONCE)

    def submit(self, dataset: Dataset, shard: int, values: Mapping[str, Sequence], folder: Path) -> "Future[Written]":
        """Begin to write files, not in their places yet. The result has them by path, or a failure.

        values : see `simgen.dataset.writer.write_aside`
        """
        return self._threads.submit(self._write, dataset, shard, values, folder)

    def _write(self, dataset: Dataset, shard: int, values: Mapping[str, Sequence], folder: Path) -> Written:
        try:
            return write_aside(dataset, shard, values, folder)
        except Exception as error:
            return Failure.of(error)

    def close(self):
        """Drop what waits to be written, and wait for the rest."""
        self._threads.shutdown(cancel_futures=True)


class WritingProcesses(WritingThreads):
    """Processes that write for this one, each for one of its threads. They end with it."""

    def __init__(self):
        super().__init__()
        self._own = threading.local()
        self._context = multiprocessing.get_context("forkserver" if CAN_FORK else "spawn")

    def _write(self, dataset: Dataset, shard: int, values: Mapping[str, Sequence], folder: Path) -> Written:
        try:
            return self._hand_over(dataset, shard, values, folder)
        except Exception as error:
            return Failure.of(error)

    def _start(self):
        """Start this thread's process. It ends when this end of its pipe is closed, or this process dies."""
        self._own.connection, there = self._context.Pipe()
        self._own.process = self._context.Process(target=_serve, args=(there,))
        self._own.process.start()
        there.close()
        # Before Python waits for its processes to end.
        multiprocessing.util.Finalize(None, self._own.connection.close, exitpriority=1)

    def _hand_over(self, dataset: Dataset, shard: int, values: Mapping[str, Sequence], folder: Path) -> Written:
        """Let this thread's process write. It gets large arrays as files, which are written without Python's lock."""
        if not hasattr(self._own, "process") or not self._own.process.is_alive():
            self._start()
        handed = {name: np.stack(of_presses) for name, of_presses in values.items()}
        for name in [name for name in handed if dataset.arrays[name].chunk]:
            with NamedTemporaryFile(dir=folder, suffix=".npy", delete=False) as file:
                np.save(file, handed[name])
            handed[name] = Path(file.name)
        try:
            self._own.connection.send((dataset.path, shard, handed, folder))
            return self._own.connection.recv()
        except (EOFError, ConnectionError):
            self._own.process.join()
            raise RuntimeError("the process that wrote it died, killed or out of memory") from None


def _serve(connection):
    """Write what comes, until the other end is closed."""
    while True:
        try:
            path, shard, handed, folder = connection.recv()
        except EOFError:
            return
        try:
            values = {name: _taken(value) if isinstance(value, Path) else value for name, value in handed.items()}
            connection.send(write_aside(_opened(path, version_of(path)), shard, values, folder))
        except Exception as error:
            connection.send(Failure.of(error))


def _taken(file: Path) -> np.ndarray:
    """Read an array from a file, and remove the file."""
    values = np.load(file)
    file.unlink()
    return values


@lru_cache(maxsize=1)
def _opened(path: Path, version: tuple[int, int] | None) -> Dataset:
    return Dataset(path)


def version_of(path: Path) -> tuple[int, int] | None:
    """Inode and time of change of a dataset's zarr.json: another run may have put another dataset at the same path."""
    found = os.stat(file) if (file := path / "zarr.json").is_file() else None
    return found and (found.st_ino, found.st_mtime_ns)


@contextmanager
def writing(device: str) -> Iterator[WritingThreads]:
    """Yield what writes a task's results: threads that end with the task, or the processes of all tasks on a GPU.

    Processes write for workers that `simgen.pipeline.workers` has started. Those of another scheduler are daemons,
    which must not have processes. The command's own process may be a script that cannot be imported again.
    """
    if device != "cpu" and multiprocessing.parent_process() and not multiprocessing.current_process().daemon:
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
