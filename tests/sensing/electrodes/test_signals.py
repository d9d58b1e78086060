"""Preparation of electrode signals: drift that was added is removed, contact stays, scaling inverts."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from simgen.errors import InputError
from simgen.sensing.electrodes.signals import LEAST_FORCE_N, Scaling, in_contact, without_drift

ROUNDING = 1e-12  # some hundred roundings of 1e-16, of signals of size 1 to 10

NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)
SIGNALS = st.tuples(st.integers(1, 5), st.integers(1, 4)).flatmap(
    lambda shape: arrays(np.float64, shape, elements=NUMBERS)
)


def recording(slopes):
    """Signals with contacts; the same with drift of these slopes; contact; time."""
    random = np.random.default_rng(4)
    time = np.cumsum(random.uniform(0.5, 2.0, 40)) + 100.0
    contact = random.uniform(size=40) < 0.5
    clean = np.where(contact[:, None], random.normal(size=(40, len(slopes))), 0.0) + np.arange(len(slopes))
    return clean, clean + np.outer(time - time[0], slopes), contact, time


def test_a_planted_line_is_removed_and_contact_left_alone():
    clean, drifted, contact, time = recording(np.array([0.0, 0.03, -0.2]))
    np.testing.assert_allclose(without_drift(drifted, contact, time), clean, rtol=0, atol=ROUNDING)


def test_signals_without_drift_stay_whatever_contacts_are():
    clean, _, contact, time = recording(np.zeros(3))
    loud = clean + 1e3 * contact[:, None]
    np.testing.assert_allclose(without_drift(loud, contact, time), loud, rtol=0, atol=ROUNDING)


def test_time_is_the_number_of_the_sample_by_default():
    _, drifted, contact, _ = recording(np.array([0.1, 0.2]))
    numbered = without_drift(drifted, contact, np.arange(40.0))
    np.testing.assert_array_equal(without_drift(drifted, contact), numbered)
    np.testing.assert_allclose(
        without_drift(drifted, contact, 3600.0 + 0.01 * np.arange(40)), numbered, rtol=0, atol=1e-9
    )  # differences of times of 3600 have 1e-12 of them left
    np.testing.assert_array_equal(numbered[0], drifted[0])


@pytest.mark.parametrize(
    "contact, time, complaint",
    [
        (np.ones(4, bool), None, "0 samples without contact; allowed: 2 or more"),
        (np.array([True, False, True, True]), None, "1 samples without contact"),
        (np.zeros(4, bool), np.ones(4), "at different times"),
        (np.zeros(3, bool), None, "contact: shape (3,); allowed: (4,)"),
        (np.zeros(4), None, "contact: float64; allowed: bool"),
        (np.zeros(4, bool), np.arange(5), "time: shape (5,)"),
        (np.zeros(4, bool), np.array([0, 1, 2, np.nan]), "time: values that are not finite"),
    ],
)
def test_drift_that_cannot_be_fitted_is_one_line(contact, time, complaint):
    with pytest.raises(InputError) as raised:
        without_drift(np.zeros((4, 2)), contact, time)
    assert complaint in str(raised.value)


def test_contact_is_a_force_of_a_size():
    force = LEAST_FORCE_N * np.array([[0.0, 0.0, 0.0], [0.6, 0.0, -0.79], [0.6, 0.0, -0.81], [-3.0, 0.0, 0.0]])
    np.testing.assert_array_equal(in_contact(force), [False, False, True, True])
    np.testing.assert_array_equal(in_contact(force, 2.0 * LEAST_FORCE_N), [False, False, False, True])
    for bad, least, complaint in (
        (np.zeros(3), 0.1, r"shape \(3,\)"),
        (np.full((1, 3), np.nan), 0.1, "not finite"),
        (force, -1.0, "0 or more"),
        (force, np.nan, "0 or more"),
    ):
        with pytest.raises(InputError, match=complaint):
            in_contact(bad, least)


@given(SIGNALS, SIGNALS)
def test_scaling_goes_back(training, others):
    scaling = Scaling.fit(training)
    scaled = scaling.apply(training)
    # Half an ulp of each of the numbers that are subtracted, over the range; both ends are such numbers.
    span = np.ptp(training, axis=0)
    allowed = 1 + 4 * np.finfo(float).eps * np.abs(training).max() / np.where(span > 0, span, 1.0)
    assert (np.abs(scaled) <= allowed).all()
    if others.shape[1] == training.shape[1]:
        size = np.abs(training).max() + np.abs(others).max()
        back = scaling.invert(scaling.apply(others))
        np.testing.assert_allclose(back, others, rtol=0, atol=4 * np.finfo(float).eps * size)


def test_each_channel_has_its_own_range():
    training = np.array([[1.0, -5.0, 2.0], [3.0, 5.0, 2.0], [2.0, 0.0, 2.0]])
    scaling = Scaling.fit(training)
    np.testing.assert_array_equal(scaling.apply(training), [[-1, -1, 0], [1, 1, 0], [0, 0, 0]])
    np.testing.assert_array_equal(scaling.apply(np.array([[4.0, 10.0, 2.5]])), [[2.0, 2.0, 0.5]])


def test_scaling_is_json():
    scaling = Scaling.fit(np.random.default_rng(0).normal(size=(5, 19)))
    assert Scaling(**json.loads(json.dumps(asdict(scaling)))) == scaling


@pytest.mark.parametrize(
    "make, complaint",
    [
        (lambda: Scaling.fit(np.zeros((0, 3))), "shape (0, 3)"),
        (lambda: Scaling.fit(np.zeros(3)), "shape (3,)"),
        (lambda: Scaling.fit(np.full((2, 2), np.nan)), "not finite"),
        (lambda: Scaling((0.0,), (1.0, 2.0)), "1 low, 2 high"),
        (lambda: Scaling((0.0, 3.0), (1.0, 2.0)), "channel 1: low above high"),
        (lambda: Scaling((np.inf,), (np.inf,)), "low: allowed: a finite number"),
        (lambda: Scaling((0.0,), (1.0,)).apply(np.zeros((4, 2))), "shape (4, 2); allowed: (n, 1)"),
        (lambda: Scaling((0.0,), (1.0,)).invert(np.zeros(4)), "shape (4,); allowed: (n, 1)"),
    ],
)
def test_scaling_refuses_what_does_not_fit(make, complaint):
    with pytest.raises(InputError) as raised:
        make()
    assert complaint in str(raised.value)
