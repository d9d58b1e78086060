"""The plot of contacts: colours, the chosen one, and clicks."""

import json

import numpy as np
import pytest
from nicegui import ui

from simgen.view.contact_map import ContactMap
from simgen.view.contact_plot import CHOSEN, HIDDEN, SHOWN, ContactPlot
from simgen.view.press_table import Filter, PressTable
from view.page_parts import elements, fire, html

POINTS = np.array([[0.0, 1.0], [np.nan, np.nan], [2.0, 3.0], [-1.0, 5.0]])
OUTLINE = np.array([[-2.0, 0.0], [3.0, 0.0], [3.0, 6.0], [-2.0, 0.0]])


@pytest.fixture
def contacts() -> ContactMap:
    """Four contacts; the dataset does not know the second."""
    return ContactMap("a < b", np.arange(4), POINTS, (OUTLINE,), ("across, mm", "along, mm"))


@pytest.fixture
def table(failing) -> PressTable:
    return PressTable.of_dataset(failing)


@pytest.fixture
def chosen() -> list[int]:
    return []


@pytest.fixture
def plot(client, contacts, table, chosen) -> ContactPlot:
    return ContactPlot(contacts, table, chosen.append)


def figure(client) -> dict:
    (plot,) = elements(client, ui.plotly)
    return json.loads(json.dumps(plot.figure, allow_nan=False))


def test_all_contacts_lie_in_the_outline_until_one_is_chosen(client, plot):
    contacts, outline = figure(client)["data"]
    assert contacts["x"] == [0.0, None, 2.0, -1.0] and contacts["y"] == [1.0, None, 3.0, 5.0]
    assert contacts["marker"]["color"] == 4 * [SHOWN]
    assert contacts["text"][2] == "contact 2"
    assert np.column_stack([outline["x"], outline["y"]]).tolist() == OUTLINE.tolist()
    axes = figure(client)["layout"]
    assert [axes[each]["title"]["text"] for each in ("xaxis", "yaxis")] == ["across, mm", "along, mm"]
    assert axes["yaxis"]["autorange"] == "reversed"  # the tip of the finger is above
    assert html(client) == "<h3>Contacts on the a &lt; b</h3>"


def test_one_contact_is_marked(client, plot):
    for trajectory in (2, 3):
        plot.mark(trajectory)
        *_, mark = figure(client)["data"]
        assert (mark["x"], mark["y"]) == ([POINTS[trajectory, 0]], [POINTS[trajectory, 1]])
        assert mark["marker"]["color"] == CHOSEN
        assert len(figure(client)["data"]) == 3
    plot.mark(1)
    assert figure(client)["data"][-1]["x"] == [None]  # not known


def test_filtered_contacts_are_grey(client, plot, table):
    presses = table.matching(Filter(status="failed"))
    assert set(table.trajectory[presses]) == {0, 1, 2, 3}  # the ring fails at each
    plot.filter(presses)
    assert figure(client)["data"][0]["marker"]["color"] == 4 * [SHOWN]
    plot.filter(np.array([3, 4, 11]))
    assert figure(client)["data"][0]["marker"]["color"] == [HIDDEN, SHOWN, HIDDEN, SHOWN]
    plot.filter(np.array([], int))
    plot.mark(2)
    assert figure(client)["data"][0]["marker"]["color"] == 4 * [HIDDEN]
    assert figure(client)["data"][-1]["marker"]["color"] == CHOSEN


def test_a_click_on_a_contact_chooses_it_and_one_on_an_outline_does_not(client, plot, chosen):
    (drawn,) = elements(client, ui.plotly)
    fire(drawn, "plotly_click", {"points": [{"curveNumber": 1, "pointIndex": 0}]})
    assert chosen == []
    fire(drawn, "plotly_click", {"points": [{"curveNumber": 1, "pointIndex": 0}, {"curveNumber": 0, "pointIndex": 3}]})
    assert chosen == [3]


def test_numbers_of_trajectories_need_not_be_places(client, contacts, table, chosen):
    own = ContactMap(contacts.sensor, np.array([4, 7, 8, 20]), POINTS, (), contacts.axes)
    plot = ContactPlot(own, table, chosen.append)
    plot.mark(8)
    assert figure(client)["data"][-1]["x"] == [2.0]
    fire(elements(client, ui.plotly)[0], "plotly_click", {"points": [{"curveNumber": 0, "pointIndex": 3}]})
    assert chosen == [20]
