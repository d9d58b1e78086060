"""What networks predict for a sample of a dataset, beside the truth. This module needs PyTorch."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from simgen.dataset.reader import Dataset
from simgen.learning.translation.picture import SKIN_M
from simgen.learning.translation.presses import TranslatedMeshes
from simgen.learning.translation.translator import choose_way, networks_of
from simgen.sensing.electrodes.gaps import electrodes_of
from simgen.units import MM_PER_M, UM_PER_M
from simgen.view.camera_picture import CameraPictures
from simgen.view.colours import SurfaceField, displacement_mm
from simgen.view.drawn_surface import PRESSES_KEPT, PressedSurface

AT_REST_WORDS = "Networks predict pressed gels alone; this is first touch."
NOT_VALID = "Networks need electrode signals, and this sample is not valid on both sensors."
MID_GREY = 128  # of an image of differences: no difference


@dataclass(frozen=True)
class PredictedSurface:
    """A predicted surface of one sensor at one step.

    positions_mm : (v, 3) float32, mm, of the vertices of a `simgen.view.drawn_surface.DrawnSurface`
    displacement : length of the predicted displacement, mm, on the scale of the true one
    difference : distance of each vertex from its true position, um
    rmse_um : um, root mean square over the components of all vertices of the mesh, as `simgen translate` writes it
    """

    positions_mm: np.ndarray
    displacement: SurfaceField
    difference: SurfaceField
    rmse_um: float


@dataclass(frozen=True)
class Predicted:
    """Predictions of networks for one sample.

    signals, at_rest : (electrode,) V, and without contact
    surfaces : by sensor, of the source and of the target
    image, difference : (height, width, 3) uint8 of the target's camera: predicted, and predicted minus true about
        `MID_GREY`; None without a camera
    """

    signals: np.ndarray
    at_rest: np.ndarray
    surfaces: dict[str, PredictedSurface]
    image: np.ndarray | None
    difference: np.ndarray | None


class Predictions:
    """Networks of a folder that `simgen train` wrote, applied to samples of a dataset.

    source, target : names of sensors: networks translate the source's electrode signals to both meshes
    networks : names of the networks, in order
    electrodes_mm : (electrode, 3) mm, on the source's core, in its frame
    above_electrodes : (electrode,) vertices of the source's drawn surface above these, which move with the skin
    surfaces : by sensor, its true surface
    pictures : images of the target

    Raises `InputError` if networks and dataset do not fit each other.
    """

    def __init__(self, dataset: Dataset, networks: Path):
        way = choose_way(networks, None)
        self.dataset, self.networks = dataset, networks_of(way)
        self._meshes = TranslatedMeshes(dataset, networks, way)
        self.source, self.target = self._meshes.job.source, self._meshes.job.target
        self.surfaces = {sensor: PressedSurface(dataset, sensor) for sensor in (self.source, self.target)}
        electrodes, normals = electrodes_of(dataset, self.source)
        self.electrodes_mm = MM_PER_M * electrodes
        skin = cKDTree(self.surfaces[self.source].surface.rest_mm)
        self.above_electrodes = skin.query(MM_PER_M * (electrodes + SKIN_M * normals))[1]
        self.pictures = CameraPictures(dataset, self.target)
        self._of_press = lru_cache(PRESSES_KEPT)(self._translate)

    def why_not(self, press: int, step: int) -> str:
        """A sentence that says why nothing is predicted for a sample; empty if it is."""
        if step < 0:
            return AT_REST_WORDS
        return "" if step in self._meshes.steps(press) else NOT_VALID

    def of_sample(self, press: int, step: int) -> Predicted | None:
        """Predict a sample; None if `why_not` says why. Raises `InputError` where an electrode finds no skin."""
        if self.why_not(press, step):
            return None
        found = self._of_press(int(press))
        row = int(np.searchsorted(found.steps, step))
        surfaces = {sensor: self._surface(sensor, found, press, row) for sensor in self.surfaces}
        image, difference = self._images(found, row)
        return Predicted(found.signals[row], self._meshes.signals_at_rest, surfaces, image, difference)

    def _translate(self, press: int) -> "_TranslatedPress":
        steps = self._meshes.steps(press)
        found = self._meshes.translated(press, steps)
        moves = {self.source: found.source, self.target: found.target}
        truth = {sensor: self.dataset.displacement(sensor, press)[steps] for sensor in moves}
        return _TranslatedPress(steps, found.signals, moves, truth)

    def _surface(self, sensor: str, found: "_TranslatedPress", press: int, row: int) -> PredictedSurface:
        pressed = self.surfaces[sensor]
        surface = pressed.surface
        guess, truth = found.moves[sensor], found.truth[sensor]
        off = UM_PER_M * np.linalg.norm((guess - truth)[:, surface.vertices], axis=2)
        largest = float(np.nanmax(displacement_mm(pressed.displacement(press)), initial=0.0))
        return PredictedSurface(
            surface.displaced(guess[row]),
            SurfaceField("predicted displacement", "mm", displacement_mm(guess[row, surface.vertices]), largest),
            SurfaceField("distance from the truth", "um", np.float32(off[row]), float(off.max())),
            float(UM_PER_M * np.sqrt(np.square(guess[row] - truth[row]).mean())),
        )

    def _images(self, found: "_TranslatedPress", row: int) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The predicted image, and its difference from the image of the true mesh."""
        if self.pictures.why_not:
            return None, None
        guess, truth = (self.pictures.of_displacement(each[self.target][row]) for each in (found.moves, found.truth))
        difference = np.clip(MID_GREY + guess.astype(int) - truth, 0, 255).astype(np.uint8)
        return guess, difference


@dataclass(frozen=True)
class _TranslatedPress:
    """The valid steps (n,) of a press: signals (n, electrode), and by sensor displacements (n, vertex, 3) m."""

    steps: np.ndarray
    signals: np.ndarray
    moves: dict[str, np.ndarray]
    truth: dict[str, np.ndarray]
