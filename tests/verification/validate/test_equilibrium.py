"""Consistent loads, and equilibria that cannot be found."""

import numpy as np
import pytest

from simgen.fem.elements.element import P2P1, face_geometry
from simgen.verification.validate import equilibrium, exact
from simgen.verification.validate.meshes import box, perturbed, top
from simgen.verification.validate.reference_law import ReferenceLaw


def test_a_load_of_constant_stress_is_stress_times_area_and_has_no_moment():
    mesh = perturbed(box(), shift=0.2, bend=0.1, inside_only=True)
    load = equilibrium.surface_load(mesh, top(mesh.nodes, mesh.faces), exact.constant(np.eye(3)))
    area = face_geometry(P2P1, mesh.nodes, top(mesh.nodes, mesh.faces)).areas.sum()
    np.testing.assert_allclose(load.sum(axis=0), [0.0, -area, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.cross(mesh.nodes, load).sum(axis=0), 0.0, atol=1e-12)


def test_an_equilibrium_that_cannot_be_found_says_which_step():
    mesh = box((1, 1, 1), (1.0, 1.0, 1.0))
    fixed = np.ones(mesh.nodes.shape, dtype=bool)
    body = equilibrium.make_body(mesh, ReferenceLaw(0.499), "cpu")
    with pytest.raises(RuntimeError, match=r"step 1 of 2.*inverted"):
        equilibrium.solve(body, fixed, -2.1 * mesh.nodes * [0.0, 1.0, 0.0], steps=2)
