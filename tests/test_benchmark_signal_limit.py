"""The limit of signals: a sensor with linear signals, whose least errors are known by hand."""

import importlib

import numpy as np
import pytest
from pages import ROOT

pytest.importorskip("torch")

from simgen.config.trajectories import GivenContact
from simgen.geometry.developed_skin import Skin
from simgen.sensing.electrodes.model import ElectrodeSettings
from simgen.sensors.given_contacts import contact_on
from simgen.sensors.room import Contacts
from simgen.sensors.sensor import load_sensor

PRIOR = np.diag([9.0, 9.0, 4.0, 4.0, 900.0])
NOISE = 0.1
# Signals show the places alone, and the tilts only as a sum. They do not show the turn.
SLOPE = np.array([[2.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0, 0.0]])
PLACE = 1e-3 * np.eye(5)[:3]  # a centroid that follows the places in x and y, and a tilt in z


@pytest.fixture
def limit(monkeypatch):
    """Benchmarks import each other by name."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module("signal_limit")


def test_slopes_are_those_of_the_moves(limit):
    values = 3.0 + np.concatenate([np.zeros((1, 5)), np.diag(limit.MOVES)]) @ SLOPE.T
    found = limit.Linear.of(values)
    np.testing.assert_allclose(found.slope, SLOPE, atol=1e-12)
    np.testing.assert_allclose(found.at(limit.MOVES[None] / 2)[0], 3.0 + SLOPE @ limit.MOVES / 2)


def test_each_coordinate_is_as_uncertain_as_the_signals_leave_it(limit):
    covariance = limit.uncertainty(SLOPE, NOISE, PRIOR)
    assert covariance[0, 0] == pytest.approx(1.0 / (20.0**2 + 1 / 9.0))
    assert covariance[1, 1] == pytest.approx(1.0 / (5.0**2 + 1 / 9.0))
    total, difference = np.array([0.0, 0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, -1.0, 0.0])
    assert total @ covariance @ total == pytest.approx(1.0 / (10.0**2 + 1 / 8.0))
    assert difference @ covariance @ difference == pytest.approx(8.0) and covariance[4, 4] == pytest.approx(900.0)


def test_limits_of_a_sample(limit):
    """A move by 0.1 mm leaves half of the contact, and the first place is known to 0.05 mm."""
    place = limit.Linear(np.zeros(3), PLACE)
    signals = limit.Linear(np.zeros(3), SLOPE)
    own = limit.Sample(0, signals, signals, place, place, np.array([0.5, 0.0, 0.0, 0.0, 0.0]), 0.0)
    found = limit.limits(own, limit.uncertainty(SLOPE, NOISE, PRIOR), np.random.default_rng(0))
    tilt = 0.25 * (8.0 + 1.0 / (10.0**2 + 1 / 8.0))
    squares = 1.0 / (20.0**2 + 1 / 9.0) + 1.0 / (5.0**2 + 1 / 9.0) + tilt
    assert found["digit_um"] == pytest.approx(1e3 * np.sqrt(squares / 3))
    # The centroid's third coordinate follows a tilt that is unknown to 1.41 degrees: 52 % lie within 1 mm.
    assert found["near"] == pytest.approx(0.52, abs=0.05)
    assert found["contact_overlap"] == pytest.approx(1.0 - 0.5 * 0.25 * np.sqrt(2 / np.pi), abs=0.01)


def test_least_change_is_by_the_best_move_of_all_coordinates(limit):
    """The first two coordinates move a signal alike, and the second one moves another signal, by 0.5 a mm.

    Only the first one moves the centroid. If it moves by 1 mm, the second one moves back by 0.8 mm. The signals change
    by 0.2 and 0.4 then. Without the second coordinate the change would be 1.
    """
    signals = limit.Linear(np.ones(2), np.array([[1.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0, 0.0]]))
    slope = np.zeros((3, 5))
    slope[2, 0] = 1e-3  # m of the centroid a mm of the first coordinate
    assert limit.least_change(signals, limit.Linear(np.ones(3), slope)) == pytest.approx(np.hypot(0.2, 0.4), rel=1e-4)


def test_means_are_over_samples_of_one_depth(limit):
    rows = [{"indenter": 0, "step": step, "near": near} for step, near in ((0, 1.0), (1, 0.5), (0, 0.5))]
    assert limit.means(rows, "step", "depth_mm", [0.1, 0.2, 0.3]) == [
        {"depth_mm": 0.1, "samples": 2, "near": 0.75}, {"depth_mm": 0.2, "samples": 1, "near": 0.5},
    ]  # fmt: skip


def test_noise_is_that_of_rounding_and_of_the_instrument(limit):
    assert limit.noise_of(ElectrodeSettings()) == pytest.approx(3.3 / 4095 / np.sqrt(12))
    both = limit.noise_of(ElectrodeSettings(noise_v=1e-3))
    assert both == pytest.approx(np.hypot(1e-3, limit.noise_of(ElectrodeSettings())))
    assert limit.noise_of(ElectrodeSettings(bits=None, noise_v=1e-3)) == 1e-3


def test_coordinates_are_those_of_given_contacts(limit):
    """A contact that a job gives by its coordinates has them."""
    skin = Skin(load_sensor("digit").surface)
    wanted = np.array([[-3.0, 1.5, 2.0, -1.0, 40.0], [2.0, -1.0, 0.0, 0.0, -20.0], [0.0, 0.0, -3.0, 2.5, 0.0]])
    found = [contact_on(skin, GivenContact(**limit.given(each))) for each in wanted]
    contacts = Contacts(*(np.concatenate(each) for each in zip(*(vars(one).values() for one in found), strict=True)))
    np.testing.assert_allclose(limit.coordinates_of(contacts), wanted, atol=1e-6)
    np.testing.assert_allclose(limit.moved(wanted[0])[[0, 2, 6]] - wanted[0], [[0] * 5, [0, 0.1, 0, 0, 0],
                                                                            limit.MOVES / 2], atol=1e-12)  # fmt: skip
