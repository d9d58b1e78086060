"""The command line: parsing and printing. Each command calls a few functions that Python code can call, too.

Commands import what they need when they run, so that ``simgen --help`` is quick.
"""

import atexit
import gc
import logging
import os
import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from simgen import __version__
from simgen.cli import exchange, images
from simgen.cli.calibrate_material import calibrate_material
from simgen.cli.options import (
    DatasetFolder,
    Device,
    Processes,
    Scheduler,
    SchedulerFile,
    Workers,
    named_after,
    scheduler_address,
)
from simgen.cli.view import view
from simgen.config.resources import bundled_jobs
from simgen.errors import InputError, check_output_file, needs_extra

app = typer.Typer(
    name="simgen",
    help="Simulate paired touch for two tactile sensors by quasi-static finite elements.",
    epilog="To begin: simgen run jobs/smoke.yaml, then simgen check smoke.zarr, then simgen report smoke.zarr.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

BUNDLED, TRAINING = (", ".join(file.stem for file in bundled_jobs(training)) for training in (False, True))

JobFile = Annotated[str, typer.Argument(metavar="JOB", help=f"A job file, or a bundled job: {BUNDLED}.")]
TrainingJobFile = Annotated[
    str, typer.Argument(metavar="JOB", help=f"A training job, or a bundled one: {TRAINING}.")
]
Overrides = Annotated[
    list[str] | None, typer.Argument(metavar="KEY=VALUE", help="Replace keys of the job: trajectories.count=10")
]
TrainingOverrides = Annotated[
    list[str] | None,
    typer.Argument(metavar="KEY=VALUE", help=r'Replace keys of the job: "networks=\[rmb, rmd]"'),  # no markup of rich
]


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"simgen {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
):
    """Simulate paired touch for two tactile sensors by quasi-static finite elements."""


@app.command()
def run(
    job: JobFile,
    overrides: Overrides = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the dataset.", show_default="<job name>.zarr"),
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    scheduler_file: SchedulerFile = None,
    device: Device = "cpu",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Sample the contacts and estimate size and time; solve nothing.")
    ] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Check shards while the run goes on; print what simgen check finds.")
    ] = False,
):
    """Press a job's indenters into its sensors and write the paired dataset.

    You can stop a run at any time. The same command continues it. Exit code 1 if shards could not be written or, with
    --check, if the dataset fails.
    """
    from simgen.config.job import load_job

    checked = load_job(job, overrides or ())
    if dry_run:
        from simgen.cli.console import print_preview
        from simgen.config.warp_device import check_device_name
        from simgen.pipeline.preview import preview

        check_device_name(device)  # the GPU may be another machine's
        print_preview(checked, preview(checked, device), output or checked.output(), device)
        return
    address = scheduler_address(scheduler, scheduler_file)
    if address is None:
        from simgen.pipeline.forked_imports import start_imports

        start_imports()  # workers' imports run while this process imports
    from simgen.cli.console import run_with_progress

    if run_with_progress(checked, output or checked.output(), workers, address, device, check=check):
        raise typer.Exit(1)


@app.command()
def train(
    job: TrainingJobFile,
    overrides: TrainingOverrides = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the networks.", show_default="<job name>.networks"),
    ] = None,
    device: Device = "cpu",
    tensorboard: Annotated[
        bool, typer.Option("--tensorboard", help="Also write logs for tensorboard into the folder.")
    ] = False,
    no_tables: Annotated[
        bool,
        typer.Option("--no-tables", help="Train and do not measure. So several GPUs can train networks of one folder."),
    ] = False,
):
    """Train a job's networks on a dataset, then measure them on the test trajectories.

    You can stop training at any time. The same command continues it and keeps the networks that are trained.
    """
    with needs_extra("training"):
        from simgen.cli.train import train_with_progress

    from simgen.learning.data.schema import load_training_job

    checked = load_training_job(job, overrides or ())
    train_with_progress(checked, output or checked.output_folder(), device, tensorboard, tables=not no_tables)


@app.command()
def mesh(
    sensor: Annotated[
        str, typer.Argument(metavar="SENSOR", help="digit, biotac, gelsight_mini, or a folder with a sensor.yaml.")
    ],
):
    """Make a sensor's meshes again, check them by the quality gates, and write them beside its sensor.yaml."""
    from simgen.sensors.sensor import remake

    for line in remake(sensor):
        typer.echo(line)


