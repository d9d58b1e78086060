"""Measure the cost of `trajectories.least_thickness_left`: replaced contacts, and area without contacts.

    python benchmarks/refused.py [JOB]     # the tables of docs/design.md; 2 minutes on a core
"""

import sys
import time

import numpy as np

from simgen.config.job import load_job
from simgen.config.warp_device import start_warp
from simgen.dataset.touchable import touchable_surface
from simgen.pipeline.plan import chosen_sensor, first_contacts, gel_under_indenters, make_plan
from simgen.report.refused import NEAR, areas, contact_places
from simgen.sensors import pairing
from simgen.sensors.indenter import chosen_indenters

SHARES = (0.0, 0.1, 0.15, 0.2, 0.25, 0.3)


def presses_table(name: str) -> None:
    """Print, without the rule, the share of each indenter's presses that leave too little gel."""
    job = load_job(name)
    sensors, indenters = {sensor: chosen_sensor(job, sensor) for sensor in job.sensors}, chosen_indenters(job)
    contacts = first_contacts(job, sensors, job.trajectories.count, {}).kept
    reference, share = next(iter(sensors.values())), job.trajectories.least_thickness_left
    left = {}
    for sensor, measure in gel_under_indenters(job, sensors, indenters).items():
        poses = np.linalg.inv(pairing.unfold(reference, sensors[sensor], contacts)) @ pairing.indenter_poses(contacts)
        left[sensor] = measure.shares(poses)
    least = np.min([*left.values()], axis=0)
    columns = [*((f"in the back, core or support: {sensor}", own < 0.0) for sensor, own in left.items()),
               *((f"below {share:g}: {sensor}", own < share) for sensor, own in left.items()),
               (f"below {share:g}: any", least < share)]  # fmt: skip
    print("| indenter | " + " | ".join(title for title, _ in columns) + " |")
    print("|---" * (1 + len(columns)) + "|")
    for i, indenter in enumerate(indenters):
        print(f"| {indenter.name} | " + " | ".join(f"{failing[:, i].mean():.1%}" for _, failing in columns) + " |")
    print("| all | " + " | ".join(f"{failing.mean():.2%}" for _, failing in columns) + " |\n")


def refused_table(name: str) -> None:
    """Print, for several limits, the number of replaced contacts and the area near kept contacts."""
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
        draws = contact_places(arrays)
        refused, surface = len(draws.refused[0]), touchable_surface(arrays, next(iter(job.sensors)))
        before, after = (1e6 * area for area in areas(surface, draws, NEAR * job.depths_m.max()))
        part = refused / (refused + job.trajectories.count)
        print(f"| {share:g} | {refused} | {part:.1%} | {before:.0f} mm2 | {after:.0f} mm2 | {seconds:.1f} s |")


if __name__ == "__main__":
    start_warp()
    job_file = (sys.argv[1:] or ["paired"])[0]
    presses_table(job_file)
    refused_table(job_file)
