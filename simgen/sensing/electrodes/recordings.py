"""Recordings of a real BioTac's electrodes in the layout in which they are published, read and checked.

HDF5, as the ACROSS framework (wzaielamri/across_framework) reads it. A recording::

    electrode_vals/data  (n, 19)          the electrodes, in the unit of the file
    contact_loc/data     (n, 3)           where the indenter touches, in the unit and the frame of the file
    force_vec/data       (n, 3)           N, on the sensor, in the frame of the file
    indenter_type/data   (n,) or (n, 1)   a number that stands for the indenter; may be missing

and, in a file beside it or in the same one, the same samples simulated again; each may be missing::

    nodal_res            (n, vertex, 3)   m, of the mesh's vertices
    force_res            (n, 3)           N, on the sensor
    mesh_max_dist        (n,) or (n, 1)   m, depth of the press

Each may be a dataset of that name, or a group with a dataset ``data``.
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
LARGEST_TYPE = 2**31  # of an indenter's number


@dataclass(frozen=True)
class Recordings:
    """Samples of one sensor, in the order in which they were recorded; None where the files do not say.

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
    """The recordings of a file, with what ``simulated`` holds of them simulated again: its meshes at least.

    By default that is the same file, which need not hold any. Without ``meshes`` nothing simulated is read: a million
    meshes are more than a machine's memory.

    Raises `InputError` of one line, with the file and the key, if a file is none of HDF5, or if what it holds is
    missing, of another shape, or no finite numbers.
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
    """The arrays of a layout by key, all of ``count`` samples, or of as many as the first has."""
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
    fits = len(found) == len(wanted) and all(
        b in (None, a) and a > 0 for a, b in zip(found, wanted, strict=True)
    )
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
