"""Gels whose thickness is a height field over an outline: the DIGIT's dome and the GelSight Mini's pad.

Measured dimensions are in mm, surfaces in metres. The gel has a flat back and upright walls.
"""

from collections.abc import Callable

import numpy as np
import trimesh
from scipy.interpolate import RectBivariateSpline

from simgen.sensors.polar_bodies import closed_rings, outward
from simgen.sensors.sensor_schema import Dome, Pad

Ring = tuple[np.ndarray, np.ndarray]  # points (n, 2) as (x, z) mm, and their heights (n,) mm above the back
Edge = tuple[np.ndarray, np.ndarray]  # points (n, 2) as (x, z) mm of an outline, and inward unit normals (n, 2)


def dome_surface(dome: Dome) -> trimesh.Trimesh:
    """Make the closed surface of the gel, m: flat back, upright wall, rounded rim, dome."""
    crown = RectBivariateSpline(dome.x_mm, dome.z_mm, np.array(dome.thickness_mm), kx=3, ky=3)
    spacing, fillet = dome.spacing_mm, dome.rim_radius_mm
    rim, normal = dome_outline(dome)

    def thickness(points: np.ndarray) -> np.ndarray:
        return crown(points[:, 0], np.abs(points[:, 1]), grid=False)

    # Inwards from the wall's top edge: a quarter circle.
    rings = wall(rim, thickness(rim) - fillet, spacing)
    turns = int(np.ceil(fillet * np.pi / 2 / spacing)) + 4
    for turn in np.linspace(0.0, np.pi / 2, turns + 1)[1:]:
        points = rim + normal * fillet * (1.0 - np.cos(turn))
        rings.append((points, thickness(points) - fillet * (1.0 - np.sin(turn))))
    return gel_surface(rings, thickness, spacing, dome.back_y_mm)


def pad_surface(pad: Pad) -> trimesh.Trimesh:
    """Make the closed surface of the gel, m: flat back, upright wall, shoulder, domed face."""
    rim, _ = pad_outline(pad)
    rings = wall(rim, pad_thickness(pad, rim), pad.spacing_mm)
    return gel_surface(rings, lambda points: pad_thickness(pad, points), pad.spacing_mm, pad.back_y_mm)


def pad_thickness(pad: Pad, points: np.ndarray) -> np.ndarray:
    """Thickness (n,) mm of a pad at points (n, 2), (x, z) mm.

    The face is the surface a + b x^2 + c z^2 + d x^2 z^2 through its four given heights. Beside it, the shoulder is a
    circular arc in the plane y and x (or y and z). The arc goes on from the face without a kink, and ends at the
    wall's top. In the corners, the heights of both arcs above the wall's top are multiplied, relative to the face's.
    """
    face = pad.face
    to_end, to_side = face.center_mm - face.end_mm, face.center_mm - face.side_mm
    both = face.center_mm - face.corner_mm - to_end - to_side
    x, z = np.abs(points[:, 0] - pad.center_x_mm), np.abs(points[:, 1])
    u, v = np.minimum(x / face.half_length_mm, 1.0), np.minimum(z / face.half_width_mm, 1.0)
    on_face = face.center_mm - to_end * u**2 - to_side * v**2 - both * u**2 * v**2 - pad.wall_mm
    above_wall = on_face.copy()
    for across, slope, half, half_face in (
        (x, 2.0 * (to_end + both * v**2) / face.half_length_mm, pad.half_length_mm, face.half_length_mm),
        (z, 2.0 * (to_side + both * u**2) / face.half_width_mm, pad.half_width_mm, face.half_width_mm),
    ):
        along = np.clip(across - half_face, 0.0, half - half_face)
        above_wall *= shoulder(along, half - half_face, on_face, slope) / on_face
    return pad.wall_mm + above_wall


