"""Types of values that sections of a ``sensor.yaml`` share."""

import os
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from simgen.errors import shown

LARGEST = 1e4  # mm or degrees; ten metres
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, le=LARGEST, allow_inf_nan=False)]
Vector = tuple[Number, Number, Number]
Interval = tuple[Number, Number]


def _direction(vector: Vector) -> Vector:
    if not 1e-3 <= np.linalg.norm(vector) <= 1e3:
        raise ValueError(f"{list(vector)}: a direction must have a length of 1e-3 to 1e3")
    return vector


def _inside(file: str) -> str:
    if os.path.isabs(file) or Path(os.path.normpath(file)).parts[:1] == ("..",):
        allowed_files = "a file in the folder or below it"
        raise ValueError(f"{shown(repr(file))} leads out of the sensor's folder; allowed: {allowed_files}")
    return file


Direction = Annotated[Vector, AfterValidator(_direction)]
OwnFile = Annotated[str, AfterValidator(_inside)]  # in the folder of the sensor.yaml, or below it
