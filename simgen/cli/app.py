"""The command line: parsing and printing only. Whatever a command does is a few lines of Python too.

Imports are inside the commands: ``simgen --help`` is quick, and a run never imports what it does not need.
"""

import os
import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from simgen import __version__
from simgen.cli import exchange, images
from simgen.config.resources import bundled_jobs
from simgen.errors import InputError, check_output_file, needs_extra

app = typer.Typer(
    name="simgen",
    help="Paired simulated touch for two tactile sensors, by quasi-static finite elements.",
    epilog="First: simgen run jobs/smoke.yaml, then simgen check smoke.zarr, then simgen report smoke.zarr.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

BUNDLED, TRAINING = (", ".join(file.stem for file in bundled_jobs(training)) for training in (False, True))

JobFile = Annotated[str, typer.Argument(metavar="JOB", help=f"A job file, or a bundled job: {BUNDLED}.")]
Overrides = Annotated[
    list[str] | None, typer.Argument(metavar="KEY=VALUE", help="Keys to replace: trajectories.count=10")
]
Workers = Annotated[
    int | None,
    typer.Option(min=1, help="Processes of the local cluster; of a scheduler, how many to wait for.",
                 show_default="one per core or GPU"),
]
Scheduler = Annotated[
    str | None,
    typer.Option(help="A dask scheduler's address, or `sync`: no cluster.", show_default="local cluster"),
]
SchedulerFile = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="What `dask scheduler --scheduler-file` wrote, instead of an address."),
]
DatasetFolder = Annotated[Path, typer.Argument(metavar="DATASET", help="A folder that `simgen run` wrote.")]


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
    """Paired simulated touch for two tactile sensors, by quasi-static finite elements."""


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
    device: Annotated[str, typer.Option(help="Where to solve: cpu, cuda or cuda:N.")] = "cpu",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Sample contacts, say how large and how long the job is; solve nothing.")
    ] = False,
):
    """Press the job's indenters into its sensors and write the paired dataset.

    Stop it at any time: the same command goes on where it stopped.
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
    from simgen.cli.console import run_with_progress

    if run_with_progress(checked, output or checked.output(), workers, _address(scheduler, scheduler_file), device):
        raise typer.Exit(1)


@app.command()
def train(
    job: Annotated[
        str, typer.Argument(metavar="JOB", help=f"A training job, or a bundled one: {TRAINING}.")
    ],
    overrides: Annotated[
        list[str] | None, typer.Argument(metavar="KEY=VALUE", help='Keys to replace: "networks=[rmb, rmd]"')
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the networks.", show_default="<job name>.networks"),
    ] = None,
    device: Annotated[str, typer.Option(help="Where to train: cpu, cuda or cuda:N.")] = "cpu",
    tensorboard: Annotated[
        bool, typer.Option("--tensorboard", help="Write what tensorboard shows into the folder, too.")
    ] = False,
):
    """Train a job's networks on a dataset, then measure them on the trajectories that nobody has trained with.

    Stop it at any time: the same command goes on where it stopped. What is trained is not trained again.
    """
    with needs_extra("training"):
        from simgen.cli.train import train_with_progress

    from simgen.learning.training.schema import load_training_job

    checked = load_training_job(job, overrides or ())
    train_with_progress(checked, output or checked.output_folder(), device, tensorboard)


@app.command()
def mesh(
    sensor: Annotated[
        str, typer.Argument(metavar="SENSOR", help="digit, biotac, or a folder with a sensor.yaml.")
    ],
):
    """Make a sensor's meshes again, through the quality gates, and write them beside its sensor.yaml."""
    from simgen.sensors.sensor import remake

    for line in remake(sensor):
        typer.echo(line)


