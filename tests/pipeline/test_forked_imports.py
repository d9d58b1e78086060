"""Imports before a fork: a worker has them and uses one core, and nothing there has initialised Warp."""

import os
import signal
import subprocess
import sys
import time

import pytest

from simgen.pipeline.forked_imports import CAN_FORK, ENVIRONMENT, IMPORTED

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="this system has no safe fork")
SCRIPT = """
import multiprocessing, os, sys
from simgen.pipeline.forked_imports import start_imports

def look(found):
    import numpy as np
    import warp._src.context
    a = np.ones((600, 600))
    _ = a @ a  # starts the threads of a library that uses several
    there = {imported} <= set(sys.modules)
    found.put((there, warp._src.context.runtime is None, len(os.listdir("/proc/self/task"))))

if __name__ == "__main__":
    before = dict(os.environ)
    start_imports()
    start_imports()  # does nothing more
    context = multiprocessing.get_context("forkserver")
    found = context.SimpleQueue()
    context.Process(target=look, args=(found,)).start()
    print(*found.get(), "simgen.pipeline.shard" in sys.modules, before == dict(os.environ))
"""


@pytest.fixture
def environment() -> dict[str, str]:
    """Variables of a user who has not set the number of threads."""
    return {name: value for name, value in os.environ.items() if name not in ENVIRONMENT}


def test_a_worker_has_the_imports_and_one_thread_and_the_caller_has_neither(tmp_path, environment):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(imported={*IMPORTED, "distributed", "simgen.pipeline.shard"}))
    command = [sys.executable, script]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True)
    assert ended.stdout.split() == ["True", "True", "1", "False", "True"], ended.stderr


COPY = """
import multiprocessing, os, signal, sys, time
from simgen.pipeline.forked_imports import start_imports

def write(found):
    found.put(os.getppid())

def look(found):
    context = multiprocessing.get_context("forkserver")  # a worker starts processes that write in this way
    inner = context.SimpleQueue()
    context.Process(target=write, args=(inner,)).start()
    found.put((os.getppid(), inner.get() not in (os.getpid(), os.getppid())))

def wait(begun):
    begun.put(True)
    time.sleep(60.0)

if __name__ == "__main__":
    print("once")
    signal.signal(signal.SIGTERM, lambda *_: print("terminated"))
    reading, writing = os.pipe()
    before = multiprocessing.util.spawnv_passfds
    start_imports(as_copy=True)
    os.close(writing)
    os.read(reading, 1)  # returns if no other process has a copy of the descriptor
    context = multiprocessing.get_context("forkserver")
    found = context.SimpleQueue()
    context.Process(target=look, args=(found,)).start()
    server, fresh = found.get()
    command = open(f"/proc/{server}/cmdline").read().split(chr(0))
    waiting = context.Process(target=wait, args=(found,))
    waiting.start()
    found.get()
    waiting.terminate()
    waiting.join()
    print(sys.argv[0] in command, fresh, multiprocessing.util.spawnv_passfds is before, waiting.exitcode)
"""
FAILING = """
import multiprocessing.forkserver
from simgen.pipeline.forked_imports import start_imports

def fail(*_, **more):
    raise ZeroDivisionError("no server")

if __name__ == "__main__":
    multiprocessing.forkserver.main = fail
    start_imports(as_copy=True)
"""


def test_the_process_that_workers_are_forked_from_can_be_a_copy_of_the_caller(tmp_path, environment):
    """It keeps no file, buffer or signal handler. Workers can start processes. It ends with the caller."""
    script = tmp_path / "script.py"
    script.write_text(COPY)
    command, environment = [sys.executable, script], environment | {"PYTHONUNBUFFERED": ""}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True)
    assert ended.stdout.split() == ["once", "True", "True", "True", str(-signal.SIGTERM)], ended.stderr


def test_an_error_of_the_copy_is_printed(tmp_path, environment):
    script = tmp_path / "script.py"
    script.write_text(FAILING)
    command = [sys.executable, script]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True)
    assert ended.stderr.count("ZeroDivisionError: no server") == 1


THREAD = "import threading, time; threading.Thread(target=time.sleep, args=(1,)).start()"
DRIVER = """
import ctypes, mmap
from types import SimpleNamespace
file = open({path!r}, "w+b")
file.write(b".")
file.flush()
mapped = mmap.mmap(file.fileno(), 1)  # as the driver would be
ctypes.CDLL = lambda name: SimpleNamespace(cuDeviceGetCount=lambda count: {error})
"""


@pytest.mark.parametrize(("prepare", "can"), [
    ("", True), (THREAD, False), (DRIVER.replace("{error}", "3"), True), (DRIVER.replace("{error}", "0"), False),
])  # fmt: skip
def test_a_process_with_threads_or_with_cuda_is_not_copied(prepare, can, tmp_path, environment):
    """Error 3 means that nothing has initialised CUDA yet."""
    look = "from simgen.pipeline.forked_imports import can_be_copied; print(can_be_copied())"
    prepare = prepare.format(path=str(tmp_path / "libcuda.so.1"))
    command = [sys.executable, "-c", f"{prepare}\n{look}"]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True)
    assert ended.stdout.split() == [str(can)], ended.stderr


def test_an_interrupt_while_workers_import_prints_no_traceback(environment):
    """A terminal interrupts all processes of a command."""
    waits = "from simgen.pipeline.forked_imports import start_imports as s; import time; s(); print(1, flush=True)"
    command = [sys.executable, "-c", f"{waits}; time.sleep(60)"]
    process = subprocess.Popen(command, env=environment, start_new_session=True, text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)  # fmt: skip
    assert process.stdout.readline() == "1\n"
    time.sleep(0.3)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert errors.count("Traceback") == 1 and errors.rstrip().endswith("KeyboardInterrupt")  # the caller's own
