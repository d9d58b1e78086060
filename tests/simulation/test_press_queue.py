"""Order of presses in the queue."""

import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from simgen.simulation.press_queue import PressQueue
from simgen.simulation.tries import Press


def a_press(shape, tries=0, race=False):
    press = Press(shape, np.eye(4), 0.0, 1, 0.0, race)
    for _ in range(tries):
        press.next_try()
    return press


def filled(*shapes, **more):
    queue, presses = PressQueue(**more), [a_press(shape) for shape in shapes]
    for press in presses:
        queue.add(press)
    return queue, presses


def order(queue, presses):
    return [presses.index(queue.pop()) for _ in range(len(queue))]


def test_presses_without_an_ended_try_keep_their_order():
    assert order(*filled(2, 0, 1, 0)) == [0, 1, 2, 3]


def test_hard_indenters_begin_first_and_an_unknown_one_before_them():
    queue, presses = filled(0, 1, 2, 3, 0, 1, 2, 3)
    for shape, iterations in ((0, 80), (1, 300), (3, 500), (0, 90), (0, 100), (3, 100)):
        queue.learn(shape, iterations)
    assert order(queue, presses) == [2, 6, 3, 7, 0, 1, 4, 5]  # 300 is less than twice the mean of 195


def test_the_longest_try_makes_an_indenter_hard():
    """Ten tries of both indenters have the same length, one try of the second is longer."""
    queue, presses = filled(0, 1, 0, 1)
    for _ in range(10):
        queue.learn(0, 100)
        queue.learn(1, 100)
    assert order(*filled(0, 1, 0, 1)) == [0, 1, 2, 3]
    queue.learn(1, 500)
    assert order(queue, presses) == [1, 3, 0, 2]


def test_presses_of_other_indenters_keep_their_order():
    queue, presses = filled(0, 1, 1, 0, 2)
    for shape, iterations in ((0, 80), (1, 100), (2, 120)):
        queue.learn(shape, iterations)
    assert order(queue, presses) == [0, 1, 2, 3, 4]


def disorder(ends) -> float:
    """Sum of how much earlier than one before it each press ends."""
    return float(np.maximum(0.0, -np.diff(ends)).sum())


def test_tries_without_iterations_say_nothing():
    queue, presses = filled(0, 1, environments=4)
    queue.learn(0, 0)
    assert order(queue, presses) == [1, 0]  # an indenter without an ended try goes first


def test_longer_presses_begin_earlier_so_that_all_end_in_the_order_of_their_arrival():
    """While one with the mean length runs, four begin. Tries of the indenters take 0.5, 1 and 1.5 times the mean."""
    shapes = [0, 1, 2, 0, 1, 2, 0, 1, 2, 1, 2, 2]
    queue, presses = filled(*shapes, environments=4)
    for shape, iterations in ((0, 60), (1, 120), (2, 180)):
        queue.learn(shape, iterations)
    begun = order(queue, presses)
    lengths = np.array([2.0, 4.0, 6.0])[[shapes[number] for number in begun]]
    ends = dict(zip(begun, np.arange(len(begun)) + lengths, strict=True))
    in_plain_order = [number + 2.0 + 2.0 * shape for number, shape in enumerate(shapes)]
    assert begun != sorted(begun)
    assert disorder([ends[number] for number in range(len(shapes))]) <= 1.0 < disorder(in_plain_order)


def test_both_queues_count_the_environments_of_both():
    queue, presses = filled(0, 0, 0, 1, environments=1)
    for shape, iterations in ((0, 100), (0, 100), (0, 100), (1, 150)):
        queue.learn(shape, iterations)
    assert presses.index(queue.pop()) == 0  # two presses before the last is too much
    other = PressQueue(queue, environments=9)
    assert presses.index(other.pop()) == 3


def test_a_try_is_slow_if_its_indenter_is_or_if_it_takes_long():
    queue, _ = filled(0, 1, slow=[0])
    assert queue.is_slow(0, 0) and not queue.is_slow(1, 10_000)  # nothing to compare with yet
    for shape, iterations in ((0, 200), (1, 100), (1, 100), (1, 100)):
        queue.learn(shape, iterations)
    assert queue.is_slow(0, 0)
    assert queue.is_slow(1, 251) and not queue.is_slow(1, 250)  # twice the mean of 125


def test_a_press_that_is_tried_again_goes_before_all():
    queue, presses = filled(0, 1)
    presses.append(a_press(0, tries=1))
    queue.add(presses[-1])
    assert order(queue, presses) == [2, 0, 1]


def test_dropped_presses_do_not_wait():
    queue, presses = filled(0, 1, 1)
    presses.append(a_press(0, tries=1))
    queue.add(presses[-1])
    for i in (1, 3):
        presses[i].dropped = True
    queue.remove_dropped()
    assert len(queue) == 2 and {id(press) for press in queue} == {id(presses[0]), id(presses[2])}
    assert order(queue, presses) == [0, 2]
    assert queue.pop() is None


def test_two_queues_take_the_hardest_and_the_easiest_of_the_same_presses():
    queue, presses = filled(0, 1, 0, 1, 0, 1)
    other = PressQueue(queue)
    queue.note_room(False)
    assert len(other) == 6 and presses.index(other.pop()) == 0  # nothing is known yet
    for shape, iterations in ((0, 80), (0, 90), (0, 100), (1, 500)):
        other.learn(shape, iterations)
    assert [presses.index(each.pop()) for each in (other, queue, other, queue, other)] == [2, 1, 4, 3, 5]
    assert not len(queue) and not len(other)


