"""Height maps of the solution: exact on curved surfaces, equal to fine meshes, stored, loaded and rendered."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from refusal import simgen

from simgen import load_dataset
from simgen.config.job import job_from_dict
from simgen.config.outputs import NOT_REACHED
from simgen.config.solver_settings import SolverSettings
from simgen.dataset.audit import check, passes
from simgen.dataset.exchange.selection import select, untracked
from simgen.dataset.exchange.training_arrays import export_npy
from simgen.errors import InputError
from simgen.fem.nonlinear.status import Status
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.geometry.subdivided_faces import subdivided_faces
from simgen.geometry.tetrahedra import SimulationMesh
from simgen.pipeline.plan import make_plan
from simgen.pipeline.run import run
from simgen.sensing.camera.renderer import Look, Renderer
from simgen.sensors.height_map import HeightMaps
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import Camera, Material
from simgen.simulation.height_maps import solution_height_maps
from simgen.simulation.press import Scene, press
from simgen.verification.validate.layer_press import LayerMeshSize, quarter_layer
from simgen.verification.validate.meshes import box, top
from simulation.blocks import GEL, SPHERE, make_block, pose
from simulation.failing_steps import fail_beyond

RADIUS_MM, MIDDLE_MM = 3.0, 2.5


def camera(height: int = 120, width: int = 90) -> Camera:
    """A camera 15 mm behind the layer's top, which lies at y = 0 and is touched from below."""
    position = 1e-3 * np.array([MIDDLE_MM, 15.0, MIDDLE_MM])
    return Camera(position, np.array([0.0, -1.0, 0.0]), np.array([-1.0, 0.0, 0.0]), 18.0, width, height, {})


def camera_over_the_block() -> Camera:
    """A camera 15 mm behind the top of `make_block`, whose middle is at the origin."""
    position = np.array([0.0, 15e-3, 0.0])
    return Camera(position, np.array([0.0, -1.0, 0.0]), np.array([-1.0, 0.0, 0.0]), 27.0, 90, 90, {})


@pytest.fixture(scope="module")
def layer():
    return quarter_layer(LayerMeshSize(edge=0.3, until=6.0, growth=0.4, top=0.3), np.zeros(1))


def test_a_sphere_is_seen_to_a_micrometre_at_slopes_up_to_45_degrees():
    """Nodes of a plane move straight up onto a sphere, over its rim, too. Rays meet it at the smaller root."""
    cube = box((24, 1, 24), (6.0, 0.5, 6.0))
    nodes, plane = 1e-3 * (cube.nodes + np.array([MIDDLE_MM, 0.0, MIDDLE_MM])), top(cube.nodes, cube.faces)
    mesh = SimulationMesh(nodes, cube.n_corners, cube.tetrahedra, np.zeros(len(nodes), bool), plane, plane[:0], "")
    maps, matrix = solution_height_maps(mesh, camera())
    beside = 1e3 * np.hypot(nodes[:, 0] - 1e-3 * MIDDLE_MM, nodes[:, 2] - 1e-3 * MIDDLE_MM)
    deep = RADIUS_MM * (1.0 - np.cos(np.pi / 4))
    up = deep - RADIUS_MM + np.sqrt(RADIUS_MM**2 - np.minimum(beside, 0.9 * RADIUS_MM) ** 2)  # mm
    found = 1e3 * maps((matrix @ (1e-3 * up[:, None] * [0.0, 1.0, 0.0]))[None]).numpy()[0]

    rows, columns = np.mgrid[:120, :90]
    x, y = maps.pinhole.across(rows, columns)
    ray = np.stack([x, y, np.ones_like(x)], axis=-1)
    middle = np.array([0.0, 0.0, 15.0 - deep + RADIUS_MM])  # of the sphere: right, up, depth, mm
    square, along = np.einsum("rci,rci->rc", ray, ray), ray @ middle
    root = np.maximum(along**2 - square * (middle @ middle - RADIUS_MM**2), 0.0)
    depth = (along - np.sqrt(root)) / square
    inside = np.hypot(x * depth, y * depth) < RADIUS_MM * np.sin(np.pi / 4)
    assert inside.sum() > 1000
    assert np.abs(found - (15.0 - depth))[inside].max() < 1e-3


@pytest.fixture(scope="module")
def pressed(layer):
    """A scene and a press of a sphere, R = 3.5 mm, to 0.6 mm in three steps, seen by the camera."""
    material = Material(youngs_modulus_pa=539e3, poisson_ratio=0.499, friction=0.0)
    scene = Scene(layer, material, outputs=("height_map",), camera=camera())
    return scene, press(scene, [rigid_shape(Kind.SPHERE, 3.5)], np.eye(4)[None], 2e-4 * np.arange(1, 4))[0]


