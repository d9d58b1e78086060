"""Estimates of the discretisation error of a press, from the same press on the next coarser mesh.

An error C h^p with the mean element size h = N^(-1/3) of N unknowns makes the error of the finer mesh
1 / ((h_coarser / h)^p - 1) times the difference of both (Richardson's extrapolation). `ORDER` is measured on both
bundled sensors: surfaces approach their limit with order 2.0 on the BioTac and 2.4 on the DIGIT. docs/accuracy.md
compares the estimates with true errors.
"""

import numpy as np

from simgen.simulation.press import PressResult

ORDER = 2.2
MOVED_M = 1e-5  # displacement from which a vertex counts as moved, as in the ACROSS paper's deformation region
COARSER = {"fine": "default", "default": "coarse"}  # by mesh: the one to compare with


def share_of_difference(coarser_unknowns: int, unknowns: int) -> float:
    """Error of the finer mesh over its difference from the coarser one, from the numbers of unknowns."""
    return 1.0 / ((unknowns / coarser_unknowns) ** (ORDER / 3.0) - 1.0)


def surface_difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Root mean square (d,) of the distance of displacements a, b (d, v, 3) m over the vertices that b moves.

    These move by `MOVED_M` or more. NaN where a or b is; 0 where b moves none.
    """
    apart, moved = ((a - b) ** 2).sum(axis=2), (b**2).sum(axis=2) >= MOVED_M**2
    squares = np.where(moved, apart, 0.0).sum(axis=1) / np.maximum(moved.sum(axis=1), 1)
    return np.where(np.isnan(apart).any(axis=1), np.nan, np.sqrt(squares))


def add_error_estimates(result: PressResult, coarser: PressResult, share: float) -> PressResult:
    """Add the outputs ``surface_error_estimate_m`` and ``force_error_estimate`` (d,) to a result, and return it.

    coarser : the same press on the coarser mesh, with the same output vertices; NaN where it did not get that far
    share : see `share_of_difference`
    """
    force, coarser_force = (np.linalg.norm(each.force, axis=1) for each in (result, coarser))
    relative = (coarser_force - force) / np.where(force > 0.0, force, np.nan)
    surface = surface_difference(coarser.displacement, result.displacement)
    result.outputs["force_error_estimate"] = (share * relative).astype(np.float32)
    result.outputs["surface_error_estimate_m"] = (share * surface).astype(np.float32)
    result.seconds += coarser.seconds
    return result
