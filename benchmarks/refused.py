"""What `trajectories.least_thickness_left` costs: contacts that are drawn again, and touchable area without contacts.

    python benchmarks/refused.py [JOB]     # a table for docs/design.md; 2 minutes on a core
"""

import sys
import time

from simgen.job import load_job
from simgen.plan import make_plan
from simgen.report.refused import NEAR, areas, draws_of
from simgen.touchable import touchable_surface

SHARES = (0.0, 0.1, 0.15, 0.2, 0.25, 0.3)


def main(name: str) -> None:
    print("| share left, at least | drawn again | of all that fit otherwise | area of all | of the kept | plan |")
    print("|---|---|---|---|---|---|")
    for share in SHARES:
        job = load_job(name, [f"trajectories.least_thickness_left={share}"])
        begin = time.perf_counter()
        arrays = make_plan(job).arrays
        seconds = time.perf_counter() - begin
        if "refused/points" not in arrays:
            print(f"| {share:g} | 0 | | | | {seconds:.1f} s |")
            continue
        draws = draws_of(arrays)
        refused, surface = len(draws.refused[0]), touchable_surface(arrays, next(iter(job.sensors)))
        before, after = (1e6 * area for area in areas(surface, draws, NEAR * job.depths_m.max()))
        part = refused / (refused + job.trajectories.count)
        print(f"| {share:g} | {refused} | {part:.1%} | {before:.0f} mm2 | {after:.0f} mm2 | {seconds:.1f} s |")


if __name__ == "__main__":
    main(*(sys.argv[1:] or ["paired"]))