def shoulder(along: np.ndarray, width: float, height: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Heights (n,) mm of circular arcs that fall from ``height`` (n,) to 0 over ``width``.

    ``along``: (n,) mm from the arcs' tops. ``slope``: (n,) with which they begin to fall.
    """
    start = np.arctan(slope)
    radius = 0.5 * np.hypot(height, width) / np.sin(np.arctan2(height, width) - start)
    return height - radius * (np.cos(start) - np.sqrt(np.maximum(1.0 - (along / radius + np.sin(start)) ** 2, 0.0)))


def dome_outline(dome: Dome) -> Edge:
    """Make a closed D-shaped outline.

    Straight sides at half width w join a half circle of radius w at the tip and two rounded corners at the rear end.
    """
    w, c, e, r = dome.half_width_mm, dome.arch_center_x_mm, dome.end_x_mm, dome.corner_radius_mm
    spacing = dome.spacing_mm
    return _joined(
        _arc((c, 0.0), w, 90, 270, spacing),
        _line((c, -w), (e - r, -w), spacing),
        _arc((e - r, -w + r), r, -90, 0, spacing),
        _line((e, -w + r), (e, w - r), spacing),
        _arc((e - r, w - r), r, 0, 90, spacing),
        _line((e - r, w), (c, w), spacing),
    )


def pad_outline(pad: Pad) -> Edge:
    """Make a closed outline: a rectangle with rounded corners."""
    r, spacing = pad.corner_radius_mm, pad.spacing_mm
    low, high, w = pad.center_x_mm - pad.half_length_mm, pad.center_x_mm + pad.half_length_mm, pad.half_width_mm
    return _joined(
        _arc((low + r, w - r), r, 90, 180, spacing),
        _line((low, w - r), (low, -w + r), spacing),
        _arc((low + r, -w + r), r, 180, 270, spacing),
        _line((low + r, -w), (high - r, -w), spacing),
        _arc((high - r, -w + r), r, -90, 0, spacing),
        _line((high, -w + r), (high, w - r), spacing),
        _arc((high - r, w - r), r, 0, 90, spacing),
        _line((high - r, w), (low + r, w), spacing),
    )


def _arc(center: tuple[float, float], radius: float, start_deg: float, stop_deg: float, spacing: float) -> Edge:
    """Points from one angle to the other, both included, in six steps or more."""
    start, stop = np.radians([start_deg, stop_deg])
    n = max(int(np.ceil(radius * abs(stop - start) / spacing)), 6)
    a = np.linspace(start, stop, n + 1)
    normal = -np.column_stack([np.cos(a), np.sin(a)])
    return np.array(center) - radius * normal, normal


def _line(start: tuple[float, float], stop: tuple[float, float], spacing: float) -> Edge:
    """Points between two ends, which are left out. The inside is on the left, seen against y."""
    start, stop = np.array(start), np.array(stop)
    length = np.hypot(*(stop - start))
    n = int(np.ceil(length / spacing))
    s = np.linspace(0.0, 1.0, n + 1)[1:-1, None]
    along = (stop - start) / length
    return start + s * (stop - start), np.broadcast_to([-along[1], along[0]], (n - 1, 2))


def _joined(*parts: Edge) -> Edge:
    return np.concatenate([points for points, _ in parts]), np.concatenate([normals for _, normals in parts])


def wall(rim: np.ndarray, top: np.ndarray, spacing: float) -> list[Ring]:
    """Rings of an upright wall over an outline ``rim`` (n, 2), from the back up to heights ``top`` (n,) mm."""
    count = int(np.ceil(top.max() / spacing))
    return [(rim, top * k / count) for k in range(count + 1)]


def gel_surface(
    rings: list[Ring], thickness: Callable[[np.ndarray], np.ndarray], spacing: float, back_y: float
) -> trimesh.Trimesh:
    """Make the closed surface of a gel, m: its back, the given rings from the back's edge on, and the height field.

    Within the last ring, rings shrink to the middle of the outline, at a height of ``thickness`` of their points.
    """
    rim, inner = rings[0][0], rings[-1][0]
    middle = np.array([0.5 * (rim[:, 0].min() + rim[:, 0].max()), 0.0])
    count = int(np.ceil(np.linalg.norm(inner - middle, axis=1).max() / spacing))
    back = [(middle + (rim - middle) * k / count, np.zeros(len(rim))) for k in range(1, count)]
    field = [middle + (inner - middle) * (1.0 - k / count) for k in range(1, count)]
    rings = [*back, *rings, *((points, thickness(points)) for points in field)]
    poles = [(middle[None], np.zeros(1)), *rings, (middle[None], thickness(middle[None]))]
    vertices = np.concatenate([
        np.column_stack([points[:, 0], back_y - height, points[:, 1]]) for points, height in poles
    ])  # fmt: skip
    return outward(vertices, closed_rings(len(rings), len(rim)))
