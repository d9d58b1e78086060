"""Atomic writes of files and folders: written aside, flushed to disk, then renamed. They survive a power cut."""

import errno
import glob
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from simgen.dataset.folder_lock import locked_new, remove_abandoned
from simgen.errors import InputError, writing

ROOM = 64 * 2**20  # bytes: more than HDF5's caches, and more than a sample with its mesh


@dataclass(frozen=True)
class Aside:
    """A flushed file that waits to be put in place."""

    temporary: Path
    sha256: str


def write_aside(folder: Path, data: bytes) -> Aside:
    """Write a new file into the folder and flush it to disk."""
    temporary = folder / uuid.uuid4().hex
    with open(temporary, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    return Aside(temporary, hashlib.sha256(data).hexdigest())


def holds(file: Path, written: Aside) -> bool:
    """True if a file is there with the same content."""
    return file.is_file() and hashlib.sha256(file.read_bytes()).hexdigest() == written.sha256


def put_in_place(root: Path, files: Mapping[str, Aside]) -> None:
    """Rename files to paths below a root on the same disk, and flush their folders."""
    for name, file in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(file.temporary, root / name)
    for folder in {parent for name in files for parent in Path(name).parents}:
        flush(root / folder)


def write_whole(file: Path, data: bytes) -> None:
    """Write a file atomically. Raises `InputError` if it cannot be written; the old file then stays."""
    with writing(file):
        put_in_place(file.parent, {file.name: write_aside(file.parent, data)})


def flush(path: Path) -> None:
    """Flush a file's content, or a folder's list of files, to disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def flush_tree(folder: Path) -> None:
    """Flush a folder and everything below it."""
    for path in folder.rglob("*"):
        flush(path)
    flush(folder)


def check_new(path: Path) -> None:
    """Raise `InputError` unless a path is free or an empty folder."""
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise InputError(f"{path}: exists already; remove it, or choose another --output")


def check_room(folder: Path) -> None:
    """Raise `OSError` if the disk is nearly full: some libraries end the process when a write fails."""
    if shutil.disk_usage(folder).free < ROOM:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Make and lock a folder aside, and rename it to ``path`` when the block ends without an error.

    Raises `FileExistsError` if ``path`` has become a folder that is not empty.
    """
    with suppress(OSError):  # leftovers do no harm
        partial = path.parent.glob(f".{glob.escape(path.name)}.{'[0-9a-f]' * 32}.partial")
        remove_abandoned(folder for folder in partial if folder.is_dir())
    with locked_new(lambda text: path.with_name(f".{path.name}.{text}.partial")) as folder:
        try:
            yield folder
            flush_tree(folder)
            os.rename(folder, path)
        except BaseException as error:
            shutil.rmtree(folder, ignore_errors=True)
            if isinstance(error, OSError) and error.errno == errno.ENOTEMPTY:
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from None
            raise
    flush(path.parent)
