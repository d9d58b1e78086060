"""The least share of the gel's thickness that an indenter leaves anywhere under it.

Each column along the press axis (see `gel_columns`) has gel of thickness t in front of a rigid body. The indenter moves
along its path from first touch and ends at a distance l before the rigid body, in the same column. It leaves the share
l / t. If the rigid body is a core behind a gap, l includes the gap and t is the skin's thickness alone, as in
`room.Room`. The share is then above 1 until the gap is closed. It is negative if the indenter ends inside the rigid
body. Columns without gel, and columns that leave the gel at a free surface, do not count.

First touch and least share are found on the lattice, so each is off by half a column at most. With a fillet of 1 mm and
columns of 0.25 mm the height is off by less than 0.02 mm.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp

from simgen.config.indenter_path import IndenterPath
from simgen.geometry.rigid_shape import highest, lateral_reach, shape_array
from simgen.geometry.signed_distance import RigidShape, distance
from simgen.sensors.gel_columns import GelColumns, Lattice
from simgen.sensors.sensor import Sensor
from simgen.sensors.support import MARGIN_MM
from simgen.units import MM_PER_M

wp.set_module_options({"enable_backward": False})

SPACING_MM = 0.25  # of the columns
LEAST_ACROSS = 20  # least columns between the axis and the widest indenter's rim: closer ones for small indenters
STARTS_MM = 1.0  # above the highest indenter: sphere tracing begins here
ENDS_MM = 10.0  # plus the widest indenter's reach, below the tip plane: sphere tracing ends here
STEPS, CLOSE_MM = 200, 1e-6  # of sphere tracing: most steps, tolerance
MOST_THREADS = 16  # more wait for the interpreter's lock: on 64 cores, 64 threads take as long
MOST_COLUMNS = 32_768  # columns that a thread measures at a time: they fit into a cache


@wp.kernel
def face_kernel(
    shapes: wp.array(dtype=RigidShape),
    columns: wp.array2d(dtype=wp.vec2d),
    starts: wp.float64,
    ends: wp.float64,
    # outputs
    height: wp.array3d(dtype=wp.float64),
):
    """Height (position, shape, column) mm of each shape's face, by sphere tracing; -inf in columns that miss it."""
    p, s, m = wp.tid()
    x = wp.vec3d(columns[p, m][0], starts, columns[p, m][1])
    height[p, s, m] = -wp.float64(wp.inf)
    for _ in range(STEPS):
        gap = distance(shapes[s], x)
        x[1] -= gap
        if gap < wp.float64(CLOSE_MM):
            height[p, s, m] = x[1]
            return
        if x[1] < ends:
            return


@wp.kernel
def touch_kernel(
    surface: wp.array2d(dtype=wp.float64),
    height: wp.array3d(dtype=wp.float64),
    # outputs
    touch: wp.array2d(dtype=wp.float64),
):
    """Travel (pose, shape) mm to first touch, at position 0."""
    n, s = wp.tid()
    least = wp.float64(wp.inf)
    for m in range(surface.shape[1]):
        if height[0, s, m] > -wp.float64(wp.inf):
            least = wp.min(least, surface[n, m] - height[0, s, m])
    touch[n, s] = least


@wp.kernel
def left_kernel(
    rigid: wp.array2d(dtype=wp.float64),
    thickness: wp.array2d(dtype=wp.float64),
    height: wp.array3d(dtype=wp.float64),
    touch: wp.array2d(dtype=wp.float64),
    depth: wp.array(dtype=wp.float64),
    share: wp.float64,
    # outputs
    least_share: wp.array3d(dtype=wp.float64),
    least_room: wp.array3d(dtype=wp.float64),
):
    """Least share (pose, shape, position) left at each position's depth, and the depth, mm, that leaves ``share``."""
    n, s, p = wp.tid()
    least, room = wp.float64(wp.inf), wp.float64(wp.inf)
    for m in range(rigid.shape[1]):
        if height[p, s, m] > -wp.float64(wp.inf) and rigid[n, m] < wp.float64(wp.inf):
            left = rigid[n, m] - height[p, s, m] - touch[n, s]
            least = wp.min(least, (left - depth[p]) / thickness[n, m])
            room = wp.min(room, left - share * thickness[n, m])
    least_share[n, s, p] = least
    least_room[n, s, p] = room


