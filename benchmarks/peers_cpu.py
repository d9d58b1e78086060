"""Compare simgen with NGSolve on one core, at equal errors: one press, and eight presses at once.

    python benchmarks/peers_cpu.py --output peers_cpu.json

Both codes press a sphere 1 mm into a quarter of a bonded layer, in ten depths, without friction
(`simgen.verification.validate.peers`). An error is the root mean square of the surface's distance from simgen's finest
mesh, at 1 mm. The time of simgen at NGSolve's error is interpolated between meshes, on logarithmic scales. Times are of
one core, for one depth of one press.
"""

import numpy as np
from record import arguments, write

from simgen.fem.groups import WIDTH
from simgen.verification.bench.settings import DEFAULT, mesh_size, reference_size
from simgen.verification.validate import peers
from simgen.verification.validate.peer_ngsolve import solve as solve_by_ngsolve
from simgen.verification.validate.peer_scene import PeerSolution

EDGES_MM = (0.9, 0.6, 0.45, 0.3, 0.25)


def row(solution: PeerSolution, edge_mm: float, presses: int, reference: PeerSolution) -> dict:
    """Time for a depth, and errors at the last depth."""
    return {
        "code": solution.code, "presses_at_once": presses, "edge_mm": edge_mm, "unknowns": solution.unknowns,
        "seconds_per_depth": solution.seconds / len(peers.STEPS_MM),
        "force_error_percent": float(100.0 * (solution.force[-1] / reference.force[-1] - 1.0)),
        "surface_rmse_um": peers.surface_rmse_um(solution.displacement[-1], reference.displacement[-1]),
    }  # fmt: skip


def time_at(error_um: float, rows: list[dict]) -> float:
    """Seconds for a depth on a mesh with this error."""
    known = sorted((each["surface_rmse_um"], each["seconds_per_depth"]) for each in rows)
    errors, seconds = np.log(np.array(known)).T
    return float(np.exp(np.interp(np.log(error_um), errors, seconds)))


def main():
    asked = arguments(__doc__, "peers_cpu.json").parse_args()
    for presses in (1, WIDTH):
        peers.solve(peers.WARM_UP, peers.STEPS_MM[:1], asked.device, presses=presses)  # compiles
    reference = peers.solve(reference_size(DEFAULT), peers.STEPS_MM, asked.device)
    rows = []
    for edge in EDGES_MM:
        for presses in (1, WIDTH):
            solution = peers.solve(mesh_size(edge), peers.STEPS_MM, asked.device, presses=presses)
            rows.append(row(solution, edge, presses, reference))
            print(rows[-1], flush=True)
    for edges in DEFAULT.ngsolve_edges:
        theirs = row(solve_by_ngsolve(*edges, peers.STEPS_MM, peers.surface_points()), edges[0], 1, reference)
        for presses in (1, WIDTH):
            ours = time_at(theirs["surface_rmse_um"], [each for each in rows if each["presses_at_once"] == presses
                                                       and each["code"] == "simgen"])  # fmt: skip
            theirs[f"times_as_fast_{presses}_at_once"] = round(theirs["seconds_per_depth"] / ours, 1)
        rows.append(theirs)
        print(theirs, flush=True)
    write(asked, rows)


if __name__ == "__main__":
    main()
