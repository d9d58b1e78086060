"""The contacts that were drawn again because an indenter would leave too little gel, and the area that they cost."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import TouchableSurface
from simgen.plotting.html import picture, table
from simgen.plotting.surface_plot import camera, draw_points, draw_surface

NEAR = 0.5  # of the deepest press: a place counts as covered by a contact so far away
KEPT, REFUSED = np.array([0.10, 0.35, 0.60]), np.array([0.80, 0.10, 0.10])
FACING_PAD = camera(np.array([0.0, -1.0, 0.0]))


@dataclass(frozen=True)
class Draws:
    """Contacts on the reference sensor in its frame: points (n, 3) m and outward normals (n, 3) of both kinds."""

    kept: tuple[np.ndarray, np.ndarray]
    refused: tuple[np.ndarray, np.ndarray]


def draws_of(arrays: Mapping[str, np.ndarray]) -> Draws:
    """The contacts of a dataset, or of a plan's arrays, that has refused some."""
    _, first = np.unique(arrays["press/trajectory"], return_index=True)
    kept = arrays["press/contact_pose"][first][:, :3, 3], arrays["press/contact_normal"][first]
    return Draws(kept, (arrays["refused/points"], arrays["refused/normals"]))


def areas(surface: TouchableSurface, draws: Draws, near_m: float) -> tuple[float, float]:
    """Touchable area, m2, with any contact so near, and with one that was kept."""
    places = surface.vertices[surface.points]
    kept, refused = (cKDTree(points).query(places)[0] <= near_m for points, _ in (draws.kept, draws.refused))
    return float(surface.areas[kept | refused].sum()), float(surface.areas[kept].sum())


def draws_map(surface: TouchableSurface, draws: Draws, title: str) -> Figure:
    """Draw kept contacts in blue and refused ones in red, seen from the pad side."""
    figure = Figure(figsize=(4.6, 3.6), layout="constrained")
    figure.suptitle(title, fontsize=10)
    axes = figure.subplots()
    draw_surface(axes, surface.vertices, surface.triangles, view=FACING_PAD)
    for (points, normals), colour in ((draws.kept, KEPT), (draws.refused, REFUSED)):
        draw_points(axes, points, normals, np.tile(colour, (len(points), 1)), view=FACING_PAD)
    return figure


def refused_lines(dataset: Dataset, surface: TouchableSurface) -> Iterator[str]:
    """Lines of HTML on a reference sensor with this surface; none if the plan has refused no contact."""
    if "refused/points" not in dataset.root:
        return
    draws = draws_of(dataset)
    kept, refused = len(draws.kept[0]), len(draws.refused[0])
    near = NEAR * float(dataset.job.depths_m.max())
    before, after = areas(surface, draws, near)
    name, least = dataset.sensors[0], dataset.job.trajectories.least_thickness_left
    yield "<h3>Contacts that were drawn again: red; kept: blue</h3>"
    yield (
        f"<p>At {refused:,} of {kept + refused:,} places that fit otherwise ({refused / (kept + refused):.1%}) an "
        f"indenter would leave less than {least:g} of the gel under it, or enter what the gel rests on, on one of the "
        "sensors (<code>trajectories.least_thickness_left</code>). Other places were drawn instead. Areas are those of "
        f"the touchable skin within {near * 1e3:.2g} mm of a contact.</p>"
    )
    yield table(["sensor", "area of all places", "area of the kept ones", "lost"], [
        [name, f"{before * 1e6:.0f} mm2", f"{after * 1e6:.0f} mm2", f"{(before - after) * 1e6:.0f} mm2"],
    ])  # fmt: skip
    yield picture(draws_map(surface, draws, name), f"contacts drawn again on {name}")
