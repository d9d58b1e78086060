"""Draw a section of the gel under an edge: a cube pressed into the DIGIT.

    python benchmarks/section.py solve after.npz                     # 5 minutes on a core
    python benchmarks/section.py draw docs/images/section.png before.npz after.npz

`before.npz` comes from this script in a checkout of an earlier commit. The section's plane has the press axis and the
lateral axis. Colours show det F, the local volume ratio: 1 for a gel that keeps its volume, below 0 for elements inside
out.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyvista
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap
from presses import job_scene

from simgen.config.job import load_job
from simgen.config.warp_device import start_warp
from simgen.geometry.interpolation import geometry_jacobian, shape_functions
from simgen.geometry.rigid_shape import signed_distance
from simgen.sensors.indenter import load_indenter
from simgen.simulation.press import press
from simgen.simulation.state_sampler import StateSampler

INDENTER = "cube_14mm"
CONTACT_MM = (-9.2379, -8.0671, -2.9699)  # contact 1 of jobs/paired.yaml, seed 1
AXES = ((0.92772227, 0.05493822, -0.36920616), (-0.10300636, 0.98838257, -0.11175684),
        (0.35877721, 0.14170989, 0.9226035))  # fmt: skip
COLOURS = LinearSegmentedColormap.from_list("det F", ["#b3001b", "#f2b34c", "#e9e4d8", "#7fa8c9", "#1d4e79"])
BACK_MM = -4.2365  # height of the bonded back


def solve(file: Path) -> None:
    """Press to 2 mm and save the state (depth, node, 3) mm at each converged depth."""
    start_warp()
    job = load_job("paired")
    scene = job_scene(job, "digit", 1, "cpu")
    pose, states, take = np.eye(4), [], StateSampler.take
    pose[:3, :3], pose[:3, 3] = AXES, 1e-3 * np.array(CONTACT_MM)

    def watch(sampler, reached):
        states.append(scene.solver.x.numpy()[: 3 * len(scene.nodes), 0].reshape(-1, 3).copy())
        return take(sampler, reached)

    StateSampler.take = watch
    result = press(scene, [load_indenter(INDENTER).shape()], pose[None], job.depths_m)[0]
    np.savez_compressed(file, nodes=scene.nodes, tetrahedra=scene.mesh.tetrahedra, u=states, pose=pose,
                        touch=result.touch, depths=job.depths_m, status=result.status)  # fmt: skip
    print(f"{file}: status {result.status.tolist()}, {result.seconds:.0f} s")


def parts(divisions: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Divide an element: points (n, 4) in barycentric coordinates, tetrahedra (m, 4)."""
    grid = np.array([(i, j, k) for i in range(divisions + 1) for j in range(divisions + 1 - i)
                     for k in range(divisions + 1 - i - j)]) / divisions  # fmt: skip
    points = np.column_stack([1.0 - grid.sum(axis=1), grid])
    cells = pyvista.PolyData(grid).delaunay_3d().cells.reshape(-1, 5)[:, 1:]
    return points, cells


def cut(positions: np.ndarray, rest: np.ndarray, tetrahedra: np.ndarray, pose: np.ndarray):
    """Cut the gel: triangles (m, 3, 2) mm in (lateral, axial) coordinates, det F (m,), element edges (n, 2, 2)."""
    points, cells = parts()
    elements = np.einsum("pn,eni->epi", shape_functions(points), positions[tetrahedra])
    here = (elements.reshape(-1, 3) - pose[:3, 3]) @ pose[:3, :3]
    of_all = (cells[None] + len(points) * np.arange(len(tetrahedra))[:, None, None]).reshape(-1, 4)
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: of_all}, here)
    at = np.broadcast_to(points[cells].mean(axis=1), (len(tetrahedra), len(cells), 4))
    now, before = (np.linalg.det(geometry_jacobian(x[tetrahedra][:, None], at)) for x in (positions, rest))
    grid.cell_data["det F"] = (now / before).ravel()
    grid.cell_data["element"] = np.repeat(np.arange(len(tetrahedra)), len(cells))
    section = grid.slice(normal=(1.0, 0.0, 0.0), origin=(1e-4, 0.0, 0.0)).triangulate()
    corners = section.points[section.regular_faces][:, :, [2, 1]]
    return corners, section.cell_data["det F"], outlines(corners, section.cell_data["element"])