@wp.kernel
def support_kernel(
    support: wp.array(dtype=RigidShape),
    rotation: wp.array(dtype=wp.mat33d),
    origin: wp.array(dtype=wp.vec3d),
    columns: wp.array(dtype=wp.vec2d),
    rigid: wp.array2d(dtype=wp.float64),
    height: wp.array3d(dtype=wp.float64),
    touch: wp.array2d(dtype=wp.float64),
    depth: wp.array(dtype=wp.float64),
    # outputs
    least_share: wp.array3d(dtype=wp.float64),
    least_room: wp.array3d(dtype=wp.float64),
):
    """Lower share and depth where a shape meets the support beside the gel, by sphere tracing from first touch."""
    n, s, p = wp.tid()
    room = least_room[n, s, p]
    ahead = rotation[n] * wp.vec3d(wp.float64(0.0), wp.float64(1.0), wp.float64(0.0))
    for m in range(rigid.shape[1]):
        if height[p, s, m] > -wp.float64(wp.inf) and rigid[n, m] == wp.float64(wp.inf):
            start = wp.vec3d(columns[m][0], height[p, s, m] + touch[n, s], columns[m][1])
            x = origin[n] + rotation[n] * start
            gone = wp.float64(0.0)
            for _ in range(STEPS):
                gap = distance(support[0], x + gone * ahead)
                if gap < wp.float64(CLOSE_MM):
                    room = wp.min(room, gone)
                    break
                # Beyond the grid of a sampled distance the gap may be too large; the grid's margin bounds the step.
                gone += wp.min(gap, wp.float64(MARGIN_MM))
                if gone > room:
                    break
    if room < least_room[n, s, p] and room < depth[p]:
        least_share[n, s, p] = -wp.float64(wp.inf)
    least_room[n, s, p] = room


