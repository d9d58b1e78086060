"""Where and how deep a surface is pressed in, of dents that are known."""

import numpy as np
import pytest
import torch
import trimesh

from simgen.geometry.surface_normals import vertex_normals
from simgen.learning.evaluation.contact import NEAR_MM, SHARE, ContactGauge
from simgen.units import MM

SPACING = 0.25 * MM  # of a grid's points
DEPTH = 0.41 * MM  # no point of the grid lies just where a dent's contact ends
SPHERE = 5.0 * MM  # radius of what is pressed in: a contact of 2 mm


class PlainGauge:
    """A gauge of arrays."""

    def __init__(self, gauge: ContactGauge):
        self.gauge, self.position = gauge, gauge.position.numpy()

    def depth(self, displacement: np.ndarray) -> np.ndarray:
        return self.gauge.depth(torch.from_numpy(displacement)).numpy()

    def centroid(self, displacement: np.ndarray) -> np.ndarray:
        return self.gauge.centroid(torch.from_numpy(displacement)).numpy()


def gauge_of(vertices: np.ndarray, triangles: np.ndarray, touchable: np.ndarray | None = None) -> PlainGauge:
    own = {"rest_positions": vertices, "surface_triangles": triangles,
           "touchable": np.ones(len(vertices), bool) if touchable is None else touchable}  # fmt: skip
    return PlainGauge(ContactGauge.of_dataset({f"pad/{key}": value for key, value in own.items()}, "pad"))


