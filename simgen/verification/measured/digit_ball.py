"""A steel ball of R = 3 mm in a real DIGIT: a table fitted to half of the pictures, and images like the other half.

The folder holds pictures of one DIGIT, pressed by hand at many places and depths that nobody recorded
(github.com/vocdex/Taxim). Places and depths of the fitted half follow from all colours. Those of the other half follow
from the imprint alone: its middle gives the place, its radius the depth.
"""

import re
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from simgen.errors import InputError
from simgen.pipeline.image_resolution import pixel
from simgen.sensing.camera.ball_presses import BallPresses, simulated_depths
from simgen.sensing.camera.image_files import png, read_image
from simgen.sensing.camera.imprint import find_imprint
from simgen.sensing.camera.press_fit import PicturedPress, PressedPictures
from simgen.sensing.camera.response import Response
from simgen.sensing.camera.spheres import Circle
from simgen.sensors.sensor import load_sensor
from simgen.units import MM
from simgen.verification.validate.case import Context, Outcome, Picture, Row, Table, at_least, at_most, case

FOLDER, BACKGROUND = "digit_ball_r3mm", "background_median.png"
PUBLISHED = Path("digit") / "polycalib.npz"  # in the folder of --published or $SIMGEN_REFERENCE: Taxim's table
RADIUS_M = 3e-3
LARGEST_MM = 4.5  # radius of an imprint with the dent around the contact; more is a change of light
DEPTHS_M = simulated_depths(RADIUS_M)
CONTACT, RADIUS, GRADIENTS = 8.0, 0.05, 0.5  # grey levels; share of the radius; correlation: chosen targets
FEWEST = 4  # pictures
WINDOW_PX = 1.5  # standard deviation of the window of similarities and gradients
SHOWN, COLUMNS = 12, 4  # pairs of pictures on the page


def read_pictures(folder: Path, height: int, width: int) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, pictures (n, height, width, 3) uint8 and background, in the size of the camera's images."""
    files = sorted(folder.glob("frame_*.jpg"), key=lambda file: int(re.sub(r"\D", "", file.stem)))
    pictures = [_resized(read_image(file), height, width) for file in files]
    return [file.stem for file in files], np.array(pictures), _resized(read_image(folder / BACKGROUND), height, width)


def imprints(pictures: np.ndarray, background: np.ndarray, most_px: float) -> dict[int, Circle]:
    """Imprints by the number of their picture; pictures without a contact, or with a larger imprint, are left out."""
    found = {}
    for number, picture in enumerate(pictures):
        try:
            circle = find_imprint(picture.astype(float) - background)
        except InputError:
            continue
        if circle.radius <= most_px:
            found[number] = circle
    return found


