"""Indenters of a dataset: loaded again from its job if they have not changed, and their poses at first touch."""

import numpy as np

from simgen.dataset.provenance import difference
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.sensors.indenter import Indenter, chosen_indenter
from simgen.sensors.indenter_pose import advanced


def pressed_indenters(dataset: Dataset) -> list[Indenter]:
    """Load the indenters of the dataset. Raises `InputError` if a user's file has changed or is gone."""
    return [pressed_indenter(dataset, index) for index in range(len(dataset.indenters))]


def pressed_indenter(dataset: Dataset, index: int) -> Indenter:
    """Load one indenter of the dataset. Raises as `pressed_indenters`."""
    name, own = dataset.indenters[index], chosen_indenter(dataset.job, index)
    stored = dataset.attributes.get("indenters", {}).get(name)
    if stored is not None and (changes := difference(stored, own.identity())):
        raise InputError(f"{name}: not the indenter that was pressed ({'; '.join(changes)})")
    return own


def first_touch(dataset: Dataset, sensor: str) -> np.ndarray:
    """Poses (press, 4, 4) m at first touch, indenter frame -> sensor frame; NaN without first touch or sensor pose."""
    return poses_at_touch(dataset["press/pose"], dataset[f"{sensor}/touch"], dataset[f"{sensor}/pose"])


def poses_at_touch(pose: np.ndarray, touch: np.ndarray, to_sensor: np.ndarray) -> np.ndarray:
    """Poses (n, 4, 4) as `first_touch`, from the arrays press/pose, and touch and pose of the sensor, of n presses."""
    pose = advanced(pose, touch)
    known = np.isfinite(to_sensor).all(axis=(1, 2))
    pose[known] = np.linalg.inv(to_sensor[known]) @ pose[known]
    pose[~known] = np.nan
    return pose
