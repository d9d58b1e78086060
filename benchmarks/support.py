"""Measure the effect of the plate under the DIGIT's gel.

    python benchmarks/support.py docs/images/support.png --mesh coarse

Nine indenters press six places to 2 mm, with and without the plate. The table shows changes of force and surface, how
far the gel bulges and hangs, and the time. The picture shows a section of a cube's press at the rim.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pyvista
from matplotlib.collections import PolyCollection
from matplotlib.patches import Rectangle

from simgen.fem.nonlinear.status import Status
from simgen.geometry.rigid_shape import signed_distance
from simgen.geometry.signed_distance import RigidShape
from simgen.plotting.surface_plot import PLAIN
from simgen.sensors.indenter import indenter_names, load_indenter
from simgen.sensors.indenter_pose import advanced
from simgen.sensors.sensor import load_sensor
from simgen.sensors.support import distance_to_outline
from simgen.simulation.press import PressResult, Scene, press
from simgen.verification.validate.sensors import place_indenter

PLACES_MM = [(-7.5, 0.0), (-7.5, 4.0), (-3.0, -6.0), (-13.0, 3.0), (1.0, 3.0), (-15.0, -5.0)]  # the first: the centre
DEPTHS_M = 1e-3 * np.linspace(0.1, 2.0, 20)
SHOWN, SHOWN_MM, SHOWN_DEPTHS = "cube_14mm", (-3.0, -6.0), 11  # both meshes converge so far
QUADRATIC_TETRAHEDRON = 24  # VTK's number


class Pressed(NamedTuple):
    """Result of a press, its last nodes (n, 3) mm, and its seconds of one core."""

    result: PressResult
    nodes: np.ndarray
    seconds: float

    @property
    def converged(self) -> np.ndarray:
        return self.result.status == Status.CONVERGED


def pressed(scene: Scene, shape: RigidShape, pose: np.ndarray, depths: np.ndarray) -> Pressed:
    start = time.process_time()
    result = press(scene, [shape], pose[None], depths)[0]
    moved = scene.solver.x.numpy()[: scene.nodes.size, 0].reshape(-1, 3)
    return Pressed(result, scene.nodes + moved, time.process_time() - start)


def compare(scenes: tuple[Scene, Scene]) -> None:
    """Print a row for each press, then a summary."""
    without, plate = scenes[0].sensor, scenes[1].sensor.support.body
    changes, depths, seconds = {"centre": [], "elsewhere": []}, np.zeros(2, int), np.zeros(2)
    print("indenter, x, arc mm: depths without, with; force, surface um at the last; bulge, hang mm without, with")
    for name in indenter_names():
        for place in PLACES_MM:
            shape, pose = load_indenter(name).shape(), place_indenter(without, *place)
            both = [pressed(scene, shape, pose, DEPTHS_M) for scene in scenes]
            one, other = (each.result for each in both)
            common = both[0].converged & both[1].converged
            change = np.linalg.norm(other.force - one.force, axis=1)[common] / np.linalg.norm(one.force, axis=1)[common]
            surface = 1e6 * np.abs(other.displacement - one.displacement)[common].max(axis=(1, 2))
            across = [distance_to_outline(each.nodes[:, [0, 2]], plate.outline_mm).max() for each in both]
            hang = [(each.nodes[:, 1] - plate.at_mm).max() for each in both]
            count = [each.converged.sum() for each in both]
            of_gel = f"{across[0]:.2f} {across[1]:.2f} {hang[0]:.2f} {hang[1]:.2f}"
            print(f"{name:20s} {place[0]:6.1f} {place[1]:5.1f}: {count[0]:2d} {count[1]:2d}; {change[-1]:.2%} "
                  f"{surface[-1]:6.1f}; {of_gel}", flush=True)  # fmt: skip
            changes["centre" if place == PLACES_MM[0] else "elsewhere"].append(change)
            depths, seconds = depths + count, seconds + [each.seconds for each in both]
    for where, found in changes.items():
        change = np.concatenate(found)
        print(f"{where}: {len(change)} samples, force changes by {np.median(change):.2%} on the median, "
              f"{np.quantile(change, 0.95):.2%} in the 95th percentile, {change.max():.2%} at most")  # fmt: skip
    print(f"depths that converge without, with: {depths}; seconds of a core: {seconds.round(1)}")


def draw(scenes: tuple[Scene, Scene], path: Path) -> None:
    """Draw a section of the press at the rim, without and with the plate."""
    sensor, plate = scenes[1].sensor, scenes[1].sensor.support.body
    shape, pose = load_indenter(SHOWN).shape(), place_indenter(sensor, *SHOWN_MM)
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.6), sharey=True, layout="constrained")
    for axis, scene, title in zip(axes, scenes, ("without a plate", "with the plate"), strict=True):
        depths = DEPTHS_M[:SHOWN_DEPTHS]
        found = pressed(scene, shape, pose, depths)
        last = found.converged.sum() - 1
        axis.add_collection(PolyCollection(section(scene, found.nodes), facecolor=PLAIN, edgecolor="#8d8778", lw=0.3))
        if scene.support_contact is not None:
            across = plate.outline_mm[..., 1]
            low, high = across.min() - plate.beyond_mm, across.max() + plate.beyond_mm
            axis.add_patch(Rectangle((low, -plate.at_mm - 1.0), high - low, 1.0, color="#b9cbd9"))
        axis.axhline(-plate.at_mm, color="#7b8794", lw=0.6, ls=":")
        moved = advanced(pose, found.result.touch + depths[last])
        z, y = np.meshgrid(np.linspace(-14.0, -4.0, 501), np.linspace(3.0, 9.0, 301))
        points = np.stack([np.full(z.shape, SHOWN_MM[0]), -y, z], axis=-1).reshape(-1, 3)
        local = (points - 1e3 * moved[:3, 3]) @ moved[:3, :3]
        inside = signed_distance(shape, local)[0].reshape(z.shape)
        axis.contourf(z, y, inside, levels=[-99.0, 0.0], colors=["#5d6b7a55"])
        force = np.linalg.norm(found.result.force[last])
        axis.set_title(f"{SHOWN}, {1e3 * depths[last]:.1f} mm, {title}: {force:.0f} N", fontsize=9, loc="left")
        axis.set(xlim=(-13.2, -5.0), ylim=(3.2, 8.2), aspect="equal", xlabel=f"z, mm, at x = {SHOWN_MM[0]:g} mm")
    axes[0].set_ylabel("-y, mm")
    figure.savefig(path, dpi=110)


def section(scene: Scene, nodes: np.ndarray) -> list[np.ndarray]:
    """Cut the gel's elements by the plane of the picture: polygons (k, 2) of z and -y, mm."""
    tetrahedra = scene.mesh.tetrahedra
    cells = np.hstack([np.full((len(tetrahedra), 1), 10), tetrahedra])
    grid = pyvista.UnstructuredGrid(cells, np.full(len(tetrahedra), QUADRATIC_TETRAHEDRON), nodes)
    cut = grid.slice(normal="x", origin=(SHOWN_MM[0], 0.0, 0.0))
    return [np.column_stack([cell.points[:, 2], -cell.points[:, 1]]) for cell in cut.cell]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", type=Path, help="PNG to write")
    parser.add_argument("--mesh", default="coarse", choices=("coarse", "default", "fine"))
    parser.add_argument("--picture-only", action="store_true")
    asked = parser.parse_args()
    digit = load_sensor("digit", asked.mesh)
    scenes = tuple(Scene(each, digit.materials["solid"]) for each in (replace(digit, support=None), digit))
    draw(scenes, asked.picture)
    if not asked.picture_only:
        compare(scenes)


if __name__ == "__main__":
    main()
