"""The indenter as three.js draws it: its surface, and its pose in a sensor's frame at each step."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np

from simgen.config.indenter_path import moved
from simgen.dataset.pressed_indenters import first_touch, pressed_indenter
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.sensors.indenter import Indenter
from simgen.units import MM_PER_M
from simgen.view.drawn_surface import AT_REST


@dataclass(frozen=True)
class DrawnIndenter:
    """Closed surface of an indenter, in its own frame: tip at the origin, +y the press axis.

    vertices_mm : (n, 3) float32, mm
    triangles : (m, 3) int32, outward
    """

    name: str
    vertices_mm: np.ndarray
    triangles: np.ndarray

    @classmethod
    def of(cls, indenter: Indenter) -> Self:
        mesh = indenter.mesh()
        return cls(indenter.name, np.float32(MM_PER_M * mesh.vertices), np.asarray(mesh.faces, np.int32))


class PressingIndenters:
    """Indenters of a dataset, and where they are in its presses."""

    def __init__(self, dataset: Dataset):
        self.dataset, self._path = dataset, dataset.indenter_path
        self._indenter = dataset["press/indenter"]
        self._drawn = lru_cache(maxsize=None)(self._load)
        self._way = lru_cache(maxsize=None)(lambda sensor: (first_touch(dataset, sensor), dataset.offsets_of(sensor)))

    def drawn(self, press: int) -> DrawnIndenter | None:
        """The indenter of a press; None if its file has changed or is gone, see `why_not`."""
        found = self._drawn(int(self._indenter[press]))
        return None if isinstance(found, str) else found

    def why_not(self, press: int) -> str:
        """A sentence that says why the indenter cannot be drawn; empty if it can."""
        found = self._drawn(int(self._indenter[press]))
        return found if isinstance(found, str) else ""

    def pose(self, sensor: str, press: int, step: int) -> np.ndarray | None:
        """Pose (4, 4), lengths in mm, from the indenter's frame to the sensor's, at a step or `AT_REST`.

        It is on the path also at steps that the press did not reach. None without first touch, or if the dataset does
        not know it.
        """
        first, offsets = self._way(sensor)
        pose = first[press].copy()
        if not np.isfinite(pose).all():
            return None
        if step != AT_REST:
            pose = moved(pose, offsets[press, step], self._path.turns_rad[step])
        pose[:3, 3] *= MM_PER_M
        return pose

    def _load(self, index: int) -> DrawnIndenter | str:
        try:
            return DrawnIndenter.of(pressed_indenter(self.dataset, index))
        except InputError as error:
            return f"The indenter is not drawn: {error}"
