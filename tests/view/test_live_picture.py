"""Images of live presses: those that `simgen render` makes, at the page's size."""

import numpy as np

from simgen.pipeline.plan import chosen_sensor
from simgen.sensing.camera.renderer import Look, Renderer
from simgen.sensors.sensor_geometry import sensor_folder
from simgen.view.camera_picture import LONGER_SIDE
from simgen.view.live_job import base_job
from simgen.view.live_picture import LivePictures


def test_a_picture_is_that_of_the_renderer():
    job = base_job(["digit"], ["ring_7mm"])
    sensor = chosen_sensor(job, "digit")
    pictures, mesh = LivePictures(job, "digit", sensor), sensor.output_mesh
    rest = pictures.picture(None)
    assert rest.dtype == np.uint8 and rest.shape == (LONGER_SIDE, 3 * LONGER_SIDE // 4, 3)
    low = mesh.vertices[:, 1].min()  # the pad looks along -y
    away = np.linalg.norm(mesh.vertices - [-7.5e-3, low, 0.0], axis=1)
    moved = 5e-4 * np.exp(-((away / 2e-3) ** 2))[:, None] * [0.0, 1.0, 0.0]
    look = Look(height=LONGER_SIDE, width=3 * LONGER_SIDE // 4)
    renderer = Renderer.of_mesh("digit", sensor_folder("digit"), mesh.vertices, mesh.surface_triangles, look)
    pressed = pictures.picture(moved)
    np.testing.assert_array_equal(pressed, renderer(moved[None])[0])
    assert (pressed != rest).any()


def test_a_sensor_without_a_camera_has_a_sentence_and_no_picture():
    job = base_job(["biotac"], ["ring_7mm"])
    pictures = LivePictures(job, "biotac", chosen_sensor(job, "biotac"))
    assert pictures.why_not == "There is no image: sensor biotac has no camera default"
    assert pictures.picture(None) is None
