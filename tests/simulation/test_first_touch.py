"""First touch of an indenter, and the number of faces near it."""

import numpy as np
from fem.box import box

from simgen.fem.nonlinear.status import Status
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.simulation.first_touch import COARSE, THREADS, dense_shapes, first_touch

RADIUS, REACH = 3.5, 1.5


def test_faces_within_reach_of_a_sphere():
    """Count again from the distances of all faces to the sphere's centre, 3.5 mm above the plane."""
    nodes, _, _, faces = box((8, 2, 8), (10.0, 4.0, 10.0))
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 1, 3] = -2.0
    poses[1, 0, 3] = 40.0
    shapes = [rigid_shape(Kind.SPHERE, RADIUS)] * 2
    travel, status, near = first_touch(nodes, faces, shapes, poses, batch=1, reach=REACH)
    assert list(status) == [Status.CONVERGED, Status.NEVER_TOUCHES]
    np.testing.assert_allclose(travel[0], 2.0 + nodes[:, 1].min(), atol=1e-5)
    points = np.einsum("qa,fai->fqi", dense_shapes(COARSE, linear=False), nodes[faces])
    centre = np.array([0.0, nodes[:, 1].min() - RADIUS, 0.0])
    distance = np.linalg.norm(points - centre, axis=-1).min(axis=1) - RADIUS
    assert not np.isclose(distance, REACH, atol=1e-4).any()  # or the count would depend on rounding
    assert near[0] == (distance < REACH).sum() and 0 < near[0] < len(faces)
    assert near[1] == 0


def test_threads_that_share_a_face_find_the_same(monkeypatch):
    """Threads share the dense points as on a GPU; the least distance does not depend on their order."""
    nodes, _, _, faces = box((8, 2, 8), (10.0, 4.0, 10.0))
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = [[0.3, -2.0, 0.1], [1.7, -2.0, -0.9], [40.0, -2.0, 0.0]]
    for pose, degrees in zip(poses, (3.0, 8.0, 0.0), strict=True):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        pose[:2, :2] = [[c, -s], [s, c]]
    shapes = [rigid_shape(Kind.CYLINDER, RADIUS, 2.0, 0.2)] * 3
    alone = first_touch(nodes, faces, shapes, poses, batch=3, reach=REACH)
    monkeypatch.setitem(THREADS, "cpu", 64)
    for one, other in zip(alone, first_touch(nodes, faces, shapes, poses, batch=3, reach=REACH), strict=True):
        np.testing.assert_array_equal(one, other)
    assert list(alone[1]) == [Status.CONVERGED, Status.CONVERGED, Status.NEVER_TOUCHES]
