"""Console views: dry run, progress and status of a run, audit, export and import."""

import signal
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
    track,
)
from rich.table import Table

from simgen.config.job_schema import Job
from simgen.config.outputs import VERTEX
from simgen.dataset.audit import passes
from simgen.dataset.audit_finding import Finding
from simgen.pipeline.run_status import RunStatus

if TYPE_CHECKING:  # these need the solver; an audit does not
    from simgen.dataset.exchange.selection import PressSelection
    from simgen.dataset.reader import Dataset
    from simgen.pipeline.parts import ShardReport
    from simgen.pipeline.preview import Preview
    from simgen.pipeline.workers import Workers

console = Console(highlight=False)
INTERRUPTED = 130


def print_preview(job: Job, seen: "Preview", output: Path, device: str) -> None:
    """Print size, time and memory of a job, and the terms of each sensor's scene."""
    sensors = " and ".join(sensor.name for sensor in seen.sensors)
    console.print(f"[bold]{job.name}[/]  job {job.hash[:12]}  ->  {output}")
    console.print(
        f"{seen.trajectories:,} trajectories x {job.indenters_in_words} x {job.steps_in_words} = "
        f"[bold]{seen.samples:,} samples[/], "
        f"each on {sensors}, in {seen.shards:,} shards"
    )
    some = "all" if seen.contacts == seen.trajectories else f"the first {seen.contacts:,} of"
    console.print(f"contacts: {some} {seen.trajectories:,} fit{_replaced(job, seen)}")
    console.print(f"size: about {_size(seen.bytes)} ({seen.bytes_source})")
    device_name = "core" if device == "cpu" else device
    console.print(f"time: about {_time(seen.seconds)} of one {device_name} ({seen.seconds_source})")
    for sensor in seen.sensors:
        under_way = "one press" if sensor.at_once == 1 else f"at most {sensor.at_once} presses at once"
        material = sensor.material
        console.print(
            f"\n[bold]{sensor.name}[/]: {sensor.tetrahedra:,} tetrahedra, {sensor.nodes:,} nodes, "
            f"{sensor.unknowns:,} unknowns; {sensor.axis_lengths[VERTEX]:,} output vertices; "
            f"memory: {_size(sensor.bytes_per_press * sensor.at_once)} for {under_way}; "
            f"{material.elasticity}, friction {material.friction:g}"
        )
        table = Table("term", "carried", "why", box=None, pad_edge=False, padding=(0, 2, 0, 0))
        for term, carried, why in sensor.terms:
            table.add_row(term, "[green]yes[/]" if carried else "no", why)
        console.print(table)
        print_remarks(sensor.remarks)


def _replaced(job: Job, seen: "Preview") -> str:
    """Share of the proposals that the sampler replaces because they leave too little gel; "" if it replaces none."""
    left = job.trajectories.least_thickness_left
    if not left or job.stops_early or job.trajectories.contacts:
        return ""
    share = seen.refused / (seen.refused + seen.contacts)
    bad = f"leave less than {left:g} of the gel or enter the support"
    return f"; {share:.1%} of the proposals would {bad} and are replaced"


def print_remarks(remarks: Iterable[str]) -> None:
    for remark in remarks:
        console.print(f"[yellow]{escape(remark)}[/]", soft_wrap=True)


def run_with_progress(
    job: Job, output: Path, workers: int | None, scheduler: str | None, device: str, again: Collection[int] = (),
    check: bool = False,
) -> int:  # fmt: skip
    """Run a job with a progress bar; return how many shards could not be written, plus how many findings fail.

    again : shards to solve again
    check : look at each shard as soon as it is written, and print all findings at the end

    Raises `SystemExit` with code 130 for an interrupt.
    """
    from simgen.dataset.growth import finish_growth
    from simgen.dataset.running_audit import RunningAudit
    from simgen.dataset.writer import check_output, has_all
    from simgen.pipeline.plan import make_plan
    from simgen.pipeline.run import run
    from simgen.pipeline.workers import start_workers

    finish_growth(output)
    check_output(output, job)
    if not again and has_all(output, job):
        scheduler = "sync"  # starts no processes
    bar = RunProgress(job)
    try:
        with start_workers(job, device, workers, scheduler) as started, RunningAudit(output) as audit:

            def on_report(report: "ShardReport") -> None:
                bar.on_report(report)
                if check and scheduler != "sync" and not report.error:
                    audit.look_at(report.shard)

            bar.workers = started
            with console.status("sampling contacts and posing them on each sensor"):
                plan = make_plan(job, device)
            print_remarks(plan.remarks)
            signal.signal(signal.SIGINT, signal.getsignal(signal.SIGINT))  # the mesher's native code resets it
            if workers and scheduler not in (None, "sync"):
                console.print(f"waiting for {workers} workers at {scheduler}, at most 5 minutes", soft_wrap=True)
            with bar.progress:
                dataset = run(plan, output, started, bar.on_start, on_report, again=again, close_workers=True)
            with console.status("checking the dataset"):
                findings = audit.findings() if check else []
    except KeyboardInterrupt:
        stop(output)
    present = sum(len(dataset.shard_presses(shard)) for shard in dataset.finished())
    console.print(f"{output}: {present} of {dataset.presses} presses; {bar.failures()}")
    if findings:
        print_findings(output, findings)
    next_check = "" if findings and passes(findings) else f"simgen check {output}{' --repair' * check}  and  "
    console.print(f"next: {next_check}simgen report {output}")
    return bar.errors + sum(finding.failed for finding in findings)


