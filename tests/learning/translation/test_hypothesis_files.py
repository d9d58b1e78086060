"""Names and tables of hypotheses."""

import numpy as np

from simgen.learning.translation.hypothesis_files import csv_of, drawn, image_name, off_mm, table

PROBABILITY = np.array([[0.75, 0.25], [1.0, 0.0]])


def test_hypotheses_with_draws_alone_are_drawn():
    rows, which = drawn(PROBABILITY)
    assert rows.tolist() == [0, 0, 1] and which.tolist() == [0, 1, 0]


def test_the_likeliest_has_the_plain_name():
    assert [image_name("02_0.3mm", k) for k in (0, 1, 7)] == [
        "02_0.3mm.png", "02_0.3mm.hypothesis2.png", "02_0.3mm.hypothesis8.png"
    ]  # fmt: skip


def test_distances_are_from_the_truth_of_the_sample():
    truth = np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0]])
    places = np.array([[[3e-3, 4e-3, 0.0], [0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [np.nan] * 3]])
    np.testing.assert_allclose(off_mm(places, truth), [[5.0, 0.0], [1.0, np.nan]])


def test_a_table_has_a_line_for_each_hypothesis():
    places = np.arange(12.0).reshape(2, 2, 3) * 1e-3
    lines = table(np.array([7, 1_234_567]), PROBABILITY, places).decode().splitlines()
    assert lines == [
        "sample,hypothesis,probability,x_mm,y_mm,z_mm", "7,1,0.75,0,1,2", "7,2,0.25,3,4,5", "1234567,1,1,6,7,8"
    ]  # fmt: skip
    known = table(np.array([7, 8]), PROBABILITY, places, np.array([[0.5, np.nan], [2.0, 9.0]])).decode().splitlines()
    assert known[0].endswith(",z_mm,off_mm") and [line.split(",")[-1] for line in known[1:]] == ["0.5", "nan", "2"]


def test_numbers_have_six_digits():
    assert csv_of({"a": np.array([1, 12_345_678]), "b": np.array([1 / 3, 0.5])}) == b"a,b\n1,0.333333\n12345678,0.5\n"
