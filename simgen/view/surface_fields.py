"""The fields that colour the surface of a dataset's sensor: displacement, contact patch, traction and stress."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from simgen.dataset.contact_patch import ContactPatches
from simgen.errors import InputError
from simgen.geometry.surface_normals import vertex_normals
from simgen.units import MM_PER_M
from simgen.view.colours import SurfaceField, displacement_mm, pressure_kpa, traction_kpa, von_mises_kpa
from simgen.view.drawn_surface import AT_REST, PRESSES_KEPT, PressedSurface

DISPLACEMENT, CONTACT, PRESSURE, TRACTION, VON_MISES = "displacement", "contact", "pressure", "traction", "von_mises"
TITLES = {
    DISPLACEMENT: ("displacement", "mm"),
    CONTACT: ("contact patch", ""),
    PRESSURE: ("contact pressure", "kPa"),
    TRACTION: ("traction", "kPa"),
    VON_MISES: ("von Mises stress", "kPa"),
}
NEEDS = {PRESSURE: "traction", TRACTION: "traction", VON_MISES: "stress"}  # outputs of `simgen.config.outputs`


class SurfaceFields:
    """Fields of one sensor of a dataset.

    titles : by key, title of each field that the dataset has; displacement first
    why_not : by key, a sentence about each field that it lacks
    """

    def __init__(self, pressed: PressedSurface):
        self.pressed, self.dataset, self.sensor = pressed, pressed.dataset, pressed.sensor
        self.titles, self.why_not = {DISPLACEMENT: TITLES[DISPLACEMENT][0]}, {}
        self._measures: dict[str, Callable[[int], np.ndarray]] = {DISPLACEMENT: self._displacement}
        try:
            self._patches = ContactPatches(self.dataset, self.sensor)
            self._add(CONTACT, self._contact)
        except InputError as error:
            self.why_not[CONTACT] = f"The contact patch is not known: {error}"
        for key, measure in ((PRESSURE, self._pressure), (TRACTION, self._traction), (VON_MISES, self._von_mises)):
            output = f"{self.sensor}/{NEEDS[key]}"
            if output in self.dataset.arrays:
                self._add(key, measure)
            else:
                self.why_not[key] = f"The dataset has no {output}; a job asks for it in outputs."
        self._of_press = lru_cache(PRESSES_KEPT * len(TITLES))(lambda key, press: self._measures[key](press))

    def _add(self, key: str, measure: Callable[[int], np.ndarray]) -> None:
        self.titles[key], self._measures[key] = TITLES[key][0], measure

    def field(self, key: str, press: int, step: int) -> SurfaceField:
        """A field at a step of a press, or `AT_REST`. Its scale is that of the whole press.

        Raises `InputError` for a field that the dataset does not have, and if a file cannot be read.
        """
        if key not in self.titles:
            raise InputError(f"{self.sensor}: field {key!r}: allowed: {', '.join(self.titles)}")
        of_steps = self._of_press(key, int(press))
        largest = 1.0 if key == CONTACT else float(np.nanmax(of_steps, initial=0.0))
        values = self._at_rest(key) if step == AT_REST else of_steps[step]
        return SurfaceField(*TITLES[key], values, largest)

    def _at_rest(self, key: str) -> np.ndarray:
        """Values (v,) before the press; stress at rest is not stored."""
        count = len(self.pressed.surface.rest_mm)
        return np.zeros(count, np.float32) if key in (DISPLACEMENT, CONTACT) else np.full(count, np.nan, np.float32)

    # Each measure gives (depth, v) float32 of a press, NaN where not reached.

    def _displacement(self, press: int) -> np.ndarray:
        return displacement_mm(self.pressed.displacement(press))

    def _contact(self, press: int) -> np.ndarray:
        """1 for points that touch the indenter and 0 for others, NaN where not touchable."""
        displacement, surface = self.pressed.displacement(press), self.pressed.surface
        steps, points = np.arange(len(displacement)), self._patches.points
        vertices, first = np.unique(surface.vertices, return_index=True)
        own = np.searchsorted(vertices, points)
        values = np.full((len(steps), len(vertices)), np.nan, np.float32)
        values[:, own] = self._patches.touching(np.full(len(steps), press), steps, displacement[:, first[own]])
        values[~np.isfinite(displacement).all(axis=(1, 2))] = np.nan
        return values[:, surface.in_outputs]

    def _output(self, name: str, press: int) -> np.ndarray:
        """An output at the surface (depth, v, ...), in its unit."""
        return self.dataset.in_unit(f"{self.sensor}/{name}", press)[:, self.pressed.surface.in_outputs]

    def _traction(self, press: int) -> np.ndarray:
        return traction_kpa(self._output("traction", press))

    def _pressure(self, press: int) -> np.ndarray:
        traction, surface = self._output("traction", press), self.pressed.surface
        moved = surface.rest_mm + MM_PER_M * self.pressed.displacement(press)
        return pressure_kpa(traction, np.stack([vertex_normals(each, surface.triangles) for each in moved]))

    def _von_mises(self, press: int) -> np.ndarray:
        return von_mises_kpa(self._output("stress", press))
