"""Pools: tasks that share load stepping get the same results as alone, never wait for each other, end on errors."""

import threading
import time
import weakref
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from itertools import count

import numpy as np
import pytest

import simgen.simulation.pool
from simgen.fem.device import DEVICE
from simgen.pipeline.presser import Pools
from simgen.simulation.pool import CREW, FREED, MANY, POOLS, THREADS, Pool, _give_back, _take
from simgen.simulation.press import Scene, follow
from simulation.blocks import CUBE, GEL, SPHERE, make_block, pose

PATH = np.array([[0.0, 0.2e-3, 0.0], [0.0, 0.4e-3, 0.0]])
POSES = np.concatenate([pose(), pose(x=1.0), pose(tilt_deg=5.0), pose(x=-1.0)])


def make_pool(block, batch, beside=None):
    return Pool(Scene(block, GEL, batch=batch), [SPHERE, CUBE], PATH, np.zeros(2), np.inf, beside)


def press(pool, first, last):
    """Add presses at `POSES`, with the two shapes in turns."""
    return pool.press([i % 2 for i in range(first, last)], POSES[first:last], np.full(last - first, 2))


@pytest.mark.parametrize("batch", [1, 3])
def test_tasks_side_by_side_give_the_bytes_of_each_alone(block, batch):
    alone = follow(Scene(block, GEL), [SPHERE, CUBE, SPHERE, CUBE], POSES, PATH)
    pool = make_pool(block, batch)
    with ThreadPoolExecutor(2) as threads:
        tasks = list(threads.map(lambda task: list(press(pool, *task)), [(0, 2), (2, 4)]))
    for one, other in zip(alone, [*tasks[0], *tasks[1]], strict=True):
        np.testing.assert_array_equal(one.displacement, other.displacement)
        np.testing.assert_array_equal(one.force, other.force)
        assert one.touch == other.touch and other.seconds > 0.0


def test_two_pools_share_the_presses_of_a_task_and_give_the_bytes_of_each_alone(block, monkeypatch):
    """All arrive in the first pool. The second one has nothing left to do whenever the first took the last press."""
    alone = follow(Scene(block, GEL), [SPHERE, CUBE, SPHERE, CUBE], POSES, PATH)
    pool = make_pool(block, 1)
    other, tries = make_pool(block, 1, pool), Counter()
    assert pool._stepping.queue._shared.environments == 2
    for each in (pool, other):
        end = each._stepping._end
        monkeypatch.setattr(each._stepping, "_end", lambda *a, e=each, f=end, **k: tries.update([e]) or f(*a, **k))
    with ThreadPoolExecutor(2) as threads:
        tasks = list(threads.map(lambda task: list(press(pool, *task)), [(0, 2), (2, 4)]))
    for one, result in zip(alone, [*tasks[0], *tasks[1]], strict=True):
        np.testing.assert_array_equal(one.displacement, result.displacement)
        np.testing.assert_array_equal(one.force, result.force)
    assert tries[pool] and tries[other] and tries.total() == 4
    other.advance()
    assert not pool.remaining and not other.remaining


@pytest.mark.parametrize(("taken", "advanced"), [(False, False), (True, False), (False, True)])
def test_the_first_of_two_pools_leaves_environments_to_slow_presses_if_the_second_is_in_use(block, taken, advanced):
    """Between two iterations no thread has the second pool."""
    pool = make_pool(block, 4)
    other = make_pool(block, 4, pool)
    other.taken = taken
    if advanced:
        other.advance()
    tasks = [press(pool, 0, 4)]
    pool.advance()
    assert pool._stepping.running.sum() == (2 if taken or advanced else 4)  # two cubes, or all
    other.taken = False
    pool.advance()
    assert pool._stepping.running.sum() == 4  # the second pool has stopped
    for each in (pool, other):
        each.drop()
    with pytest.raises(RuntimeError, match="another task of this process has failed"):
        list(tasks[0])


def test_the_second_of_two_pools_takes_slow_presses_only_if_the_first_is_full(block):
    pool = make_pool(block, 2)
    other = make_pool(block, 2, pool)
    task = pool.press([1, 1, 1], POSES[:3], np.full(3, 2))  # cubes
    pool._begin_arrived()
    other.advance()
    assert not other.remaining and pool.remaining == 3  # so no thread waits busily with the second pool
    pool.advance()
    other.advance()
    assert (pool._stepping.running.sum(), other._stepping.running.sum()) == (2, 1)
    for each in (pool, other):
        each.drop()
    assert all(press.dropped for press in task.presses)


def test_the_kernels_of_a_sensor_s_first_pool_go_before_those_of_its_second_and_these_before_smaller_sensors(block):
    """Pools that have had presses, and have none, do not count."""
    idle, small = make_pool(make_block((8, 4, 2)), 1), make_pool(make_block((2, 4, 2)), 1)
    pool = make_pool(block, 1)
    other = make_pool(block, 1, pool)
    assert idle._place < pool._place < other._place < small._place
    before, idle._advances = pool._place, 1
    assert pool._place == before - 1


