"""Fit of a table of colours to pictures of a ball, on surfaces of simulated presses.

Inside the contact circle the gel follows the ball, whatever the gel is made of, and `table_fit` needs no more. A
simulated press also gives the tilt around the contact. So the table is fitted to the whole dent, and the place and the
depth of each press follow from all of its colours, not from the edge of a blurred circle.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.optimize import minimize

from simgen.errors import InputError
from simgen.sensing.camera.ball_presses import BallPresses
from simgen.sensing.camera.imprint import find_imprint
from simgen.sensing.camera.response import PUBLISHED_SIZE, Placement, Response
from simgen.sensing.camera.shading import Shading
from simgen.sensing.camera.spheres import Circle
from simgen.sensing.camera.table_fit import Observations, fit_response

SLOPE_LEVELS = 255.0  # grey levels of a slope of 1, where slopes stand for changes of colour
ROUNDS = 2  # of finding the presses and fitting the table
REACH = 2.2  # imprint radii around its centre that are fitted
EVALUATIONS, SHIFT_PX = 45, 5.0  # of a search for place and depth; its first step
DEPTH_STEP = 0.12e-3  # m, first step of that search


@dataclass(frozen=True)
class PicturedPress:
    """Depth, m, of a press and its shift to the right and down, px, from the place where it was simulated."""

    depth_m: float
    right: float = 0.0
    down: float = 0.0


class PressedPictures:
    """Pictures of a ball with simulated presses at the same places.

    pictures : (place, height, width, 3) uint8, of the size of the presses' camera
    background : (height, width, 3) uint8, of the untouched gel
    circles : imprints of the pictures, see `find_imprint`
    """

    def __init__(
        self, pictures: np.ndarray, background: np.ndarray, circles: Sequence[Circle], presses: BallPresses
    ):
        self.pictures, self.background, self.circles, self.presses = pictures, background, circles, presses
        height, width = background.shape[:2]
        self._rows, self._columns = np.mgrid[:height, :width]
        self._pixel = presses.rest_depth / presses.pinhole.focal
        self._placement = Placement.of(height, width, *PUBLISHED_SIZE[::-1])
        self._last: Shading | None = None

    def picture(self, response: Response, place: int, press: PicturedPress) -> np.ndarray:
        """Image (height, width, 3) uint8 of a press by a table of colours."""
        height = self.presses.height(place, press.depth_m, press.right, press.down)
        return self._shading(response)(wp.array(height[None], dtype=wp.float32)).numpy()[0]

    def levels(self, response: Response, place: int, press: PicturedPress) -> tuple[float, float]:
        """Mean change of colour in a picture's contact, and mean difference of the press's image there, levels."""
        contact, picture = self.around(place, 1.0), self.pictures[place].astype(float)
        others = self.background, self.picture(response, place, press)
        return tuple(float(np.abs(picture - other)[contact].mean()) for other in others)

    def around(self, place: int, radii: float) -> np.ndarray:
        """Pixels (height, width) bool within this many radii of the middle of an imprint."""
        circle = self.circles[place]
        return np.hypot(self._columns - circle.column, self._rows - circle.row) < radii * circle.radius

    def press_by_slope(self, place: int) -> PicturedPress:
        """Depth whose slopes, before any colours are known, reach as far as the picture's colours change."""
        depths = self.presses.depths_m
        heights = (self.presses.height(place, depth) for depth in depths)
        radii = [_radius(SLOPE_LEVELS * np.hypot(*np.gradient(each)) / self._pixel) for each in heights]
        return PicturedPress(float(np.interp(self.circles[place].radius, np.maximum.accumulate(radii), depths)))

    def press_by_radius(self, response: Response, place: int) -> PicturedPress:
        """Depth whose imprint, in the colours of a table, has the radius of the picture's."""
        depths = self.presses.depths_m
        images = (self.picture(response, place, PicturedPress(depth)) for depth in depths)
        radii = [_radius(image.astype(float) - self.background) for image in images]
        return PicturedPress(float(np.interp(self.circles[place].radius, np.maximum.accumulate(radii), depths)))

    def press_by_colours(self, response: Response, place: int, start: PicturedPress) -> PicturedPress:
        """Place and depth with the least mean absolute difference of colours around the imprint."""
        near, wanted = self.around(place, REACH), self.pictures[place].astype(np.int16)
        scale = np.array([DEPTH_STEP, SHIFT_PX, SHIFT_PX])

        def difference(at: np.ndarray) -> float:
            return float(np.abs(self.picture(response, place, PicturedPress(*(at * scale))) - wanted)[near].mean())

        first = np.array([start.depth_m, start.right, start.down]) / scale
        options = {"initial_simplex": np.vstack([first, first + np.eye(3)]), "maxfev": EVALUATIONS}
        return PicturedPress(*(minimize(difference, first, method="Nelder-Mead", options=options).x * scale))

    def observe(self, place: int, press: PicturedPress) -> Observations:
        """Slopes of a press, and changes of colour in its picture, around the imprint."""
        height = self.presses.height(place, press.depth_m, press.right, press.down)
        down, right = np.gradient(height) / self._pixel
        near = self.around(place, REACH)
        change = self.pictures[place][near].astype(float) - self.background[near]
        position = self._placement.position(self._rows[near], self._columns[near])
        return Observations(*self._placement.slope(down[near], right[near]), *position, change)

    def fit(
        self, places: Sequence[int], source: str = "", rounds: int = ROUNDS
    ) -> tuple[Response, list[PicturedPress]]:
        """Fit a table to some of the pictures, and find their presses."""
        presses = [self.press_by_slope(place) for place in places]
        response = self._fitted(places, presses, source)
        for _ in range(rounds):
            presses = [self.press_by_colours(response, *each) for each in zip(places, presses, strict=True)]
            response = self._fitted(places, presses, source)
        return response, presses

    def _fitted(self, places: Sequence[int], presses: Sequence[PicturedPress], source: str) -> Response:
        return fit_response((self.observe(*each) for each in zip(places, presses, strict=True)), source=source)

    def _shading(self, response: Response) -> Shading:
        """Shading by a table; the last one is kept."""
        if self._last is None or self._last.response is not response:
            self._last = Shading(response, self._pixel, self.background)
        return self._last


def _radius(change: np.ndarray) -> float:
    """Radius, px, of the imprint of changes (height, width) or (height, width, 3); 0 without one."""
    try:
        return find_imprint(change if change.ndim == 3 else change[..., None]).radius
    except InputError:
        return 0.0
