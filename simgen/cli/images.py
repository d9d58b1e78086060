"""The commands that make images; see `simgen.cli.app`, which parses them."""

import re
from pathlib import Path
from typing import Annotated

import typer

from simgen.errors import InputError, needs_extra, shown

Calibration = Annotated[
    Path | None, typer.Option(metavar="FILE", help="A table as Taxim has it.", show_default="the sensor's own")
]
Background = Annotated[
    Path | None, typer.Option(metavar="FILE", help="The image of nothing.", show_default="the sensor's own")
]
Size = Annotated[
    str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Pixels, such as 480x640.", show_default="the camera's")
]
Smoothed = Annotated[
    str | None,
    typer.Option(
        "--blur", metavar="HOW", show_default="whole",
        help="whole: smooth the whole height map. across: ACROSS's kernels; the large ones spare the contact.",
    ),
]  # fmt: skip
Sharp = Annotated[bool, typer.Option("--no-blur", help="Do not smooth height maps.")]
Shaded = Annotated[
    bool, typer.Option("--shadows", help="Dim what the lights do not reach: takes ten times as long.")
]


def render(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="A folder that `simgen run` wrote.")],
    sensor: Annotated[str, typer.Option(metavar="NAME", help="A sensor with a camera.")] = "digit",
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the images.",
                     show_default="<dataset name>.images"),
    ] = None,
    calibration: Calibration = None,
    background: Background = None,
    size: Size = None,
    blur: Smoothed = None,
    no_blur: Sharp = False,
    shadows: Shaded = False,
    gif: Annotated[bool, typer.Option("--gif", help="Write every press in motion, too.")] = False,
    trajectories: Annotated[
        str | None, typer.Option(help="0:10 (the end excluded), or 3,7.", show_default="all")
    ] = None,
    split: Annotated[str | None, typer.Option(help="train, validation or test.", show_default="all")] = None,
    device: Annotated[str, typer.Option(help="Where to render: cpu, cuda or cuda:N.")] = "cpu",
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes.", show_default="one per core, or one GPU")
    ] = None,
):
    """Write the images that a sensor's camera takes of every sample, and pictures of many of them.

    Stop it at any time: the same command goes on where it stopped.
    """
    from simgen.cli.render import render_with_progress
    from simgen.dataset.exchange.selection import select
    from simgen.dataset.layout import checked
    from simgen.dataset.reader import Dataset
    from simgen.pipeline.workers import cores
    from simgen.sensing.camera.images import Images
    from simgen.sensing.camera.renderer import Look

    opened = checked(Dataset(dataset))
    folder = output or Path(f"{dataset.resolve().name.removesuffix('.zarr')}.images")
    look = Look(calibration, background, *_height_and_width(size), _smoothing(blur, no_blur), shadows)
    images = Images(dataset, sensor, folder, look, device)
    processes = workers or (cores() if device == "cpu" else 1)
    render_with_progress(images, select(opened, (sensor,), trajectories, split), processes, gif)


