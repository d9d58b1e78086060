"""Maps of values and contacts on the touchable surface of a sensor."""

import numpy as np
from matplotlib.figure import Figure

from simgen.dataset.touchable import TouchableSurface
from simgen.plotting.surface_plot import FROM_OTHER_SIDE, FROM_PAD, draw_points, draw_surface


def draw_map(
    surface: TouchableSurface,
    values: np.ndarray | None,
    title: str,
    label: str = "",
    *,
    largest: float = 1.0,
    contacts: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
) -> Figure:
    """Draw values (n,) of touchable points, and contacts (points, normals, colours), from both sides of the pad."""
    figure = Figure(figsize=(3.9, 4.0), layout="constrained")
    figure.suptitle(title, fontsize=10)
    grid = figure.subplots(2, 1)
    for axes, view in zip(grid, (FROM_PAD, FROM_OTHER_SIDE), strict=True):
        shown = None if values is None else surface.on_vertices(values)
        faces = draw_surface(axes, surface.vertices, surface.triangles, shown, largest=largest, view=view)
        if contacts is not None:
            draw_points(axes, *contacts, view=view, size=16.0 if len(contacts[0]) < 100 else 5.0)
    if values is not None:
        figure.colorbar(faces, ax=list(grid), label=label, shrink=0.7)
    return figure
