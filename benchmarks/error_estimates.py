"""Compare true with estimated errors of presses at places that calibrated nothing.

    python benchmarks/error_estimates.py --sensor digit --device cuda --output error_estimates.json

Contacts of another seed, one indenter each in turn, are pressed on the coarse, default and fine mesh. The truth is the
difference of the default mesh from the fine one, plus the fine mesh's own error by the same order.
"""

import numpy as np
from record import arguments, write

from simgen.config.job import load_job
from simgen.pipeline.plan import make_plan
from simgen.sensors.indenter import chosen_indenters
from simgen.sensors.sensor import load_sensor
from simgen.simulation.error_estimate import share_of_difference, surface_difference, surface_error_estimate
from simgen.simulation.press import PressResult, Scene, press
from simgen.units import UM_PER_M

MESHES = ("coarse", "default", "fine")
REPORTED_MM = (0.5, 1.0, 2.0)
SEED, STEP_MM = 20261125, 0.1


def solve(
    sensor: str, mesh: str, count: int, depths_mm: np.ndarray, device: str
) -> tuple[list[PressResult], int, list[str]]:
    """Press at ``count`` contacts; returns results, number of unknowns, and names of the indenters."""
    job = load_job("paired", [f"seed={SEED}", f"trajectories.count={count}"])
    plan, indenters = make_plan(job), chosen_indenters(job)
    rows = [trajectory * len(indenters) + trajectory % len(indenters) for trajectory in range(count)]
    chosen = [indenters[plan.arrays["press/indenter"][row]] for row in rows]
    poses = np.linalg.inv(plan.arrays[f"{sensor}/pose"][rows]) @ plan.arrays["press/contact_pose"][rows]
    shape_of = {indenter.name: indenter.shape() for indenter in indenters}
    loaded = load_sensor(sensor, mesh)
    scene = Scene(loaded, loaded.materials["solid"], device=device, batch=count if device != "cpu" else 1,
                  outputs=("error_energy",))
    results = press(scene, [shape_of[each.name] for each in chosen], poses, 1e-3 * depths_mm)
    return results, scene.unknowns, [each.name for each in chosen]


def main():
    parser = arguments(__doc__, "error_estimates.json")
    parser.add_argument("--sensor", default="digit")
    parser.add_argument("--count", type=int, default=45, help="contacts")
    parser.add_argument("--deepest-mm", type=float, default=2.0)
    asked = parser.parse_args()
    depths = STEP_MM * np.arange(1, round(asked.deepest_mm / STEP_MM) + 1)
    results, unknowns, names = zip(*(solve(asked.sensor, mesh, asked.count, depths, asked.device) for mesh in MESHES),
                                   strict=True)  # fmt: skip
    share, of_fine = share_of_difference(*unknowns[:2]), share_of_difference(*unknowns[1:])
    rows = []
    for name, coarse, default, fine in zip(names[0], *results, strict=True):
        surface = surface_error_estimate(default.displacement, coarse.displacement, share)
        force = [np.linalg.norm(each.force, axis=1) for each in (default, fine)]
        true_force = (1.0 + of_fine) * (force[0] - force[1]) / force[0]
        true_surface = (1.0 + of_fine) * surface_difference(fine.displacement, default.displacement)
        for depth in REPORTED_MM:
            i = int(np.abs(depths - depth).argmin())
            if abs(depths[i] - depth) < 1e-9:
                rows.append({
                    "indenter": name, "depth_mm": depth, "surface_um": float(UM_PER_M * true_surface[i]),
                    "surface_estimated_um": float(UM_PER_M * surface[i]),
                    "force_percent": float(100.0 * true_force[i]),
                    "force_estimated_percent": float(100.0 * default.force_error_estimate[i]),
                })  # fmt: skip
    for depth in sorted({row["depth_mm"] for row in rows}):
        own = [row for row in rows if row["depth_mm"] == depth]
        for what, unit in (("surface", "um"), ("force", "percent")):
            pairs = np.array([(row[f"{what}_{unit}"], row[f"{what}_estimated_{unit}"]) for row in own])
            true, estimated = np.abs(pairs[np.isfinite(pairs).all(axis=1)].T)
            ratio = true / estimated
            good = np.mean((ratio > 0.5) & (ratio < 2.0))
            print(f"{depth:g} mm, {what}: true median {np.median(true):.2f}, worst {true.max():.2f} {unit}; true over "
                  f"estimated median {np.median(ratio):.2f}, within 1/2 to 2 in {good:.0%} of {len(ratio)}", flush=True)
    write(asked, rows, unknowns=unknowns)


if __name__ == "__main__":
    main()
