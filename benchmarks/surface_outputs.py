"""Measure the cost of surface stress and traction: the same presses with and without them, in rounds.

    python benchmarks/surface_outputs.py --device cuda --presses 512 --rounds 3
"""

import argparse
import json
import time

from presses import paired_presses

from simgen.config.warp_device import check_device, start_warp
from simgen.simulation.press import press

OUTPUTS = "outputs={digit: [stress, traction]}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--mesh", default="default")
    parser.add_argument("--presses", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    start_warp()
    check_device(asked.device)
    batch = 1 if asked.device == "cpu" else asked.presses
    trajectories, depths = -(-asked.presses // 9), "depths_mm={first: 0.1, last: 1.0, count: 10}"
    kinds = {"plain": [depths], "with stress and traction": [depths, OUTPUTS]}
    ready = {kind: paired_presses("digit", asked.mesh, trajectories, batch, asked.device, overrides)
             for kind, overrides in kinds.items()}  # fmt: skip
    seconds = {kind: [] for kind in kinds}
    for round_ in range(asked.rounds + 1):  # the first one compiles
        for kind, presses in ready.items():
            begin = time.perf_counter()
            press(*presses.some(asked.presses))
            if round_:
                seconds[kind].append(round(time.perf_counter() - begin, 3))
    print(json.dumps({**vars(asked), "seconds": seconds}, indent=1))


if __name__ == "__main__":
    main()
