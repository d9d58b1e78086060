"""Simulation and output meshes of a sensor: made from its true surface, checked, stored, and found again."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from simgen.config.parsing import parsing
from simgen.errors import InputError
from simgen.geometry import mesh_files
from simgen.geometry.curved_tetrahedra import (
    CORE,
    FREE,
    HELD,
    CurvedMesh,
    LabelledSurface,
    face_regions,
    make_quadratic,
)
from simgen.geometry.interpolation import locate
from simgen.geometry.mesh_quality import MeshQuality, check, measure
from simgen.geometry.region_edges import align
from simgen.geometry.surface import shells
from simgen.geometry.tetrahedra import (
    OutputMesh,
    SimulationMesh,
    boundary_edges,
    boundary_triangles,
    signed_volumes,
    tetrahedralize,
)
from simgen.sensors.sensor_geometry import SensorGeometry
from simgen.sensors.sensor_schema import MeshSize
from simgen.units import MM

NAMES = ("default", "coarse", "fine")  # of simulation meshes
EXACT = 1e-9  # m; vertices of a user's own tetrahedra lie on the surface already
ATTEMPTS = 4  # fTetWild is not reproducible, and one mesh in many fails a gate
MOST_CELLS = 2_000_000  # cubes of an edge's length in the gel's bounding box; the DIGIT's fine mesh has 40,000
BOND_GROWTH = 0.7  # m of edge length per m of distance from an edge of a held region
LEAST_ENVELOPE = 1e-3  # of an edge's length
FARTHEST = 0.02  # of the gel's longest side: largest distance of a given output mesh's vertex from the gel
LIMIT = 5.0  # envelopes; largest move of a node onto its patches: mid-edge nodes also move from chord to arc


def simulation_mesh(geometry: SensorGeometry, name: str) -> SimulationMesh:
    """Load the simulation mesh of that name from the folder or the cache, or make it. Raises InputError."""
    settings = getattr(geometry.description.meshes, name)
    if settings is None:
        raise InputError(f"{geometry.folder / 'sensor.yaml'}: meshes.{name}: missing, but needed for mesh = {name!r}")
    source = geometry.mesh_source(settings)
    committed = mesh_files.load_mesh(geometry.folder / f"{name}.npz", SimulationMesh, source)
    return committed or mesh_files.cached(source, SimulationMesh, lambda: make_simulation_mesh(geometry, settings)[0])


class OutputMeshFile(NamedTuple):
    """A file of tetrahedra that replaces the output mesh, and the unit of its coordinates, m or mm."""

    path: Path
    unit: str


def output_mesh(geometry: SensorGeometry) -> OutputMesh:
    """Load the output mesh from the user's tetrahedra, the folder or the cache, or make it. Raises InputError."""
    settings = output_settings(geometry)
    source = geometry.mesh_source(settings) + "-output"
    if settings == "as_given":
        return output_of(geometry, geometry.own_vertices, geometry.own_tetrahedra, source, geometry.selected)
    committed = mesh_files.load_mesh(geometry.folder / "output.npz", OutputMesh, source)
    return committed or mesh_files.cached(source, OutputMesh, lambda: make_output_mesh(geometry, settings, source)[0])


def output_from_file(
    geometry: SensorGeometry, file: OutputMeshFile, solved: SimulationMesh
) -> tuple[OutputMesh, np.ndarray]:
    """Read an output mesh, and find the points (v, 3) m of the gel with which its vertices move.

    Vertices and tetrahedra keep the file's order. A vertex off the gel moves with the nearest point of the gel's
    surface. A vertex is held if it lies in a held region or if this point does. Raises InputError for a file that
    `mesh_files.read_mesh` refuses, a file without tetrahedra, and a vertex further off the gel than `FARTHEST`.
    """
    path = file.path
    _, vertices, tetrahedra = mesh_files.read_mesh(path, file.unit)
    if vertices is None:
        allowed = " ".join(mesh_files.TET_SUFFIXES)
        raise InputError(f"{path}: a surface; allowed: a file of tetrahedra ({allowed})")
    outside = locate(solved.nodes, solved.tetrahedra, vertices)[2] > EXACT
    moves_with = vertices.copy()
    moves_with[outside] = geometry.true.closest(vertices[outside])[0]
    away = np.linalg.norm(moves_with - vertices, axis=1)
    allowed = FARTHEST * np.ptp(geometry.plain.vertices, axis=0).max()
    if away.max() > allowed:
        raise InputError(
            f"{path}: unit {file.unit}: vertex {away.argmax()} lies {away.max() / MM:.3g} mm off the gel of sensor "
            f"{geometry.description.name}; allowed: {allowed / MM:.2g} mm, in the frame of the sensor"
        )
    source = geometry.mesh_source(f"{file.unit} {hashlib.sha256(path.read_bytes()).hexdigest()}") + "-output"

    def held_at(points: np.ndarray) -> np.ndarray:
        return geometry.selected(points) | geometry.true.is_held(points)

    return output_of(geometry, vertices, tetrahedra, source, held_at), moves_with