def similarity(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Structural similarity (height, width) of two images, mean over channels (Wang et al., IEEE TIP 2004, eq. 13)."""
    a, b = one.astype(float), other.astype(float)

    def mean(image: np.ndarray) -> np.ndarray:
        return gaussian_filter(image, (WINDOW_PX, WINDOW_PX, 0.0))

    ma, mb = mean(a), mean(b)
    va, vb, both = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
    c1, c2 = (0.01 * 255.0) ** 2, (0.03 * 255.0) ** 2
    return ((2 * ma * mb + c1) * (2 * both + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))).mean(axis=2)


def gradient_correlation(one: np.ndarray, other: np.ndarray, where: np.ndarray) -> tuple[float, float]:
    """Correlation of the gradients of two changes of colour (height, width, 3), along rows and along columns.

    Both are smoothed first: noise of single pixels makes 68 and 56 % of the variance of a real picture's gradients.
    """
    smooth = [gaussian_filter(each.astype(float), (WINDOW_PX, WINDOW_PX, 0.0)) for each in (one, other)]
    return tuple(
        float(np.corrcoef(*(np.gradient(each, axis=axis)[where].ravel() for each in smooth))[0, 1]) for axis in (1, 0)
    )


class Comparison:
    """Images by one table, against the pictures of some places.

    table : a row for each place: in the contact, outside, radius, distance of the middles, similarity, gradients
    """

    COLUMNS = ("in the contact, levels", "outside, levels", "radius, ratio", "middles apart, px", "SSIM in the contact",
               "gradients along rows, r", "along columns, r")  # fmt: skip

    def __init__(self, pressed: PressedPictures, response: Response | None, places: dict[int, PicturedPress]):
        self.images = {
            place: pressed.background if response is None else pressed.picture(response, place, press)
            for place, press in places.items()
        }
        self.table = np.array([self._row(pressed, *each, response is not None) for each in self.images.items()])

    def mean(self) -> list[float]:
        """Means over the places, in the order of `COLUMNS`."""
        return self.table.mean(axis=0).tolist()

    @staticmethod
    def _row(pressed: PressedPictures, place: int, image: np.ndarray, is_pressed: bool) -> list[float]:
        picture, background, circle = pressed.pictures[place], pressed.background, pressed.circles[place]
        contact, around = pressed.around(place, 1.0), pressed.around(place, 1.5)
        off = np.abs(image.astype(float) - picture).mean(axis=2)
        row = [off[contact].mean(), off[~contact].mean()]
        ssim = similarity(image, picture)[contact].mean()
        if not is_pressed:
            return [*row, np.nan, np.nan, ssim, np.nan, np.nan]
        found = find_imprint(image.astype(float) - background)
        apart = np.hypot(found.column - circle.column, found.row - circle.row)
        changes = (each.astype(float) - background for each in (image, picture))
        return [*row, found.radius / circle.radius, apart, ssim, *gradient_correlation(*changes, around)]


def pairs(pressed: PressedPictures, comparison: Comparison) -> bytes:
    """PNG of pictures beside their images, evenly picked."""
    places = list(comparison.images)
    picked = [places[i] for i in np.linspace(0, len(places) - 1, min(SHOWN, len(places))).astype(int)]
    tiles = [np.hstack([pressed.pictures[place], comparison.images[place]]) for place in picked]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % COLUMNS)
    return png(np.vstack([np.hstack(tiles[i : i + COLUMNS]) for i in range(0, len(tiles), COLUMNS)]))


@case("measured-digit-ball", "A ball in a real DIGIT: images by a table that was fitted to other pictures", "standard")
def digit_ball(context: Context) -> Outcome:
    """Fit a table to every second picture, and compare images at the places of the others."""
    folder = None if context.measured is None else context.measured / FOLDER
    if folder is None or not (folder / BACKGROUND).is_file():
        return Outcome([], skipped=f"no {FOLDER} in --measured DIR: the pictures belong to others")
    sensor = load_sensor("digit")
    camera = sensor.cameras["default"]
    names, pictures, background = read_pictures(folder, camera.height_px, camera.width_px)
    found = imprints(pictures, background, LARGEST_MM * MM / pixel(camera, sensor.output_mesh))
    kept = list(found)
    if len(kept) < FEWEST:
        return Outcome([], skipped=f"{folder}: {len(kept)} pictures show a contact; allowed: {FEWEST} and more")
    presses = BallPresses.simulate(sensor, camera, list(found.values()), RADIUS_M, DEPTHS_M)
    pressed = PressedPictures(pictures[kept], background, list(found.values()), presses)
    fitted, others = list(range(0, len(kept), 2)), list(range(1, len(kept), 2))
    response, _ = pressed.fit(fitted)
    comparisons = {"the fitted table": Comparison(pressed, response, _at_imprints(pressed, response, others))}
    comparisons["the untouched gel"] = Comparison(pressed, None, dict.fromkeys(others, PicturedPress(0.0)))
    if (published := _published(context)) is not None:
        table = Response.load(published)
        comparisons["Taxim's published table"] = Comparison(pressed, table, _at_imprints(pressed, table, others))
    own = comparisons["the fitted table"]
    lines = [[what, *each.mean()] for what, each in comparisons.items()]
    notes = [f"{len(fitted)} pictures fitted, {len(others)} compared, {len(names) - len(kept)} without a contact or "
             f"with other light; images of {camera.width_px} x {camera.height_px} pixels",
             "left: the real picture; right: the image of the simulated press"]  # fmt: skip
    return Outcome(
        _rows(own, comparisons),
        [Table("Means over the compared pictures", ["colours of", *Comparison.COLUMNS], lines)],
        notes=notes,
        pictures=[Picture("Pictures that the table was not fitted to", pairs(pressed, own))],
    )


def _at_imprints(pressed: PressedPictures, response: Response, places: list[int]) -> dict[int, PicturedPress]:
    return {place: pressed.press_by_radius(response, place) for place in places}


def _rows(own: Comparison, comparisons: dict[str, Comparison]) -> list[Row]:
    contact, _, radius, *_ = own.table.T
    target = "a chosen target"
    rows = [
        at_most("mean difference in the contact", "levels", float(contact.mean()), CONTACT, target),
        at_most("radius of the imprint, median difference", "", float(np.median(np.abs(radius - 1.0))), RADIUS, target),
    ]
    for what, each in comparisons.items():
        if each is not own:
            rows.append(at_most(f"mean difference in the contact, over that of {what}", "", contact.mean()
                                / each.table[:, 0].mean(), 1.0, "a fitted table must be better"))  # fmt: skip
            rows.append(at_most(f"mean difference outside, over that of {what}", "", own.table[:, 1].mean()
                                / each.table[:, 1].mean(), 1.0, "a fitted table must be better"))  # fmt: skip
    gradients = min(own.mean()[5:])
    rows.append(at_least("correlation of colour gradients, least of both directions", "", gradients, GRADIENTS, target))
    return rows


def _published(context: Context) -> Path | None:
    folders = [each for each in (context.published, context.reference) if each is not None]
    return next((folder / PUBLISHED for folder in folders if (folder / PUBLISHED).is_file()), None)


def _resized(image: np.ndarray, height: int, width: int) -> np.ndarray:
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
