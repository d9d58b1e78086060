"""Levels of meshes: how many vertices, who neighbours whom, and what interpolation reproduces."""

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from simgen.config.resources import resource
from simgen.geometry.tetrahedra import sizing_grid
from simgen.learning.networks.hierarchy import BOUND, LEVELS, affine_weights, build_hierarchy, edge_graph
from simgen.learning.networks.hierarchy import farthest_point_order as order_of

GAP = 0.1  # of an edge: between the arms of the fork


def block() -> tuple[np.ndarray, np.ndarray]:
    return sizing_grid(np.zeros(3), np.array([6.0, 4.0, 3.0]), 1.0)


def fork() -> tuple[np.ndarray, np.ndarray]:
    """Two arms along x, joined at x = 0 by a block, else a gap of a tenth of an edge apart in y."""
    points, tetrahedra = sizing_grid(np.zeros(3), np.array([12.0, 8.0, 2.0]), 1.0)
    middle = points[tetrahedra].mean(axis=1)
    tetrahedra = tetrahedra[(middle[:, 0] < 1.0) | (middle[:, 1] < 4.0) | (middle[:, 1] > 5.0)]
    used, tetrahedra = np.unique(tetrahedra, return_inverse=True)
    points = points[used]
    points[points[:, 1] >= 5.0, 1] -= 1.0 - GAP
    return points, tetrahedra.reshape(-1, 4)


def bundled(sensor: str) -> tuple[np.ndarray, np.ndarray]:
    with np.load(resource("sensor_models") / sensor / "output.npz") as mesh:
        return mesh["vertices"], mesh["tetrahedra"]


@pytest.fixture(scope="module", params=["block", "fork", "digit", "biotac"])
def mesh(request):
    return {"block": block, "fork": fork}.get(request.param, lambda: bundled(request.param))()


@pytest.fixture(scope="module")
def hierarchy(mesh):
    return build_hierarchy(*mesh)


def test_each_level_has_half_of_the_one_before(mesh, hierarchy):
    assert len(hierarchy.sizes) == len(hierarchy.adjacency) == LEVELS == len(hierarchy.interpolation) + 1
    assert hierarchy.sizes[0] == len(mesh[0])
    for finer, coarser, weights in zip(hierarchy.sizes, hierarchy.sizes[1:], hierarchy.interpolation, strict=False):
        assert coarser == (finer + 1) // 2
        assert weights.shape == (finer - coarser, coarser)
    np.testing.assert_array_equal(np.sort(hierarchy.order), np.arange(len(mesh[0])))


def test_the_finest_level_is_the_mesh(mesh, hierarchy):
    edges = {tuple(sorted(pair)) for pair in zip(*hierarchy.adjacency[0].nonzero(), strict=True)}
    place = np.argsort(hierarchy.order)
    corners = [(a, b) for a in range(4) for b in range(a)]
    expected = {tuple(sorted(pair)) for a, b in corners for pair in place[mesh[1][:, [a, b]]].tolist()}
    assert edges == expected


def test_neighbours_are_mutual_and_every_level_is_connected(hierarchy):
    for size, adjacency in zip(hierarchy.sizes, hierarchy.adjacency, strict=True):
        assert adjacency.shape == (size, size)
        assert (adjacency != adjacency.T).nnz == 0
        assert not adjacency.diagonal().any()
        assert set(adjacency.data) == {1.0}
        assert connected_components(adjacency)[0] == 1


def test_a_vertex_has_no_more_neighbours_on_coarse_levels(hierarchy):
    fine, *coarse = (adjacency.nnz / adjacency.shape[0] for adjacency in hierarchy.adjacency)
    assert max(coarse) < 1.1 * fine  # a product costs what its level has of vertices


def test_a_level_covers_the_mesh_evenly(mesh, hierarchy):
    """No vertex is farther from a level than the level's vertices are from one another: what Gonzalez guarantees."""
    graph = edge_graph(*mesh)
    for size in hierarchy.sizes[1:]:
        kept = hierarchy.order[:size]
        reach = dijkstra(graph, indices=kept, min_only=True).max()
        along = dijkstra(graph, indices=kept[-50:], limit=2.0 * reach)[:, kept]
        along[along == 0.0] = np.inf
        assert reach <= along.min() * (1.0 + 1e-12)


