"""Direct shading: images of height maps by the photometric model itself, without a table of colours."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from simgen.errors import InputError
from simgen.sensors.pinhole import Pinhole

wp.set_module_options({"enable_backward": False})


@wp.func
def _view(
    rest_depth: wp.array2d(dtype=wp.float32),
    height: wp.array3d(dtype=wp.float32),
    half: wp.vec2f,
    focal: wp.float32,
    sample: wp.int32,
    row: wp.int32,
    column: wp.int32,
):
    """Right, up and depth, m, of the coat at a pixel."""
    x, y = wp.float32(column) + 0.5 - half[0], half[1] - wp.float32(row) - 0.5
    return wp.vec3f(x, y, focal) * ((rest_depth[row, column] - height[sample, row, column]) / focal)


@wp.kernel
def _light_kernel(
    rest_depth: wp.array2d(dtype=wp.float32),
    height: wp.array3d(dtype=wp.float32),
    lights: wp.mat33f,
    colour: wp.mat33f,
    beams: wp.array3d(dtype=wp.float32),
    half: wp.vec2f,
    focal: wp.float32,
    reaching: wp.array3d(dtype=wp.float32),
    # outputs
    light_out: wp.array3d(dtype=wp.vec3f),
):
    """Light of a pixel in red, green and blue, as `Photometry.radiance`; NaN where a neighbour is beside the gel.

    ``reaching``: share of each light that is not blocked, as `Shadows.reaching`; empty if all of it reaches the coat.
    """
    sample, row, column = wp.tid()
    up, down = wp.max(row - 1, 0), wp.min(row + 1, rest_depth.shape[0] - 1)
    left, right = wp.max(column - 1, 0), wp.min(column + 1, rest_depth.shape[1] - 1)
    here = _view(rest_depth, height, half, focal, sample, row, column)
    along_rows = _view(rest_depth, height, half, focal, sample, down, column) - _view(
        rest_depth, height, half, focal, sample, up, column
    )
    along_columns = _view(rest_depth, height, half, focal, sample, row, right) - _view(
        rest_depth, height, half, focal, sample, row, left
    )
    normal = wp.normalize(wp.cross(along_rows, along_columns))
    if normal[2] > 0.0:  # towards the camera
        normal = -normal
    power = wp.vec3f()
    for light in range(3):
        away = lights[light] - here
        square = wp.dot(away, away)
        cosine = wp.dot(away, normal) / wp.sqrt(square)
        power[light] = beams[light, row, column] * wp.max(cosine, 0.0) / square
        if reaching.shape[0] > 0:
            power[light] = power[light] * reaching[3 * sample + light, row, column]
    total = wp.transpose(colour) * power
    if not wp.isfinite(here[2] + along_rows[2] + along_columns[2]):
        total = wp.vec3f(wp.nan)
    light_out[sample, row, column] = total


@wp.kernel
def _image_kernel(
    background: wp.array2d(dtype=wp.vec3f),
    at_rest: wp.array3d(dtype=wp.vec3f),
    light: wp.array3d(dtype=wp.vec3f),
    gain: wp.vec3f,
    noise: wp.float32,
    seed: wp.int32,
    # outputs
    image_out: wp.array4d(dtype=wp.uint8),
):
    """Grey levels: the background, the change of light by the press, and noise."""
    sample, row, column = wp.tid()
    rows, columns = light.shape[1], light.shape[2]
    value = background[row, column]
    change = wp.cw_mul(gain, light[sample, row, column] - at_rest[0, row, column])
    if wp.isfinite(change[0]):
        value += change
    state = wp.rand_init(seed, (sample * rows + row) * columns + column)
    for channel in range(3):
        level = value[channel] + noise * wp.randn(state)
        image_out[sample, row, column, channel] = wp.uint8(wp.clamp(level + 0.5, 0.0, 255.5))


@dataclass(frozen=True)
class Illumination:
    """Lights as they reach the coat.

    lights : (3, 3) m, positions of the red, green and blue light, in the sensor's frame
    crosstalk : share of each light's power that the other two channels see
    beams : (3, height, width) power that each light sends to a pixel, relative to that of an even light
    """

    lights: np.ndarray
    crosstalk: float
    beams: np.ndarray


class DirectShading:
    """Makes images (sample, height, width, 3) uint8, red first, from height maps (sample, height, width) m.

    rest_depth : (height, width) m, smooth, because facets would be visible; infinite beside the gel
    """

    def __init__(self, rest_depth: np.ndarray, pinhole: Pinhole, illumination: Illumination, device: str = "cpu"):
        self.pinhole, self.device = pinhole, device
        self._rest_depth = wp.array(rest_depth, dtype=wp.float32, device=device)
        own, other = np.eye(3), illumination.crosstalk
        self._colour = wp.mat33f((other + (1.0 - other) * own).ravel())
        self._lights = wp.mat33f(pinhole.in_view(illumination.lights).ravel())
        self._beams = wp.array(illumination.beams, dtype=wp.float32, device=device)
        self._scattered = np.moveaxis(illumination.beams, 0, -1)
        self._at_rest = self.light(wp.zeros((1, *rest_depth.shape), dtype=wp.float32, device=device))

    @property
    def at_rest(self) -> np.ndarray:
        """Light (height, width, 3) of the untouched gel, 1/m2; NaN beside it."""
        return self._at_rest.numpy()[0]

    def light(self, height: wp.array, reaching: wp.array | None = None) -> wp.array:
        """Light (sample, height, width) vec3, 1/m2, for an albedo of 1. ``reaching`` is that of `image`."""
        if reaching is None:
            reaching = wp.empty((0, 0, 0), dtype=wp.float32, device=self.device)
        out = wp.empty(height.shape, dtype=wp.vec3f, device=self.device)
        half, focal = wp.vec2f(0.5 * self.pinhole.width, 0.5 * self.pinhole.height), float(self.pinhole.focal)
        inputs = [self._rest_depth, height, self._lights, self._colour, self._beams, half, focal, reaching]
        wp.launch(_light_kernel, dim=height.shape, inputs=inputs, outputs=[out], device=self.device)
        return out

    def exposure(self, level: np.ndarray, ambient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gain (3,), levels m2, and background (height, width, 3), levels, that give channels these mean levels.

        level, ambient : (3,) mean grey level on the untouched gel, and the share of ambient light in it. Ambient light
            is that of the channel's own light, scattered: it is as uneven as its beam, but knows no tilt

        Raises `InputError` if a channel is dark.
        """
        at_rest = self.at_rest
        mean = np.nanmean(at_rest, axis=(0, 1))
        if not (mean > 0.0).all():
            raise InputError("camera: a drawn light does not shine on the gel; allowed: lights around the gel")
        gain = np.asarray(level) * (1.0 - np.asarray(ambient)) / mean
        scattered = self._scattered / self._scattered[np.isfinite(at_rest[..., 0])].mean(axis=0)
        background = np.clip(np.asarray(level) * ambient * scattered + gain * at_rest, 0.0, 255.0)
        return gain, np.nan_to_num(background)

    def image(
        self, height: wp.array, gain: np.ndarray, background: np.ndarray, noise: float = 0.0, seed: int = 0,
        reaching: wp.array | None = None,
    ) -> wp.array:  # fmt: skip
        """Images of height maps.

        gain : (3,) levels m2; background : (height, width, 3) levels of the untouched gel
        noise : standard deviation, levels, of Gaussian noise of each pixel; ``seed`` and a sample's number decide it
        reaching : (3 * sample, height, width) share of each light that other gel does not block; by default all of it
        """
        out = wp.empty((*height.shape, 3), dtype=wp.uint8, device=self.device)
        rest = wp.array(background, dtype=wp.vec3f, device=self.device)
        inputs = [rest, self._at_rest, self.light(height, reaching), wp.vec3f(*map(float, gain)), float(noise), seed]
        wp.launch(_image_kernel, dim=height.shape, inputs=inputs, outputs=[out], device=self.device)
        return out
