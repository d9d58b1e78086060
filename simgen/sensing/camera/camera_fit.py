"""Fit of a camera's scale and centre to imprints of a ball at known positions of a stage.

The camera is a pinhole behind a domed gel. A ball of known radius touches the gel beside its own middle, because the
gel is tilted there. So the middle of each imprint is followed along its ray to the gel, and from there along the gel's
normal to the ball's middle. The stage moves that middle. Lengths are in mm, seen from the camera: right and up in the
image, depth along the optical axis.
"""

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Self

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.optimize import least_squares

from simgen.errors import InputError
from simgen.sensing.camera.undeformed_gel import undeformed_depth
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import Camera
from simgen.sensors.sensor_geometry import SensorGeometry
from simgen.units import MM_PER_M

WIDE, MAP_PX = 1.8, 640  # view of the gel's map: the tangent of the camera's, and the map's longer side
LEAST_PLACES = 3
TRIALS = 2000  # pairs of places from which the fit may begin
FAR = 4.0  # standard deviations of the others, by which an outlier is off at least
NEAR, MOST_OFF = 0.01, 0.05  # of the image's shorter side: no outlier is nearer; places that belong to the pictures
LARGEST = 10.0  # factor between the fitted focal length and that of the sensor.yaml
MOST_OUTLIERS = 0.3  # share of the places
LEAST_SPREAD = 0.05  # of places across the line along which they spread most, as a share of the spread along it
RAYLEIGH = np.sqrt(2.0 * np.log(2.0))  # median distance of a normal scatter in the plane, in its standard deviations


@dataclass(frozen=True)
class SeenGel:
    """Coat of the untouched gel along the rays of a camera.

    pinhole : rays of the map, wider than the camera's
    points, normals : (3, height, width) mm and unit vectors, away from the camera; beside the gel, those of its rim
    apex_mm : largest depth of the gel
    """

    pinhole: Pinhole
    points: np.ndarray
    normals: np.ndarray
    apex_mm: float

    @classmethod
    def of(cls, geometry: SensorGeometry, camera: Camera) -> Self:
        """Map the gel of a sensor. Raises `InputError` if the camera does not see it."""
        size = (round(MAP_PX * each / max(camera.height_px, camera.width_px))
                for each in (camera.height_px, camera.width_px))  # fmt: skip
        pinhole = Pinhole.of(camera, *size)
        pinhole = replace(pinhole, focal=pinhole.focal / WIDE)
        depth = MM_PER_M * undeformed_depth(geometry, pinhole)
        nearest = distance_transform_edt(~np.isfinite(depth), return_distances=False, return_indices=True)
        depth = depth[tuple(nearest)]
        x, y = pinhole.across(*np.mgrid[: pinhole.height, : pinhole.width])
        points = np.stack([x, y, np.ones(depth.shape)]) * depth
        down, right = np.gradient(points, axis=(1, 2))
        normals = np.cross(right, down, axis=0)
        normals *= np.sign(normals[2]) / np.linalg.norm(normals, axis=0)
        return cls(pinhole, points, normals, float(depth.max()))

    def balls(self, circles: np.ndarray, image: Pinhole, radius_mm: float) -> tuple[np.ndarray, np.ndarray]:
        """Middles (n, 2) mm of balls, and px per mm (n,) at their contacts, from imprints (n, 3): column, row, radius.

        By Hertz's law an imprint of radius a is a^2 / R deep, so that the ball's middle is R - a^2 / R beyond the gel.
        On simulated presses of a 3 mm ball in a DIGIT, to 0.8 mm, this distance is right to 0.1 mm.
        """
        columns, rows, radii = circles.T
        x, y = image.across(rows, columns)
        focal, height, width = self.pinhole.focal, self.pinhole.height, self.pinhole.width
        at = np.array([0.5 * height - 0.5 - focal * y, 0.5 * width - 0.5 + focal * x])
        point, normal = (np.array([map_coordinates(each, at, order=1, mode="nearest") for each in of])
                         for of in (self.points, self.normals))  # fmt: skip
        scale = image.focal / point[2]
        share = np.minimum(radii / scale / radius_mm, 1.0)
        contact = np.array([x, y]) * point[2]
        return (contact + radius_mm * (1.0 - share**2) * normal[:2]).T, scale


