"""Quantities that the gel of a live press can be coloured by."""

import numpy as np

from simgen.config.job_schema import Job
from simgen.units import MM_PER_M
from simgen.view.colours import SurfaceField, displacement_mm, traction_kpa
from simgen.view.drawn_surface import DrawnSurface
from simgen.view.live_press import LivePress

DISPLACEMENT, TRACTION = "displacement", "traction"
FIELDS = (DISPLACEMENT, TRACTION)


def fields_of(base: Job) -> tuple[str, ...]:
    """Names of the quantities that presses of a job measure on some sensor."""
    measured = {output for outputs in base.outputs.values() for output in outputs}
    return FIELDS if TRACTION in measured else (DISPLACEMENT,)


def live_field(name: str, press: LivePress, surface: DrawnSurface, step: int) -> SurfaceField:
    """Field of a press at a step that has converged.

    The scale of displacements ends at the largest depth, that of tractions at the largest so far.
    """
    outputs = press.outputs[step]
    if name == TRACTION and "traction" in outputs:
        values = traction_kpa(outputs["traction"])[surface.in_outputs]
        largest = max(float(np.nanmax(traction_kpa(own["traction"]))) for own in press.outputs.values())
        return SurfaceField("traction", "kPa", values, largest)
    values = displacement_mm(outputs["displacement"][surface.vertices])
    return SurfaceField("displacement", "mm", values, float(MM_PER_M * press.deepest_m))


def field_at_rest(surface: DrawnSurface, depth_m: float) -> SurfaceField:
    """Displacement before a press to a depth, m: zero everywhere."""
    return SurfaceField("displacement", "mm", np.zeros(len(surface.rest_mm), np.float32), float(MM_PER_M * depth_m))
