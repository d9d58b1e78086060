"""Stress at nodes: exact in homogeneous states."""

import numpy as np
import pytest
import warp as wp

from simgen.fem.elements.nodal_stress import COMPONENTS, NodalStress
from simgen.verification.validate.equilibrium import make_body, solve
from simgen.verification.validate.exact import block, homogeneous, stretch_and_shear
from simgen.verification.validate.meshes import on_plane
from simgen.verification.validate.reference_law import LAWS, ReferenceLaw


def stress_of(body, found, nodes):
    """(node, 6) of an equilibrium."""
    x = np.append(found.displacement.ravel(), found.pressure)[:, None]
    stress, sums = NodalStress(body, nodes), wp.zeros((len(nodes), 6, 1), dtype=wp.float64, device="cpu")
    stress.add_to(sums, wp.array(x, dtype=wp.float64, device="cpu"))
    return sums.numpy()[:, :, 0] / stress.volumes[:, None]


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_a_homogeneous_state_has_its_stress_at_every_node(law):
    """sigma = P F^T / det F with the law in numpy, on irregular, bent elements: exact to the solver's balance."""
    body_mesh = block(inside_only=False)
    body, F = make_body(body_mesh, law, "cpu"), stretch_and_shear(1.0 + 0.003 / (law.poisson_ratio + 0.5))
    fixed = np.zeros(body_mesh.nodes.shape, dtype=bool)
    fixed[body_mesh.faces.ravel()] = True
    found = solve(body, fixed, np.where(fixed, homogeneous(F, body_mesh), 0.0), steps=4)
    sigma = law.first_piola(F) @ F.T / np.linalg.det(F)
    expected = [sigma["xyz".index(name[0]), "xyz".index(name[1])] for name in COMPONENTS]
    some = np.arange(0, len(body_mesh.nodes), 7)
    np.testing.assert_allclose(stress_of(body, found, some), np.tile(expected, (len(some), 1)), atol=1e-9)


@pytest.mark.parametrize("stretch", [0.8, 1.3])
def test_a_bar_that_is_pulled_has_uniaxial_stress(stretch):
    """The closed form of the law: nominal stress over the deformed area along the pull, nothing across."""
    mesh, law = block(inside_only=True), ReferenceLaw(0.499)
    fixed = np.stack([on_plane(mesh.nodes, axis, mesh.nodes[:, axis].min()) for axis in range(3)], axis=1)
    fixed[on_plane(mesh.nodes, 0, mesh.nodes[:, 0].max()), 0] = True
    guess = np.diag([stretch, stretch**-0.5, stretch**-0.5])
    body = make_body(mesh, law, "cpu")
    found = solve(body, fixed, (mesh.nodes - mesh.nodes.min(axis=0)) @ (guess - np.eye(3)), steps=3)
    nominal, lateral = law.uniaxial(stretch)
    every = stress_of(body, found, np.arange(len(mesh.nodes)))
    np.testing.assert_allclose(every[:, 0], nominal / lateral**2, rtol=1e-9)
    np.testing.assert_allclose(every[:, 1:], 0.0, atol=1e-9)
