"""Built shapes of sensors in the user's cache. Building one takes up to a second, in each process that presses."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np
import scipy
import trimesh

from simgen.config.resources import PACKAGE
from simgen.geometry.curved_tetrahedra import LabelledSurface
from simgen.geometry.mesh_files import cache_folder

BUILDERS = ("geometry", "sensors")  # folders with the code that builds shapes


class BuiltShape(NamedTuple):
    """What `simgen.sensors.sensor_geometry` builds from a ``sensor.yaml``; see `SensorGeometry`."""

    plain: trimesh.Trimesh
    true: LabelledSurface
    held_regions: dict[str, np.ndarray]
    own_vertices: np.ndarray | None
    own_tetrahedra: np.ndarray | None
    core: trimesh.Trimesh | None


def cached(source: str, build: Callable[[], BuiltShape]) -> BuiltShape:
    """The shape of this ``source`` in the user's cache, or else ``build()``, which is then cached.

    A shape that other code or other packages have built counts as missing. So does a file that cannot be read. A folder
    that cannot be written does no harm.
    """
    path = cache_folder() / "shapes" / f"{source}.npz"
    arrays = _read(path)
    if arrays is None:
        arrays = _arrays(build())
        with suppress(OSError):
            _write(path, arrays)
    return _shape(arrays)  # of the same arrays in both cases


@cache
def _builder() -> str:
    """Hash of the code that builds shapes, and versions of its packages."""
    digest = hashlib.sha256(f"{np.__version__} {scipy.__version__} {trimesh.__version__}".encode())
    for folder in BUILDERS:
        for file in sorted((PACKAGE / folder).glob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _read(path: Path) -> dict[str, np.ndarray] | None:
    try:
        with np.load(path) as file:
            if str(file["builder"]) != _builder():
                return None
            return {name: file[name] for name in file.files if name != "builder"}
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None


def _write(path: Path, arrays: dict[str, np.ndarray]):
    """Write a shape. The file is replaced in one step: other processes may read or write it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
        np.savez(file, builder=_builder(), **arrays)
    os.replace(file.name, path)


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
