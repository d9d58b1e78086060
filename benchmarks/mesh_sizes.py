"""Measure the error of simulation meshes against their number of unknowns.

    python benchmarks/mesh_sizes.py --sensor biotac --device cuda default 0.95,1.4,8 0.75,1.8,10,0.3

A mesh is one of the sensor's own, or it is made from edge_length_mm, held_edge_length_mm, grading_mm and, optionally,
bond_edge_length_mm; the cache keeps it. The 27 presses of the accuracy table are compared with those on the fine mesh.
"""

from dataclasses import replace

import numpy as np
from record import arguments, write

from simgen.geometry import mesh_files
from simgen.geometry.tetrahedra import SimulationMesh
from simgen.sensors.indenter import indenter_names, load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.sensors.sensor_geometry import load_geometry
from simgen.sensors.sensor_meshes import NAMES, make_simulation_mesh
from simgen.sensors.sensor_schema import MeshSize
from simgen.simulation.error_estimate import surface_difference
from simgen.simulation.press import PressResult, Scene, press
from simgen.units import UM_PER_M
from simgen.verification.validate.sensors import PLACES_MM, place_indenter

KEYS = ("edge_length_mm", "held_edge_length_mm", "grading_mm", "bond_edge_length_mm")
ENVELOPE = 0.1  # of the edge length
STEP_MM = 0.1
REPORTED_MM = (0.5, 1.0)


def mesh_of(sensor: str, sizes: str) -> SimulationMesh:
    """Load the sensor's mesh of that name, or make one of the given lengths, or find it in the cache."""
    if sizes in NAMES:
        return load_sensor(sensor, sizes).simulation_mesh
    geometry = load_geometry(sensor)
    lengths = [float(each) for each in sizes.split(",")]
    size = MeshSize(**dict(zip(KEYS, lengths, strict=False)), envelope_mm=ENVELOPE * lengths[0])
    source = geometry.mesh_source(size)
    return mesh_files.cached(source, SimulationMesh, lambda: make_simulation_mesh(geometry, size)[0])


def solve(sensor: str, mesh: SimulationMesh, depths_mm: np.ndarray, device: str) -> tuple[list[PressResult], int]:
    """Press all indenters at all places of the accuracy table; returns results and number of unknowns."""
    loaded = replace(load_sensor(sensor, "coarse"), simulation_mesh=mesh)
    names = [name for _ in PLACES_MM for name in indenter_names()]
    poses = np.stack([place_indenter(loaded, *place) for place in PLACES_MM.values() for _ in indenter_names()])
    shapes = {name: load_indenter(name).shape() for name in indenter_names()}
    scene = Scene(loaded, loaded.materials["solid"], device=device, batch=len(names) if device != "cpu" else 1)
    return press(scene, [shapes[name] for name in names], poses, 1e-3 * depths_mm), scene.unknowns


def main():
    parser = arguments(__doc__, "mesh_sizes.json")
    parser.add_argument("sizes", nargs="+", help="coarse, default, or lengths in mm")
    parser.add_argument("--sensor", default="digit")
    parser.add_argument("--only-make", action="store_true", help="make the meshes, and press nothing")
    asked = parser.parse_args()
    meshes = [mesh_of(asked.sensor, sizes) for sizes in asked.sizes]
    if asked.only_make:
        return
    depths = STEP_MM * np.arange(1, round(max(REPORTED_MM) / STEP_MM) + 1)
    fine, of_fine = solve(asked.sensor, mesh_of(asked.sensor, "fine"), depths, asked.device)
    rows = []
    for sizes, mesh in zip(asked.sizes, meshes, strict=True):
        results, unknowns = solve(asked.sensor, mesh, depths, asked.device)
        row = {"sizes_mm": sizes, "unknowns": unknowns}
        for depth in REPORTED_MM:
            i = int(np.abs(depths - depth).argmin())
            forces = np.array([[np.linalg.norm(each.force[i]) for each in own] for own in (results, fine)])
            pairs = zip(results, fine, strict=True)
            surface = UM_PER_M * np.array([surface_difference(a.displacement, b.displacement)[i] for a, b in pairs])
            force = 100.0 * np.abs(forces[0] / forces[1] - 1.0)
            row |= {f"force_percent_{depth:g}mm": [float(np.median(force)), float(force.max())],
                    f"surface_um_{depth:g}mm": [float(np.median(surface)), float(surface.max())]}  # fmt: skip
        print(", ".join(f"{key} {value}" for key, value in row.items()), flush=True)
        rows.append(row)
    write(asked, rows, unknowns_of_fine=of_fine)


if __name__ == "__main__":
    main()
