"""Dots in images against exact results: moves, stretches, areas, folds, and what is stored."""

import io
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from simgen.errors import InputError
from simgen.sensing.camera.marker_dots import MarkerDots
from simgen.sensors.height_map import HeightMaps
from simgen.sensors.markers import Markers
from tests.sensing.camera import scenes
from tests.sensors.test_markers import OF, RADIUS, layout, tilted

GREY = 200
PIXEL = scenes.DISTANCE_M / OF.focal  # m, at the plane


def dots_at(*view: tuple[float, float], darkness: float = 1.0) -> tuple[MarkerDots, np.ndarray]:
    """Dots at points of right and up, mm, on a plane, and the plane's vertices in the camera's view, m."""
    vertices, triangles = tilted()
    placed = layout(*((right, up, 20.0) for right, up in view))
    markers = replace(Markers.on_surface(placed, vertices, triangles), darkness=darkness)
    return MarkerDots(markers, HeightMaps(vertices, triangles, OF)), OF.in_view(vertices)


def tracked(dots: MarkerDots, view: np.ndarray):
    """Tracks of a displacement (vertex, 3) m along right, up and depth, without heights that could hide them."""
    moved = (view @ OF.axes)[None]
    return dots.tracks(moved, np.zeros((1, OF.height, OF.width)) - view[:, 2].max())


def drawn(dots: MarkerDots, tracks) -> np.ndarray:
    image = wp.full((1, OF.height, OF.width, 3), GREY, dtype=wp.uint8, device="cpu")
    return dots.draw(image, tracks).numpy()[0]


def covered(dots: MarkerDots, tracks) -> float:
    """Area of the dots in pixels, from the light that they take."""
    return float((GREY - drawn(dots, tracks)[..., 0].astype(float)).sum() / GREY)


def ellipse(outline: np.ndarray) -> np.ndarray:
    """Semi-axes of an ellipse through points (point, 2) at even angles, the longer first."""
    arms = outline - outline.mean(axis=0)
    return np.sqrt(2.0 * np.linalg.eigvalsh(arms.T @ arms / len(arms)))[::-1]


def test_a_coat_that_moves_across_moves_its_dots_by_focal_times_move_over_depth():
    dots, view = dots_at((0.0, 0.0), (-3.0, 2.0), (4.0, -5.0))
    tracks = tracked(dots, np.broadcast_to([0.3e-3, -0.1e-3, 0.0], view.shape))
    expected = np.array([0.3e-3, 0.1e-3]) / PIXEL  # rows go down
    np.testing.assert_allclose((tracks.at - dots.rest.at)[0], np.tile(expected, (3, 1)), atol=1e-8)
    assert tracks.visible.all()


def test_a_coat_that_comes_nearer_spreads_its_dots():
    dots, view = dots_at((-3.0, 2.0))
    tracks = tracked(dots, np.broadcast_to([0.0, 0.0, -2e-3], view.shape))
    middle = np.array([OF.width, OF.height]) / 2 - 0.5
    np.testing.assert_allclose(tracks.at - middle, (dots.rest.at - middle) * 20.0 / 18.0, atol=1e-9)


@pytest.mark.parametrize("stretch", [[[1.5, 0.0], [0.0, 0.8]], [[1.0, 0.4], [0.0, 1.0]], [[1.2, 0.3], [-0.2, 0.7]]])
def test_a_stretch_makes_ellipses(stretch):
    """Area and semi-axes are the determinant and the singular values of the stretch times those of the disc."""
    dots, view = dots_at((0.5, -0.3))
    change = np.zeros_like(view)
    change[:, :2] = view[:, :2] @ (np.array(stretch).T - np.eye(2))
    tracks = tracked(dots, change)
    around = ellipse(dots.rest.outlines[0, 0])
    np.testing.assert_allclose(around, RADIUS / PIXEL, rtol=4e-3)  # the polygon's corners lie a little outside
    singular = np.linalg.svd(np.array(stretch), compute_uv=False)
    np.testing.assert_allclose(ellipse(tracks.outlines[0, 0]), singular * around, rtol=1e-6)
    assert covered(dots, tracks) == pytest.approx(np.linalg.det(stretch) * np.pi * (RADIUS / PIXEL) ** 2, rel=3e-3)


def test_a_drawn_dot_covers_its_area_in_pixels_wherever_it_is():
    for right, up in np.random.default_rng(0).uniform(-4.0, 4.0, (8, 2)):
        dots, _ = dots_at((right, up))
        assert covered(dots, dots.rest) == pytest.approx(np.pi * (RADIUS / PIXEL) ** 2, rel=3e-3)


