"""A real press of an edge on a DIGIT, frame by frame: width and length of the imprint, real and simulated.

The frames show one press to 1 mm on one sensor (github.com/ndolphin-github/DIGIT_simulation). The source gives its
depths as linear in the frame, from 0 to 1 mm. The edge is the ridge of a roof, 10 mm long, whose flanks fall by 1 in
2.5 (its ``edge.STL``).
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import trimesh
from scipy.optimize import minimize

from simgen.geometry.rigid_shape import sampled_shape
from simgen.sensing.camera.image_files import png
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import Camera, Sensor, load_sensor
from simgen.simulation.height_maps import solution_height_maps
from simgen.simulation.press import Scene, press
from simgen.units import MM
from simgen.verification.measured.edge_images import EdgeLine, NormalColours, read_changes, shifted
from simgen.verification.validate.case import Context, Outcome, Picture, Table, at_most, case

FOLDER, PATTERN = "digit_edge", "edge6_*.jpg"
LENGTH_MM, FALL, BEHIND_MM = 10.0, 2.5, 5.0  # of the roof: ridge and width, run per fall of its flanks, its height
DEEPEST_MM = 1.0  # at the last frame, as the source says
GRID_MM, MARGIN_MM = 0.1, 3.0  # of the roof's sampled distance
DEPTHS_M = MM * 0.1 * np.arange(1, 11)
ABOVE_M = 5e-4  # start of the press above the gel
SHALLOWEST = 0.4  # of the deepest press: frames with less are too faint to measure
CLEAR_LEVELS = 6.0  # change of colour, levels, that belongs to the press
SIZE = 0.10  # share of width and length: a target chosen before the first comparison, which had the source's depth
HEIGHT_PX, WIDTH_PX = 160, 120  # of compared images; details of the frames are coarser
AROUND_PX = 11  # width of what belongs to the surroundings of a press
EVERY = 10  # frames from one fitted frame to the next; so for compared ones


def roof() -> trimesh.Trimesh:
    """The indenter, m: its ridge along x at y = 0, its body towards -y."""
    half = 0.5 * LENGTH_MM
    section = [(0.0, 0.0), (-half / FALL, half), (-BEHIND_MM, half), (-BEHIND_MM, -half), (-half / FALL, -half)]
    return trimesh.convex.convex_hull(MM * np.array([(x, y, z) for x in (-half, half) for y, z in section]))


@dataclass(frozen=True)
class EdgePress:
    """Height maps (depth, height, width) m of a press, the first one at depth 0, and the size of each pixel, m."""

    heights: np.ndarray
    depths_m: np.ndarray
    pixel_m: np.ndarray

    def height(self, depth_m: float) -> np.ndarray:
        """Height map at a depth, linear between the simulated ones."""
        k = int(np.clip(np.searchsorted(self.depths_m, depth_m) - 1, 0, len(self.depths_m) - 2))
        t = (depth_m - self.depths_m[k]) / (self.depths_m[k + 1] - self.depths_m[k])
        return (1.0 - t) * self.heights[k] + t * self.heights[k + 1]

    def shifted(self, right: float, down: float) -> "EdgePress":
        """The same press some pixels aside."""
        return EdgePress(np.array([shifted(h, right, down) for h in self.heights]), self.depths_m, self.pixel_m)


def press_edge(sensor: Sensor, camera: Camera, ridge: EdgeLine) -> EdgePress:
    """Press the roof along the camera's axis where the image shows the ridge."""
    maps = solution_height_maps(sensor.simulation_mesh, camera)[0]
    scene = Scene(sensor, sensor.materials["solid"], outputs=("height_map",), camera=camera)
    shape = sampled_shape(roof(), GRID_MM, MARGIN_MM)
    pose = edge_pose(maps.pinhole, maps.rest_depth, ridge)
    result = press(scene, [shape], pose[None], DEPTHS_M)[0]
    reached = np.isfinite(result.force[:, 0])
    heights = scene.height_step_m * result.height_map[reached].astype(np.float32)
    flat = np.zeros((1, *maps.rest_depth.shape), np.float32)
    depths = np.concatenate([[0.0], DEPTHS_M[reached]])
    return EdgePress(np.concatenate([flat, heights]), depths, np.float32(maps.rest_depth / maps.pinhole.focal))


