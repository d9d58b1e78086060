"""State sampler: inverted elements, and one sampler for a scene."""

import numpy as np

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.simulation.load_stepping import LoadStepping
from simgen.simulation.state_sampler import StateSampler
from simgen.verification.validate.hard_scenes import block, scene_of


def test_elements_inverted_between_their_quadrature_points_are_counted():
    """A stretch inverts no element; a corner pushed through its element inverts it only near the corner."""
    scene = scene_of(block(), "cpu")
    scene.reset([rigid_shape(Kind.SPHERE, 3.5)])
    sampler, x = StateSampler(scene), np.zeros(scene.unknowns)
    u = x[: scene.nodes.size].reshape(-1, 3)
    u[:, 0] = 0.1 * scene.nodes[:, 0]
    scene.solver.x.assign(x[:, None])
    assert sampler.measure(1).read().inverted[0] == 0
    u[:] = 0.0
    tetrahedron = scene.mesh.tetrahedra[0]
    u[tetrahedron[0]] = 0.45 * (scene.nodes[tetrahedron[1:4]].mean(axis=0) - scene.nodes[tetrahedron[0]])
    scene.solver.x.assign(x[:, None])
    at_points = scene.solver.balance.measure(scene.solver.x).min_det
    assert sampler.measure(1).read().inverted[0] > 0 and at_points[0] > 0.0


def test_all_presses_of_a_scene_share_one_sampler():
    """With stress and traction the sampler takes half a second to make on the DIGIT's default mesh."""
    scene = scene_of(block(), "cpu")
    scene.reset([rigid_shape(Kind.SPHERE, 3.5)])
    path = np.array([[0.0, 0.1, 0.0, 0.0]])
    assert LoadStepping(scene, path, np.inf).sampler is LoadStepping(scene, path, np.inf).sampler
