"""Measure converged depths per second for several batch sizes, and the time of each phase of the solver.

    python benchmarks/batch.py --sensor digit --mesh default --device cuda --batches 32 128 256 --output batch.json

Presses are those of the full paired job: nine indenters, 20 depths to 2 mm. ``--profile`` times the phases. It waits
for the device before and after each phase, which slows the run.
"""

import time
from collections import defaultdict
from collections.abc import Iterator
from operator import attrgetter

import warp as wp
from presses import paired_presses, summary
from record import sensor_arguments, write

from simgen.simulation.press import press
from simgen.simulation.state_sampler import StateSampler

PHASES = {  # name: attributes of the solver, method
    "forces": ("balance", "measure"),
    "forces after an update of the multipliers": ("balance", "measure_surfaces"),
    "preconditioner": ("preconditioner", "rebuild_multigrid"),
    "Krylov iterations": ("systems.krylov", "advance"),
}


def watch(thing, method: str, name: str, spent: dict[str, float]) -> None:
    """Replace a method by one that adds its seconds to ``spent[name]``."""
    plain = getattr(thing, method)

    def timed(*arguments, **keywords):
        wp.synchronize()
        begin = time.perf_counter()
        result = plain(*arguments, **keywords)
        if isinstance(result, Iterator):
            result = list(result)
        wp.synchronize()
        spent[name] += time.perf_counter() - begin
        return result

    setattr(thing, method, timed)


def main():
    parser = sensor_arguments(__doc__, "batch.json")
    parser.add_argument("--batches", nargs="+", type=int, default=[1])
    parser.add_argument("--rounds", type=float, default=2.0, help="number of presses over the batch size")
    parser.add_argument("--trajectories", type=int, default=30)
    parser.add_argument("--profile", action="store_true")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="keys of the job to replace")
    asked = parser.parse_args()
    rows = []
    for batch in asked.batches:
        set_up = paired_presses(asked.sensor, asked.mesh, asked.trajectories, batch, asked.device, asked.set)
        scene, shapes, poses, depths = set_up.some(max(1, round(asked.rounds * batch)))
        press(scene, shapes[:1], poses[:1], depths[:1])  # compile kernels
        spent: dict[str, float] = defaultdict(float)
        if asked.profile:
            for name, (part, method) in PHASES.items():
                watch(attrgetter(part)(scene.solver), method, name, spent)
            watch(StateSampler, "take", "samples", spent)
        wp.synchronize()
        begin = time.perf_counter()
        results = press(scene, shapes, poses, depths)
        found = summary(results, time.perf_counter() - begin)
        phases = {name: round(seconds, 3) for name, seconds in spent.items()}
        rows.append({"batch": batch, "unknowns": scene.unknowns, **found, "phases": phases})
        print(rows[-1], flush=True)
    write(asked, rows)


if __name__ == "__main__":
    main()
