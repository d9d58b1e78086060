"""Measure the effect of the load steps' size on accuracy and time. With friction a press depends on its path.

    python benchmarks/steps.py --sensor digit --mesh default --output steps.json

The same press in steps of several sizes is compared with the smallest: force (positive is too high), and RMSE of the
surface that moves, at depths that all of them store.
"""

import time

import numpy as np
from presses import summary
from record import sensor_arguments, write

from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene, press
from simgen.verification.validate.sensors import PLACES_MM, difference_um, place_indenter

COMPARED_M = np.array([0.5e-3, 1e-3])


def main():
    parser = sensor_arguments(__doc__, "steps.json")
    parser.add_argument("--indenters", nargs="+", default=["sphere_3.5mm", "ring_7mm"])
    parser.add_argument("--steps", nargs="+", type=float, default=[0.025, 0.05, 0.1, 0.25, 0.5], help="mm, rising")
    asked = parser.parse_args()
    sensor, rows = load_sensor(asked.sensor, asked.mesh), []
    scene = Scene(sensor, sensor.materials["solid"], device=asked.device)
    pose = place_indenter(sensor, *PLACES_MM["centre"])[None]
    for indenter in asked.indenters:
        shapes, smallest = [load_indenter(indenter).shape()], None
        press(scene, shapes, pose, COMPARED_M[:1])  # compile kernels
        for step in asked.steps:
            depths = np.arange(1, round(COMPARED_M[-1] / (step * 1e-3)) + 1) * step * 1e-3
            begin = time.perf_counter()
            result = press(scene, shapes, pose, depths)[0]
            found = summary([result], time.perf_counter() - begin)
            at = [int(np.argmin(np.abs(depths - depth))) for depth in COMPARED_M]
            force, moved = np.linalg.norm(result.force[at], axis=1), result.displacement[at]
            smallest = smallest or (force, moved)
            of_force = 100.0 * (force / smallest[0] - 1.0)
            of_surface = [difference_um(a, b) for a, b in zip(moved, smallest[1], strict=True)]
            for depth, percent, surface in zip(COMPARED_M, of_force, of_surface, strict=True):
                rows.append({"indenter": indenter, "step_mm": step, "depth_mm": 1e3 * float(depth),
                             "force_percent": float(percent), "surface_um": surface, **found})  # fmt: skip
                print(f"{indenter:14s} steps of {step:5.3f} mm, at {1e3 * depth:.1f} mm: force {percent:+.2f} %, "
                      f"surface {surface:.2f} um, {found['seconds']:.1f} s", flush=True)  # fmt: skip
    write(asked, rows)


if __name__ == "__main__":
    main()