def grid(x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of the plane y = 0, whose outside is -y, each square cut along the same diagonal: where points are evenly
    spaced, each has six triangles and the area of a square.
    """
    x, z = np.meshgrid(x, z, indexing="ij")
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1), triangles


def square() -> tuple[np.ndarray, np.ndarray]:
    """A pad of 20 mm x 20 mm around the origin."""
    line = np.arange(-40, 41) * SPACING
    return grid(line, line)


def gaussian(vertices: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(vertex,) how far each is pressed in."""
    return DEPTH * np.exp(-np.sum((vertices - centre) ** 2, axis=1) / (2.0 * MM) ** 2)


def sphere(vertices: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """By a rigid paraboloid that a sphere is near its lowest point."""
    return np.maximum(DEPTH - np.sum((vertices - centre) ** 2, axis=1) / (2.0 * SPHERE), 0.0)


DENTS = pytest.mark.parametrize("dent", [gaussian, sphere])


def inwards(dent: np.ndarray) -> np.ndarray:
    """(1, vertex, 3): displacement of a pad whose outside is -y."""
    return (dent[:, None] * [0.0, 1.0, 0.0])[None]


@pytest.fixture(scope="module")
def pad() -> PlainGauge:
    return gauge_of(*square())


@DENTS
def test_a_dent_around_a_point_of_the_mesh_is_found_exactly(pad, dent):
    """All is symmetric there, areas too: to rounding, of sums of some thousand numbers."""
    centre = np.array([2.0, 0.0, -3.0]) * MM
    displacement = inwards(dent(pad.position, centre))
    np.testing.assert_allclose(pad.centroid(displacement)[0], centre, atol=1e-12)
    np.testing.assert_allclose(pad.depth(displacement), DEPTH, rtol=1e-12)


@DENTS
@pytest.mark.parametrize("off", [(0.4, 0.3), (0.1, 0.5), (-0.3, 0.2)])
def test_a_dent_between_points_is_found_as_well_as_they_are_dense(pad, dent, off):
    """The contact ends between two points; the deepest point lies at most half a diagonal of a square away."""
    centre = np.array([1.0 * MM + off[0] * SPACING, 0.0, 2.0 * MM + off[1] * SPACING])
    displacement = inwards(dent(pad.position, centre))
    assert np.linalg.norm(pad.centroid(displacement)[0] - centre) < SPACING
    corner = centre + np.array([SPACING / 2, 0.0, SPACING / 2])
    lowest = dent(corner[None], centre)[0]
    assert lowest <= pad.depth(displacement)[0] <= DEPTH


@DENTS
def test_a_dent_of_a_ball(dent):
    """Pressed in along the ball's own normals, from which those of its mesh differ by half an edge at most, 2 degrees.

    The contact's points lie on the ball, so that their mean is below its surface, as deep as a cap's centre is.
    """
    radius = 7.0 * MM
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    normals = np.asarray(mesh.vertices) / radius
    gauge = gauge_of(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    edge = mesh.edges_unique_length.max()
    for vertex in (0, 100, 2000):
        centre = radius * normals[vertex]
        pressed = dent(mesh.vertices, centre)
        displacement = -(pressed[:, None] * normals)[None]
        np.testing.assert_allclose(gauge.depth(displacement), DEPTH, rtol=1.0 - np.cos(edge / radius / 2.0))
        found = gauge.centroid(displacement)[0]
        across = found - (found @ normals[vertex]) * normals[vertex]
        assert np.linalg.norm(across) < edge
        reach = np.linalg.norm(mesh.vertices - centre, axis=1)[pressed >= 0.8 * SHARE * DEPTH].max()
        assert radius - reach**2 / (2.0 * radius) <= found @ normals[vertex] < radius


def test_bulges_do_not_count(pad):
    here, there = np.array([2.0, 0.0, 1.0]) * MM, np.array([-3.0, 0.0, -2.0]) * MM
    dent = sphere(pad.position, here)
    bulge = 3.0 * sphere(pad.position, there)
    for measure in (pad.depth, pad.centroid):
        assert np.array_equal(measure(inwards(dent - bulge)), measure(inwards(dent)))


def test_what_slides_is_not_pressed_in(pad):
    """Motion along the surface has no depth, however large."""
    dent = inwards(sphere(pad.position, np.zeros(3)))
    slide = np.full(dent.shape, [5.0 * MM, 0.0, 5.0 * MM])
    np.testing.assert_allclose(pad.depth(dent + slide), DEPTH, rtol=1e-12)
    np.testing.assert_allclose(pad.centroid(dent + slide), 0.0, atol=1e-12)
    assert pad.depth(slide) == 0.0


def test_nothing_pressed_has_no_place_and_no_depth(pad):
    dent, none = inwards(sphere(pad.position, np.zeros(3))), np.zeros((1, len(pad.position), 3))
    samples = np.concatenate([none, dent, -dent, -dent - inwards(np.full(len(pad.position), DEPTH))])
    depth, centroid = pad.depth(samples), pad.centroid(samples)
    assert (depth[[0, 2, 3]] == 0.0).all() and depth[1] > 0.0
    assert np.isnan(centroid[[0, 2, 3]]).all() and np.isfinite(centroid[1]).all()


def test_of_two_dents_the_deeper_is_the_contact(pad):
    """The other is less deep than what belongs to it."""
    here, there = np.array([4.0, 0.0, 4.0]) * MM, np.array([-4.0, 0.0, -4.0]) * MM
    one, other = sphere(pad.position, here), sphere(pad.position, there)
    np.testing.assert_allclose(pad.centroid(inwards(one + 0.98 * SHARE * other))[0], here, atol=1e-12)
    np.testing.assert_allclose(pad.centroid(inwards(one + other))[0], 0.0, atol=1e-12)


def test_points_count_by_how_far_they_are_pressed_in(pad):
    """A ramp that ends 32 points from where it begins: of those that are a tenth as deep, 4 to 32, the mean of k
    weighted by k is 11426 / 522; unweighted it would be 18.
    """
    x, _, z = np.rint(pad.position.T / SPACING)
    ramp = np.where((x > 0) & (x <= 32) & (np.abs(z) <= 8), x, 0.0) * 1e-5  # m
    np.testing.assert_allclose(pad.centroid(inwards(ramp))[0], [11426 / 522 * SPACING, 0.0, 0.0], atol=1e-12)


def test_points_count_by_their_area():
    """A mesh that is eight times as dense on one side: the same contact, which their plain mean would be far from."""
    coarse, fine = np.arange(-20, 1) * 2.0 * SPACING, np.arange(1, 161) * 0.25 * SPACING
    line = np.concatenate([coarse, fine])
    gauge = gauge_of(*grid(line, np.arange(-20, 21) * 2.0 * SPACING))
    pressed = sphere(gauge.position, np.zeros(3))
    belongs = pressed >= SHARE * DEPTH
    plain = pressed[belongs] @ gauge.position[belongs] / pressed[belongs].sum()
    assert np.linalg.norm(gauge.centroid(inwards(pressed))[0]) < SPACING  # half of the coarse side's
    assert np.linalg.norm(plain) > SPACING


def test_what_nothing_may_touch_is_no_contact():
    vertices, triangles = square()
    gauge = gauge_of(vertices, triangles, touchable=vertices[:, 0] > 0.0)
    here, held = np.array([4.0, 0.0, 4.0]) * MM, np.array([-4.0, 0.0, -4.0]) * MM
    both = inwards(sphere(vertices, here) + 2.0 * sphere(vertices, held))
    np.testing.assert_allclose(gauge.centroid(both)[0], here, atol=1e-12)
    np.testing.assert_allclose(gauge.depth(both), DEPTH, rtol=1e-12)


def test_samples_do_not_know_of_each_other(pad):
    centres = np.array([[1.0, 0.0, 2.0], [-5.0, 0.0, 3.0], [0.0, 0.0, -6.0]]) * MM
    each = [inwards((i + 1) * sphere(pad.position, centre)) for i, centre in enumerate(centres)]
    together = np.concatenate(each)
    np.testing.assert_allclose(pad.centroid(together), centres, atol=1e-12)
    np.testing.assert_allclose(pad.depth(together), DEPTH * np.array([1, 2, 3]), rtol=1e-12)


def test_near_is_within_a_millimetre_of_the_true_contact(pad):
    """One contact beside the place, one too far from it, one that is not found, and none to find."""
    true = inwards(sphere(pad.position, np.zeros(3)))
    moved = [inwards(sphere(pad.position, np.array([way * NEAR_MM, 0.0, 0.0]) * MM)) for way in (0.9, 1.1)]
    truth = torch.from_numpy(np.concatenate([true, true, true, 0.0 * true]))
    guess = torch.from_numpy(np.concatenate([*moved, -true, true]))
    np.testing.assert_array_equal(pad.gauge.near(guess, truth), [1.0, 0.0, 0.0, np.nan])


def by_numpy(gauge: ContactGauge, normals: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """(3,) m of one mesh, point by point as the docstring says."""
    surface, total, moment = gauge.surface, 0.0, np.zeros(3)
    inward = [-displacement[point] @ normals[point] for point in surface.points]
    for point, area, depth in zip(surface.points, surface.areas, inward, strict=True):
        if depth > 0.0 and depth >= SHARE * max(inward):
            total, moment = total + depth * area, moment + depth * area * surface.vertices[point]
    return moment / total


def test_centroids_of_several_meshes_are_those_of_each(pad):
    """Three meshes of each of two samples, one of them without contact."""
    dents = [inwards(sphere(pad.position, np.array([x, 0.0, 0.0]) * MM)) for x in (-4, -2, 0, 2, 4)]
    meshes = torch.from_numpy(np.concatenate([*dents, 0.0 * dents[0]])).unflatten(0, (2, 3))
    found = pad.gauge.centroids(meshes)
    assert found.shape == (2, 3, 3) and found[1, 2].isnan().all()
    for k in range(3):
        np.testing.assert_allclose(found[:, k], pad.gauge.centroid(meshes[:, k]), rtol=1e-9)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_centroid_is_that_of_a_plain_sum(kind):
    """Random fields on a part of a ball."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=7.0 * MM)
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    gauge = gauge_of(vertices, triangles, touchable=vertices[:, 1] < 3.0 * MM).gauge
    fields = np.random.default_rng(0).normal(scale=0.1 * MM, size=(5, len(vertices), 3)).astype(kind)
    expected = [by_numpy(gauge, vertex_normals(vertices, triangles), field.astype(float)) for field in fields]
    np.testing.assert_allclose(gauge.centroid(torch.from_numpy(fields)), expected, atol=1e-15)
