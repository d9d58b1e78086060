"""Workers: a scheduler's address, what they say of themselves, and errors that come back as data."""

import json
import os
import threading
import time
from collections import Counter
from functools import partial
from itertools import pairwise

import fake
import numpy as np
import psutil
import pytest
from dask.distributed import Client

from pipeline.tasks import (
    LEAST_SHARED_S,
    fail_with,
    no_preparation,
    no_room,
    process_after,
    reciprocal,
    room_for_three,
    uneven_task,
    unknown_room,
)
from simgen.errors import InputError
from simgen.pipeline import workers
from simgen.pipeline.local_cluster import TASKS_PER_GPU_PROCESS, local_cluster
from simgen.pipeline.workers import Workers, scheduler_address, start_workers


def test_an_error_comes_back_in_place_of_a_result(client):
    found = dict(Workers("cpu", 2, lambda: (client, {})).map(reciprocal, [2, 0, 4]))
    assert isinstance(found.pop(0), ZeroDivisionError)
    assert found == {2: 0.5, 4: 0.25}


def test_all_arguments_have_their_results_however_many_there_are(client):
    numbers = list(range(1, 40))
    found = dict(Workers("cpu", 2, lambda: (client, {})).map(reciprocal, numbers))
    assert found == {number: 1.0 / number for number in numbers}


def test_no_more_is_submitted_than_workers_will_soon_take(client, monkeypatch):
    submitted, most = [], []
    submit = client.submit
    monkeypatch.setattr(client, "submit", lambda *a, **k: submitted.append(1) or submit(*a, **k))
    for finished, _ in enumerate(Workers("cpu", 2, lambda: (client, {})).map(reciprocal, list(range(1, 20)))):
        most.append(len(submitted) - finished)
    assert len(submitted) == 19 and max(most) == 4  # two threads, two tasks each


def test_they_say_where_they_are_and_how_many(client):
    about = Workers("cpu", 2, lambda: (client, {})).about
    assert about.startswith(f"2 workers with 2 threads at {client.scheduler.address}")
    assert Workers("cpu").about == "this process alone"


def test_the_address_of_a_scheduler_file(tmp_path):
    file = tmp_path / "scheduler.json"
    file.write_text(json.dumps({"type": "Scheduler", "address": "tcp://127.0.0.1:4711", "workers": {}}))
    assert scheduler_address(file) == "tcp://127.0.0.1:4711"


@pytest.mark.parametrize("text, words", [
    (None, "No such file"), ("", "no address in it"), ("[1]", "no address in it"), ("{}", "no address in it"),
    ('{"address": 5}', "no address in it"), ("\xff", "no address in it"),
])  # fmt: skip
def test_a_file_without_an_address_is_refused(tmp_path, text, words):
    file = tmp_path / "scheduler.json"
    if text is not None:
        file.write_bytes(text.encode("latin1"))
    with pytest.raises(InputError, match=f"scheduler file .*scheduler.json: {words}"):
        scheduler_address(file)


def test_a_worker_that_is_ready_first_does_not_get_the_task_of_another():
    """With a second thread it could: two tasks in one process, one after the other, and an idle process."""
    with local_cluster([{"CUDA_VISIBLE_DEVICES": name} for name in "01"]) as cluster, Client(cluster) as client:
        client.wait_for_workers(2)
        preparing = {client.submit(process_after, seconds, workers=[address], pure=False): address
                     for seconds, address in zip((0.1, 2.0), client.nthreads(), strict=True)}  # fmt: skip
        found = dict(Workers("cpu", 2, lambda: (client, preparing)).map(process_after, [1.0, 1.1]))
    assert found.keys() == {1.0, 1.1} and len(set(found.values())) == 2


def test_a_process_that_dies_while_it_is_prepared_does_not_hold_up_the_run(tmp_path, monkeypatch):
    """dask leaves the task of a dead process alone if no other one was there."""
    monkeypatch.setenv(fake.LAST_WORDS, str(tmp_path / "died"))
    found = {}

    def solve():
        with start_workers(fake.make_job(), count=1, build=fake.dying_presser) as started:
            found.update(started.map(reciprocal, [2, 4]))

    solving = threading.Thread(target=solve, daemon=True)
    solving.start()
    solving.join(timeout=60.0)
    assert found == {2: 0.5, 4: 0.25} and (tmp_path / "died").exists()


@pytest.mark.parametrize(("error", "words"), [
    (InputError("GPU 1: 0 GB of memory are free"), "^GPU 1: 0 GB of memory are free$"),
    (RuntimeError("out of memory"), "^a worker process could not be prepared: RuntimeError: out of memory$"),
])  # fmt: skip
def test_a_process_that_cannot_be_prepared_ends_the_run_before_it_takes_tasks(client, error, words):
    """Its tasks would fail at once, and it would soon have had them all."""
    preparing = {client.submit(fail_with, each, pure=False): address
                 for each, address in zip((None, error), client.nthreads(), strict=True)}  # fmt: skip
    with pytest.raises(InputError, match=words):
        next(Workers("cpu", 2, lambda: (client, preparing)).map(reciprocal, [2, 4]))


