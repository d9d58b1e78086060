"""Published meshes as sensors: our descriptions of the two sensors with the published gel and core.

Held regions, materials and friction are ours, so that two presses differ only in their meshes. The published simulation
of the BioTac also held 15 vertices of the inner skin that touch the core.

A folder of published data has the layout of the repositories: ``biotac/`` (NVlabs/biotac_sim), ``digit/``
(wzaielamri/across_framework) and ``indenters/`` (both). Result files (``*.hdf5``) may lie anywhere below it.
"""

import shutil
from dataclasses import replace
from pathlib import Path

import trimesh
import yaml

from simgen.errors import InputError
from simgen.geometry.mesh_files import TET_SUFFIXES, read_mesh
from simgen.geometry.tetrahedra import OutputMesh
from simgen.sensors.indenter import indenter_names
from simgen.sensors.sensor import Sensor, load_sensor
from simgen.sensors.sensor_geometry import load_geometry, sensor_folder
from simgen.sensors.sensor_meshes import output_of

GEL = {"digit": "digit/digit_gel.mesh", "biotac": "biotac/int_ext_skin_combined_ftw.tet"}
CORE = {"biotac": "biotac/top_side_core_bc.obj"}
UNIT = "m"  # unit of all published meshes


def published_sensors(published: Path) -> list[str]:
    """List the sensors whose published meshes exist."""
    return [name for name in GEL if all((published / files[name]).is_file() for files in (GEL, CORE) if name in files)]


def published_indenters(published: Path) -> dict[str, trimesh.Trimesh]:
    """Load the published indenters by our names, in m and in our frame."""
    files = {name: published / "indenters" / f"{name.replace('.5', '-5')}.obj" for name in indenter_names()}
    return {name: trimesh.load(file, force="mesh") for name, file in files.items() if file.is_file()}


def published_surface(published: Path, name: str) -> trimesh.Trimesh:
    """Read the closed surface of a published gel, m."""
    return read_mesh(published / GEL[name], UNIT)[0]


def published_sensor(published: Path, name: str, scratch: Path) -> Sensor:
    """Load a published gel and core as a sensor on its own tetrahedra, with straight edges.

    Writes a description of the sensor into ``scratch``. Raises InputError for a mesh that fails the quality gates.
    """
    folder = scratch / f"published_{name}"
    folder.mkdir(exist_ok=True)
    description = yaml.safe_load((sensor_folder(name) / "sensor.yaml").read_text())
    kept = {key: description[key] for key in ("held", "materials")}
    gel = {"mesh": _copied(published / GEL[name], folder)}
    own = {"name": f"{name}_published", "gel": gel, "meshes": {"default": "as_given"}, **kept}
    if name in CORE:
        core = _copied(published / CORE[name], folder)
        own["core"] = {"friction": description["core"]["friction"], "mesh": core}
    (folder / "sensor.yaml").write_text(yaml.safe_dump(own))
    return load_sensor(folder)


def _copied(path: Path, folder: Path) -> dict[str, str]:
    """Copy a mesh file into a sensor's folder; return its ``mesh`` key."""
    shutil.copy(path, folder)
    return {"file": path.name, "unit": UNIT}


def seen_at(name: str, vertices: OutputMesh, mesh: str = "default") -> Sensor:
    """Load our sensor on its own mesh, with output at the vertices of another mesh."""
    return replace(load_sensor(name, mesh), output_mesh=vertices)


def mesh_with(name: str, vertices: int, published: Path) -> OutputMesh:
    """Find the mesh with this number of vertices: our output mesh of the sensor, or a tetrahedral file below a folder.

    The file must be in the frame of our sensor, which gives the regions. Raises InputError if there is no such mesh.
    """
    bundled = load_sensor(name).output_mesh
    if len(bundled.vertices) == vertices:
        return bundled
    for file in sorted(path for path in published.rglob("*") if path.suffix.lower() in TET_SUFFIXES):
        _, points, tetrahedra = read_mesh(file, UNIT)
        if points is not None and len(points) == vertices:
            return output_of(load_geometry(name), points, tetrahedra, source=str(file))
    raise InputError(f"{published}: no mesh of {vertices} vertices ({' '.join(TET_SUFFIXES)}), as the results have")
