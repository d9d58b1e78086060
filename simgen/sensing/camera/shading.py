"""Shading: images of height maps by Taxim's table of colours."""

import numpy as np
import warp as wp

from simgen.sensing.camera.response import TERMS, Placement, Response

wp.set_module_options({"enable_backward": False})

HALF_PI = wp.constant(wp.float32(0.5 * np.pi))
PI = wp.constant(wp.float32(np.pi))
Coefficients = wp.types.vector(length=3 * TERMS, dtype=wp.float32)  # of one bin: red, green, blue


@wp.func
def _arctan(x: wp.float32):
    """Arc tangent of 0 <= x <= 1 to 1e-5, 0.003 bins (Abramowitz and Stegun, 4.4.49). wp.atan takes 20 ns."""
    z = x * x
    p = wp.float32(0.0208351) * z - wp.float32(0.0851330)
    p = p * z + wp.float32(0.1801410)
    p = p * z - wp.float32(0.3302995)
    return x * (p * z + wp.float32(0.9998660))


@wp.func
def _angle(y: wp.float32, x: wp.float32):
    """As wp.atan2, to 1e-5; 0 at the origin."""
    along, up = wp.abs(x), wp.abs(y)
    longer = wp.max(along, up)
    angle = _arctan(wp.min(along, up) / wp.max(longer, wp.float32(1.0e-30)))
    angle = wp.where(up > along, HALF_PI - angle, angle)
    angle = wp.where(x < wp.float32(0.0), PI - angle, angle)
    return wp.where(y < wp.float32(0.0), -angle, angle)


@wp.kernel
def _shade_kernel(
    height: wp.array3d(dtype=wp.float32),
    pixel: wp.array2d(dtype=wp.float32),
    background: wp.array3d(dtype=wp.uint8),
    table: wp.array2d(dtype=Coefficients),
    bins: wp.int32,
    turned: wp.bool,
    scale: wp.float32,
    # outputs
    image_out: wp.array4d(dtype=wp.uint8),
):
    """Colour of a pixel: the background plus the table's change of colour for its tilt."""
    sample, row, column = wp.tid()
    rows, columns = height.shape[1], height.shape[2]
    r, c = wp.clamp(row, 1, rows - 2), wp.clamp(column, 1, columns - 2)
    half = wp.float32(0.5)
    down = half * (height[sample, r + 1, c] - height[sample, r - 1, c]) / pixel[r, c]
    right = half * (height[sample, r, c + 1] - height[sample, r, c - 1]) / pixel[r, c]
    x, y, along_x, along_y = wp.float32(column), wp.float32(row), right, down
    if turned:  # clockwise by a right angle: the bottom becomes the left side
        x, y, along_x, along_y = wp.float32(rows - 1 - row), wp.float32(column), -down, right
    x, y = x * scale, y * scale
    size = _angle(wp.sqrt(along_x * along_x + along_y * along_y), wp.float32(1.0)) / HALF_PI * wp.float32(bins - 1)
    direction = (_angle(along_y, along_x) + PI) / (wp.float32(2.0) * PI) * wp.float32(bins - 1) - half
    # Rows of the table lie at tilts of 0, 1/2, 3/2, ... bins, columns at all whole numbers, around.
    lower = wp.min(wp.int32(size + half), bins - 1)
    along = wp.where(lower == 0, wp.float32(2.0) * size, size + half - wp.float32(lower))
    below = wp.floor(direction)
    across = direction - below
    around = bins - 1
    first = (wp.int32(below) + around) % around
    second = (first + 1) % around
    one = wp.float32(1.0)
    own = (one - along) * ((one - across) * table[lower, first] + across * table[lower, second]) + along * (
        (one - across) * table[lower + 1, first] + across * table[lower + 1, second]
    )
    for channel in range(3):
        k = 6 * channel
        value = (own[k] * x + own[k + 2] * y + own[k + 3]) * x + (own[k + 1] * y + own[k + 4]) * y + own[k + 5]
        value += wp.float32(background[row, column, channel])
        image_out[sample, row, column, channel] = wp.uint8(wp.clamp(value + half, wp.float32(0.0), wp.float32(255.0)))


class Shading:
    """Makes images (sample, height, width, 3) uint8, red first, from height maps (sample, height, width) m.

    pixel : (height, width) m, size of each pixel on the surface at rest, across the optical axis
    background : (height, width, 3) uint8, image of the untouched gel
    """

    def __init__(self, response: Response, pixel: np.ndarray, background: np.ndarray, device: str = "cpu"):
        self.device = device
        table = response.from_flat()
        self.response, self._bins = response, response.bins
        self._table = wp.array(table, dtype=Coefficients, device=device)
        self._pixel = wp.array(pixel, dtype=wp.float32, device=device)
        self._background = wp.array(background, dtype=wp.uint8, device=device)
        self._placement = Placement.of(*pixel.shape, response.height, response.width)

    def __call__(self, height: wp.array) -> wp.array:
        placement = self._placement
        image = wp.empty((*height.shape, 3), dtype=wp.uint8, device=self.device)
        inputs = [height, self._pixel, self._background, self._table, self._bins, placement.turned, placement.scale]
        wp.launch(_shade_kernel, dim=height.shape, inputs=inputs, outputs=[image], device=self.device)
        return image
