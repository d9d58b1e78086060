"""FElupe solves the layer on a coarse mesh."""

import pytest

from tests.verification.validate.peer_checks import QUARTER_MM3, check_coarse, press_coarse


def test_felupe_on_a_coarse_mesh():
    felupe = pytest.importorskip("felupe")
    from simgen.verification.validate import peer_felupe

    mesh = peer_felupe.make_mesh(3, 2, 0.5)
    assert felupe.RegionTriQuadraticHexahedron(mesh).dV.sum() == pytest.approx(QUARTER_MM3, rel=1e-3)
    check_coarse(press_coarse(peer_felupe.solve, 3, 2, 0.5))
