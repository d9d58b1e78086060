"""Panels of predictions: gels, electrodes and images of what small networks say."""

import asyncio
import json

import numpy as np
import pytest
from nicegui import ui

from simgen.view.curve_plot import CURVE_COLOURS
from simgen.view.dataset_page import DatasetPage
from simgen.view.drawn_surface import AT_REST
from simgen.view.opened_dataset import OpenedDataset
from simgen.view.predicted_panels import DOT_MM, ELECTRODES, PredictedPanels, electrode_dots, electrode_figure
from simgen.view.sensor_panel import GEL
from simgen.view.stage import Stage
from view.page_parts import elements, fire, html, numbers, texts

pytest.importorskip("torch", reason="torch is not installed (the training extra)")

from simgen.view.predictions import AT_REST_WORDS, NOT_VALID, Predictions

PRESS, STEP = 2, 3
SIGNALS, BEFORE = np.array([1.0, 2.5, 3.0]), np.array([1.0, 2.0, 4.0])


@pytest.fixture(scope="module")
def predictions(with_electrodes, trained) -> Predictions:
    return Predictions(with_electrodes, trained.output)


@pytest.fixture
def panels(client, sent, predictions, at_once) -> PredictedPanels:
    panels = PredictedPanels(predictions)
    for stage in elements(client, Stage):
        fire(stage, "ready")
    sent.clear()
    return panels


def draw(panels: PredictedPanels, press: int, step: int, is_old=lambda: False) -> None:
    asyncio.run(panels.draw(press, step, is_old))


def sent_last(sent: list, stage: Stage, method: str, body: str) -> tuple:
    return [call[3:] for call in sent if call[:3] == (stage, method, body)][-1]


def stages(client, predictions) -> dict[str, Stage]:
    """Stages by sensor: that of the source is the first."""
    return dict(zip((predictions.source, predictions.target), elements(client, Stage), strict=True))


def test_predicted_gels_are_drawn_with_their_errors(client, panels, predictions, sent):
    draw(panels, PRESS, STEP)
    found = predictions.of_sample(PRESS, STEP)
    for sensor, stage in stages(client, predictions).items():
        own = found.surfaces[sensor]
        points, colours = sent_last(sent, stage, "move", GEL)
        np.testing.assert_array_equal(numbers(points), own.positions_mm)
        np.testing.assert_array_equal(numbers(colours, "u1"), own.displacement.colours)
        assert f"off by {own.rmse_um:.3g} um (root mean square)" in texts(client)
        assert f"<h3>{sensor}, predicted</h3>" in html(client)


def test_the_toggle_shows_the_distance_from_the_truth(client, panels, predictions, sent):
    draw(panels, PRESS, STEP)
    (shows,) = elements(client, ui.toggle)
    shows.value = "difference"
    found = predictions.of_sample(PRESS, STEP)
    for sensor, stage in stages(client, predictions).items():
        own = found.surfaces[sensor]
        np.testing.assert_array_equal(
            numbers(sent_last(sent, stage, "move", GEL)[1], "u1"), own.difference.colours
        )  # fmt: skip
        assert f"{own.difference.largest:.3g} um (distance from the truth)" in texts(client)


def test_electrodes_lie_on_the_predicted_skin(client, panels, predictions, sent):
    draw(panels, PRESS, STEP)
    own = predictions.of_sample(PRESS, STEP)
    skin = own.surfaces[predictions.source].positions_mm[predictions.above_electrodes]
    points, _, colours, *_ = sent_last(sent, stages(client, predictions)[predictions.source], "put", ELECTRODES)
    balls = numbers(points).reshape(len(skin), -1, 3)
    np.testing.assert_allclose(balls.mean(axis=1), skin, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(balls - skin[:, None], axis=2), DOT_MM, rtol=1e-4)
    assert len(np.unique(numbers(colours, "u1"), axis=0)) > 1
    bars = elements(client, ui.plotly, "electrodes")[0].figure["data"][0]
    np.testing.assert_allclose(bars["y"], own.signals)


def test_images_are_shown(client, panels, predictions):
    draw(panels, PRESS, STEP)
    image, difference = elements(client, ui.interactive_image)
    assert image.visible and difference.visible
    assert image.source.startswith("data:image/png;base64,") and image.source != difference.source
    before = image.source
    draw(panels, PRESS, 0)
    assert image.source != before


def test_what_is_not_predicted_is_said_and_the_panels_are_hidden(client, panels, predictions, sent):
    (gels,) = elements(client, ui.element, "panels")
    for press, step, words in ((0, AT_REST, AT_REST_WORDS), (1, 3, NOT_VALID)):
        draw(panels, press, step)
        assert words in texts(client) and not gels.visible and not sent
    draw(panels, 1, 1)
    assert gels.visible and NOT_VALID not in texts(client) and sent
    assert f"Predicted by {', '.join(predictions.networks)}" in html(client)


def test_an_old_sample_is_not_drawn(client, panels, sent):
    draw(panels, PRESS, STEP, is_old=lambda: True)
    assert not sent
    (shows,) = elements(client, ui.toggle)
    shows.value = "difference"  # before anything was drawn
    assert not sent


def test_the_page_of_a_dataset_has_them(client, sent, trained, with_electrodes, at_once):
    page = DatasetPage(OpenedDataset(with_electrodes.path, trained.output))
    page.show(PRESS, STEP)
    own, shown = page.opened.predictions.of_sample(PRESS, STEP), elements(client, Stage)[-2:]
    for stage in shown:
        fire(stage, "ready")
    (slow,) = {each.callback for each in elements(client, ui.timer) if each.interval == 0.0}

    async def draw() -> None:
        with client:
            await slow()

    asyncio.run(draw())
    for stage, surface in zip(shown, own.surfaces.values(), strict=True):
        np.testing.assert_array_equal(numbers(sent_last(sent, stage, "move", GEL)[0]), surface.positions_mm)


def test_a_bar_for_each_electrode():
    figure = json.loads(json.dumps(electrode_figure(SIGNALS, BEFORE), allow_nan=False))
    bars, marks = figure["data"]
    assert bars["x"] == marks["x"] == [1, 2, 3]
    assert (bars["y"], marks["y"]) == (SIGNALS.tolist(), BEFORE.tolist())
    assert len(set(bars["marker"]["color"])) == 3 and marks["marker"]["color"] == CURVE_COLOURS[0]
    low, high = figure["layout"]["yaxis"]["range"]
    assert low < 1.0 and high > 4.0


def test_signals_that_are_all_the_same_can_be_drawn():
    low, high = electrode_figure(np.ones(3), np.ones(3))["layout"]["yaxis"]["range"]
    assert low < 1.0 < high


def test_dots_are_closed_balls():
    places = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    dots = electrode_dots(places, np.array([0.0, -2.0]))
    first, second = np.split(dots.points, 2)
    np.testing.assert_allclose(second - first, np.broadcast_to([5.0, 0.0, 0.0], first.shape))
    assert dots.triangles.max() == len(dots.points) - 1
    assert (
        len(np.unique(np.sort(dots.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0)) * 2 == dots.triangles.size
    )
    assert len(np.unique(dots.colours, axis=0)) == 2