def edge_pose(pinhole: Pinhole, rest_depth: np.ndarray, ridge: EdgeLine) -> np.ndarray:
    """Pose (4, 4) m of the roof: +y against the camera's axis, x along the ridge, its middle just above the gel."""
    right, up, forward = pinhole.axes
    x, y = pinhole.across(np.array(ridge.row), np.array(ridge.column))
    depth = rest_depth[round(ridge.row), round(ridge.column)]
    pose = np.eye(4)
    pose[:3, 0] = ridge.direction[0] * right - ridge.direction[1] * up
    pose[:3, 1] = -forward
    pose[:3, 2] = np.cross(pose[:3, 0], pose[:3, 1])
    pose[:3, 3] = pinhole.position + depth * np.array([x, y, 1.0]) @ pinhole.axes + ABOVE_M * forward
    return pose


@dataclass(frozen=True)
class EdgeFit:
    """A simulated press that looks most like the frames: colours, place and the depth of the last frame.

    pressed : the press, shifted to its place in the image
    right, down : px, of the shift
    last_m : m, depth of the last frame
    left : rms of what is left, levels
    """

    colours: NormalColours
    pressed: EdgePress
    right: float
    down: float
    last_m: float
    left: float

    def change(self, share: float) -> np.ndarray:
        """Change of colour (height, width, 3), levels, at a share of the last frame's depth."""
        return self.colours(self.pressed.height(share * self.last_m), self.pressed.pixel_m)


def fit(
    pressed: EdgePress, changes: np.ndarray, shares: np.ndarray, where: np.ndarray, last_m: float | None = None,
    blurred: bool = True,
) -> EdgeFit:  # fmt: skip
    """Fit colours, place and blur to frames (n, height, width, 3) at shares (n,) of the last depth.

    The last depth is fitted, too, unless it is given. ``where`` (height, width): pixels that count.
    """

    def at(parameters: np.ndarray) -> EdgeFit:
        right, down, blur, last_mm = parameters.tolist()
        moved = pressed.shifted(right, down)
        last = MM * float(np.clip(last_mm, 0.1, DEEPEST_MM))
        heights = [moved.height(share * last) for share in shares]
        colours = NormalColours.fit(heights, pressed.pixel_m, changes, where, abs(blur))
        off = [colours(h, pressed.pixel_m)[where] - change[where] for h, change in zip(heights, changes, strict=True)]
        return EdgeFit(colours, moved, right, down, last, float(np.sqrt(np.mean(np.square(off)))))

    free = np.array([True, True, blurred, last_m is None])
    first = np.array([0.0, 0.0, 2.0 if blurred else 0.0, DEEPEST_MM if last_m is None else last_m / MM])
    simplex = np.vstack([first, first + np.diag([3.0, 3.0, 2.0, -0.2])[free]])
    whole = first.copy()

    def left(values: np.ndarray) -> float:
        whole[free] = values
        return at(whole).left

    found = minimize(left, first[free], method="Nelder-Mead",
                     options={"initial_simplex": simplex[:, free], "xatol": 0.02, "fatol": 1e-3})  # fmt: skip
    whole[free] = found.x
    return at(whole)


def located(camera: Camera, changes: np.ndarray, shares: np.ndarray, where: np.ndarray) -> EdgeLine:
    """The ridge's place. One end of an imprint may be faint, so a press on the coarse mesh corrects its middle."""
    ridge = EdgeLine.of(changes[-1])
    coarse = fit(press_edge(load_sensor("digit", mesh="coarse"), camera, ridge), changes, shares, where)
    return EdgeLine(ridge.column + coarse.right, ridge.row + coarse.down, ridge.direction)


