"""The command `simgen view`."""

from pathlib import Path
from typing import Annotated

import typer

from simgen.cli.options import Device
from simgen.errors import InputError, needs_extra, shown

EXTRA = "view"


def view(
    dataset: Annotated[
        Path | None, typer.Argument(metavar="[DATASET]", help="A dataset folder. Leave it out to press live.")
    ] = None,
    sensor: Annotated[
        list[str] | None,
        typer.Option("--sensor", metavar="SENSOR",
                     help="Press live: a bundled sensor, or a folder with a sensor.yaml. Repeat for a pair; you place "
                     "contacts on the first."),
    ] = None,
    indenter: Annotated[
        str | None,
        typer.Option("--indenter", metavar="INDENTER", help="Press live: a bundled indenter, or a closed mesh.",
                     show_default="sphere_7mm"),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option("--unit", metavar="UNIT", help="Unit of an indenter's mesh: m or mm.", show_default="m"),
    ] = None,
    job: Annotated[
        str | None, typer.Option("--job", metavar="JOB", help="Press live with the sensors and settings of a job.")
    ] = None,
    networks: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Networks that `simgen train` wrote: adds what they predict."),
    ] = None,
    device: Device = "cpu",
    port: Annotated[
        int | None, typer.Option("--port", min=1, max=65535, help="Port of the server.", show_default="a free one")
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the link, and open no browser.")] = False,
):  # fmt: skip
    """Look at a dataset in the browser, or press a sensor live.

    The page is for this machine alone: the server listens on 127.0.0.1. Stop it with Ctrl+C.

    simgen view smoke.zarr

    simgen view --sensor digit --indenter ring_7mm
    """
    from simgen.config.choices import is_path

    live = {"--sensor": sensor, "--indenter": indenter, "--unit": unit, "--job": job}
    given = [name for name, value in live.items() if value]
    if dataset is not None and given:
        raise InputError(f"{dataset} and {given[0]}: allowed: a dataset to look at, or {given[0]} to press live")
    if dataset is None and not (sensor or job):
        raise InputError("simgen view: nothing to show; allowed: a dataset, --sensor NAME, or --job JOB")
    if job is not None and len(given) > 1:
        raise InputError(f"--job {job} and {given[0]}: allowed: one of them, since a job names sensors and indenters")
    if unit is not None and not is_path(indenter or ""):
        raise InputError(f"--unit {shown(unit)}: allowed: only with a mesh file as --indenter")
    if dataset is not None and device != "cpu":
        raise InputError(f"--device {shown(device)}: allowed: only to press live")
    if networks is not None and dataset is None:
        raise InputError(f"--networks {networks}: allowed: only with a dataset")
    with needs_extra(EXTRA):
        from simgen.view.server import serve
    if dataset is not None:
        from simgen.view.dataset_page import dataset_page

        page, title = dataset_page(dataset, networks), dataset.resolve().name
    else:
        from simgen.config.warp_device import check_device
        from simgen.view.live_page import live_page

        check_device(device)
        page, title = live_page(sensor or [], indenter, unit, job, device), job or " and ".join(sensor)

    def announce(link: str) -> None:
        typer.echo(f"{title}: {link} (stop with Ctrl+C)")

    serve(page, f"{title} - simgen", announce, not no_browser, port)