@app.command()
def check(
    dataset: DatasetFolder,
    repair: Annotated[
        bool, typer.Option("--repair", help="Solve damaged and missing shards again, and no others.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write all findings, with the samples they name.")
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    scheduler_file: SchedulerFile = None,
):
    """Audit a dataset: files, certificates, pairing, splits, fixed and touchable vertices.

    Exit code 1 if the dataset fails. The audit names the bad samples. Samples that did not converge do not count as
    damaged, and --repair leaves them as they are.
    """
    from simgen.cli.console import print_findings, run_with_progress
    from simgen.dataset.audit import check, passes, to_repair
    from simgen.dataset.reader import Dataset

    def audit(opened: Dataset) -> list:
        findings = check(opened)
        print_findings(dataset, findings)
        _write_findings(findings, json_file)
        return findings

    opened = Dataset(dataset)
    findings = audit(opened)
    if repair and (shards := to_repair(opened, findings)):
        address = scheduler_address(scheduler, scheduler_file)
        if run_with_progress(opened.job, dataset, workers, address, opened.attributes["device"], shards):
            raise typer.Exit(1)
        findings = audit(Dataset(dataset))
    if not passes(findings):
        raise typer.Exit(1)


@app.command()
def status(dataset: DatasetFolder):
    """Show the progress of a run: presses, failures, active workers, speed, time left."""
    from simgen.cli.console import print_status
    from simgen.dataset.layout import checked
    from simgen.dataset.reader import Dataset
    from simgen.pipeline.run_status import outcomes, run_status

    opened = checked(Dataset(dataset))
    print_status(dataset, run_status(opened), outcomes(opened))


@app.command()
def report(
    dataset: DatasetFolder,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="HTML file to write.", show_default="<dataset name>.html"),
    ] = None,
    networks: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Networks that `simgen train` wrote: adds a press that they translated."),
    ] = None,
):
    """Write a self-contained HTML page: coverage, failures, a press in motion and in 3-D, contact patches, forces."""
    from simgen.dataset.layout import checked
    from simgen.dataset.reader import Dataset
    from simgen.report import write_report

    opened = Dataset(dataset)
    if opened.imported:
        raise InputError(f"{dataset}: imported, without the contacts and certificates of a report; see simgen check")
    checked(opened)
    page = output or named_after(dataset, ".html")
    check_output_file(page)
    more = {}
    if networks is not None:
        with needs_extra("training"):
            from simgen.learning.translation.report_section import TITLE, translated_section
        more[TITLE] = partial(translated_section, networks=networks)
    write_report(opened, page, more)
    typer.echo(f"wrote {page} ({page.stat().st_size / 1e6:.1f} MB)")


@app.command()
def validate(
    listed: Annotated[bool, typer.Option("--list", help="List the cases; run none.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Run only the cases that take seconds.")] = False,
    case: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A case or a pattern (layer-*); repeat for more.",
                     show_default="all but long"),
    ] = None,
    device: Device = "cpu",
    workers: Processes = None,
    json_file: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write all results.")] = None,
    html_file: Annotated[Path | None, typer.Option("--html", metavar="FILE", help="Write a page with plots.")] = None,
    published: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of published meshes and results to compare with.")
    ] = None,
    measured: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of measured data to compare with.")
    ] = None,
):  # fmt: skip
    """Compare the solver with closed forms, other codes, published data and measurements. Exit code 1 if a row fails.

    Reference data come from the folder $SIMGEN_REFERENCE. Cases that need them are skipped without it.
    """
    from simgen.cli import validate as printing
    from simgen.verification.validate import all_cases, runner

    if listed:
        printing.print_cases(all_cases().values())
        return
    cases = runner.choose(case or [], quick)
    context = runner.make_context(device, published, measured)
    for file in filter(None, (json_file, html_file)):
        check_output_file(file)
    results = printing.run_and_print(cases, context, workers)
    if json_file:
        from simgen.verification.validate.record import write_json

        write_json(results, device, json_file)
    if html_file:
        from simgen.verification.validate.page import write_validation

        write_validation(results, device, html_file)
    if any(result.failed for result in results):
        raise typer.Exit(1)


@app.command()
def bench(
    quick: Annotated[
        bool, typer.Option("--quick", help="Measure fewer settings and no other codes: two minutes.")
    ] = False,
    device: Device = "cpu",
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the results.")] = Path(
        "bench"
    ),
):
    """Measure speed against error on this machine, for elements, meshes, tolerances, energy terms and other codes.

    Writes speed.csv, speed.png, and advice.txt with the fastest setting for errors of 1, 5 and 20 um.
    """
    for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):  # before numpy: one core is timed
        os.environ[threads] = "1"
    from simgen.verification.bench import run

    run(quick, device, output, typer.echo)


def _write_findings(findings: list, file: Path | None) -> None:
    from simgen.dataset.audit_finding import as_json
    from simgen.errors import writing

    if file is not None:
        with writing(file):
            file.write_text(as_json(findings), encoding="utf-8")


app.command()(exchange.export)
app.command("import")(exchange.import_)
app.command()(images.render)
app.command()(images.translate)
app.command("calibrate-optics")(images.calibrate_optics)
app.command("calibrate-material")(calibrate_material)
app.command()(view)


def main() -> None:
    """Run the console script. Bad input prints one line and exits with code 2; an interrupt exits with 130."""
    gc.set_threshold(50_000)  # a command makes millions of objects, and nearly all stay or are in no cycle
    atexit.register(gc.freeze)  # looking for cycles at the end would take half a second
    # zarr writes files in tasks. If several fail, one error is raised, and asyncio would print the others.
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    try:
        app()
    except InputError as error:
        _refuse(str(error))
    except OSError as error:
        _refuse(f"{error.filename}: {error.strerror}" if error.filename else str(error))


def _refuse(sentence: str) -> None:
    typer.secho(f"simgen: {sentence}", fg="red", err=True)
    sys.exit(2)
