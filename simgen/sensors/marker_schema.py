"""The section ``markers`` of a ``sensor.yaml``: dots that are printed on the gel's coat."""

from typing import Annotated

from pydantic import Field, model_validator

from simgen.config.allowed_values import allowed
from simgen.config.strict_section import StrictSection
from simgen.sensors.section_types import OwnFile, Positive, Vector

Count = Annotated[int, Field(ge=1, le=100)]


class MarkerGrid(StrictSection):
    """Dots in a plane across the axis of the camera ``default``. Each is moved along the axis onto the coat.

    Rows go along the camera's right, columns along its up.
    """

    rows: Count
    columns: Count
    pitch_mm: Positive  # from middle to middle, both ways
    center_mm: Vector | None = None  # of the grid; by default on the camera's axis


class MarkerSettings(StrictSection):
    """Dots of one size, in a grid or at the points of a CSV file ``x_mm,y_mm,z_mm``."""

    grid: MarkerGrid | None = None
    file: OwnFile | None = None
    diameter_mm: Positive
    darkness: Annotated[float, Field(gt=0.0, le=1.0, **allowed("above 0, to 1 (black)"))] = 1.0

    @model_validator(mode="after")
    def _grid_or_file(self):
        if (self.grid is None) == (self.file is None):
            found = "none" if self.grid is None else "both"
            raise ValueError(f"exactly one of grid, file is needed, found {found}")
        return self
