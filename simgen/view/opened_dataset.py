"""A dataset opened for the page: everything that its clients share."""

from pathlib import Path

from simgen.dataset.layout import checked
from simgen.dataset.reader import Dataset
from simgen.view.camera_picture import CameraPictures
from simgen.view.contact_map import ContactMap
from simgen.view.drawn_indenter import PressingIndenters
from simgen.view.drawn_surface import PressedSurface
from simgen.view.press_table import PressTable
from simgen.view.press_values import PressValues
from simgen.view.surface_fields import SurfaceFields


class OpenedDataset:
    """A dataset, its table of presses, and what is drawn of it. Raises `InputError` if it cannot be read.

    networks : folder of networks, whose predictions are shown, too
    is_finished : all presses were there when it was opened
    """

    def __init__(self, path: Path, networks: Path | None):
        self.dataset = dataset = Dataset(path)
        if not dataset.imported:
            checked(dataset)
        self.is_finished = not dataset.unfinished()
        self.table = PressTable.of_dataset(dataset)
        self.contacts = ContactMap.of_dataset(dataset)
        self.indenters = PressingIndenters(dataset)
        self.surfaces = {sensor: PressedSurface(dataset, sensor) for sensor in dataset.sensors}
        self.fields = {sensor: SurfaceFields(surface) for sensor, surface in self.surfaces.items()}
        self.values = PressValues(dataset)
        self.pictures = {sensor: CameraPictures(dataset, sensor) for sensor in dataset.sensors}
        self.predictions = None
        if networks is not None:
            from simgen.view.predictions import Predictions  # imports torch

            self.predictions = Predictions(dataset, networks)

    @property
    def depths(self) -> int:
        """Number of depths, or steps of the path, of each press."""
        return len(self.dataset.indenter_path)
