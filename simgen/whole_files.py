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
        handle = os.open(root / folder, os.O_RDONLY)
        os.fsync(handle)
        os.close(handle)