def test_a_pool_of_few_presses_goes_first_on_the_device_only_if_one_of_them_is_slow(block):
    """The block's cube counts as slow. Two pools with short presses take turns."""
    pool, spheres = make_pool(block, 2), make_pool(block, 2)
    ranks = [(pool.device_rank, spheres.device_rank)]
    tasks = [press(pool, 0, 2), spheres.press([0, 0], POSES[:2], np.full(2, 2))]
    for each in (pool, spheres):
        each.advance()
    ranks.append((pool.device_rank, spheres.device_rank))
    spheres._stepping.queue.learn(0, 1)
    spheres._stepping._try_iterations[:] = 3  # much longer than the only ended try
    ranks.append((pool.device_rank, spheres.device_rank))
    assert ranks == [(MANY, MANY), (2, MANY), (2, 2)]
    for each, results in zip((pool, spheres), tasks, strict=True):
        each.drop()
        assert all(one.dropped for one in results.presses)


def test_an_error_of_one_pool_ends_the_presses_that_another_one_would_have_taken(block, monkeypatch):
    """All threads wait until every pool has dropped its presses. Then the pools are sound."""
    pool = make_pool(block, 1)
    other = make_pool(block, 1, pool)

    def break_down(ended):
        raise MemoryError("no more")

    with monkeypatch.context() as patch:
        patch.setattr(other._stepping, "_accept_or_reject", break_down)
        with ThreadPoolExecutor(2) as threads:
            tasks = [threads.submit(lambda i: list(press(pool, i, i + 2)), i) for i in (0, 2)]
            errors = {type(task.exception(timeout=60.0)) for task in tasks}
    assert errors <= {MemoryError, RuntimeError} and MemoryError in errors
    assert not pool.remaining and not other.remaining
    assert (next(iter(press(other, 0, 1))).status == 0).all()


def test_results_keep_both_pools_alive(block):
    pool = make_pool(block, 1)
    results = Pools([pool, make_pool(block, 1, pool)]).press([0, 1, 0], POSES[:3], np.full(3, 2))
    second = weakref.ref(results.pools[1])
    del pool
    assert second() is not None and len(list(results)) == 3
    del results
    assert second() is None


def test_a_task_ends_while_a_hard_press_of_another_goes_on(block):
    """Three presses share the environment that the hard press leaves."""
    pool = make_pool(block, 2)
    settle = pool._stepping._accept_or_reject
    hard = press(pool, 0, 1)

    def never_ends(finished):
        settle(finished & np.array([each is not hard.presses[0] for each in pool._stepping.press]))

    pool._stepping._accept_or_reject = never_ends
    ended = list(press(pool, 1, 4))
    assert [result.status[-1] for result in ended] == [0, 0, 0]
    assert hard.presses[0].status is None and pool.remaining == 1
    pool.drop()  # or the tasks of other tests would carry it on


def test_the_pool_that_was_made_first_goes_first(block):
    first, second = make_pool(block, 1), make_pool(block, 2)
    waiting, ended = press(second, 0, 3), press(first, 0, 2)
    assert len(list(ended)) == 2
    assert second.remaining == 3 and waiting.presses is None  # nothing of the other has begun
    assert len(list(waiting)) == 3


def test_presses_of_many_tasks_begin_together_up_to_the_number_of_environments(block, monkeypatch):
    """Whole tasks begin. The first touches of all tasks are found by few calls."""
    pool, begun = make_pool(block, 3), []
    begin = simgen.simulation.pool.begin_presses

    def watch(stepping, shapes, shape_of, poses, steps):
        begun.append(len(shape_of))
        return begin(stepping, shapes, shape_of, poses, steps)

    monkeypatch.setattr(simgen.simulation.pool, "begin_presses", watch)
    tasks = [press(pool, 0, 2), press(pool, 2, 4), press(pool, 0, 1), press(pool, 1, 3)]
    assert pool.remaining == 7
    assert [len(list(task)) for task in tasks] == [2, 2, 1, 2]
    assert begun == [4, 3]


def test_an_error_ends_all_tasks_and_the_next_one_is_sound(block, monkeypatch):
    pool, other = make_pool(block, 2), make_pool(block, 1)
    first, second, third = press(pool, 0, 2), press(pool, 2, 4), press(other, 0, 1)
    with monkeypatch.context() as patch:

        def break_down(ended):
            raise MemoryError("no more")

        patch.setattr(pool._stepping, "_accept_or_reject", break_down)
        with pytest.raises(MemoryError):
            list(first)
    for task in (second, third):
        with pytest.raises(RuntimeError, match="another task of this process has failed"):
            list(task)
    assert not pool.remaining and not other.remaining
    [again] = press(pool, 0, 1)
    [alone] = follow(Scene(block, GEL), [SPHERE], POSES[:1], PATH)
    np.testing.assert_array_equal(again.displacement, alone.displacement)


