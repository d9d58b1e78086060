"""The cases with exact solutions fail where the solver is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import P2P1
from simgen.fem.material import LAWS
from simgen.verification.validate import exact
from simgen.verification.validate.case import Context
from simgen.verification.validate.reference_law import ReferenceLaw


def softer(mesh, law, device):
    """A body whose shear modulus is wrong by one part in a million."""
    right = LAWS[law.name].from_engineering(1.0, law.poisson_ratio, 3.0, **law.constants)
    wrong = replace(right, mu=right.mu * (1.0 + 1e-6))
    active = ActiveEnvironments(1, device)
    return Elasticity(P2P1, mesh.nodes, mesh.tetrahedra, mesh.n_corners, wrong, device, active)


def test_the_case_notices_a_wrong_modulus(monkeypatch):
    monkeypatch.setattr(exact, "make_body", softer)
    monkeypatch.setattr(exact, "LAWS", (ReferenceLaw(0.3), ReferenceLaw(0.499)))
    rows = exact.simple_shear(Context("cpu", None, None, None)).rows
    assert rows and not any(row.passed for row in rows)


@pytest.mark.parametrize("J", [0.9, 1.3])
def test_the_deformation_of_the_patch_has_its_volume(J):
    F = exact.stretch_and_shear(J)
    assert np.linalg.det(F) == pytest.approx(J, rel=1e-14)
    assert abs(F - F.T).max() > 0.1
