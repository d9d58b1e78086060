"""Measure all networks on the whole paired dataset in one sitting, from `simgen run` to `simgen translate`.

    python benchmarks/one_sitting.py sitting --devices cuda:0 cuda:1 cuda:2 cuda:3

The folder gets the dataset without error estimates, the paper's networks and ours with their tables, edges, and images.
It also gets RMB, S2RM and PT with an indenter left out. `sitting.json` has the figures of all tables and edges.
`times.csv` has the seconds of each step, and `<step>.log` what it printed. First the dataset is simulated. Then a step
starts on the first free device as soon as the steps that it needs have succeeded. If a step fails, the steps that need
it are skipped, and the others go on. The same command continues. It repeats only steps that have failed or were
interrupted, and steps whose command is now another.
"""

import argparse
import csv
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from record import write
from sitting_figures import figures

from simgen.learning.data.registry import NETWORKS
from simgen.learning.translation.translator import networks_of

EDGES = Path(__file__).parent / "translated_edges.py"
PAPER = [name for name, spec in NETWORKS.items() if spec.published]
OURS = [name for name in NETWORKS if name not in PAPER]
POLL_S = 0.1


@dataclass(frozen=True)
class Step:
    """A command that needs one device. ``needs`` names the steps before it."""

    name: str
    command: Sequence[str]
    needs: tuple[str, ...] = ()


def simgen(*words: str) -> list[str]:
    return [sys.executable, "-m", "simgen.cli", *words]


def steps(asked: argparse.Namespace) -> list[Step]:
    """List the steps of a sitting; earlier ones start first."""
    data, translated = asked.folder / "paired.zarr", asked.folder / "translated"
    ours, paper = (asked.folder / f"{name}.networks" for name in ("ours", "paper"))

    def train(networks: Sequence[str], output: Path, *more: str) -> list[str]:
        chosen = f"networks=[{','.join(networks)}]"
        return simgen("train", asked.training, f"dataset={data}", chosen, "-o", str(output), *asked.train_keys, *more)

    def edges(way: str, networks: Path, name: str, *more: str) -> list[str]:
        output = str(asked.folder / f"edges_{name}.json")
        return [sys.executable, str(EDGES), str(networks), str(data), "--way", way, "--output", output,
                "--presses", str(asked.presses), *more]  # fmt: skip

    # MVD takes longest, so it comes first. M2MPN needs MVD and MVB: the step with the tables trains it.
    return [
        Step("mvd", train(["mvd"], paper, "--no-tables")),
        Step("mvb", train(["svb", "mvb", "s2mpn"], paper, "--no-tables")),
        Step("ours", train(OURS, ours)),
        *(
            Step(f"without_{name}", train(networks_of("points"), asked.folder / f"without_{name}.networks",
                                          f"leave_out={name}", *asked.left_out_keys))
            for name in asked.leave_out
        ),
        Step("paper", train(PAPER, paper), ("mvd", "mvb")),
        Step("edges_points", edges("points", ours, "points"), ("ours",)),
        Step("edges_true_mesh", edges("points", ours, "true_mesh", "--true-meshes"), ("ours",)),
        Step("translate", simgen("translate", str(ours), str(data), "--hypotheses", "4", "-o", str(translated),
                                 "--workers", "1", *asked.translate), ("ours",)),
        Step("edges_ours", edges("ours", ours, "ours"), ("ours",)),
        Step("edges_paper", edges("paper", paper, "paper"), ("paper",)),
    ]  # fmt: skip


