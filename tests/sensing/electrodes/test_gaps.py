"""Gaps above electrodes against planes and balls and VTK's rays on the BioTac; errors."""

import electrode_dataset
import fake
import numpy as np
import pytest
import pyvista
import trimesh
import warp as wp

from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.pipeline.run import run
from simgen.sensing.electrodes.gaps import GapGauge, gaps, gauge_of, outward_normals
from simgen.sensors.sensor import load_sensor, place_electrodes
from simgen.sensors.sensor_geometry import cavity_faces, load_geometry

EXACT = 1e-15  # m: some ten roundings of lengths of 0.01 m
GAP = 1e-3


def plane(height, half_width=4e-3, cells=8):
    """Vertices and triangles of a square above the origin, its corners where rays may hit them."""
    x = np.linspace(-half_width, half_width, cells + 1)
    vertices = np.stack([*np.meshgrid(x, x, indexing="ij"), np.full((cells + 1, cells + 1), height)], axis=-1)
    i = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    return vertices.reshape(-1, 3), np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def plane_gauge(slopes):
    """A gauge under a plane at `GAP`, with rays from the origin that lean by the slopes; cosines of their angles."""
    vertices, triangles = plane(GAP)
    directions = np.column_stack([slopes, np.zeros(len(slopes)), np.ones(len(slopes))])
    length = np.linalg.norm(directions, axis=1)
    gauge = GapGauge(vertices, triangles, np.zeros((len(slopes), 3)), directions / length[:, None])
    return gauge, 1.0 / length


def test_a_plane_at_rest_and_moved():
    gauge, cosine = plane_gauge(np.array([0.0, 0.1, -0.75]))  # the first hits a vertex, the others edges
    np.testing.assert_allclose(gauge.rest_gap, GAP / cosine, rtol=0, atol=EXACT)
    # Down, up, along itself, and to the very core: heights; a plane that moves along itself is where it was.
    moves = np.array([[0, 0, -2e-4], [0, 0, 5e-4], [3e-4, -2e-4, 0], [0, 0, -GAP], [0, 0, -1.3 * GAP]])
    found = gauge(np.repeat(moves[:, None], len(plane(GAP)[0]), axis=1))
    np.testing.assert_allclose(found, (GAP + moves[:, 2:]) / cosine, rtol=0, atol=EXACT)


def test_skin_that_tilts():
    gauge, _ = plane_gauge(np.zeros(1))
    vertices = plane(GAP)[0]
    tilt = np.stack([slope * (vertices[:, :1] - 1e-3) * [0, 0, 1] for slope in (-0.5, 0.2)])
    np.testing.assert_allclose(gauge(tilt), [[GAP + 5e-4], [GAP - 2e-4]], rtol=0, atol=EXACT)


