"""Measurements of a press: one for each output, and exact values."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from types import SimpleNamespace

import numpy as np
import pytest

from simgen.config.outputs import OUTPUTS
from simgen.simulation.measurements import MEASUREMENTS, State, measurement_of
from simgen.simulation.press import Scene, press
from simulation.blocks import CUBE, DEPTHS, GEL, make_block, pose


@pytest.fixture(scope="module")
def flat():
    """A flat punch on a block, turned by 30 degrees about the press axis."""
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    turned = pose()
    turned[0, :3, :3] = [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
    return press(Scene(make_block((4, 2, 4)), GEL), [CUBE], turned, DEPTHS)[0]


def test_every_output_has_its_measurement():
    measured = (output for output in OUTPUTS if not output.is_estimate)
    assert {measurement_of(output) for output in measured} == set(MEASUREMENTS.values())


def test_a_flat_punch_presses_on_the_whole_face():
    straight = press(Scene(make_block((4, 2, 4)), GEL), [CUBE], pose(), DEPTHS[:1])[0]
    np.testing.assert_allclose(straight.contact_area, 100.0, rtol=1e-6)  # mm2: 10 x 10 mm, as it is at rest


def test_shear_force_is_the_force_along_the_axes_of_the_contact_frame(flat):
    axes = np.array([[np.cos(np.pi / 6), 0.0, -np.sin(np.pi / 6)], [np.sin(np.pi / 6), 0.0, np.cos(np.pi / 6)]])
    np.testing.assert_allclose(flat.shear_force, flat.force @ axes.T, atol=1e-12)


def test_a_result_has_its_outputs_as_attributes(flat):
    assert flat.contact_area is flat.outputs["contact_area"]
    assert flat.stress is None and flat.cavity_pressure is None  # the scene does not measure them
    with pytest.raises(AttributeError, match="heat is no output of a press; allowed: displacement, force"):
        _ = flat.heat


def test_threads_measure_two_states_at_the_same_time(monkeypatch):
    """A lock that both states share would hold one thread while the other waits for the device."""
    both = Barrier(2)
    monkeypatch.setattr("simgen.simulation.measurements.read", lambda *arrays: (both.wait(timeout=5.0), 0))
    solver = SimpleNamespace(balance=SimpleNamespace(surface=[0]), x=[0])
    sampler = SimpleNamespace(scene=SimpleNamespace(solver=solver, cavity=SimpleNamespace(row=0)))
    states = [State(sampler, np.zeros(1), None, None, None, None) for _ in range(2)]
    with ThreadPoolExecutor(2) as threads:
        found = list(threads.map(lambda state: state.cavity, states))
    assert sorted(found) == [(0, 0), (1, 0)] and [state.cavity for state in states] == found
