"""Shadows that parts of the coat throw on others.

A ray goes from every pixel to each light, in steps of about a pixel. It is blocked where the coat that the camera sees
lies nearer to the camera than the ray. A table of colours knows tilts but no shadows. So the colour of a blocked light
is dimmed by that light's share in it.
"""

import numpy as np
import warp as wp

from simgen.sensing.camera.blur import Blur, scaled_kernels
from simgen.sensors.pinhole import Pinhole

wp.set_module_options({"enable_backward": False})

OWN_SHARE = wp.constant(wp.float32(0.7))  # of a channel's light that comes from the light of its colour; assumed
STEP_PX = wp.constant(wp.float32(1.0))
CLEAR_M = wp.constant(wp.float32(2.0e-5))  # depth below the coat that blocks no ray yet: between pixels it is unknown
SOFT = (21,)  # px in an image of 480, Gaussian kernel that softens edges, because lights are not points


@wp.func
def _view(pixel: wp.vec2f, depth: wp.float32, half: wp.vec2f, focal: wp.float32):
    """Right, up and depth, m, of a pixel (column, row) at a depth."""
    return wp.vec3f(pixel[0] + 0.5 - half[0], half[1] - pixel[1] - 0.5, focal) * (depth / focal)


@wp.kernel
def _shadow_kernel(
    rest_depth: wp.array2d(dtype=wp.float32),
    height: wp.array3d(dtype=wp.float32),
    highest: wp.array(dtype=wp.float32),
    lights: wp.array(dtype=wp.vec3f),
    half: wp.vec2f,
    focal: wp.float32,
    # outputs
    lit_out: wp.array3d(dtype=wp.float32),
):
    """1 where a light reaches a pixel, else 0, light by light. ``highest``: least depth of each sample."""
    sample, row, column = wp.tid()
    rows, columns = rest_depth.shape[0], rest_depth.shape[1]
    here = wp.vec2f(wp.float32(column), wp.float32(row))
    start = _view(here, rest_depth[row, column] - height[sample, row, column], half, focal)
    for light in range(3):
        lit = wp.float32(1.0)
        way = lights[light] - start
        # The ray ends where it is nearer to the camera than all of the coat.
        last = wp.float32(1.0)
        if way[2] < 0.0:
            last = wp.min((highest[sample] - start[2]) / way[2], last)
        end = start + last * way
        on_image = wp.vec2f(half[0] + end[0] / end[2] * focal - 0.5, half[1] - end[1] / end[2] * focal - 0.5) - here
        steps = wp.int32(wp.ceil(wp.length(on_image) / STEP_PX))
        for k in range(1, steps):
            # The ray is straight in the image, and 1 / depth is linear along it.
            t = wp.float32(k) / wp.float32(steps)
            at = here + t * on_image
            c, r = wp.int32(wp.round(at[0])), wp.int32(wp.round(at[1]))
            if c < 0 or r < 0 or c >= columns or r >= rows:
                break
            depth = 1.0 / ((1.0 - t) / start[2] + t / end[2])
            if depth > rest_depth[r, c] - height[sample, r, c] + CLEAR_M:
                lit = wp.float32(0.0)
                break
        lit_out[3 * sample + light, row, column] = lit


@wp.kernel
def _reaching_kernel(
    lit_at_rest: wp.array3d(dtype=wp.float32),
    # outputs
    lit_out: wp.array3d(dtype=wp.float32),
):
    """Share of each light that a press leaves. Shadows of the gel at rest are in the background already."""
    k, row, column = wp.tid()
    lit_out[k, row, column] = 1.0 - wp.max(lit_at_rest[k % 3, row, column] - lit_out[k, row, column], 0.0)


@wp.kernel
def _dim_kernel(
    reaching: wp.array3d(dtype=wp.float32),
    # outputs
    image_out: wp.array4d(dtype=wp.uint8),
):
    """Dim colours in shadow."""
    sample, row, column, channel = wp.tid()
    lost = 1.0 - reaching[3 * sample + channel, row, column]
    value = wp.float32(image_out[sample, row, column, channel]) * (1.0 - OWN_SHARE * lost)
    image_out[sample, row, column, channel] = wp.uint8(value + 0.5)


class Shadows:
    """Finds the lights that reach each pixel, and dims images where one does not.

    rest_depth : (height, width) m, finite
    lights : (3, 3) m, positions of the red, green and blue light, in the sensor's frame
    """

    def __init__(self, rest_depth: np.ndarray, pinhole: Pinhole, lights: np.ndarray, device: str = "cpu"):
        self.pinhole, self.device = pinhole, device
        self._rest_depth = wp.array(rest_depth, dtype=wp.float32, device=device)
        self._least = float(rest_depth.min())
        self._lights = wp.array(pinhole.in_view(lights), dtype=wp.vec3f, device=device)
        kernels = scaled_kernels(min(pinhole.height, pinhole.width), SOFT)
        self._soften = Blur(pinhole.height, pinhole.width, kernels, device)
        self._at_rest = self._soften(self.lit(wp.zeros((1, *rest_depth.shape), dtype=wp.float32, device=device)))

    def lit(self, height: wp.array) -> wp.array:
        """Light (3 * sample, height, width) float32: 1 where a light reaches a pixel, else 0, light by light.

        height : (sample, height, width) m, towards the camera
        """
        highest = self._least - height.numpy().reshape(len(height), -1).max(axis=1)
        lit = wp.empty((3 * len(height), *height.shape[1:]), dtype=wp.float32, device=self.device)
        half = wp.vec2f(0.5 * self.pinhole.width, 0.5 * self.pinhole.height)
        highest = wp.array(highest, dtype=wp.float32, device=self.device)
        inputs = [self._rest_depth, height, highest, self._lights, half, self.pinhole.focal]
        wp.launch(_shadow_kernel, dim=height.shape, inputs=inputs, outputs=[lit], device=self.device)
        return lit

    def reaching(self, height: wp.array) -> wp.array:
        """Share (3 * sample, height, width) float32 of each light that a press leaves, with soft edges, light by light.

        height : (sample, height, width) m, towards the camera
        """
        lit = self._soften(self.lit(height))
        wp.launch(_reaching_kernel, dim=lit.shape, inputs=[self._at_rest], outputs=[lit], device=self.device)
        return lit

    def __call__(self, image: wp.array, height: wp.array) -> wp.array:
        """Dim shadows of an image (sample, height, width, 3) uint8 in place."""
        wp.launch(_dim_kernel, dim=image.shape, inputs=[self.reaching(height)], outputs=[image], device=self.device)
        return image