class Sitting:
    """Runs steps on devices and records them in a folder. ``succeeded`` names the steps that ended with 0."""

    def __init__(self, folder: Path, devices: Sequence[str]):
        self.folder, self.devices = folder, devices
        folder.mkdir(parents=True, exist_ok=True)
        self.times = folder / "times.csv"
        self.succeeded: set[str] = set()
        self._running: dict[int, tuple[Step, subprocess.Popen, float]] = {}  # by place in devices: "cpu" may come twice

    def run(self, steps: Sequence[Step]) -> bool:
        """Run steps, at most one on a device at a time. Returns False if one failed or was skipped.

        Raises `ValueError` for a step that needs an unknown one.
        """
        names = {step.name for step in steps}
        for step in steps:
            if unknown := {*step.needs} - names - self.succeeded:
                raise ValueError(f"{step.name} needs {', '.join(sorted(unknown))}; allowed: steps of the list")
        before = {(row["step"], row["command"]) for row in self.rows() if row["exit_code"] == "0"}
        self.succeeded |= {step.name for step in steps if (step.name, shlex.join(step.command)) in before}
        waiting = [step for step in steps if step.name not in self.succeeded]
        try:
            while waiting or self._running:
                self._collect()
                ready = [step for step in waiting if {*step.needs} <= self.succeeded]
                free = [place for place in range(len(self.devices)) if place not in self._running]
                for place, step in zip(free, ready, strict=False):
                    waiting.remove(step)
                    self._start(step, place)
                if waiting and not self._running:  # all others need a step that has failed
                    for step in waiting:
                        print(f"{step.name}: skipped, since a step that it needs has failed", flush=True)
                    break
                time.sleep(POLL_S)
        finally:
            for _, process, _ in self._running.values():  # an interrupted step is not recorded
                process.terminate()
            for _, process, _ in self._running.values():
                process.wait()
        return names <= self.succeeded

    def rows(self) -> list[dict[str, str]]:
        """Read the record of the steps that have ended, also in earlier runs."""
        if not self.times.exists():
            return []
        with self.times.open(newline="") as file:
            return list(csv.DictReader(file))

    def _start(self, step: Step, place: int) -> None:
        device = self.devices[place]
        print(f"{step.name}: starts on {device}", flush=True)
        with (self.folder / f"{step.name}.log").open("w") as log:
            command = [*step.command, "--device", device]
            process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
        self._running[place] = step, process, time.time()

    def _collect(self) -> None:
        """Record the steps that have ended."""
        for place, (step, process, begin) in [*self._running.items()]:
            if (code := process.poll()) is None:
                continue
            del self._running[place]
            if code == 0:
                self.succeeded.add(step.name)
            seconds = round(time.time() - begin, 1)
            self._record(step=step.name, device=self.devices[place], begin=round(begin, 1), seconds=seconds,
                         exit_code=code, command=shlex.join(step.command))  # fmt: skip
            print(f"{step.name}: {seconds} s, exit code {code}", flush=True)

    def _record(self, **row: Any) -> None:
        new = not self.times.exists()
        with self.times.open("a", newline="") as file:
            writer = csv.DictWriter(file, list(row))
            if new:
                writer.writeheader()
            writer.writerow(row)


def main(words: Sequence[str] | None = None) -> bool:
    """Run a sitting with the given command line. Returns True if all steps have succeeded."""
    title = __doc__.splitlines()[0]
    parser = argparse.ArgumentParser(description=title)
    parser.set_defaults(question=title)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--devices", nargs="+", default=["cuda:0"], help="with several, all GPUs simulate")
    parser.add_argument("--job", default="paired", help="of `simgen run`")
    parser.add_argument("--run-keys", nargs="*", default=["outputs={}"], metavar="KEY=VALUE")
    parser.add_argument("--training", default="training", help="of `simgen train`")
    parser.add_argument("--train-keys", nargs="*", default=[], metavar="KEY=VALUE")
    parser.add_argument("--leave-out", nargs="*", default=["cube_14mm", "sphere_7mm"], metavar="INDENTER")
    parser.add_argument("--left-out-keys", nargs="*", default=[], metavar="KEY=VALUE", help="of these trainings alone")
    parser.add_argument("--presses", type=int, default=40, help="of each indenter, whose edges are compared")
    parser.add_argument(
        "--translate", nargs=argparse.REMAINDER, default=[], metavar="OPTION", help="of `simgen translate`; comes last"
    )
    asked = parser.parse_args(words)
    asked.output, asked.device = asked.folder / "sitting.json", asked.devices[0]
    data = Step("data", simgen("run", asked.job, *asked.run_keys, "-o", str(asked.folder / "paired.zarr")))
    everywhere = asked.devices[0].partition(":")[0] if len(asked.devices) > 1 else asked.devices[0]
    simulated = Sitting(asked.folder, [everywhere]).run([data])
    sitting = Sitting(asked.folder, asked.devices)
    succeeded = simulated and sitting.run(steps(asked))
    write(asked, sitting.rows(), **figures(asked.folder))
    return succeeded


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that its steps end, too
    sys.exit(0 if main() else 1)
