"""Launches that are repeated, and arrays that are read and written."""

import gc
import time
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import warp as wp

from simgen.fem import device
from simgen.fem.device import DEVICE, launch_kernel, once, read, stream_in_place, write


@wp.struct
class Line:
    slope: float
    points: wp.array(dtype=wp.float64)


@wp.kernel
def line_kernel(line: Line, offset: wp.float64, out: wp.array(dtype=wp.float64)):
    i = wp.tid()
    out[i] = wp.float64(line.slope) * line.points[i] + offset


def test_arrays_are_read_together_with_and_without_the_device():
    a, b = (wp.array(np.arange(n, dtype=float), dtype=wp.float64, device="cpu") for n in (2, 3))
    with DEVICE:
        inside = read(a, b)
    for found in (inside, read(a, b)):
        np.testing.assert_array_equal(found[0], [0.0, 1.0])
        np.testing.assert_array_equal(found[1], [0.0, 1.0, 2.0])


def zeros(*shape, dtype=wp.float64):
    return wp.zeros(shape, dtype=dtype, device="cpu")


def test_a_repeated_launch_has_the_values_that_its_arguments_have_now(monkeypatch):
    """The content of arrays, the fields of structs, and numbers may change; so may the arrays themselves."""
    monkeypatch.setattr(device, "_LAUNCHES", {})
    line, out, other = Line(), zeros(3), zeros(3)
    line.slope, line.points = 2.0, wp.array([0.0, 1.0, 2.0], dtype=wp.float64, device="cpu")

    def launch(offset, into):
        launch_kernel(line_kernel, "cpu", 3, [line, offset], [into])
        return into.numpy().tolist()

    assert launch(1.0, out) == [1.0, 3.0, 5.0]
    write(np.array([0.0, 10.0, 20.0]), line.points)
    assert launch(1.0, out) == [1.0, 21.0, 41.0] and len(device._LAUNCHES) == 1
    assert launch(2.0, out) == [2.0, 22.0, 42.0]
    assert launch(2.0, other) == [2.0, 22.0, 42.0]
    line.slope = 3.0
    assert launch(2.0, out) == [2.0, 32.0, 62.0]
    line.points = wp.array([1.0, 1.0, 1.0], dtype=wp.float64, device="cpu")
    assert launch(2.0, out) == [5.0, 5.0, 5.0]
    line.slope = 2.0
    assert launch(2.0, out) == [4.0, 4.0, 4.0]


def test_launches_without_threads_do_nothing():
    out = wp.array([7.0], dtype=wp.float64, device="cpu")
    for _ in range(2):
        launch_kernel(line_kernel, "cpu", 0, [Line(), 1.0], [out])
    assert out.numpy().tolist() == [7.0]


def test_recorded_launches_are_bounded(monkeypatch):
    monkeypatch.setattr(device, "_LAUNCHES", {})
    monkeypatch.setattr(device, "MOST_LAUNCHES", 4)
    line, out = Line(), zeros(1)
    line.points = zeros(1)
    for offset in range(11):
        launch_kernel(line_kernel, "cpu", 1, [line, float(offset)], [out])
        assert out.numpy().tolist() == [offset] and 1 <= len(device._LAUNCHES) <= 4


def test_a_recorded_launch_does_not_keep_the_memory_of_its_arrays(monkeypatch):
    monkeypatch.setattr(device, "_LAUNCHES", {})
    line, out = Line(), zeros(1)
    line.points = zeros(1)
    launch_kernel(line_kernel, "cpu", 1, [line, 1.0], [out])
    assert len(device._LAUNCHES) == 1
    gone = weakref.ref(out), weakref.ref(line.points)
    del out, line
    gc.collect()
    assert [each() for each in gone] == [None, None]