@pytest.mark.parametrize(("room", "at_once"), [(room_for_three, 3), (unknown_room, 2)])
def test_shared_tasks_go_to_the_processes_that_have_room(room, at_once):
    """One process takes fifteen times as long for each. It has as many at a time as it has room for, and gets fewer."""
    with local_cluster([{"CUDA_VISIBLE_DEVICES": name} for name in "01"]) as cluster, Client(cluster) as client:
        client.wait_for_workers(2)
        own, shared = [0.01] * 6, [LEAST_SHARED_S + 1e-6 * number for number in range(24)]
        workers = Workers("cuda", 2, lambda: (client, {}), tasks_at_once=TASKS_PER_GPU_PROCESS)
        found = list(workers.map(uneven_task, own, shared, room))
    assert sorted(argument for argument, _ in found) == [*own, *shared]
    results = [result for argument, result in found if argument in shared]
    for gpu in "01":
        times = [(begin, 1) for each, begin, _ in results if each == gpu]
        times += [(end, -1) for each, _, end in results if each == gpu]
        assert np.cumsum([change for _, change in sorted(times)]).max() == at_once
    counts = Counter(gpu for gpu, _, _ in results)
    assert counts["1"] >= at_once and counts["0"] >= 2 * counts["1"]


def test_shared_tasks_are_not_lost_if_no_worker_is_there_when_they_are_handed_out(monkeypatch):
    with local_cluster([{"CUDA_VISIBLE_DEVICES": "0"}]) as cluster, Client(cluster) as client:
        client.wait_for_workers(1)
        monkeypatch.setattr(client, "nthreads", dict)
        workers = Workers("cuda", 2, lambda: (client, {}), tasks_at_once=TASKS_PER_GPU_PROCESS)
        found = [argument for argument, _ in workers.map(uneven_task, [0.01, 0.02], [0.03, 0.04, 0.05], room_for_three)]
    assert sorted(found) == [0.01, 0.02, 0.03, 0.04, 0.05]


def test_shared_tasks_are_not_lost_if_no_worker_ever_has_room():
    """They come one after the other, when nothing else is under way."""
    with local_cluster([{"CUDA_VISIBLE_DEVICES": "0"}]) as cluster, Client(cluster) as client:
        client.wait_for_workers(1)
        workers = Workers("cuda", 1, lambda: (client, {}), tasks_at_once=TASKS_PER_GPU_PROCESS)
        found = list(workers.map(uneven_task, [0.3], [0.01, 0.02, 0.03], no_room))
    times = [result[1:] for _, result in found]
    assert [argument for argument, _ in found] == [0.3, 0.01, 0.02, 0.03]
    assert all(end <= begin for (_, end), (begin, _) in pairwise(times))


def test_a_silent_worker_is_not_waited_for(client, monkeypatch):
    addresses = list(client.nthreads())
    assert workers.ask(client, os.getpid, addresses).keys() == set(addresses)
    monkeypatch.setattr(workers, "LONGEST_ANSWER_S", 0.2)
    begin = time.monotonic()
    assert workers.ask(client, partial(time.sleep, 3.0), addresses) == {}
    assert time.monotonic() - begin < 2.5


def test_processes_of_gpus_start_while_the_caller_goes_on(monkeypatch):
    """No machine here has a GPU, so the processes are not prepared, but they start, solve and end."""
    monkeypatch.setattr(workers, "prepare", no_preparation)
    monkeypatch.setattr(workers, "check_device", lambda device: None)
    monkeypatch.setattr(workers, "visible_gpus", lambda device: ["3", "5"])
    local, goes_on, copies = workers.local_cluster, threading.Event(), []

    def late(environments):
        assert goes_on.wait(timeout=60.0)
        return local(environments)

    monkeypatch.setattr(workers, "local_cluster", late)
    monkeypatch.setattr(workers, "start_imports", lambda as_copy: copies.append(as_copy))
    with start_workers(fake.make_job(), "cuda", build=fake.fake_presser) as started:
        goes_on.set()
        assert dict(started.map(reciprocal, [2, 4])) == {2: 0.5, 4: 0.25}
        assert started.count == 2 and started.tasks_at_once == TASKS_PER_GPU_PROCESS
        client, _ = started.started
    assert client.status == "closed" and copies == [True]


def test_workers_for_cpus_are_not_forked_from_a_copy(monkeypatch):
    """They would use all cores for linear algebra, as the caller does."""
    copies = []
    monkeypatch.setattr(workers, "start_imports", lambda as_copy: copies.append(as_copy))
    with start_workers(fake.make_job(), count=1, build=fake.fake_presser):
        assert copies == [False]


def test_processes_end_while_the_caller_goes_on():
    with start_workers(fake.make_job(), count=2, build=fake.fake_presser) as started:
        processes = [psutil.Process(pid) for pid in started.started[0].run(os.getpid).values()]
        started.begin_to_close()
        assert len(processes) == 2 and not psutil.wait_procs(processes, timeout=60.0)[1]


def test_an_error_of_closing_reaches_the_caller():
    with pytest.raises(ZeroDivisionError), start_workers(fake.make_job(), count=1, build=fake.fake_presser) as started:
        started.close = lambda: reciprocal(0)
        started.begin_to_close()


def test_a_caller_that_fails_while_processes_of_gpus_start_leaves_none(monkeypatch):
    monkeypatch.setattr(workers, "check_device", lambda device: None)
    monkeypatch.setattr(workers, "visible_gpus", lambda device: ["3"])
    with local_cluster([{}]):  # the process that workers are forked from is there, and stays
        pass
    before = set(psutil.Process().children(recursive=True))
    with pytest.raises(ZeroDivisionError), start_workers(fake.make_job(), "cuda", build=fake.fake_presser):
        reciprocal(0)
    assert set(psutil.Process().children(recursive=True)) <= before


def test_a_failure_after_processes_of_gpus_have_started_leaves_none(monkeypatch):
    monkeypatch.setattr(workers, "check_device", lambda device: None)
    monkeypatch.setattr(workers, "visible_gpus", lambda device: ["3"])
    with (
        pytest.raises(ZeroDivisionError),
        start_workers(fake.make_job(), "cuda", build=fake.fake_presser) as started,
    ):
        [process] = started.started[0].run(os.getpid).values()
        reciprocal(0)
    assert not psutil.pid_exists(process)
