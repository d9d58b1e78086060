"""What do the solver's tolerances cost in accuracy, and what do they save?

    python benchmarks/tolerances.py --sensor digit --mesh default --output tolerances.json

The same press with several tolerances, against one with a contact tolerance of 1e-4 and a residual tolerance of 1e-6:
differences of the force and of the surface that moves, at the depth where they are largest. On the same mesh: the error
of the mesh is another matter (`simgen validate --case "sensors-*"`).
"""

import argparse
import time
from pathlib import Path

import numpy as np
from presses import summary
from record import write

from simgen.config.warp_device import start_warp
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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensor", default="digit")
    parser.add_argument("--mesh", default="default")
    parser.add_argument("--indenters", nargs="+", default=["sphere_7mm", "ring_7mm"])
    parser.add_argument("--depths", type=int, default=6, help="of 0.1 mm")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--output", type=Path, default=Path("tolerances.json"))
    asked = parser.parse_args()
    start_warp()
    sensor, rows = load_sensor(asked.sensor, asked.mesh), []
    pose, depths = place_indenter(sensor, *PLACES_MM["centre"])[None], np.arange(1, asked.depths + 1) * 1e-4
    for indenter in asked.indenters:
        tight = None
        for name, settings in {"tight": TIGHT, **SETTINGS}.items():
            scene = Scene(sensor, sensor.materials["solid"], device=asked.device, settings=settings)
            press(scene, [load_indenter(indenter).shape()], pose, depths[:1])  # loads kernels
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
    plain = {name: str(value) for name, value in vars(asked).items()}
    write(asked.output, __doc__.splitlines()[0], asked.device, plain, rows)


if __name__ == "__main__":
    main()
