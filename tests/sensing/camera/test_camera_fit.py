"""The fit of a camera to imprints at stage positions: exact, with noise, with outliers, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.camera_fit import SeenGel, check_places, fit_camera
from simgen.sensors.pinhole import Pinhole, placed_camera
from simgen.sensors.sensor_geometry import load_geometry
from simgen.units import MM_PER_M

RADIUS_MM = 3.0
ANGLE, CENTRE = 32.0, np.array([40.0, -7.0])  # degrees; mm
TRUE_VIEW = 55.0  # degrees


def on_stage(balls: np.ndarray, is_mirrored: bool, angle: float = ANGLE) -> np.ndarray:
    """Stage positions (n, 2) mm of middles of balls (n, 2) mm, seen from the camera."""
    turned = (balls @ [1.0, 1j]) * np.exp(-1j * np.radians(angle))
    return CENTRE + np.stack([turned.real, -turned.imag if is_mirrored else turned.imag], axis=1)


class Setup:
    """A sensor, its camera as the sensor.yaml has it, and the true one with another field of view."""

    def __init__(self, name: str):
        self.geometry = load_geometry(name)
        self.camera = placed_camera(self.geometry.description, self.geometry.folder)
        self.nominal = Pinhole.of(self.camera)
        self.true = Pinhole.of(replace(self.camera, vertical_field_of_view_deg=TRUE_VIEW))
        self.gel = SeenGel.of(self.geometry, self.camera)

    def circles(self, count: int, seed: int = 0) -> np.ndarray:
        random = np.random.default_rng(seed)
        width, height = self.true.width, self.true.height
        low, high = [0.2 * width, 0.15 * height, 10.0], [0.8 * width, 0.85 * height, 25.0]
        return random.uniform(low, high, (count, 3))

    def stage(self, circles: np.ndarray, is_mirrored: bool = True) -> np.ndarray:
        return on_stage(self.gel.balls(circles, self.true, RADIUS_MM)[0], is_mirrored)

    def fit(self, circles: np.ndarray, stage: np.ndarray):
        return fit_camera(circles, stage, RADIUS_MM, self.gel, self.nominal)


@pytest.fixture(scope="module")
def digit_setup() -> Setup:
    return Setup("digit")


@pytest.mark.parametrize("count", [3, 4, 20])
@pytest.mark.parametrize("is_mirrored", [False, True])
def test_exact_imprints_give_the_camera_to_rounding(digit_setup, count, is_mirrored):
    circles = digit_setup.circles(count)
    found = digit_setup.fit(circles, digit_setup.stage(circles, is_mirrored))
    assert found.focal_px == pytest.approx(digit_setup.true.focal, rel=1e-9)
    assert found.angle_deg == pytest.approx(ANGLE, abs=1e-7)
    assert found.centre_mm == pytest.approx(CENTRE, abs=1e-8)
    assert found.is_mirrored == is_mirrored and found.used.all() and found.rms_px < 1e-6


def test_under_a_plane_the_fit_is_that_of_a_pinhole(digit_setup):
    """A ball over a plane is a point that a pinhole projects; no other geometry is used."""
    depth, true = 19.0, digit_setup.true
    x, y = np.random.default_rng(1).uniform(-5.0, 5.0, (2, 12))
    view = np.stack([x, y, np.full(12, depth)], axis=1) / MM_PER_M
    column_row, _ = true.project(true.position + view @ true.axes)
    pinhole = digit_setup.gel.pinhole
    across = pinhole.across(*np.mgrid[: pinhole.height, : pinhole.width])
    points = depth * np.stack([*across, np.ones((pinhole.height, pinhole.width))])
    plane = SeenGel(pinhole, points, np.zeros(points.shape) + np.array([0.0, 0.0, 1.0])[:, None, None], depth)
    circles, stage = np.column_stack([column_row, np.full(12, 15.0)]), on_stage(np.stack([x, y], axis=1), False)
    found = fit_camera(circles, stage, RADIUS_MM, plane, digit_setup.nominal)
    assert found.focal_px == pytest.approx(true.focal, rel=1e-9)
    assert found.centre_mm == pytest.approx(CENTRE, abs=1e-8) and not found.is_mirrored
    assert found.angle_deg == pytest.approx(ANGLE, abs=1e-7)


def test_on_a_dome_the_ball_is_beside_its_imprint(digit_setup):
    """Contacts are triangles of the gel's surface, and their normals those of the triangles."""
    surface = digit_setup.geometry.true.surface
    points, normals = surface.triangles_center, surface.face_normals
    column_row, _ = digit_setup.true.project(points)
    inside = ((column_row > 40.0) & (column_row < np.array([200.0, 280.0]))).all(axis=1) & (normals[:, 1] < -0.5)
    some = np.random.default_rng(2).choice(np.flatnonzero(inside), 60, replace=False)
    share = 0.5
    radius = share * RADIUS_MM / MM_PER_M * digit_setup.true.focal / digit_setup.true.in_view(points[some])[:, 2]
    balls = points[some] + RADIUS_MM / MM_PER_M * (1.0 - share**2) * normals[some]
    stage = on_stage(MM_PER_M * digit_setup.true.in_view(balls)[:, :2], is_mirrored=True)
    found = digit_setup.fit(np.column_stack([column_row[some], radius]), stage)
    assert found.focal_px == pytest.approx(digit_setup.true.focal, rel=2e-3)
    assert found.centre_mm == pytest.approx(CENTRE, abs=0.02) and found.rms_px < 0.5


