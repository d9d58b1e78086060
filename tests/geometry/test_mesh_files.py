"""Users' mesh files are read, and simgen's own files are written and read again."""

from pathlib import Path

import meshio
import numpy as np
import pytest
import trimesh

from simgen.errors import InputError
from simgen.geometry import mesh_files
from simgen.geometry.tetrahedra import OutputMesh, boundary_triangles, signed_volumes, sizing_grid

POINTS, TETRAHEDRA = sizing_grid(np.zeros(3), np.array([2.0, 1.0, 1.0]), 0.5)  # mm
VOLUME = 2e-9  # m3


def write_tets(path, tetrahedra=TETRAHEDRA):
    if path.suffix == ".tet":
        rows = [f"v {x} {y} {z} 0" for x, y, z in POINTS] + ["t " + " ".join(map(str, t)) for t in tetrahedra]
        path.write_text("\n".join(["# made by hand", "", *rows]))
    else:
        options = {"file_format": "gmsh22", "binary": False} if path.suffix == ".msh" else {}
        meshio.Mesh(POINTS, [("tetra", tetrahedra)]).write(path, **options)
    return path


@pytest.mark.parametrize("suffix", [".tet", ".mesh", ".msh", ".vtu"])
def test_tetrahedral_files(tmp_path, suffix):
    surface, vertices, tetrahedra = mesh_files.read_mesh(write_tets(tmp_path / f"a{suffix}"), "mm")
    np.testing.assert_allclose(vertices, POINTS * 1e-3, atol=1e-9)
    assert len(tetrahedra) == len(TETRAHEDRA)
    np.testing.assert_allclose(signed_volumes(vertices, tetrahedra).sum(), VOLUME, rtol=1e-6)
    np.testing.assert_allclose(surface.volume, VOLUME, rtol=1e-6)


def second_order(corners: np.ndarray, sides: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """`POINTS` with mid-edge points after them, and second-order cells."""
    edges = np.sort(corners[:, sides].reshape(-1, 2), axis=1)
    edges, number = np.unique(edges, axis=0, return_inverse=True)
    middle = len(POINTS) + number.reshape(len(corners), len(sides))
    return np.vstack([POINTS, POINTS[edges].mean(axis=1)]), np.hstack([corners, middle])


SIDES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]


@pytest.mark.parametrize("suffix", [".msh", ".vtu"])
def test_second_order_tetrahedra_count_by_their_corners(tmp_path, suffix):
    points, cells = second_order(TETRAHEDRA, SIDES)
    moved = np.random.default_rng(0).permutation(len(points))  # corners stand anywhere among the nodes
    places = np.argsort(moved)
    file = tmp_path / f"a{suffix}"
    options = {"file_format": "gmsh", "binary": False} if suffix == ".msh" else {}
    meshio.Mesh(points[moved], [("tetra10", places[cells])]).write(file, **options)
    surface, vertices, tetrahedra = mesh_files.read_mesh(file, "mm")
    np.testing.assert_allclose(1e3 * vertices[tetrahedra], POINTS[TETRAHEDRA], atol=1e-9)
    assert len(vertices) == len(POINTS)  # a mid-edge node would be a vertex of no cell
    np.testing.assert_allclose(surface.volume, VOLUME, rtol=1e-6)


def test_second_order_triangles_count_by_their_corners(tmp_path):
    points, cells = second_order(boundary_triangles(TETRAHEDRA)[0], SIDES[:3])
    meshio.Mesh(points, [("triangle6", cells)]).write(tmp_path / "a.msh", file_format="gmsh", binary=False)
    surface, vertices, _ = mesh_files.read_mesh(tmp_path / "a.msh", "mm")
    assert vertices is None
    np.testing.assert_allclose(surface.volume, VOLUME, rtol=1e-6)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
@pytest.mark.parametrize("inside_out", [False, True])
def test_surface_files_become_closed_and_outward(tmp_path, suffix, inside_out):
    box = trimesh.creation.box([2.0, 1.0, 1.0])
    if inside_out:
        box.invert()
    box.export(tmp_path / f"a{suffix}")
    surface, vertices, tetrahedra = mesh_files.read_mesh(tmp_path / f"a{suffix}", "mm")
    assert vertices is None
    assert tetrahedra is None
    assert surface.is_watertight
    np.testing.assert_allclose(surface.volume, VOLUME, rtol=1e-6)


