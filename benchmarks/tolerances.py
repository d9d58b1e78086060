"""Measure the effect of the solver's tolerances on accuracy and time.

    python benchmarks/tolerances.py --sensor digit --mesh default --output tolerances.json

The same press with several tolerances is compared with one that has a contact tolerance of 1e-4 and a residual
tolerance of 1e-6: largest differences of force and of the surface that moves, over all depths. The mesh is the same;
its error is measured by `simgen validate --case "sensors-*"`.
"""

import time

import numpy as np
from presses import summary
from record import sensor_arguments, write

from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene, SolverSettings, press
from simgen.verification.validate.sensors import PLACES_MM, difference_um, place_indenter

DEFAULTS = SolverSettings()
TIGHT = SolverSettings(residual_tolerance=1e-6, contact_tolerance=1e-4, linear_tolerance=1e-2)
SETTINGS = {
    "defaults": DEFAULTS,
    "contact 0.005, residual 1e-4, linear 0.05": SolverSettings(
        contact_tolerance=5e-3, residual_tolerance=1e-4, linear_tolerance=5e-2
    ),
    "contact 0.005": SolverSettings(contact_tolerance=5e-3),
    "contact 0.05": SolverSettings(contact_tolerance=5e-2),
    "contact 0.1, residual 1e-2": SolverSettings(contact_tolerance=0.1, residual_tolerance=1e-2),
    "linear 0.02": SolverSettings(linear_tolerance=0.02),
    "linear 0.3": SolverSettings(linear_tolerance=0.3),
}


def main():
    parser = sensor_arguments(__doc__, "tolerances.json")
    parser.add_argument("--indenters", nargs="+", default=["sphere_7mm", "ring_7mm"])
    parser.add_argument("--depths", type=int, default=6, help="number of depths, 0.1 mm apart")
    asked = parser.parse_args()
    sensor, rows = load_sensor(asked.sensor, asked.mesh), []
    pose, depths = place_indenter(sensor, *PLACES_MM["centre"])[None], np.arange(1, asked.depths + 1) * 1e-4
    for indenter in asked.indenters:
        tight = None
        for name, settings in {"tight": TIGHT, **SETTINGS}.items():
            scene = Scene(sensor, sensor.materials["solid"], device=asked.device, settings=settings)
            press(scene, [load_indenter(indenter).shape()], pose, depths[:1])  # compile kernels
            begin = time.perf_counter()
            result = press(scene, [load_indenter(indenter).shape()], pose, depths)[0]
            found = summary([result], time.perf_counter() - begin)
            tight = tight or result
            size = np.linalg.norm(tight.force, axis=1)
            of_force = 100.0 * np.linalg.norm(result.force - tight.force, axis=1) / size
            of_surface = [difference_um(a, b) for a, b in zip(result.displacement, tight.displacement, strict=True)]
            rows.append({"indenter": indenter, "tolerances": name, "force_percent": float(of_force.max()),
                         "surface_um": float(max(of_surface)), **found})  # fmt: skip
            print(f"{indenter:12s} {name:42s} force {of_force.max():.3f} %  surface {max(of_surface):.3f} um  "
                  f"{found['newton_per_solve']} Newton, {found['krylov_per_newton']} Krylov each, "
                  f"{found['seconds'] / len(depths):.2f} s a depth", flush=True)  # fmt: skip
    write(asked, rows)


if __name__ == "__main__":
    main()
