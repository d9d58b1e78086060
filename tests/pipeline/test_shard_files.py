"""Writing of results: threads and processes write the same bytes, tell failures, and end with their parent."""

import os
import signal
import subprocess
import sys
import threading

import fake
import psutil
import pytest

from simgen.dataset.reader import Dataset
from simgen.dataset.writer import create, folder_aside
from simgen.pipeline import shard_files
from simgen.pipeline.shard_files import WritingProcesses, WritingThreads, writing


@pytest.fixture
def dataset(tmp_path):
    plan = fake.make_plan(fake.make_job())
    create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    return Dataset(tmp_path / "d.zarr")


def results(dataset: Dataset, build=fake.fake_presser) -> dict[str, list]:
    """Values of the first shard on the first sensor, by array."""
    presses, sensor = list(dataset.shard_presses(0)), dataset.sensors[0]
    indenters, poses = dataset["press/indenter"][presses].tolist(), dataset["press/contact_pose"][presses]
    pressed = build(dataset.job, sensor, "cpu")(indenters, poses)
    names = (output.name for output in dataset.job.kept_outputs(sensor))
    return {f"{sensor}/{name}": [result.outputs[name] for result in pressed] for name in names}


@pytest.fixture(params=[WritingThreads, WritingProcesses])
def threads(request):
    made = request.param(1)
    yield made
    made.close()


def written(dataset: Dataset, values, threads: WritingThreads) -> dict[str, bytes] | str:
    """Contents of the shard's files by path, or the sentence of the failure."""
    with folder_aside(dataset) as folder:
        files = threads.submit(dataset, 0, values, folder).result(60.0)
        if not isinstance(files, dict):
            return files.sentence
        assert {file.temporary for file in files.values()} == set(folder.iterdir()) - {folder / ".lock"}
        return {path: file.temporary.read_bytes() for path, file in files.items()}


@pytest.mark.parametrize("build", [fake.fake_presser, fake.missing_presser])
def test_processes_write_the_bytes_of_threads(dataset, build):
    values = results(dataset, build)
    files = [written(dataset, values, kind(1)) for kind in (WritingThreads, WritingProcesses)]
    assert len(files[0]) >= len(values) and files[0] == files[1]


def test_a_failure_comes_back_as_a_sentence(dataset, threads):
    values = results(dataset)
    [name] = [name for name in values if name.endswith("displacement")]
    for each in values[name]:
        each[:] = 1.0
    failure = written(dataset, values, threads)
    assert "OverflowError" in failure and "displacement: 1 does not fit" in failure


def test_another_process_takes_the_place_of_a_dead_one(dataset, monkeypatch):
    own, values = WritingProcesses(1), results(dataset)
    files, connection, found = written(dataset, values, own), own._connection, threading.Event()

    def watched():
        there = connection()
        found.set()
        return there

    process = own._threads.submit(lambda: own._own.process).result()
    os.kill(process.pid, signal.SIGSTOP)  # it answers nothing until it is killed
    with monkeypatch.context() as patch:
        patch.setattr(own, "_connection", watched)
        pending = own.submit(dataset, 0, values, dataset.path)
        assert found.wait(20.0)
        process.kill()
        assert "the process that wrote it died" in pending.result(20.0).sentence
    assert written(dataset, values, own) == files
    own.close()


@pytest.mark.parametrize(("by_processes", "kind"), [(True, WritingProcesses), (False, WritingThreads)])
def test_all_tasks_of_a_worker_share_its_processes_and_threads_end_with_their_task(monkeypatch, by_processes, kind):
    monkeypatch.setattr(shard_files, "BY_PROCESSES", by_processes)
    with writing() as threads, writing() as again:
        assert type(threads) is kind and (threads is again) == by_processes
    if not by_processes:
        with pytest.raises(RuntimeError, match="after shutdown"):
            threads.submit(None, 0, {}, None)


def test_processes_end_when_their_parent_is_killed():
    code = "import time; from simgen.pipeline.shard_files import WritingProcesses\n"
    code += "own = WritingProcesses(); own._threads.submit(own._connection).result()\n"
    code += "print(own._threads.submit(lambda: own._own.process.pid).result(), flush=True); time.sleep(600)"
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        child = psutil.Process(int(parent.stdout.readline()))
    finally:
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()
    child.wait(timeout=20.0)


SCRIPT = """
import multiprocessing, sys
from pathlib import Path
import numpy as np
from simgen.dataset.reader import Dataset
from simgen.pipeline.shard_files import processes

if __name__ == "__main__":
    multiprocessing.set_start_method("forkserver")
    dataset, folder = Dataset(Path(sys.argv[1])), Path(sys.argv[2])
    names = [f"{dataset.sensors[0]}/{name}" for name in ("force", "displacement")]
    presses = len(dataset.shard_presses(0))
    values = {name: np.zeros((presses, *dataset.arrays[name].shape)) for name in names}
    print(processes().submit(dataset, 0, values, folder).result())
"""


def test_processes_end_with_their_parent_and_leave_nothing(dataset, tmp_path):
    """numcodecs gives each process a lock, and Python reports locks that nobody has freed."""
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, tmp_path / "script.py", dataset.path, tmp_path]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60.0)
    assert ended.returncode == 0 and "Aside(" in ended.stdout and not ended.stderr
