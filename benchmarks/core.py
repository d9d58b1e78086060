"""Measure the time of presses on one core, one after the other and eight at once, in turn, and by kernel.

    python benchmarks/core.py --meshes coarse default --output core.json

Presses are those of the first trajectories of the paired job, in random order, with all nine indenters. Times are those
of this process's core. Displacements of both ways are compared. Kernels are timed in further presses, without graphs,
which takes longer.
"""

import time
from collections import defaultdict
from dataclasses import replace

import numpy as np
import warp as wp
from presses import Presses, paired_presses, summary
from record import arguments, write

from simgen.fem.groups import WIDTH
from simgen.fem.linear_solver.krylov import ConjugateResiduals
from simgen.simulation.press import Scene, press


def timed(presses: Presses, count: int) -> tuple[float, list]:
    begin = time.process_time()
    results = press(*presses.some(count))
    return time.process_time() - begin, results


def kernel_times(presses: Presses, count: int) -> dict[str, float]:
    """Milliseconds per depth of each kernel, and of all the rest."""
    spent, launch, advance = defaultdict(float), wp.launch, ConjugateResiduals.advance

    def watched(kernel, *args, **more):
        begin = time.process_time()
        launch(kernel, *args, **more)
        spent[kernel.key] += time.process_time() - begin

    wp.launch = watched
    ConjugateResiduals.advance = lambda solver, *args, capture=False, **more: advance(solver, *args, **more)
    try:
        seconds, _ = timed(presses, count)
    finally:
        wp.launch, ConjugateResiduals.advance = launch, advance
    spent["rest"] = seconds - sum(spent.values())
    depths = count * len(presses.depths_m)
    return {name: round(1e3 * spent[name] / depths, 3) for name in sorted(spent, key=spent.get, reverse=True)}


def main():
    parser = arguments(__doc__, "core.json")
    parser.add_argument("--sensor", default="digit")
    parser.add_argument("--meshes", nargs="+", default=["coarse", "default"])
    parser.add_argument("--presses", type=int, default=16)
    parser.add_argument("--depths", type=int, default=10, help="number of depths, 0.1 mm apart")
    parser.add_argument("--repeats", type=int, default=2)
    asked = parser.parse_args()
    rows = []
    for mesh in asked.meshes:
        drawn = paired_presses(asked.sensor, mesh, -(-asked.presses // 9), 1, "cpu")
        drawn = replace(drawn, depths_m=drawn.depths_m[: asked.depths])
        scene = drawn.scene
        wide = Scene(scene.sensor, scene.material, batch=WIDTH, settings=scene.settings)
        ways = [drawn, replace(drawn, scene=wide)]
        for way in ways:
            press(*way.some(WIDTH)[:3], drawn.depths_m[:1])  # compile kernels
        seconds, results = [[], []], [None, None]
        for _ in range(asked.repeats):
            for i, way in enumerate(ways):
                spent, results[i] = timed(way, asked.presses)
                seconds[i].append(round(spent, 2))
        pairs = zip(*results, strict=True)
        same = all(a.displacement.tobytes() == b.displacement.tobytes() for a, b in pairs)
        for i, way in enumerate(ways):
            of_all = {**summary(results[i], float(np.median(seconds[i]))), "seconds": seconds[i]}
            row = {"mesh": mesh, "unknowns": scene.unknowns, "at_once": way.scene.batch, **of_all, "same_bytes": same}
            rows.append({**row, "ms_per_depth_of_kernels": kernel_times(way, asked.presses)})
            print({key: value for key, value in rows[-1].items() if key != "ms_per_depth_of_kernels"}, flush=True)
    write(asked, rows)


if __name__ == "__main__":
    main()
