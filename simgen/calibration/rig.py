"""A simulated rig: one indenter over one place of a sensor, and its forces for any material of the gel.

The solver works in units of E. So at fixed nu, friction, C20 / E and C30 / E, forces are proportional to E.
"""

from dataclasses import dataclass, field

import numpy as np

from simgen.config.indenter_path import press_path
from simgen.config.strict_section import section_from_dict
from simgen.errors import InputError
from simgen.fem.nonlinear.status import Status, has_values
from simgen.geometry.developed_skin import skin_of
from simgen.geometry.signed_distance import RigidShape
from simgen.sensors.least_thickness import LeastThickness
from simgen.sensors.material import Material
from simgen.sensors.pairing import Contacts, indenter_poses
from simgen.sensors.sensor import Sensor
from simgen.simulation.press import Scene, press
from simgen.units import MM, MM_PER_M

TOUCHABLE = 0  # region of a sensor's surface
LEAST_LEFT = 0.05  # share of the gel's thickness under the indenter
UNIT_PA = 1e6  # E of the simulated presses


@dataclass(frozen=True)
class ForceCurve:
    """Forces of one press.

    depth_mm : (d,) mm from first touch
    force : (d,) N per Pa of E, the component along the press, as a load cell in the press's axis measures it
    mesh_error : (d,) estimated error of the mesh, as a share of the force (`simgen.simulation.error_estimate`)
    """

    depth_mm: np.ndarray
    force: np.ndarray
    mesh_error: np.ndarray


@dataclass
class Rig:
    """An indenter that presses one place of a sensor along the local normal.

    sensor : with the mesh to solve on
    shape : of the indenter, mm
    place_mm : x, and arc from the centre line, as in `simgen.geometry.developed_skin`; by default the middle of the
        touchable surface along x, on the centre line
    material : whatever a fit does not replace
    """

    sensor: Sensor
    shape: RigidShape
    material: Material
    place_mm: tuple[float, float] | None = None
    device: str = "cpu"
    curves: dict[tuple, ForceCurve] = field(default_factory=dict)  # made presses

    def values(self, **changes: float) -> dict[str, float]:
        """Parameters by name: the material's own, and changes."""
        own = self.material.law_constants
        return {"nu": self.material.poisson_ratio, "friction": self.material.friction,
                "c20": own.get("c20", 0.0), "c30": own.get("c30", 0.0), **changes}  # fmt: skip

    def solid(self, youngs_modulus_pa: float, values: dict[str, float], source: str = "") -> Material:
        """The material with a modulus and parameters of a fit. Raises `InputError` if it is not stable."""
        given = {"youngs_modulus_pa": youngs_modulus_pa, "poisson_ratio": values["nu"], "friction": values["friction"]}
        if values["c20"] or values["c30"]:
            constants = {f"{name}_pa": values[name] * youngs_modulus_pa for name in ("c20", "c30")}
            given |= {"law": "yeoh", **constants}
        return section_from_dict(Material, {**given, "source": source}, f"material of {self.sensor.name}")

    def press(self, values: dict[str, float], depth_mm: np.ndarray) -> ForceCurve:
        """Press to depths (d,) mm, increasing. Each press is made once.

        Raises `InputError` if a press does not reach its last depth.
        """
        key = (*sorted(values.items()), depth_mm.tobytes())
        if key not in self.curves:
            solid = self.solid(UNIT_PA, values)
            scene = Scene(self.sensor, solid, device=self.device, outputs=("error_energy",))
            result = press(scene, [self.shape], self.pose[None], depth_mm * MM)[0]
            if not has_values(result.status).all():
                first = int(np.argmin(has_values(result.status)))
                sentence = Status(int(result.status[first])).sentence
                raise InputError(f"{self.sensor.name}: the press with friction {solid.friction:g}, {solid.elasticity} "
                                 f"ends before {depth_mm[first]:.3g} mm: {sentence}")  # fmt: skip
            force = result.force @ self.pose[:3, 1] / UNIT_PA
            self.curves[key] = ForceCurve(depth_mm, force, np.asarray(result.force_error_estimate, float))
        return self.curves[key]

    @property
    def pressed_mm(self) -> tuple[float, float]:
        """The place that is pressed, x and arc, mm: ``place_mm``, or the default."""
        if self.place_mm is not None:
            return self.place_mm
        x = self.sensor.surface.triangles[self.sensor.surface_region == TOUCHABLE][..., 0]
        return 0.5 * MM_PER_M * float(x.min() + x.max()), 0.0

    @property
    def pose(self) -> np.ndarray:
        """Pose (4, 4) m of the indenter at its place. Raises `InputError` where the skin cannot be touched."""
        surface = self.sensor.surface
        touchable = self.sensor.surface_region == TOUCHABLE
        x = surface.triangles[touchable][..., 0]
        x_mm, arc_mm = self.pressed_mm
        points, normals = skin_of(surface).points([x_mm * MM], [arc_mm * MM])
        nearest = np.linalg.norm(surface.triangles_center - points, axis=1)
        if not np.isfinite(points).all() or not touchable[np.nanargmin(nearest)]:
            low, high = MM_PER_M * x.min(), MM_PER_M * x.max()
            raise InputError(f"{self.sensor.name}: nothing to touch at x = {x_mm:g} mm, arc {arc_mm:g} mm; allowed: x "
                             f"within {low:.4g} to {high:.4g} mm, and an arc on its touched side")  # fmt: skip
        zero = np.zeros(1)
        return indenter_poses(Contacts(points, normals, -normals, zero, zero))[0]

    def check_room(self, deepest_mm: float, extra_share: float = 0.0) -> None:
        """Raise `InputError` if a press would leave hardly any gel under the indenter.

        extra_share : the press goes deeper than ``deepest_mm`` by this share of it
        """
        path = press_path(np.array([deepest_mm * (1.0 + extra_share) * MM]))
        room = LeastThickness(self.sensor, [self.shape], path)
        if (share := room.shares(self.pose[None]).item()) < LEAST_LEFT:
            most = MM_PER_M * room.depths_that_leave(self.pose[None], LEAST_LEFT).item() / (1.0 + extra_share)
            extra = f", with {extra_share:.0%} more for the offset," if extra_share else ""
            raise InputError(f"{self.sensor.name}: a depth of {deepest_mm:.4g} mm{extra} leaves {share:.2g} of the gel "
                             f"under the indenter; allowed: at most {most:.3g} mm")  # fmt: skip
