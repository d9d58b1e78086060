"""Safe reading of HDF5 files from other programs: each error is one line with file, key and what is expected."""

import os
from pathlib import Path

import h5py
import numpy as np

from simgen.errors import InputError, shown


def open_hdf5(path: Path) -> h5py.File:
    """Open a file for reading. Raises `InputError` if it is not HDF5."""
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise InputError(f"{path}: cannot be read as HDF5 ({' '.join(str(error).split())})") from None


def member_at(path: Path, file: h5py.File, key: str) -> h5py.Group | h5py.Dataset | None:
    """Find the group or dataset at a key; None if there is none.

    Raises `InputError` if it lies in another file, by an external link or by external or virtual storage: a file from
    elsewhere must not make us read other files of this machine.
    """
    found = file
    for name in filter(None, key.split("/")):
        if not isinstance(found, h5py.Group) or not found.id.links.exists(name.encode()):
            return None
        if found.id.links.get_info(name.encode()).type == h5py.h5l.TYPE_EXTERNAL:
            raise _elsewhere(path, key, os.fsdecode(found.id.links.get_val(name.encode())[0]))
        found = found.get(name)
    if found is not None and found.file.filename != file.filename:  # a soft link can lead through an external one
        raise _elsewhere(path, key, found.file.filename)
    if isinstance(found, h5py.Dataset) and (others := _storage(found) - {file.filename, "."}):
        raise _elsewhere(path, key, min(others))
    return found


def _storage(stored: h5py.Dataset) -> set[str]:
    """Names of the files, besides its own, that hold a dataset's values."""
    virtual = {source.file_name for source in stored.virtual_sources()} if stored.is_virtual else set()
    return virtual | {name for name, _, _ in stored.external or ()}


def _elsewhere(path: Path, key: str, other: str) -> InputError:
    return InputError(f"{path}: {key}: lies in another file, {shown(other, 200)}; allowed: what the file itself holds")


def group_at(path: Path, file: h5py.File, key: str) -> h5py.Group:
    """Find the group at a key. Raises `InputError` if there is none, and as `member_at`."""
    if not isinstance(found := member_at(path, file, key), h5py.Group):
        raise InputError(f"{path}: {key}: not there, expected a group")
    return found


def dataset_at(path: Path, file: h5py.File, key: str) -> h5py.Dataset:
    """Find the dataset at a key. Raises `InputError` if there is none, and as `member_at`."""
    if not isinstance(found := member_at(path, file, key), h5py.Dataset):
        raise InputError(f"{path}: {key}: not there, expected numbers")
    return found


def numbers(path: Path, stored: h5py.Dataset) -> np.ndarray:
    """Read all values of a dataset as float64. Raises `InputError` unless they are finite numbers."""
    try:
        values = stored[...].astype(float)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {stored.name}: {' '.join(str(error).split())}") from None
    if not np.isfinite(values).all():
        raise InputError(f"{path}: {stored.name}: values that are not finite numbers")
    return values
