"""NGSolve solves the layer on a coarse mesh."""

import pytest

from tests.verification.validate.peer_checks import QUARTER_MM3, check_coarse, press_coarse


def test_ngsolve_on_a_coarse_mesh():
    pytest.importorskip("ngsolve")
    import ngsolve

    from simgen.verification.validate import peer_ngsolve

    mesh = peer_ngsolve.make_mesh(0.5, 3.0)
    assert ngsolve.Integrate(1.0, mesh) == pytest.approx(QUARTER_MM3, rel=1e-3)
    check_coarse(press_coarse(peer_ngsolve.solve, 0.5, 3.0))
