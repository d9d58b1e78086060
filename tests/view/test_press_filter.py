"""Fields of filters, and the presses that they let through."""

import numpy as np
import pytest

from simgen.view.press_filter import PressFilter
from simgen.view.press_table import PressTable
from view.page_parts import field, texts

DEPTH, ERROR = "reaches at least, mm", "estimated error at most, um"


@pytest.fixture
def found() -> list[list[int]]:
    return []


@pytest.fixture
def filtered(client, failing, found):
    """Filters of a dataset whose ring, press 1, 4, 7 and 10, stalls after 0.2 mm."""
    return PressFilter(PressTable.of_dataset(failing), lambda presses: found.append(presses.tolist()))


def test_each_field_filters_and_all_go_together(client, filtered, found, failing):
    rings = [1, 4, 7, 10]
    field(client, "indenter").value = "ring_7mm"
    assert found[-1] == rings and texts(client)[-1] == "4 of 12 presses match"
    field(client, "status").value = "converged"
    assert found[-1] == [] and texts(client)[-1] == "0 of 12 presses match"
    field(client, "indenter").value = None
    assert found[-1] == [press for press in range(12) if press not in rings]
    field(client, "status").value = None
    field(client, DEPTH).value = 0.3
    assert found[-1] == [press for press in range(12) if press not in rings]
    field(client, DEPTH).value = 0.2  # the ring gets there
    assert found[-1] == list(range(12))
    field(client, DEPTH).value = None
    assert found[-1] == list(range(12))
    field(client, "split").value = "validation"
    assert found[-1] == np.flatnonzero(failing["press/split"] == 1).tolist() != []


def test_no_field_for_errors_that_are_not_estimated(client, filtered):
    assert ERROR not in [each.props.get("label") for each in client.elements.values()]


def test_estimated_errors(client, estimating, found):
    PressFilter(PressTable.of_dataset(estimating), lambda presses: found.append(presses.tolist()))
    field(client, ERROR).value = 6.0  # 3 um for the sphere, 6 for the ring
    assert found[-1] == [press for press in range(12) if press % 3 < 2]
    field(client, ERROR).value = 5.9
    assert found[-1] == [0, 3, 6, 9]
    assert texts(client)[-1] == "4 of 12 presses match"


def test_choices_are_those_of_the_dataset(client, filtered, failing):
    assert list(field(client, "indenter").options) == [None, *failing.indenters]
    assert list(field(client, "split").options) == [None, "train", "validation", "test"]
