"""The figures of curves."""

import json

import numpy as np
from nicegui import ui

from simgen.view.curve_plot import CURVE_COLOURS, CurvePlot
from view.page_parts import elements, html

X = np.array([0.0, 0.1, 0.2])


def figure(client) -> dict:
    """The figure as JSON, which has no NaN."""
    (plot,) = elements(client, ui.plotly)
    return json.loads(json.dumps(plot.figure, allow_nan=False))


def test_curves_have_names_labels_and_gaps(client):
    plot = CurvePlot("Force <N>")
    plot.draw("depth, mm", "force, N", {"digit": (X, np.array([0.0, 1.0, np.nan])), "biotac": (X[:2], X[:2])})
    first, second = figure(client)["data"]
    assert (first["name"], first["x"], first["y"]) == ("digit", X.tolist(), [0.0, 1.0, None])
    assert (second["name"], second["y"]) == ("biotac", [0.0, 0.1])
    assert first["line"]["color"] != second["line"]["color"]
    axes = figure(client)["layout"]
    assert [axes[each]["title"]["text"] for each in ("xaxis", "yaxis")] == ["depth, mm", "force, N"]
    assert html(client) == "<h3>Force &lt;N&gt;</h3>"


def test_there_are_more_curves_than_colours(client):
    CurvePlot().draw("", "", {str(number): (X, X) for number in range(len(CURVE_COLOURS) + 1)})
    colours = [each["line"]["color"] for each in figure(client)["data"]]
    assert colours == [*CURVE_COLOURS, CURVE_COLOURS[0]]


def test_the_cursor_moves_and_stays_where_curves_change(client):
    plot = CurvePlot()
    assert figure(client)["layout"]["shapes"] == []
    plot.draw("", "", {"digit": (X, X)})
    plot.cursor(0.1)
    plot.cursor(0.2)
    plot.draw("", "", {"biotac": (X, X)})
    (cursor,) = figure(client)["layout"]["shapes"]
    assert (cursor["x0"], cursor["x1"]) == (0.2, 0.2)