@dataclass(frozen=True)
class CameraFit:
    """A camera's scale and place over a stage, with standard errors.

    focal_px : focal length
    angle_deg : from the image's right to the stage's x axis, counter-clockwise in the image
    centre_mm : (2,) position of the stage over which the optical axis meets the ball's middle
    is_mirrored : the stage's axes are a mirror image of right and up in the image
    covariance : (4, 4) of log(focal_px), angle (radians) and centre_mm
    residual_px : (n, 2) right and up
    used : (n,) bool; the others are outliers
    """

    focal_px: float
    angle_deg: float
    centre_mm: np.ndarray
    is_mirrored: bool
    covariance: np.ndarray
    residual_px: np.ndarray
    used: np.ndarray

    def seen(self, stage_mm: np.ndarray) -> np.ndarray:
        """Middles (n, 2) mm of the ball at stage positions (n, 2), right and up from the optical axis."""
        at = np.array([0.0, np.radians(self.angle_deg), *self.centre_mm])
        return _moved(at, stage_mm, self.is_mirrored)

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the used places."""
        return float(np.sqrt((self.residual_px[self.used] ** 2).sum(axis=1).mean()))

    @property
    def errors(self) -> np.ndarray:
        """Standard errors (4,), of focal_px as a share, the angle in radians and centre_mm."""
        return np.sqrt(np.diag(self.covariance))


def fit_camera(circles: np.ndarray, stage_mm: np.ndarray, radius_mm: float, gel: SeenGel, image: Pinhole) -> CameraFit:
    """Fit focal length, rotation, mirror and centre to imprints (n, 3) px at stage positions (n, 2) mm.

    image : the pictures' camera; its focal length begins the search

    Least squares of the distances in the image. The search begins with the pair of places that most others agree with
    (least median of squares; Rousseeuw, J. Am. Stat. Assoc. 79, 1984), and a Cauchy loss shows the outliers. Raises
    `InputError` if too many places are outliers, the rest lie on one line or do not fit, the scale is beyond
    `LARGEST`, or most imprints are wider than the ball.
    """
    check_places(stage_mm)
    balls, _ = gel.balls(circles, image, radius_mm)
    guesses = [_similarity(balls, stage_mm, mirrored) for mirrored in (False, True)]
    off, start, is_mirrored = min((*guess, mirrored) for guess, mirrored in zip(guesses, (False, True), strict=True))
    if not abs(start[0]) < np.log(LARGEST):
        raise InputError(f"scale of {np.exp(start[0]):.3g} times the sensor.yaml's: allowed: {1.0 / LARGEST:g} to "
                         f"{LARGEST:g} times; positions are in mm")  # fmt: skip
    start = np.array([start[0] + np.log(image.focal), *start[1:]])
    free = [np.inf] * 3
    limits = [np.log(image.focal / LARGEST), *np.negative(free)], [np.log(image.focal * LARGEST), *free]

    def residual(at: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Right and up (2n,), px."""
        seen, scale = gel.balls(circles[used], replace(image, focal=np.exp(at[0])), radius_mm)
        return ((seen - _moved(at, stage_mm[used], is_mirrored)) * scale[:, None]).ravel()

    everything = np.full(len(stage_mm), True)
    near, most = (share * min(image.height, image.width) for share in (NEAR, MOST_OFF))
    loss = max(off * image.focal / gel.apex_mm, near)
    robust = least_squares(residual, start, args=(everything,), loss="cauchy", f_scale=loss, bounds=limits,
                           x_scale="jac")  # fmt: skip
    distance = np.linalg.norm(residual(robust.x, everything).reshape(-1, 2), axis=1)
    count = len(distance)
    scatter = np.median(distance) / RAYLEIGH * np.sqrt(count / (count - 2))  # four parameters, two numbers a place
    used = distance <= max(FAR * scatter, near)
    if (~used).sum() > MOST_OUTLIERS * count or scatter > most:
        raise InputError(f"positions and imprints do not fit: {np.median(distance):.1f} pixels apart (median), "
                         f"{(~used).sum()} of {count} outliers; allowed: at most {most:.3g} pixels and "
                         f"{MOST_OUTLIERS:.0%}")  # fmt: skip
    check_places(stage_mm[used])
    found = least_squares(residual, robust.x, args=(used,), bounds=limits, x_scale="jac", xtol=1e-15, ftol=1e-15,
                          gtol=1e-15)  # fmt: skip
    _, scale = gel.balls(circles, replace(image, focal=np.exp(found.x[0])), radius_mm)
    share = float(np.median(circles[:, 2] / scale / radius_mm))
    if share >= 1.0:
        raise InputError(f"imprints have {share:.3g} of the ball's radius (median); allowed: less than 1")
    degrees = 2 * used.sum() - 4
    covariance = np.linalg.inv(found.jac.T @ found.jac) * 2.0 * found.cost / degrees
    angle = float(np.degrees(np.angle(np.exp(1j * found.x[1]))))
    return CameraFit(float(np.exp(found.x[0])), angle, found.x[2:], is_mirrored, covariance,
                     residual(found.x, everything).reshape(-1, 2), used)  # fmt: skip


