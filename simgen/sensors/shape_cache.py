"""Built shapes of sensors in the user's cache. Building one takes up to a second, in each process that presses."""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np
import scipy
import trimesh

from simgen.config.resources import PACKAGE
from simgen.geometry.curved_tetrahedra import LabelledSurface
from simgen.geometry.mesh_files import cache_folder

BUILDERS = ("config", "geometry", "sensors", "units.py")  # code that builds shapes
OLD_S = 86_400.0  # age from which an unfinished file counts as left by a killed process


class BuiltShape(NamedTuple):
    """Shape that is built from a ``sensor.yaml``; `sensor_geometry.SensorGeometry` says what its fields are."""

    plain: trimesh.Trimesh
    true: LabelledSurface
    held_regions: dict[str, np.ndarray]
    own_vertices: np.ndarray | None
    own_tetrahedra: np.ndarray | None
    core: trimesh.Trimesh | None


def cached(source: str, build: Callable[[], BuiltShape], is_current: Callable[[], bool]) -> BuiltShape:
    """The shape of this ``source`` in the user's cache, or else ``build()``, which is then cached.

    It is not cached if ``is_current()`` is false after the build, because a file has changed meanwhile. A shape that
    other code or other packages have built counts as missing. So does a broken file. A folder that cannot be written
    does no harm.
    """
    path = cache_folder() / "shapes" / f"{source}.npz"
    if (found := _read(path)) is not None:
        return found
    arrays = _arrays(build())
    with suppress(OSError):
        if is_current():
            _write(path, arrays)
    return _shape(arrays)  # the shape from the cache has the same arrays


def _builder() -> str:
    """Hash of the code that builds shapes, and versions of its packages."""
    versions = (np.__version__, scipy.__version__, trimesh.__version__, meshio.__version__)
    digest = hashlib.sha256(" ".join(versions).encode())
    for place in BUILDERS:
        for file in sorted((PACKAGE / place).glob("*.py")) or [PACKAGE / place]:
            digest.update(file.read_bytes())
    return digest.hexdigest()


BUILDER = _builder()  # of the loaded code: files may change later


def _read(path: Path) -> BuiltShape | None:
    try:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        if str(arrays.pop("builder")) != BUILDER or sorted(arrays.pop("names")) != sorted(arrays):
            return None
        return _shape(arrays)
    except Exception:  # a broken file raises many kinds
        return None


def _write(path: Path, arrays: dict[str, np.ndarray]):
    """Write a shape. The file is replaced in one step: other processes may read or write it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for left in path.parent.glob("*.tmp"):
        if time.time() - left.stat().st_mtime > OLD_S:
            left.unlink()
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
        try:
            np.savez(file, builder=BUILDER, names=list(arrays), **arrays)
            file.flush()
            os.chmod(file.name, 0o644)  # other users may share the cache
            os.replace(file.name, path)
        except BaseException:
            os.unlink(file.name)
            raise


def _arrays(shape: BuiltShape) -> dict[str, np.ndarray]:
    arrays = {
        "region": shape.true.region,
        "held_names": np.array(list(shape.held_regions), dtype=str),
        "held": np.array(list(shape.held_regions.values()), dtype=bool).reshape(-1, len(shape.true.region)),
    }
    for name, surface in (("plain", shape.plain), ("true", shape.true.surface), ("core", shape.core)):
        if surface is not None:
            arrays |= {f"{name}_vertices": np.asarray(surface.vertices), f"{name}_faces": np.asarray(surface.faces)}
    if shape.own_tetrahedra is not None:
        arrays |= {"own_vertices": shape.own_vertices, "own_tetrahedra": shape.own_tetrahedra}
    return arrays


def _shape(arrays: dict[str, np.ndarray]) -> BuiltShape:
    plain, true, core = (
        trimesh.Trimesh(arrays[f"{name}_vertices"], arrays[f"{name}_faces"], process=False)
        if f"{name}_faces" in arrays else None
        for name in ("plain", "true", "core")
    )  # fmt: skip
    return BuiltShape(
        plain,
        LabelledSurface(true, arrays["region"]),
        dict(zip(arrays["held_names"].tolist(), arrays["held"], strict=True)),
        arrays.get("own_vertices"),
        arrays.get("own_tetrahedra"),
        core,
    )
