"""Energy of the discretisation error, by a recovered strain."""

import numpy as np
import pytest
import warp as wp

from simgen.fem.elements.recovered_strain import RecoveredStrain
from simgen.geometry.interpolation import TET_EDGES, shape_functions, shape_gradients
from simgen.verification.validate.equilibrium import make_body
from simgen.verification.validate.exact import block
from simgen.verification.validate.meshes import box
from simgen.verification.validate.reference_law import ReferenceLaw

LAW = ReferenceLaw(0.499)
NODES = np.vstack([np.eye(4), 0.5 * (np.eye(4)[TET_EDGES[:, 0]] + np.eye(4)[TET_EDGES[:, 1]])])


def energy(body, displacement):
    x = np.zeros((body.n_displacements + body.n_pressures, 1))
    x[: body.n_displacements, 0] = displacement.ravel()
    return RecoveredStrain(body, 1).error_energy(wp.array(x, device="cpu"), 1)[0]


def gradients(mesh, displacement, points):
    """Gradients (element, point, 3, 3)."""
    shape = shape_gradients(points)
    jacobian = np.einsum("eni,pnj->epij", mesh.nodes[mesh.tetrahedra], shape)
    return np.einsum("eni,pnj->epij", displacement[mesh.tetrahedra], shape) @ np.linalg.inv(jacobian)


def by_numpy(mesh, body, displacement):
    points, volumes = body.solid.shapes.numpy(), body.solid.volumes.numpy()
    at_nodes, own = (gradients(mesh, displacement, each) for each in (NODES, points))
    of_element = volumes.sum(axis=1)
    sums, around = np.zeros((len(mesh.nodes), 3, 3)), np.zeros(len(mesh.nodes))
    np.add.at(sums, mesh.tetrahedra, of_element[:, None, None, None] * at_nodes)
    np.add.at(around, mesh.tetrahedra, of_element[:, None])
    recovered = (sums / around[:, None, None])[mesh.tetrahedra]
    apart = np.einsum("pa,eaij->epij", shape_functions(points), recovered) - own
    gradient = apart @ np.linalg.inv(np.eye(3) + own)
    strain = 0.5 * (gradient + gradient.swapaxes(2, 3))
    return body.solid.mu * ((strain**2).sum(axis=(2, 3)) * volumes).sum()


def test_a_linear_field_has_no_error():
    mesh = block(inside_only=False)
    linear = mesh.nodes @ np.array([[0.1, 0.02, 0.0], [0.0, -0.05, 0.03], [0.01, 0.0, 0.2]])
    assert energy(make_body(mesh, LAW, "cpu"), linear) == pytest.approx(0.0, abs=1e-20)


def test_the_energy_is_that_of_its_formula():
    """By numpy, for a displacement without any smoothness."""
    mesh = block(inside_only=True)
    body, rough = make_body(mesh, LAW, "cpu"), 1e-2 * np.random.default_rng(5).standard_normal(mesh.nodes.shape)
    assert energy(body, rough) == pytest.approx(by_numpy(mesh, body, rough), rel=1e-9)


def test_what_deformed_the_body_before_does_not_matter():
    """A turn and a stretch without a change of volume, then a rough field: as if the body had been made deformed."""
    mesh = block(inside_only=True)
    c, s = np.cos(0.7), np.sin(0.7)
    F = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.diag([1.5, 0.8, 1.0 / 1.2])
    deformed = mesh._replace(nodes=mesh.nodes @ F.T)
    rough = 1e-2 * np.random.default_rng(5).standard_normal(mesh.nodes.shape)
    of_rest = energy(make_body(mesh, LAW, "cpu"), deformed.nodes - mesh.nodes + rough)
    assert of_rest == pytest.approx(energy(make_body(deformed, LAW, "cpu"), rough), rel=1e-9)


def test_the_energy_falls_with_the_fourth_power_of_the_edges():
    """As the energy of a quadratic element's error in a smooth field, here a cubic one."""
    found = []
    for cells in (4, 8):
        mesh = box((cells, cells, cells), (1.0, 1.0, 1.0))
        X, Y, Z = mesh.nodes.T
        cubic = 0.1 * np.stack([X**3 + X * Y * Z, Y**3 - X**2 * Z, Z**3 + X * Y**2], axis=1)
        found.append(energy(make_body(mesh, LAW, "cpu"), cubic))
    assert np.log2(found[0] / found[1]) == pytest.approx(4.0, abs=0.5)
