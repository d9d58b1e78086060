"""`simgen calibrate-optics --simulate`: fits a table of colours to pictures of a ball on simulated surfaces.

The result explains pictures of a real DIGIT better than a fit to contact circles (docs/reality.md), and takes minutes.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from simgen.config.choices import DEFAULT_CAMERA
from simgen.errors import InputError, check_output_file
from simgen.sensing.camera.ball_presses import BallPresses, simulated_depths
from simgen.sensing.camera.calibrate_optics import (
    PICTURES,
    check_enough_left,
    check_replaceable,
    counted,
    write_tables,
)
from simgen.sensing.camera.image_files import read_image
from simgen.sensing.camera.imprint import find_imprint
from simgen.sensing.camera.press_fit import PressedPictures
from simgen.sensing.camera.spheres import Circle
from simgen.sensing.camera.undeformed_gel import check_aspect
from simgen.sensors.pinhole import placed_camera
from simgen.sensors.sensor import load_sensor
from simgen.sensors.sensor_geometry import load_geometry
from simgen.units import MM_PER_M


def fit_to_simulated_presses(
    pictures: Sequence[Path], background: Path, radius_m: float, model: str, output: Path, camera: str = DEFAULT_CAMERA
) -> Iterator[str]:
    """Fit a table to pictures in which a ball touches a sensor, and yield lines about each step.

    Pictures are shrunk to the size of the camera's images. A picture without a contact is left out, with a line that
    says why. Raises `InputError` if more than half are.
    """
    check_output_file(output)
    check_replaceable(output, PICTURES)
    geometry = load_geometry(model)
    placed = placed_camera(geometry.description, geometry.folder, camera)
    nothing = read_image(background)
    check_aspect(placed, *nothing.shape[:2])
    size = placed.width_px, placed.height_px
    untouched = cv2.resize(nothing, size, interpolation=cv2.INTER_AREA)
    seen: list[np.ndarray] = []
    imprints: list[Circle] = []
    left_out: list[InputError] = []
    for picture in pictures:
        try:
            image, circle = _imprint(picture, nothing, untouched)
        except InputError as error:
            left_out.append(error)
            yield f"left out: {error}"
            continue
        seen.append(image)
        imprints.append(circle)
    check_enough_left(left_out, len(pictures))
    yield f"pressing a ball of {MM_PER_M * radius_m:g} mm at {len(seen)} places"
    sensor = load_sensor(model)
    presses = BallPresses.simulate(sensor, placed, imprints, radius_m, simulated_depths(radius_m))
    pressed = PressedPictures(np.array(seen), untouched, imprints, presses)
    yield "fitting colours, places and depths"
    response, found = pressed.fit(range(len(seen)), source=PICTURES)
    write_tables(output.parent, {output.name: response.data()})
    depths = [MM_PER_M * press.depth_m for press in found]
    change, off = (float(np.mean(each)) for each in zip(*map(pressed.levels, [response] * len(found), range(len(found)),
                                                             found), strict=True))  # fmt: skip
    yield (
        f"{output}: of {counted(len(seen), len(pictures))}, {min(depths):.2f} to {max(depths):.2f} mm deep; in their "
        f"contacts colours change by {change:.1f} grey levels on average, and images by the table are {off:.1f} off"
    )


def _imprint(picture: Path, nothing: np.ndarray, untouched: np.ndarray) -> tuple[np.ndarray, Circle]:
    """A picture in the camera's size, and its imprint. Raises `InputError`, naming the picture."""
    image = read_image(picture)
    if image.shape != nothing.shape:
        size, own = ("{1} x {0}".format(*each.shape) for each in (image, nothing))
        raise InputError(f"{picture}: {size} pixels: allowed: those of the background, {own}")
    image = cv2.resize(image, untouched.shape[1::-1], interpolation=cv2.INTER_AREA)
    try:
        return image, find_imprint(image.astype(float) - untouched)
    except InputError as error:
        raise InputError(f"{picture}: {error}") from None
