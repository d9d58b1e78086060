"""Measure all networks on the whole paired dataset in one sitting, from `simgen run` to `simgen translate`.

    python benchmarks/one_sitting.py sitting --devices cuda:0 cuda:1 cuda:2 cuda:3

The folder gets the dataset, the paper's networks and ours with their tables, ours with an indenter left out, edges, and
images. `times.csv` has the seconds of each step, and `<step>.log` what it printed. All GPUs simulate the dataset. Then
each step starts on the first device that is free, once all steps have succeeded that it needs. If a step fails, those
that need it are skipped, and the others go on. The same command continues: it runs no step again that has succeeded.
"""

import argparse
import csv
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from simgen.learning.data.registry import NETWORKS, WAYS

EDGES = Path(__file__).parent / "translated_edges.py"
OURS = [name for name, spec in NETWORKS.items() if "(ours)" in spec.label]
PAPER = [name for name in NETWORKS if name not in OURS]
POINTS = [*WAYS["points"], "rmb"]


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

    # MVD takes longest. M2MPN needs it and MVB, so that it is trained with the tables.
    found = [
        Step("mvd", train(["mvd"], paper, "--no-tables")),
        Step("mvb", train(["svb", "mvb", "s2mpn"], paper, "--no-tables")),
        Step("ours", train(OURS, ours)),
        *(
            Step(f"without_{name}", train(POINTS, asked.folder / f"without_{name}.networks", f"leave_out={name}"))
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
    return found


class Sitting:
    """Runs steps on devices and records them in a folder. ``succeeded`` names the steps that ended with 0."""

    def __init__(self, folder: Path, devices: Sequence[str]):
        self.folder, self.devices = folder, devices
        folder.mkdir(parents=True, exist_ok=True)
        self.times = folder / "times.csv"
        self.succeeded = {row["step"] for row in self._rows() if row["exit_code"] == "0"}
        self._ended = set(self.succeeded)
        self._change = threading.Condition()

    def run(self, given: Sequence[Step]) -> bool:
        """Run steps, each on one device. Returns False if one failed or was skipped."""
        self._waiting = [step for step in given if step.name not in self.succeeded]
        threads = [threading.Thread(target=self._work, args=(device,)) for device in self.devices]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return all(step.name in self.succeeded for step in given)

    def alone(self, step: Step, device: str) -> bool:
        """Run one step before the others. Returns True if it has succeeded, now or before."""
        if step.name not in self.succeeded:
            self._execute(step, device)
        return step.name in self.succeeded

    def _work(self, device: str) -> None:
        while (step := self._next()) is not None:
            self._execute(step, device)

    def _next(self) -> Step | None:
        """Take the first step whose needs have succeeded; wait for one; None if there will be none."""
        with self._change:
            while self._waiting:
                self._waiting = [step for step in self._waiting if not self._is_lost(step)]
                for step in self._waiting:
                    if set(step.needs) <= self.succeeded:
                        self._waiting.remove(step)
                        return step
                if self._waiting:
                    self._change.wait()
            return None

    def _is_lost(self, step: Step) -> bool:
        lost = any(need in self._ended - self.succeeded for need in step.needs)
        if lost:
            self._ended.add(step.name)
            print(f"{step.name}: skipped, since a step that it needs has failed", flush=True)
        return lost

    def _execute(self, step: Step, device: str) -> None:
        print(f"{step.name}: starts on {device}", flush=True)
        begin = time.time()
        with (self.folder / f"{step.name}.log").open("w") as log:
            command = [*step.command, "--device", device]
            code = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL).returncode
        with self._change:
            self._record(step.name, device, begin, time.time(), code)
            self._ended.add(step.name)
            if code == 0:
                self.succeeded.add(step.name)
            self._change.notify_all()

    def _record(self, name: str, device: str, begin: float, end: float, code: int) -> None:
        new = not self.times.exists()
        with self.times.open("a", newline="") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(("step", "device", "begin", "seconds", "exit_code"))
            writer.writerow((name, device, round(begin, 1), round(end - begin, 1), code))
        print(f"{name}: {end - begin:.1f} s, exit code {code}", flush=True)

    def _rows(self) -> list[dict[str, str]]:
        if not self.times.exists():
            return []
        with self.times.open(newline="") as file:
            return list(csv.DictReader(file))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--devices", nargs="+", default=["cuda:0"], help="one step at a time on each")
    parser.add_argument("--job", default="paired", help="of `simgen run`")
    parser.add_argument("--run-keys", nargs="*", default=["outputs={}"], metavar="KEY=VALUE")
    parser.add_argument("--training", default="training", help="of `simgen train`")
    parser.add_argument("--train-keys", nargs="*", default=[], metavar="KEY=VALUE")
    parser.add_argument("--leave-out", nargs="*", default=["cube_14mm", "sphere_7mm"], metavar="INDENTER")
    parser.add_argument("--presses", type=int, default=40, help="of each indenter, whose edges are compared")
    parser.add_argument(
        "--translate", nargs=argparse.REMAINDER, default=[], metavar="OPTION", help="of `simgen translate`; comes last"
    )
    asked = parser.parse_args()
    sitting = Sitting(asked.folder, asked.devices)
    data = simgen("run", asked.job, *asked.run_keys, "-o", str(asked.folder / "paired.zarr"))
    everywhere = asked.devices[0].partition(":")[0]  # all GPUs, or the CPU
    succeeded = sitting.alone(Step("data", data), everywhere) and sitting.run(steps(asked))
    raise SystemExit(0 if succeeded else 1)


if __name__ == "__main__":
    main()
