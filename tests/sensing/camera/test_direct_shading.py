"""Direct shading is the photometric model to rounding, and its noise is what it says."""

import numpy as np
import pytest
import warp as wp

from simgen.sensing.camera.direct_shading import DirectShading, Illumination
from simgen.sensing.camera.photometric_gel import PhotometricGel
from simgen.sensing.camera.photometry import Photometry
from simgen.sensing.camera.response import Response
from simgen.sensing.camera.shading import Shading
from simgen.sensors.sensor_geometry import sensor_folder
from tests.sensing.camera import scenes


def shading_of(gel: PhotometricGel, beams: np.ndarray | None = None, device: str = "cpu") -> DirectShading:
    beams = np.ones((3, *gel.rest_depth.shape)) if beams is None else beams
    illumination = Illumination(gel.photometry.lights, gel.photometry.crosstalk, beams)
    return DirectShading(gel.rest_depth, gel.pinhole, illumination, device)


def heights(*maps: np.ndarray) -> wp.array:
    return wp.array(np.stack(maps), dtype=wp.float32)


def ball(gel: PhotometricGel, radius_m: float = 3e-3, depth_m: float = 1e-3) -> np.ndarray:
    """Height (row, column) m of a ball's cap in the middle of the image; its rim is a sharp edge."""
    rows, columns = np.mgrid[: gel.pinhole.height, : gel.pinhole.width]
    pixel = np.nanmin(gel.rest_depth) / gel.pinhole.focal
    square = (pixel * (rows - 0.5 * rows.max())) ** 2 + (pixel * (columns - 0.5 * columns.max())) ** 2
    return np.maximum(np.sqrt(np.maximum(radius_m**2 - square, 0.0)) - radius_m + depth_m, 0.0)


def tilted() -> PhotometricGel:
    """A plane that leans 20 degrees downwards and 10 to the right, in a camera of no special direction."""
    of = scenes.pinhole(160, 120)
    x, y = of.across(*np.mgrid[:160, :120])
    depth = scenes.DISTANCE_M / (1.0 + np.tan(np.radians(20.0)) * y + np.tan(np.radians(10.0)) * x)
    lights = np.array([scenes.camera().lights[colour] for colour in ("red", "green", "blue")])
    return PhotometricGel(depth, of, Photometry(lights))


@pytest.mark.parametrize("kind", ["dome", "plane"])
def test_own_lights_give_the_model_s_picture(digit, kind):
    """Compare the untouched gel and a ball in it. Half a level is rounding."""
    gel = digit if kind == "dome" else tilted()
    shading, photometry = shading_of(gel), gel.photometry
    gain = np.full(3, photometry.albedo * gel.exposure)
    for height in (np.zeros_like(gel.rest_depth), ball(gel)):
        found = shading.image(heights(height), gain, gel.background).numpy()[0]
        expected = gel.picture(gel.rest_depth - height)
        assert np.abs(found - expected).max() < 0.51
    assert np.abs(expected - gel.background).max() > 30.0


def test_light_on_a_plane_is_lambert_s():
    gel = tilted()
    row, column = 40, 90
    ray = np.array([*gel.pinhole.across(np.array(row), np.array(column)), 1.0])
    point = scenes.in_sensor(ray * gel.rest_depth[row, column], gel.pinhole)
    normal = -np.array([np.tan(np.radians(10.0)), np.tan(np.radians(20.0)), 1.0])
    normal = normal / np.linalg.norm(normal) @ gel.pinhole.axes
    expected = gel.photometry.radiance(point, normal) / gel.photometry.albedo
    np.testing.assert_allclose(shading_of(gel).at_rest[row, column], expected, rtol=2e-3)


def test_exposure_gives_the_levels(digit):
    level, ambient = np.array([90.0, 100.0, 110.0]), np.array([0.2, 0.5, 0.8])
    shading = shading_of(digit)
    gain, background = shading.exposure(level, ambient)
    np.testing.assert_allclose(background.mean((0, 1)), level, rtol=1e-4)
    np.testing.assert_allclose((gain * shading.at_rest).mean((0, 1)), level * (1.0 - ambient), rtol=1e-4)


