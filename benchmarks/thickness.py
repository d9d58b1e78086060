"""Measure completeness and accuracy of presses over the share of the gel's thickness that they leave.

    python benchmarks/thickness.py --device cuda --output thickness.json

Contacts are sampled without `trajectories.least_thickness_left`. Presses of the widest indenters are chosen by the
share of gel that they leave at the last depth on one sensor. Some are also solved on a finer mesh. For each range of
shares it reports complete presses, samples with an element inside out, and differences to the finer mesh at some
depths.
"""

from itertools import pairwise

import numpy as np
from presses import job_scene
from record import sensor_arguments, write

from simgen.config.job import load_job
from simgen.fem.nonlinear.status import Status, has_values
from simgen.pipeline.plan import chosen_sensor, make_plan
from simgen.sensors.indenter import chosen_indenters
from simgen.sensors.least_thickness import LeastThickness
from simgen.simulation.press import press

BOUNDS = (0.05, 0.10, 0.15, 0.20, 0.25, 0.30, 0.40, 0.60)
SHOWN_MM = (1.0, 1.5, 2.0)


def choose(job, sensor: str, names: list[str], ranges: list[tuple[float, float]], count: int) -> list[dict]:
    """The first ``count`` presses of each indenter in each range of shares."""
    indenters, arrays = chosen_indenters(job), make_plan(job).arrays
    poses = np.linalg.inv(arrays[f"{sensor}/pose"]) @ arrays["press/contact_pose"]
    measure = LeastThickness(chosen_sensor(job, sensor), [each.shape() for each in indenters], job.indenter_path)
    shares, chosen = measure.shares(poses[:: len(indenters)]), []
    for i, indenter in enumerate(indenters):
        if indenter.name not in names:
            continue
        for low, high in ranges:
            fitting = np.flatnonzero((shares[:, i] >= low) & (shares[:, i] < high))[:count]
            chosen += [{"indenter": i, "name": indenter.name, "bounds": (low, high), "share": float(shares[t, i]),
                        "pose": poses[t * len(indenters) + i]} for t in fitting]  # fmt: skip
    return chosen


def solve(job, sensor: str, mesh: str, chosen: list[dict], device: str, batch: int):
    """Results of the chosen presses on a mesh of the sensor."""
    on_mesh = job.sensors[sensor].model_copy(update={"mesh": mesh})
    job = job.model_copy(update={"sensors": job.sensors | {sensor: on_mesh}})
    scene, shapes = job_scene(job, sensor, batch, device), [each.shape() for each in chosen_indenters(job)]
    poses = np.stack([each["pose"] for each in chosen])
    return press(scene, [shapes[each["indenter"]] for each in chosen], poses, job.depths_m), scene


def complete(results: list) -> int:
    return int(sum(has_values(result.status).all() for result in results))


def differences(pairs: list[tuple], shown: list[int], surface: np.ndarray) -> dict:
    """Differences of pairs (press, the same on the finer mesh), at the shown depths where both converged."""
    force, moved = [], []
    for depth in shown:
        both = [pair for pair in pairs if all(has_values(each.status[depth]) for each in pair)]
        sizes = np.array([[np.linalg.norm(each.force[depth]) for each in pair] for pair in both]).reshape(-1, 2)
        force.append((sizes[:, 0] / sizes[:, 1] - 1.0).round(4).tolist())
        moved.append([float(np.linalg.norm((ours.displacement - fine.displacement)[depth][surface], axis=1).max() * 1e6)
                      for ours, fine in both])  # fmt: skip
    return {
        "complete_on_the_finer_mesh": complete([fine for _, fine in pairs]),
        "force_over_finer_less_1": force, "surface_largest_difference_um": moved,
    }  # fmt: skip


def row(name: str, bounds: tuple[float, float], own: list) -> dict:
    """Counts of the presses of an indenter that leave a share between two bounds."""
    status = np.stack([press.status for press in own])
    return {
        "indenter": name, "share_left": bounds, "presses": len(own), "complete": complete(own),
        "samples": int(has_values(status).sum()), "inside_out": int((status == Status.INSIDE_OUT).sum()),
        "newton_iterations": int(sum(np.nansum(press.certificate["newton_iterations"]) for press in own)),
    }  # fmt: skip


def main():
    parser = sensor_arguments(__doc__, "thickness.json")
    parser.add_argument("--finer", default="fine")
    parser.add_argument("--indenters", nargs="+", default=["cylinder_long_7mm", "cube_14mm", "ring_7mm"])
    parser.add_argument("--count", type=int, default=8, help="presses of an indenter for each range of shares")
    parser.add_argument("--finer-count", type=int, default=2, help="presses that are also solved on the finer mesh")
    parser.add_argument("--least-share", type=float, default=BOUNDS[0], help="smallest share of the ranges")
    parser.add_argument("--trajectories", type=int, default=400, help="number of contacts to choose from")
    parser.add_argument("--batch", type=int, default=1)
    asked = parser.parse_args()
    job = load_job("paired", [f"trajectories.count={asked.trajectories}", "trajectories.least_thickness_left=0"])
    ranges = [bounds for bounds in pairwise(BOUNDS) if bounds[0] >= asked.least_share]
    chosen = choose(job, asked.sensor, asked.indenters, ranges, asked.count)
    results, scene = solve(job, asked.sensor, asked.mesh, chosen, asked.device, asked.batch)
    rows, members = [], []
    for name in asked.indenters:
        for bounds in ranges:
            own = [i for i, each in enumerate(chosen) if each["name"] == name and each["bounds"] == bounds]
            if own:
                rows.append(row(name, bounds, [results[i] for i in own]))
                members.append(own[: asked.finer_count])

    more = {"shown_mm": SHOWN_MM, "unknowns": scene.unknowns}
    write(asked, rows, **more)  # before the finer mesh, which may take ten times as long
    if asked.finer_count:
        some = [i for own in members for i in own]
        finer, _ = solve(job, asked.sensor, asked.finer, [chosen[i] for i in some], asked.device, asked.batch)
        found = dict(zip(some, finer, strict=True))
        surface = chosen_sensor(job, asked.sensor).output_mesh.touchable
        shown = [int(np.abs(job.depths_m * 1e3 - depth).argmin()) for depth in SHOWN_MM]
        for each, own in zip(rows, members, strict=True):
            each |= differences([(results[i], found[i]) for i in own], shown, surface)
        write(asked, rows, **more)
    for each in rows:
        print(each)


if __name__ == "__main__":
    main()
