"""Presses on a worker process: the server asks for them, and polls for events while it serves pages."""

import multiprocessing
import threading
from contextlib import suppress
from queue import Empty, SimpleQueue

from simgen.config.job_schema import Job
from simgen.view.press_events import Event, Lost
from simgen.view.press_process import Begin, Prepare, Stop, serve

LONGEST_END_S = 5.0  # for the process to end


class PressWorker:
    """A process that presses one sensor at a time. It lives until `close`, or until this process dies.

    The process starts at once and takes about two seconds, in which commands already queue.
    """

    def __init__(self, device: str = "cpu"):
        spawn = multiprocessing.get_context("spawn")  # a fork would share threads' locks and Warp's state
        self._connection, far = spawn.Pipe()
        self._process = spawn.Process(target=serve, args=(far, device), daemon=True)
        self._process.start()
        far.close()
        self._number, self._closed = 0, False
        self._arrived: SimpleQueue[Event] = SimpleQueue()
        # Large events would fill the pipe and make the worker wait if only `poll` emptied it.
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def prepare(self, job: Job, sensor: str):
        """Make the scene of a job's sensor before the first press. A `Ready` or `Refused` follows."""
        self._send(Prepare(job, sensor))

    def press(self, job: Job, sensor: str) -> int:
        """Press the first contact of a job on one of its sensors with its first indenter; returns the press's number.

        An earlier press that is still under way is stopped.
        """
        self.stop()
        self._number += 1
        self._send(Begin(self._number, job, sensor))
        return self._number

    def stop(self):
        """Stop all presses between two Newton iterations. A `Stopped` follows for each that had not ended."""
        self._send(Stop(self._number))

    def poll(self) -> list[Event]:
        """Give the events that have arrived since the last call, in order. Does not wait."""
        events = []
        with suppress(Empty):
            while True:
                events.append(self._arrived.get_nowait())
        return events

    def close(self):
        """End the process, also within a press. Later calls of other methods do nothing."""
        self._closed = True
        self._process.kill()  # it writes no files
        self._process.join()
        self._reader.join()
        self._connection.close()

    def _send(self, command: Prepare | Begin | Stop | None):
        with suppress(OSError):  # the process has ended; `Lost` says so
            self._connection.send(command)

    def _read(self):
        try:
            while True:
                self._arrived.put(self._connection.recv())
        except (EOFError, OSError):
            self._process.join(LONGEST_END_S)
            if not self._closed:
                self._arrived.put(Lost(f"the worker process has ended with exit code {self._process.exitcode}"))