def test_a_beam_scales_its_own_light_alone(digit):
    beams = np.ones((3, *digit.rest_depth.shape))
    beams[1, :100] = 2.0
    even, uneven = shading_of(digit).at_rest, shading_of(digit, beams).at_rest
    np.testing.assert_allclose(uneven[100:], even[100:])
    added = (uneven - even)[:100]
    np.testing.assert_allclose(added[..., 0], digit.photometry.crosstalk * added[..., 1], rtol=1e-3, atol=0.02)
    assert (added[..., 1] > 0.3 * even[:100, :, 1]).all()


def test_noise_has_its_standard_deviation_and_its_seed(digit):
    """Rounding adds 1/12 to the variance. 230,400 values: 0.15 % of the standard deviation is one sigma."""
    shading, flat = shading_of(digit), np.full((320, 240, 3), 100.0)
    none = heights(*[np.zeros((320, 240))] * 2)
    one, again, other = (shading.image(none, np.zeros(3), flat, 1.5, seed).numpy() for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, again)
    assert np.sqrt(one[0].var() - 1.0 / 12.0) == pytest.approx(1.5, rel=0.01) and abs(one.mean() - 100.0) < 0.02
    for a, b in ((one[0], one[1]), (one, other), (one[:, 1:], one[:, :-1]), (one[..., 0], one[..., 1])):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.02


def test_pixels_beside_the_gel_stay_dark_or_as_they_were():
    gel = tilted()
    depth = np.where(np.arange(120) < 60, gel.rest_depth, np.inf)
    shading = DirectShading(depth, gel.pinhole, Illumination(gel.photometry.lights, 0.1, np.ones((3, 160, 120))))
    gain, background = shading.exposure(np.full(3, 90.0), np.full(3, 0.5))
    image = shading.image(heights(np.zeros((160, 120))), gain, background).numpy()[0]
    assert (image[:, 61:] == 0).all() and image[:, :59].min() > 0


def test_the_bundled_table_is_near_the_model(digit):
    """For a ball of 3 mm, 0.6 mm deep: the table's own error, on tilts to 37 degrees."""
    height, folder = ball(digit, depth_m=0.6e-3), sensor_folder("digit")
    background = np.rint(digit.background).astype(np.uint8)
    table = Shading(Response.load(folder / "optics.npz"), digit.rest_depth / digit.pinhole.focal, background)
    direct = shading_of(digit)
    gain = np.full(3, digit.photometry.albedo * digit.exposure)
    images = table(heights(height)), direct.image(heights(height), gain, digit.background)
    one, other = (image.numpy()[0].astype(float) for image in images)
    inside = height > 0.0
    change = np.abs(other - digit.background)[inside].mean()
    error = np.abs(one - other)[inside].mean()
    print(f"table {error:.2f} levels off, change {change:.1f}, outside {np.abs(one - other)[~inside].mean():.3f}")
    assert error < 0.15 * change and change > 10.0


def test_a_blocked_light_is_gone_and_all_else_stays():
    """Without lights the ambient part is left; without the red one, what the others send."""
    gel = tilted()
    shading = shading_of(gel)
    flat = heights(np.zeros_like(gel.rest_depth))
    gain, background = shading.exposure(np.full(3, 120.0), np.full(3, 0.7))

    def reaching(*shares: float) -> wp.array:
        return wp.array(np.ones((3, *gel.rest_depth.shape)) * np.reshape(shares, (3, 1, 1)), dtype=wp.float32)

    def image(*shares: float) -> np.ndarray:
        return shading.image(flat, gain, background, reaching=reaching(*shares)).numpy()[0].astype(float)

    inside = np.isfinite(shading.at_rest[..., 0])
    ambient = background - gain * np.nan_to_num(shading.at_rest)
    np.testing.assert_allclose(image(1.0, 1.0, 1.0), background, atol=0.51)
    np.testing.assert_allclose(image(0.0, 0.0, 0.0)[inside], ambient[inside], atol=0.51)
    lost = image(1.0, 1.0, 1.0) - image(0.0, 1.0, 1.0)
    red, green = lost[inside][:, 0] / gain[0], lost[inside][:, 1] / gain[1]
    np.testing.assert_allclose(green, gel.photometry.crosstalk * red, atol=1.1 / gain.min())
    assert lost[inside][:, 0].mean() > 5.0
