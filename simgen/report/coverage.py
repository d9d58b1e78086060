"""Contacts on each sensor, and how well they cover its touchable surface."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import TouchableSurface, touchable_surface
from simgen.plotting.html import picture, table, tiles
from simgen.report.choice import NOTHING_YET, depths_reached
from simgen.report.maps import draw_map
from simgen.report.refused import refused_lines


@dataclass(frozen=True)
class ConvergedContacts:
    """Contacts with a converged sample on a sensor, in its frame: points (n, 3) m, outward normals (n, 3)."""

    trajectories: np.ndarray
    points: np.ndarray
    normals: np.ndarray


def contacts_on(dataset: Dataset, sensor: str) -> ConvergedContacts:
    """Find the contacts of trajectories with a converged sample on a sensor."""
    converged = dataset["press/trajectory"][depths_reached(dataset, sensor) > 0]
    trajectories, first = np.unique(dataset["press/trajectory"], return_index=True)
    keep = np.isin(trajectories, converged)
    first = first[keep]
    pose = dataset[f"{sensor}/pose"][first]
    points = dataset["press/contact_pose"][first][:, :3, 3] - pose[:, :3, 3]
    own, normals = (
        np.einsum("nji,nj->ni", pose[:, :3, :3], each) for each in (points, dataset["press/contact_normal"][first])
    )
    return ConvergedContacts(trajectories[keep], own, normals)


@dataclass(frozen=True)
class Coverage:
    """Distances to the nearest contact.

    contacts : number of contacts
    area : m2, of the touchable surface
    distance : (n,) m, straight line from each touchable point to its nearest contact
    median, percentile_95 : m, of the distance, weighted by area
    """

    contacts: int
    area: float
    distance: np.ndarray
    median: float
    percentile_95: float


def coverage(surface: TouchableSurface, points: np.ndarray) -> Coverage:
    """Coverage of a surface by contacts (n, 3) m, one or more."""
    distance, _ = cKDTree(points).query(surface.vertices[surface.points])
    median, high = np.quantile(distance, [0.5, 0.95], weights=surface.areas, method="inverted_cdf")
    return Coverage(len(points), float(surface.areas.sum()), distance, float(median), float(high))


def coverage_section(dataset: Dataset) -> Iterator[str]:
    on = {sensor: contacts_on(dataset, sensor) for sensor in dataset.sensors}
    if not any(len(contacts.points) for contacts in on.values()):
        yield NOTHING_YET
        return
    yield (
        f"<p>The job has {dataset.job.trajectories.count:,} contacts. A contact counts on a sensor if at least one of "
        "its samples converged there. Distances are straight lines from touchable points to the nearest contact. "
        "Percentiles are weighted by area.</p>"
    )
    surfaces = {sensor: touchable_surface(dataset, sensor) for sensor in dataset.sensors}
    found = {
        sensor: coverage(surfaces[sensor], on[sensor].points) for sensor in dataset.sensors if len(on[sensor].points)
    }
    header = ["sensor", "contacts", "touchable area", "contacts per cm2", "nearest contact: median", "95th percentile"]
    yield table(header, [
        [sensor, f"{own.contacts:,}", f"{own.area * 1e4:.2f} cm2", f"{own.contacts / (own.area * 1e4):.3g}",
         f"{own.median * 1e3:.2f} mm", f"{own.percentile_95 * 1e3:.2f} mm"] for sensor, own in found.items()
    ])  # fmt: skip
    colours = _place_colours(dataset)
    yield "<h3>Contacts, each in the same colour on all sensors</h3>"
    yield tiles(_picture_of_contacts(s, surfaces[s], on[s], colours) for s in found)
    largest = max(own.distance.max() for own in found.values()) * 1e3
    yield "<h3>Distance to the nearest contact (grey: not touchable)</h3>"
    label = "nearest contact, mm"
    yield tiles(
        picture(draw_map(surfaces[s], own.distance * 1e3, s, label, largest=largest), f"coverage of {s}")
        for s, own in found.items()
    )
    yield from refused_lines(dataset, surfaces[dataset.sensors[0]])


def _picture_of_contacts(
    sensor: str, surface: TouchableSurface, contacts: ConvergedContacts, colours: np.ndarray
) -> str:
    shown = contacts.points, contacts.normals, colours[contacts.trajectories]
    return picture(draw_map(surface, None, sensor, contacts=shown), f"contacts on {sensor}")


def _place_colours(dataset: Dataset) -> np.ndarray:
    """Colours (trajectory, 3) that vary along x (red) and z (blue) of the shared frame."""
    _, first = np.unique(dataset["press/trajectory"], return_index=True)
    points = dataset["press/contact_pose"][first][:, :3, 3]
    spread = np.ptp(points, axis=0)
    part = (points - points.min(axis=0)) / np.where(spread > 0, spread, 1.0)
    return np.stack([0.15 + 0.8 * part[:, 0], np.full(len(points), 0.35), 0.15 + 0.8 * part[:, 2]], axis=1)
