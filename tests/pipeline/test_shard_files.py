"""Writing of results: threads and processes write the same bytes, tell failures, and end with their parent."""

import multiprocessing
import os
import signal
import subprocess
import sys

import fake
import numpy as np
import psutil
import pytest

from simgen.dataset.reader import Dataset
from simgen.dataset.writer import create, folder_aside
from simgen.pipeline import shard_files
from simgen.pipeline.shard_files import WritingProcesses, WritingThreads, processes, writing


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


def written(dataset: Dataset, values, device: str) -> dict[str, bytes] | str:
    """Contents of the shard's files by path, or the sentence of the failure."""
    own = processes() if device == "cuda" else WritingThreads()
    with folder_aside(dataset) as folder:
        files = own.submit(dataset, 0, values, folder).result(60.0)
        if not isinstance(files, dict):
            return files.sentence
        assert not list(folder.glob("*.npy"))
        return {path: file.temporary.read_bytes() for path, file in files.items()}


@pytest.mark.parametrize("build", [fake.fake_presser, fake.missing_presser])
def test_processes_write_the_bytes_of_threads(dataset, build):
    values = results(dataset, build)
    files = written(dataset, values, "cpu")
    assert len(files) >= len(values) and written(dataset, values, "cuda") == files


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_a_failure_is_told(dataset, device):
    values = results(dataset)
    [name] = [name for name in values if name.endswith("displacement")]
    for each in values[name]:
        each[:] = 1.0
    assert "OverflowError" in (told := written(dataset, values, device)) and "displacement: 1 does not fit" in told


def test_another_process_takes_the_place_of_a_dead_one(dataset, monkeypatch):
    monkeypatch.setattr(shard_files, "WRITTEN_AT_ONCE", 1)
    processes.cache_clear()
    own, values = processes(), results(dataset)
    files, save = written(dataset, values, "cuda"), np.save

    def kill_and_save(file, array):
        own._own.process.kill()
        own._own.process.join()
        save(file, array)

    monkeypatch.setattr(shard_files.np, "save", kill_and_save)
    assert "the process that wrote it died" in written(dataset, values, "cuda")
    monkeypatch.setattr(shard_files.np, "save", save)
    assert written(dataset, values, "cuda") == files
    processes.cache_clear()


@pytest.mark.parametrize(("device", "parent", "daemon", "kind"), [
    ("cuda", "a", False, WritingProcesses), ("cpu", "a", False, WritingThreads), ("cuda", "a", True, WritingThreads),
    ("cuda", None, False, WritingThreads),
])  # fmt: skip
def test_processes_write_for_a_worker_on_a_gpu_that_may_have_them(monkeypatch, device, parent, daemon, kind):
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: parent)
    monkeypatch.setattr(multiprocessing.current_process(), "_config", {"daemon": daemon})
    with writing(device) as threads, writing(device) as again:
        assert type(threads) is kind and (threads is again) == (kind is WritingProcesses)


def test_processes_end_when_their_parent_is_killed():
    code = "import time; from simgen.pipeline.shard_files import processes\n"
    code += "own = processes(); own._threads.submit(own._start).result()\n"
    code += "print(own._threads.submit(lambda: own._own.process.pid).result(), flush=True); time.sleep(600)"
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    child = psutil.Process(int(parent.stdout.readline()))
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
    name = f"{dataset.sensors[0]}/force"
    values = np.zeros((len(dataset.shard_presses(0)), *dataset.arrays[name].shape))
    print(processes().submit(dataset, 0, {name: values}, folder).result())
"""


def test_processes_end_with_their_parent_and_leave_nothing(dataset, tmp_path):
    """numcodecs gives each process a lock, and Python reports locks that nobody has freed."""
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, tmp_path / "script.py", dataset.path, tmp_path]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60.0)
    assert ended.returncode == 0 and "Aside(" in ended.stdout and not ended.stderr