def test_a_pool_that_nobody_has_is_no_pool_any_more(block):
    pool = make_pool(block, 1)
    assert pool in POOLS
    count = len(POOLS)
    del pool
    assert len(POOLS) == count - 1


def test_at_most_four_threads_carry_pools_on_and_the_others_sleep(block, monkeypatch):
    """Run ten tasks; none is lost when the thread that solved its presses leaves. The first four threads meet."""
    pool, carrying, most, asleep = make_pool(block, 2), set(), [], []
    advance, calls, meeting = simgen.simulation.pool._advance, count(), threading.Barrier(THREADS)

    def watch(results):
        carrying.add(threading.get_ident())
        if next(calls) < THREADS:
            meeting.wait(timeout=60.0)
        most.append(len(carrying))
        asleep.append(len(CREW._asleep))
        advance(results)
        carrying.remove(threading.get_ident())

    monkeypatch.setattr(simgen.simulation.pool, "_advance", watch)
    with ThreadPoolExecutor(10) as threads:
        tasks = list(threads.map(lambda i: list(press(pool, i % 4, i % 4 + 1)), range(10)))
    assert all((result.status == 0).all() for task in tasks for result in task)
    assert max(asleep) >= 4 and max(most) == THREADS
    assert not CREW._asleep and CREW._free == THREADS


def let_others_in(device):
    """Release the device as a thread does when it reads from a GPU."""
    with DEVICE.left():
        time.sleep(1e-4)


def test_two_pools_that_take_turns_in_the_middle_of_an_iteration_give_the_bytes_of_each_alone(block, monkeypatch):
    alone = follow(Scene(block, GEL), [SPHERE, CUBE, SPHERE, CUBE], POSES, PATH)
    inside, overlaps = set(), []
    advance = Pool.advance

    def watch(pool):
        inside.add(pool)
        overlaps.append(len(inside))
        advance(pool)
        inside.remove(pool)

    monkeypatch.setattr("simgen.fem.device._wait_for", let_others_in)
    monkeypatch.setattr(Pool, "advance", watch)
    pools = make_pool(block, 2), make_pool(block, 2)
    with ThreadPoolExecutor(4) as threads:
        tasks = [threads.submit(lambda pool, i: list(press(pool, i, i + 2)), pool, i) for pool in pools for i in (0, 2)]
        first, second, third, fourth = (task.result() for task in tasks)
    assert max(overlaps) == 2
    for found in ([*first, *second], [*third, *fourth]):
        for one, other in zip(alone, found, strict=True):
            np.testing.assert_array_equal(one.displacement, other.displacement)


def test_an_error_of_one_pool_waits_for_the_iteration_of_another_and_then_ends_both(block, monkeypatch):
    monkeypatch.setattr("simgen.fem.device._wait_for", let_others_in)
    pools, begun, raised, seen = (make_pool(block, 2), make_pool(block, 2)), threading.Event(), [], []

    def break_down():
        while not begun.is_set():
            let_others_in("cpu")
        raised.append(True)
        raise MemoryError("no more")

    def never_ends():
        begun.set()
        while not raised:
            let_others_in("cpu")
        for _ in range(10):
            let_others_in("cpu")
        seen.append([press.dropped for press in pools[1]._stepping.unfinished])

    monkeypatch.setattr(pools[0]._stepping, "advance", break_down)
    monkeypatch.setattr(pools[1]._stepping, "advance", never_ends)
    with ThreadPoolExecutor(2) as threads:
        tasks = [threads.submit(lambda pool: list(press(pool, 0, 2)), pool) for pool in pools]
        errors = [type(task.exception(timeout=20.0)) for task in tasks]
    assert set(errors) == {MemoryError, RuntimeError}  # either thread may carry the first pool on
    assert seen[0] == [False, False]  # nothing was taken from it while it was at work
    assert not any(pool.remaining for pool in pools) and CREW._free == THREADS


def test_threads_take_pools_in_their_order_and_wait_for_one(block):
    """More unknowns go first. A pool without presses is left out."""
    second, idle, first = (make_pool(sensor, 2) for sensor in (block, make_block((8, 4, 8)), make_block((6, 2, 6))))
    waiting = [press(first, 0, 1), press(second, 0, 4)]
    assert _take(waiting[0]) is first and _take(waiting[0]) is second
    with ThreadPoolExecutor(1) as thread:
        third = thread.submit(_take, waiting[1])
        with pytest.raises(TimeoutError):
            third.result(timeout=0.2)
        with FREED:
            _give_back(second)
        assert third.result(timeout=10.0) is second
        fourth = thread.submit(_take, waiting[0])
        first.drop()
        with FREED:
            _give_back(first)
        assert fourth.result(timeout=10.0) is None  # its results will not come
    second.drop()
    for pool in (idle, first, second):
        pool.taken = False
    for results in waiting:
        with pytest.raises(RuntimeError, match="another task of this process has failed"):
            list(results)