@app.command()
def check(
    dataset: DatasetFolder,
    repair: Annotated[
        bool, typer.Option("--repair", help="Solve again what is damaged or missing, and only that.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write all findings, with every sample they name.")
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    scheduler_file: SchedulerFile = None,
):
    """Audit a dataset: files, certificates, pairing, splits, what is held and touched.

    Exit code 1 if it fails. Bad samples are named. Those that did not converge are no damage: they would not converge
    again.
    """
    from simgen.cli.console import print_findings, run_with_progress
    from simgen.dataset.audit import check, passes, to_repair
    from simgen.dataset.reader import Dataset

    opened = Dataset(dataset)
    findings = check(opened)
    print_findings(dataset, findings)
    _write_findings(findings, json_file)
    if repair and (shards := to_repair(opened, findings)):
        address = _address(scheduler, scheduler_file)
        if run_with_progress(opened.job, dataset, workers, address, opened.attributes["device"], shards):
            raise typer.Exit(1)
        findings = check(Dataset(dataset))
        print_findings(dataset, findings)
        _write_findings(findings, json_file)
    if not passes(findings):
        raise typer.Exit(1)


@app.command()
def status(dataset: DatasetFolder):
    """Say how far a run is: presses, failures, who is at work, how fast, how long it will take."""
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
        typer.Option("--output", "-o", help="The page to write.", show_default="<dataset name>.html"),
    ] = None,
    networks: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="What `simgen train` wrote: shows a press translated by it.")
    ] = None,
):
    """Write one HTML page that needs no network: coverage, failures, a press in motion and in 3-D, patches, forces."""
    from simgen.dataset.layout import checked
    from simgen.dataset.reader import Dataset
    from simgen.report import write_report

    opened = Dataset(dataset)
    if opened.imported:
        raise InputError(f"{dataset}: imported, without the contacts and certificates of a report; see simgen check")
    checked(opened)
    page = output or Path(f"{dataset.resolve().name.removesuffix('.zarr')}.html")
    check_output_file(page)
    more = {}
    if networks is not None:
        with needs_extra("training"):
            from simgen.learning.translation.section import TITLE, translated_section
        more[TITLE] = partial(translated_section, networks=networks)
    write_report(opened, page, more)
    typer.echo(f"wrote {page} ({page.stat().st_size / 1e6:.1f} MB)")


@app.command()
def validate(
    listed: Annotated[bool, typer.Option("--list", help="Say which cases there are; run none.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Only the cases that take seconds.")] = False,
    case: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="This case or pattern (layer-*); may repeat.", show_default="all but long"),
    ] = None,
    device: Annotated[str, typer.Option(help="Where to solve: cpu, cuda or cuda:N.")] = "cpu",
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes.", show_default="one per core, or one GPU")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write all that was found.")] = None,
    html_file: Annotated[Path | None, typer.Option("--html", metavar="FILE", help="Write a page with plots.")] = None,
    published: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Published meshes and results to compare with.")
    ] = None,
):
    """Compare the solver with closed forms, independent codes and published data. Exit code 1 if a row fails.

    Cases that need reference data find them in $SIMGEN_REFERENCE, and are skipped without them.
    """
    from simgen.cli import validate as view
    from simgen.verification.validate import all_cases, runner

    if listed:
        view.print_cases(all_cases().values())
        return
    cases = runner.choose(case or [], quick)
    context = runner.make_context(device, published)
    for file in filter(None, (json_file, html_file)):
        check_output_file(file)
    results = view.run_and_print(cases, context, workers)
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
    quick: Annotated[bool, typer.Option("--quick", help="Fewer settings, no other codes: two minutes.")] = False,
    device: Annotated[str, typer.Option(help="Where to solve: cpu, cuda or cuda:N.")] = "cpu",
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the results.")] = Path(
        "bench"
    ),
):
    """Measure speed against error on this machine: elements, meshes, tolerances, terms, and other codes.

    Writes speed.csv, speed.png and the sentence that says which setting to take for 1, 5 and 20 um.
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


def _address(scheduler: str | None, file: Path | None) -> str | None:
    """Of the scheduler, from one of the two options."""
    from simgen.pipeline.workers import scheduler_address

    if file is None:
        return scheduler
    if scheduler is not None:
        raise InputError(f"--scheduler {scheduler} and --scheduler-file {file}: allowed: one of them")
    return scheduler_address(file)


app.command()(exchange.export)
app.command("import")(exchange.import_)
app.command()(images.render)
app.command()(images.translate)
app.command("calibrate-optics")(images.calibrate_optics)


def main() -> None:
    """Entry point of the console script: bad input is one line and exit code 2, an interrupt 130."""
    try:
        app()
    except InputError as error:
        typer.secho(f"simgen: {error}", fg="red", err=True)
        sys.exit(2)
    except OSError as error:
        sentence = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        typer.secho(f"simgen: {sentence}", fg="red", err=True)
        sys.exit(2)

