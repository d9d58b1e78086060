"""Printed dots in the image: their places, which of them the camera sees, and how they darken it."""

import hashlib
import io
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from simgen.errors import InputError
from simgen.sensing.camera.stored_heights import StoredHeights
from simgen.sensors.height_map import HeightMaps
from simgen.sensors.markers import Markers
from simgen.units import MM

wp.set_module_options({"enable_backward": False})

LINES = wp.constant(4)  # lines across a pixel, along which the share that a dot covers is exact
Lines = wp.types.vector(length=LINES, dtype=wp.float32)
# Output mesh and solution differ by less than this. A dot that lies deeper than the gel in its pixels is hidden.
HIDDEN_M = 1e-4


@wp.kernel
def _darken_kernel(
    outline: wp.array3d(dtype=wp.vec2f),
    box: wp.array2d(dtype=wp.vec4i),
    darkness: wp.float32,
    # outputs
    image_out: wp.array4d(dtype=wp.uint8),
):
    """Darken a row by the share of each pixel that dots cover. ``box``: first and last row, first and last column.

    Along a line, a dot covers what lies between the first and the last crossing of its outline.
    """
    sample, row = wp.tid()
    points = outline.shape[2]
    for marker in range(outline.shape[1]):
        inside = box[sample, marker]
        if row < inside[0] or row > inside[1]:
            continue
        first, last = Lines(1.0e9), Lines(-1.0e9)
        a = outline[sample, marker, points - 1]
        for k in range(points):
            b = outline[sample, marker, k]
            for line in range(LINES):
                y = wp.float32(row) - 0.5 + (wp.float32(line) + 0.5) / wp.float32(LINES)
                if (a[1] <= y) != (b[1] <= y):
                    x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
                    first[line] = wp.min(first[line], x)
                    last[line] = wp.max(last[line], x)
            a = b
        for column in range(inside[2], inside[3] + 1):
            start = wp.float32(column) - 0.5
            share = wp.float32(0.0)
            for line in range(LINES):
                share += wp.max(wp.min(last[line], start + 1.0) - wp.max(first[line], start), 0.0)
            share = share / wp.float32(LINES)
            for channel in range(3):
                value = wp.float32(image_out[sample, row, column, channel]) * (1.0 - darkness * share)
                image_out[sample, row, column, channel] = wp.uint8(value + 0.5)


@dataclass(frozen=True)
class MarkerTracks:
    """Dots in the images of some samples. Places are columns and rows, px; the middle of a pixel has whole numbers.

    at : (sample, marker, 2) middles of the dots
    visible : (sample, marker) bool, True where the middle lies in the image and no other gel hides it
    outlines : (sample, marker, OUTLINE, 2)
    drawn : (sample, marker) bool; also True for dots beside the image, which may reach into it
    """

    at: np.ndarray
    visible: np.ndarray
    outlines: np.ndarray
    drawn: np.ndarray


class MarkerDots:
    """Finds and draws dots for one camera.

    heights : of the renderer, with the gel's depth at rest
    rest : `MarkerTracks` of the untouched gel, one sample

    Raises `InputError` if the camera sees no dot.
    """

    def __init__(self, markers: Markers, heights: HeightMaps | StoredHeights):
        self.markers, self.pinhole, self.device = markers, heights.pinhole, heights.device
        self._rest_depth = heights.rest_depth
        vertices = int(markers.corners.max()) + 1
        self.rest = self.tracks(np.zeros((1, vertices, 3)), np.zeros((1, *self._rest_depth.shape)))
        if not self.rest.visible.any():
            raise InputError(f"markers: the camera sees none of {len(markers.rest)} dots; allowed: dots in its image")

    def tracks(self, displacement: np.ndarray, height: np.ndarray) -> MarkerTracks:
        """Find the dots of displacements (sample, vertex, 3) m, under heights (sample, row, column) m, not smoothed."""
        places, depth = self.pinhole.project(self.markers.moved(displacement))
        at, ahead = places[:, :, 0], (depth > 0.0).all(axis=2)
        rows, columns = self._rest_depth.shape
        inside = ahead & (at > -0.5).all(axis=2) & (at < [columns - 0.5, rows - 0.5]).all(axis=2)
        hidden = np.zeros(inside.shape, dtype=bool)
        hidden[inside] = depth[:, :, 0][inside] > self._depth_around(at, inside, height) + HIDDEN_M
        return MarkerTracks(at, inside & ~hidden, places[:, :, 1:], ahead & ~hidden)

    def _depth_around(self, at: np.ndarray, inside: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Largest depth (n,), m, of the gel in the four pixels around each place that is ``inside``."""
        sample = np.nonzero(inside)[0]
        low = np.floor(at[inside]).astype(int)
        last = np.array(self._rest_depth.shape)[::-1] - 1
        deepest = np.full(len(low), -np.inf)
        for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
            column, row = np.clip(low + np.array([right, down]), 0, last).T
            deepest = np.maximum(deepest, self._rest_depth[row, column] - height[sample, row, column])
        return deepest

    def draw(self, image: wp.array, tracks: MarkerTracks) -> wp.array:
        """Darken images (sample, height, width, 3) uint8 in place where dots cover them."""
        last = np.array(image.shape[1:3]) - 1
        corners = np.where(tracks.drawn[..., None, None], tracks.outlines, -9.0)  # those left out end before the image
        low = np.clip(np.ceil(corners.min(axis=2) - 0.5), 0, last[::-1] + 1)
        high = np.clip(np.floor(corners.max(axis=2) + 0.5), -1, last[::-1])
        box = np.stack([low[..., 1], high[..., 1], low[..., 0], high[..., 0]], axis=-1).astype(np.int32)
        inputs = [
            wp.array(corners, dtype=wp.vec2f, device=self.device),
            wp.array(box, dtype=wp.vec4i, device=self.device),
            self.markers.darkness,
        ]
        wp.launch(_darken_kernel, dim=image.shape[:2], inputs=inputs, outputs=[image], device=self.device)
        return image

    def record(self) -> dict[str, Any]:
        """All that decides the dots, for JSON."""
        markers = self.markers
        points = hashlib.sha256(np.round(markers.rest / MM, 6).tobytes()).hexdigest()
        return {
            "number": len(markers.rest),
            "diameter_mm": round(markers.diameter / MM, 6),
            "darkness": markers.darkness,
            "points": points,
        }

    def table(self) -> bytes:
        """Content of ``markers.csv``: places of the dots on the untouched gel, in mm and px, a line for each."""
        lines = ["marker,x_mm,y_mm,z_mm,column,row,visible"]
        rest = self.rest
        for number, (point, at, seen) in enumerate(
            zip(self.markers.rest[:, 0] / MM, rest.at[0], rest.visible[0], strict=True)
        ):
            lines.append(",".join([str(number), *(f"{value:.4f}" for value in (*point, *at)), str(int(seen))]))
        return "\n".join([*lines, ""]).encode()

    def arrays(self, tracks: MarkerTracks, steps: np.ndarray, depth: np.ndarray) -> bytes:
        """Content of ``markers.npz``: tracks of the depths with numbers ``steps`` (n,) and ``depth`` (n,), m."""
        data = io.BytesIO()
        np.savez(
            data,
            displacement_px=(tracks.at - self.rest.at).astype(np.float32),
            rest_px=self.rest.at[0].astype(np.float32),
            visible=tracks.visible,
            depth_m=depth,
            step=steps,
        )
        return data.getvalue()