def check_places(stage_mm: np.ndarray) -> None:
    """Raise `InputError` if positions (n, 2) are fewer than three places, or lie on one line."""
    places = len(np.unique(stage_mm, axis=0))
    if places < LEAST_PLACES:
        raise InputError(f"{places} different places; allowed: {LEAST_PLACES} and more, not on one line")
    along, across = np.linalg.svd(stage_mm - stage_mm.mean(axis=0), compute_uv=False)
    if across < LEAST_SPREAD * along:
        raise InputError(f"all places lie on one line, to {across / along:.1%} of its length; allowed: places that "
                         f"spread to {LEAST_SPREAD:.0%} across")  # fmt: skip


def _moved(at: np.ndarray, stage_mm: np.ndarray, is_mirrored: bool) -> np.ndarray:
    """Middles (n, 2) of the ball seen from the camera, at stage positions; ``at``: see `CameraFit.covariance`."""
    x, y = (stage_mm - at[2:]).T
    turned = (x - 1j * y if is_mirrored else x + 1j * y) * np.exp(1j * at[1])
    return np.stack([turned.real, turned.imag], axis=1)


def _similarity(balls: np.ndarray, stage_mm: np.ndarray, is_mirrored: bool) -> tuple[float, list[float]]:
    """Similarity from stage to balls through two places, with the least median distance of all places.

    Returns that distance, mm, and the start of a fit: log of the focal length over the present one, angle, centre.
    """
    seen, stage = balls @ [1.0, 1j], stage_mm @ [1.0, -1j if is_mirrored else 1j]
    pairs = np.array(list(combinations(range(len(stage)), 2)))
    if len(pairs) > TRIALS:
        pairs = np.random.default_rng(0).choice(pairs, TRIALS, replace=False)
    apart = np.all([np.abs(of[pairs[:, 0]] - of[pairs[:, 1]]) > 0.0 for of in (seen, stage)], axis=0)
    if not apart.any():
        raise InputError("all imprints lie at one place; allowed: places that spread in the image")
    one, other = pairs[apart].T
    turn = (seen[one] - seen[other]) / (stage[one] - stage[other])
    shift = seen[one] - turn * stage[one]
    distance = np.abs(seen - turn[:, None] * stage - shift[:, None])
    rank = (len(stage) + 3) // 2 - 1  # two places fit exactly
    middle = np.partition(distance, rank, axis=1)[:, rank]
    best = int(middle.argmin())
    centre = -shift[best] / turn[best]
    centre_mm = [float(centre.real), float(-centre.imag if is_mirrored else centre.imag)]
    return float(middle[best]), [float(np.log(np.abs(turn[best]))), float(np.angle(turn[best])), *centre_mm]
