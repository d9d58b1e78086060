"""Measure the time of a GPU run by number of active presses, by phase of an iteration, and by kernel.

    python benchmarks/rounds.py --trajectories 216 --device cuda --output rounds.json

Runs the first trajectories of the paired job in this process, as a worker of `simgen run` does, into a folder that is
removed. A round is one call of `LoadStepping.advance`: an iteration, or a trial of a line search, of all active presses
of a sensor. The time of a phase excludes phases inside it: it is the host's own. The phase `_wait_for` is the time in
which the host waits for the device, so all phases together are the time of all rounds. `--wait` also waits after each
phase, which slows the run. Kernels and copies are timed in some rounds at each number of presses, without CUDA graphs.

One thread feeds the device. `--crew 3` uses three threads, as `simgen run` does. Rounds of several pools then overlap,
so only rounds are timed, not phases or kernels.
"""

import tempfile
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

import warp as wp
from record import arguments, write

from simgen.config.job import load_job
from simgen.fem import device
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.linear_solver.krylov import ConjugateResiduals
from simgen.fem.linear_solver.preconditioner import BlockTriangular
from simgen.fem.nonlinear.force_balance import ForceBalance
from simgen.fem.nonlinear.linear_systems import LinearSystems
from simgen.fem.nonlinear.newton import NewtonSolver
from simgen.pipeline.plan import make_plan
from simgen.pipeline.run import run
from simgen.pipeline.shard import prepare
from simgen.pipeline.workers import TASKS_PER_GPU_PROCESS, Workers
from simgen.simulation import pool
from simgen.simulation.load_stepping import LoadStepping
from simgen.simulation.state_sampler import StateSampler
from simgen.simulation.tries import Try

PHASES = {
    LoadStepping: ("_begin_increments", "_start_tries", "_repeat", "_accept_or_reject", "_store_samples"),
    StateSampler: ("overlap", "measure"),
    Try: ("keep",),
    device: ("_wait_for",),
    NewtonSolver: ("iterate", "_try_steps", "_damp", "_begin_solving"),
    LinearSystems: ("advance",),
    ForceBalance: ("measure", "measure_surfaces", "measure_step"),
    ConjugateResiduals: ("begin", "advance", "end"),
    BlockTriangular: ("rebuild_multigrid", "prepare"),
    Elasticity: ("stabilise", "linearize", "damp", "expect"),
}
AT_WORK = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024)  # lower bounds of the rows
# Least and most active presses, rounds to skip, rounds whose kernels are timed.
KERNELS = {"few": (1, 2, 40, 30), "some": (16, 64, 20, 30), "full": (500, 512, 150, 4)}


class Stopwatch:
    """Time and calls of nested phases, without inner phases; for one thread at a time."""

    def __init__(self, wait: bool):
        self.seconds, self.calls, self._inside, self._wait = defaultdict(float), defaultdict(int), [], wait

    def timed(self, name: str, function):
        """Wrap a function to time it."""
        def call(*args, **more):
            begin, _ = time.perf_counter(), self._inside.append(0.0)
            try:
                return function(*args, **more)
            finally:
                if self._wait:
                    wp.synchronize()
                spent = time.perf_counter() - begin
                self.seconds[name] += spent - self._inside.pop()
                self.calls[name] += 1
                if self._inside:
                    self._inside[-1] += spent

        return call

    def watch(self):
        """Time all `PHASES`."""
        for owner, names in PHASES.items():
            for name in names:
                setattr(owner, name, self.timed(f"{owner.__name__}.{name}", getattr(owner, name)))


