"""A worker process that presses one sensor after commands, and keeps what decides its presses between them.

The process ends when its parent closes the connection, or dies: the thread that listens for commands then ends it, even
while kernels run.
"""

import os
import signal
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from queue import SimpleQueue

import numpy as np

from simgen.config.job_schema import Job
from simgen.config.warp_device import check_device, start_warp
from simgen.errors import InputError
from simgen.fem.nonlinear.status import Status, has_values
from simgen.simulation.march import March
from simgen.view.press_events import DepthReached, PressEnded, Ready, Refused, Stopped, Touched
from simgen.view.press_inputs import PressInputs


@dataclass(frozen=True)
class Prepare:
    """Command: make the scene of a job's sensor."""

    job: Job
    sensor: str


@dataclass(frozen=True)
class Begin:
    """Command: press the first contact of a job with its first indenter on one of its sensors."""

    press: int
    job: Job
    sensor: str


@dataclass(frozen=True)
class Stop:
    """Command: end all presses up to this number."""

    press: int


class _Mailbox:
    """Commands that have arrived, with their times, and the number up to which presses are stopped.

    The command None, or the end of the connection, ends the process.
    """

    def __init__(self, connection: Connection):
        self.stopped = 0
        self.commands: SimpleQueue[tuple[float, Prepare | Begin]] = SimpleQueue()
        self._connection = connection
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        try:
            while (command := self._connection.recv()) is not None:
                if isinstance(command, Stop):
                    self.stopped = max(self.stopped, command.press)
                else:
                    self.commands.put((time.perf_counter(), command))
        finally:  # whatever happens: without this thread, nothing would end the process
            os._exit(0)


def serve(connection: Connection, device: str):
    """Obey commands until the process ends. The target of `simgen.view.press_worker.PressWorker`'s process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal interrupts the whole process group; the parent answers
    mailbox = _Mailbox(connection)
    start_warp()
    inputs = PressInputs(device)
    while True:
        begin, command = mailbox.commands.get()
        number = command.press if isinstance(command, Begin) else 0
        try:
            check_device(device)
            if isinstance(command, Prepare):
                inputs.prepare(command.job, command.sensor)
                connection.send(Ready(command.sensor, time.perf_counter() - begin))
            else:
                _press(command, inputs, mailbox, connection, begin)
        except InputError as error:
            connection.send(Refused(number, str(error)))
        except (BrokenPipeError, ConnectionResetError):
            return  # the parent has died


def _press(command: Begin, inputs: PressInputs, mailbox: _Mailbox, connection: Connection, begin: float):
    """Press, and send each event as it happens."""
    number, march, send = command.press, None, connection.send
    if mailbox.stopped < number:
        march = inputs.march(command.job, command.sensor)
        if march.touch_pose is not None:
            send(Touched(number, march.touch_pose))
    while mailbox.stopped < number and march.under_way:
        for sample in march.advance():
            send(DepthReached(number, sample.step, sample.outputs, time.perf_counter() - begin))
    if march is None or march.under_way:
        send(Stopped(number))
        return
    send(_end(number, march, time.perf_counter() - begin))


def _end(number: int, march: March, seconds: float) -> PressEnded:
    result = march.result
    reached = int(np.count_nonzero(has_values(result.status)))
    status = Status(int(result.status[reached])) if reached < len(result.status) else Status.CONVERGED
    return PressEnded(number, int(status), status.sentence, reached, float(result.touch), seconds)
