"""The way from electrodes to image as figure and GIF: what stands where, and that it is what it should be."""

import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from simgen.learning.translation.picture import FRAME_MS, HOLD_MS, SKIN_M, ChainPainter, ChainSample
from simgen.sensing.electrodes.gaps import electrodes_of

ROWS = ["biotac\nelectrodes", "biotac\nskin, unfolded", "digit\ngel", "digit image\nfrom within: mirrored",
        "digit\ntrue image"]  # fmt: skip


def steps_of(painter, count: int, truth: bool) -> list[ChainSample]:
    """Samples of random signals, meshes and images."""
    random = np.random.default_rng(count)
    shapes = (painter._skin.vertices, 3), (len(painter._gel[0]), 3)
    steps = []
    for i in range(count):
        signals, meshes = painter.at_rest + random.normal(size=19), [1e-4 * random.normal(size=each) for each in shapes]
        images = random.integers(0, 256, (1 + truth, 8, 6, 3), np.uint8)
        steps.append(ChainSample(f"sample {i}", signals, *meshes, *images))
    return steps


def drawn(figure) -> list:
    """Its axes but for the two colour bars."""
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


@pytest.mark.parametrize(("count", "truth"), [(1, True), (3, True), (2, False)])
def test_a_figure_has_a_column_for_each_sample_and_a_row_for_each_stage(painter, count, truth):
    rows = ROWS if truth else ROWS[:4]
    axes = drawn(painter.figure(steps_of(painter, count, truth)))
    assert len(axes) == len(rows) * count
    grid = np.array(axes).reshape(len(rows), count)
    assert [line[0].texts[0].get_text() for line in grid] == rows
    assert [axes.get_title() for axes in grid[0]] == [f"sample {i}" for i in range(count)]


def test_each_column_shows_its_own_sample(painter):
    steps = steps_of(painter, 3, truth=True)
    grid = np.array(drawn(painter.figure(steps))).reshape(5, 3)
    change = max(np.abs(step.signals - painter.at_rest).max() for step in steps)
    moved = 1e3 * max(np.linalg.norm(mesh, axis=1).max() for step in steps for mesh in (step.source, step.target))
    for column, step in zip(grid.T, steps, strict=True):
        (electrodes,) = column[0].collections
        assert np.array_equal(electrodes.get_array(), step.signals - painter.at_rest)
        assert electrodes.get_clim() == (-change, change)  # one scale for all columns
        (skin,) = column[1].images
        own = painter._skin.map(1e3 * np.linalg.norm(step.source, axis=1))
        np.testing.assert_array_equal(skin.get_array().filled(np.nan), own)
        assert skin.get_clim() == (0.0, moved) and tuple(skin.get_extent()) == painter._skin.extent
        (gel,) = column[2].collections
        assert gel.get_clim() == (0.0, moved)
        for axes, image in zip(column[3:], (step.image, step.truth), strict=True):
            assert np.array_equal(axes.images[0].get_array(), image)


@pytest.mark.parametrize("truth", [True, False])
def test_a_second_hypothesis_has_a_row_and_both_their_probability(painter, truth):
    """The second sample has none."""
    one, other = steps_of(painter, 2, truth)
    steps = [replace(one, probability=(0.625, 0.25), second=255 - one.image), replace(other, probability=(1.0, 0.0))]
    rows = [*ROWS[:4], "digit image\nsecond hypothesis", *ROWS[4:][:truth]]
    grid = np.array(drawn(painter.figure(steps))).reshape(len(rows), 2)
    assert [line[0].texts[-1].get_text() for line in grid] == rows
    assert np.array_equal(grid[3, 0].images[0].get_array(), one.image)
    assert np.array_equal(grid[4, 0].images[0].get_array(), 255 - one.image) and not grid[4, 1].images
    assert [[axes.texts[0].get_text() for axes in line] for line in grid[3:5]] == [["62%", "100%"], ["25%", "0%"]]
    if truth:
        assert np.array_equal(grid[5, 1].images[0].get_array(), other.truth)
    with Image.open(io.BytesIO(painter.motion(steps))) as gif, Image.open(io.BytesIO(painter.motion([one]))) as plain:
        assert gif.width > plain.width


