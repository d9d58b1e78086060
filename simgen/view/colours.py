"""Colours of a surface, and the quantities that it can be coloured by."""

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import to_hex

from simgen.plotting.surface_plot import COLOURS
from simgen.units import MM_PER_M

PA_PER_KPA = 1e3
STOPS = 9  # of the colour scale in the legend
NO_VALUE = to_hex(COLOURS.get_bad())


@dataclass(frozen=True)
class SurfaceField:
    """A quantity at the vertices of a `simgen.view.drawn_surface.DrawnSurface`, at one step.

    values : (v,) float32 in ``unit``; NaN where there is none
    largest : end of the colour scale, which starts at 0; the same at all steps of a press
    """

    title: str
    unit: str
    values: np.ndarray
    largest: float

    @property
    def label(self) -> str:
        return f"{self.title}, {self.unit}" if self.unit else self.title

    @property
    def colours(self) -> np.ndarray:
        """Colours (v, 3) uint8, see `colours_of`."""
        return colours_of(self.values, self.largest)


def colours_of(values: np.ndarray, largest: float) -> np.ndarray:
    """Colours (..., 3) uint8 of values (...) on a scale from 0 to ``largest``; `NO_VALUE` for NaN."""
    share = np.ma.masked_invalid(np.asarray(values, float) / (largest or 1.0))
    return COLOURS(share, bytes=True)[..., :3]


def colour_stops(count: int = STOPS) -> list[str]:
    """Colours of the scale at even distances from 0 to its end, as #rrggbb."""
    return [to_hex(COLOURS(share)) for share in np.linspace(0.0, 1.0, count).tolist()]


def css_gradient(direction: str = "to right") -> str:
    """CSS value of the colour scale, from 0 to its end."""
    return f"linear-gradient({direction}, {', '.join(colour_stops())})"


def displacement_mm(displacement: np.ndarray) -> np.ndarray:
    """Length (...) float32, mm, of displacements (..., 3) m."""
    return np.float32(MM_PER_M * np.linalg.norm(displacement, axis=-1))


def traction_kpa(traction: np.ndarray) -> np.ndarray:
    """Size (...) float32, kPa, of tractions (..., 3) Pa."""
    return np.float32(np.linalg.norm(traction, axis=-1) / PA_PER_KPA)


def pressure_kpa(traction: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Pressure (...) float32, kPa: the part of tractions (..., 3) Pa against outward unit normals (..., 3)."""
    return np.float32(-np.einsum("...i,...i->...", traction, normals) / PA_PER_KPA)


def von_mises_kpa(stress: np.ndarray) -> np.ndarray:
    """Von Mises stress (...) float32, kPa, of stresses (..., 6) Pa as xx, yy, zz, yz, xz, xy.

    sqrt(3 J2), with the second invariant J2 of the deviator (von Mises, 1913).
    """
    xx, yy, zz, yz, xz, xy = np.moveaxis(np.asarray(stress, float), -1, 0)
    normal = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.float32(np.sqrt(0.5 * normal + 3.0 * (yz**2 + xz**2 + xy**2)) / PA_PER_KPA)
