"""The commands that make images: `simgen render`, `simgen translate` and `simgen calibrate-optics`."""

from pathlib import Path
from typing import Annotated

import typer

from simgen.cli.options import (
    DatasetFolder,
    Device,
    Processes,
    Split,
    Trajectories,
    height_and_width,
    named_after,
    process_count,
    sample_range,
    smoothing,
)
from simgen.errors import InputError, needs_extra

Calibration = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Colour table in Taxim's layout.", show_default="the sensor's own")
]
Background = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Image without contact.", show_default="the sensor's own")
]
CameraName = Annotated[
    str | None,
    typer.Option("--camera", metavar="CAMERA", help="A camera of the sensor.yaml; the DIGIT has default and tacto.",
                 show_default="the job's"),
]  # fmt: skip
Size = Annotated[
    str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Pixels, such as 480x640.", show_default="the camera's")
]
Blur = Annotated[
    str | None,
    typer.Option(metavar="HOW", show_default="whole",
                 help="whole: smooth the whole height map. across: ACROSS's kernels; large ones keep contacts sharp."),
]  # fmt: skip
NoBlur = Annotated[bool, typer.Option("--no-blur", help="Do not smooth height maps.")]
Shadows = Annotated[
    bool, typer.Option("--shadows", help="Darken pixels that a light does not reach; takes ten times as long.")
]


def render(
    dataset: DatasetFolder,
    sensor: Annotated[str, typer.Option(metavar="NAME", help="A sensor with a camera.")] = "digit",
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the images.",
                     show_default="<dataset name>.images"),
    ] = None,
    camera: CameraName = None,
    calibration: Calibration = None,
    background: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Image without contact; with --vary also a folder of them.",
                     show_default="the sensor's own"),
    ] = None,
    size: Size = None,
    blur: Blur = None,
    no_blur: NoBlur = False,
    heights: Annotated[
        str | None,
        typer.Option(metavar="SOURCE", help="Source of height maps: mesh, stored vertices; solution, stored maps.",
                     show_default="solution if the dataset has height_map"),
    ] = None,
    shadows: Shadows = False,
    vary: Annotated[
        int | None,
        typer.Option(metavar="SEED", help="Draw lights, levels and noise anew for each press; excludes --calibration.",
                     show_default="one sensor"),
    ] = None,
    markers: Annotated[
        str | None,
        typer.Option(metavar="DOTS", show_default="none",
                     help="Printed dots: own (the sensor.yaml's), 7x9@2.05 (rows, columns, pitch in mm), or a CSV file "
                     "x_mm,y_mm,z_mm."),
    ] = None,
    dot_mm: Annotated[
        float | None,
        typer.Option("--dot-mm", metavar="D", help="Diameter of the dots.", show_default="the sensor.yaml's"),
    ] = None,
    gif: Annotated[bool, typer.Option("--gif", help="Also write an animation of each press.")] = False,
    trajectories: Trajectories = None,
    split: Split = None,
    device: Device = "cpu",
    workers: Processes = None,
):  # fmt: skip
    """Render the camera image of every sample, and montages of them.

    You can stop rendering at any time. The same command continues it.
    """
    from simgen.cli.render import render_with_progress
    from simgen.dataset.exchange.selection import select
    from simgen.dataset.layout import checked
    from simgen.dataset.reader import Dataset
    from simgen.sensing.camera.images import Images
    from simgen.sensing.camera.renderer import Look
    from simgen.sensing.camera.stored_heights import has_height_maps

    opened = checked(Dataset(dataset))
    heights = heights or ("solution" if has_height_maps(opened, sensor, camera) else "mesh")
    look = Look(
        calibration, background, *height_and_width(size), smoothing(blur, no_blur), shadows, camera, heights, vary,
        markers, dot_mm,
    )  # fmt: skip
    images = Images(dataset, sensor, output or named_after(dataset, ".images"), look, device)
    selection = select(opened, (sensor,), trajectories, split)
    render_with_progress(images, selection, process_count(workers, device), gif)


