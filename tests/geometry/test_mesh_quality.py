"""Each gate refuses the defect that it is there for, and gives the number."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from simgen.errors import InputError
from simgen.geometry.curved_tetrahedra import FREE, HELD, LabelledSurface, make_quadratic
from simgen.geometry.mesh_quality import boundary_topology, check, components, mean_ratio, measure
from simgen.geometry.tetrahedra import boundary_triangles, sizing_grid

REGULAR = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)


def test_mean_ratio_is_one_for_the_regular_tetrahedron_and_signed():
    corners = np.array([[0, 1, 2, 3], [0, 2, 1, 3]])
    np.testing.assert_allclose(np.abs(mean_ratio(REGULAR, corners)), 1.0)
    assert np.sign(mean_ratio(REGULAR, corners)).sum() == 0
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 1e-3], [0, 1, 0]], dtype=float)
    assert abs(mean_ratio(flat, corners[:1])[0]) < 0.02


@pytest.fixture(scope="module")
def good():
    vertices, tetrahedra = sizing_grid(np.zeros(3), np.ones(3) * 1e-3, 0.5e-3)
    surface = trimesh.creation.box(bounds=[np.zeros(3), np.ones(3) * 1e-3]).subdivide()
    true = LabelledSurface(surface, np.where(surface.triangles_center[:, 2] < 1e-9, HELD, FREE))
    quality = measure(make_quadratic(vertices, tetrahedra, true, limit=1e-6), true)
    return quality


def test_a_good_mesh_passes(good):
    check(good, shells=1, name="box")
    assert abs(good.volume_error) < 1e-9
    assert abs(good.held_area_error) < 1e-9
    assert "mean ratio >= " in str(good)


@pytest.mark.parametrize(
    ("defect", "says"),
    [
        ({"least_mean_ratio": 0.02}, "mean ratio 0.02, least allowed 0.15"),
        ({"least_determinant": -0.3}, "determinant of -0.3"),
        ({"volume_error": 0.05}, "volume off by +5.00%"),
        ({"components": 2}, "2 separate bodies"),
        ({"boundary_shells": 2}, "2 closed shells, allowed 1"),
        ({"open_edges": 4}, "4 open boundary edges"),
        ({"held_nodes": 0}, "no held node"),
        ({"held_area_error": -0.5}, "held area off by -50.0%"),
    ],
)
def test_every_gate_fails_loudly(good, defect, says):
    with pytest.raises(InputError, match=says.replace("+", r"\+")):
        check(replace(good, **defect), shells=1, name="box")


def test_counting_of_bodies_and_of_open_edges():
    _, one = sizing_grid(np.zeros(3), np.ones(3), 0.5)
    two = np.concatenate([one, one + one.max() + 1])
    assert [components(one), components(two)] == [1, 2]
    faces, _, _ = boundary_triangles(two)
    assert boundary_topology(faces) == (2, 0)
    assert boundary_topology(faces[1:])[1] == 3
