"""Contacts that the plan refused because an indenter would leave too little gel, and the area lost by that."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import TouchableSurface
from simgen.plotting.html import picture, table
from simgen.plotting.surface_plot import camera, draw_points, draw_surface

NEAR = 0.5  # skin within this share of the largest depth from a contact counts as covered
KEPT, REFUSED = np.array([0.10, 0.35, 0.60]), np.array([0.80, 0.10, 0.10])
FACING_PAD = camera(np.array([0.0, -1.0, 0.0]))


@dataclass(frozen=True)
class ContactPlaces:
    """Contacts on the reference sensor: points (n, 3) m and outward normals (n, 3), in its frame."""

    kept: tuple[np.ndarray, np.ndarray]
    refused: tuple[np.ndarray, np.ndarray]


def contact_places(arrays: Mapping[str, np.ndarray]) -> ContactPlaces:
    """Contacts of a dataset, or of a plan's arrays, with refused ones."""
    _, first = np.unique(arrays["press/trajectory"], return_index=True)
    kept = arrays["press/contact_pose"][first][:, :3, 3], arrays["press/contact_normal"][first]
    return ContactPlaces(kept, (arrays["refused/points"], arrays["refused/normals"]))


def areas(surface: TouchableSurface, places: ContactPlaces, near_m: float) -> tuple[float, float]:
    """Touchable area, m2, within ``near_m`` of any contact, and of a kept one."""
    skin = surface.vertices[surface.points]
    kept, refused = (cKDTree(points).query(skin)[0] <= near_m for points, _ in (places.kept, places.refused))
    return float(surface.areas[kept | refused].sum()), float(surface.areas[kept].sum())


def places_map(surface: TouchableSurface, places: ContactPlaces, title: str) -> Figure:
    """Draw kept contacts in blue and refused ones in red, seen from the pad side."""
    figure = Figure(figsize=(4.6, 3.6), layout="constrained")
    figure.suptitle(title, fontsize=10)
    axes = figure.subplots()
    draw_surface(axes, surface.vertices, surface.triangles, view=FACING_PAD)
    for (points, normals), colour in ((places.kept, KEPT), (places.refused, REFUSED)):
        draw_points(axes, points, normals, np.tile(colour, (len(points), 1)), view=FACING_PAD)
    return figure


def refused_lines(dataset: Dataset, surface: TouchableSurface) -> Iterator[str]:
    """Lines of HTML about the reference sensor; none if the plan refused no contact."""
    if "refused/points" not in dataset.root:
        return
    places = contact_places(dataset)
    kept, refused = len(places.kept[0]), len(places.refused[0])
    near = NEAR * float(dataset.job.depths_m.max())
    before, after = areas(surface, places, near)
    name, least = dataset.sensors[0], dataset.job.trajectories.least_thickness_left
    yield "<h3>Refused contacts (red) and kept ones (blue)</h3>"
    yield (
        f"<p>{refused:,} of {kept + refused:,} places ({refused / (kept + refused):.1%}) were refused and replaced. "
        f"There, on one of the sensors, an indenter would leave less than {least:g} of the gel's thickness, or enter "
        "the body under the gel (<code>trajectories.least_thickness_left</code>). Areas are touchable skin within "
        f"{near * 1e3:.2g} mm of a contact.</p>"
    )
    yield table(["sensor", "area of all contacts", "area of kept contacts", "lost"], [
        [name, f"{before * 1e6:.0f} mm2", f"{after * 1e6:.0f} mm2", f"{(before - after) * 1e6:.0f} mm2"],
    ])  # fmt: skip
    yield picture(places_map(surface, places, name), f"refused contacts on {name}")
