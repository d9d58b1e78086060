"""Dots on a coat: their places, their outlines, and what they do not stand on."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensors import markers
from simgen.sensors.marker_layout import MarkerLayout
from simgen.sensors.markers import OUTLINE, Markers
from simgen.sensors.sensor import load_sensor
from simgen.sensors.sensor_geometry import sensor_folder
from simgen.sensors.sensor_schema import read_description
from tests.sensing.camera import scenes

OF = scenes.pinhole(640, 480)
RADIUS = 0.45e-3


def tilted(slope: float = 0.0, size_m: float = 0.02):
    """A plane at a mean depth of `DISTANCE_M`, whose outside looks away from the camera."""
    vertices, triangles = scenes.sheet(lambda right, up: scenes.DISTANCE_M + slope * right, OF, size_m, cells=41)
    normal = np.cross(*(vertices[triangles[0, k]] - vertices[triangles[0, 0]] for k in (1, 2)))
    return vertices, triangles if normal @ OF.axes[2] > 0 else triangles[:, ::-1]


def layout(*view: tuple[float, float, float], along_axis: bool = True) -> MarkerLayout:
    """Dots at points of right, up and depth, mm."""
    points = scenes.in_sensor(1e-3 * np.array(view), OF)
    return MarkerLayout(points, OF, along_axis, 2.0 * RADIUS, 1.0, [f"dot {k}" for k in range(len(points))])


def area(outline: np.ndarray) -> np.ndarray:
    """Area of polygons (..., point, 3) in a plane."""
    arms = outline - outline[..., :1, :]
    return 0.5 * np.linalg.norm(np.cross(arms[..., :-1, :], arms[..., 1:, :]).sum(axis=-2), axis=-1)


def test_grid_points_move_along_the_axis_and_others_to_the_nearest_point():
    """On a plane that rises by 3/4, a point 1 mm before it moves by 1 mm along the axis, or by 0.8 mm across."""
    vertices, triangles = tilted(slope=0.75)
    along, nearest = (
        OF.in_view(Markers.on_surface(layout((0.0, 0.0, 19.0), along_axis=each), vertices, triangles).rest[0, 0])
        for each in (True, False)
    )
    np.testing.assert_allclose(along, [0.0, 0.0, 0.02], atol=1e-12)
    np.testing.assert_allclose(nearest, np.array([-0.48, 0.0, 19.64]) * 1e-3, atol=1e-12)


def test_of_two_layers_the_one_that_the_camera_sees_has_the_dot():
    vertices, triangles = tilted()
    behind = vertices + 2e-3 * OF.axes[2]
    both = np.concatenate([behind, vertices]), np.concatenate([triangles, triangles + len(vertices)])
    dots = Markers.on_surface(layout((0.0, 0.0, 30.0)), *both)
    np.testing.assert_allclose(OF.in_view(dots.rest[0, 0]), [0.0, 0.0, 0.02], atol=1e-12)


def test_a_dot_is_a_disc_on_the_coat():
    vertices, triangles = tilted(slope=0.75)
    dots = Markers.on_surface(layout((0.1, 0.2, 20.0), (-2.0, 3.0, 18.0)), vertices, triangles)
    assert dots.rest.shape == (2, 1 + OUTLINE, 3)
    np.testing.assert_allclose(area(dots.rest[:, 1:]), np.pi * RADIUS**2, rtol=1e-9)
    away = np.linalg.norm(dots.rest[:, 1:] - dots.rest[:, :1], axis=2)
    np.testing.assert_allclose(away, RADIUS, rtol=5e-3)
    right, _, depth = np.moveaxis(OF.in_view(dots.rest), -1, 0)
    np.testing.assert_allclose(depth, scenes.DISTANCE_M + 0.75 * right, atol=1e-12)


def test_points_move_as_the_triangles_that_hold_them():
    """A linear displacement is followed exactly, and a point on a vertex moves as the vertex does."""
    vertices, triangles = tilted()
    rng = np.random.default_rng(1)
    gradient, shift = 0.3 * rng.normal(size=(3, 3)), rng.normal(size=3)
    dots = Markers.on_surface(layout((0.1, 0.2, 20.0), (-2.0, 3.0, 20.0)), vertices, triangles)
    np.testing.assert_allclose(
        dots.moved((vertices @ gradient + shift)[None])[0], dots.rest + dots.rest @ gradient + shift, atol=1e-12
    )
    vertex = np.linalg.norm(vertices - scenes.in_sensor(np.array([0.0, 0.0, 0.02]), OF), axis=1).argmin()
    one = layout(tuple(1e3 * OF.in_view(vertices[vertex])))
    any_field = rng.normal(size=(2, *vertices.shape))
    on_it = Markers.on_surface(one, vertices, triangles)
    np.testing.assert_allclose((on_it.moved(any_field) - on_it.rest)[:, 0, 0], any_field[:, vertex], atol=1e-9)


@pytest.mark.parametrize(
    ("dots", "says"),
    [
        (layout((0.0, 0.0, 20.0), (15.0, 0.0, 20.0)), "dot 1: off the coat; allowed: a grid that ends on it"),
        (layout((0.0, 0.0, 18.5), along_axis=False), "dot 0: 1.5 mm off the coat; allowed: 1 mm"),
        (layout((9.9, 0.0, 20.0)), "dot 0: the dot of 0.9 mm leaves the coat"),
    ],
)
def test_a_dot_off_the_coat_is_one_line(dots, says):
    with pytest.raises(InputError, match=says):
        Markers.on_surface(dots, *tilted())


def test_a_camera_between_the_axes_makes_whole_circles():
    right = np.ones(3) / np.sqrt(3.0)
    triangle = np.array([[[0.0, 0.0, 0.0], [1.0, -1.0, 0.0], [1.0, 0.0, -1.0]]])  # its plane is across `right`
    [circle] = markers._circles(np.zeros((1, 3)), triangle, right, 2.0)
    np.testing.assert_allclose(np.linalg.norm(circle, axis=1), 2.0)
    np.testing.assert_allclose(circle @ right, 0.0, atol=1e-12)


def test_a_surface_that_faces_the_camera_has_no_coat():
    vertices, triangles = tilted()
    with pytest.raises(InputError, match="camera default: sees no coat of the gel"):
        Markers.on_surface(layout((0.0, 0.0, 20.0)), vertices, triangles[:, ::-1])


def test_the_gelsight_mini_has_63_dots_2_05_mm_apart():
    folder = sensor_folder("gelsight_mini")
    chosen = MarkerLayout.of("own", read_description(folder / "sensor.yaml"), folder)
    mesh = load_sensor("gelsight_mini", "coarse").output_mesh
    dots = Markers.on_surface(chosen, mesh.vertices, mesh.surface_triangles)
    middle = dots.rest[:, 0].reshape(7, 9, 3)
    np.testing.assert_allclose(np.diff(middle[..., 0], axis=1), 2.05e-3, atol=1e-9)  # right is +x
    np.testing.assert_allclose(np.diff(middle[..., 2], axis=0), 2.05e-3, atol=1e-9)  # up is -z
    np.testing.assert_allclose(middle.mean(axis=(0, 1))[[0, 2]], [-7.56e-3, 0.0], atol=1e-9)
    assert middle[..., 1].max() < -7.9e-3 and middle[3, 4, 1] == pytest.approx(-8.3e-3, abs=2e-6)
    at, depth = chosen.camera.project(middle)
    pitch = np.diff(at[..., 0], axis=1)
    np.testing.assert_allclose(pitch[3, 4], chosen.camera.focal * 2.05e-3 / depth[3, 4], rtol=2e-3)
    assert 32.0 < pitch.min() < pitch.max() < 33.2
