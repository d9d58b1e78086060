"""The arrays of a dataset that follow from its job: shapes, types and storage."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from simgen.config.indenter_path import IndenterPath
from simgen.config.job_schema import Job
from simgen.config.outputs import NOT_REACHED, PIXEL_COLUMN, PIXEL_ROW, SURFACE_VERTEX, VERTEX

REST_DEPTH = "height_map_depth"  # array of a sensor with height maps


@dataclass(frozen=True)
class Array:
    """One array that tasks write: its shape without the press axis, and its storage."""

    shape: tuple[int, ...]
    dtype: str
    about: str
    unit: str = ""
    chunk: tuple[int, ...] | None = None  # what training reads at once; by default a whole press
    attributes: dict[str, float] = field(default_factory=dict)

    @property
    def fill(self) -> float | int:
        return {"float32": np.nan, "float64": np.nan, "int16": NOT_REACHED}.get(self.dtype, -1)


def written_arrays(job: Job, lengths: Mapping[str, Mapping[str, int]]) -> dict[str, Array]:
    """The arrays that tasks write, by path.

    lengths : by sensor, the lengths of the axes that its outputs have, see `axis_lengths`
    """
    steps, about = len(job.depths_m), "indenter to shared frame at first touch, or the contact pose where there is none"
    arrays = {"press/pose": Array((4, 4), "float64", about, "m")}
    for sensor, of_axes in lengths.items():
        touch = Array((), "float64", "travel from press/pose to first touch, NaN if none", "m")
        arrays[f"{sensor}/touch"] = touch
        for output in job.kept_outputs(sensor):
            sample = output.shape_of(of_axes)
            chunk = (1, *sample) if output.is_read_by_sample else None
            dtype, scale = output.dtype, {}
            if output.name == "displacement":
                dtype = job.dataset.displacement
                scale = {"scale_factor": job.displacement_step_m} if dtype == "int16" else {}
            elif output.is_image:
                scale = {"scale_factor": job.height_step_m}
            arrays[f"{sensor}/{output.name}"] = Array((steps, *sample), dtype, output.about, output.unit, chunk, scale)
    return arrays


def axis_lengths(job: Job, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, dict[str, int]]:
    """Lengths of the axes of each sensor's outputs, from the shapes of a dataset's planned arrays by path."""
    found = {}
    for sensor in job.sensors:
        lengths = {VERTEX: shapes[f"{sensor}/rest_positions"][0]}
        if job.surface_outputs(sensor):
            lengths[SURFACE_VERTEX] = shapes[f"{sensor}/surface_vertices"][0]
        if job.has_images(sensor):
            lengths[PIXEL_ROW], lengths[PIXEL_COLUMN] = shapes[f"{sensor}/{REST_DEPTH}"]
        found[sensor] = lengths
    return found


def path_arrays(path: IndenterPath) -> dict[str, np.ndarray]:
    """The arrays of the indenters' path, by name in the dataset; only ``depth`` if there are no legs."""
    arrays = {"depth": path.depths_m}
    if not path.is_a_press:
        arrays |= {"path/offset": path.offsets_m, "path/turn": path.turns_rad, "path/leg": path.legs}
    return arrays
