"""Map of all contacts of a dataset on the unrolled skin of its first sensor, to choose one."""

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.learning.translation.unfolded import UnfoldedSkin
from simgen.units import MM_PER_M

AXES = ("lateral arc, mm", "along the finger, mm")
FLAT_AXES = ("z, mm", "x, mm")
OUTLINE_MM = 0.3  # largest error of an outline


@dataclass(frozen=True)
class ContactMap:
    """Contacts in a plane with equal axes. The tip of the finger, -x, is above: the second axis points down.

    sensor : the one whose skin it is
    trajectories : (n,) numbers, rising
    points_mm : (n, 2) mm; NaN if the dataset does not know the contact
    outlines : closed polygons (m, 2), mm, around the touchable skin; none if the skin cannot be unrolled
    axes : their labels
    """

    sensor: str
    trajectories: np.ndarray
    points_mm: np.ndarray
    outlines: tuple[np.ndarray, ...]
    axes: tuple[str, str]

    @classmethod
    def of_dataset(cls, dataset: Dataset) -> Self:
        """Make the map, in about half a second. Where no skin can be unrolled, it shows x and z of the sensor."""
        sensor = dataset.sensors[0]
        trajectories, points = _contacts(dataset, sensor)
        try:
            skin = _skin(dataset, sensor)
        except InputError:
            return cls(sensor, trajectories, MM_PER_M * points[:, [2, 0]], (), FLAT_AXES)
        known = np.isfinite(points).all(axis=1)
        placed = np.full((len(points), 2), np.nan)
        placed[known] = skin.place(points[known])
        return cls(sensor, trajectories, placed, _outlines(skin), AXES)


def _contacts(dataset: Dataset, sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (n,) of the trajectories, and their contacts (n, 3) m in the sensor's frame."""
    trajectories, first = np.unique(dataset["press/trajectory"], return_index=True)
    at = dataset.get("press/contact_pose")
    at = (dataset["press/pose"] if at is None else at)[first, :3, 3]  # imported files state first touch alone
    pose = dataset[f"{sensor}/pose"][first]
    return trajectories, np.einsum("nji,nj->ni", pose[:, :3, :3], at - pose[:, :3, 3])


def _skin(dataset: Dataset, sensor: str) -> UnfoldedSkin:
    rest, touchable = dataset[f"{sensor}/rest_positions"], dataset.get(f"{sensor}/touchable")
    shown = np.ones(len(rest), bool) if touchable is None else touchable
    return UnfoldedSkin(rest, dataset[f"{sensor}/surface_triangles"], shown)


def _outlines(skin: UnfoldedSkin) -> tuple[np.ndarray, ...]:
    """Outlines of what a map shows, on the map."""
    image = np.pad(np.isfinite(skin.map(np.zeros(skin.vertices))).astype(np.uint8), 1)
    left, right, bottom, top = skin.extent
    pixel = np.array([right - left, bottom - top]) / (np.array(image.shape[::-1]) - 2)
    found, _ = cv2.findContours(image, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    found = (cv2.approxPolyDP(each, OUTLINE_MM / pixel.min(), closed=True)[:, 0] for each in found)
    return tuple(np.vstack([each, each[:1]]) * pixel + [left, top] - 0.5 * pixel for each in found)