def outlines(corners: np.ndarray, element: np.ndarray) -> np.ndarray:
    """Outline each ``element`` (m,): edges (n, 2, 2) of triangles (m, 3, 2) that only one of its triangles has."""
    edges = np.concatenate([corners[:, [i, (i + 1) % 3]] for i in range(3)])
    ends = np.round(edges * 1e5).astype(np.int64) @ np.array([1 << 32, 1])
    keys = np.column_stack([np.sort(ends, axis=1), np.tile(element, 3)])
    _, index, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    return edges[index[count == 1]]


def draw_state(axes: Axes, state: dict[str, np.ndarray], depth: int, title: str) -> PolyCollection:
    """Draw the gel at one depth, with the indenter and the bonded back."""
    pose = state["pose"].copy()
    pose[:3, 3] = 1e3 * pose[:3, 3] + (1e3 * (state["touch"] + state["depths"][depth])) * pose[:3, 1]
    corners, det, edges = cut(state["nodes"] + state["u"][depth], state["nodes"], state["tetrahedra"], pose)
    gel = PolyCollection(corners, array=det, cmap=COLOURS, edgecolors="face", linewidths=0.1)
    gel.set_clim(0.0, 2.0)
    axes.add_collection(gel)
    axes.add_collection(LineCollection(edges, colors="#333333", linewidths=0.25))
    z, y = np.meshgrid(np.linspace(-13.0, 17.0, 600), np.linspace(-4.0, 6.0, 240))
    at = np.stack([np.zeros_like(z), y, z], axis=-1).reshape(-1, 3)
    gap = signed_distance(load_indenter(INDENTER).shape(), at)[0].reshape(z.shape)
    axes.contourf(z, y, gap, levels=[-50.0, 0.0], colors=["#9aa0a6"], alpha=0.55)
    axes.contour(z, y, gap, levels=[0.0], colors="k", linewidths=0.8)
    height = (at @ pose[:3, :3].T + pose[:3, 3])[:, 1].reshape(z.shape)
    axes.contourf(z, y, height - BACK_MM, levels=[0.0, 50.0], colors=["#d5dbe1"], zorder=0)
    axes.set(xlim=(-10.5, 13.5), ylim=(-1.5, 5.0), aspect="equal", title=title, xticks=[], yticks=[])
    axes.invert_yaxis()
    return gel


def draw(file: Path, before: Path, after: Path) -> None:
    """Draw three panels: both states at the last depth that converged before, and the later state at 2 mm."""
    start_warp()
    old, new = np.load(before), np.load(after)
    last = len(old["u"]) - 1
    depths = 1e3 * new["depths"]
    panels = [(old, last, "before, where the press ended"), (new, last, "now"), (new, len(new["u"]) - 1, "now")]
    figure, axes = plt.subplots(3, 1, figsize=(9.0, 9.6), layout="constrained")
    for own, (state, depth, title) in zip(axes, panels, strict=True):
        gel = draw_state(own, state, depth, f"{depths[depth]:.1f} mm, {title}")
    figure.colorbar(gel, ax=axes, label="det F", shrink=0.5)
    figure.savefig(file, dpi=150)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    what = parser.add_subparsers(dest="what", required=True)
    what.add_parser("solve").add_argument("file", type=Path)
    drawing = what.add_parser("draw")
    for name in ("file", "before", "after"):
        drawing.add_argument(name, type=Path)
    asked = vars(parser.parse_args())
    {"solve": solve, "draw": draw}[asked.pop("what")](**asked)


if __name__ == "__main__":
    main()
