"""The arrays that follow from a job: their axes, steps and chunks."""

import numpy as np
from fake import make_job

from simgen.config.outputs import PIXEL_COLUMN, PIXEL_ROW, SURFACE_VERTEX, VERTEX
from simgen.dataset.stored_arrays import NOT_REACHED, axis_lengths, written_arrays

OUTPUTS = {"digit": ["height_map", "stress"]}
SHAPES = {"digit/rest_positions": (7, 3), "digit/surface_vertices": (4,), "digit/height_map_depth": (20, 15),
          "biotac/rest_positions": (9, 3)}  # fmt: skip


def test_axes_have_the_lengths_of_the_planned_arrays():
    assert axis_lengths(make_job(outputs=OUTPUTS), SHAPES) == {
        "digit": {VERTEX: 7, SURFACE_VERTEX: 4, PIXEL_ROW: 20, PIXEL_COLUMN: 15}, "biotac": {VERTEX: 9}
    }  # fmt: skip


def test_samples_of_meshes_and_images_are_chunks_of_their_own():
    job = make_job(outputs=OUTPUTS)
    arrays = written_arrays(job, axis_lengths(job, SHAPES))
    assert arrays["digit/height_map"].shape == (4, 20, 15) and arrays["digit/height_map"].chunk == (1, 20, 15)
    assert arrays["digit/stress"].chunk == (1, 4, 6) and arrays["digit/force"].chunk is None
    assert "biotac/height_map" not in arrays


def test_steps_of_heights_suit_the_depth():
    """0.1 um up to presses of 2.04 mm; a range of 1.6 times the depth in deeper ones."""
    for last, steps in ((2.0, 1), (2.1, 2), (3.1, 2)):
        job = make_job(outputs=OUTPUTS, depths_mm={"first": 0.1, "last": last, "count": 2})
        array = written_arrays(job, axis_lengths(job, SHAPES))["digit/height_map"]
        assert array.dtype == "int16" and array.attributes["scale_factor"] == 1e-7 * steps
        assert array.fill == NOT_REACHED
        assert array.attributes["scale_factor"] * np.iinfo(np.int16).max > 1.6e-3 * last
