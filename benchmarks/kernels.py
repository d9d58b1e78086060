"""Compare the solver's kernels with the peak speed of the device.

    python benchmarks/kernels.py --sensor digit --mesh default --device cuda --batches 64 256 --output kernels.json

Peaks are measured in the same run: bytes per second of a copy, and operations per second of independent multiply-adds
in single and double precision. Bytes of a kernel are a lower bound: each vector of the batch once, mesh data once for
all environments. Operations per element are counted by hand from the formulas.
"""

import time

import numpy as np
import warp as wp
from record import sensor_arguments, write

from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene, press
from simgen.verification.validate.sensors import PLACES_MM, place_indenter

wp.set_module_options({"enable_backward": False})

ADDS = 256  # multiply-adds of each of a thread's eight chains
Chains, DoubleChains = (wp.types.vector(length=8, dtype=dtype) for dtype in (wp.float32, wp.float64))
# Operations of a P2-P1 element with 8 points: 130 for derivatives at corners, 150 for nodal forces. At each point: 63
# for interpolation, 45 for det and cofactor, 70 for stress, 190 for its increment, 80 for sums at corners.
OPERATIONS = {"tangent": 2 * 130 + 150 + 8 * (2 * 63 + 45 + 190 + 80),
              "rough tangent": 2 * 130 + 150 + 4 * (2 * 63 + 45 + 190 + 80),
              "forces": 130 + 150 + 8 * (63 + 45 + 70 + 80)}  # fmt: skip


@wp.kernel
def single_kernel(x: wp.array(dtype=wp.float32)):
    i = wp.tid()
    start = x[i]
    a = Chains(start)
    for _ in range(ADDS):
        a = 0.999 * a + Chains(0.1)
    x[i] = wp.length_sq(a)


@wp.kernel
def double_kernel(x: wp.array(dtype=wp.float64)):
    i = wp.tid()
    start = x[i]
    a = DoubleChains(start)
    for _ in range(ADDS):
        a = wp.float64(0.999) * a + DoubleChains(wp.float64(0.1))
    x[i] = wp.length_sq(a)


def seconds(action, repeats: int = 20) -> float:
    """Median seconds of a call, with the wait for the device."""
    action()
    wp.synchronize()
    spent = []
    for _ in range(repeats):
        begin = time.perf_counter()
        action()
        wp.synchronize()
        spent.append(time.perf_counter() - begin)
    return float(np.median(spent))


def ceilings(device: str) -> dict[str, float]:
    """Peak bytes and operations per second of simple kernels."""
    large = (1 << 30 if device != "cpu" else 1 << 26) // 4
    a, b = (wp.zeros(large, dtype=wp.float32, device=device) for _ in range(2))
    found = {"bytes_per_second": 2.0 * 4.0 * large / seconds(lambda: wp.copy(b, a))}
    threads = 1 << (22 if device != "cpu" else 14)
    for name, kernel, dtype in (("float32", single_kernel, wp.float32), ("float64", double_kernel, wp.float64)):
        x = wp.ones(threads, dtype=dtype, device=device)
        taken = seconds(lambda k=kernel, x=x: wp.launch(k, dim=threads, inputs=[x], device=device))
        found[f"{name}_operations_per_second"] = 2.0 * 8.0 * ADDS * threads / taken
    return found


def measure(sensor, batch: int, device: str, limits: dict[str, float]) -> list[dict]:
    """Time each kernel with a batch of presses at 0.5 mm."""
    scene = Scene(sensor, sensor.materials["solid"], device=device, batch=batch)
    pose = np.tile(place_indenter(sensor, *PLACES_MM["centre"]), (batch, 1, 1))
    press(scene, [load_indenter("sphere_7mm").shape()] * batch, pose, np.array([0.5e-3]))
    solver = scene.solver
    solver.mark(np.ones(batch, dtype=bool))
    n, elements = solver.n_unknowns, len(solver.elasticity.host_tetrahedra)
    v, out = (wp.zeros((n, batch), dtype=wp.float32, device=device) for _ in range(2))
    v.assign(np.random.default_rng(0).normal(size=v.shape))
    forces, least = solver.vector(), wp.zeros(batch, dtype=wp.float64, device=device)
    multigrid = solver.preconditioner.multigrid
    actions = {
        "tangent": (lambda: solver.elasticity.tangent(v, out), 4 * (4 * n), "float32"),
        "rough tangent": (lambda: solver.elasticity.tangent(v, out, reduced=True), 4 * (4 * n), "float32"),
        "forces": (lambda: solver.elasticity.residual(solver.x, forces, least), 8 * (3 * n), "float64"),
        "diagonal blocks": (multigrid._invert_diagonal, 4 * (n + 2 * 9 * len(scene.nodes)), "float32"),
        "corner blocks": (multigrid.linear.rebuild, 4 * (n + 9 * multigrid.linear.pattern.n_blocks), "float32"),
        "corner cycle": (lambda: multigrid.linear.apply(multigrid._linear_b, multigrid._linear_x),
                         4 * 6 * 9 * multigrid.linear.pattern.n_blocks, "float32"),
        "preconditioner": (lambda: solver.preconditioner.apply(v, out), 0, "float32"),
        "contact forces": (lambda: scene.indenter_contact.residual(solver.x, forces), 0, "float64"),
    }  # fmt: skip
    rows = []
    for name, (action, moved, precision) in actions.items():
        taken = seconds(action)
        row = {"kernel": name, "batch": batch, "unknowns": n, "us_per_environment": 1e6 * taken / batch,
               "unknowns_per_second": n * batch / taken}  # fmt: skip
        if moved:
            row["share_of_bandwidth"] = moved * batch / taken / limits["bytes_per_second"]
        if name in OPERATIONS:
            done = OPERATIONS[name] * elements * batch / taken
            row["share_of_operations"] = done / limits[f"{precision}_operations_per_second"]
        rows.append({key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()})
        print(rows[-1], flush=True)
    return rows


def main():
    parser = sensor_arguments(__doc__, "kernels.json")
    parser.add_argument("--batches", nargs="+", type=int, default=[1])
    asked = parser.parse_args()
    limits = ceilings(asked.device)
    print(limits, flush=True)
    sensor = load_sensor(asked.sensor, asked.mesh)
    rows = [row for batch in asked.batches for row in measure(sensor, batch, asked.device, limits)]
    write(asked, rows, ceilings=limits)


if __name__ == "__main__":
    main()
