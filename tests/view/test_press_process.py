"""Commands of a worker process, over a pipe."""

import multiprocessing

import pytest

from simgen.view.press_events import Refused, Stopped
from simgen.view.press_process import Begin, Stop, serve
from view.live import job_at


@pytest.fixture
def started():
    """A function that starts a process for a device; returns the process and the connection to it."""
    spawn, processes = multiprocessing.get_context("spawn"), []

    def start(device="cpu"):
        connection, far = spawn.Pipe()
        process = spawn.Process(target=serve, args=(far, device), daemon=True)
        process.start()
        far.close()
        processes.append(process)
        return process, connection

    yield start
    for process in processes:
        process.kill()


def test_presses_that_were_stopped_before_they_begin_are_not_begun(started):
    _, connection = started()
    connection.send(Stop(1))
    connection.send(Begin(1, job_at(), "digit"))
    assert connection.poll(60.0) and connection.recv() == Stopped(1)


def test_a_device_that_is_not_there_is_refused(started):
    _, connection = started("cuda:77")
    connection.send(Begin(1, job_at(), "digit"))
    assert connection.poll(60.0)
    refused = connection.recv()
    assert isinstance(refused, Refused) and "allowed here: cpu" in refused.sentence


@pytest.mark.parametrize("end", ["a closed connection", "the command None"])
def test_the_process_ends(started, end):
    process, connection = started()
    connection.send(None) if end == "the command None" else connection.close()
    process.join(60.0)
    assert process.exitcode == 0
