"""Batch size: predicted memory of a press against the memory of all arrays."""

import numpy as np
import pytest
import warp as wp

from simgen.config.solver_settings import SolverSettings
from simgen.errors import InputError
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.batch_size import bytes_per_press, has_room_for_another, presses_at_once
from simgen.simulation.load_stepping import LoadStepping
from simgen.simulation.press import Scene


def arrays(thing, found: dict[int, int], seen: set[int]):
    """Add the bytes of all Warp arrays of a simgen object to ``found``, by address."""
    if id(thing) in seen:
        return
    seen.add(id(thing))
    if isinstance(thing, wp.array):
        found[thing.ptr] = max(found.get(thing.ptr, 0), thing.capacity)
    elif isinstance(thing, list | tuple):
        for each in thing:
            arrays(each, found, seen)
    elif hasattr(thing, "_cls") or (hasattr(thing, "__dict__") and type(thing).__module__.startswith("simgen")):
        for each in vars(thing).values():
            arrays(each, found, seen)


@pytest.mark.parametrize(("model", "element"), [("digit", "P2-P1"), ("biotac", "P2-P1"), ("biotac", "P1")])
def test_what_a_press_takes_is_known_before(model, element):
    sensor, total, settings = load_sensor(model, "coarse"), [], SolverSettings(element=element)
    for batch in (2, 3):
        scene = Scene(sensor, sensor.materials["solid"], batch=batch, settings=settings)
        scene.reset([load_indenter("sphere_7mm").shape()])
        stepping = LoadStepping(scene, np.ones((1, 4)), max_force_n=1.0)
        found = {}
        for thing in (scene, stepping):
            arrays(thing, found, set())
        total.append(sum(found.values()))
    assert bytes_per_press(sensor, settings) == pytest.approx(total[1] - total[0], rel=0.02)


class Gpu:
    def __init__(self, free):
        self.free_memory = free


def test_as_many_presses_as_keep_a_gpu_busy_or_as_fit(monkeypatch):
    settings = SolverSettings()
    for mesh, most in (("coarse", 2048), ("default", 512)):
        sensor = load_sensor("digit", mesh)
        each = bytes_per_press(sensor)
        for free, expected in ((1e13, most), (100.0 * each, 80), (1.3 * each, 1)):
            monkeypatch.setattr("simgen.simulation.batch_size.wp.get_device", lambda name, free=free: Gpu(free))
            assert presses_at_once(sensor, "cuda:0", settings, 36) == expected
    monkeypatch.setattr("simgen.simulation.batch_size.wp.get_device", lambda name: Gpu(1.2 * each))
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3")
    with pytest.raises(InputError, match=r"^GPU 3: .*; allowed: .* a coarser mesh"):
        presses_at_once(sensor, "cuda", settings, 36)


def test_another_batch_leaves_as_much_memory_for_other_sensors(monkeypatch):
    sensor, settings = load_sensor("digit", "coarse"), SolverSettings()
    each = bytes_per_press(sensor)
    for free, expected in ((210.0, True), (190.0, False)):
        monkeypatch.setattr("simgen.simulation.batch_size.wp.get_device", lambda name, free=free: Gpu(free * each))
        assert has_room_for_another(sensor, "cuda:0", settings, 100) == expected


def test_a_core_computes_eight_presses_or_one():
    sensor, settings = load_sensor("digit", "coarse"), SolverSettings()
    assert [presses_at_once(sensor, "cpu", settings, presses) for presses in (1, 2, 3, 8, 36)] == [1, 1, 8, 8, 8]
    assert presses_at_once(sensor, "cpu", SolverSettings(element="P1"), 36) == 1