def test_without_a_second_hypothesis_there_is_no_row(painter):
    steps = [replace(step, probability=(1.0, 0.0)) for step in steps_of(painter, 2, truth=True)]
    grid = np.array(drawn(painter.figure(steps))).reshape(len(ROWS), 2)
    assert [line[0].texts[-1].get_text() for line in grid] == ROWS
    assert [axes.texts[0].get_text() for axes in grid[3]] == ["100%", "100%"] and not grid[4, 1].texts


def test_colour_bars_say_what_and_in_which_unit(painter):
    figure = painter.figure(steps_of(painter, 1, truth=False))
    bars = [axes for axes in figure.axes if axes.get_label() == "<colorbar>"]
    assert [bar.get_ylabel() for bar in bars] == ["change of signal,\nV", "displacement, mm"]


def test_labels_are_whole(painter, with_electrodes):
    """Recordings have the longer unit and the figure with fewer parts."""
    recorded = ChainPainter(with_electrodes, "biotac", "digit", painter.at_rest, "as recorded")
    figure = recorded.figure(steps_of(recorded, 1, truth=False))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    labels = [axes.yaxis.label for axes in figure.axes] + [text for axes in figure.axes for text in axes.texts]
    for text in labels + [axes.title for axes in figure.axes]:
        box = text.get_window_extent(canvas.get_renderer())
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1, text


def test_an_electrode_at_the_tip_is_whole(painter):
    """The tip's lie at the edge of the map."""
    figure = painter.figure(steps_of(painter, 1, truth=True))
    (dots,) = figure.axes[0].collections
    assert not dots.get_clip_on()


def test_electrodes_are_drawn_where_the_skin_above_them_is(painter, with_electrodes):
    """The pixel at each place shows the point of the skin that is nearest to what is just above the electrode."""
    electrodes, normals = electrodes_of(with_electrodes, "biotac")
    above = electrodes + SKIN_M * normals
    shown = np.stack([painter._skin.map(axis) for axis in with_electrodes["biotac/rest_positions"].T], axis=-1)
    left, right, bottom, top = painter._skin.extent
    rows, columns = shown.shape[:2]
    assert painter._electrodes.shape == (19, 2)
    for (arc, along), point in zip(painter._electrodes, above, strict=True):
        pixel = int((along - top) / (bottom - top) * rows), int((arc - left) / (right - left) * columns)
        distance = np.linalg.norm(shown - point, axis=2)
        assert distance[pixel] <= np.nanmin(distance) * (1.0 + 1e-9)  # rounding


def test_a_sample_of_nothing_is_drawn(painter):
    """Nothing moves, no signal changes: scales do not shrink to nothing."""
    (step,) = steps_of(painter, 1, truth=False)
    none = ChainSample("rest", painter.at_rest, 0.0 * step.source, 0.0 * step.target, step.image)
    electrodes = drawn(painter.figure([none]))[0].collections[0]
    assert electrodes.get_clim() == (-1.0, 1.0)


@pytest.mark.parametrize(("count", "truth"), [(1, False), (3, True)])
def test_a_gif_has_a_frame_for_each_sample(painter, count, truth):
    with Image.open(io.BytesIO(painter.motion(steps_of(painter, count, truth)))) as gif:
        assert gif.format == "GIF" and getattr(gif, "n_frames", 1) == count
        frames, durations = [], []
        for i in range(count):
            gif.seek(i)
            durations.append(gif.info["duration"])
            frames.append(np.asarray(gif.convert("RGB")))
    assert durations == [FRAME_MS] * (count - 1) + [HOLD_MS]
    assert len({frame.tobytes() for frame in frames}) == count
