"""Where a viewer looks from at the contact of a press, in a sensor's frame."""

from dataclasses import dataclass

import numpy as np

from simgen.dataset.reader import Dataset
from simgen.plotting.surface_plot import FROM_PAD, camera
from simgen.report.meshes import OBLIQUE
from simgen.units import MM_PER_M

TILT = 0.35  # share of the contact normal in the direction to a viewer at the side


@dataclass(frozen=True)
class Viewpoint:
    """A direction to look from.

    towards_viewer, up : (3,) unit vectors at right angles
    target_mm : (3,) mm, the point to look at
    """

    towards_viewer: np.ndarray
    up: np.ndarray
    target_mm: np.ndarray


def side_viewpoint(normal: np.ndarray, target_mm: np.ndarray) -> Viewpoint:
    """Look at a contact from the side, so that the indenter comes from above.

    normal, target_mm : outward unit normal (3,) and contact (3,) mm, in the sensor's frame
    """
    finger = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 0.0, 1.0])
    return _of_view(camera(np.cross(finger, normal) + TILT * normal, up=normal), target_mm)


def top_viewpoint(normal: np.ndarray, target_mm: np.ndarray) -> Viewpoint:
    """Look at a contact obliquely from above, for a surface without its indenter; arguments as `side_viewpoint`."""
    return _of_view(camera(normal + OBLIQUE), target_mm)


def contact_viewpoint(dataset: Dataset, sensor: str, press: int, with_indenter: bool = True) -> Viewpoint:
    """Viewpoint of a press: from the side with its indenter, from above without.

    Without a known contact it looks at the middle of the sensor, from the pad side.
    """
    contact, normal = dataset.get("press/contact_pose"), dataset.get("press/contact_normal")
    if contact is None or normal is None:
        rest = dataset[f"{sensor}/rest_positions"]
        return _of_view(FROM_PAD, MM_PER_M * 0.5 * (rest.min(axis=0) + rest.max(axis=0)))
    pose = dataset[f"{sensor}/pose"][press]
    normal, point = (each @ pose[:3, :3] for each in (normal[press], contact[press][:3, 3] - pose[:3, 3]))
    return (side_viewpoint if with_indenter else top_viewpoint)(normal, MM_PER_M * point)


def _of_view(view: np.ndarray, target_mm: np.ndarray) -> Viewpoint:
    _, up, out = view
    return Viewpoint(out, up, target_mm)
