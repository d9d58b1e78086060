"""Reference solutions of a rigid sphere pressed into a bonded, nearly incompressible layer.

The layer is a cylinder of radius 10 mm and height 4 mm with a fixed bottom, E = 0.539 MPa and nu = 0.499. The reference
was solved with NGSolve 6.2.2608: axisymmetric, mixed displacement-pressure elements of order 3, edges of 0.1 mm under
the contact. The order is 2 with friction 0.3, and with friction 0.78 in 160 steps. CalculiX 2.20 agrees within 0.1 %
without and 0.7 % with friction. ``axisymmetric/profile.csv`` of the reference data has the surface.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

RADIUS_MM, HEIGHT_MM = 10.0, 4.0
MODULUS_MPA, POISSON_RATIO = 0.539, 0.499
DEPTHS_MM = (0.1, 0.25, 0.5, 1.0, 1.5, 2.0)


@dataclass(frozen=True)
class Reference:
    """Solution for one sphere and friction coefficient at `DEPTHS_MM`.

    steps : load steps to 2 mm
    force : N
    contact_radius : radius of the deformed contact circle, mm
    pressure : MPa per rest area, in the centre at 2 mm
    """

    steps: int
    force: tuple[float, ...]
    contact_radius: tuple[float, ...]
    pressure: float


# By radius of the sphere (mm) and friction. With friction, the force falls as load steps get smaller: by 0.7 % at 1 mm
# and 0.95 % at 2 mm from 20 to 160 steps (R = 3.5 mm, friction 0.78). These values have the smallest steps.
REFERENCES = {
    (1.75, 0.0): Reference(20, (0.044264, 0.185391, 0.55679, 1.672366, 3.092791, 4.612096),
                           (0.4429, 0.703, 0.9962, 1.3728, 1.5981, 1.7244), 2.3641),
    (1.75, 0.78): Reference(20, (0.044558, 0.187333, 0.5702, 1.797915, 3.605549, 5.999323),
                            (0.4403, 0.6996, 0.983, 1.3392, 1.5593, 1.6833), 0.66484),
    (3.5, 0.0): Reference(20, (0.066807, 0.294911, 0.949334, 3.208069, 6.61062, 11.013194),
                          (0.6365, 1.032, 1.4958, 2.156, 2.6257, 2.9763), 1.55964),
    (3.5, 0.3): Reference(20, (0.067254, 0.297022, 0.969971, 3.442955, 7.609133, 13.759968),
                          (0.6332, 1.0282, 1.4895, 2.1326, 2.5812, 2.9209), 0.64949),
    (3.5, 0.78): Reference(160, (0.067206, 0.296393, 0.96785, 3.438513, 7.673477, 14.106639),
                           (0.635, 1.0289, 1.4911, 2.1327, 2.575, 2.9037), 0.6498),
    (7.0, 0.0): Reference(20, (0.103716, 0.491059, 1.727815, 6.564298, 14.680614, 26.273367),
                          (0.9208, 1.5244, 2.2561, 3.3169, 4.117, 4.7522), 1.6007),
}  # fmt: skip
# Order 3 with 20 steps gives 0.681 MPa in the centre, order 2 with 40 steps 0.647 MPa (3.5 mm, friction 0.78).
PRESSURE_SCATTER = 0.05

# Exact linear theory of a frictionless paraboloid on an infinite bonded layer, nu = 0.499, by chi = sqrt(R d) / h:
# force over Hertz's force, and contact radius over sqrt(R d).
LINEAR = {0.1: (1.1288, 1.0409), 0.25: (1.39979, 1.11277)}


def hertz_force(sphere_mm: float, depth_mm: float) -> float:
    """Force on a half-space of the layer's material, N (Johnson, *Contact Mechanics*, 1985, eq. 4.23)."""
    return 4.0 / 3.0 * MODULUS_MPA / (1.0 - POISSON_RATIO**2) * sphere_mm**0.5 * depth_mm**1.5


def dimitriadis_force(sphere_mm: float, depth_mm: float) -> float:
    """Force on a thin bonded incompressible layer, N (Dimitriadis et al., Biophys. J. 82, 2002, eq. 12)."""
    chi = (sphere_mm * depth_mm) ** 0.5 / HEIGHT_MM
    series = 1.0 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4
    return 16.0 / 9.0 * MODULUS_MPA * sphere_mm**0.5 * depth_mm**1.5 * series


def read_profiles(reference: Path | None, sphere_mm: float, friction: float) -> dict[float, np.ndarray]:
    """Read the surface by depth, (k, 3) mm: rest radius, u_r, and u_y into the layer. Empty without the file."""
    path = None if reference is None else reference / "axisymmetric" / "profile.csv"
    if path is None or not path.is_file():
        return {}
    profiles: dict[float, list] = {}
    with path.open(newline="") as table:
        for row in csv.DictReader(table):
            if (float(row["sphere_radius_mm"]), float(row["friction"])) == (sphere_mm, friction):
                values = float(row["r_mm"]), float(row["u_r_mm"]), -float(row["u_z_mm"])
                profiles.setdefault(float(row["depth_mm"]), []).append(values)
    return {depth: np.array(rows) for depth, rows in profiles.items()}
