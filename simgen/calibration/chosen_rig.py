"""The rig that a user describes: a sensor, an indenter or a sphere of any radius, and a place."""

import math
from dataclasses import dataclass
from typing import Literal

from simgen.calibration.rig import Rig
from simgen.config.warp_device import check_device
from simgen.errors import InputError, shown
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor

LARGEST_MM = 1e3  # radius of a sphere


@dataclass(frozen=True)
class RigChoice:
    """A rig as the user describes it.

    sensor : a bundled sensor, or the folder of a ``sensor.yaml``; mesh : of it; material : a preset of it
    indenter : a bundled name or a closed mesh, in ``unit``; or ``radius_mm`` of a sphere
    place_mm : x and arc, see `Rig`; friction : replaces the material's
    """

    sensor: str
    indenter: str | None = None
    radius_mm: float | None = None
    unit: Literal["m", "mm"] = "m"
    mesh: str = "default"
    material: str = "solid"
    friction: float | None = None
    place_mm: tuple[float, float] | None = None
    device: str = "cpu"

    @property
    def indenter_in_words(self) -> str:
        return self.indenter or f"sphere of R = {self.radius_mm:g} mm"

    def rig(self) -> Rig:
        """Load everything. Raises `InputError` for any choice that is not there or not allowed."""
        if (self.indenter is None) == (self.radius_mm is None):
            raise InputError("the indenter: allowed: one of --indenter and --radius-mm")
        if self.radius_mm is not None and not 0.0 < self.radius_mm <= LARGEST_MM:
            raise InputError(f"--radius-mm {self.radius_mm:g}: allowed: more than 0, at most {LARGEST_MM:g}")
        if self.unit not in ("m", "mm"):
            raise InputError(f"--unit {shown(self.unit)}: allowed: m, mm")
        if self.friction is not None and not 0.0 <= self.friction <= 2.0:
            raise InputError(f"--friction {self.friction:g}: allowed: 0 to 2")
        check_device(self.device)
        if self.radius_mm is not None:
            shape = rigid_shape(Kind.SPHERE, self.radius_mm)
        else:
            shape = load_indenter(self.indenter, unit=self.unit).shape()
        sensor = load_sensor(self.sensor, self.mesh)
        if self.material not in sensor.materials:
            names = ", ".join(sensor.materials)
            raise InputError(f"--material {shown(self.material)}: sensor {sensor.name} has no such material; allowed: "
                             f"{names}")  # fmt: skip
        material = sensor.materials[self.material]
        if self.friction is not None:
            material = material.model_copy(update={"friction": self.friction})
        return Rig(sensor, shape, material, self.place_mm, self.device)


def place_of(text: str | None) -> tuple[float, float] | None:
    """Numbers of ``--at X,ARC``, mm. Raises `InputError` for other text."""
    if text is None:
        return None
    try:
        x, arc = map(float, text.split(","))
    except ValueError:
        x = arc = math.nan
    if not (math.isfinite(x) and math.isfinite(arc)):
        raise InputError(f"--at {shown(text)!r}: write it as X,ARC in mm, such as -7.5,0")
    return x, arc
