"""HDF5 files of others, read so that whatever is wrong with them is one line: the file, the key, what is expected."""

from pathlib import Path

import h5py
import numpy as np

from simgen.errors import InputError


def open_hdf5(path: Path) -> h5py.File:
    """The file, open for reading. Raises `InputError` if it is none of HDF5."""
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise InputError(f"{path}: cannot be read as HDF5 ({' '.join(str(error).split())})") from None


def group_at(path: Path, file: h5py.File, key: str) -> h5py.Group:
    if not isinstance(found := file.get(key), h5py.Group):
        raise InputError(f"{path}: {key}: not there, expected a group")
    return found


def dataset_at(path: Path, file: h5py.File, key: str) -> h5py.Dataset:
    if not isinstance(found := file.get(key), h5py.Dataset):
        raise InputError(f"{path}: {key}: not there, expected numbers")
    return found


def numbers(path: Path, stored: h5py.Dataset) -> np.ndarray:
    """All values of a dataset in float64. Raises `InputError` unless they are finite numbers."""
    try:
        values = stored[...].astype(float)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {stored.name}: {' '.join(str(error).split())}") from None
    if not np.isfinite(values).all():
        raise InputError(f"{path}: {stored.name}: values that are not finite numbers")
    return values
