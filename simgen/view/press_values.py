"""The numbers of a press: outputs of a sensor that are no mesh and no image, read a press at a time."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from simgen.dataset.reader import Dataset

PRESSES_KEPT = 32


class PressValues:
    """Numbers of the presses of a dataset. The last presses are kept."""

    def __init__(self, dataset: Dataset):
        self.dataset = dataset
        self._names = {sensor: [output.name for output in dataset.job.kept_outputs(sensor)
                                if not output.is_read_by_sample and f"{sensor}/{output.name}" in dataset.arrays]
                       for sensor in dataset.sensors}  # fmt: skip
        self._read = lru_cache(PRESSES_KEPT * len(dataset.sensors))(self._read_press)
        self._pose, self._contact = {}, dataset.get("press/contact_pose")

    def of(self, sensor: str, press: int) -> Mapping[str, np.ndarray]:
        """Values (depth, ...) of each output, by its name in `simgen.config.outputs`, in its unit.

        Raises `InputError` if a file cannot be read.
        """
        return self._read(sensor, int(press))

    def touch(self, sensor: str, press: int) -> float:
        """Travel, m, from ``press/pose`` to first touch on this sensor; NaN if it never touched."""
        return float(self.dataset.of_press(f"{sensor}/touch", int(press)))

    def axial_force(self, sensor: str, press: int) -> np.ndarray:
        """Force (depth,), N, on the sensor along the press axis; NaN where not reached or without a known contact."""
        if sensor not in self._pose:
            self._pose[sensor] = self.dataset[f"{sensor}/pose"]
        force = self.of(sensor, press)["force"]
        if self._contact is None:
            return np.full(len(force), np.nan)
        return force @ (self._contact[press, :3, 1] @ self._pose[sensor][press, :3, :3])

    def _read_press(self, sensor: str, press: int) -> dict[str, np.ndarray]:
        return {name: self.dataset.of_press(f"{sensor}/{name}", press) for name in self._names[sensor]}
