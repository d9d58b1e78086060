"""Images of samples, on the ball in front of the DIGIT's camera."""

import io

import fake
import numpy as np
import pytest
from PIL import Image

from simgen.pipeline.run import run
from simgen.sensing.camera.renderer import Look, Renderer, camera_of
from simgen.sensors.pinhole import Pinhole
from simgen.view.camera_picture import CameraPictures, as_png
from simgen.view.drawn_surface import AT_REST


def mapped_presser(job, sensor, device):
    """As the fake one, with a dent of 0.1 mm a depth in the middle of the digit's height map."""

    def presser(indenters, poses):
        results = fake.failing_presser(job, sensor, device)(indenters, poses)
        for result in results:
            y, x = np.mgrid[:32, :24] / np.array([32, 24])[:, None, None] - 0.5
            steps = 1e-4 / job.height_step_m * np.exp(-(x**2 + y**2) / 0.02)
            heights = np.rint(np.arange(1, 5)[:, None, None] * steps).astype(np.int16)
            heights[result.status != 0] = -(2**15)
            result.outputs["height_map"] = heights
        return results

    return presser


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    """A dataset with height maps of the digit."""
    plan = fake.make_plan(fake.make_job(outputs={"digit": ["height_map"]}, trajectories={"count": 1}))
    plan.arrays["digit/height_map_depth"] = np.full((32, 24), 0.02)
    dataset = run(plan, tmp_path_factory.mktemp("mapped") / "d.zarr", build=mapped_presser)
    _, camera, _ = camera_of(dataset, "digit")
    dataset.attributes["sensors"]["digit"] = {"camera": Pinhole.of(camera).record()}  # the ball is no sensor
    return dataset


@pytest.fixture(scope="module")
def pictures(failing):
    return CameraPictures(failing, "digit")


def test_an_image_is_what_render_makes_of_it(failing, pictures):
    assert pictures.why_not == ""
    renderer = Renderer.of_dataset(failing, "digit", Look(height=320, width=240))
    found = pictures.picture(0, 3)
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, renderer(failing.displacement("digit", 0, 3)[None])[0])
    np.testing.assert_array_equal(found, pictures.of_displacement(failing.displacement("digit", 0, 3)))


def test_first_touch_shows_the_untouched_gel(failing, pictures):
    at_rest = np.zeros_like(failing["digit/rest_positions"])
    np.testing.assert_array_equal(pictures.picture(0, AT_REST), pictures.of_displacement(at_rest))
    assert (pictures.picture(0, AT_REST) != pictures.picture(0, 3)).any()


def test_a_step_that_was_not_reached_has_no_image(pictures):
    assert pictures.picture(1, 3) is None and pictures.picture(1, 1) is not None


def test_a_sensor_without_a_camera_has_a_sentence(failing):
    pictures = CameraPictures(failing, "biotac")
    assert pictures.why_not.startswith("There is no image: ") and "no camera" in pictures.why_not
    assert pictures.picture(0, 0) is pictures.of_displacement(np.zeros((1, 3))) is None


def test_stored_height_maps_are_used(mapped):
    pictures = CameraPictures(mapped, "digit")
    assert pictures.why_not == ""
    found = pictures.picture(0, 3)
    renderer = Renderer.of_dataset(mapped, "digit", Look(height=320, width=240, heights="solution"))
    np.testing.assert_array_equal(found, renderer(mapped.in_unit("digit/height_map", 0, 3)[None])[0])
    changed = np.abs(found.astype(int) - pictures.picture(0, AT_REST)).max(axis=2)
    assert changed[120:200, 80:160].max() > 10 > 1 >= max(changed[:30].max(), changed[-30:].max())  # the map's dent
    assert pictures.picture(1, 3) is None
    assert (pictures.of_displacement(mapped.displacement("digit", 0, 3)) != pictures.picture(0, 3)).any()


def test_png_holds_the_image(pictures):
    found = pictures.picture(0, 2)
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(as_png(found)))), found)
