"""Pressers: which pool of a sensor gets a task's presses, and how many pools there are."""

import fake
import numpy as np
import pytest

from simgen.pipeline import presser
from simgen.pipeline.presser import Pools, fem_presser


class CountingPool:
    def __init__(self, remaining=0, environments=8, waiting=0, arrived=0):
        self.remaining, self.environments, self.waiting, self.arrived = remaining, environments, waiting, arrived

    def press(self, shape_of, poses, steps):
        self.remaining += len(shape_of)
        return self


def test_presses_go_to_the_pool_with_the_fewest():
    first, second = CountingPool(3), CountingPool()
    pools = Pools([first, second])
    taken = [pools.press([0] * count, np.eye(4), np.ones(count)) for count in (2, 2, 1, 1)]
    assert taken == [second, second, first, first] and (first.remaining, second.remaining) == (5, 4)


def test_there_is_room_until_as_many_presses_wait_as_one_pool_has_environments():
    """The presses that wait are those of both pools."""
    assert Pools([CountingPool()]).room == 8
    assert Pools([CountingPool(waiting=1, arrived=2), CountingPool(waiting=1)]).room == 5
    assert Pools([CountingPool(waiting=9)]).room == -1


@pytest.mark.parametrize(
    ("device", "batch", "room", "pools"),
    [("cuda", 2, True, 2), ("cuda", 2, False, 1), ("cuda", 12, True, 1), ("cpu", 2, True, 1)],
)
def test_a_gpu_with_room_has_two_pools_for_more_presses_than_one_holds(monkeypatch, device, batch, room, pools):
    made, beside, job = [], [], fake.make_job()
    assert job.presses == 12
    monkeypatch.setattr(presser, "presses_at_once", lambda *_: batch)
    monkeypatch.setattr(presser, "has_room_for_another", lambda *_: room)
    monkeypatch.setattr(presser, "load_kernels", lambda device: None)
    monkeypatch.setattr(presser, "Scene", lambda *_: type("Scene", (), {"unknowns": 7}))

    def make_pool(*given):
        beside.append(given[-1])
        made.append(CountingPool())
        return made[-1]

    monkeypatch.setattr(presser, "Pool", make_pool)
    press = fem_presser(job, "digit", device)
    assert len(made) == pools and beside == [None, *made][:pools]
    for _ in range(2):
        press([0, 0], np.stack([np.eye(4)] * 2))
        assert presser.POOLS_BY_SENSOR["digit"]._pools == made
    assert sum(pool.remaining for pool in made) == 4 and {pool.remaining for pool in made} == {4 // pools}
