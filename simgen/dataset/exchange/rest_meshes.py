"""Rest meshes of the sensors in result files, as the user gives them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from simgen.errors import InputError
from simgen.geometry.mesh_files import read_mesh
from simgen.geometry.tetrahedra import boundary_triangles
from simgen.units import MM


@dataclass(frozen=True)
class RestMesh:
    """A sensor at rest.

    arrays : mesh arrays of a dataset's plan; ``held`` and ``touchable`` only if the file has them
    origin : (3,) m, origin of the mesh in the coordinates of the result files
    """

    path: Path
    arrays: Mapping[str, np.ndarray]
    origin: np.ndarray

    @property
    def in_files(self) -> np.ndarray:
        """Rest positions (vertex, 3) m in the coordinates of the result files."""
        return self.arrays["rest_positions"] + self.origin

    @property
    def rounding(self) -> float:
        """Last place of the largest coordinate in float32, m: rounding can move held vertices by it."""
        return float(np.spacing(np.float32(np.abs(self.in_files).max())))


def read_rest_meshes(meshes: Sequence[str], origins_mm: Sequence[str] = ()) -> dict[str, RestMesh]:
    """Read ``SENSOR=FILE`` (.vtu .tet .msh .mesh, tetrahedra, m) with origins ``SENSOR=X,Y,Z`` (mm, default 0,0,0).

    Raises `InputError` for other text, a file without tetrahedra, and an origin without a mesh.
    """
    paths, origins = _by_sensor("--mesh", "FILE", meshes), _by_sensor("--origin-mm", "X,Y,Z", origins_mm)
    if not paths:
        raise InputError("--mesh: missing; give SENSOR=FILE for each sensor")
    for sensor in origins:
        if sensor not in paths:
            raise InputError(f"--origin-mm {sensor}={origins[sensor]}: sensor {sensor!r} has no --mesh")
    return {
        sensor: RestMesh(Path(path), _arrays(sensor, Path(path)), _origin(sensor, origins.get(sensor, "0,0,0")))
        for sensor, path in paths.items()
    }


def _by_sensor(option: str, value: str, texts: Sequence[str]) -> dict[str, str]:
    given: dict[str, str] = {}
    for text in texts:
        sensor, _, rest = text.partition("=")
        if not (sensor and rest):
            raise InputError(f"{option} {text!r}: write it as SENSOR={value}")
        if sensor in given:
            raise InputError(f"{option} {text!r}: sensor {sensor!r} has one already")
        given[sensor] = rest
    return given


def _origin(sensor: str, text: str) -> np.ndarray:
    try:
        x, y, z = (float(word) for word in text.split(","))
    except ValueError:
        x = y = z = np.nan
    if not np.isfinite([x, y, z]).all():
        raise InputError(f"--origin-mm {sensor}={text}: write it as SENSOR=X,Y,Z, such as biotac=0,50,0")
    return MM * np.array([x, y, z])


def _arrays(sensor: str, path: Path) -> dict[str, np.ndarray]:
    _, vertices, tetrahedra = read_mesh(path, "m")
    if tetrahedra is None:
        raise InputError(f"--mesh {sensor}={path}: holds no tetrahedra")
    surface = boundary_triangles(tetrahedra)[0].astype(np.int32)
    arrays = {"rest_positions": vertices, "tetrahedra": tetrahedra, "surface_triangles": surface}
    flags = meshio.read(path).point_data if path.suffix == ".vtu" else {}
    for key in flags.keys() & {"held", "touchable"}:
        if flags[key].shape != (len(vertices),):
            raise InputError(f"--mesh {sensor}={path}: {key}: shape {flags[key].shape}, expected ({len(vertices)},)")
        arrays[key] = flags[key].astype(bool)
    return arrays
