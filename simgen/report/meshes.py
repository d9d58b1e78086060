"""Deformed meshes of one press of each indenter, coloured by the length of the displacement."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from simgen.dataset.reader import Dataset
from simgen.plotting.html import picture, tiles
from simgen.plotting.surface_plot import camera, draw_surface
from simgen.report.choice import NOTHING_YET, furthest_press, step_title

OBLIQUE = np.array([-0.3, -0.6, 0.1])  # added to the contact normal, gives the direction to the viewer


def meshes_section(dataset: Dataset) -> Iterator[str]:
    pictures = []
    for index, name in enumerate(dataset.indenters):
        press, reached = furthest_press(dataset, index)
        if reached:
            pictures.append(picture(draw_press(dataset, press, reached), f"deformed by {name}"))
    if not pictures:
        yield NOTHING_YET
        return
    yield (
        "<p>For each indenter, the press that goes furthest on all sensors, half-way and at its end, in the shared "
        "frame.</p>"
    )
    yield tiles(pictures)


def draw_press(dataset: Dataset, press: int, reached: int) -> Figure:
    """Draw one press half-way and at the last of the ``reached`` depths, a row for each sensor."""
    last = reached - 1
    depths = sorted({last // 2, last})
    moved = {sensor: [dataset.displacement(sensor, press, depth) for depth in depths] for sensor in dataset.sensors}
    largest = max(np.linalg.norm(each, axis=-1).max() for own in moved.values() for each in own) * 1e3
    view = camera(dataset.root["press/contact_normal"][press] + OBLIQUE)
    figure = Figure(figsize=(1.7 * len(depths) + 0.7, 1.6 * len(dataset.sensors) + 0.3), layout="constrained")
    figure.suptitle(f"{dataset.indenters[dataset['press/indenter'][press]]}, press {press}", fontsize=10)
    grid = figure.subplots(len(dataset.sensors), len(depths), squeeze=False)
    for row, (sensor, own) in zip(grid, moved.items(), strict=True):
        pose = dataset.root[f"{sensor}/pose"][press]
        triangles = dataset[f"{sensor}/surface_triangles"]
        for axes, depth, displacement in zip(row, depths, own, strict=True):
            vertices = (dataset[f"{sensor}/rest_positions"] + displacement) @ pose[:3, :3].T + pose[:3, 3]
            length = np.linalg.norm(displacement, axis=1) * 1e3
            faces = draw_surface(axes, vertices, triangles, length, largest=largest, view=view)
            axes.set_title(f"{sensor}, {step_title(dataset, depth)}", fontsize=9)
    figure.colorbar(faces, ax=grid.ravel().tolist(), label="displacement, mm", shrink=0.7)
    return figure