def test_numbers_that_python_takes_for_equal_are_told_apart(monkeypatch):
    monkeypatch.setattr(device, "_LAUNCHES", {})
    line, out = Line(), zeros(1)
    line.points = wp.array([-0.0], dtype=wp.float64, device="cpu")
    for offset in (0.0, -0.0, np.nan, np.nan):
        launch_kernel(line_kernel, "cpu", 1, [line, offset], [out])
        assert np.array_equal(out.numpy(), [offset], equal_nan=True)
        assert np.signbit(out.numpy())[0] == np.signbit(offset)
    assert len(device._LAUNCHES) == 3


def test_launches_of_a_graph_are_not_recorded(monkeypatch):
    monkeypatch.setattr(device, "_LAUNCHES", {})
    line, out = Line(), zeros(1)
    line.points = zeros(1)
    with once():
        launch_kernel(line_kernel, "cpu", 1, [line, 5.0], [out])
    assert out.numpy().tolist() == [5.0] and not device._LAUNCHES


def test_values_are_written_in_the_type_and_shape_of_the_array():
    poses = np.arange(32.0).reshape(2, 4, 4)
    rotation, origin, numbers = (zeros(2, dtype=kind) for kind in (wp.mat33d, wp.vec3d, wp.int32))
    row = zeros(1, 2)
    write(poses[:, :3, :3], rotation)
    write(poses[:, :3, 3], origin)
    write(np.array([3, 4]), numbers)
    with pytest.raises(TypeError):
        write(np.array([3.5, 4.5]), numbers)
    write(np.array([5.0, 6.0]), row)
    np.testing.assert_array_equal(rotation.numpy(), poses[:, :3, :3])
    np.testing.assert_array_equal(origin.numpy(), poses[:, :3, 3])
    assert numbers.numpy().tolist() == [3, 4] and row.numpy().tolist() == [[5.0, 6.0]]


def test_what_was_read_stays_when_the_array_changes():
    array = wp.array([1.0], dtype=wp.float64, device="cpu")
    [found] = read(array)
    write(np.array([2.0]), array)
    assert found.tolist() == [1.0] and read(array)[0].tolist() == [2.0]


def test_host_memory_has_the_shape_and_type_of_each_array():
    """The memory is the same, so a view holds the values only until the next one is filled."""
    memory = device._HostMemory(pinned=False)
    forces, counts = zeros(3, dtype=wp.vec3d), zeros(2, 2, dtype=wp.int32)
    for array, values in ((forces, np.arange(9.0).reshape(3, 3)), (counts, np.arange(4).reshape(2, 2))):
        assert memory.holds(array)
        same, view = memory.view(array)
        view[...] = values
        wp.copy(array, same)
        np.testing.assert_array_equal(array.numpy(), values)
        assert memory.view(array)[0] is same
    assert not memory.holds(zeros(1 + memory.BYTES // 8)) and memory.holds(zeros(memory.BYTES // 8))


def test_a_thread_with_fewer_presses_runs_between_two_launches_but_not_among_those_of_a_graph():
    values, order = wp.zeros(1, dtype=wp.float64, device="cpu"), []
    line = Line()
    line.points = wp.zeros(1, dtype=wp.float64, device="cpu")

    def few(name):
        with DEVICE.with_rank(1):
            order.append(name)

    def launch(name):
        launch_kernel(line_kernel, "cpu", 1, [line, wp.float64(0.0)], [values])
        order.append(name)

    def wait_for_turn(threads, name):
        threads.submit(few, name)
        deadline = time.monotonic() + 20.0
        while not DEVICE._turns:
            assert time.monotonic() < deadline
            time.sleep(0.001)

    with ThreadPoolExecutor(1) as threads, DEVICE.with_rank(64):
        launch("first")
        wait_for_turn(threads, "few")
        launch("second")
        wait_for_turn(threads, "later")
        with once():
            launch("in a graph")
    assert order == ["first", "few", "second", "in a graph", "later"]


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
def test_streams_have_more_priorities_than_two():
    """Lower numbers go first. The last places share the lowest priority."""
    priorities = [stream_in_place(wp.get_device("cuda"), place).priority for place in (0, 1, 2, 99)]
    assert priorities[1:3] == [priorities[0] + 1, priorities[0] + 2] and priorities[3] == 0
