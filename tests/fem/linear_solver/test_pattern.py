"""Blocks are the tangent among displacements, of the body and of its contacts."""

import numpy as np
import pytest
import scipy.sparse as sparse
import warp as wp

from simgen.fem import blocks
from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.contact.contact import Contact
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import P1, P2P1
from simgen.fem.linear_solver.pattern import BlockPattern, corners_to_nodes
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from tests.fem.box import box, top

SINGLE = 5e-6  # relative: rounding of 6e-8 for each of some hundred operations


@pytest.mark.parametrize(("element", "linear"), [(P1, True), (P1, False), (P2P1, True), (P2P1, False)])
def test_blocks_are_the_tangent_among_displacements_or_linear_ones(element, linear):
    nodes, tets, n_corners, faces = box()
    nodes, tets = (nodes[:n_corners], tets[:, :4]) if element is P1 else (nodes, tets)
    active = ActiveEnvironments(1, "cpu")
    solid = NeoHookean.from_engineering(1.0, 0.499, 1.0 if element.pressures else None)
    body = Elasticity(element, nodes, tets, n_corners, solid, "cpu", active)
    contact = Contact(element, nodes, top(box().nodes, faces), (20.0, 20.0), 0.5, "cpu", active)
    contact.set_shapes([rigid_shape(Kind.SPHERE, 3.5)])
    pose = np.eye(4)[None].copy()
    pose[0, 1, 3] = 0.2
    contact.set_pose(pose)
    rng = np.random.default_rng(0)
    n = body.n_displacements + body.n_pressures
    x = np.append(0.03 * rng.normal(size=body.n_displacements), 0.1 * rng.normal(size=body.n_pressures))
    x = wp.array(x[:, None], dtype=wp.float64, device="cpu")
    embedding = np.eye(len(nodes))
    on_faces = contact.host_faces
    if linear and element is P2P1:
        embedding = corners_to_nodes(tets, len(nodes), n_corners).toarray()
        np.testing.assert_allclose(embedding @ nodes[:n_corners], nodes, atol=1e-14)  # straight edges
        tets, on_faces = tets[:, :4], on_faces[:, :3]
    embedding = np.kron(embedding, np.eye(3))
    v = rng.normal(size=embedding.shape[1])
    pattern = BlockPattern(len(v) // 3, tets, [on_faces], "cpu")
    for term, index in ((body, pattern.tet_index), (contact, pattern.face_index[0])):
        made = blocks.zeros(pattern.n_blocks, 1, "cpu")
        out = wp.zeros((n, 1), dtype=wp.float32, device="cpu")
        whole = np.append(embedding @ v, np.zeros(body.n_pressures))
        term.linearize(x)
        term.blocks(index, made, linear)
        roughly = [linear] if term is body else []  # by fewer points
        term.tangent(wp.array(whole[:, None], dtype=wp.float32, device="cpu"), out, *roughly)
        expected = embedding.T @ out.numpy()[: body.n_displacements, 0]
        found = pattern.matrix(blocks.of_environment(made, 0)) @ v
        assert np.abs(expected).max() > 1e-3
        np.testing.assert_allclose(found, expected, rtol=0, atol=SINGLE * np.abs(expected).max())


def test_the_matrix_has_the_pattern_s_blocks():
    _, tets, n_corners, _ = box()
    pattern = BlockPattern(n_corners, tets[:, :4], [], "cpu")
    values = np.arange(9.0 * pattern.n_blocks).reshape(-1, 3, 3)
    matrix = pattern.matrix(values)
    assert isinstance(matrix, sparse.csr_array)
    row = pattern.host_columns[pattern.host_row_starts[4]]
    np.testing.assert_array_equal(matrix[12:15, 3 * row : 3 * row + 3].toarray(), values[pattern.host_row_starts[4]])
