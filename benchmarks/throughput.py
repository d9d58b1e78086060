"""Time a whole dataset, written and audited, over the number of workers or GPUs.

    python benchmarks/throughput.py --device cuda --workers 1 2 4 --trajectories 860 --output throughput.json

Runs the full paired job, or its first trajectories, into a folder that is removed afterwards. Solves are converged
samples of both sensors. The time includes set-up, loading of kernels, writing and the audit, which looks at each shard
as soon as it is written, as `simgen run --check` does. ``seconds_with_writing`` ends when all files are in place,
``seconds_with_audit`` when the audit and all processes have ended. ``seconds_of_solving_by_sensor`` is the average of
the workers. It includes loading at the first press, and excludes writing and the audit. Each number of workers has a
process of its own. The clock starts after its imports. The workers' imports count. Give no more workers than GPUs and
shards.
"""

import shutil
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from record import arguments, write

from simgen.config.job import load_job
from simgen.dataset.audit import passes
from simgen.dataset.running_audit import RunningAudit
from simgen.fem.nonlinear.status import has_values
from simgen.pipeline.plan import make_plan
from simgen.pipeline.run import run
from simgen.pipeline.workers import start_workers


def measure(job, device: str, workers: int, folder: Path) -> dict:
    """Run and audit the job once."""
    begin, reports = time.perf_counter(), []
    with start_workers(job, device, workers) as started, RunningAudit(folder) as audit:

        def on_report(report):
            reports.append(report)
            if not report.error:
                audit.look_at(report.shard)

        plan = make_plan(job, device)
        planned = time.perf_counter() - begin
        dataset = run(plan, folder, started, on_report=on_report, close_workers=True)
        solved = time.perf_counter() - begin
        findings = audit.findings()
    total = time.perf_counter() - begin
    solving = {sensor: sum(report.seconds_by_sensor[sensor] for report in reports if report.seconds_by_sensor)
               for sensor in job.sensors}  # fmt: skip
    status = {sensor: dataset[f"{sensor}/status"] for sensor in job.sensors}
    converged = sum(int(has_values(values).sum()) for values in status.values())
    return {
        "workers": workers,
        "presses": dataset.presses,
        "solves": sum(values.size for values in status.values()),
        "converged": converged,
        "presses_converged": int(np.logical_and.reduce([has_values(v).all(axis=1) for v in status.values()]).sum()),
        "outcomes": {str(code): sum(int((v == code).sum()) for v in status.values())
                     for code in np.unique(np.concatenate([v.ravel() for v in status.values()]))},
        "errors": sorted({report.error for report in reports if report.error}),
        "audit_passes": passes(findings),
        "audit_fails": [f"{f.subject}: {f.what}: {f.found}" for f in findings if f.failed],
        "seconds_to_plan": round(planned, 2),
        "seconds_of_solving_by_sensor": {sensor: round(seconds / workers, 1) for sensor, seconds in solving.items()},
        "seconds_with_writing": round(solved, 2),
        "seconds_with_audit": round(total, 2),
        "solves_per_second": round(converged / solved, 2),
    }  # fmt: skip


def main():
    parser = arguments(__doc__, "throughput.json")
    parser.add_argument("--trajectories", type=int, default=860)
    parser.add_argument("--workers", nargs="+", type=int, default=[1])
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="keys of the job to replace")
    asked = parser.parse_args()
    job = load_job("paired", [f"trajectories.count={asked.trajectories}", "outputs={}", *asked.set])
    rows = []
    for workers in asked.workers:
        folder = Path(tempfile.mkdtemp()) / "dataset.zarr"
        with ProcessPoolExecutor(1, get_context("spawn")) as fresh:
            rows.append(fresh.submit(measure, job, asked.device, workers, folder).result())
        shutil.rmtree(folder.parent)
        print(rows[-1], flush=True)
    write(asked, rows)


if __name__ == "__main__":
    main()
