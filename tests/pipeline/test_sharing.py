"""Sharing of tasks: who gets the next one."""

from collections import Counter

import pytest

from simgen.pipeline import sharing
from simgen.pipeline.sharing import AT_ONCE, Sharing


class Client:
    """dask's client, with what workers tell of their rooms by address."""

    def __init__(self, **told):
        self.told, self.looks = told, 0

    def nthreads(self):
        return dict.fromkeys(self.told, 1)

    def run(self, function, workers, on_error):
        assert on_error == "return" and set(workers) <= set(self.told)
        self.looks += 1
        return {address: self.told[address] for address in workers}


@pytest.fixture(autouse=True)
def looks_each_time(monkeypatch):
    monkeypatch.setattr(sharing, "LOOK_S", 0.0)


def addresses(shared: Sharing, idle=False) -> Counter:
    return Counter(address for _, address in shared.hand_out(idle))


def test_the_worker_with_most_room_gets_the_next_task_until_none_has_room():
    shared = Sharing(Client(a=(0, 1), b=(0, 3)), range(10), None)
    assert [*shared.hand_out(False)] == [(0, "b"), (1, "b"), (2, "a"), (3, "b")] and shared.left


def test_tasks_that_have_not_begun_take_room():
    client = Client(a=(0, 3))
    shared = Sharing(client, range(10), None)
    assert addresses(shared) == {"a": 3}
    assert addresses(shared) == {}
    client.told = {"a": (1, 3)}  # two are on their way
    assert addresses(shared) == {"a": 1}
    client.told = {"a": (9, 3)}  # five of another worker, which was lost, have begun here
    assert addresses(shared) == {"a": 3}


def test_an_idle_run_hands_out_one_task_whatever_workers_tell():
    shared = Sharing(Client(a=(0, -1), b=(0, 0)), range(3), None)
    assert addresses(shared) == {}
    assert addresses(shared, idle=True) == {"b": 1}


def test_without_workers_only_an_idle_run_hands_out_a_task():
    shared = Sharing(Client(), range(3), None)
    assert addresses(shared) == {} and addresses(shared, idle=True) == {None: 1}


@pytest.mark.parametrize("told", [None, OSError("lost")])
def test_a_worker_that_does_not_tell_its_room_has_few_tasks_at_a_time(told):
    shared = Sharing(Client(a=told), range(10), None)
    assert addresses(shared) == {"a": AT_ONCE}
    assert addresses(shared) == {}
    shared.end("a")
    assert addresses(shared) == {"a": 1}


def test_workers_are_not_asked_too_often_or_without_need(monkeypatch):
    client = Client(a=(0, 1))
    shared = Sharing(client, range(2), None)
    monkeypatch.setattr(sharing, "LOOK_S", 60.0)
    assert addresses(shared) == {"a": 1} and addresses(shared) == {} and client.looks == 1
    assert addresses(shared, idle=True) == {"a": 1} and not shared.left
    assert addresses(shared, idle=True) == {} and client.looks == 2


def test_tasks_are_taken_when_they_are_handed_out():
    """So a run can leave out those that are not needed any more, but for one."""
    taken = []
    shared = Sharing(Client(a=(0, 1)), (taken.append(number) or number for number in range(5)), None)
    assert shared.left and taken == [0]
    assert addresses(shared) == {"a": 1} and taken == [0]
