"""Count Newton and Krylov iterations over mesh size, depth and Poisson's ratio.

    python benchmarks/iterations.py --sensor digit --meshes coarse default --output iterations.json

A sphere of R = 3.5 mm is pressed 2 mm into the middle of a sensor in 20 steps, with friction, on several meshes and
with several Poisson's ratios. At some depths it reports Newton iterations of the step and Krylov iterations per Newton
step.
"""


import numpy as np
from record import arguments, write

from simgen.fem.nonlinear.status import has_values
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene, SolverSettings, press
from simgen.verification.validate.sensors import PLACES_MM, place_indenter

DEPTHS_MM = np.arange(1, 21) * 0.1
SHOWN_MM = (0.1, 0.5, 1.0, 1.5, 2.0)


def measure(sensor, nu: float, indenter: str, settings: SolverSettings, device: str) -> dict:
    scene = Scene(
        sensor, sensor.materials["solid"].model_copy(update={"poisson_ratio": nu}), device=device, settings=settings
    )
    pose = place_indenter(sensor, *PLACES_MM["centre"])
    result = press(scene, [load_indenter(indenter).shape()], pose[None], DEPTHS_MM * 1e-3)[0]
    newton, krylov = (result.certificate[f"{kind}_iterations"] for kind in ("newton", "krylov"))
    shown = [int(np.abs(DEPTHS_MM - depth).argmin()) for depth in SHOWN_MM]
    return {
        "unknowns": scene.unknowns,
        "depth_mm": list(SHOWN_MM),
        "newton": newton[shown].tolist(),
        "krylov_per_newton": np.round(krylov / newton, 2)[shown].tolist(),
        "mean_newton_per_depth": float(np.mean(newton)),
        "mean_krylov_per_newton": float(krylov.sum() / newton.sum()),
        "converged": int(has_values(result.status).sum()),
        "of": len(DEPTHS_MM),
        "seconds": round(result.seconds, 1),
    }


def main():
    parser = arguments(__doc__, "iterations.json")
    parser.add_argument("--sensor", default="digit")
    parser.add_argument("--meshes", nargs="+", default=["coarse", "default", "fine"])
    parser.add_argument("--nu", nargs="+", type=float, default=[0.45, 0.49, 0.499, 0.4999])
    parser.add_argument("--indenter", default="sphere_7mm")
    parser.add_argument("--linear-tolerance", type=float, default=SolverSettings().linear_tolerance)
    asked = parser.parse_args()
    settings = SolverSettings(linear_tolerance=asked.linear_tolerance)
    rows = []
    for mesh in asked.meshes:
        sensor = load_sensor(asked.sensor, mesh)
        for nu in asked.nu:
            found = measure(sensor, nu, asked.indenter, settings, asked.device)
            rows.append({"mesh": mesh, "hash": sensor.simulation_mesh.hash[:12], "nu": nu, **found})
            print(f"{mesh:8s} {found['unknowns']:7d} unknowns  nu {nu:<7g} Newton a depth {found['newton']}  "
                  f"Krylov a Newton {found['krylov_per_newton']}  {found['converged']}/{found['of']} converged, "
                  f"{found['seconds']} s", flush=True)  # fmt: skip
    write(asked, rows)


if __name__ == "__main__":
    main()
