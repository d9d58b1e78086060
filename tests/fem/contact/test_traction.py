"""Tractions at points of a face, and bounds of its distance from a shape."""

import numpy as np
import pytest
import trimesh
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.contact.contact import Contact
from simgen.fem.contact.traction import Surface, face_positions, gap_lower_bound, return_tangent, return_to_cone
from simgen.fem.elements.element import P2P1
from simgen.fem.precision import mat33, real, vec3
from simgen.geometry.rigid_shape import rigid_shape, sampled_shape, signed_distance
from simgen.geometry.signed_distance import Kind
from simgen.simulation.first_touch import dense_shapes
from tests.fem.box import box, top
from tests.fem.contact.pressed_box import CUBE, NEAR, SPHERE, STIFFNESS, K, contact, pose, state, update


def test_stiffness_goes_with_one_over_the_edge():
    nodes, _, _, faces = box()
    big = Contact(P2P1, 3.0 * nodes, top(nodes, faces), STIFFNESS, 0.0, "cpu", ActiveEnvironments(1, "cpu"))
    big.set_shapes([rigid_shape(Kind.CUBE, 60.0, 1.0)])
    big.set_pose(pose(0.0, 0.01, 0.0))
    force = big.resultants(state(np.zeros(3 * len(nodes)))).read().force
    assert force[0, 1] == pytest.approx(K / 3.0 * 0.01 * 9.0 * 36.0)



@wp.kernel(enable_backward=False)
def least_gap_kernel(s: Surface, x: wp.array2d(dtype=wp.float64), least_out: wp.array2d(dtype=wp.float64)):
    f, env = wp.tid()
    least_out[f, env] = gap_lower_bound(s, face_positions(s, x, f, env), env)



def least_gaps(term, x):
    least = wp.zeros((len(term.host_faces), 1), dtype=wp.float64, device="cpu")
    wp.launch(least_gap_kernel, dim=least.shape, inputs=[term.surface, x], outputs=[least], device="cpu")
    return least.numpy()[:, 0]



@pytest.mark.parametrize("kind", ["sphere", "cube", "sampled"])
def test_the_gap_of_a_whole_face_has_a_lower_bound(kind):
    """No point of a face, however bent, is nearer."""
    sampled = sampled_shape(trimesh.creation.icosphere(subdivisions=3, radius=2e-3), 0.25, 0.5)
    shape = {"sphere": SPHERE, "cube": CUBE, "sampled": sampled}[kind]
    nodes, term = contact(0.0, shape)
    rng, dense = np.random.default_rng(5), dense_shapes(12, linear=False)
    for height in (-1.0, 0.5, 20.0):
        x = state(0.3 * rng.normal(size=3 * len(nodes)))  # edges are 2 mm long
        term.set_pose(pose(0.4, -height, 0.2))
        positions = (nodes + x.numpy().reshape(-1, 3))[term.host_faces]
        points = np.einsum("qa,fai->fqi", dense, positions) - [0.4, -height, 0.2]
        truth = signed_distance(shape, points.reshape(-1, 3))[0].reshape(points.shape[:2]).min(axis=1)
        assert (least_gaps(term, x) <= truth + 1e-12).all()



@pytest.mark.parametrize("edge", [0, 1, 2])
def test_the_lower_bound_knows_how_far_a_face_bulges(edge):
    """The middle of an edge is pulled by 6 mm, three edges: the bound goes to the Bezier point, 12 mm further out."""
    nodes, term = contact(0.0, SPHERE)
    face = nodes[term.host_faces[0]].copy()
    face[3 + edge] += [0.0, 0.0, 6.0]
    u = np.zeros_like(nodes)
    u[term.host_faces[0]] = face - nodes[term.host_faces[0]]
    term.set_pose(pose(0.0, -100.0, 0.0))  # far below, so that distances hardly change over a face
    middle = face[:3].mean(axis=0)
    control = 2.0 * face[3 + edge] - 0.5 * (face[edge] + face[(edge + 1) % 3])
    expected = signed_distance(SPHERE, middle[None] + [[0.0, 100.0, 0.0]])[0][0]
    expected -= 1.65 * np.linalg.norm(control - middle)
    assert np.linalg.norm(control - middle) > 10.0
    assert least_gaps(term, state(u.ravel()))[0] == pytest.approx(expected, abs=1e-12)



@pytest.mark.parametrize(("slip", "expected"), [(1e-3, 15.0 * 1e-3 * 36.0), (1.0, 0.78 * 0.6 * 36.0)])
def test_friction_sticks_then_slides_on_the_cone(slip, expected):
    """Normal traction 0.6: sticking resists with k times slip, sliding with 0.78 times the normal force."""
    nodes, term = contact(0.78, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    down = pose(0.0, 0.01, 0.0)
    term.begin_increment(rest, rest, down, down, NEAR)
    update(term, rest)
    flush = pose(0.0, 0.0, 0.0)
    term.begin_increment(rest, rest, flush, pose(slip, 0.0, 0.0), NEAR)
    force = term.resultants(rest).read().force
    assert force[0, 0] == pytest.approx(expected, rel=1e-12)  # the gel is dragged along
    assert force[0, 1] == pytest.approx(0.6 * 36.0)


@wp.kernel(enable_backward=False)
def return_kernel(
    trials: wp.array(dtype=vec3), radius: real, normal: vec3,
    # outputs
    returned_out: wp.array(dtype=vec3), tangent_out: wp.array(dtype=mat33),
):
    i = wp.tid()
    plane = wp.identity(n=3, dtype=wp.float64) - wp.outer(normal, normal)
    returned_out[i] = return_to_cone(trials[i], radius)
    tangent_out[i] = return_tangent(trials[i], radius, plane)


def returned(trials, radius):
    arrays = [wp.zeros(len(trials), dtype=kind, device="cpu") for kind in (vec3, mat33)]
    inputs = [wp.array(trials, dtype=vec3, device="cpu"), radius, vec3(0.0, 1.0, 0.0)]
    wp.launch(return_kernel, dim=len(trials), inputs=inputs, outputs=arrays, device="cpu")
    return [array.numpy() for array in arrays]


def test_the_return_to_the_cone_keeps_the_direction_and_its_tangent_is_the_derivative():
    trials = np.random.default_rng(3).normal(size=(50, 3)) * [1.0, 0.0, 1.0]
    sizes = np.linalg.norm(trials, axis=1)
    found, tangent = returned(trials, 1.0)
    assert (sizes < 1.0).any() and (sizes > 1.0).any()
    np.testing.assert_allclose(found, trials * (np.minimum(sizes, 1.0) / sizes)[:, None], atol=1e-15)
    v, h = np.array([0.6, 0.0, -0.8]), 1e-6
    difference = (returned(trials + h * v, 1.0)[0] - returned(trials - h * v, 1.0)[0]) / (2.0 * h)
    np.testing.assert_allclose(tangent @ v, difference, atol=1e-8)
