"""Shadows end where straight lines say, and shadows at rest are not dimmed again."""

import numpy as np
import pytest
import warp as wp

from simgen.config.warp_device import start_warp
from simgen.sensing.camera.shadows import Shadows
from tests.sensing.camera.scenes import DISTANCE_M, in_sensor, pinhole

HEIGHT, WIDTH = 240, 320
WALL_M = 1e-3


@pytest.fixture
def of():
    start_warp()
    return pinhole(HEIGHT, WIDTH)


def lights(of, right: float, up: float, depth: float) -> np.ndarray:
    """Positions (3, 3), m, in the sensor's frame: red at this place, the others in the camera."""
    return in_sensor(np.array([[right, up, depth], [0.0, 0.0, 1e-6], [0.0, 0.0, 1e-6]]), of)


def plateau(of, left_m: float) -> np.ndarray:
    """Height map (1, height, width), m: WALL_M from ``left_m`` to the right, 0 before."""
    _, columns = np.mgrid[:HEIGHT, :WIDTH]
    x, _ = of.across(np.zeros(1), columns)
    return np.where(x * (DISTANCE_M - WALL_M) >= left_m, WALL_M, 0.0).astype(np.float32)[None]


def on(height: np.ndarray) -> wp.array:
    return wp.array(height, dtype=wp.float32, device="cpu")


@pytest.mark.parametrize("left_m", [0.0, 2e-3])
def test_a_wall_throws_a_shadow_as_long_as_similar_triangles_say(of, left_m):
    """The light lies as far to the right of the wall as above its top: the shadow is as long as the wall is high."""
    top = DISTANCE_M - WALL_M
    shadows = Shadows(np.full((HEIGHT, WIDTH), DISTANCE_M), of, lights(of, left_m + 0.5 * top, 0.0, 0.5 * top))
    red, green, blue = shadows.lit(on(plateau(of, left_m))).numpy()
    assert (green == 1.0).all() and (blue == 1.0).all()
    row = red[HEIGHT // 2]
    dark = np.flatnonzero(row == 0.0)
    assert (np.diff(dark) == 1).all()
    x, _ = of.across(np.zeros(WIDTH), np.arange(WIDTH))
    length = x[dark.max() + 1] * top - x[dark.min()] * DISTANCE_M  # from the wall's foot, which its top hides, on
    assert length == pytest.approx(WALL_M, abs=2.5 * DISTANCE_M / of.focal)  # two pixels and a half


def test_light_from_above_throws_none(of):
    shadows = Shadows(np.full((HEIGHT, WIDTH), DISTANCE_M), of, lights(of, 0.0, 0.0, 1e-6))
    assert (shadows.lit(on(plateau(of, 0.0))).numpy() == 1.0).all()


def test_a_light_that_is_turned_moves_its_shadow(of):
    """Light from the left reaches the top of the plateau, and nothing lies behind it."""
    shadows = Shadows(np.full((HEIGHT, WIDTH), DISTANCE_M), of, lights(of, -0.02, 0.0, 0.01))
    assert (shadows.lit(on(plateau(of, 0.0))).numpy() == 1.0).all()


def test_a_channel_loses_the_share_of_its_light(of):
    shadows = Shadows(np.full((HEIGHT, WIDTH), DISTANCE_M), of, lights(of, 0.0095, 0.0, 0.0095))
    height = on(plateau(of, 0.0))
    dark = shadows.lit(height).numpy()[0] == 0.0
    image = wp.array(np.full((1, HEIGHT, WIDTH, 3), 100, np.uint8), dtype=wp.uint8, device="cpu")
    found = shadows(image, height).numpy()[0]
    assert (found[..., 1:] == 100).all()
    core = dark & np.roll(dark, 2, axis=1) & np.roll(dark, -2, axis=1)
    assert core.any() and found[core, 0].max() < 100 and found[:, :40, 0].min() == 100
    assert found[core, 0].min() >= 30  # 0.7 is lost where it is darkest


def test_rest_stays_as_it_is(of):
    """A step of the gel at rest throws a shadow that the background shows already."""
    step = DISTANCE_M - plateau(of, 0.0)[0]
    shadows = Shadows(step, of, lights(of, 0.0095, 0.0, 0.0095))
    nothing = on(np.zeros((1, HEIGHT, WIDTH)))
    assert (shadows.lit(nothing).numpy()[0] == 0.0).any()
    image = np.random.default_rng(0).integers(0, 256, (1, HEIGHT, WIDTH, 3), dtype=np.uint8)
    found = shadows(wp.array(image, dtype=wp.uint8, device="cpu"), nothing).numpy()
    np.testing.assert_array_equal(found, image)