def test_a_dot_takes_the_light_of_its_pixels_alone():
    dots, _ = dots_at((0.0, 0.0), darkness=0.5)
    image = drawn(dots, dots.rest)
    rows, columns = np.indices(image.shape[:2])
    away = np.hypot(columns - dots.rest.at[0, 0, 0], rows - dots.rest.at[0, 0, 1])
    assert (image[away < RADIUS / PIXEL - 1.0] == GREY // 2).all()
    assert (image[away > RADIUS / PIXEL + 1.0] == GREY).all()


def test_a_dot_on_the_border_is_drawn_and_one_beside_it_has_no_place_in_the_image():
    edge = 1e3 * 0.5 * OF.width * PIXEL
    dots, _ = dots_at((0.0, 0.0), (edge - 0.01, 0.0), (edge + 0.01, 1.0))
    assert dots.rest.visible.tolist() == [[True, True, False]]
    one = np.pi * (RADIUS / PIXEL) ** 2
    assert covered(dots, dots.rest) == pytest.approx(2.0 * one, rel=5e-3)  # the whole one, and two halves


def test_a_dot_under_a_fold_is_neither_visible_nor_drawn():
    """A second sheet, at rest beside the image, moves before the right half of the first one."""
    far, triangles = tilted()
    near = far + OF.axes[0] * 25e-3
    vertices = np.concatenate([far, near])
    both = np.concatenate([triangles, triangles + len(far)])
    markers = Markers.on_surface(layout((-2.0, 0.0, 20.0), (2.0, 0.0, 20.0)), vertices, both)
    heights = HeightMaps(vertices, both, OF)
    dots = MarkerDots(markers, heights)
    assert dots.rest.visible.all()
    displacement = np.zeros((1, *vertices.shape))
    displacement[0, len(far) :] = OF.axes.T @ [-15e-3, 0.0, -1e-3]  # 1 mm before the first, from its middle on
    tracks = dots.tracks(displacement, heights(displacement).numpy())
    assert tracks.visible.tolist() == [[True, False]]
    assert covered(dots, tracks) == pytest.approx(np.pi * (RADIUS / PIXEL) ** 2, rel=3e-3)
    np.testing.assert_allclose(tracks.at, dots.rest.at, atol=1e-9)  # where it would be


def test_a_dot_behind_the_camera_is_not_drawn():
    dots, view = dots_at((0.0, 0.0))
    tracks = tracked(dots, np.broadcast_to([0.0, 0.0, -0.05], view.shape))
    assert not tracks.visible.any() and covered(dots, tracks) == 0.0


def test_a_camera_that_sees_no_dot_is_one_line():
    vertices, triangles = tilted(size_m=0.08)
    markers = Markers.on_surface(layout((30.0, 0.0, 20.0)), vertices, triangles)
    with pytest.raises(InputError, match="markers: the camera sees none of 1 dots"):
        MarkerDots(markers, HeightMaps(vertices, triangles, OF))


def test_what_is_stored():
    dots, view = dots_at((0.0, 0.0), (1.0, 2.0))
    tracks = tracked(dots, np.broadcast_to([PIXEL, 0.0, 0.0], view.shape))
    stored = np.load(io.BytesIO(dots.arrays(tracks, np.array([4]), np.array([5e-4]))))
    np.testing.assert_allclose(stored["displacement_px"], np.tile([1.0, 0.0], (1, 2, 1)), atol=1e-5)
    np.testing.assert_allclose(stored["rest_px"], dots.rest.at[0], atol=1e-4)
    assert stored["visible"].tolist() == [[True, True]]
    assert (stored["step"].tolist(), stored["depth_m"].tolist()) == ([4], [5e-4])
    lines = dots.table().decode().splitlines()
    assert lines[0] == "marker,x_mm,y_mm,z_mm,column,row,visible" and len(lines) == 3
    numbers = np.array(lines[2].split(","), dtype=float)
    np.testing.assert_allclose(numbers[1:4], 1e3 * dots.markers.rest[1, 0], atol=1e-4)
    np.testing.assert_allclose(numbers[4:6], dots.rest.at[0, 1], atol=1e-4)
    other, _ = dots_at((0.0, 0.0), (1.0, 2.1))
    assert dots.record()["number"] == 2 and dots.record()["points"] != other.record()["points"]
