"""Independent codes: each solves the layer by itself, and a difference between codes is told."""

import dataclasses

import numpy as np
import pytest

from simgen.verification.validate import peers
from simgen.verification.validate.layer_reference import HEIGHT_MM, RADIUS_MM
from simgen.verification.validate.peer_scene import PeerSolution

DEPTHS_MM = np.array([0.1, 0.2])
QUARTER_MM3 = 0.25 * np.pi * RADIUS_MM**2 * HEIGHT_MM


def made_up(code: str, force: float = 1.0, shift_mm: float = 0.0) -> PeerSolution:
    d = len(peers.STEPS_MM)
    displacement = np.full((d, len(peers.surface_points()), 3), 0.1)
    displacement[..., 1] += shift_mm
    return PeerSolution(code, 1000, 1.0, 10, 0, np.full(d, force), displacement)


def test_codes_that_agree_pass():
    outcome = peers.compare(made_up("peer"), made_up("simgen", force=1.009, shift_mm=0.004))
    assert len(outcome.rows) == 4
    assert all(row.passed for row in outcome.rows)
    assert [row.ours for row in outcome.rows if row.unit == "um"] == pytest.approx([4.0, 4.0])


@pytest.mark.parametrize(("ours", "unit"), [({"force": 1.011}, "N"), ({"shift_mm": 0.006}, "um")])
def test_codes_that_differ_fail(ours, unit):
    outcome = peers.compare(made_up("peer"), made_up("simgen", **ours))
    assert {row.unit for row in outcome.rows if not row.passed} == {unit}


def test_a_press_that_did_not_converge_fails():
    broken = made_up("simgen")
    broken = dataclasses.replace(broken, force=np.full_like(broken.force, np.nan))
    assert not broken.converged
    assert not any(row.passed for row in peers.compare(made_up("peer"), broken).rows if row.unit == "N")


def test_an_absent_package_is_skipped():
    outcome = peers.against("no_such_package", made_up, "cpu")
    assert "no_such_package is not installed" in outcome.skipped
    assert outcome.rows == []


def press_coarse(peer_solve, *size) -> PeerSolution:
    solution = peer_solve(*size, DEPTHS_MM, peers.surface_points())
    assert solution.converged and solution.seconds > 0.0
    return solution


def check_coarse(solution: PeerSolution):
    """A coarse mesh of any code is within some percent of a coarse mesh of ours; locking would be a factor."""
    ours = peers.solve(peers.LayerMeshSize(0.6, 0.7, 0.3, 0.66), DEPTHS_MM, "cpu")
    assert solution.force[-1] == pytest.approx(ours.force[-1], rel=0.05)
    assert peers.surface_rmse_um(solution.displacement[-1], ours.displacement[-1]) < 5.0


def test_ngsolve_on_a_coarse_mesh():
    pytest.importorskip("ngsolve")
    import ngsolve

    from simgen.verification.validate import peer_ngsolve

    mesh = peer_ngsolve.make_mesh(0.5, 3.0)
    assert ngsolve.Integrate(1.0, mesh) == pytest.approx(QUARTER_MM3, rel=1e-3)
    check_coarse(press_coarse(peer_ngsolve.solve, 0.5, 3.0))


def test_felupe_on_a_coarse_mesh():
    felupe = pytest.importorskip("felupe")
    from simgen.verification.validate import peer_felupe

    mesh = peer_felupe.make_mesh(3, 2, 0.5)
    assert felupe.RegionTriQuadraticHexahedron(mesh).dV.sum() == pytest.approx(QUARTER_MM3, rel=1e-3)
    check_coarse(press_coarse(peer_felupe.solve, 3, 2, 0.5))
