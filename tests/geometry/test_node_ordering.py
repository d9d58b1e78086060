"""Reordering keeps the mesh and brings neighbours together."""

import numpy as np

from simgen.geometry.node_ordering import in_cuthill_mckee_order
from simgen.geometry.tetrahedra import signed_volumes
from simgen.sensors.sensor import load_sensor

WINDOW = 400  # elements


def positions(mesh, nodes):
    """Elements or faces as the coordinates of their nodes, sorted by coordinates."""
    points = mesh.nodes[nodes].reshape(len(nodes), -1)
    return points[np.lexsort(points.T)]


def test_the_mesh_is_the_same_and_its_neighbours_are_close():
    mesh = load_sensor("biotac", "coarse").simulation_mesh
    again = in_cuthill_mckee_order(mesh)
    assert (again.n_corners, again.hash) == (mesh.n_corners, mesh.hash)
    for name in ("tetrahedra", "touchable", "facing_core"):
        np.testing.assert_array_equal(positions(again, getattr(again, name)), positions(mesh, getattr(mesh, name)))
    np.testing.assert_array_equal(np.unique(again.nodes[again.held], axis=0), np.unique(mesh.nodes[mesh.held], axis=0))
    assert (again.tetrahedra[:, :4] < again.n_corners).all() and (again.tetrahedra[:, 4:] >= again.n_corners).all()
    assert (signed_volumes(again.nodes, again.tetrahedra[:, :4]) > 0).all()

    def nodes_in_windows(mesh):
        return np.mean([len(np.unique(mesh.tetrahedra[i : i + WINDOW])) for i in range(0, 1600, WINDOW)])

    assert nodes_in_windows(again) < 0.7 * nodes_in_windows(mesh)  # 0.5 on the default mesh, which is larger
