"""Export to numpy arrays for training, for ``np.load(..., mmap_mode="r")``.

Arrays of samples have a row for each sample that is valid on all sensors.
"""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from simgen.dataset.exchange.selection import PressSelection, Track, vertex_flags
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import IN_NONE, SPLITS

OF_MESH = ("rest_positions", "tetrahedra", "surface_triangles")
OF_SAMPLE = {"force": "N", "moment": "N m"}


class _Folder:
    """Writes arrays into a folder and collects its index."""

    def __init__(self, folder: Path):
        self.folder, self.index = folder, {}

    def write(
        self, name: str, shape: tuple[int, ...], dtype: np.dtype, axes: str, unit: str, blocks: Iterable[np.ndarray]
    ) -> None:
        """Write an array block by block of rows, so that it never is in memory as a whole.

        A full disk is an error here; a memory-mapped file would end the process.
        """
        dtype, path = dtype.newbyteorder("<"), self.folder / f"{name}.npy"
        path.parent.mkdir(exist_ok=True)
        header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
        with open(path, "wb") as file:
            np.lib.format.write_array_header_1_0(file, header)
            for block in blocks:
                file.write(np.ascontiguousarray(block, dtype))
        self.index[f"{name}.npy"] = {"shape": shape, "dtype": dtype.name, "axes": axes, "unit": unit}

    def whole(self, name: str, values: np.ndarray, axes: str, unit: str = "") -> None:
        self.write(name, values.shape, values.dtype, axes, unit, [values])


def export_npy(selection: PressSelection, folder: Path, track: Track) -> None:
    """Write columns of the samples, mesh, displacements and forces of each sensor, and ``index.json``."""
    dataset, files = selection.dataset, _Folder(folder)
    row, step = np.nonzero(selection.paired)  # press by press, depths in order
    press = selection.presses[row]
    columns = {name: dataset[f"press/{name}"][press] for name in ("trajectory", "indenter", "split")}
    for name, values in {"press": press, **columns, "step": step}.items():
        files.whole(f"sample/{name}", values.astype(np.int32), "sample")
    files.whole("sample/depth", dataset["depth"][step], "sample", "m")
    if not dataset.indenter_path.is_a_press:
        files.whole("sample/offset", dataset.indenter_path.offsets_m[step], "sample, 3", "m")
        files.whole("sample/turn", dataset.indenter_path.turns_rad[step], "sample", "rad")
        files.whole("sample/leg", dataset.indenter_path.legs[step], "sample")
    for sensor in selection.sensors:
        mesh = {name: dataset[f"{sensor}/{name}"] for name in OF_MESH} | vertex_flags(dataset, sensor)
        for name, values in mesh.items():
            axes, unit = ("vertex, 3", "m") if name == "rest_positions" else ("", "")
            files.whole(f"{sensor}/{name}", values, axes or ("vertex" if values.ndim == 1 else "cell, corner"), unit)
        files.whole(f"{sensor}/depth", dataset.depths_of(sensor)[press, step], "sample", "m")
        for name, unit in OF_SAMPLE.items():
            files.whole(f"{sensor}/{name}", dataset[f"{sensor}/{name}"][press, step], "sample, 3", unit)
        for name, values in _surface_vertices(dataset, sensor).items():
            files.whole(name, values, "surface vertex")
        for output in dataset.job.optional_outputs(sensor):
            name = output.name
            array = dataset.arrays[f"{sensor}/{name}"]
            axes = ", ".join(["sample", *map(str, array.shape[1:])])
            if not output.is_read_by_sample:
                files.whole(f"{sensor}/{name}", dataset[f"{sensor}/{name}"][press, step], axes, array.unit)
                continue
            shape = (len(press), *array.shape[1:])
            blocks = (
                dataset.in_unit(f"{sensor}/{name}", int(selection.presses[each]))[selection.paired[each]]
                for each in np.unique(row)
            )
            files.write(f"{sensor}/{name}", shape, np.dtype(np.float32), axes, array.unit, blocks)
        shape = (len(press), len(mesh["rest_positions"]), 3)
        blocks = (
            dataset.displacement(sensor, int(selection.presses[each]))[selection.paired[each]]
            for each in track(np.unique(row), sensor)
        )
        files.write(f"{sensor}/displacement", shape, np.dtype(np.float32), "sample, vertex, 3", "m", blocks)
    about = {
        "samples": len(press),
        "sensors": selection.sensors,
        "indenters": dataset.indenters,
        "splits": {name: code for code, name in enumerate(SPLITS)} | {"none": IN_NONE},
        "frame": "vectors and positions of a sensor are in its own frame",
        "arrays": files.index,
        "job_hash": dataset.attributes["job_hash"],
        "job": dataset.attributes["job"],
        "code": dataset.attributes.get("code"),
    }
    (folder / "index.json").write_text(json.dumps(about, indent=1), encoding="utf-8")


def _surface_vertices(dataset: Dataset, sensor: str) -> dict[str, np.ndarray]:
    """Vertices of stress and traction, by path; empty in a dataset without these outputs."""
    name = f"{sensor}/surface_vertices"
    return {name: dataset[name]} if name in dataset.root else {}
