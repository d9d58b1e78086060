"""The published meshes as sensors: our descriptions of the two sensors, with their gel and core in place of ours.

What is held, the materials and the friction are then the same, so that two presses differ in their meshes alone. The
published simulation of the BioTac held, besides the plates, 15 vertices of the inner skin that touch the core.

A folder of published data is laid out as their repositories: ``biotac/`` (NVlabs/biotac_sim), ``digit/``
(wzaielamri/across_framework), ``indenters/`` (both); result files (``*.hdf5``) lie anywhere below.
"""

from __future__ import annotations

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
UNIT = "m"  # of all published meshes


def published_sensors(published: Path) -> list[str]:
    """Names of the sensors whose published meshes are there."""
    return [name for name in GEL if all((published / files[name]).is_file() for files in (GEL, CORE) if name in files)]


def published_indenters(published: Path) -> dict[str, trimesh.Trimesh]:
    """Published shapes by the names that we give them, m, in our frame."""
    files = {name: published / "indenters" / f"{name.replace('.5', '-5')}.obj" for name in indenter_names()}
    return {name: trimesh.load(file, force="mesh") for name, file in files.items() if file.is_file()}


def published_surface(published: Path, name: str) -> trimesh.Trimesh:
    """Closed surface of a published gel, m."""
    return read_mesh(published / GEL[name], UNIT)[0]


def published_sensor(published: Path, name: str, scratch: Path) -> Sensor:
    """A published gel and core as a sensor on its own tetrahedra (mid-edge nodes on straight edges).

    Its description is written into ``scratch``, as a user would. Raises InputError for a mesh that fails the gates.
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
    """The ``mesh`` key for a mesh file that is copied into the folder of a ``sensor.yaml``."""
    shutil.copy(path, folder)
    return {"file": path.name, "unit": UNIT}


def seen_at(name: str, vertices: OutputMesh, mesh: str = "default") -> Sensor:
    """Our sensor, solved on its own mesh, its displacement stored at the vertices of another one."""
    return replace(load_sensor(name, mesh), output_mesh=vertices)


def mesh_with(name: str, vertices: int, published: Path) -> OutputMesh:
    """The mesh of so many vertices: the bundled output mesh of sensor ``name``, or a tetrahedral file below a folder.

    Regions are those of our sensor, in whose frame the file must be. Raises InputError where there is no such mesh.
    """
    bundled = load_sensor(name).output_mesh
    if len(bundled.vertices) == vertices:
        return bundled
    for file in sorted(path for path in published.rglob("*") if path.suffix.lower() in TET_SUFFIXES):
        _, points, tetrahedra = read_mesh(file, UNIT)
        if points is not None and len(points) == vertices:
            return output_of(load_geometry(name), points, tetrahedra, source=str(file))
    raise InputError(f"{published}: no mesh of {vertices} vertices ({' '.join(TET_SUFFIXES)}), as the results have")
