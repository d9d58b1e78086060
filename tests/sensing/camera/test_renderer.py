"""Images of a dataset: the camera sees the coat from within, and untouched gel is the background."""

import cv2
import fake
import numpy as np
import pytest
import trimesh
import warp as wp

from simgen.errors import InputError
from simgen.pipeline.run import run
from simgen.sensing.camera.renderer import Look, Renderer, camera_of, optics_files
from simgen.sensing.camera.response import Response
from simgen.sensors.height_map import coat
from simgen.sensors.sensor_geometry import sensor_folder
from tests.sensing.camera import scenes

SMALL = Look(height=64, width=48)


def test_the_coat_is_what_looks_away_from_the_camera():
    of = scenes.pinhole()
    box = trimesh.creation.box((6e-3, 6e-3, 2e-3))
    middle = scenes.in_sensor(np.array([0.0, 0.0, scenes.DISTANCE_M]), of)
    vertices = middle + box.vertices @ of.axes * [1.0, 1.0, 1.0]
    outward = box.faces if trimesh.Trimesh(vertices, box.faces, process=False).volume > 0 else box.faces[:, ::-1]
    far = of.in_view(vertices)[:, 2] > scenes.DISTANCE_M
    kept = coat(vertices, outward, of)
    back = {tuple(triangle) for triangle in outward[far[outward].all(axis=1)].tolist()}
    near = {tuple(triangle) for triangle in outward[(~far)[outward].all(axis=1)].tolist()}
    found = {tuple(triangle) for triangle in kept.tolist()}
    assert back <= found and not near & found


def test_untouched_gel_is_the_background(seen):
    renderer = Renderer.of_dataset(seen, "digit", SMALL)
    rest = np.zeros((2, *seen["digit/rest_positions"].shape))
    np.testing.assert_array_equal(renderer(rest), [renderer.background] * 2)
    assert renderer.background.shape == (64, 48, 3)


def test_a_press_changes_the_image_where_it_is(seen):
    renderer = Renderer.of_dataset(seen, "digit", Look(height=64, width=48, blur=None))
    rest = seen["digit/rest_positions"]
    at = rest[np.linalg.norm(rest - [-3e-3, -6.3e-3, 0.0], axis=1).argmin()]
    near = np.exp(-np.sum((rest - at) ** 2, axis=1) / 1.5e-3**2)
    pressed = 1e-3 * near[:, None] * np.array([0.0, 1.0, 0.0])
    changed = (renderer(pressed[None])[0] != renderer.background).any(axis=2)
    right, up, depth = renderer.pinhole.in_view(at)
    column = 24 + right / depth * renderer.pinhole.focal
    row = 32 - up / depth * renderer.pinhole.focal
    assert changed.any()
    away = np.hypot(*(np.argwhere(changed) - [row, column]).T) / renderer.pinhole.focal * depth
    assert away.max() < 5e-3 and away.min() < 1e-3  # at 4 mm it is 1 um, and a facet goes on for 1 mm


def test_smoothing_takes_edges_of_facets_away(seen):
    displacement = seen.displacement("digit", 0)[-1:]
    looks = [Look(height=256, width=192, blur=blur) for blur in (None, "whole")]
    sharp, smooth = (Renderer.of_dataset(seen, "digit", look) for look in looks)
    heights = [each.blur(each.heights(displacement)).numpy() for each in (sharp, smooth)]
    bumps = [np.abs(np.diff(height, n=2, axis=1)).max() for height in heights]
    assert bumps[1] < 0.5 * bumps[0]
    assert sharp.blur.sizes == () and smooth.blur.sizes


def test_an_unknown_blur_is_one_line():
    with pytest.raises(InputError, match="--blur 'soft': allowed: whole, across"):
        Look(blur="soft")


def test_files_take_the_place_of_the_sensor_s_own(seen, tmp_path):
    table = Response(np.zeros((3, 9, 9, 6)))
    table.save(tmp_path / "table.npz")
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((32, 24, 3), 90, np.uint8))
    renderer = Renderer.of_dataset(seen, "digit", Look(tmp_path / "table.npz", tmp_path / "grey.png", 64, 48))
    assert (renderer(seen.displacement("digit", 0)) == 90).all()  # a table that changes nothing


def test_images_have_the_camera_s_own_size(seen):
    _, camera, _ = camera_of(seen, "digit")
    assert Renderer.of_dataset(seen, "digit").background.shape == (camera.height_px, camera.width_px, 3)


@pytest.mark.parametrize("camera", [None, "tacto"])
def test_a_mesh_without_a_dataset_has_the_same_images(seen, camera):
    look = Look(height=64, width=48, camera=camera)
    mesh = (seen[f"digit/{key}"] for key in ("rest_positions", "surface_triangles"))
    own, other = (
        Renderer.of_dataset(seen, "digit", look),
        Renderer.of_mesh("digit", sensor_folder("digit"), *mesh, look),
    )
    assert own.record() == other.record()
    np.testing.assert_array_equal(own.untouched, other.untouched)
    displacement = seen.displacement("digit", 0)
    np.testing.assert_array_equal(own(displacement), other(displacement))
    assert (own(displacement) != own.untouched).any()


def test_another_camera_has_its_own_view_and_colours(seen):
    """TACTO's camera sees 29 % more of the gel. Names of its files end in its name."""
    looks = (Look(height=64, width=48, camera=name) for name in (None, "tacto"))
    own, tacto = (Renderer.of_dataset(seen, "digit", look) for look in looks)
    assert own.pinhole.focal / tacto.pinhole.focal == pytest.approx(1.29, abs=0.01)
    assert own.shading.response.hash != tacto.shading.response.hash
    assert optics_files("tacto") == ("optics_tacto.npz", "background_tacto.png")


