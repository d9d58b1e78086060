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


def sample(limit, signals=(0.0, 0.0, 0.0), mesh=(0.0, 0.0, 0.0), points=(0, 1), apart=(0.0,) * 5):
    contact = np.zeros(6, bool)
    contact[[*points]] = True
    return limit.Sample(limit.Linear(np.array(signals), SLOPE), limit.Linear(np.array(mesh), PLACE),
                        limit.Linear(np.array(mesh), PLACE), contact, np.array(apart), 0.0)  # fmt: skip


def test_slopes_are_those_of_the_moves(limit):
    values = 3.0 + np.concatenate([np.zeros((1, 5)), np.diag(limit.MOVES)]) @ SLOPE.T
    found = limit.Linear.of(values)
    np.testing.assert_allclose(found.slope, SLOPE, atol=1e-12)
    np.testing.assert_allclose(found.at(limit.MOVES[None] / 2)[0], 3.0 + SLOPE @ limit.MOVES / 2)


def test_each_coordinate_is_as_uncertain_as_the_signals_leave_it(limit):
    (found,) = limit.fits(np.array([2.0, 0.0, 0.0]), [sample(limit)], NOISE, PRIOR)
    assert found.probability == 1.0
    assert found.mean[0] == pytest.approx(1.0, rel=1e-3) and np.abs(found.mean[1:]).max() < 1e-9
    covariance = found.covariance
    assert covariance[0, 0] == pytest.approx(1.0 / (20.0**2 + 1 / 9.0))
    assert covariance[1, 1] == pytest.approx(1.0 / (5.0**2 + 1 / 9.0))
    total, difference = np.array([0.0, 0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, -1.0, 0.0])
    assert total @ covariance @ total == pytest.approx(1.0 / (10.0**2 + 1 / 8.0))
    assert difference @ covariance @ difference == pytest.approx(8.0) and covariance[4, 4] == pytest.approx(900.0)


def test_samples_count_by_their_likelihood(limit):
    """The second sample is 0.3 V off in a channel that moves as it is read, with a deviation of the prior and noise."""
    off = [sample(limit), sample(limit, signals=(0.3, 0.0, 0.0))]
    one, other = (fit.probability for fit in limit.fits(np.zeros(3), off, NOISE, PRIOR))
    assert other / one == pytest.approx(np.exp(-0.5 * 0.3**2 / (2.0**2 * 9.0 + NOISE**2)))


def test_the_mesh_scatters_about_the_mean_of_all_that_fits(limit):
    """Two samples with the same signals and meshes 3 mm apart in one of three coordinates."""
    alone = limit.fits(np.zeros(3), [sample(limit)], NOISE, PRIOR)
    tilt = 0.25 * (8.0 + 1.0 / (10.0**2 + 1 / 8.0))
    squares = 1.0 / (20.0**2 + 1 / 9.0) + 1.0 / (5.0**2 + 1 / 9.0) + tilt
    assert limit.mesh_scatter(alone) == pytest.approx(1e-3 * np.sqrt(squares / 3))
    both = limit.fits(np.zeros(3), [sample(limit), sample(limit, mesh=(3e-3, 0.0, 0.0))], NOISE, PRIOR)
    assert limit.mesh_scatter(both) == pytest.approx(1e-3 * np.sqrt((squares + 1.5**2) / 3))


def test_limits_of_a_sample(limit):
    """A move by 0.1 mm leaves half of the contact, and the first place is known to 0.05 mm."""
    own = sample(limit, apart=(0.5, 0.0, 0.0, 0.0, 0.0))
    found = limit.limits(own, limit.fits(np.zeros(3), [own], NOISE, PRIOR), np.random.default_rng(0))
    # The centroid's third coordinate follows a tilt that is unknown to 1.41 degrees: 52 % lie within 1 mm.
    assert found["near"] == pytest.approx(0.52, abs=0.05)
    assert found["contact_overlap"] == pytest.approx(1.0 - 0.5 * 0.25 * np.sqrt(2 / np.pi), abs=0.01)


def test_a_contact_of_another_indenter_bounds_the_overlap(limit):
    """One of three points is common: the mean of an overlap of 1 and of 1/3, halved towards 1."""
    own = sample(limit)
    fits = limit.fits(np.zeros(3), [own, sample(limit, points=(1, 2))], NOISE, PRIOR)
    found = limit.limits(own, fits, np.random.default_rng(0))
    assert found["contact_overlap"] == pytest.approx(0.5 + 0.5 * (1 + 1 / 3) / 2, abs=0.02)


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