def test_the_second_queue_takes_slow_presses_last_even_if_none_was_hard():
    queue, presses = filled(0, 1)
    for shape, iterations in ((0, 190), (0, 190), (1, 100), (1, 100), (1, 100), (1, 100), (1, 100)):
        queue.learn(shape, iterations)
    other = PressQueue(queue)
    assert other.pop() is presses[1] and other.pop() is None  # the first queue has room for the slow one
    assert queue.pop() is presses[0]


def test_the_second_queue_takes_slow_presses_if_the_first_has_no_room():
    queue, presses = filled(0, 0, 1, slow=[0])
    other = PressQueue(queue)
    assert queue.pop() is presses[0] and len(other) == 1
    assert other.pop() is presses[2] and other.pop() is None and len(queue) == 1
    other.note_room(False)  # says nothing of the first queue
    assert other.pop() is None and not len(other)
    queue.note_room(False)
    assert len(other) == 1 and other.pop() is presses[1]


def test_a_second_try_stays_in_its_own_queue():
    queue, presses = filled(0)
    other, again = PressQueue(queue), a_press(0, tries=1)
    other.add(again)
    assert (len(queue), len(other)) == (1, 2)
    assert queue.pop() is presses[0] and other.pop() is again


def test_presses_dropped_from_one_queue_do_not_wait_in_the_other():
    queue, presses = filled(0, 1, 0)
    presses[2].dropped = True
    PressQueue(queue).remove_dropped()
    assert list(queue) == presses[:2]


def test_no_press_is_lost_while_another_thread_removes_those_that_were_dropped():
    queue, _ = filled(*[0] * 100)
    other, done = PressQueue(queue), threading.Event()

    def remove():
        while not done.is_set():
            other.remove_dropped()

    before, each = sys.getswitchinterval(), 2000
    sys.setswitchinterval(1e-5)
    try:
        with ThreadPoolExecutor(1) as thread:
            removing = thread.submit(remove)
            for _ in range(each):
                queue.add(a_press(0))
            done.set()
            removing.result()
    finally:
        sys.setswitchinterval(before)
    assert len(queue) == 100 + each


def test_beside_slow_presses_only_slow_and_hard_ones_begin_in_the_first_queue():
    """So their iterations become short; the second queue takes the rest. Without its help, the first one takes all."""
    queue, presses = filled(0, 1, 2, 1, 3)
    for shape, iterations in ((0, 100), (1, 200), (2, 100), (2, 90), (3, 10), (3, 300), (3, 10), (3, 10)):
        queue.learn(shape, iterations)
    other, queue.has_help = PressQueue(queue), True
    assert queue.pop(beside_slow=True) is presses[4]  # hard, because one of its tries was long
    assert queue.pop(beside_slow=True) is presses[1]
    assert other.pop() is presses[0]
    assert queue.pop(beside_slow=True) is presses[3] and queue.pop(beside_slow=True) is None
    queue.has_help = False
    assert queue.pop(beside_slow=True) is presses[2]


def test_a_probably_slow_shape_counts_as_slow_whatever_its_mean_is():
    """Short tries of a slow shape end first, and their mean is less than that of all."""
    queue, presses = filled(0, 1, 0, 1, slow=[1])
    other, queue.has_help = PressQueue(queue), True
    assert queue.pop() is presses[1] and other.pop() is presses[0]
    for shape, iterations in ((1, 90), (0, 100)):
        queue.learn(shape, iterations)
    assert queue.is_slow(1, 0) and not queue.is_slow(0, 0)
    assert queue.pop(beside_slow=True) is presses[3] and queue.pop(beside_slow=True) is None
    assert queue.pop() is presses[2]


def begun(queue, slow, running, beside_slow=False):
    """The presses that begin their next try now."""
    return [press for press in queue.next_presses(slow, running, beside_slow) if press.next_try()]


def test_second_tries_go_before_presses_that_wait_and_more_tries_after_them():
    queue, waiting = filled(0, 0)
    one, two = (a_press(0, tries, race=True) for tries in (1, 2))
    assert begun(queue, [one, two], running=3) == [one, *waiting, one, one]  # eight tries run then


def test_more_tries_begin_beside_slow_presses_while_presses_wait_for_the_second_queue():
    """So a slow press at the end of the first pool ends earlier, and more often completes."""
    queue, presses = filled(0, 1, slow=[1])
    queue.learn(0, 100)
    queue.learn(1, 100)
    queue.has_help, slow = True, a_press(1, tries=2, race=True)
    assert begun(queue, [slow], running=2, beside_slow=True) == [presses[1], slow, slow]
    assert list(queue) == [presses[0]]


def test_a_slow_press_that_begins_keeps_others_from_the_first_queue():
    queue, presses = filled(1, 0, slow=[1])
    queue.has_help = True
    queue.learn(0, 100)
    assert begun(queue, [], running=0) == [presses[0]] and list(queue) == [presses[1]]


def test_while_many_presses_wait_the_first_queue_takes_others_too():
    """It would otherwise run nearly empty for long, because of a few slow presses."""
    queue, presses = filled(1, 0, 0, 0, slow=[1], environments=2)
    queue.has_help = True
    queue.learn(0, 100)
    assert begun(queue, [], running=0) == presses[:3]  # then one waits, and there are two environments
    queue, presses = filled(1, 0, slow=[1], environments=3)
    queue.has_help = True
    queue.learn(0, 100)
    assert begun(queue, [], running=0) == presses[:1]


def test_slow_shapes_begin_before_others_that_are_as_hard():
    queue, presses = filled(0, 1, 0, 1, slow=[1])
    for shape, iterations in ((0, 100), (1, 110)):
        queue.learn(shape, iterations)
    assert order(queue, presses) == [1, 3, 0, 2]
