"""Whatever a file holds, reading it works or raises `InputError` of one line: never anything else, never for long.

The short runs are part of the tests; ``python -m pytest -m long tests/fuzz`` takes ten minutes.
"""

import json
import signal
import time
import warnings
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from resource import RLIMIT_AS, getpagesize, getrlimit, setrlimit

import fake
import meshio
import numpy as np
import pytest
import trimesh
import yaml
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from simgen.config.choices import MESH_SUFFIXES
from simgen.config.job import load_job
from simgen.config.job_schema import Job
from simgen.config.resources import resource
from simgen.dataset import audit
from simgen.dataset.layout import faults
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.geometry import mesh_files
from simgen.geometry.tetrahedra import sizing_grid
from simgen.pipeline.run import run
from simgen.pipeline.run_status import outcomes, run_status
from simgen.sensors.indenter import MESH_SUFFIXES as INDENTER_SUFFIXES
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import place_camera, place_electrodes
from simgen.sensors.sensor_geometry import load_geometry
from simgen.sensors.sensor_meshes import check_count
from simgen.sensors.support import load_support
from tests.fuzz.mutations import mutated_bytes, mutated_tree

LONGEST_S = 30.0  # of one example, which takes milliseconds on its own
MOST_BYTES = 6 * 2**30  # by which the process may grow
LONG_S = 600.0
EXAMPLES = {"job": 150, "mesh": 250, "sensor": 80, "dataset": 30}  # of a short run: some five seconds each


class TooLongError(BaseException):
    """No `Exception`: nobody may catch it."""


@contextmanager
def bounded():
    def stop(*_):
        raise TooLongError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module", autouse=True)
def bounded_memory():
    before = getrlimit(RLIMIT_AS)
    now = int(Path("/proc/self/statm").read_text().split()[0]) * getpagesize()
    setrlimit(RLIMIT_AS, (now + MOST_BYTES, before[1]))
    yield
    setrlimit(RLIMIT_AS, before)


def accepted(read: Callable, *arguments) -> object | None:
    """What a reader returns; None if it raises `InputError` of one line."""
    try:
        with bounded(), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # they would be printed
            return read(*arguments)
    except InputError as error:
        assert len(str(error).splitlines()) == 1 and str(error).isprintable() and len(str(error)) < 3000, str(error)
        return None


# Jobs

JOBS = [file.read_bytes() for file in sorted(resource("jobs").glob("*.yaml"))]
JOB_TREES = [yaml.safe_load(text) for text in JOBS]
RICH = {
    "name": "rich",
    "sensors": {"a": {"model": "./x", "material": {"preset": "solid", "friction": 0.5}, "fluid": "none"}},
    "indenters": ["sphere_7mm", "pins/p.stl"], "trajectories": {"count": 3, "roll_range_deg": [-10, 20.0]},
    "depths_mm": {"first": 0.1, "last": 1, "count": 3}, "solver": {"element": "P1"},
    "dataset": {"output": "x", "leave_out": "p", "displacement": "float32"},
}  # fmt: skip


def to_yaml(tree) -> bytes:
    """As YAML's subset JSON, which says what YAML's own writer cannot (half characters), or too deep for it."""
    try:
        return json.dumps(tree).encode()
    except RecursionError:
        return b"["


JOB_FILES = st.one_of(
    st.sampled_from(JOBS).flatmap(mutated_bytes),
    st.sampled_from([*JOB_TREES, RICH]).flatmap(mutated_tree).map(to_yaml),
)


@pytest.fixture(scope="module")
def job_reader(tmp_path_factory):
    file = tmp_path_factory.mktemp("job") / "job.yaml"

    def read(data: bytes) -> None:
        file.write_bytes(data)
        job = accepted(load_job, file)
        if job is not None:
            assert isinstance(job, Job)
            assert len(job.hash) == 64 and json.dumps(job.resolved())
            pressed = job.depths_m[job.indenter_path.legs == 0]
            assert (np.diff(pressed) > 0).all() and pressed[0] > 0
            assert job.shards <= job.presses <= job.samples
            job.output(), [job.locate(each.file) for each in job.indenters]

    return JOB_FILES, read


# Meshes

POINTS, TETRAHEDRA = sizing_grid(np.zeros(3), np.array([2.0, 1.0, 1.0]), 1.0)  # mm


