"""Blocks are the tangent among displacements: between corners, between all nodes, and of each node with itself."""

import numpy as np
import pytest
import warp as wp

from simgen.fem import blocks
from simgen.fem.elements.element import P2P1
from simgen.fem.linear_solver.pattern import BlockPattern, corners_to_nodes
from simgen.fem.material import LAWS
from tests.fem.elements.test_elasticity import SINGLE, action, body


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("linear", [True, False])
def test_blocks_are_the_tangent_among_displacements_or_linear_ones(linear, law):
    nodes, term = body(P2P1, law=law)
    tets, rng = term.host_tetrahedra, np.random.default_rng(0)
    x = np.append(0.03 * rng.normal(size=term.n_displacements), 0.1 * rng.normal(size=term.n_pressures))
    embedding = np.eye(len(nodes))
    if linear:
        embedding = corners_to_nodes(tets, len(nodes), term.n_corners).toarray()
        tets = tets[:, :4]
    embedding = np.kron(embedding, np.eye(3))
    v = rng.normal(size=embedding.shape[1])
    pattern = BlockPattern(len(v) // 3, tets, [], "cpu")
    made = blocks.zeros(pattern.n_blocks, 1, "cpu")
    whole = np.append(embedding @ v, np.zeros(term.n_pressures))
    expected = embedding.T @ action(term, x, whole, reduced=linear)[: term.n_displacements]
    term.blocks(pattern.tet_index, made, linear)
    found = pattern.matrix(blocks.of_environment(made, 0)) @ v
    np.testing.assert_allclose(found, expected, rtol=0, atol=SINGLE * np.abs(expected).max())


@pytest.mark.parametrize("law", LAWS)
def test_the_diagonal_is_that_of_the_tangent(law):
    nodes, term = body(P2P1, law=law)
    n = term.n_displacements + term.n_pressures
    x = 0.03 * np.random.default_rng(2).normal(size=n)
    made = blocks.zeros(len(nodes), 1, "cpu")
    term.linearize(wp.array(x.reshape(-1, 1), dtype=wp.float64, device="cpu"))
    term.diagonal(made)
    diagonal = blocks.of_environment(made, 0)
    for node in (0, len(nodes) // 2, len(nodes) - 1):  # a corner, and middles of edges
        for i in range(3):
            column = action(term, x, np.eye(n)[3 * node + i], reduced=True)[3 * node : 3 * node + 3]
            allowed = SINGLE * np.abs(column).max()
            np.testing.assert_allclose(diagonal[node, :, i], column, rtol=0, atol=allowed)