def stop(output: Path) -> NoReturn:
    """End a command that was interrupted. Raises `SystemExit`."""
    console.print(f"stopped; the same command continues from {output}")
    raise SystemExit(INTERRUPTED) from None


class RunProgress:
    """A progress bar over presses, with presses per second, time left and failures."""

    def __init__(self, job: Job):
        self.progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("presses  {task.fields[rate]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[failures]}"),
            console=console,
        )
        self.done = self.already = self.failed = self.planned = self.inside_out = self.errors = 0
        self.workers: Workers | None = None
        self.presses, self.began = job.presses, time.monotonic()
        self.bar = self.progress.add_task(job.name, total=job.presses, rate="starting", failures="")

    def on_start(self, already: int) -> None:
        """Start the clock; an earlier run has written ``already`` presses."""
        self.done = self.already = already
        self.began = time.monotonic()
        self.progress.update(self.bar, completed=already, rate="no rate yet")
        if already < self.presses:
            self.progress.console.print(self.workers.about, soft_wrap=True)

    def on_report(self, report: "ShardReport") -> None:
        """Count the presses of a shard that has ended."""
        if report.error:
            self.errors += 1
            self.progress.console.print(f"[red]shard {report.shard} was not written: {escape(report.error)}[/]")
        else:
            self.done += report.presses
            self.failed += report.failed
            self.planned += report.planned
            self.inside_out += report.inside_out
        rate = (self.done - self.already) / (time.monotonic() - self.began)
        self.progress.update(self.bar, completed=self.done, rate=f"{rate:.3g}/s", failures=self.failures())

    def failures(self) -> str:
        """Counts of failed, inverted and planned samples, and of unwritten shards."""
        inverted = f", {self.inside_out} inverted" if self.inside_out else ""
        planned = f", {self.planned} not pressed, as planned" if self.planned else ""
        shards = f", {self.errors} shards not written" if self.errors else ""
        return f"{self.failed or 'no'} samples failed{inverted}{planned}{shards}"


def print_findings(path: Path, findings: list[Finding]) -> None:
    """Print the audit's table, its notes, and whether the dataset passes."""
    table = Table("", "", "found", "allowed", "", box=box.SIMPLE_HEAD, pad_edge=False)
    stated, ok, fail = "", "[green]ok[/]", "[bold red]FAIL[/]"
    previous = None
    for finding in findings:
        if previous not in (None, finding.subject):
            table.add_section()
        mark = fail if finding.failed else stated if finding.passed is None else ok
        subject = finding.subject if finding.subject != previous else ""
        table.add_row(subject, finding.what, finding.found, finding.allowed, mark)
        previous = finding.subject
    console.print(table)
    for finding in findings:
        for line in finding.note.splitlines():
            console.print(f"{finding.subject}: {escape(line)}", soft_wrap=True)
    failures = sum(finding.failed for finding in findings)
    fails = f"[bold red]fails[/] in {failures} of {len(findings)} points"
    console.print(f"{path} {'[green]passes[/]' if passes(findings) else fails}")


def print_status(path: Path, found: RunStatus, outcomes: Mapping[str, int]) -> None:
    """Print the progress of a run and how many samples have each outcome."""
    share = 100.0 * found.finished / found.presses
    console.print(f"{path}: {found.finished} of {found.presses} presses, {share:.1f} %")
    if found.at_work:
        console.print(f"running: {found.at_work}", soft_wrap=True)
    elif found.finished < found.presses:
        console.print("no process is running; the command that began the run continues it")
    if found.last_s is not None:
        rate = f"; {found.rate:.3g} presses a second since the run began" if found.rate else ""
        console.print(f"last shard: {_time(found.last_s)} ago{rate}")
    if found.left_s is not None:
        console.print(f"left: about {_time(found.left_s)}")
    for outcome, count in outcomes.items():
        console.print(f"{count} samples {outcome}", soft_wrap=True)
    for shard, error in found.errors.items():
        console.print(f"[red]shard {shard} was not written: {escape(error)}[/]", soft_wrap=True)


def tracked(sequence: Sequence, description: str) -> Iterable:
    """The items of a loop, with a progress bar."""
    return track(sequence, description, console=console, transient=True, disable=not console.is_terminal)


def print_export(folder: Path, selection: "PressSelection", files: Sequence[Path]) -> None:
    there, of = selection.paired.sum(), selection.paired.size
    size = _size(sum(file.stat().st_size for file in files))
    console.print(f"{folder}: {len(files)} files, {size}; {there} of {of} samples on {' and '.join(selection.sensors)}")
    if missing := selection.dataset.unfinished():
        console.print(f"the run is unfinished: {len(missing)} of {selection.dataset.shards} shards are missing")


def print_import(dataset: "Dataset") -> None:
    left_out = dataset.attributes["source"]["samples_left_out"]
    for sensor in dataset.sensors:
        status = dataset[f"{sensor}/status"]
        console.print(f"{dataset.path}: {sensor}: {(status == 0).sum()} of {status.size} samples came from the files")
    if left_out:
        console.print(f"{left_out} samples were left out: far from each depth of the dataset, or not the nearest")
    console.print(f"next: simgen check {dataset.path}")


def _size(count: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count / 1e3:.3g} kB"


def _time(seconds: float) -> str:
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.0f} seconds"
