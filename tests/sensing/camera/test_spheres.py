"""Spheres through circles on planes: every depth satisfies the sphere's equation."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.spheres import Circle, Patch, sphere_in
from simgen.sensors.pinhole import Pinhole
from tests.sensing.camera.scenes import DISTANCE_M, pinhole

RADIUS_M = 2e-3
ROUNDING = 1e-12  # m: of lengths of 20 mm in double precision, a few operations


def plane(of: Pinhole, right: float = 0.0, up: float = 0.0) -> np.ndarray:
    """Depth map (height, width), m, of the plane depth = DISTANCE_M + right * x + up * y."""
    rows, columns = np.mgrid[: of.height, : of.width]
    x, y = of.across(rows, columns)
    return DISTANCE_M / (1.0 - right * x - up * y)


def in_view(patch: Patch, of: Pinhole) -> np.ndarray:
    x, y = of.across(patch.rows, patch.columns)
    return np.stack([x, y, np.ones(len(x))], axis=1) * patch.depth[:, None]


@pytest.mark.parametrize(("right", "up"), [(0.0, 0.0), (0.3, -0.2), (-0.5, 0.4)])
@pytest.mark.parametrize("share", [0.2, 0.9])
def test_a_patch_is_a_sphere_that_meets_the_plane_in_the_circle(right, up, share):
    """The middle is on the plane's normal, as deep as Pythagoras says. Depths are on the near side of the sphere."""
    of = pinhole(320, 240)
    x, y = of.across(np.array(150.3), np.array(130.6))
    depth = DISTANCE_M / (1.0 - right * x - up * y)
    circle = Circle(130.6, 150.3, share * RADIUS_M * of.focal / depth)
    rest = plane(of, right, up)
    patch = sphere_in(circle, RADIUS_M, rest, of)

    normal = np.array([-right, -up, 1.0]) / np.sqrt(1.0 + right**2 + up**2)  # away from the camera
    middle = np.array([x, y, 1.0]) * depth + normal * RADIUS_M * np.sqrt(1.0 - share**2)
    points = in_view(patch, of)
    assert len(points) > 0.8 * np.pi * circle.radius**2 * np.cos(np.arctan(np.hypot(right, up)))
    np.testing.assert_allclose(np.linalg.norm(points - middle, axis=1), RADIUS_M, atol=ROUNDING)
    assert (np.einsum("ni,ni->n", points - middle, points) < 0.0).all()  # the nearer of two depths
    risen = rest[patch.rows, patch.columns] - patch.depth
    assert (risen > 0.0).all()
    assert (np.hypot(patch.rows - circle.row, patch.columns - circle.column) < circle.radius).all()
    # The highest point of the cap, above the plane.
    high = -(points @ normal - (middle @ normal - RADIUS_M * np.sqrt(1.0 - share**2)))
    pixel = DISTANCE_M / of.focal
    assert high.max() == pytest.approx(RADIUS_M * (1.0 - np.sqrt(1.0 - share**2)), abs=pixel**2 / RADIUS_M)


def test_on_a_plane_across_the_axis_all_of_the_circle_is_there():
    """A small circle in the middle, where rays are almost parallel: its rim is where the sphere leaves the plane."""
    of = pinhole(64, 48)
    patch = sphere_in(Circle(23.5, 31.5, 4.2), RADIUS_M, plane(of), of)
    rows, columns = np.mgrid[:64, :48]
    assert len(patch.rows) == (np.hypot(rows - 31.5, columns - 23.5) < 4.2).sum()


def test_beside_the_gel_there_is_nothing():
    of = pinhole(64, 48)
    rest = np.where(np.arange(48) < 26, plane(of), np.inf)
    patch = sphere_in(Circle(23.0, 31.0, 5.0), RADIUS_M, rest, of)
    assert patch.columns.max() == 25 and np.isfinite(patch.depth).all()


@pytest.mark.parametrize(
    ("circle", "complaint"),
    [
        (Circle(48.0, 10.0, 3.0), "circle at column 48, row 10 of 48 x 64 pixels: allowed: its middle on the gel"),
        (Circle(10.0, -7.5, 3.0), "circle at column 10, row -7.5 of 48 x 64 pixels: allowed: its middle on the gel"),
        (Circle(40.0, 10.0, 3.0), "circle at column 40, row 10 of 48 x 64 pixels: allowed: its middle on the gel"),
        (Circle(20.0, 30.0, 0.0), "circle of 0 pixels: 0 of the sphere's radius; allowed: between 0 and 1"),
    ],
)
def test_circles_beside_the_gel_are_one_line(circle, complaint):
    of = pinhole(64, 48)
    rest = np.where(np.arange(48) < 41, plane(of), np.inf)  # column 40 is the last
    with pytest.raises(InputError) as raised:
        sphere_in(circle, RADIUS_M, rest, of)
    assert str(raised.value) == complaint


def test_a_circle_larger_than_the_sphere_is_one_line():
    of = pinhole(64, 48)
    pixels = 1.1 * RADIUS_M * of.focal / DISTANCE_M
    with pytest.raises(InputError, match=r"circle of [\d.]+ pixels: 1\.1 of the sphere's radius; allowed: between 0"):
        sphere_in(Circle(23.5, 31.5, pixels), RADIUS_M, plane(of), of)