def test_standard_errors_are_those_of_repeated_measurements(digit_setup):
    circles = digit_setup.circles(20)
    stage = digit_setup.stage(circles)
    random, off = np.random.default_rng(3), []
    for _ in range(100):
        noisy = circles + np.column_stack([random.normal(0.0, 0.7, (20, 2)), np.zeros(20)])
        found = digit_setup.fit(noisy, stage)
        error = [np.log(found.focal_px / digit_setup.true.focal), np.radians(found.angle_deg - ANGLE),
                 *(found.centre_mm - CENTRE)]  # fmt: skip
        off.append(error / found.errors)
    within = (np.abs(off) < 1.0).mean(axis=0)  # 68 % of a normal distribution; 100 draws scatter by 5 %
    assert (within > 0.53).all() and (within < 0.82).all(), within
    assert (np.abs(off) < 2.0).mean() > 0.90


def test_outliers_are_named_and_change_nothing(digit_setup):
    circles = digit_setup.circles(20)
    random = np.random.default_rng(4)
    circles[:, :2] += random.normal(0.0, 0.3, (20, 2))
    stage = digit_setup.stage(digit_setup.circles(20))
    bad = np.isin(np.arange(20), [0, 7, 8, 19])
    wrong = stage + np.where(bad, 1.0, 0.0)[:, None] * random.uniform(1.0, 6.0, (20, 2))
    found, without = digit_setup.fit(circles, wrong), digit_setup.fit(circles[~bad], stage[~bad])
    np.testing.assert_array_equal(found.used, ~bad)
    assert found.focal_px == pytest.approx(without.focal_px, rel=1e-9)
    assert found.errors == pytest.approx(without.errors, rel=1e-4)


def test_positions_of_other_pictures_are_refused(digit_setup):
    circles = digit_setup.circles(20)
    with pytest.raises(InputError, match=r"positions and imprints do not fit: [\d.]+ pixels apart"):
        digit_setup.fit(circles, np.random.default_rng(5).permutation(digit_setup.stage(circles)))


@pytest.mark.parametrize("unit", [1e-3, 25.4])
def test_positions_in_another_unit_are_refused(digit_setup, unit):
    circles = digit_setup.circles(20)
    with pytest.raises(InputError, match=r"scale of [\d.e+-]+ times the sensor.yaml's: allowed: 0.1 to 10 times"):
        digit_setup.fit(circles, digit_setup.stage(circles) * unit)


def test_a_ball_that_is_too_small_is_refused(digit_setup):
    circles = digit_setup.circles(20)
    stage = digit_setup.stage(circles)
    with pytest.raises(InputError, match=r"imprints have [\d.]+ of the ball's radius \(median\); allowed: less than 1"):
        fit_camera(circles, stage, 0.5, digit_setup.gel, digit_setup.nominal)


def test_imprints_at_one_place_are_refused(digit_setup):
    circles = digit_setup.circles(5)
    with pytest.raises(InputError, match="all imprints lie at one place"):
        digit_setup.fit(np.tile(circles[:1], (5, 1)), digit_setup.stage(circles))


@pytest.mark.parametrize(
    ("places", "words"),
    [
        ([[0, 0], [1, 0], [0, 0], [1, 0]], "2 different places; allowed: 3 and more, not on one line"),
        ([[0, 0], [1, 1], [2, 2], [3, 3.01]], "all places lie on one line, to 0.1% of its length; allowed: places"),
    ],
)
def test_places_must_spread(places, words):
    with pytest.raises(InputError) as raised:
        check_places(np.array(places, float))
    assert words in str(raised.value)