def test_tetrahedra_all_the_other_way_round_are_turned(tmp_path):
    path = write_tets(tmp_path / "a.tet", TETRAHEDRA[:, [0, 2, 1, 3]])
    _, vertices, tetrahedra = mesh_files.read_mesh(path, "mm")
    assert signed_volumes(vertices, tetrahedra).min() > 0


def test_what_is_wrong_with_a_file_is_said_in_one_line(tmp_path):
    mixed = TETRAHEDRA.copy()
    mixed[0] = mixed[0, [0, 2, 1, 3]]
    bad = {
        "inverted": write_tets(tmp_path / "mixed.tet", mixed),
        "unknown kind": tmp_path / "a.step",
        "no such mesh file": tmp_path / "missing.stl",
        "cannot be read": tmp_path / "broken.vtu",
        "open": tmp_path / "open.stl",
    }
    bad["cannot be read"].write_text("<VTK")
    box = trimesh.creation.box()
    box.update_faces(np.arange(12) > 0)
    box.export(bad["open"])
    for says, path in bad.items():
        with pytest.raises(InputError, match=says) as error:
            mesh_files.read_mesh(path, "mm")
        assert str(path) in str(error.value)
        assert "\n" not in str(error.value)


def output_mesh(source: str, shift: float = 0.0) -> OutputMesh:
    arrays = {
        "vertices": POINTS + shift,
        "tetrahedra": TETRAHEDRA,
        "surface_triangles": TETRAHEDRA[:, :3],
        "held": POINTS[:, 0] == 0,
        "touchable": POINTS[:, 0] > 1,
    }
    return mesh_files.with_hash(OutputMesh, source, arrays)


def test_a_saved_mesh_comes_back_with_its_hash_and_a_stale_one_is_refused(tmp_path):
    mesh = output_mesh("abc")
    assert len(mesh.surface_vertices)  # derived values are not saved
    mesh_files.save_mesh(tmp_path / "m.npz", mesh, "abc")
    again = mesh_files.load_mesh(tmp_path / "m.npz", OutputMesh, "abc")
    assert again.hash == mesh.hash
    np.testing.assert_array_equal(again.vertices, mesh.vertices)
    assert mesh_files.load_mesh(tmp_path / "other.npz", OutputMesh, "abc") is None
    with pytest.raises(InputError, match="run simgen mesh"):
        mesh_files.load_mesh(tmp_path / "m.npz", OutputMesh, "changed")


def test_the_hash_depends_on_every_array():
    assert output_mesh("a").hash == output_mesh("a").hash
    assert len({output_mesh("a").hash, output_mesh("b").hash, output_mesh("a", 1e-12).hash}) == 3


def test_the_first_mesh_in_the_cache_stays(tmp_path, monkeypatch):
    monkeypatch.setenv("SIMGEN_CACHE", str(tmp_path))

    def while_another_process_is_first():
        mesh_files.save_mesh(tmp_path / "meshes" / "key.npz", output_mesh("key", 1.0), "key")
        return output_mesh("key", 2.0)

    mesh = mesh_files.cached("key", OutputMesh, while_another_process_is_first)
    np.testing.assert_array_equal(mesh.vertices, POINTS + 1.0)
    again = mesh_files.cached("key", OutputMesh, lambda: pytest.fail("made again"))
    assert again.hash == mesh.hash
    assert [path.name for path in (tmp_path / "meshes").iterdir()] == ["key.npz"]


def test_a_body_without_thickness_is_no_body():
    flat = trimesh.creation.box([20e-3, 4e-3, 1e-303])
    with pytest.raises(InputError, match=r"sensor\.yaml: its sizes make no closed body"):
        mesh_files.check_body(Path("sensor.yaml"), flat)
    mesh_files.check_body(Path("sensor.yaml"), trimesh.creation.box([20e-3, 4e-3, 1e-3]))