def test_neighbours_are_near_along_the_mesh(mesh, hierarchy):
    """Cells that touch: at most two reaches and the longest edge between their vertices, whatever lies across a gap."""
    graph = edge_graph(*mesh)
    for size, adjacency in zip(hierarchy.sizes[1:], hierarchy.adjacency[1:], strict=True):
        kept = hierarchy.order[:size]
        reach = dijkstra(graph, indices=kept, min_only=True).max()
        few = np.linspace(0, size - 1, 40).astype(int)
        along = dijkstra(graph, indices=kept[few])[:, kept]
        assert along[adjacency[few].toarray() > 0].max() <= 2.0 * reach + graph.data.max() * (1.0 + 1e-12)


def test_no_edge_and_no_weight_crosses_a_gap():
    """On all levels but the coarsest, whose cells at the joint reach the arms from both sides."""
    points, tetrahedra = fork()
    made = build_hierarchy(points, tetrahedra, levels=4)
    x, y, _ = points[made.order].T
    arm = np.where(x < 5.0, 0, np.where(y < 4.0 + 0.5 * GAP, -1, 1))
    assert len(x[(arm == 1) & (y < 4.0 + 2 * GAP)]) > 0  # there are vertices that only the gap parts
    for matrix, first in [(one, 0) for one in made.adjacency] + [
        (one, size) for one, size in zip(made.interpolation, made.sizes[1:], strict=True)
    ]:
        entries = matrix.tocoo()
        assert not (arm[entries.row + first] * arm[entries.col] < 0).any()


def test_interpolation_keeps_affine_fields_and_is_bounded(mesh, hierarchy):
    points = mesh[0][hierarchy.order]
    fields = np.column_stack([np.ones(len(points)), points / np.ptp(points, axis=0).max()])
    for coarser, weights in zip(hierarchy.sizes[1:], hierarchy.interpolation, strict=True):
        rest = slice(coarser, coarser + weights.shape[0])
        np.testing.assert_allclose(weights @ fields[:coarser, :1], fields[rest, :1], rtol=0, atol=1e-12)
        sums = abs(weights).sum(axis=1)
        assert sums.max() <= BOUND
        exact = weights @ fields[:coarser] - fields[rest]
        if len(points) > 1000:  # of small meshes, the coarsest level has too few vertices for four conditions
            assert np.abs(exact).max() < 1e-4  # the ridge is 1e-6


def test_interpolation_of_a_smooth_field_is_good_to_second_order():
    """Half the edge, a quarter of the error: twice at least, on a quadratic field."""
    errors = []
    for edge in (1.0, 0.5):
        points, tetrahedra = sizing_grid(np.zeros(3), np.array([6.0, 4.0, 3.0]), edge)
        made = build_hierarchy(points, tetrahedra, levels=2)
        field = (points[made.order] ** 2).sum(axis=1)
        size = made.sizes[1]
        errors.append(np.sqrt(np.mean((made.interpolation[0] @ field[:size] - field[size:]) ** 2)))
    assert errors[1] < 0.5 * errors[0]


def test_the_same_mesh_has_the_same_levels():
    first, second = build_hierarchy(*block()), build_hierarchy(*block())
    np.testing.assert_array_equal(first.order, second.order)
    for one, other in zip(first.interpolation, second.interpolation, strict=True):
        assert (one != other).nnz == 0


def test_farthest_points_of_a_line_are_its_ends_then_its_middle():
    chain = csr_array(np.eye(9, k=1) + np.eye(9, k=-1))
    assert order_of(chain, 3).tolist()[:3] == [0, 8, 4]


def test_weights_stay_bounded_where_all_sources_lie_to_one_side():
    sources = np.array([[1.0, 0.0, 0.0], [1.1, 0.0, 0.0], [1.0, 0.1, 0.0], [1.0, 0.0, 0.1]])
    weights = affine_weights(np.zeros((1, 3)), sources, csr_array(np.ones((1, 4))))
    assert abs(weights).sum() <= BOUND
    assert weights.sum() == pytest.approx(1.0)
