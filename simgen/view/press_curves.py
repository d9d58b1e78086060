"""Curves of a press: forces and pressures against depth."""

from dataclasses import dataclass

import numpy as np

from simgen.report.choice import steps_axis
from simgen.units import MM_PER_M
from simgen.view.press_values import PressValues

AXES = "xyz"


@dataclass(frozen=True)
class PressCurve:
    """One quantity of a press on a sensor, from 0 at first touch.

    x : (1 + depth,) depth in mm, or the number of the step on a path with legs
    values : (1 + depth,) in ``unit``; NaN where not reached
    """

    sensor: str
    title: str
    unit: str
    x: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class PressCurves:
    """Curves of one press on all sensors, in one order on each: forces first. ``x_label`` names their common axis."""

    x_label: str
    curves: tuple[PressCurve, ...]

    @property
    def titles(self) -> tuple[str, ...]:
        """Titles of the quantities, each once."""
        return tuple(dict.fromkeys(curve.title for curve in self.curves))


def press_curves(values: PressValues, press: int) -> PressCurves:
    """Make the curves of a press: the force along the press axis and in the sensor's frame, and what else is stored.

    Raises `InputError` if a file cannot be read.
    """
    dataset, curves = values.dataset, []
    steps, label = steps_axis(dataset)
    for sensor in dataset.sensors:
        own = values.of(sensor, press)
        quantities = [("normal force", "N", values.axial_force(sensor, press))]
        quantities += [(f"force, {axis}", "N", own["force"][:, k]) for k, axis in enumerate(AXES)]
        if "shear_force" in own:
            quantities.append(("shear force", "N", np.linalg.norm(own["shear_force"], axis=1)))
        if "cavity_pressure" in own:
            quantities.append(("cavity pressure", "kPa", own["cavity_pressure"] / 1e3))
        if "contact_area" in own:
            quantities.append(("contact area", "mm2", own["contact_area"]))
        x = MM_PER_M * dataset.depths_of(sensor)[press] if dataset.indenter_path.is_a_press else steps
        x = np.concatenate([[0.0], x])
        curves += [
            PressCurve(sensor, title, unit, x, np.concatenate([[0.0], each])) for title, unit, each in quantities
        ]
    return PressCurves(label, tuple(curves))