def output_settings(geometry: SensorGeometry) -> MeshSize | str:
    meshes = geometry.description.meshes
    return meshes.output or ("as_given" if geometry.own_tetrahedra is not None else meshes.default)


def remake(geometry: SensorGeometry) -> list[str]:
    """Make and check all meshes of a sensor, then write them into its folder; return a line about each."""
    made = []
    for name in NAMES:
        settings = getattr(geometry.description.meshes, name)
        if settings is not None:
            made.append((name, geometry.mesh_source(settings), *make_simulation_mesh(geometry, settings)))
    settings = output_settings(geometry)
    if settings != "as_given":
        source = geometry.mesh_source(settings) + "-output"
        made.append(("output", source, *make_output_mesh(geometry, settings, source)))
    return [_replace(geometry.folder / f"{name}.npz", mesh, source, quality) for name, source, mesh, quality in made]


def _replace(path: Path, mesh: SimulationMesh | OutputMesh, source: str, quality: MeshQuality) -> str:
    """Write a mesh and return a line that compares it with the old file."""
    points = "vertices" if isinstance(mesh, OutputMesh) else "nodes"
    before = "new"
    if path.is_file():
        with suppress(InputError), parsing(path, "a mesh that simgen wrote"), np.load(path) as old:
            inputs = "same" if str(old["source"]) == source else "other"
            before = f"was {len(old[points])} {points} from {inputs} geometry and settings"
    mesh_files.save_mesh(path, mesh, source)
    return f"{path.name}: {len(getattr(mesh, points))} {points}, {quality}; {before}; hash {mesh.hash[:12]}"


def edge_lengths(geometry: SensorGeometry, size: MeshSize):
    """Wanted edge length, m: a number, or a function of points (n, 3) m.

    It grows from the touchable skin to the held regions, and away from the edges of held regions.
    """
    fine = size.edge_length_mm * MM
    held = bond = None
    if size.held_edge_length_mm is not None:
        coarse, grading, held = size.held_edge_length_mm * MM, size.grading_mm * MM, geometry.true.part(HELD)
    if size.bond_edge_length_mm is not None:
        least = size.bond_edge_length_mm * MM
        bond = cKDTree(points_along(geometry.true.held_edges(), 0.25 * least))
    if held is None and bond is None:
        return fine

    def wanted(points: np.ndarray) -> np.ndarray:
        lengths = np.full(len(points), fine)
        if held is not None:
            lengths = coarse + (fine - coarse) * np.clip(held(points)[1] / grading, 0.0, 1.0)
        return lengths if bond is None else np.minimum(lengths, least + BOND_GROWTH * bond.query(points)[0])

    return wanted


def points_along(edges: np.ndarray, spacing: float) -> np.ndarray:
    """Points (n, 3) m on straight edges (e, 2, 3) m, with both ends, at most ``spacing`` m apart."""
    counts = np.ceil(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1) / spacing).astype(int) + 1
    return np.concatenate([np.linspace(*ends, count) for ends, count in zip(edges, counts, strict=True)])


def make_curved(geometry: SensorGeometry, size: MeshSize | str) -> tuple[CurvedMesh, MeshQuality]:
    """Make curved tetrahedra that pass the quality gates. Raises InputError with figures if all attempts fail."""
    as_given = size == "as_given"
    if as_given and geometry.own_tetrahedra is None:
        raise InputError(f"{geometry.folder / 'sensor.yaml'}: meshes: as_given needs a file of tetrahedra")
    attempts = 1 if as_given else ATTEMPTS
    for attempt in range(1, attempts + 1):
        if as_given:
            vertices, tetrahedra, limit = geometry.own_vertices, geometry.own_tetrahedra, EXACT
        else:
            check_count(geometry, size)
            envelope, cell = size.envelope * MM, size.cell_mm * MM
            wanted = edge_lengths(geometry, size)
            vertices, tetrahedra = tetrahedralize(geometry.plain, wanted, envelope, cell)
            vertices, tetrahedra = end_at_regions(vertices, tetrahedra, geometry.true)
            limit = LIMIT * envelope
        mesh = make_quadratic(vertices, tetrahedra, geometry.true, limit)
        quality = measure(mesh, geometry.true)
        try:
            check(quality, len(shells(geometry.true.surface)), f"sensor {geometry.description.name}")
        except InputError:
            if attempt == attempts:
                raise
        else:
            break
    return mesh, quality


