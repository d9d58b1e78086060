"""A coarse solution of another code, checked against a coarse one of ours."""

import numpy as np
import pytest

from simgen.verification.validate import peers
from simgen.verification.validate.layer_reference import HEIGHT_MM, RADIUS_MM
from simgen.verification.validate.peer_scene import PeerSolution

DEPTHS_MM = np.array([0.1, 0.2])
QUARTER_MM3 = 0.25 * np.pi * RADIUS_MM**2 * HEIGHT_MM


def press_coarse(peer_solve, *size) -> PeerSolution:
    solution = peer_solve(*size, DEPTHS_MM, peers.surface_points())
    assert solution.converged and solution.seconds > 0.0
    return solution


def check_coarse(solution: PeerSolution):
    """Compare coarse meshes of both codes: they agree within some percent, but locking would be a factor."""
    ours = peers.solve(peers.LayerMeshSize(0.6, 0.7, 0.3, 0.66), DEPTHS_MM, "cpu")
    assert solution.force[-1] == pytest.approx(ours.force[-1], rel=0.05)
    assert peers.surface_rmse_um(solution.displacement[-1], ours.displacement[-1]) < 5.0
