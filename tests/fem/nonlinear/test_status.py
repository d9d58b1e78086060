"""Kinds of outcomes: each code has one, and arrays of codes are told apart as single ones are."""

import numpy as np
import pytest

from simgen.fem.nonlinear.status import NOT_THERE, Status, has_values, in_words, is_failure, is_planned_end, is_valid


@pytest.mark.parametrize("status", Status)
def test_an_outcome_is_of_one_kind(status):
    assert status.has_values + status.is_planned_end + status.is_failure == 1
    assert status.sentence.endswith(".")


def test_codes_of_a_dataset_are_told_apart():
    """Also those that no version of simgen writes, which are failures, and what is not there yet, which is none."""
    codes = np.array([[0, 1, 6, 7], [8, 9, 77, NOT_THERE]], np.int8)
    np.testing.assert_array_equal(is_valid(codes), [[1, 0, 0, 0], [0, 0, 0, 0]])
    np.testing.assert_array_equal(has_values(codes), [[1, 0, 0, 0], [0, 1, 0, 0]])
    np.testing.assert_array_equal(is_planned_end(codes), [[0, 0, 0, 1], [1, 0, 0, 0]])
    np.testing.assert_array_equal(is_failure(codes), [[0, 1, 1, 0], [0, 0, 1, 0]])
    words = ["converged", "failed", "failed", "not pressed", "not pressed", "inside out", "failed", "not there yet"]
    assert [in_words(code) for code in codes.ravel()] == words
