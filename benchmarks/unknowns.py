"""Measure the time of a depth over the number of unknowns.

    python benchmarks/unknowns.py --meshes coarse default fine --output unknowns.json

A sphere of R = 3.5 mm is pressed into the middle of a sensor, with friction, on meshes that each halve the edges under
the contact. The exponent is the slope of log time over log unknowns, between the first and the last mesh.
"""

import time

import numpy as np
from presses import summary
from record import arguments, write

from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene, press
from simgen.verification.validate.sensors import PLACES_MM, place_indenter


def main():
    parser = arguments(__doc__, "unknowns.json")
    parser.add_argument("--sensor", default="digit")
    parser.add_argument("--meshes", nargs="+", default=["coarse", "default", "fine"])
    parser.add_argument("--indenter", default="sphere_7mm")
    parser.add_argument("--depths", type=int, default=5, help="number of depths, 0.1 mm apart")
    parser.add_argument("--batch", type=int, default=1, help="number of equal presses solved together")
    asked = parser.parse_args()
    rows = []
    depths = np.arange(1, asked.depths + 1) * 1e-4
    for mesh in asked.meshes:
        sensor = load_sensor(asked.sensor, mesh)
        scene = Scene(sensor, sensor.materials["solid"], device=asked.device, batch=asked.batch)
        shapes = [load_indenter(asked.indenter).shape()] * asked.batch
        poses = np.tile(place_indenter(sensor, *PLACES_MM["centre"]), (asked.batch, 1, 1))
        press(scene, shapes[:1], poses[:1], depths[:1])  # compile kernels
        begin = time.perf_counter()
        found = summary(press(scene, shapes, poses, depths), time.perf_counter() - begin)
        rows.append({"mesh": mesh, "unknowns": scene.unknowns, **found})
        print(rows[-1], flush=True)
    first, last = rows[0], rows[-1]
    slower = first["solves_per_second"] / last["solves_per_second"]
    exponent = float(np.log(slower) / np.log(last["unknowns"] / first["unknowns"]))
    print(f"exponent {exponent:.2f}")
    write(asked, rows, exponent=exponent)


if __name__ == "__main__":
    main()