@pytest.mark.parametrize("shadows", [False, True])
def test_dots_darken_their_pixels_and_change_nothing_else(seen, tmp_path, shadows):
    """Images with and without dots differ in the dots' outlines alone, at rest too."""
    plain, dotted = (
        Renderer.of_dataset(seen, "digit", Look(height=64, width=48, shadows=shadows, markers=markers, dot_mm=size))
        for markers, size in ((None, None), (scenes.dots_on_ball(tmp_path / "dots.csv"), 1.2))
    )
    moved = seen.displacement("digit", 0)
    images, tracks = dotted.images_and_tracks(moved)
    rest = np.zeros_like(moved[:1])
    np.testing.assert_array_equal(dotted(rest)[0], dotted.untouched)
    for image, without, outlines in (
        (dotted.untouched, plain.untouched, dotted.dots.rest.outlines[0]),
        (images[-1], plain(moved)[-1], tracks.outlines[-1]),
    ):
        inside = np.zeros(image.shape[:2], np.uint8)
        for outline in outlines:
            cv2.fillPoly(inside, [np.round(outline).astype(np.int32)], 1)
        near = cv2.dilate(inside, np.ones((3, 3), np.uint8)) > 0
        np.testing.assert_array_equal(image[~near], without[~near])
        assert (image[cv2.erode(inside, np.ones((3, 3), np.uint8)) > 0] == 0).all()


def test_dots_are_the_same_for_each_camera(seen, tmp_path):
    """They belong to the gel; only their places in the image differ."""
    file = scenes.dots_on_ball(tmp_path / "dots.csv")
    looks = (Look(height=64, width=48, camera=name, markers=file, dot_mm=0.8) for name in (None, "tacto"))
    own, tacto = (Renderer.of_dataset(seen, "digit", look).dots for look in looks)
    assert own.record() == tacto.record()
    middle = np.array([48, 64]) / 2 - 0.5
    np.testing.assert_allclose(own.rest.at - middle, 1.29 * (tacto.rest.at - middle), rtol=0.01)


@pytest.mark.parametrize(
    ("sensor", "look", "complaint"),
    [
        ("digit", Look(camera="front"), r"digit.sensor\.yaml: camera 'front': allowed: default, tacto"),
        ("biotac", Look(), r"biotac.sensor\.yaml: no camera; allowed: a sensor with one"),
        ("finger", Look(), r"sensor 'finger': allowed: digit, biotac"),
        ("digit", Look(height=0, width=10**6), r"image of 1000000 x \d+ pixels: allowed: 1 to 8192 each way"),
        ("digit", Look(background="nowhere.png"), r"nowhere\.png: cannot be read: No such file or directory"),
        ("digit", Look(table="nowhere.npz"), r"nowhere\.npz: cannot be read: No such file or directory"),
        ("digit", Look(markers="own"), r"digit.sensor\.yaml has no markers; allowed: ROWSxCOLUMNS@PITCH"),
        ("digit", Look(background=__file__), r"test_renderer\.py: not an image; allowed: PNG, JPEG"),
    ],
)
def test_bad_input_is_one_line(seen, sensor, look, complaint):
    with pytest.raises(InputError, match=complaint) as raised:
        Renderer.of_dataset(seen, sensor, look)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("sensor", "look", "complaint"),
    [
        ("biotac", Look(), r"biotac.sensor\.yaml: no camera; allowed: a sensor with one"),
        ("digit", Look(camera="front"), r"digit.sensor\.yaml: camera 'front': allowed: default, tacto"),
    ],
)
def test_a_mesh_that_no_camera_sees_is_one_line(seen, sensor, look, complaint):
    mesh = (seen[f"digit/{key}"] for key in ("rest_positions", "surface_triangles"))
    with pytest.raises(InputError, match=complaint):
        Renderer.of_mesh(sensor, sensor_folder(sensor), *mesh, look)


def test_a_diameter_without_markers_is_one_line():
    with pytest.raises(InputError, match=r"--dot-mm 0\.9: no --markers; allowed: with --markers"):
        Look(dot_mm=0.9)


def test_gel_out_of_sight_is_one_line(tmp_path):
    plan = fake.make_plan(fake.make_job())
    plan.arrays["digit/rest_positions"] = plan.arrays["digit/rest_positions"] + [0.0, 0.1, 0.0]  # behind the camera
    dataset = run(plan, tmp_path / "behind.zarr", build=fake.fake_presser)
    with pytest.raises(InputError, match="camera: the gel is out of its sight"):
        Renderer.of_dataset(dataset, "digit", SMALL)


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
@pytest.mark.parametrize("blur", ["whole", "across"])
def test_a_gpu_makes_the_same_images(seen, blur):
    """Except for rounding of grey levels: single precision sums in another order."""
    moved = seen.displacement("digit", 3)
    look = Look(height=64, width=48, blur=blur)
    own, other = (Renderer.of_dataset(seen, "digit", look, device)(moved).astype(int) for device in ("cpu", "cuda"))
    assert np.abs(own - other).max() <= 1 and np.mean(own != other) < 1e-3


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
def test_a_gpu_draws_the_same_dots(seen, tmp_path):
    look = Look(height=64, width=48, markers=scenes.dots_on_ball(tmp_path / "dots.csv"), dot_mm=1.2)
    own, other = (Renderer.of_dataset(seen, "digit", look, device).untouched.astype(int) for device in ("cpu", "cuda"))
    assert np.abs(own - other).max() <= 1
