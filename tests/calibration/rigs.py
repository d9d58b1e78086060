"""A rig whose forces follow a formula, so that a fit takes no presses."""

import numpy as np

from simgen.calibration.rig import ForceCurve, Rig
from simgen.sensors.material import Material

GEL = Material(youngs_modulus_pa=1e5, poisson_ratio=0.475, friction=0.9)
MESH_ERROR = 0.01


def formula(nu: float, friction: float, c20: float, depth_mm: np.ndarray) -> np.ndarray:
    """N per Pa: like a sphere's, larger with nu, friction and C20 where the press is deep."""
    depth = np.maximum(depth_mm, 0.0)
    stiffer = 1.0 + depth * (0.3 * np.tanh(friction / 0.2) + 1.5 * (nu - 0.3) + 5.0 * c20)
    return 1e-5 * depth**1.5 * stiffer


class FormulaRig(Rig):
    """`Rig` with `formula` for a press; ``made`` counts the presses."""

    def __init__(self, material: Material = GEL):
        super().__init__(None, None, material)
        self.made = 0

    def press(self, values: dict[str, float], depth_mm: np.ndarray) -> ForceCurve:
        self.made += 1
        force = formula(values["nu"], values["friction"], values["c20"], depth_mm)
        return ForceCurve(depth_mm, force, np.full(len(depth_mm), MESH_ERROR))

    def check_room(self, deepest_mm: float) -> None:
        """There is always room."""
