"""How many converged solves a second, by the number of presses that are under way at once? And where does time go?

    python benchmarks/batch.py --sensor digit --mesh default --device cuda --batches 32 128 256 --output batch.json

Presses of the full paired job, all nine indenters, to 2 mm in 20 depths. ``--profile`` waits for the device before and
after every phase of the solver, which costs some speed, and says how long each one took.
"""

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import warp as wp
from presses import paired_presses, summary
from record import write

from simgen.config.warp_device import start_warp
from simgen.simulation.press import press
from simgen.simulation.state_sampler import StateSampler

PHASES = {  # name: attributes of the solver, method
    "forces": ("balance", "measure"),
    "forces after an update of the multipliers": ("balance", "measure_surfaces"),
    "preconditioner": ("preconditioner", "follow"),
    "Krylov iterations": ("krylov", "go_on"),
}


def watch(thing, method: str, name: str, spent: dict[str, float]):
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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensor", default="digit")
    parser.add_argument("--mesh", default="default")
    parser.add_argument("--batches", nargs="+", type=int, default=[1])
    parser.add_argument("--rounds", type=float, default=2.0, help="presses, over those that are under way at once")
    parser.add_argument("--trajectories", type=int, default=30)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--profile", action="store_true")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="keys of the job to replace")
    parser.add_argument("--output", type=Path, default=Path("batch.json"))
    asked = parser.parse_args()
    start_warp()
    rows = []
    for batch in asked.batches:
        set_up = paired_presses(asked.sensor, asked.mesh, asked.trajectories, batch, asked.device, asked.set)
        scene, shapes, poses, depths = set_up.some(max(1, round(asked.rounds * batch)))
        press(scene, shapes[:1], poses[:1], depths[:1])  # loads kernels
        spent: dict[str, float] = defaultdict(float)
        if asked.profile:
            for name, (part, method) in PHASES.items():
                watch(getattr(scene.solver, part), method, name, spent)
            watch(StateSampler, "take", "samples", spent)
        wp.synchronize()
        begin = time.perf_counter()
        results = press(scene, shapes, poses, depths)
        found = summary(results, time.perf_counter() - begin)
        phases = {name: round(seconds, 3) for name, seconds in spent.items()}
        rows.append({"batch": batch, "unknowns": scene.unknowns, **found, "phases": phases})
        print(rows[-1], flush=True)
    plain = {name: str(value) for name, value in vars(asked).items()}
    write(asked.output, __doc__.splitlines()[0], asked.device, plain, rows)


if __name__ == "__main__":
    main()
