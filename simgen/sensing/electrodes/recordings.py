"""Recordings of a real BioTac's electrodes: reads and checks the published HDF5 layout.

The ACROSS framework (wzaielamri/across_framework) reads this layout. A recording::

    electrode_vals/data  (n, 19)          electrode readings, in the unit of the file
    contact_loc/data     (n, 3)           contact point, in the unit and the frame of the file
    force_vec/data       (n, 3)           N, on the sensor, in the frame of the file
    indenter_type/data   (n,) or (n, 1)   number of the indenter; optional

The same file or a second one can hold simulations of the same samples. Each array is optional::

    nodal_res            (n, vertex, 3)   m, vertices of the mesh
    force_res            (n, 3)           N, on the sensor
    mesh_max_dist        (n,) or (n, 1)   m, depth of the press

Each name is a dataset, or a group with a dataset ``data``.
"""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from simgen.config.parsing import parsing
from simgen.dataset.hdf5_files import dataset_at, member_at, numbers, open_hdf5
from simgen.errors import InputError

ELECTRODES = 19
RECORDED = {"electrode_vals": (ELECTRODES,), "contact_loc": (3,), "force_vec": (3,), "indenter_type": ()}
SIMULATED = {"nodal_res": (None, 3), "force_res": (3,), "mesh_max_dist": ()}
LARGEST_TYPE = 2**31  # largest number of an indenter


@dataclass(frozen=True)
class Recordings:
    """Samples of one sensor, in the order of the recording; None for what the files lack.

    signals : (n, 19), in the unit of the file
    contact : (n, 3), in the unit and the frame of the file
    force : (n, 3) N, on the sensor
    indenter : (n,) int64, the numbers of the file
    simulated_mesh : (n, vertex, 3) m, as the file stores it
    simulated_force : (n, 3) N
    simulated_depth : (n,) m
    """

    signals: np.ndarray
    contact: np.ndarray
    force: np.ndarray
    indenter: np.ndarray | None = None
    simulated_mesh: np.ndarray | None = None
    simulated_force: np.ndarray | None = None
    simulated_depth: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.signals)


def read_recordings(path: str | Path, simulated: str | Path | None = None, *, meshes: bool = True) -> Recordings:
    """Read the recordings of a file and their simulations.

    simulated : file with the simulations, meshes at least; by default ``path``, which need not hold any
    meshes : False reads no simulations; a million meshes do not fit into memory

    Raises `InputError`, naming file and key, if a file is not HDF5, or if an array is missing, of another shape or not
    finite.
    """
    path = Path(path)
    beside = path if simulated is None else Path(simulated)
    found = _read(path, RECORDED, {"indenter_type"})
    count = len(found["electrode_vals"])
    needed = {"nodal_res"} if simulated else set()
    found |= _read(beside, SIMULATED, {*SIMULATED} - needed, count) if meshes else dict.fromkeys(SIMULATED)
    return Recordings(
        signals=found["electrode_vals"],
        contact=found["contact_loc"],
        force=found["force_vec"],
        indenter=_whole(path, found["indenter_type"]),
        simulated_mesh=found["nodal_res"],
        simulated_force=found["force_res"],
        simulated_depth=found["mesh_max_dist"],
    )


def _read(
    path: Path, layout: dict[str, tuple], optional: set[str], count: int | None = None
) -> dict[str, np.ndarray | None]:
    """Arrays of a layout by key, all of ``count`` samples; by default of as many as the first array."""
    found = {}
    with parsing(path, "HDF5"), open_hdf5(path) as file:
        for key, shape in layout.items():
            member = member_at(path, file, key)
            if key in optional and member is None:
                found[key] = None
                continue
            stored = dataset_at(path, file, f"{key}/data" if isinstance(member, h5py.Group) else key)
            _check_shape(path, stored, count, shape)
            count = stored.shape[0]
            values = numbers(path, stored)
            found[key] = values if shape else values.reshape(count)
    return found


def _check_shape(path: Path, stored: h5py.Dataset, count: int | None, shape: tuple) -> None:
    wanted = (count, *shape)
    found = stored.shape or ()
    if not shape and len(found) == 2 and found[1] == 1:  # a column
        found = found[:1]
    fits = len(found) == len(wanted) and all(b in (None, a) and a > 0 for a, b in zip(found, wanted, strict=True))
    if not fits:
        names = [str(size or name) for size, name in zip(wanted, ("n", "vertex", "3"), strict=False)]
        allowed = f"({', '.join(names)}{',' * (len(names) == 1)})"
        raise InputError(f"{path}: {stored.name}: shape {stored.shape}; allowed: {allowed}")


def _whole(path: Path, types: np.ndarray | None) -> np.ndarray | None:
    if types is None:
        return None
    bad = (types != np.rint(types)) | (np.abs(types) > LARGEST_TYPE)
    if bad.any():
        raise InputError(f"{path}: indenter_type: {types[bad][0]:g}; allowed: whole numbers")
    return types.astype(np.int64)
