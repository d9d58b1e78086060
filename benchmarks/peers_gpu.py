"""Compare simgen with Newton's VBD solver and libuipc: a sphere pressed 1 mm into a bonded layer, many at once.

    pip install newton pyuipc
    python benchmarks/peers_gpu.py --device cuda --edges 0.9 0.6 --batches 1 64 512 --libuipc-batches 1 8

The layer is that of the reference solutions (R = 10 mm, 4 mm high, E = 0.539 MPa), the sphere has R = 3.5 mm, and
nothing rubs. simgen takes quadratic elements of the mesh, the others linear ones of the same corners. Their time is
that of the frames after which twice as many change the force by less than 0.5 % and no surface node by more than 1 um.
Errors are those against simgen on edges of 0.15 mm, whose force for nu = 0.499 is 0.1 % above NGSolve's. Settings of
the others: `vbd_layers` and `libuipc_layers`.
"""

import json
import time
from importlib.metadata import version

import numpy as np
from libuipc_layers import LibuipcLayers
from pressed_layer import Reference, gel, layer, solve
from record import arguments, write
from vbd_layers import VbdLayers

from simgen.simulation.press import Scene
from simgen.units import MM_PER_M, UM_PER_M
from simgen.verification.validate.layer_meshes import fixed_symmetric, make_sensor
from simgen.verification.validate.layer_reference import HEIGHT_MM
from simgen.verification.validate.meshes import Mesh, on_plane, top

FORCE_CHANGE, SURFACE_CHANGE_UM = 5e-3, 1.0
PEERS = {"Newton VBD": VbdLayers, "libuipc": LibuipcLayers}
PACKAGES = {"Newton VBD": "newton", "libuipc": "pyuipc"}


def settle(layers, surface: np.ndarray, limit_s: float) -> tuple[float, np.ndarray, float, int] | None:
    """Double the frames until nothing changes; returns force, displacements, seconds and frames, or None."""
    frames, spent, done, last = layers.first_frames, 0.0, 0, None
    while spent < limit_s:
        begin = time.perf_counter()
        layers.advance(frames - done)
        spent, done = spent + time.perf_counter() - begin, frames
        force, moved = layers.measure()
        if not np.isfinite(moved).all():
            return None
        if last is not None and last[0] > 0.0:
            change = np.abs(moved - last[1])[surface].max() * UM_PER_M / MM_PER_M
            if abs(force / last[0] - 1.0) < FORCE_CHANGE and change < SURFACE_CHANGE_UM:
                return last
        last, frames = (force, moved, spent, done), 2 * frames
    return None


class Case:
    """One mesh with one Poisson's ratio, and rows of results on it."""

    def __init__(self, edge: float, nu: float, reference: Reference, device: str):
        self.mesh: Mesh = layer(edge)
        self.nu, self._reference, self._device = nu, reference, device
        corners = self.mesh.nodes[: self.mesh.n_corners]
        self.surface = on_plane(corners, 1, 0.0)
        self._points = corners[self.surface]
        self._common = {"edge_mm": edge, "nu": nu}

    def by_simgen(self, batch: int) -> dict:
        """Press with simgen, in one step."""
        fixed = fixed_symmetric(self.mesh, (), HEIGHT_MM)
        sensor = make_sensor(self.mesh, fixed, top(self.mesh.nodes, self.mesh.faces), self._points)
        scene = Scene(sensor, gel(self.nu), device=self._device, batch=batch)
        solve(scene, min(batch, 2))  # loads the kernels
        results, seconds = solve(scene, batch)
        failed = sum(int(result.status[-1] != 0) for result in results)
        force, moved = abs(float(results[0].force[-1, 1])), results[0].displacement[-1] * MM_PER_M
        return self._row("simgen", batch, scene.unknowns, (force, moved, seconds), failed=failed)

    def by_peer(self, engine: str, batch: int, limit_s: float) -> dict:
        """Press with another engine."""
        found, why, unknowns = None, f"no equilibrium within {limit_s:g} s", 3 * self.mesh.n_corners
        try:
            layers = PEERS[engine](self.mesh, self.nu, batch, self._device)
            found = settle(layers, self.surface, limit_s)
        except RuntimeError as error:
            why = str(error)
        if found is None:
            return {"engine": engine, **self._common, "batch": batch, "unknowns": unknowns, "result": why}
        force, moved, seconds, frames = found
        more = {"imbalance_percent": layers.imbalance_percent()} if engine == "libuipc" else {}
        return self._row(engine, batch, unknowns, (force, moved[self.surface], seconds), frames=frames, **more)

    def _row(self, engine: str, batch: int, unknowns: int, found: tuple[float, np.ndarray, float], **more) -> dict:
        force, moved, seconds = found
        return {"engine": engine, **self._common, "batch": batch, "unknowns": unknowns, **more,
                "force_error_percent": round(100.0 * (force / self._reference.force - 1.0), 3),
                "surface_error_um": round(self._reference.error_um(self._points, moved), 2),
                "seconds": round(seconds, 4), "equilibria_per_second": round(batch / seconds, 2)}  # fmt: skip


def main():
    parser = arguments(__doc__, "peers_gpu.json")
    parser.add_argument("--edges", nargs="+", type=float, default=[0.9], help="mm")
    parser.add_argument("--batches", nargs="+", type=int, default=[1], help="of simgen and VBD")
    parser.add_argument("--libuipc-batches", nargs="*", type=int, default=[1])
    parser.add_argument("--nu", nargs="+", type=float, default=[0.45, 0.499])
    parser.add_argument("--engines", nargs="+", choices=["simgen", *PEERS], default=["simgen", *PEERS])
    parser.add_argument("--limit", type=float, default=60.0, help="seconds after which a peer gives up")
    asked = parser.parse_args()
    packages = {name: version(name) for engine, name in PACKAGES.items() if engine in asked.engines}
    rows = []
    for nu in asked.nu:
        reference = Reference(nu, asked.device)
        print(f"nu = {nu:g}: reference force {reference.force:.4f} N", flush=True)
        for edge in asked.edges:
            case = Case(edge, nu, reference, asked.device)
            runs = [run for batch in asked.batches for run in (("simgen", batch), ("Newton VBD", batch))]
            runs += [("libuipc", batch) for batch in asked.libuipc_batches]
            for engine, batch in (run for run in runs if run[0] in asked.engines):
                rows.append(case.by_simgen(batch) if engine == "simgen" else case.by_peer(engine, batch, asked.limit))
                print(json.dumps(rows[-1]), flush=True)
            write(asked, rows, peers=packages)  # after each mesh, because a peer may end the process


if __name__ == "__main__":
    main()