def mesh_files_of(folder: Path) -> list[tuple[str, bytes]]:
    """Small valid files of every format, in text and in bytes: suffix and contents."""
    box = trimesh.creation.box([2.0, 1.0, 1.0])
    found = [(suffix, box.export(file_type=suffix[1:])) for suffix in (".stl", ".obj", ".ply")]
    found += [(".stl", box.export(file_type="stl_ascii")), (".ply", box.export(file_type="ply", encoding="ascii"))]
    rows = [f"v {x} {y} {z}" for x, y, z in POINTS] + ["t " + " ".join(map(str, t)) for t in TETRAHEDRA]
    found.append((".tet", "\n".join(rows)))
    tets, skin = (meshio.Mesh(POINTS, [("tetra", TETRAHEDRA)]), meshio.Mesh(box.vertices, [("triangle", box.faces)]))
    for mesh in (tets, skin):
        gmsh = [{"file_format": kind, "binary": binary} for kind in ("gmsh", "gmsh22") for binary in (False, True)]
        vtu = [{"binary": False}, {"compression": None}, {}]
        for suffix, options in [(".mesh", {}), *((".vtu", each) for each in vtu), *((".msh", each) for each in gmsh)]:
            mesh.write(folder / f"m{suffix}", **options)
            found.append((suffix, (folder / f"m{suffix}").read_bytes()))
    return [(suffix, data.encode() if isinstance(data, str) else data) for suffix, data in found]


