"""Images agree with the table for each pixel's tilt, by numpy alone; flat gel is the background."""

import numpy as np
import pytest
import warp as wp

from simgen.config.warp_device import start_warp
from simgen.sensing.camera.response import CHANNELS, Placement, Response
from simgen.sensing.camera.shading import Shading

PIXEL_M = 3e-5
BINS = 9


@pytest.fixture(autouse=True)
def _warp():
    start_warp()


def a_response(seed: int = 0, width: int = 640, height: int = 480) -> Response:
    """A table whose changes are tens of grey levels all over the image."""
    scale = np.array([width**-2.0, height**-2.0, 1.0 / (width * height), 1.0 / width, 1.0 / height, 1.0])
    return Response(20.0 * scale * np.random.default_rng(seed).normal(size=(3, BINS, BINS, 6)), width, height)


def shade(response: Response, height: np.ndarray, background: np.ndarray) -> np.ndarray:
    shading = Shading(response, np.full(height.shape[1:], PIXEL_M), background)
    return shading(wp.array(height, dtype=wp.float32, device="cpu")).numpy()


def ramp(down: float, right: float, shape: tuple[int, int]) -> np.ndarray:
    """Height map (1, height, width), m, with slopes along rows and columns."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return (PIXEL_M * (down * rows + right * columns))[None].astype(np.float32)


@pytest.mark.parametrize("offset", [0.0, 1e-3])
def test_flat_gel_is_the_background(offset):
    background = np.random.default_rng(1).integers(0, 256, (40, 30, 3), dtype=np.uint8)
    np.testing.assert_array_equal(shade(a_response(), np.full((2, 40, 30), offset), background), [background] * 2)


def test_almost_flat_gel_is_not_speckled():
    """Noise of 1e-4 of a pixel has any direction. A tilt of 1e-4 changes no colour by a level."""
    noise = np.random.default_rng(2).normal(0.0, 1e-4 * PIXEL_M, (1, 40, 30))
    background = np.full((40, 30, 3), 128, np.uint8)
    assert np.abs(shade(a_response(), noise, background).astype(int) - 128).max() <= 1


@pytest.mark.parametrize("shape", [(64, 48), (48, 64)])
@pytest.mark.parametrize(("size", "direction"), [(1, 0), (3, 2), (3, 5), (6, 7)])
def test_in_the_middle_of_a_bin_the_table_s_own_polynomial_counts(shape, size, direction):
    response = a_response()
    tilt = np.tan((size + 0.5) * 0.5 * np.pi / (BINS - 1))
    angle = -np.pi + (direction + 0.5) * 2.0 * np.pi / (BINS - 1)
    along_x, along_y = tilt * np.cos(angle), tilt * np.sin(angle)
    down, right = (-along_x, along_y) if shape[0] > shape[1] else (along_y, along_x)  # what stands is turned
    place = Placement.of(*shape, 480, 640)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    x, y = place.position(rows, columns)
    terms = np.stack([x * x, y * y, x * y, x, y, np.ones(shape)], axis=-1)
    flat = response.coefficients[:, 0, :-1].mean(axis=1)
    change = terms @ (response.coefficients[:, size, direction] - flat).T
    found = shade(response, ramp(down, right, shape), np.full((*shape, 3), 128, np.uint8))[0]
    # The angle is known to 1e-5 and lies between bins: colours, to a ten-thousandth of a bin's change.
    expected = np.clip(128.0 + change, 0.0, 255.0)
    assert np.abs(found - expected).max() <= 0.5 + 0.05


def test_between_bins_colours_go_over_into_each_other():
    """Linear from bin to bin, as in numpy, along the size of the tilt and around."""
    response, shape = a_response(), (4, 6)
    table = response.from_flat()
    sizes = np.concatenate([[0.0], np.arange(BINS) + 0.5]) * 0.5 * np.pi / (BINS - 1)
    for tilt, angle in ((0.02, 0.3), (0.4, -3.0), (0.9, 3.1), (1.3, 1.0), (0.08, -0.1)):
        down, right = np.tan(tilt) * np.sin(angle), np.tan(tilt) * np.cos(angle)
        place = (angle + np.pi) / (2.0 * np.pi) * (BINS - 1) - 0.5
        first = int(np.floor(place))
        both = [np.array([np.interp(tilt, sizes, column) for column in table[:, (first + k) % (BINS - 1)].T])
                for k in (0, 1)]  # fmt: skip
        mixed = both[0] + (place - first) * (both[1] - both[0])
        scale = 640 / 6
        x, y = scale * 2, scale * 1
        change = mixed.reshape(3, 6) @ np.array([x * x, y * y, x * y, x, y, 1.0])
        found = shade(response, ramp(down, right, shape), np.full((*shape, 3), 128, np.uint8))[0, 1, 2]
        assert np.abs(found - np.clip(128.0 + change, 0.0, 255.0)).max() <= 0.5 + 0.05


def test_steps_are_bright_or_dark_and_no_more():
    cliff = np.zeros((1, 20, 30))
    cliff[:, :, 15:] = 1.0  # m
    found = shade(a_response(), cliff, np.full((20, 30, 3), 250, np.uint8))
    assert found.dtype == np.uint8 and found.shape == (1, 20, 30, 3)
    assert (found[:, :, :14] == 250).all() and (found[:, :, 16:] == 250).all()


def test_channels_are_red_green_and_blue():
    coefficients = np.zeros((3, BINS, BINS, 6))
    coefficients[0, 1:, :, 5] = 40.0  # what is tilted is redder
    assert CHANNELS[0] == "grad_r"
    found = shade(Response(coefficients), ramp(1.0, 0.0, (10, 12)), np.full((10, 12, 3), 100, np.uint8))
    np.testing.assert_array_equal(found[0, 5, 5], [140, 100, 100])


def test_tables_say_what_images_show():
    """`Response.change` agrees with the kernel, also for tilts below half a bin and directions near +-pi."""
    response, shape = a_response(), (6, 8)
    place = Placement.of(*shape, response.height, response.width)
    x, y = (np.full(1, each) for each in place.position(3, 5))
    for tilt, angle in ((0.0, 0.0), (0.03, 0.3), (0.09, -2.0), (0.4, -3.1), (0.9, 3.1), (1.5, 1.0)):
        along_x, along_y = np.tan(tilt) * np.cos(angle), np.tan(tilt) * np.sin(angle)
        change = response.change(np.array([along_x]), np.array([along_y]), x, y)[0]
        found = shade(response, ramp(along_y, along_x, shape), np.full((*shape, 3), 128, np.uint8))[0, 3, 5]
        assert np.abs(found - np.clip(128.0 + change, 0.0, 255.0)).max() <= 0.5 + 0.05