class LeastThickness:
    """Least share of the thickness of one sensor's gel that each indenter leaves.

    shapes : the indenters, in the order of the results
    path : path from first touch; only its points count, not the segments between them
    """

    def __init__(self, sensor: Sensor, shapes: Sequence[RigidShape], path: IndenterPath):
        self._gel, self._path = GelColumns(sensor), path
        self._support = None if sensor.support is None else shape_array([sensor.support.shape("cpu")])
        reach = max(map(lateral_reach, shapes))
        spacing = min(SPACING_MM, reach / LEAST_ACROSS)
        # Offsets are rounded to columns, and turns to one column at half the rim's radius. Points of fine paths then
        # share positions.
        unit = np.array([spacing, spacing, 2.0 * spacing / reach])
        places = np.column_stack([path.offsets_m[:, [0, 2]] * MM_PER_M, path.turns_rad])
        places = unit * np.round(places / unit)
        # Position 0 is first touch; a straight press has no other.
        places, self._position = np.unique(np.vstack([np.zeros(3), places]), axis=0, return_inverse=True)
        order = np.argsort(np.arange(len(places)) != self._position[0], kind="stable")
        places, self._position = places[order], np.argsort(order)[self._position[1:]]
        depths = np.full(len(places), -np.inf)
        np.maximum.at(depths, self._position, path.depths_m * MM_PER_M)
        self._depths = wp.array(depths, dtype=wp.float64, device="cpu")
        widest = MM_PER_M * float(np.linalg.norm(sensor.surface.extents))
        furthest = min(reach + MM_PER_M * path.lateral_reach_m, widest)
        half = int(np.ceil(furthest / spacing))
        square = Lattice(spacing, half, half)
        height = self._faces(shapes, places, square.points, -ENDS_MM - reach)
        self._lattice, self._height = _cropped(square, height)
        self._columns = wp.array(self._lattice.points, dtype=wp.vec2d, device="cpu")

    def _faces(self, shapes: Sequence[RigidShape], places: np.ndarray, points: np.ndarray, ends: float) -> np.ndarray:
        """Heights (position, shape, column) mm of the indenters' faces at points (column, 2) mm, tips at height 0."""
        from_tip = points[None] - places[:, None, :2]
        cos, sin = np.cos(places[:, 2:]), np.sin(places[:, 2:])
        x, z = from_tip[..., 0], from_tip[..., 1]
        own = np.stack([cos * x - sin * z, sin * x + cos * z], axis=-1)
        height = wp.empty((len(places), len(shapes), len(points)), dtype=wp.float64, device="cpu")
        starts = STARTS_MM + max(map(highest, shapes))
        inputs = [shape_array(shapes), wp.array(own, dtype=wp.vec2d, device="cpu"), starts, ends]
        wp.launch(face_kernel, dim=height.shape, inputs=inputs, outputs=[height], device="cpu")
        return height.numpy()

    def shares(self, poses: np.ndarray) -> np.ndarray:
        """Least share (n, shapes) over the whole path; inf where no gel lies under an indenter.

        poses : (n, 4, 4) m, indenter frame -> sensor frame, near the surface
        """
        return self._least(poses, 0.0)[0].min(axis=2)

    def depths_that_leave(self, poses: np.ndarray, share: float) -> np.ndarray:
        """Largest depth (n, shapes, point of the path) m that leaves a share; inf where no gel lies under an indenter.

        The indenter has the point's offset and turn.
        """
        return self._least(poses, share)[1][:, :, self._position] / MM_PER_M

    def steps_that_leave(self, poses: np.ndarray, share: float) -> np.ndarray:
        """Number (n, shapes) of the path's first points that all leave a share."""
        too_deep = self._path.depths_m > self.depths_that_leave(poses, share)
        return np.where(too_deep.any(axis=2), too_deep.argmax(axis=2), len(self._path))

    def _least(self, poses: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
        """Least share, and largest depth mm that leaves ``share``: (n, shapes, position) each. Runs in threads."""
        threads = min(MOST_THREADS, os.cpu_count() or 1)  # kernels release the interpreter's lock
        each = max(1, -(-len(poses) // threads))
        least, room = np.empty((2, len(poses), *self._height.shape[1::-1]))

        def measure(first: int):
            part = slice(first, first + each)
            self._measure(poses[part], share, least[part], room[part])

        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(measure, range(0, len(poses), each)))
        return least, room

    def _measure(self, poses: np.ndarray, share: float, least_out: np.ndarray, room_out: np.ndarray):
        """Write the results of poses (n, 4, 4) into arrays (n, shapes, position), a few poses at a time."""
        positions, shapes, columns = self._height.shape
        size = min(len(poses), max(1, MOST_COLUMNS // columns))
        buffers = self._gel.buffers(size, self._lattice)
        surface, rigid, thickness = buffers.columns
        touch = wp.empty((size, shapes), dtype=wp.float64, device="cpu")
        least, room = (wp.empty((size, shapes, positions), dtype=wp.float64, device="cpu") for _ in range(2))
        for first in range(0, len(poses), size):
            some = poses[first : first + size]
            self._gel.cut(some, self._lattice, buffers)
            dim = len(some), shapes, positions
            wp.launch(touch_kernel, dim[:2], inputs=[surface, self._height], outputs=[touch], device="cpu")
            inputs = [rigid, thickness, self._height, touch, self._depths, share]
            wp.launch(left_kernel, dim, inputs=inputs, outputs=[least, room], device="cpu")
            if self._support is not None:
                inputs = [self._support, *buffers.frames, self._columns, rigid, self._height, touch, self._depths]
                wp.launch(support_kernel, dim, inputs=inputs, outputs=[least, room], device="cpu")
            for values, out in ((least, least_out), (room, room_out)):
                out[first : first + size] = values.numpy()[: len(some)]


def _cropped(square: Lattice, height: np.ndarray) -> tuple[Lattice, wp.array]:
    """Crop a lattice to the columns that meet an indenter."""
    side = 2 * square.half_x + 1
    covered = np.isfinite(height).any(axis=(0, 1)).reshape(side, side)
    half_x, half_z = (
        int(np.abs(np.flatnonzero(covered.any(axis=axis)) - square.half_x).max(initial=0)) for axis in (1, 0)
    )
    middle = square.half_x
    kept = height.reshape(*height.shape[:2], side, side)
    kept = kept[:, :, middle - half_x : middle + half_x + 1, middle - half_z : middle + half_z + 1]
    heights = np.ascontiguousarray(kept).reshape(*height.shape[:2], -1)
    return Lattice(square.spacing, half_x, half_z), wp.array(heights, dtype=wp.float64, device="cpu")