@pytest.fixture(scope="module")
def mesh_reader(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mesh")
    valid = mesh_files_of(folder)
    assert {suffix for suffix, _ in valid} == set(MESH_SUFFIXES)

    def read(chosen: tuple[str, bytes]) -> None:
        suffix, data = chosen
        file = folder / f"mutated{suffix}"
        file.write_bytes(data)
        found = accepted(mesh_files.read_mesh, file, "mm")
        if found is not None:
            assert found[0].is_watertight and np.isfinite(found[0].vertices).all()
        if suffix in INDENTER_SUFFIXES and (indenter := accepted(load_indenter, file)) is not None:
            assert np.isfinite(indenter.extent).all()

    for each in valid:
        read(each)
        assert mesh_files.read_mesh(folder / f"mutated{each[0]}", "mm")[0].is_watertight
    return st.sampled_from(valid).flatmap(lambda each: st.tuples(st.just(each[0]), mutated_bytes(each[1]))), read


# Sensors

SLAB = {
    "name": "slab",
    "gel": {"mesh": {"file": "slab.stl", "unit": "mm"}},
    "held": {
        "back": {"plane": {"axis": "y", "at_mm": 2.0}},
        "side": {"box": {"x_mm": [-10.0, -8.0], "y_mm": [-2.0, 2.0]}},
        "pin": {"cylinder": {"axis": "y", "center_mm": [0.0, 0.0], "radius_mm": 1.0, "along_mm": [1.0, 3.0]}},
        "glue": {"touching": {"file": "slab.stl", "unit": "mm", "within_mm": 0.1}},
    },
    "support": {"mesh": {"file": "table.stl", "unit": "mm"}, "friction": 0.5},
    "meshes": {"default": {"edge_length_mm": 4.0, "held_edge_length_mm": 6.0}, "coarse": "as_given"},
    "materials": {"solid": {"youngs_modulus_pa": 539e3, "poisson_ratio": 0.499, "friction": 0.78}},
}


def sensor_trees() -> list[dict]:
    """The bundled sensors with few triangles, and one of a mesh file."""
    digit, biotac, mini = (
        yaml.safe_load((resource("sensor_models") / name / "sensor.yaml").read_text())
        for name in ("digit", "biotac", "gelsight_mini")
    )
    digit["gel"]["dome"]["spacing_mm"] = 2.5
    biotac["gel"]["polar_shell"]["spacing_mm"] = 2.0
    biotac["core"]["polar_core"]["spacing_mm"] = 2.0
    mini["gel"]["pad"]["spacing_mm"] = 2.5
    for each in (digit, biotac, mini):
        each["meshes"]["default"]["edge_length_mm"] = 5.0
    return [SLAB, digit, biotac, mini]


@pytest.fixture(scope="module")
def sensor_reader(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sensor")
    trimesh.creation.box([20.0, 4.0, 20.0]).export(folder / "slab.stl")
    trimesh.creation.box([24.0, 2.0, 24.0]).apply_translation([0.0, 3.0, 0.0]).export(folder / "table.stl")
    trees = sensor_trees()

    def everything(path: Path):
        shape = load_geometry(path)
        about = shape.description
        sizes = (about.meshes.default, about.meshes.coarse, about.meshes.fine, about.meshes.output)
        for size in sizes:
            if size is not None and size != "as_given":
                check_count(shape, size)
        parts = [shape.true.surface.vertices]
        for camera in about.cameras.values():
            parts += place_camera(camera).lights.values()
        if about.support is not None:
            parts.append(load_support(about.support, folder, shape.true).distance(shape.true.surface.vertices))
        if about.electrodes is not None:
            parts.append(place_electrodes(about.electrodes, shape.core))
        return parts

    def read(data: bytes) -> None:
        (folder / "sensor.yaml").write_bytes(data)
        for each in accepted(everything, folder) or ():
            assert np.isfinite(each).all()

    for tree in trees:
        (folder / "sensor.yaml").write_bytes(to_yaml(tree))
        assert everything(folder)
    texts = [yaml.safe_dump(tree, sort_keys=False).encode() for tree in trees]
    mutated = st.one_of(
        st.sampled_from(trees).flatmap(mutated_tree).map(to_yaml), st.sampled_from(texts).flatmap(mutated_bytes)
    )
    return mutated, read


# Datasets

FILES = (
    "zarr.json", "zarr.json", "zarr.json", "digit/displacement/zarr.json", "depth/c/0", "press/indenter/c/0",
    "digit/status/c/1/0", "digit/displacement/c/1/0/0/0", "biotac/surface_triangles/c/0/0", "digit/pose/c/0/0/0",
    "manifest/plan.json", "manifest/000001.json", "manifest/timings.jsonl",
)  # fmt: skip


@pytest.fixture(scope="module")
def dataset_reader(tmp_path_factory):
    path = tmp_path_factory.mktemp("dataset") / "d.zarr"
    run(fake.make_plan(fake.make_job(trajectories={"count": 1})), path, build=fake.fake_presser)
    whole = {file: (path / file).read_bytes() for file in FILES}

    def mutations(file: str):
        anyhow = mutated_bytes(whole[file])
        if file.endswith(".json"):
            anyhow |= mutated_tree(json.loads(whole[file])).map(to_yaml)
        return st.tuples(st.just(file), anyhow)

    def everything() -> None:
        dataset = Dataset(path)
        for name in dataset.arrays:
            accepted(dataset.__getitem__, name)
        accepted(dataset.displacement, dataset.sensors[0], 0)
        accepted(audit.check, dataset)
        if not faults(dataset):
            run_status(dataset), accepted(outcomes, dataset)

    def read(chosen: tuple[str, bytes]) -> None:
        file, data = chosen
        (path / file).write_bytes(data)
        try:
            accepted(everything)
        finally:
            (path / file).write_bytes(whole[file])

    return st.sampled_from(FILES).flatmap(mutations), read


def fuzz(strategy: st.SearchStrategy, read: Callable, examples: int, **options) -> None:
    @settings(
        max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck), database=None, print_blob=False,
        phases=(Phase.explicit, Phase.generate, Phase.shrink), **options,
    )  # fmt: skip
    @given(strategy)
    def example(data):
        read(data)

    example()


@pytest.mark.parametrize("what", EXAMPLES)
def test_what_is_read_works_or_is_refused_in_one_line(what, request):
    fuzz(*request.getfixturevalue(f"{what}_reader"), EXAMPLES[what], derandomize=True)


@pytest.mark.long
@pytest.mark.parametrize("what", EXAMPLES)
def test_what_is_read_for_minutes(what, request, capsys):
    strategy, read = request.getfixturevalue(f"{what}_reader")
    count, end = 0, time.monotonic() + LONG_S / len(EXAMPLES)

    def counted(data) -> None:
        nonlocal count
        count += 1
        read(data)

    while time.monotonic() < end:
        fuzz(strategy, counted, EXAMPLES[what])
    with capsys.disabled():
        print(f"{what}: {count} examples")
