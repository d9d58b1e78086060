"""Files that are there whole or not at all, also after a power cut: written aside, flushed to disk, then renamed."""

import hashlib
import os
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


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