class Rounds:
    """Sensor, active presses and time of each round, and kernel times of some."""

    def __init__(self, stopwatch: Stopwatch, on: str, of_kernels: bool):
        self.found, self.kernels, self._seen = [], defaultdict(lambda: defaultdict(float)), defaultdict(int)
        self._capture, self._of_kernels = True, of_kernels and not wp.get_device(on).is_cpu
        go_on, krylov = LoadStepping.advance, ConjugateResiduals.advance
        if of_kernels:
            go_on = stopwatch.timed("the rest of a round", go_on)

        def solve(solver, *args, **more):
            return krylov(solver, *args, **more | ({} if self._capture else {"capture": False}))

        def watched(stepping):
            kind, begin, at_work = self._kind(stepping), time.perf_counter(), int(stepping.running.sum())
            if kind:
                self._capture = False
                wp.timing_begin(cuda_filter=wp.TIMING_ALL)
            go_on(stepping)
            if kind:
                self._keep(kind, wp.timing_end(), time.perf_counter() - begin)
            else:
                self.found.append((stepping.scene.sensor.name, at_work, time.perf_counter() - begin))

        ConjugateResiduals.advance, LoadStepping.advance = solve, watched

    def _kind(self, stepping: LoadStepping) -> str | None:
        if not self._of_kernels:
            return None
        for kind, (least, most, before, count) in KERNELS.items():
            if least <= stepping.running.sum() <= most:
                self._seen[kind] += 1
                return kind if before < self._seen[kind] <= before + count else None
        return None

    def _keep(self, kind: str, timed: list, seconds: float):
        self._capture, own = True, self.kernels[kind]
        own["rounds"] += 1
        own["ms, all of the rounds"] += 1e3 * seconds
        for each in timed:
            own[f"ms, {each.name}"] += each.elapsed

    def rows(self) -> list[dict]:
        spent = defaultdict(list)
        for sensor, count, seconds in self.found:
            if count:
                spent[sensor, max(least for least in AT_WORK if least <= count)].append(seconds)
        return [{"sensor": sensor, "presses_at_work": least, "rounds": len(own),
                 "ms_a_round": round(1e3 * sum(own) / len(own), 2), "seconds": round(sum(own), 2)}
                for (sensor, least), own in sorted(spent.items())]  # fmt: skip


class Threads(Workers):
    """Threads of a worker, in this process."""

    def map(self, function, arguments):
        with ThreadPoolExecutor(self.tasks_at_once) as threads:
            tasks = {threads.submit(function, each): each for each in arguments}
            for task in as_completed(tasks):
                yield tasks[task], task.result()


def main():
    parser = arguments(__doc__, "rounds.json")
    parser.add_argument("--trajectories", type=int, default=216)
    parser.add_argument("--crew", type=int, choices=(1, 2, 3), default=1, help="threads that feed the device")
    parser.add_argument("--wait", action="store_true", help="wait for the device after each phase")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="keys of the job to replace")
    asked = parser.parse_args()
    pool.CREW = pool.Crew(asked.crew)
    stopwatch = Stopwatch(asked.wait)
    if asked.crew == 1:
        stopwatch.watch()
    rounds, reports = Rounds(stopwatch, asked.device, of_kernels=asked.crew == 1), []
    job = load_job("paired", [f"trajectories.count={asked.trajectories}", "outputs={}", *asked.set])
    plan = make_plan(job, asked.device)
    prepare(job, asked.device)
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        workers = Threads(asked.device, tasks_at_once=TASKS_PER_GPU_PROCESS)
        run(plan, Path(folder) / "dataset.zarr", workers, on_report=reports.append)
    seconds = time.perf_counter() - begin
    phases = {name: {"seconds": round(spent, 2), "calls": stopwatch.calls[name]}
              for name, spent in sorted(stopwatch.seconds.items(), key=lambda each: -each[1])}  # fmt: skip
    kernels = {kind: {name: round(value, 3) for name, value in sorted(own.items(), key=lambda each: -each[1])}
               for kind, own in rounds.kernels.items()}  # fmt: skip
    counts = {key: sum(getattr(report, key) for report in reports) for key in ("presses", "failed", "inside_out")}
    rows, measured = rounds.rows(), {"seconds": round(seconds, 1), "phases": phases, "kernels": kernels}
    write(asked, rows, **counts, **measured)
    for row in rows:
        print(row)


if __name__ == "__main__":
    main()