@case("measured-digit-edge", "An edge in a real DIGIT, frame by frame: width and length of its imprint", "standard")
def digit_edge(context: Context) -> Outcome:
    """Fit colours to every tenth frame, and compare the imprints between them."""
    folder = None if context.measured is None else context.measured / FOLDER
    if folder is None or not list(folder.glob(PATTERN)):
        return Outcome([], skipped=f"no {FOLDER} in --measured DIR: the pictures belong to others")
    sensor = load_sensor("digit")
    camera = replace(sensor.cameras["default"], height_px=HEIGHT_PX, width_px=WIDTH_PX)
    changes = read_changes(folder, PATTERN, HEIGHT_PX, WIDTH_PX)
    shares = np.linspace(0.0, 1.0, len(changes))
    where = around_press(changes[-1])
    fitted, compared = np.arange(EVERY - 1, len(changes), EVERY), np.arange(EVERY // 2 - 1, len(changes), EVERY)
    compared = compared[shares[compared] >= SHALLOWEST]
    ridge = located(camera, changes[fitted], shares[fitted], where)
    pressed = press_edge(sensor, camera, ridge)
    fits = {
        what: fit(pressed, changes[fitted], shares[fitted], where, last_m, blurred)
        for what, last_m, blurred in (("fitted depth", None, True), ("the source's depth", MM * DEEPEST_MM, True),
                                      ("the source's depth, not blurred", MM * DEEPEST_MM, False))
    }  # fmt: skip
    pixel_mm = float(np.median(pressed.pixel_m[where])) / MM
    real = np.array([ridge.extent(changes[frame], pixel_mm) for frame in compared])
    sizes = {
        what: np.array([ridge.extent(each.change(shares[frame]), pixel_mm) for frame in compared])
        for what, each in fits.items()
    }
    own = fits["fitted depth"]
    ratios = sizes["fitted depth"] / real
    off_by = np.median(np.abs(ratios - 1.0), axis=0).tolist()
    rows = [
        at_most(f"{what} of the imprint, median difference, last depth fitted", "", value, SIZE, "a chosen target")
        for what, value in zip(("width", "length"), off_by, strict=True)
    ]
    off, untouched = (np.mean([np.abs(change - changes[frame])[where].mean() for frame, change in each]) for each in (
        [(frame, own.change(shares[frame])) for frame in compared], [(frame, 0.0) for frame in compared]))  # fmt: skip
    rows.append(at_most("mean difference of colours, over that of the untouched gel", "", off / untouched, 1.0,
                        "a press must be nearer than none"))  # fmt: skip
    columns = ["frame", "real: width, mm", "length, mm", *(f"{what}: {size}" for what in sizes
               for size in ("width, ratio", "length, ratio"))]  # fmt: skip
    lines = [[str(frame), *real[i], *(value for each in sizes.values() for value in each[i] / real[i])]
             for i, frame in enumerate(compared)]  # fmt: skip
    summary = [[what, each.last_m / MM, each.colours.blur_px * pixel_mm, each.left] for what, each in fits.items()]
    return Outcome(
        rows,
        [Table("Imprints of the frames that no colours were fitted to", columns, lines),
         Table("Fits", ["with", "last depth, mm", "blur, mm", "left, levels (rms)"], summary)],
        notes=[f"{len(fitted)} frames fitted, {len(compared)} compared; images of {WIDTH_PX} x {HEIGHT_PX} pixels; "
               f"colours are off by {off:.2f} levels, those of the untouched gel by {untouched:.2f}",
               "left: the change of colour in the real frame, twice; right: that of the simulated press"],
        pictures=[Picture("Frames that no colours were fitted to", pairs(own, changes, shares, compared))],
    )  # fmt: skip


def around_press(change: np.ndarray) -> np.ndarray:
    """Pixels (height, width) that a press changes clearly, and those around them."""
    clear = np.abs(cv2.GaussianBlur(change, (0, 0), 1.0)).max(axis=2) > CLEAR_LEVELS
    return cv2.dilate(clear.astype(np.uint8), np.ones((AROUND_PX, AROUND_PX))) > 0


def pairs(own: EdgeFit, changes: np.ndarray, shares: np.ndarray, frames: np.ndarray) -> bytes:
    """PNG of changes of colour in frames beside those of the simulated press."""
    tiles = [np.hstack([changes[frame], own.change(shares[frame])]) for frame in frames]
    return png(np.clip(128.0 + 2.0 * np.hstack(tiles), 0.0, 255.0).astype(np.uint8))
