"""Folders with something wrong in them, for test_bad_input: what to write, by path, or a function that writes it."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import trimesh
import yaml
import zarr

from simgen.geometry.tetrahedra import sizing_grid

Files = dict[str, str | bytes | None]  # None is a folder

JOB = {
    "name": "tiny",
    "sensors": {"digit": {"model": "digit", "mesh": "coarse"}},
    "indenters": ["sphere_7mm"],
    "trajectories": {"count": 1},
    "depths_mm": {"first": 0.1, "last": 0.2, "count": 2},
}
SOLID = {"youngs_modulus_pa": 539e3, "poisson_ratio": 0.499, "friction": 0.78}
SLAB = {
    "name": "slab",
    "gel": {"mesh": {"file": "slab.stl", "unit": "mm"}},
    "held": {"back": {"plane": {"axis": "y", "at_mm": 2.0}}},
    "meshes": {"default": {"edge_length_mm": 2.0}},
    "materials": {"solid": SOLID},
}
BOX = trimesh.creation.box([20.0, 4.0, 20.0])
POINTS, TETRAHEDRA = sizing_grid(np.array([-10.0, -2.0, -10.0]), np.array([10.0, 2.0, 10.0]), 4.0)  # mm


def job(**changes) -> Files:
    """A job file with other values at its top."""
    return {"job.yaml": yaml.safe_dump(JOB | changes, sort_keys=False)}


def text(added: str = "", whole: str | bytes | None = None) -> Files:
    """A job file with some more text, or of other text alone."""
    return {"job.yaml": job()["job.yaml"] + added if whole is None else whole}


def box(kind: str = "stl", scale: float = 1.0, faces: slice = slice(None)) -> bytes:
    """A mesh file of the slab's body, or of some of its faces."""
    mesh = BOX.copy().apply_scale(scale)
    mesh.update_faces(np.arange(12)[faces])
    data = mesh.export(file_type=kind)
    return data.encode() if isinstance(data, str) else data


def sensor(mesh: bytes | str | None = None, file: str = "slab.stl", **changes) -> Files:
    """A sensor's folder ``s``, its mesh file and other values at the top of its sensor.yaml."""
    about = SLAB | {"gel": {"mesh": {"file": file, "unit": "mm"}}} | changes
    return {"s/sensor.yaml": yaml.safe_dump(about), f"s/{file}": box() if mesh is None else mesh}


def tet(points=POINTS, tetrahedra=TETRAHEDRA) -> str:
    rows = ["v {} {} {}".format(*point) for point in points] + ["t {} {} {} {}".format(*each) for each in tetrahedra]
    return "\n".join(rows)


def written(suffix: str, **options) -> Callable[[Path], bytes]:
    """A file of tetrahedra as meshio writes it."""

    def write(folder: Path) -> bytes:
        meshio.Mesh(POINTS, [("tetra", TETRAHEDRA)]).write(folder / f"m{suffix}", **options)
        data = (folder / f"m{suffix}").read_bytes()
        (folder / f"m{suffix}").unlink()
        return data

    return write


def truncated(suffix: str, **options) -> Callable[[Path], None]:
    """A sensor whose mesh file ends in the middle."""

    def prepare(folder: Path) -> None:
        write(folder, sensor(written(suffix, **options)(folder)[:-700], f"m{suffix}"))

    return prepare


def write(folder: Path, files: Files) -> None:
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if data is None:
            path.mkdir()
        else:
            path.write_bytes(data.encode() if isinstance(data, str) else data)


def attributes(**changes) -> Callable[[Path], None]:
    """A dataset with other attributes; None leaves one out."""

    def change(dataset: Path) -> None:
        file = dataset / "zarr.json"
        about = json.loads(file.read_text())
        about["attributes"] = {k: v for k, v in (about["attributes"] | changes).items() if v is not None}
        file.write_text(json.dumps(about))

    return change


def content(name: str, data: bytes | str | None) -> Callable[[Path], None]:
    """A dataset with another file, or without it, or without a folder."""

    def change(dataset: Path) -> None:
        path = dataset / name
        if data is None:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        else:
            path.write_bytes(data.encode() if isinstance(data, str) else data)

    return change


def array(name: str, values: np.ndarray | None) -> Callable[[Path], None]:
    """A dataset with another array, or without it, and with checksums that fit."""

    def change(dataset: Path) -> None:
        root = zarr.open_group(dataset, mode="r+", use_consolidated=False)
        if values is None:
            del root[name]
        elif (stored := root[name]).shape == values.shape and stored.dtype == values.dtype:
            stored[...] = values  # into the files that there are
        else:
            root.create_array(name, data=values, overwrite=True)
        zarr.consolidate_metadata(dataset)
        for manifest in (dataset / "manifest").glob("*.json"):
            about = json.loads(manifest.read_text())
            files = [file for file in about["sha256"] if (dataset / file).is_file()]
            about["sha256"] = {f: hashlib.sha256((dataset / f).read_bytes()).hexdigest() for f in files}
            manifest.write_text(json.dumps(about))

    return change
