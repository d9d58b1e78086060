"""Rest meshes of imported files: what is read, and one line for everything that can be wrong."""

import meshio
import numpy as np
import pytest

from simgen.dataset.exchange.rest_meshes import read_rest_meshes
from simgen.errors import InputError


def test_an_origin_moves_positions_into_the_files_coordinates(tetrahedron):
    path, vertices = tetrahedron
    mesh = read_rest_meshes([f"biotac={path}"], ["biotac=0,50,-1"])["biotac"]
    np.testing.assert_array_equal(mesh.arrays["rest_positions"], vertices)
    np.testing.assert_allclose(mesh.in_files, vertices + np.array([0.0, 0.05, -0.001]), atol=1e-15)
    assert mesh.rounding == np.spacing(np.float32(0.06))
    assert mesh.arrays["surface_triangles"].shape == (4, 3) and "held" not in mesh.arrays


def test_a_vtu_says_which_vertices_are_held_and_touchable(tetrahedron, tmp_path):
    _, vertices = tetrahedron
    flags = {"held": np.array([1, 0, 0, 1], np.uint8), "touchable": np.array([0, 1, 0, 0], np.uint8)}
    file = tmp_path / "rest.vtu"
    meshio.Mesh(vertices, [("tetra", [[0, 1, 2, 3]])], point_data=flags).write(file)
    arrays = read_rest_meshes([f"digit={file}"])["digit"].arrays
    assert arrays["held"].tolist() == [True, False, False, True] and arrays["touchable"].sum() == 1
    meshio.Mesh(vertices, [("tetra", [[0, 1, 2, 3]])], point_data={"held": np.zeros((4, 2))}).write(file)
    with pytest.raises(InputError, match=r"rest.vtu: held: shape \(4, 2\), expected \(4,\)"):
        read_rest_meshes([f"digit={file}"])


@pytest.mark.parametrize(
    ("meshes", "origins", "says"),
    [
        ([], [], "--mesh: missing; give SENSOR=FILE"),
        (["{mesh}"], [], "write it as SENSOR=FILE"),
        (["digit={mesh}", "digit={mesh}"], [], "sensor 'digit' has one already"),
        (["digit={mesh}"], ["digit=0,50"], "--origin-mm digit=0,50: write it as SENSOR=X,Y,Z"),
        (["digit={mesh}"], ["digit=0,nan,0"], "--origin-mm digit=0,nan,0: write it as SENSOR=X,Y,Z"),
        (["digit={mesh}"], ["biotac=0,50,0"], "--origin-mm biotac=0,50,0: sensor 'biotac' has no --mesh"),
    ],
)
def test_bad_options_are_one_line(tetrahedron, meshes, origins, says):
    with pytest.raises(InputError) as refusal:
        read_rest_meshes([text.format(mesh=tetrahedron[0]) for text in meshes], origins)
    assert says in str(refusal.value) and "\n" not in str(refusal.value)
