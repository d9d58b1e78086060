"""Photometric model of a gel seen from within: three coloured lights and a matt coat.

A point of the coat sends to the camera

    albedo * (ambient + power * sum over lights of colour * max(n . l, 0) / |d|^2),   l = d / |d|

where d leads from the point to a light, and n is the coat's normal on the camera's side (Lambert's cosine law, inverse
square law). Lights are points and the gel is clear. Light reflected by other parts of the coat counts as ambient.
"""

from dataclasses import dataclass

import numpy as np

from simgen.errors import InputError

COLOURS = ("red", "green", "blue")


@dataclass(frozen=True)
class Photometry:
    """Lights and coat of a sensor.

    lights : (3, 3) m, positions of the red, green and blue light, in the sensor's frame
    crosstalk : share of each light's power that the camera's other two channels see; assumed
    albedo : share of light that the grey coat reflects; assumed
    ambient : ambient light of a channel, relative to the brightest pixel of the untouched gel; assumed
    brightest : grey level, 0 to 255, of that pixel
    """

    lights: np.ndarray
    crosstalk: float = 0.1
    albedo: float = 0.6
    ambient: float = 0.15
    brightest: float = 180.0

    def radiance(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Radiance (..., 3) of points (..., 3) m with unit normals (..., 3), in any unit, without ambient light."""
        colour = np.full((3, 3), self.crosstalk) + (1.0 - self.crosstalk) * np.eye(3)
        total = np.zeros(points.shape)
        for light, own in zip(self.lights, colour, strict=True):
            away = light - points
            square = np.einsum("...i,...i->...", away, away)
            cosine = np.einsum("...i,...i->...", away, normals) / np.sqrt(square)
            total += (np.maximum(cosine, 0.0) / square)[..., None] * own
        return self.albedo * total

    def exposure(self, untouched: np.ndarray) -> float:
        """Grey levels per radiance that give the brightest pixel of ``untouched`` (..., 3) the level ``brightest``.

        Raises `InputError` if all pixels are dark.
        """
        most = float(np.nanmax(untouched))
        if most <= 0.0:
            raise InputError("camera: no light shines on the gel; allowed: lights on the camera's side of it")
        return self.brightest * (1.0 - self.ambient) / most

    def image(self, radiance: np.ndarray, exposure: float) -> np.ndarray:
        """Grey levels (..., 3), float, 0 to 255, of radiances (..., 3)."""
        return np.clip(self.brightest * self.ambient + exposure * radiance, 0.0, 255.0)
