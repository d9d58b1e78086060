"""Sharing of tasks: who gets the next one."""

from collections import Counter

import pytest

from simgen.pipeline import sharing
from simgen.pipeline.sharing import AT_ONCE, Sharing


class Told:
    """Rooms that workers tell, by address."""

    def __init__(self, **told):
        self.told, self.looks = told, 0

    def ask(self, addresses):
        assert addresses == list(self.told)
        self.looks += 1
        return self.told


def share(tasks, told: Told) -> Sharing:
    return Sharing(tasks, lambda: told.told, told.ask)


@pytest.fixture(autouse=True)
def looks_each_time(monkeypatch):
    monkeypatch.setattr(sharing, "LOOK_S", 0.0)


def addresses(shared: Sharing, idle=False) -> Counter:
    return Counter(address for _, address in shared.hand_out(idle))


def test_the_worker_with_most_room_gets_the_next_task_until_none_has_room():
    shared = share(range(10), Told(a=(0, 1), b=(0, 3)))
    assert [*shared.hand_out(False)] == [(0, "b"), (1, "b"), (2, "a"), (3, "b")] and shared.left


def test_tasks_that_have_not_begun_take_room():
    told = Told(a=(0, 3))
    shared = share(range(10), told)
    assert addresses(shared) == {"a": 3}
    assert addresses(shared) == {}
    told.told = {"a": (1, 3)}  # two are on their way
    assert addresses(shared) == {"a": 1}
    told.told = {"a": (9, 3)}  # five of another worker have begun here
    assert addresses(shared) == {"a": 3}


def test_tasks_that_end_without_having_begun_take_no_room():
    """They fail before, or another worker takes them."""
    shared = share(range(10), Told(a=(0, 2)))
    for _ in range(3):
        assert addresses(shared) == {"a": 2}
        shared.end("a")
        shared.end("a")


def test_an_idle_run_hands_out_one_task_whatever_workers_tell():
    shared = share(range(3), Told(a=(0, -1), b=(0, 0)))
    assert addresses(shared) == {}
    assert addresses(shared, idle=True) == {"b": 1}


def test_without_workers_only_an_idle_run_hands_out_a_task():
    shared = share(range(3), Told())
    assert addresses(shared) == {} and addresses(shared, idle=True) == {None: 1}


@pytest.mark.parametrize("told", [None, OSError("lost")])
def test_a_worker_that_does_not_tell_its_room_has_few_tasks_at_a_time(told):
    shared = share(range(10), Told(a=told))
    assert addresses(shared) == {"a": AT_ONCE}
    assert addresses(shared) == {}
    shared.end("a")
    assert addresses(shared) == {"a": 1}


def test_workers_are_not_asked_too_often_or_without_need(monkeypatch):
    told = Told(a=(0, 1))
    shared = share(range(2), told)
    monkeypatch.setattr(sharing, "LOOK_S", 60.0)
    assert addresses(shared) == {"a": 1} and addresses(shared) == {} and told.looks == 1
    assert addresses(shared, idle=True) == {"a": 1} and not shared.left
    assert addresses(shared, idle=True) == {} and told.looks == 2


def test_tasks_are_taken_when_they_are_handed_out():
    """So a run can leave out those that are not needed any more, but for one."""
    taken = []
    shared = share((taken.append(number) or number for number in range(5)), Told(a=(0, 1)))
    assert shared.left and taken == [0]
    assert addresses(shared) == {"a": 1} and taken == [0]
