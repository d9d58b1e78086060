"""Files and folders that are whole or not there, also after a power cut: written aside, flushed to disk, renamed."""

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

ROOM = 64 * 2**20  # bytes: more than HDF5 keeps in its caches, and than a sample and its mesh take


@dataclass(frozen=True)
class Aside:
    """A file that lies aside, flushed, until it is put in its place."""

    temporary: Path
    sha256: str


def write_aside(folder: Path, data: bytes) -> Aside:
    """A new file in the folder, on the disk when this returns."""
    temporary = folder / uuid.uuid4().hex
    with open(temporary, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    return Aside(temporary, hashlib.sha256(data).hexdigest())


def put_in_place(root: Path, files: Mapping[str, Aside]) -> None:
    """Rename files to these paths below the root, which is on the same disk; flush the folders that may be new."""
    for name, file in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(file.temporary, root / name)
    for folder in {parent for name in files for parent in Path(name).parents}:
        flush(root / folder)


def write_whole(file: Path, data: bytes) -> None:
    """Raises `InputError` if the file cannot be written; what was there before then stays."""
    with writing(file):
        put_in_place(file.parent, {file.name: write_aside(file.parent, data)})


def flush(path: Path) -> None:
    """What a file holds, or which files a folder has, is on the disk when this returns."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def flush_tree(folder: Path) -> None:
    """Flush a folder and all that is below it."""
    for path in folder.rglob("*"):
        flush(path)
    flush(folder)


def check_new(path: Path) -> None:
    """Raises `InputError` unless a path is free, or an empty folder."""
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise InputError(f"{path}: exists already; remove it, or choose another --output")


def check_room(folder: Path) -> None:
    """Raises `OSError` if the disk is all but full: before libraries write that would end the process if it were."""
    if shutil.disk_usage(folder).free < ROOM:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A folder aside, held by this process, which takes its place at ``path`` when the block ends without an error.

    Raises `FileExistsError` if a folder that is not empty is there by then.
    """
    with suppress(OSError):  # what cannot be removed is not in the way
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
