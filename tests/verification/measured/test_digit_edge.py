"""The case of an edge in a real DIGIT: its indenter, its fit to known frames, and a short run with real ones."""

from pathlib import Path

import numpy as np
import pytest

from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import load_sensor
from simgen.units import MM
from simgen.verification.measured import digit_edge
from simgen.verification.measured.digit_edge import FOLDER, EdgePress, around_press, edge_pose, fit, roof
from simgen.verification.measured.edge_images import EdgeLine, NormalColours, shifted
from simgen.verification.validate.case import Context

HEIGHT, WIDTH = 80, 60


def test_the_roof_has_the_sizes_of_the_source():
    mesh = roof()
    np.testing.assert_allclose(mesh.bounds / MM, [[-5.0, -5.0, -5.0], [5.0, 0.0, 5.0]], atol=1e-9)
    assert mesh.is_watertight
    section = mesh.section(plane_origin=[0.0, -0.5 * MM, 0.0], plane_normal=[0.0, 1.0, 0.0])
    np.testing.assert_allclose(np.ptp(section.bounds, axis=0) / MM, [10.0, 0.0, 2.5], atol=1e-9)


def test_the_pose_presses_along_the_axis_with_the_ridge_where_the_image_shows_it():
    camera = load_sensor("digit", mesh="coarse").cameras["default"]
    pinhole = Pinhole.of(camera, HEIGHT, WIDTH)
    ridge = EdgeLine(20.0, 50.0, (0.6, -0.8))
    pose = edge_pose(pinhole, np.full((HEIGHT, WIDTH), 0.018), ridge)
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(pose[:3, 1], -pinhole.axes[2], atol=1e-12)

    def pixel(point: np.ndarray) -> np.ndarray:
        x, y, depth = pinhole.in_view(point)
        return np.array([0.5 * WIDTH + pinhole.focal * x / depth - 0.5, 0.5 * HEIGHT - pinhole.focal * y / depth - 0.5])

    middle = pose[:3, 3] - digit_edge.ABOVE_M * pinhole.axes[2]
    np.testing.assert_allclose(pixel(middle), [20.0, 50.0], atol=1e-9)
    ahead = pixel(middle + 1e-3 * pose[:3, 0]) - pixel(middle)
    np.testing.assert_allclose(ahead / np.linalg.norm(ahead), [0.6, -0.8], atol=1e-9)


def dents() -> EdgePress:
    """A dent that widens as it deepens, at depths of 0 to 1 mm."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    depths = MM * np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    across = np.abs(0.8 * (columns - 30) + 0.6 * (rows - 40)) * 0.1 * MM
    along = np.abs(0.6 * (columns - 30) - 0.8 * (rows - 40)) * 0.1 * MM
    heights = [np.maximum(depth - 0.4 * across, 0.0) * (along < 2.5 * MM) for depth in depths]
    return EdgePress(np.array(heights, np.float32), depths, np.full((HEIGHT, WIDTH), 1e-4))


def test_heights_between_depths_are_linear():
    pressed = dents()
    np.testing.assert_allclose(pressed.height(0.375 * MM), 0.5 * (pressed.heights[1] + pressed.heights[2]), atol=1e-9)
    np.testing.assert_array_equal(pressed.height(1.0 * MM), pressed.heights[-1])


def test_place_blur_and_last_depth_of_known_frames_are_found():
    pressed = dents()
    true = NormalColours(20.0 * np.random.default_rng(1).normal(size=(15, 3)), blur_px=1.5)
    shares = np.linspace(0.2, 1.0, 5)
    changes = np.array([
        true(shifted(pressed.height(0.8 * MM * share), 2.0, -1.5), pressed.pixel_m) for share in shares
    ])  # fmt: skip
    found = fit(pressed, changes, shares, np.ones((HEIGHT, WIDTH), bool))
    assert found.last_m == pytest.approx(0.8 * MM, rel=0.02)
    assert (found.right, found.down) == pytest.approx((2.0, -1.5), abs=0.1)
    assert found.colours.blur_px == pytest.approx(1.5, rel=0.05)
    np.testing.assert_allclose(found.change(1.0), changes[-1], atol=2.0)
    given = fit(pressed, changes, shares, np.ones((HEIGHT, WIDTH), bool), last_m=MM, blurred=False)
    assert given.last_m == MM and given.colours.blur_px == 0.0 and given.left > found.left


def test_surroundings_of_a_press_hold_the_press():
    change = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    change[30:40, 20:30] = 50.0
    where = around_press(change)
    assert where[30:40, 20:30].all() and 200 < where.sum() < 700


def test_it_is_skipped_without_frames(tmp_path):
    for measured in (None, tmp_path):
        outcome = digit_edge.digit_edge(Context("cpu", None, None, tmp_path, measured))
        assert outcome.rows == [] and FOLDER in outcome.skipped


def test_real_frames_make_rows_tables_and_a_page(reference: Path, tmp_path, monkeypatch):
    """The coarse mesh is less exact under an edge, so its bounds are wider than the case's."""
    measured = reference / "measured"
    if not (measured / FOLDER).is_dir():
        pytest.skip(f"no {measured / FOLDER}: the pictures belong to others")
    coarse = load_sensor("digit", mesh="coarse")
    monkeypatch.setattr(digit_edge, "load_sensor", lambda *_, **__: coarse)
    monkeypatch.setattr(digit_edge, "EVERY", 20)
    outcome = digit_edge.digit_edge(Context("cpu", reference, None, tmp_path, measured))
    width, length, colours = (row.ours for row in outcome.rows)
    assert length < 0.15 and width < 0.3 and colours < 0.6
    assert len(outcome.tables[0].rows) == 3 and outcome.pictures[0].data.startswith(b"\x89PNG")
