"""Generator of pictures for the docs: indenters, paired contacts, refused contacts.

Run ``python docs/generate/pictures.py FOLDER``.
"""

import sys
from pathlib import Path

import matplotlib.colors
import numpy as np
import pyvista

from simgen.config.job import load_job
from simgen.dataset.touchable import touchable_surface
from simgen.pipeline.plan import make_plan
from simgen.report.refused import contact_places, places_map
from simgen.sensors.indenter import Indenter, indenter_names, load_indenter
from simgen.sensors.pairing import Contacts, partners, sample_contacts
from simgen.sensors.sensor import Sensor, load_sensor

GEL = "#d9d4c7"
STEEL = "#b9cbd9"
PAD_SIDE_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # shared frame -> drawing, z up
TIP_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # indenter frame -> drawing, z up


def draw_indenters(indenters: list[Indenter], path: Path, columns: int = 3) -> None:
    """Draw all indenters as a PNG, tip up, at the same scale."""
    rows = -(-len(indenters) // columns)
    plotter = pyvista.Plotter(
        off_screen=True, shape=(rows, columns), window_size=(280 * columns, 230 * rows), border=False
    )
    for index, indenter in enumerate(indenters):
        plotter.subplot(index // columns, index % columns)
        mesh = pyvista.wrap(indenter.mesh()).clip("y", origin=(0.0, -8e-3, 0.0), invert=False)
        _add(plotter, mesh, TIP_UP, STEEL)
        plotter.add_text(indenter.name, font_size=9, color="black", position="upper_edge")
        _look(plotter, focus=(0.0, 0.0, -4e-3), direction=(0.55, -1.0, 0.8), half_height=13e-3)
    _save(plotter, path)


def draw_contacts(sensors: list[Sensor], contacts: Contacts, path: Path) -> None:
    """Draw the contacts on each sensor as a PNG, seen from the pad. Paired contacts share a colour.

    Hue changes along the lateral arc, lightness along the finger.
    """
    colours = _place_colours(contacts)
    plotter = pyvista.Plotter(
        off_screen=True, shape=(1, len(sensors)), window_size=(540 * len(sensors), 470), border=False
    )
    for index, sensor in enumerate(sensors):
        plotter.subplot(0, index)
        _add(plotter, pyvista.wrap(sensor.surface), PAD_SIDE_UP, GEL)
        cloud = pyvista.PolyData(partners(sensor, contacts)[0])
        cloud["colour"] = colours
        dots = cloud.glyph(
            geom=pyvista.Sphere(radius=0.16e-3, theta_resolution=10, phi_resolution=10),
            scale=False,
            orient=False,
        )
        _add(plotter, dots, PAD_SIDE_UP, scalars="colour", rgb=True)
        plotter.add_text(sensor.name, font_size=10, color="black", position="upper_edge")
        _look(plotter, focus=(-7.5e-3, 0.0, 4e-3), direction=(0.2, -0.6, 1.0), half_height=14e-3)
    _save(plotter, path)


def _place_colours(contacts: Contacts) -> np.ndarray:
    """Colours (n, 3) uint8 of the contacts."""
    x, arc = (
        (values - values.min()) / max(np.ptp(values), 1e-12)
        for values in (contacts.points[:, 0], contacts.arcs)
    )
    hsv = np.stack([0.83 * arc, np.full_like(arc, 0.85), 0.45 + 0.5 * x], axis=1)
    return np.round(255.0 * matplotlib.colors.hsv_to_rgb(hsv)).astype(np.uint8)


def _add(plotter: pyvista.Plotter, mesh: pyvista.DataSet, rotation: np.ndarray, colour=None, **how) -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    mesh = (
        mesh.extract_surface(algorithm="dataset_surface") if not isinstance(mesh, pyvista.PolyData) else mesh
    )
    mesh = mesh.transform(matrix, inplace=False).compute_normals(
        cell_normals=False, split_vertices=True, feature_angle=40.0
    )
    plotter.add_mesh(mesh, color=colour, smooth_shading=True, specular=0.2, **how)


def _look(plotter: pyvista.Plotter, focus, direction, half_height: float) -> None:
    focus = np.array(focus)
    plotter.camera_position = [focus + 0.1 * np.array(direction), focus, (0.0, 0.0, 1.0)]
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = half_height


def _save(plotter: pyvista.Plotter, path: Path) -> None:
    plotter.set_background("white")
    path.parent.mkdir(parents=True, exist_ok=True)
    plotter.screenshot(path)
    plotter.close()


def main(folder: Path) -> None:
    """Make all pictures of this module."""
    draw_indenters([load_indenter(name) for name in indenter_names()], folder / "indenters.png")
    digit, biotac = load_sensor("digit"), load_sensor("biotac")
    contacts = sample_contacts(digit, count=860, seed=1, max_depth_m=2e-3)
    draw_contacts([digit, biotac], contacts, folder / "paired_contacts.png")
    arrays = make_plan(load_job("paired")).arrays
    figure = places_map(touchable_surface(arrays, "digit"), contact_places(arrays), "DIGIT")
    figure.savefig(folder / "refused_contacts.jpg", dpi=110, pil_kwargs={"quality": 85})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
