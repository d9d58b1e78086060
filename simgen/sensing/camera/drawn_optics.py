"""Optics drawn at random for each press, so that images are not those of one sensor."""

from dataclasses import asdict, dataclass, field, fields
from typing import Any, Self

import numpy as np

from simgen.sensing.camera.photometry import COLOURS
from simgen.sensors.pinhole import Pinhole

WAVES = 6  # of a beam's unevenness
LONGEST, SHORTEST = 2.0, 0.4  # their wavelengths, in sides of the image


Span = tuple[float, float]  # least and largest value; values are drawn evenly between them


@dataclass(frozen=True)
class OpticsRanges:
    """Ranges that optics are drawn from. `DrawnOptics` says what each value means.

    Each press draws every value anew. Lights and channels draw their own.

    Levels are the least and the largest mean of the red, green and blue channel of 31 pictures of untouched DIGITs
    (suddhu/tacto, commit fc653c23). The noise is that of 50 pictures of a DIGIT away from a ball, from differences of
    neighbouring pixels (vocdex/Taxim, commit 4d654588): 0.8 to 1.8 levels by channel and size. No measurement tells
    the others alone. They are chosen so that drawn pictures differ from one another as those 31 do. Red is the
    least even channel of those.
    """

    radius: Span = (0.8, 1.3)
    angle_deg: Span = (-30.0, 30.0)
    depth: Span = (0.8, 0.95)
    level_red: Span = (89.0, 106.0)
    level_green: Span = (88.0, 118.0)
    level_blue: Span = (84.0, 105.0)
    ambient: Span = (0.6, 0.95)
    crosstalk: Span = (0.0, 0.2)
    unevenness_red: Span = (0.2, 0.5)
    unevenness_green: Span = (0.05, 0.25)
    unevenness_blue: Span = (0.05, 0.25)
    noise: Span = (0.8, 1.8)

    def record(self) -> dict[str, list[float]]:
        """Ranges by name, for JSON."""
        return {each.name: list(getattr(self, each.name)) for each in fields(self)}


@dataclass(frozen=True)
class DrawnOptics:
    """Optics of one press.

    radius : (3,) distance of the red, green and blue light from the optical axis, relative to the sensor's own
    angle_deg : (3,) angle around the optical axis, from the sensor's own light
    depth : (3,) depth of each light along the optical axis, as a share of the gel's greatest depth
    level : (3,) mean grey level of each channel of the untouched gel
    ambient : (3,) share of ambient light in that level, that is, of light that no tilt changes
    crosstalk : share of each light's power that the other two channels see
    unevenness : (3,) standard deviation of the logarithm of each light's beam over the image
    noise : standard deviation of each pixel's noise, grey levels
    seed : of the beams and the noise
    """

    radius: tuple[float, ...]
    angle_deg: tuple[float, ...]
    depth: tuple[float, ...]
    level: tuple[float, ...]
    ambient: tuple[float, ...]
    crosstalk: float
    unevenness: tuple[float, ...]
    noise: float
    seed: int = field(repr=False)

    @classmethod
    def draw(cls, seed: int, press: int, ranges: OpticsRanges = OpticsRanges()) -> Self:
        """Draw the optics of a press. They depend on the two numbers alone."""
        rng = np.random.default_rng([seed, press])

        def three(span: Span) -> tuple[float, ...]:
            return tuple(rng.uniform(*span, 3).tolist())

        return cls(
            radius=three(ranges.radius),
            angle_deg=three(ranges.angle_deg),
            depth=three(ranges.depth),
            level=tuple(rng.uniform(*getattr(ranges, f"level_{colour}")) for colour in COLOURS),
            ambient=three(ranges.ambient),
            crosstalk=rng.uniform(*ranges.crosstalk),
            unevenness=tuple(rng.uniform(*getattr(ranges, f"unevenness_{colour}")) for colour in COLOURS),
            noise=rng.uniform(*ranges.noise),
            seed=int(rng.integers(2**31)),
        )

    def lights(self, own: np.ndarray, pinhole: Pinhole, gel_depth: float) -> np.ndarray:
        """Positions (3, 3) m of the lights, in the sensor's frame.

        own : (3, 3) m, the sensor's own lights; gel_depth : m, greatest depth of the gel at rest
        """
        right, up, _ = pinhole.in_view(own).T
        radius = np.hypot(right, up) * self.radius
        angle = np.arctan2(up, right) + np.radians(self.angle_deg)
        view = np.stack([radius * np.cos(angle), radius * np.sin(angle), gel_depth * np.array(self.depth)], axis=1)
        return view @ pinhole.axes + pinhole.position

    def beams(self, height: int, width: int) -> np.ndarray:
        """Power (3, height, width) that each light sends to a pixel, relative to that of an even light.

        Its logarithm is a sum of waves in random directions, with random phases.
        """
        rng = np.random.default_rng(self.seed)
        rows, columns = np.mgrid[:height, :width] / max(height, width)
        beams = []
        for spread in self.unevenness:
            angle, phase = rng.uniform(0.0, 2.0 * np.pi, (2, WAVES))
            number = 2.0 * np.pi / np.exp(rng.uniform(np.log(SHORTEST), np.log(LONGEST), WAVES))
            waves = [np.cos(k * (columns * np.cos(a) + rows * np.sin(a)) + p)
                     for k, a, p in zip(number, angle, phase, strict=True)]  # fmt: skip
            beams.append(np.exp(spread * np.sqrt(2.0 / WAVES) * np.sum(waves, axis=0)))
        return np.array(beams)

    def record(self) -> dict[str, Any]:
        """Drawn values by name, for JSON."""
        return asdict(self)
