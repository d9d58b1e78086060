"""Export to time series for ParaView: for each press and sensor, one of the sensor and one of the indenter.

``trajectory_<i>/<indenter>/<sensor>.pvd`` and ``<sensor>_indenter.pvd`` name a file for each step. Time is the depth in
mm, or the number of the step on a path with legs. Coordinates are deformed, in m, in the shared frame of the sensors.
They are in the sensor's own frame if an imported dataset lacks the sensor's pose; then the indenter is left out. The
indenter is also left out if its file has changed or is gone.
"""

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyvista

from simgen.config.indenter_path import moved
from simgen.config.outputs import AT_SURFACE
from simgen.config.warp_device import start_warp
from simgen.dataset.atomic_files import check_room
from simgen.dataset.exchange.selection import PressSelection, Track, vertex_flags
from simgen.dataset.pressed_indenters import pressed_indenter
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.fem.nonlinear.status import is_valid
from simgen.sensors.indenter_pose import advanced
from simgen.units import MM_PER_M


def export_vtk(selection: PressSelection, folder: Path, track: Track) -> None:
    """Write two files for each press, sensor and depth."""
    dataset = selection.dataset
    start_warp()  # meshes of indenters need it
    trajectory, indenter = dataset["press/trajectory"], dataset["press/indenter"]
    indenters = {index: _shape(dataset, index) for index in np.unique(indenter[selection.presses]).tolist()}
    for sensor in selection.sensors:
        series = _Series(dataset, sensor)
        for press in track(selection.presses, sensor):
            there = folder / f"trajectory_{trajectory[press]}" / dataset.indenters[indenter[press]]
            series.write(int(press), indenters[indenter[press]], there)


def _shape(dataset: Dataset, index: int) -> pyvista.PolyData | None:
    """Surface of an indenter; None if its file has changed or is gone."""
    try:
        mesh = pressed_indenter(dataset, index).mesh()
    except InputError:
        return None
    return pyvista.PolyData.from_regular_faces(np.float32(mesh.vertices), mesh.faces)


class _Series:
    """The presses of one sensor."""

    def __init__(self, dataset: Dataset, sensor: str):
        self.dataset, self.sensor = dataset, sensor
        self.rest, self.tetrahedra = dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/tetrahedra"]
        self.flags, self.offsets = vertex_flags(dataset, sensor), dataset.offsets_of(sensor)
        self.turns = dataset.indenter_path.turns_rad
        self.surface_outputs = [name for name in AT_SURFACE if f"{sensor}/{name}" in dataset.arrays]
        self.surface_vertices = dataset[f"{sensor}/surface_vertices"] if self.surface_outputs else None
        self.valid, self.force = is_valid(dataset[f"{sensor}/status"]), dataset[f"{sensor}/force"]
        self.pose = dataset[f"{sensor}/pose"]
        self.touched = advanced(dataset["press/pose"], dataset[f"{sensor}/touch"])

    def write(self, press: int, indenter: pyvista.PolyData | None, folder: Path) -> None:
        """Write all valid samples of a press; nothing without any."""
        steps = np.flatnonzero(self.valid[press])
        if not len(steps):
            return
        (folder / self.sensor).mkdir(parents=True)
        displacement, meshes, shapes = self.dataset.displacement(self.sensor, press), [], []
        for step in steps:
            check_room(folder)  # on a full disk VTK ends the process
            meshes.append((step, folder / self.sensor / f"depth_{step}.vtu"))
            self._sample(press, step, displacement[step]).save(meshes[-1][1])
            pose = moved(self.touched[press], self.offsets[press, step], self.turns[step])
            if indenter is not None and np.isfinite(pose).all():
                shapes.append((step, folder / self.sensor / f"indenter_{step}.vtp"))
                indenter.transform(pose, inplace=False).save(shapes[-1][1])
        self._write_pvd(folder / f"{self.sensor}.pvd", press, meshes)
        if shapes:
            self._write_pvd(folder / f"{self.sensor}_indenter.pvd", press, shapes)

    def _sample(self, press: int, step: int, displacement: np.ndarray) -> pyvista.UnstructuredGrid:
        pose = self.pose[press] if np.isfinite(self.pose[press]).all() else np.eye(4)
        points = (self.rest + displacement) @ pose[:3, :3].T + pose[:3, 3]
        mesh = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: self.tetrahedra}, points)
        mesh.point_data["displacement"] = displacement @ pose[:3, :3].T
        mesh.point_data.update(self.flags)
        for name in self.surface_outputs:
            values = np.full((len(points), *self.dataset.arrays[f"{self.sensor}/{name}"].shape[2:]), np.nan, np.float32)
            values[self.surface_vertices] = self.dataset.of_samples(f"{self.sensor}/{name}", press, int(step))
            mesh.point_data[f"{name}_Pa"] = values
        mesh.field_data["depth_mm"] = [MM_PER_M * self.offsets[press, step, 1]]
        mesh.field_data["force_N"] = (pose[:3, :3] @ self.force[press, step])[None]
        return mesh

    def _write_pvd(self, path: Path, press: int, files: Iterable[tuple[int, Path]]) -> None:
        root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
        collection = ElementTree.SubElement(root, "Collection")
        for step, file in files:
            name = file.relative_to(path.parent).as_posix()
            depth_mm = MM_PER_M * self.offsets[press, step, 1]
            time = f"{depth_mm:.9g}" if self.dataset.indenter_path.is_a_press else f"{step}"
            ElementTree.SubElement(collection, "DataSet", timestep=time, part="0", file=name)
        ElementTree.ElementTree(root).write(path, xml_declaration=True)
