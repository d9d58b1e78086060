"""`simgen calibrate-optics`: fits a table of colours to pictures of a sphere, or to the photometric model.

Both ways write files atomically and yield progress lines.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from simgen.config.choices import DEFAULT_CAMERA
from simgen.dataset.atomic_files import put_in_place, write_aside
from simgen.errors import InputError, check_output_file, writing
from simgen.sensing.camera.contact_circles import find_circle, read_circles
from simgen.sensing.camera.image_files import png, read_image
from simgen.sensing.camera.photometric_gel import RADIUS_M, SPHERES, PhotometricGel, photometry_of
from simgen.sensing.camera.picture_numbers import check_listed
from simgen.sensing.camera.renderer import BACKGROUND, TABLE, optics_files
from simgen.sensing.camera.response import Response
from simgen.sensing.camera.spheres import Circle, sphere_in
from simgen.sensing.camera.table_fit import Observations, fit_response, observe, table_error
from simgen.sensing.camera.undeformed_gel import UndeformedGel, table_size, undeformed_gel
from simgen.sensors.pinhole import placed_camera
from simgen.sensors.sensor_geometry import load_geometry, sensor_folder

PICTURES, MODEL = "pictures of a sphere", "photometric model"  # sources that a table states
LARGEST_MM = 1e3  # radius of a sphere
MOST_LEFT_OUT = 0.5  # largest share of pictures left out; with more, a setting such as the radius is wrong
OTHERS = 2**6  # spheres for testing a table


def calibrate(
    pictures: Sequence[Path],
    background: Path | None,
    radius_mm: float | None,
    model: str,
    circles: Path | None,
    output: Path | None,
    camera: str = DEFAULT_CAMERA,
) -> Iterator[str]:
    """Check the options and fit to pictures, or without pictures to the model. Raises `InputError`.

    Pictures need ``background``, ``radius_mm`` and ``output``. The model takes none of these but ``output``.
    """
    given = {"--background": background, "--radius-mm": radius_mm, "--output": output, "--circles": circles}
    if not pictures:
        for option in ("--background", "--radius-mm", "--circles"):
            if given[option] is not None:
                raise InputError(f"{option} {given[option]}: no PICTURE; allowed: with pictures")
        return fit_to_model(model, output, camera)
    check_picture_options(background, radius_mm, output)
    return fit_to_pictures(pictures, background, 1e-3 * radius_mm, model, circles, output, camera)


def check_picture_options(background: Path | None, radius_mm: float | None, output: Path | None) -> None:
    """Raise `InputError` if an option that pictures need is missing, or the radius is out of range."""
    for option, value in (("--background", background), ("--radius-mm", radius_mm), ("--output", output)):
        if value is None:
            raise InputError(
                f"{option} is missing; allowed with pictures: --background FILE --radius-mm R --output FILE"
            )
    if not 0.0 < radius_mm <= LARGEST_MM:
        raise InputError(f"--radius-mm {radius_mm:g}: allowed: more than 0, at most {LARGEST_MM:g}")


def fit_to_pictures(
    pictures: Sequence[Path],
    background: Path,
    radius_m: float,
    model: str,
    circles: Path | None,
    output: Path,
    camera: str = DEFAULT_CAMERA,
) -> Iterator[str]:
    """Fit a table to pictures in which a sphere touches a sensor.

    background : picture of the untouched gel, of the same size
    circles : CSV file of contact circles, see `read_circles`; in pictures that it does not list they are searched

    A picture that cannot be used is left out, with a line that says why. Raises `InputError` if more than half are.
    """
    check_output_file(output)
    check_replaceable(output, PICTURES)
    known = read_circles(circles) if circles else {}
    check_listed(circles, known, pictures)
    nothing = read_image(background)
    gel = undeformed_gel(load_geometry(model), *nothing.shape[:2], camera)
    observed: list[Observations] = []
    left_out: list[InputError] = []
    for picture in pictures:
        try:
            circle, seen = _contact(picture, nothing, known.get(picture.resolve()), radius_m, gel)
        except InputError as error:
            left_out.append(error)
            yield f"left out: {error}"
            continue
        observed.append(seen)
        yield (
            f"{picture}: circle of {circle.radius:.1f} pixels at column {circle.column:.1f}, row {circle.row:.1f}; "
            f"{len(seen.x)} pixels with a known tilt"
        )
    check_enough_left(left_out, len(pictures))
    response = fit_response(observed, source=PICTURES)
    write_tables(output.parent, {output.name: response.data()})
    yield f"{output}: of {counted(len(observed), len(pictures))}; {_sentence(response, observed)}"


def fit_to_model(model: str, output: Path | None, camera: str = DEFAULT_CAMERA) -> Iterator[str]:
    """Fit a table to spheres under the photometric model, and write its background too. Raises `InputError`."""
    folder = output or sensor_folder(model)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; allowed: the folder of {TABLE} and {BACKGROUND}")
    geometry = load_geometry(model)
    placed = placed_camera(geometry.description, geometry.folder, camera)
    table, background_file = (folder / name for name in optics_files(camera))
    check_output_file(table)
    check_replaceable(table, MODEL)
    if not table.exists() and background_file.exists():
        raise InputError(
            f"{background_file}: exists already, without a table of ours; remove it or choose another --output"
        )
    gel = undeformed_gel(geometry, *table_size(placed), camera)
    try:
        rendered = PhotometricGel(gel.depth, gel.pinhole, photometry_of(gel.camera))
    except InputError as error:
        raise InputError(f"{geometry.folder / 'sensor.yaml'}: {error}") from None
    response = fit_response((rendered.of_patch(patch) for patch in rendered.spheres()), source=MODEL)
    others = [rendered.of_patch(patch) for patch in rendered.spheres(OTHERS, seed=1)]
    background = np.rint(rendered.background).astype(np.uint8)
    write_tables(folder, {background_file.name: png(background), table.name: response.data()})
    yield (
        f"{table}: of {SPHERES} spheres of {1e3 * RADIUS_M:g} mm under the photometric model; "
        f"of {len(others)} others {_sentence(response, others)}"
    )
    yield f"{background_file}: {background.shape[1]} x {background.shape[0]} pixels"


def _contact(
    picture: Path, nothing: np.ndarray, circle: Circle | None, radius_m: float, gel: UndeformedGel
) -> tuple[Circle, Observations]:
    """The contact circle, searched unless given, and the colours inside it.

    Raises `InputError`, naming the picture, if it shows no usable contact.
    """
    image = read_image(picture)
    if image.shape != nothing.shape:
        size, own = ("{1} x {0}".format(*each.shape) for each in (image, nothing))
        raise InputError(f"{picture}: {size} pixels: allowed: those of the background, {own}")
    try:
        circle = circle or find_circle(image, nothing)
        patch = sphere_in(circle, radius_m, gel.depth, gel.pinhole)
    except InputError as error:
        raise InputError(f"{picture}: {error}") from None
    seen = observe(patch, gel.depth, gel.pinhole.focal, image - nothing.astype(float))
    if not len(seen.x):
        raise InputError(f"{picture}: circle of {circle.radius:.4g} pixels: allowed: two pixels and more, on the gel")
    return circle, seen


def check_enough_left(left_out: Sequence[InputError], given: int) -> None:
    """Raise `InputError` if more than half of the given pictures were left out."""
    if len(left_out) > MOST_LEFT_OUT * given:
        first = left_out[0]
        raise InputError(f"{len(left_out)} of {given} pictures left out; allowed: at most half; the first: {first}")


def check_replaceable(file: Path, source: str) -> None:
    """Raise `InputError` if the file exists and is no table fitted to ``source``."""
    if not file.exists():
        return
    try:
        found = Response.load(file).source
    except InputError:
        found = ""
    if found != source:
        raise InputError(
            f"{file}: exists already, and was not fitted to {source}; remove it or choose another --output"
        )


def write_tables(folder: Path, files: dict[str, bytes]) -> None:
    """Write files, by name, into a folder; all appear whole or none."""
    with writing(folder / next(iter(files))):
        put_in_place(folder, {name: write_aside(folder, data) for name, data in files.items()})


def counted(used: int, given: int) -> str:
    """The number of pictures that were used, in words."""
    return f"{used} pictures" if used == given else f"{used} of {given} pictures"


def _sentence(response: Response, observed: Sequence[Observations]) -> str:
    found = table_error(response, observed)
    return f"colours change by {found.change:.2f} grey levels on average, and the table is {found.residual:.2f} off"
