"""Text cells of rows: percent or numbers, with units, by the kind of the row."""

import math

import pytest

from simgen.verification.validate.cells import COLUMNS, cells, number
from tests.verification.validate.fakes import good_row


@pytest.mark.parametrize(
    "changes, expected",
    [
        ({}, ["3.21 N", "3.208 N", "+0.05 %", "1 %"]),
        ({"reference": 3.0, "tolerance": 1e-10, "ours": 3.0 + 6e-11}, ["3 N", "3 N", "+2.0e-11", "1e-10"]),
        ({"kind": "absolute", "tolerance": 0.05}, ["3.21 N", "3.208 N", "+0.0016 N", "0.05 N"]),
        ({"kind": "at most", "reference": math.nan, "unit": "", "tolerance": 4.0}, ["3.21", "", "", "at most 4"]),
        ({"kind": "at least", "reference": math.nan, "unit": "um", "tolerance": 2.0},
         ["3.21 um", "", "", "at least 2 um"]),
    ],
)  # fmt: skip
def test_cells_of_each_kind(changes, expected):
    row = good_row(**changes)
    quantity, *numbers, origin, verdict = cells(row)
    assert numbers == expected and (quantity, origin, verdict) == (row.quantity, row.origin, "ok")
    assert len(COLUMNS) == len(expected) + 3


def test_numbers_have_four_digits_and_texts_stay():
    assert (number(1.23456), number(123456.0), number("7 of 8")) == ("1.235", "1.235e+05", "7 of 8")