def check_count(geometry: SensorGeometry, size: MeshSize) -> None:
    """Raise InputError for edges so short that meshing would take days and all memory."""
    extents = np.ptp(geometry.plain.vertices, axis=0) / MM
    least = float((extents.prod() / MOST_CELLS) ** (1 / 3))
    path = geometry.folder / "sensor.yaml"
    for key in ("edge_length_mm", "bond_edge_length_mm"):
        if (length := getattr(size, key)) is not None and length < least:
            raise InputError(f"{path}: meshes: {key} = {length:g}: allowed: {least:.2g} mm or more")
    if size.envelope < (thinnest := LEAST_ENVELOPE * size.edge_length_mm):
        raise InputError(f"{path}: meshes: envelope_mm = {size.envelope:g}: allowed: {thinnest:.2g} mm or more")


def end_at_regions(
    vertices: np.ndarray, tetrahedra: np.ndarray, true: LabelledSurface
) -> tuple[np.ndarray, np.ndarray]:
    """Align boundary triangles with the edges of held regions, where elements stay well shaped."""
    meeting = true.patches_at(vertices, boundary_triangles(tetrahedra)[0])
    return align(vertices, tetrahedra, boundary_edges(tetrahedra), true.is_held, meeting)


def make_simulation_mesh(geometry: SensorGeometry, size: MeshSize | str) -> tuple[SimulationMesh, MeshQuality]:
    """Make a simulation mesh that passes the quality gates, and return its quality too."""
    curved, quality = make_curved(geometry, size)
    held = np.zeros(len(curved.nodes), dtype=bool)
    held[curved.faces[curved.region == HELD]] = True
    arrays = {
        "nodes": curved.nodes,
        "n_corners": curved.n_corners,
        "tetrahedra": curved.tetrahedra,
        "held": held,
        "touchable": curved.faces[curved.region == FREE],
        "facing_core": curved.faces[curved.region == CORE],
    }
    return mesh_files.with_hash(SimulationMesh, geometry.mesh_source(size), arrays), quality


def make_output_mesh(geometry: SensorGeometry, size: MeshSize, source: str) -> tuple[OutputMesh, MeshQuality]:
    """Make an output mesh, the straight tetrahedra of a curved mesh that passes the gates; return its quality too."""
    curved, quality = make_curved(geometry, size)
    return output_of(geometry, curved.nodes[: curved.n_corners], curved.tetrahedra[:, :4], source), quality


def output_of(
    geometry: SensorGeometry,
    vertices: np.ndarray,
    tetrahedra: np.ndarray,
    source: str,
    held_at: Callable[[np.ndarray], np.ndarray] | None = None,
) -> OutputMesh:
    """Make the output mesh of given tetrahedra. Raises InputError if one is inverted.

    held_at : maps points (n, 3) m of the boundary to their mask (n,); by default, corners of held triangles are held
    """
    if (signed_volumes(vertices, tetrahedra) <= 0).any():
        raise InputError(f"sensor {geometry.description.name}: inverted tetrahedra in the output mesh")
    faces, _, _ = boundary_triangles(tetrahedra)
    region, _ = face_regions(vertices, faces, geometry.true)
    held = np.zeros(len(vertices), dtype=bool)
    if held_at is not None:
        on_surface = np.unique(faces)
        held[on_surface] = held_at(vertices[on_surface])
    else:
        held[faces[region == HELD]] = True
    touchable = np.zeros(len(vertices), dtype=bool)
    touchable[faces[region == FREE]] = True
    arrays = {
        "vertices": vertices,
        "tetrahedra": tetrahedra.astype(np.int32),
        "surface_triangles": faces.astype(np.int32),
        "held": held,
        "touchable": touchable & ~held,
    }
    return mesh_files.with_hash(OutputMesh, source, arrays)