def translate(
    networks: Annotated[Path, typer.Argument(metavar="NETWORKS", help="A folder that `simgen train` wrote.")],
    dataset: Annotated[
        Path, typer.Argument(metavar="DATASET", help="A dataset of the sensors that the networks were trained with.")
    ],
    recordings: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Recorded electrode signals in the published HDF5 layout; repeat for more.",
                     show_default="synthetic signals of the dataset"),
    ] = None,
    samples: Annotated[
        str | None,
        typer.Option(metavar="FIRST:END", help="Samples of each recording.", show_default="all in contact"),
    ] = None,
    way: Annotated[
        str | None,
        typer.Option(help="Networks to use: points, ours or paper.", show_default="the first of these that is trained"),
    ] = None,
    hypotheses: Annotated[
        int,
        typer.Option(metavar="N", min=1, max=8,
                     help="At most N images of a sample: the likeliest contact first. Others need the way points."),
    ] = 1,
    steps: Annotated[
        bool, typer.Option("--steps", help="Also write intermediate results: signals, latents, meshes, probabilities.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the images.",
                     show_default="<dataset name>.translated"),
    ] = None,
    camera: CameraName = None,
    calibration: Calibration = None,
    background: Background = None,
    size: Size = None,
    blur: Blur = None,
    no_blur: NoBlur = False,
    shadows: Shadows = False,
    gif: Annotated[bool, typer.Option("--gif", help="Also write animations of the presses in chain.png.")] = False,
    trajectories: Annotated[
        str | None,
        typer.Option(help="Trajectory numbers: 0:10 (end excluded) or 3,7.", show_default="all of the split"),
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(help="train, validation or test.", show_default="test; with --trajectories, all"),
    ] = None,
    device: Device = "cpu",
    workers: Processes = None,
):  # fmt: skip
    """Translate electrode signals of one sensor into camera images of the other.

    The signals are synthetic ones of a dataset's presses, or recordings. For a dataset the true contacts are known, and
    a table says how near the translated contacts are.

    You can stop translating at any time. The same command continues it.
    """
    with needs_extra("training"):
        from simgen.cli.translate import translate_files, translate_presses

    from simgen.cli.render import interruptible
    from simgen.dataset.exchange.selection import select
    from simgen.dataset.layout import checked
    from simgen.dataset.reader import Dataset
    from simgen.dataset.splits import split_names
    from simgen.learning.translation.presses import TranslatedImages, check_sensors
    from simgen.learning.translation.translator import choose_way, read_job
    from simgen.sensing.camera.renderer import Look

    job, opened = read_job(networks), checked(Dataset(dataset))
    if opened.imported:
        raise InputError(f"{dataset}: imported, without touchable vertices and the sensors' models; allowed: a dataset "
                         "that `simgen run` wrote")  # fmt: skip
    if samples is not None and not recordings:
        raise InputError(f"--samples {samples}: needs --recordings; allowed for a dataset: --trajectories and --split")
    for option, value in (("--trajectories", trajectories), ("--split", split), ("--workers", workers)):
        if value is not None and recordings:
            raise InputError(f"{option} {value}: applies to a dataset; allowed with --recordings: --samples")
    check_sensors(opened, job.source, job.target)
    folder = output or named_after(dataset, ".translated")
    look = Look(calibration, background, *height_and_width(size), smoothing(blur, no_blur), shadows, camera)
    images = TranslatedImages(
        dataset, job.target, folder, look, device, networks=networks, way=choose_way(networks, way), keep=steps,
        hypotheses=hypotheses,
    )  # fmt: skip
    both = job.source, job.target
    with interruptible(folder):
        if recordings:
            translate_files(images, select(opened, both), recordings, sample_range(samples), gif)
            return
        if trajectories is None and split is None and "test" not in split_names(opened["press/split"]):
            raise InputError(f"{dataset}: has no test trajectories; allowed: --trajectories or --split")
        chosen = select(opened, both, trajectories, split or (None if trajectories else "test"))
        translate_presses(images, chosen, process_count(workers, device), gif)


def calibrate_optics(
    pictures: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="PICTURE...", help="Images of a sphere in contact.",
            show_default="spheres rendered by the photometric model"
        ),
    ] = None,
    background: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Image without contact, of the same size.")
    ] = None,
    radius_mm: Annotated[float | None, typer.Option(metavar="R", help="Radius of the sphere.")] = None,
    sensor: Annotated[
        str, typer.Option("--sensor", metavar="SENSOR", help="digit, gelsight_mini, or a folder with a sensor.yaml.")
    ] = "digit",
    camera: Annotated[
        str | None,
        typer.Option("--camera", metavar="CAMERA", help="A camera of the sensor.yaml; the DIGIT has default and tacto.",
                     show_default="default"),
    ] = None,
    circles: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="CSV with the contact circles in pixels: file,column,row,radius.",
                     show_default="found in the images"),
    ] = None,
    positions: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="CSV with stage positions: file,x_mm,y_mm. Fits the camera, not colours.",
                     show_default="none"),
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z", help="With --positions: point of the sensor, mm, where the stage reads 0,0.",
                     show_default="not known"),
    ] = None,
    simulate: Annotated[
        bool,
        typer.Option("--simulate", help="Fit to the dents of simulated presses: more exact, a few minutes."),
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="PATH", help="The table; without pictures, a folder for both files.",
                     show_default="the sensor's folder"),
    ] = None,
):  # fmt: skip
    """Fit a sensor's colour table to pictures of a sphere, or to a photometric model of the sensor.

    With pictures: simgen calibrate-optics a.png b.png --background nothing.png --radius-mm 2 -o table.npz

    Without pictures: the model renders spheres on the sensor's surface. Writes optics.npz and background.png; for a
    camera other than default, its name follows in the files' names.

    With --positions FILE: fits the camera's scale and centre, prints a cameras section for the sensor.yaml, and writes
    nothing.
    """
    from simgen.config.choices import DEFAULT_CAMERA
    from simgen.sensing.camera.calibrate_optics import calibrate, check_picture_options

    name = camera or DEFAULT_CAMERA
    if positions is not None:
        from simgen.sensing.camera.calibrate_camera import fit_to_positions

        for option, given in ((f"-o {output}", output is not None), ("--simulate", simulate)):
            if given:
                raise InputError(f"{option}: fits colours; allowed with --positions: neither -o nor --simulate")
        lines = fit_to_positions(pictures or [], background, radius_mm, sensor, positions, origin, circles, name)
    elif origin is not None:
        raise InputError(f"--origin {origin}: no --positions; allowed: with --positions FILE")
    elif simulate:
        from simgen.sensing.camera.calibrate_by_presses import fit_to_simulated_presses

        if circles is not None or not pictures:
            given = f"--circles {circles}" if pictures else "no PICTURE"
            raise InputError(f"--simulate: {given}; allowed: pictures, whose imprints it finds itself")
        check_picture_options(background, radius_mm, output)
        lines = fit_to_simulated_presses(pictures, background, 1e-3 * radius_mm, sensor, output, name)
    else:
        lines = calibrate(pictures or [], background, radius_mm, sensor, circles, output, name)
    for line in lines:
        typer.echo(line)
