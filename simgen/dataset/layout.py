"""Checks of a dataset's arrays: shapes, types, ranges of indices, finite numbers, invertible poses.

They find datasets that somebody else, or a bad disk, has changed.
"""

import numpy as np

from simgen.dataset.reader import Dataset
from simgen.dataset.splits import IN_NONE, SPLITS
from simgen.dataset.stored_arrays import REST_DEPTH, path_arrays
from simgen.errors import InputError

REFUSED = ("refused/points", "refused/normals")


def faults(dataset: Dataset) -> dict[str, str]:
    """Find faulty arrays: a description of the fault by name. Values of arrays that tasks write are not read."""
    found = {}
    for name, (shape, kind) in _expected(dataset).items():
        try:
            array = dataset.array(name)
        except InputError as error:
            found[name] = str(error)
            continue
        if array.shape != shape or not np.issubdtype(array.dtype, kind):
            wanted = kind if isinstance(kind, str) else kind.__name__
            found[name] = f"{array.dtype} {array.shape}; allowed: {wanted} {shape}"
    if not found:
        found |= _faulty_values(dataset)
    return found


def checked(dataset: Dataset) -> Dataset:
    """Return the dataset itself. Raises `InputError` if `faults` finds any."""
    for name, fault in faults(dataset).items():
        raise InputError(f"{dataset.path}/{name}: {fault}; `simgen check` says more")
    return dataset


def _expected(dataset: Dataset) -> dict[str, tuple[tuple[int, ...], str | type]]:
    """Shape and type (or kind of types) of every array, by name."""
    presses, integer, real = dataset.presses, np.integer, np.floating
    expected = {
        **{name: (values.shape, np.integer if values.dtype.kind == "i" else real)
           for name, values in path_arrays(dataset.indenter_path).items()},
        "press/trajectory": ((presses,), integer),
        "press/indenter": ((presses,), integer),
        "press/split": ((presses,), integer),
        "press/contact_pose": ((presses, 4, 4), real),
        "press/contact_normal": ((presses, 3), real),
    }
    for name in REFUSED:
        if name in dataset.root:
            expected[name] = ((_length(dataset, name), 3), real)
    for sensor in dataset.sensors:
        vertices = dataset.array(f"{sensor}/rest_positions").shape[0]
        expected |= {
            f"{sensor}/rest_positions": ((vertices, 3), real),
            f"{sensor}/tetrahedra": ((_length(dataset, f"{sensor}/tetrahedra"), 4), integer),
            f"{sensor}/surface_triangles": ((_length(dataset, f"{sensor}/surface_triangles"), 3), integer),
            f"{sensor}/held": ((vertices,), np.bool_),
            f"{sensor}/touchable": ((vertices,), np.bool_),
            f"{sensor}/pose": ((presses, 4, 4), real),
        }
        if dataset.job.stops_early:
            expected[f"{sensor}/pressable_steps"] = ((presses,), integer)
        if dataset.job.surface_outputs(sensor):
            name = f"{sensor}/surface_vertices"
            expected[name] = ((_length(dataset, name),), integer)
        if dataset.job.has_images(sensor):
            name = f"{sensor}/{REST_DEPTH}"
            expected[name] = (dataset.array(name).shape, real)
    if dataset.imported:  # it has no contacts, and flags of vertices only if its mesh had some
        optional = ("contact_pose", "contact_normal", "held", "touchable")
        expected = {name: each for name, each in expected.items()
                    if name.partition("/")[2] not in optional or name in dataset.root}  # fmt: skip
    written = {name: ((presses, *array.shape), array.dtype) for name, array in dataset.arrays.items()}
    return expected | written


def _length(dataset: Dataset, name: str) -> int:
    return (*dataset.array(name).shape, 0)[0]


def _faulty_values(dataset: Dataset) -> dict[str, str]:
    """Find indices out of range, numbers that are not finite, poses that cannot be inverted."""
    job, found = dataset.job, {}
    last = np.iinfo(np.int32).max if dataset.imported else job.trajectories.count - 1  # files number as they like
    bounds = {
        "press/trajectory": (0, last),
        "press/indenter": (0, len(job.indenters) - 1),
        "press/split": (IN_NONE, len(SPLITS) - 1),
    }
    finite, poses = [*path_arrays(dataset.indenter_path), *(name for name in REFUSED if name in dataset.root)], []
    if not dataset.imported:
        finite.append("press/contact_normal")
        poses.append("press/contact_pose")
    for sensor in dataset.sensors:
        last = dataset.array(f"{sensor}/rest_positions").shape[0] - 1
        indices = ("tetrahedra", "surface_triangles", "surface_vertices")
        bounds |= {f"{sensor}/{key}": (0, last) for key in indices if f"{sensor}/{key}" in dataset.root}
        if job.stops_early:
            bounds[f"{sensor}/pressable_steps"] = (0, len(dataset.indenter_path))
        finite.append(f"{sensor}/rest_positions")
        poses += [] if dataset.imported else [f"{sensor}/pose"]  # imported files may lack poses
    for name, (low, high) in bounds.items():
        values = dataset[name]
        if values.size and (values.min() < low or values.max() > high):
            found[name] = f"{values.min()} to {values.max()}; allowed: {low} to {high}"
    for name in (*finite, *poses):
        if not np.isfinite(values := dataset[name]).all():
            found[name] = "values that are not finite numbers"
        elif name in poses and (np.linalg.matrix_rank(values) < 4).any():
            found[name] = "matrices that cannot be inverted"
    return found
