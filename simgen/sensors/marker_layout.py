"""Layout of printed dots: the sensor's own markers, a grid, or the points of a CSV file."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from simgen.config.csv_files import csv_lines, csv_number
from simgen.config.strict_section import section_from_dict
from simgen.errors import InputError, shown
from simgen.sensors.marker_schema import MarkerGrid
from simgen.sensors.pinhole import Pinhole, placed_camera
from simgen.sensors.sensor_schema import SensorDescription
from simgen.units import MM

OWN = "own"  # the markers of the sensor.yaml
GRID = re.compile(r"(\d{1,9})x(\d{1,9})@(\d+\.?\d*|\.\d+)")
COLUMNS = ("x_mm", "y_mm", "z_mm")
MOST = 10_000  # dots of a file; as many as the largest grid has
LARGEST_DOT_MM = 100.0


@dataclass(frozen=True)
class MarkerLayout:
    """Dots before they are moved onto the coat.

    points : (marker, 3) m, in the sensor's frame
    camera : the sensor's camera ``default``, of any size
    along_axis : True moves the points along the camera's axis, False to the nearest points of the coat
    diameter : m
    darkness : share of the light that a dot takes away, above 0, to 1 (black)
    names : the file and line, or the grid's row and column, of each dot, for messages
    """

    points: np.ndarray
    camera: Pinhole
    along_axis: bool
    diameter: float
    darkness: float
    names: list[str]

    @classmethod
    def of(cls, choice: str, description: SensorDescription, folder: Path, diameter_mm: float | None = None) -> Self:
        """Read the layout that a text names: ``own``, ROWSxCOLUMNS@PITCH in mm such as ``7x9@2.05``, or a CSV file.

        description : of the sensor, whose ``sensor.yaml`` lies in ``folder``
        diameter_mm : by default that of the sensor's own markers

        Raises `InputError` for another text, a bad file, a sensor without own markers or without a camera, and a
        missing diameter, one out of range, or one that exceeds the pitch of a grid.
        """
        camera = Pinhole.of(placed_camera(description, folder))
        own, option, file = description.markers, f"--markers {shown(choice)}", folder / "sensor.yaml"
        if choice == OWN and own is None:
            raise InputError(f"{option}: {file} has no markers; allowed: ROWSxCOLUMNS@PITCH, or a CSV file")
        grid = own.grid if choice == OWN else _grid(choice)
        is_file = choice == OWN or choice.lower().endswith(".csv") or Path(choice).is_file()
        if grid is None and not is_file:
            raise InputError(f"{option}: allowed: {OWN}, ROWSxCOLUMNS@PITCH in mm such as 7x9@2.05, or a CSV file with "
                             f"the columns {','.join(COLUMNS)}")  # fmt: skip
        if diameter_mm is None and own is None:
            raise InputError(f"{option}: --dot-mm is missing, and {file} has no markers; allowed: a diameter in mm")
        if diameter_mm is not None and not 0.0 < diameter_mm <= LARGEST_DOT_MM:
            raise InputError(f"--dot-mm {diameter_mm:g}: allowed: above 0, to {LARGEST_DOT_MM:g} mm")
        diameter_mm = own.diameter_mm if diameter_mm is None else diameter_mm
        if grid is not None:
            source = f"{file}: markers.grid" if choice == OWN else option
            if diameter_mm > grid.pitch_mm:
                raise InputError(f"{source}: dots of {diameter_mm:g} mm overlap at a pitch of {grid.pitch_mm:g} mm; "
                                 "allowed: diameters up to the pitch")  # fmt: skip
            points, names = grid_points(grid, camera, source)
        else:
            points, names = read_points(folder / own.file if choice == OWN else Path(choice))
        return cls(points, camera, grid is not None, MM * diameter_mm, own.darkness if own else 1.0, names)


def _grid(choice: str) -> MarkerGrid | None:
    """The grid that a text describes; None for another text. Raises `InputError` for a number out of range."""
    match = GRID.fullmatch(choice)
    if match is None:
        return None
    plain = {"rows": int(match[1]), "columns": int(match[2]), "pitch_mm": float(match[3])}
    return section_from_dict(MarkerGrid, plain, f"--markers {shown(choice)}")


def grid_points(grid: MarkerGrid, camera: Pinhole, source: str) -> tuple[np.ndarray, list[str]]:
    """Points (marker, 3) m of a grid, row by row from the image's upper left, and their names."""
    right, up, _ = camera.axes
    center = camera.position if grid.center_mm is None else MM * np.array(grid.center_mm)
    row, column = (each.ravel() for each in np.indices((grid.rows, grid.columns)))
    x, y = column - 0.5 * (grid.columns - 1), 0.5 * (grid.rows - 1) - row
    points = center + MM * grid.pitch_mm * (x[:, None] * right + y[:, None] * up)
    names = [f"{source}: row {r + 1}, column {c + 1}" for r, c in zip(row, column, strict=True)]
    return points, names


def read_points(file: Path) -> tuple[np.ndarray, list[str]]:
    """Read points (marker, 3) m from a CSV file with `COLUMNS`, and their names. Raises `InputError`."""
    points, names = [], []
    for where, line in csv_lines(file, COLUMNS):
        names.append(where)
        points.append([csv_number(line[name], f"{where}: {name}", "mm") for name in COLUMNS])
    if not 0 < len(points) <= MOST:
        raise InputError(f"{file}: {len(points)} points; allowed: 1 to {MOST}")
    return MM * np.array(points), names