def translate(
    networks: Annotated[Path, typer.Argument(metavar="NETWORKS", help="A folder that `simgen train` wrote.")],
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="A dataset of the sensors that they know.")],
    recordings: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Electrodes as published (HDF5), instead; may repeat.",
                     show_default="synthetic signals of the dataset"),
    ] = None,
    samples: Annotated[
        str | None, typer.Option(metavar="FIRST:END", help="Of each recording.", show_default="all in contact")
    ] = None,
    way: Annotated[
        str | None,
        typer.Option(help="ours or paper: which networks.", show_default="ours if it is trained, else paper"),
    ] = None,
    steps: Annotated[
        bool, typer.Option("--steps", help="Write what lies between, too: signals, latents, both meshes.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the images.",
                     show_default="<dataset name>.translated"),
    ] = None,
    calibration: Calibration = None,
    background: Background = None,
    size: Size = None,
    blur: Smoothed = None,
    no_blur: Sharp = False,
    shadows: Shaded = False,
    gif: Annotated[bool, typer.Option("--gif", help="Write what chain.png shows in motion, too.")] = False,
    trajectories: Annotated[
        str | None, typer.Option(help="0:10 (the end excluded), or 3,7.", show_default="all of the split")
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(help="train, validation or test.", show_default="test; with --trajectories, all"),
    ] = None,
    device: Annotated[str, typer.Option(help="Where to compute: cpu, cuda or cuda:N.")] = "cpu",
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes.", show_default="one per core, or one GPU")
    ] = None,
):
    """From electrode signals to images: what the other sensor's camera would see of what this one felt.

    Signals are synthetic ones of a dataset's presses, whose truth is known: a table says how near the contacts are.
    Or they are recordings.

    Stop it at any time: the same command goes on where it stopped.
    """
    with needs_extra("training"):
        from simgen.cli.translate import translate_files, translate_presses

    from simgen.cli.render import interruptible
    from simgen.dataset.exchange.selection import select
    from simgen.dataset.layout import checked
    from simgen.dataset.reader import Dataset
    from simgen.dataset.splits import split_names
    from simgen.learning.training.translator import choose_way, read_job
    from simgen.learning.translation.presses import TranslatedImages, check_sensors
    from simgen.pipeline.workers import cores
    from simgen.sensing.camera.renderer import Look

    job, opened = read_job(networks), checked(Dataset(dataset))
    if opened.imported:
        raise InputError(f"{dataset}: imported, without what may touch and the sensors' models; allowed: a dataset of "
                         "`simgen run`")  # fmt: skip
    if samples is not None and not recordings:
        raise InputError(f"--samples {samples}: is of --recordings; of a dataset there are --trajectories and --split")
    for option, value in (("--trajectories", trajectories), ("--split", split), ("--workers", workers)):
        if value is not None and recordings:
            raise InputError(f"{option} {value}: is of a dataset's presses; of --recordings there is --samples")
    check_sensors(opened, job.source, job.target)
    folder = output or Path(f"{dataset.resolve().name.removesuffix('.zarr')}.translated")
    look = Look(calibration, background, *_height_and_width(size), _smoothing(blur, no_blur), shadows)
    images = TranslatedImages(
        dataset, job.target, folder, look, device, networks=networks, way=choose_way(networks, way), keep=steps
    )
    both = job.source, job.target
    with interruptible(folder):
        if recordings:
            translate_files(images, select(opened, both), recordings, _range(samples), gif)
            return
        if trajectories is None and split is None and "test" not in split_names(opened["press/split"]):
            raise InputError(f"{dataset}: has no trajectory of the test; allowed: --trajectories or --split")
        chosen = select(opened, both, trajectories, split or (None if trajectories else "test"))
        translate_presses(images, chosen, workers or (cores() if device == "cpu" else 1), gif)


def calibrate_optics(
    pictures: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="PICTURE...", help="Images of a sphere that touches.", show_default="spheres under the model"
        ),
    ] = None,
    background: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The image of nothing, of the same size.")
    ] = None,
    radius_mm: Annotated[float | None, typer.Option(metavar="R", help="The sphere's radius.")] = None,
    sensor: Annotated[str, typer.Option(metavar="SENSOR", help="digit, or a folder with a sensor.yaml.")] = "digit",
    circles: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="CSV of file,column,row,radius in pixels: where it touches.", show_default="searched"
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="PATH", help="The table; without pictures, a folder for both files.",
                     show_default="the sensor's folder"),
    ] = None,
):  # fmt: skip
    """Fit the table that colours come from: to pictures of a sphere, or to a photometric model of the sensor.

    With pictures: simgen calibrate-optics a.png b.png --background nothing.png --radius-mm 2 -o table.npz.

    Without: spheres touch the sensor's true surface under its lights; writes optics.npz and background.png.
    """
    from simgen.sensing.camera.fitting import calibrate

    for line in calibrate(pictures or [], background, radius_mm, sensor, circles, output):
        typer.echo(line)


def _height_and_width(size: str | None) -> tuple[int | None, int | None]:
    """Raises `InputError` unless it is as 480x640."""
    if size is None:
        return None, None
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    if match is None:
        raise InputError(f"--size {size!r}: write it as WIDTHxHEIGHT, such as 480x640")
    return int(match[2]), int(match[1])


def _smoothing(blur: str | None, no_blur: bool) -> str | None:
    """Raises `InputError` if both options are given."""
    if not no_blur:
        return blur or "whole"
    if blur is not None:
        raise InputError(f"--no-blur: contradicts --blur {shown(blur)}; allowed: one of them")
    return None


def _range(samples: str | None) -> range | None:
    """Raises `InputError` unless it is as 0:200."""
    if samples is None:
        return None
    match = re.fullmatch(r"(\d{1,9}):(\d{1,9})", samples)
    if match is None or int(match[1]) >= int(match[2]):
        raise InputError(f"--samples {samples!r}: write it as 0:200 (the end excluded)")
    return range(int(match[1]), int(match[2]))
