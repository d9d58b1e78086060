"""Estimates of the discretisation error of a press: of its surface and of its force.

Surface: the same press on the next coarser mesh. The error is taken as C h^p, with the mean element size h = N^(-1/3)
of N unknowns. So the error of the finer mesh is 1 / ((h_coarser / h)^p - 1) times the difference of both (Richardson's
extrapolation). The exponent p, `ORDER`, is measured on both bundled sensors.

Force: the energy of the strain's error (`simgen.fem.elements.recovered_strain`). The error of an elastic body's stored
energy is the energy of its error. The force is the derivative of the stored energy by the indenter's travel. So the
force's error is the derivative of the error's energy. `ENERGY_FACTOR` is measured, too, as recovered strains err
themselves. docs/accuracy.md compares both estimates with true errors.
"""

import numpy as np

ORDER = 2.2
ENERGY_FACTOR = 1.5  # true over recovered energy of the error
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


def surface_error_estimate(displacement: np.ndarray, coarser: np.ndarray, share: float) -> np.ndarray:
    """Estimate the surface's error (d,) float32 m, from displacements (d, v, 3) m on a mesh and on a coarser one.

    NaN where the press on the coarser mesh did not get so far. ``share``: see `share_of_difference`.
    """
    return (share * surface_difference(coarser, displacement)).astype(np.float32)


def force_error_estimate(energy: np.ndarray, force: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Estimate the error of the force as a share of it, (d,) float32, by central differences along a path.

    energy (d,) J : of the strain's error; force (d, 3) N; path (d, 3) m : offsets of the indenter from first touch

    NaN where the press did not get so far, and where the indenter only turns.
    """
    travel = np.linalg.norm(np.diff(path, axis=0, prepend=0.0), axis=1).cumsum()
    energies, travels = np.append(0.0, energy), np.append(0.0, travel)
    ahead = np.append(np.arange(2, len(travels)), len(travels) - 1)  # the last step has no next one
    ahead = np.where(np.isfinite(energies[ahead]), ahead, np.arange(1, len(travels)))
    behind = np.arange(len(travels) - 1)
    work = (travels[ahead] - travels[behind]) * np.linalg.norm(force, axis=1)
    share = np.full(len(force), np.nan)
    np.divide(ENERGY_FACTOR * np.abs(energies[ahead] - energies[behind]), work, out=share, where=work > 0.0)
    return share.astype(np.float32)
