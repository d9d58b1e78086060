"""`simgen calibrate-optics --positions`: fits a camera's scale and centre to imprints of a ball that a stage placed.

Colours alone do not give the scale, because a smaller ball looks the same under a larger one. Nothing is written: the
command prints a section for the sensor.yaml. A table of colours belongs to the sensor.yaml's camera. So it is fitted
afterwards, with the new section in its place.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from simgen.config.choices import DEFAULT_CAMERA
from simgen.errors import InputError, shown
from simgen.sensing.camera.calibrate_optics import LARGEST_MM, check_enough_left, counted
from simgen.sensing.camera.camera_fit import CameraFit, SeenGel, check_places, fit_camera
from simgen.sensing.camera.contact_circles import read_circles
from simgen.sensing.camera.image_files import read_image
from simgen.sensing.camera.imprint import find_imprint
from simgen.sensing.camera.picture_numbers import check_listed, read_picture_numbers
from simgen.sensing.camera.spheres import Circle
from simgen.sensing.camera.undeformed_gel import check_aspect
from simgen.sensors.pinhole import Pinhole, placed_camera
from simgen.sensors.sensor import Camera
from simgen.sensors.sensor_geometry import SensorGeometry, load_geometry
from simgen.sensors.sensor_schema import CameraSettings
from simgen.units import MM, MM_PER_M

COLUMNS = ("x_mm", "y_mm")
ROUNDS, SETTLED_MM = 10, 1e-4  # of moving the camera over the gel
WRONG = 0.02  # difference of scales from which the sensor.yaml's camera is called wrong


def fit_to_positions(
    pictures: Sequence[Path],
    background: Path | None,
    radius_mm: float | None,
    model: str,
    positions: Path,
    origin: str | None = None,
    circles: Path | None = None,
    camera: str = DEFAULT_CAMERA,
) -> Iterator[str]:
    """Fit a camera to pictures of a ball at known positions of a stage, and yield lines with what was found.

    background : picture of the untouched gel, of the same size
    positions : CSV file ``file,x_mm,y_mm``, see `read_picture_numbers`: the stage's position across the gel in each
        picture, in its own axes
    origin : point X,Y,Z of the sensor, mm, over which the stage reads 0,0; without it the camera stays over its place
    circles : CSV file of imprints, see `read_circles`; in pictures that it does not list they are searched

    A picture without a contact is left out, with a line that says why. Raises `InputError` for bad input, and if more
    than half of the pictures are left out.
    """
    check_options(pictures, background, radius_mm)
    zero = origin_of(origin)
    places = read_positions(positions, pictures)
    known = read_circles(circles) if circles else {}
    if circles:
        check_listed(circles, known, pictures)
    geometry = load_geometry(model)
    placed = placed_camera(geometry.description, geometry.folder, camera)
    nothing = read_image(background)
    check_aspect(placed, *nothing.shape[:2])
    image = Pinhole.of(placed, *nothing.shape[:2])
    used, imprints, left_out = [], [], []
    for number, picture in enumerate(pictures):
        try:
            imprint = _imprint(picture, nothing, known.get(picture.resolve()))
        except InputError as error:
            left_out.append(error)
            yield f"left out: {error}"
            continue
        used.append(number)
        imprints.append([imprint.column, imprint.row, imprint.radius])
    check_enough_left(left_out, len(pictures))
    try:
        found, gel, moved = fit_and_place(np.array(imprints), places[used], radius_mm, geometry, placed, image, zero)
    except InputError as error:
        raise InputError(f"{positions}: {error}") from None
    for number, off, is_used in zip(used, found.residual_px, found.used, strict=True):
        if not is_used:
            yield f"outlier: {pictures[number]}: {math.hypot(*off):.1f} pixels from its position; not used"
    yield f"{positions}: of {counted(int(found.used.sum()), len(pictures))}; {found.rms_px:.2f} pixels off (rms)"
    yield from _lines(found, gel, image, placed)
    yield from _place_lines(placed, moved, gel, zero is not None)
    yield _section(camera, geometry.description.cameras[camera], moved)


def check_options(pictures: Sequence[Path], background: Path | None, radius_mm: float | None) -> None:
    """Raise `InputError` if something is missing that a fit to positions needs, or the radius is out of range."""
    for name, value in (("PICTURE", pictures or None), ("--background", background), ("--radius-mm", radius_mm)):
        if value is None:
            raise InputError(f"{name} is missing; allowed with --positions: PICTURE... --background FILE --radius-mm R")
    if not 0.0 < radius_mm <= LARGEST_MM:
        raise InputError(f"--radius-mm {radius_mm:g}: allowed: more than 0, at most {LARGEST_MM:g}")


def read_positions(file: Path, pictures: Sequence[Path]) -> np.ndarray:
    """Stage positions (n, 2) mm of pictures, from a CSV file ``file,x_mm,y_mm``.

    Raises `InputError` if the file cannot be read, does not list just these pictures, or has too few places.
    """
    numbers = read_picture_numbers(file, COLUMNS, "mm")
    check_listed(file, numbers, pictures)
    for picture in pictures:
        if picture.resolve() not in numbers:
            raise InputError(f"{file}: no position of {picture}; allowed: a line for each picture")
    places = np.array([numbers[picture.resolve()] for picture in pictures])
    try:
        check_places(places)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    return places


def fit_and_place(
    circles: np.ndarray,
    stage_mm: np.ndarray,
    radius_mm: float,
    geometry: SensorGeometry,
    camera: Camera,
    image: Pinhole,
    origin: np.ndarray | None = None,
) -> tuple[CameraFit, SeenGel, Camera]:
    """Fit a camera, and move it to where an ``origin`` (3,) m of the sensor is the stage's origin.

    The depth of a domed gel depends on the camera's place, so both are repeated until it rests. Raises `InputError` as
    `fit_camera` does, and if the camera does not come to rest over the gel.
    """
    moved = camera
    for _ in range(ROUNDS):
        try:
            gel = SeenGel.of(geometry, moved)
        except InputError:
            if moved is camera:
                raise
            break
        found = fit_camera(circles, stage_mm, radius_mm, gel, image)
        view = 2.0 * math.degrees(math.atan(0.5 * image.height / found.focal_px))
        moved = replace(moved, vertical_field_of_view_deg=view)
        if origin is None:
            return found, gel, moved
        across = image.axes[:2]
        seen = across @ (origin - moved.position) - MM * found.seen(np.zeros((1, 2)))[0]
        moved = replace(moved, position=moved.position + seen @ across)
        if MM_PER_M * np.linalg.norm(seen) < SETTLED_MM:
            return found, gel, moved
    raise InputError("the camera finds no place over the gel; allowed: an --origin from which the stage counts")


def origin_of(text: str | None) -> np.ndarray | None:
    """Point (3,) m of ``--origin X,Y,Z`` in mm. Raises `InputError` for other text."""
    if text is None:
        return None
    try:
        point = np.array([float(each) for each in text.split(",")])
    except ValueError:
        point = np.empty(0)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise InputError(f"--origin {shown(text)!r}: write it as X,Y,Z in mm, such as -7.56,-8.3,0")
    return MM * point


def _imprint(picture: Path, nothing: np.ndarray, imprint: Circle | None) -> Circle:
    """The imprint, searched unless given. Raises `InputError`, naming the picture, if it shows none."""
    image = read_image(picture)
    if image.shape != nothing.shape:
        size, own = ("{1} x {0}".format(*each.shape) for each in (image, nothing))
        raise InputError(f"{picture}: {size} pixels: allowed: those of the background, {own}")
    try:
        return imprint or find_imprint(image - nothing.astype(float))
    except InputError as error:
        raise InputError(f"{picture}: {error}") from None


def _lines(found: CameraFit, gel: SeenGel, image: Pinhole, camera: Camera) -> Iterator[str]:
    """Lines with each fitted value and its standard error."""
    share, turn, *centre = found.errors
    scale, own = found.focal_px / gel.apex_mm, image.focal / gel.apex_mm
    view = 2.0 * math.degrees(math.atan(0.5 * image.height / found.focal_px))
    yield (
        f"scale at the gel's apex: {scale:.3f} +- {share * scale:.3f} pixels per mm, "
        f"{1.0 / scale:.5f} +- {share / scale:.5f} mm per pixel"
    )
    yield (
        f"vertical field of view: {view:.2f} +- {math.degrees(share * math.sin(math.radians(view))):.2f} degrees; "
        f"in the sensor.yaml {camera.vertical_field_of_view_deg:g}"
    )
    at = ", ".join(f"{name} = {value:.3f} +- {error:.3f} mm"
                   for name, value, error in zip("xy", found.centre_mm, centre, strict=True))  # fmt: skip
    yield f"centre of the image: stage at {at}"
    yield (
        f"rotation: the stage's x runs {found.angle_deg:.2f} +- {math.degrees(turn):.2f} degrees from the image's "
        f"right, counter-clockwise; its axes are {'' if found.is_mirrored else 'not '}mirrored"
    )
    if abs(own / scale - 1.0) > WRONG:
        yield (
            f"the sensor.yaml's camera has {own:.3f} pixels per mm, {own / scale - 1.0:+.1%}: a table that was fitted "
            "with it is wrong; put in the section below and fit colours anew"
        )


def _place_lines(before: Camera, moved: Camera, gel: SeenGel, is_placed: bool) -> Iterator[str]:
    """Lines with the camera's place over the gel, and with what the pictures do not determine."""
    if is_placed:
        away = MM_PER_M * float(np.linalg.norm(moved.position - before.position))
        yield f"camera: {away:.3f} mm beside its place in the sensor.yaml"
    else:
        yield "camera: kept over the place of the sensor.yaml; --origin gives the true one"
    yield (
        f"not determined: the camera's distance, and its turn about its axis; the field of view is for "
        f"{gel.apex_mm:.2f} mm from the gel's apex"
    )


def _section(name: str, settings: CameraSettings, moved: Camera) -> str:
    """A section ``cameras`` for the sensor.yaml."""
    new = settings.model_dump(mode="json") | {
        "position_mm": [round(float(each), 4) for each in MM_PER_M * moved.position],
        "vertical_field_of_view_deg": round(moved.vertical_field_of_view_deg, 3),
    }
    return yaml.safe_dump({"cameras": {name: new}}, sort_keys=False, default_flow_style=None).rstrip()