def test_of_two_layers_the_first_counts():
    (low, triangles), (high, _) = plane(GAP), plane(2 * GAP)
    for order in ((low, high), (high, low)):
        both = np.concatenate([triangles, triangles + len(low)])
        gauge = GapGauge(np.concatenate(order), both, np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
        np.testing.assert_allclose(gauge.rest_gap, GAP, rtol=0, atol=EXACT)


def test_skin_that_left_the_ray_and_samples_that_are_not_there():
    gauge, _ = plane_gauge(np.zeros(2))
    count = len(plane(GAP)[0])
    moved = np.zeros((3, count, 3))
    moved[1, :, 0] = 1.0
    moved[2, 0] = np.nan
    found = gauge(moved)
    assert np.isfinite(found[0]).all() and np.isposinf(found[1]).all() and np.isnan(found[2]).all()


def test_no_skin_above_an_electrode_is_one_line():
    vertices, triangles = plane(GAP)
    up = np.array([[0.0, 0.0, 1.0]] * 2)
    with pytest.raises(InputError, match="electrode 2: no inner surface of the skin above it"):
        GapGauge(vertices, triangles, np.array([[0.0, 0, 0], [9e-3, 0, 0]]), up)


def test_balls_about_one_centre():
    core = trimesh.creation.icosphere(subdivisions=4, radius=6e-3)
    skin = trimesh.creation.icosphere(subdivisions=3, radius=7e-3)
    directions = np.random.default_rng(1).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    gauge = GapGauge(skin.vertices, skin.faces, 6e-3 * directions, directions)
    # A facet's middle lies below the ball by 1 - cos of half the angle that its longest edge spans, times 2 / sqrt 3.
    angle = skin.edges_unique_length.max() / np.sqrt(3) / 7e-3
    assert (gauge.rest_gap <= 1e-3 + EXACT).all() and (gauge.rest_gap >= 1e-3 - 7e-3 * (1 - np.cos(angle))).all()
    # A shrunken polyhedron is similar: the rays' lengths from the centre shrink with it, facet or not.
    shrunk = np.array([0.0, 0.02, 0.1, 0.2])
    found = gauge(-shrunk[:, None, None] * skin.vertices)
    expected = (gauge.rest_gap + 6e-3) * (1.0 - shrunk[:, None]) - 6e-3
    np.testing.assert_allclose(found, expected, rtol=0, atol=EXACT)
    assert (found[-1] < 0).all()  # inside the core, and still measured
    # Normals of a fine polyhedron, smoothed: within a quarter of the angle that its edges span.
    points = core.triangles_center[::97]
    cosine = np.einsum("ni,ni->n", outward_normals(core, points), points) / np.linalg.norm(points, axis=1)
    assert np.arccos(cosine).max() < core.edges_unique_length.max() / 6e-3 / 4


@pytest.fixture(scope="module")
def biotac():
    """Rest vertices, inner triangles, electrodes, normals."""
    sensor = load_sensor("biotac")
    mesh = sensor.output_mesh
    inner = cavity_faces(trimesh.Trimesh(mesh.vertices, mesh.surface_triangles, process=False))
    return (
        mesh.vertices,
        mesh.surface_triangles[inner],
        sensor.electrodes,
        outward_normals(sensor.core, sensor.electrodes),
    )


def vtk_gaps(vertices, triangles, electrodes, normals):
    """VTK's tree of oriented boxes; rays begin 2 mm below the electrodes."""
    surface = pyvista.PolyData.from_regular_faces(vertices, triangles)
    found = []
    for start, direction in zip(electrodes, normals, strict=True):
        points, _ = surface.ray_trace(start - 2e-3 * direction, start + 5e-3 * direction)
        found.append(((points - start) @ direction).min())
    return np.array(found)


def test_the_biotac_by_rays_of_vtk(biotac):
    vertices, triangles, electrodes, normals = biotac
    gauge = GapGauge(*biotac)
    bulge = 3e-4 * np.sin(vertices[:, ::-1] / 2e-3)
    for moved, found in ((0.0 * bulge, gauge.rest_gap), (bulge, gauge(bulge[None])[0])):
        assert np.abs(vtk_gaps(vertices + moved, triangles, electrodes, normals) - found).max() < EXACT
    assert gauge(bulge[None]).min() < 0.0 < gauge.rest_gap.min()  # skin overlaps the core


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return electrode_dataset.make(tmp_path_factory.mktemp("electrodes") / "fake.zarr")


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
def test_a_gpu_measures_the_same(biotac):
    bulge = 2e-4 * np.sin(biotac[0][None, :, ::-1] / np.array([1e-3, 2e-3, 3e-3])[:, None, None])
    np.testing.assert_allclose(GapGauge(*biotac, device="cuda")(bulge), GapGauge(*biotac)(bulge), rtol=0, atol=EXACT)


def test_samples_of_a_dataset(dataset, biotac):
    normals = biotac[3]
    press, step = np.array([11, 0, 0, 5, 0, 1]), np.array([3, 2, 0, 1, 2, 1])
    found = gaps(dataset, "biotac", press, step)
    assert found.shape == (6, 19)
    gauge = GapGauge(*biotac)
    for row, (p, k) in enumerate(zip(press, step, strict=True)):
        moved = dataset.displacement("biotac", int(p), int(k))
        np.testing.assert_array_equal(found[row], gauge(moved[None])[0])
    np.testing.assert_array_equal(found[1], found[4])
    # A skin that moves as a whole against a locally flat gap changes it by about the part along the normal.
    moved = dataset.displacement("biotac", 11, 3)[0]
    assert np.corrcoef(found[0] - gauge.rest_gap, normals @ moved)[0, 1] > 0.9


def test_the_gauge_of_a_dataset_is_that_of_its_model(dataset, biotac):
    shape = load_geometry("biotac")
    np.testing.assert_array_equal(place_electrodes(shape.description.electrodes, shape.core), biotac[2])
    np.testing.assert_array_equal(gauge_of(dataset, "biotac").rest_gap, GapGauge(*biotac).rest_gap)


@pytest.mark.parametrize(
    "sensor, press, step, complaint",
    [
        ("nose", [0], [0], "sensor 'nose': allowed: digit, biotac"),
        ("digit", [0], [0], "sensor digit: its model has no electrodes"),
        ("biotac", [1], [2], "press 1, depth 2: it did not converge"),
        ("biotac", [12], [0], "press 12 to 12; allowed: 0 to 11"),
        ("biotac", [-1], [0], "press -1 to -1; allowed: 0 to 11"),
        ("biotac", [0], [4], "step 4 to 4; allowed: 0 to 3"),
        ("biotac", [0, 1], [0], "press (2,), step (1,)"),
        ("biotac", [0.5], [0], "two lists of as many integers"),
        ("biotac", np.zeros(0, int), np.zeros(0, int), "samples: none"),
    ],
)
def test_samples_that_cannot_be_measured_are_one_line(dataset, sensor, press, step, complaint):
    with pytest.raises(InputError) as raised:
        gaps(dataset, sensor, np.array(press), np.array(step))
    assert complaint in str(raised.value) and "\n" not in str(raised.value)


def test_a_mesh_without_a_cavity_is_one_line(tmp_path):
    run(fake.make_plan(fake.make_job()), tmp_path / "ball.zarr", build=fake.fake_presser)
    with pytest.raises(InputError, match="sensor biotac: its mesh has no cavity"):
        gauge_of(Dataset(tmp_path / "ball.zarr"), "biotac")


def test_skin_that_left_a_ray_names_the_sample(dataset, monkeypatch):
    far = np.full((1, len(load_sensor("biotac").output_mesh.vertices), 3), 0.1)
    monkeypatch.setattr(Dataset, "displacement", lambda *_: far)
    with pytest.raises(InputError, match=r"press 3, depth 0: no skin within 5 mm .* above electrode 1;"):
        gaps(dataset, "biotac", np.array([3]), np.array([0]))


def test_a_device_that_is_none_is_one_line(dataset):
    with pytest.raises(InputError, match="device 'tpu' is not allowed"):
        gauge_of(dataset, "biotac", "tpu")