def test_it_equals_the_map_of_a_fine_mesh_of_the_same_solution(layer, pressed):
    """Each face in 24 x 24 flat pieces, four times as fine. The state is that of the last step."""
    scene, result = pressed
    mesh, n = scene.mesh, len(scene.nodes)
    moved = 1e-3 * scene.solver.x.numpy()[: 3 * n, 0].reshape(n, 3)
    matrix, triangles = subdivided_faces(mesh.touchable, n, 24)
    fine = HeightMaps.of_mesh(matrix @ mesh.nodes, triangles, solution_height_maps(mesh, camera())[0].pinhole)
    assert np.abs(fine((matrix @ moved)[None]).numpy()[0] - 1e-7 * result.height_map[-1]).max() < 0.5e-6


def test_it_is_near_that_of_stored_meshes_and_nearer_to_finer_ones():
    """Vertices of a stored mesh lie on the solution's surface, and its facets are chords of it."""
    apart = {}
    for cells in (8, 32):
        stored = make_block((cells, cells // 4, cells)).output_mesh
        sensor = replace(make_block((8, 2, 8)), output_mesh=stored)
        scene = Scene(sensor, GEL, outputs=("height_map",), camera=camera_over_the_block())
        [result] = press(scene, [SPHERE], pose(), np.array([0.3e-3, 0.6e-3]))
        maps = HeightMaps.of_mesh(stored.vertices, stored.surface_triangles, Pinhole.of(camera_over_the_block()))
        away = np.abs(maps(result.displacement[1:]).numpy()[0] - 1e-7 * result.height_map[1])
        apart[cells] = 1e6 * np.array([np.median(away), np.quantile(away, 0.99), away.max()])  # um
    assert (apart[32] < [0.3, 7.0, 9.0]).all() and (apart[32] < 0.1 * apart[8]).all()


def test_linear_elements_are_seen_with_their_flat_faces(layer, pressed):
    """The map is that of the corners alone, to steps of 0.1 um."""
    scene = Scene(layer, pressed[0].material, settings=SolverSettings(element="P1"), outputs=("height_map",),
                  camera=camera())  # fmt: skip
    [result] = press(scene, [rigid_shape(Kind.SPHERE, 3.5)], np.eye(4)[None], 2e-4 * np.arange(1, 4))
    mesh, n = scene.mesh, scene.mesh.n_corners
    assert (result.status == Status.CONVERGED).all() and len(scene.nodes) == n
    moved = 1e-3 * scene.solver.x.numpy()[: 3 * n, 0].reshape(n, 3)
    flat = HeightMaps.of_mesh(mesh.nodes[:n], mesh.touchable[:, :3], Pinhole.of(camera()))
    assert np.abs(flat(moved[None]).numpy()[0] - 1e-7 * result.height_map[-1]).max() < 0.2e-6


def test_the_contact_has_the_height_of_the_indenter(pressed):
    """The sphere touches at the origin, so that its cap is in a corner of the map."""
    _, result = pressed
    assert result.height_map.shape == (3, 120, 90) and result.height_map.dtype == np.int16
    peaks = 1e-4 * result.height_map.max(axis=(1, 2))
    assert (np.diff(peaks) > 0.05).all() and peaks[-1] < 0.6


def test_a_height_that_does_not_fit_becomes_that_of_the_nearest_other_pixel(layer, pressed):
    """Steps of 10 nm reach 0.33 mm: lower pixels stay, and higher ones take the height of those at the edge."""
    scene = Scene(layer, pressed[0].material, outputs=("height_map",), camera=camera(), height_step_m=1e-8)
    [result] = press(scene, [rigid_shape(Kind.SPHERE, 3.5)], np.eye(4)[None], 2e-4 * np.arange(1, 4))
    whole = 10.0 * pressed[1].height_map[-1]
    fits = whole < 2**15 - 100
    assert 0 < (~fits).sum() < fits.sum()
    assert np.abs(result.height_map[-1] - whole)[fits].max() < 50
    assert result.height_map[-1][~fits].min() > 31000


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
def test_a_gpu_sees_the_same(layer, pressed):
    scene = Scene(layer, pressed[0].material, "cuda", 2, outputs=("height_map",), camera=camera())
    both = press(scene, [rigid_shape(Kind.SPHERE, 3.5)] * 2, np.eye(4)[None].repeat(2, axis=0), 2e-4 * np.arange(1, 4))
    for result in both:
        np.testing.assert_allclose(result.height_map, pressed[1].height_map, atol=10)  # steps of 0.1 um


JOB = {
    "name": "seen",
    "sensors": {"digit": {"model": "digit", "mesh": "coarse"}},
    "indenters": ["sphere_7mm"],
    "trajectories": {"count": 2},
    "depths_mm": {"first": 0.4, "last": 0.8, "count": 2},
    "outputs": {"digit": ["height_map"]},
}


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    return run(make_plan(job_from_dict(JOB)), tmp_path_factory.mktemp("seen") / "seen.zarr")


def test_a_dataset_stores_loads_and_exports_them(seen, tmp_path):
    array = seen.array("digit/height_map")
    assert array.shape == (2, 2, 320, 240) and array.dtype == np.int16 and array.attrs["scale_factor"] == 1e-7
    assert seen["digit/height_map_depth"].shape == (320, 240)
    heights = seen.in_unit("digit/height_map", 0)
    assert 0.6e-3 < heights[1].max() < 0.9e-3 and passes(check(seen))
    sample = load_dataset(seen.path)[1]["digit/height_map"]
    assert sample.dtype == np.float32
    np.testing.assert_array_equal(sample, np.float32(heights[1]))
    export_npy(select(seen, ("digit",)), tmp_path, untracked)
    np.testing.assert_array_equal(np.load(tmp_path / "digit" / "height_map.npy")[1], sample)


@pytest.mark.parametrize(("second_mm", "reached"), [(np.inf, 2), (0.3, 1)])
def test_maps_are_those_of_the_try_that_counts(seen, tmp_path, monkeypatch, second_mm, reached):
    """The first try fails after the first depth, and the second one gets to its end or less far."""
    fail_beyond(monkeypatch, (0.5, second_mm))
    job = job_from_dict(JOB | {"trajectories": {"count": 1}, "solver": {"smallest_substep": 0.5}})
    twice = run(make_plan(job), tmp_path / "twice.zarr")
    assert (twice["digit/status"][0] == Status.CONVERGED).tolist() == [True] * reached + [False] * (2 - reached)
    maps, once = (dataset["digit/height_map"][0].astype(int) for dataset in (twice, seen))
    assert np.abs(maps - once)[:reached].max() < 50 and (maps[reached:] == NOT_REACHED).all()  # 5 um: other load steps


def test_growth_adds_maps_and_keeps_those_that_are_there(seen, tmp_path):
    folder, added = tmp_path / "grown.zarr", []
    for count in (1, 2):
        job = job_from_dict(JOB | {"trajectories": {"count": count}, "dataset": {"presses_per_shard": 1}})
        grown = run(make_plan(job), folder, on_report=lambda report: added.append(report.shard))
    assert added == [0, 1] and grown.grown_from == (1,) and passes(check(grown))
    np.testing.assert_array_equal(grown["digit/height_map"], seen["digit/height_map"])


def test_a_job_with_linear_elements_stores_them(tmp_path):
    job = job_from_dict(JOB | {"trajectories": {"count": 1}, "solver": {"element": "P1"}})
    linear = run(make_plan(job), tmp_path / "linear.zarr")
    assert 0.6e-3 < linear.in_unit("digit/height_map", 0)[1].max() < 0.9e-3 and passes(check(linear))


def test_images_of_them_are_sharp_and_show_the_same_press_as_the_mesh(seen):
    solution, mesh = (Renderer.of_dataset(seen, "digit", Look(heights=each)) for each in ("solution", "mesh"))
    assert solution.blur.sizes == () and mesh.blur.sizes
    own = solution(seen.in_unit("digit/height_map", 0)).astype(int) - solution.background
    other = mesh(seen.displacement("digit", 0)).astype(int) - mesh.background
    touched = np.abs(other).max(axis=3) > 8
    assert np.corrcoef(own[touched].ravel(), other[touched].ravel())[0, 1] > 0.9
    large = Renderer.of_dataset(seen, "digit", Look(height=640, width=480, heights="solution"))
    pictures = large(seen.in_unit("digit/height_map", 0))
    assert pictures.shape == (2, 640, 480, 3)
    assert np.abs(pictures[:, ::2, ::2].astype(int) - large.background[::2, ::2] - own)[touched].mean() < 4.0


def test_render_uses_them_unless_it_is_told_otherwise(seen, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    for folder, options, heights in (("a", "", "solution"), ("b", "--heights mesh", "mesh"),
                                     ("c", "--camera tacto", "mesh")):  # fmt: skip
        code, _, error = simgen(
            f"render {seen.path} -o {folder} --size 48x64 --workers 1 {options}", monkeypatch, capfd
        )
        assert code == 0, error
        assert f'"heights": "{heights}"' in (tmp_path / folder / "render.json").read_text()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ("--camera tacto --heights solution", "digit/height_map is of camera default; allowed: default, or --heights"),
        ("--heights image", "--heights 'image': allowed: mesh, solution"),
    ],
)
def test_bad_options_are_one_line(seen, options, complaint, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    code, _, error = simgen(f"render {seen.path} -o a {options}", monkeypatch, capfd)
    assert code == 2 and complaint in error and error.count("\n") <= 1


def test_a_sensor_without_a_camera_is_one_line():
    job = job_from_dict(JOB | {"sensors": {"finger": {"model": "biotac", "mesh": "coarse"}},
                               "outputs": {"finger": ["height_map"]}})  # fmt: skip
    with pytest.raises(InputError, match=r"outputs\.finger: height_map: sensor biotac has no camera"):
        make_plan(job)
