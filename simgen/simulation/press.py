"""Presses of indenters into a sensor, from first touch to depths or along a path: samples with certificates."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgen.config.indenter_path import DOWN
from simgen.config.outputs import BY_NAME, CERTIFICATE, NOT_REACHED
from simgen.config.solver_settings import SolverSettings
from simgen.errors import InputError, shown
from simgen.fem.nonlinear.status import Status
from simgen.geometry.rigid_shape import lateral_reach
from simgen.geometry.signed_distance import RigidShape
from simgen.simulation.error_estimate import force_error_estimate
from simgen.simulation.first_touch import first_touch
from simgen.simulation.load_stepping import LoadStepping
from simgen.simulation.scene import Scene
from simgen.simulation.tries import Press
from simgen.units import MM_PER_M

__all__ = ["PressResult", "Scene", "SolverSettings", "Status", "follow", "press"]


@dataclass
class PressResult:
    """One press on one sensor, at d depths or points of a path.

    outputs : arrays (d, ...) by name, with the shapes, units and meanings of `simgen.config.outputs`. Each is also an
        attribute: ``result.force`` is (d, 3). Where the press did not get that far, ``status`` has the reason and all
        others are NaN, or -32768 in the int16 ``height_map``. None for an output that the scene does not measure
    touch : m, travel along the press axis from the given pose to first touch; NaN without a touch
    seconds : this press's share of the wall time of the presses that ran together
    """

    outputs: dict[str, np.ndarray]
    touch: float
    seconds: float

    def __getattr__(self, name: str) -> np.ndarray | None:
        if name not in BY_NAME:
            raise AttributeError(f"{name} is no output of a press; allowed: {', '.join(BY_NAME)}")
        return self.outputs.get(name)

    @property
    def certificate(self) -> dict[str, np.ndarray]:
        """Accuracy measures of each sample by name, arrays (d,)."""
        names = (name for name in self.outputs if BY_NAME[name].is_certificate)
        return {name.removeprefix(CERTIFICATE): self.outputs[name] for name in names}


def press(scene: Scene, shapes: list[RigidShape], poses: np.ndarray, depths_m: np.ndarray) -> list[PressResult]:
    """Press indenters along their +y axes to all depths from first touch; ``scene.batch`` presses run at a time.

    poses (b, 4, 4): indenter frame -> sensor frame, m, near the surface; depths_m (d,) increasing.
    """
    return follow(scene, shapes, poses, np.asarray(depths_m, dtype=float)[:, None] * DOWN)


def follow(
    scene: Scene,
    shapes: list[RigidShape],
    poses: np.ndarray,
    path_m: np.ndarray,
    turns_rad: np.ndarray | None = None,
    steps: np.ndarray | None = None,
    max_force_n: float = math.inf,
) -> list[PressResult]:
    """Move indenters along one path from first touch, and keep a sample at every point of the path.

    Straight lines join the points in order. So a path can shear, twist, slide and release.

    poses : (b, 4, 4) m, indenter frame -> sensor frame, near the surface
    path_m : (d, 3) m, offsets of the tip from first touch in the contact frame, which is the indenter's frame at first
        touch: +y presses, x and z shear
    turns_rad : (d,) rad, right-handed turns of the indenter about its +y; none by default
    steps : (b,) number of points, 0 to d, that each press follows; if less than d, it ends with `Status.NO_ROOM`. All
        points by default
    max_force_n : N, along the press axis. A press ends with `Status.FORCE_LIMIT` at the first point where its force
        exceeds this; the sample there is not kept. Forces between the points are not checked

    Raises `InputError` for a path without points, for numbers that are not finite, and for steps or a force out of
    range.

    This example presses a sphere 0.4 mm deep into the DIGIT, shears by 0.2 mm, turns by 10 degrees and lets go:

    >>> import numpy as np
    >>> from simgen.sensors.indenter import load_indenter
    >>> from simgen.simulation.press import Scene, follow
    >>> from simgen.sensors.sensor import load_sensor
    >>> digit = load_sensor("digit", mesh="coarse")
    >>> scene = Scene(digit, digit.materials["solid"])
    >>> pose = np.eye(4)
    >>> pose[:3, 3] = [-0.006, -0.0083, 0.0]  # m; the tip is at the top of the gel, and +y goes into it
    >>> path_mm = [[0.0, 0.2, 0.0], [0.0, 0.4, 0.0], [0.2, 0.4, 0.0], [0.2, 0.4, 0.0], [0.2, -0.1, 0.0]]
    >>> turns = np.radians([0.0, 0.0, 0.0, 10.0, 10.0])
    >>> result = follow(scene, [load_indenter("sphere_7mm").shape()], pose[None], 1e-3 * np.array(path_mm), turns)[0]
    >>> result.status.tolist()
    [0, 0, 0, 0, 0]
    >>> np.round(result.force[:, 1], 2).tolist()  # N along the press axis; at the last point the tip is above the gel
    [0.2, 0.63, 0.63, 0.63, 0.0]
    >>> np.round(result.shear_force[2:, 0], 2).tolist()  # N along x: friction drags the gel along
    [0.24, 0.21, 0.0]
    >>> (result.slip_share[2] < 0.3 < result.slip_share[3]).tolist()  # the turn makes half of the contact slide
    True
    """
    path, steps = checked_path(len(shapes), poses, path_m, turns_rad, steps, max_force_n)
    if not len(shapes):
        return []
    stepping, presses = begin(scene, shapes, poses, path, steps, max_force_n)
    while stepping.remaining:
        stepping.advance()
    return [result_of(stepping, press) for press in presses]


def checked_path(
    count: int,
    poses: np.ndarray,
    path_m: np.ndarray,
    turns_rad: np.ndarray | None,
    steps: np.ndarray | None,
    max_force_n: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Check the arguments of `follow` for so many presses.

    Returns the path (d, 4), offsets in mm and turns in rad, and the steps (count,). Raises `InputError`.
    """
    path_m = np.asarray(path_m, dtype=float)
    if path_m.ndim != 2 or path_m.shape[1] != 3 or not len(path_m) or not np.isfinite(path_m).all():
        raise InputError(f"path of shape {path_m.shape}: allowed: one or more points of three finite coordinates, m")
    turns_rad = np.zeros(len(path_m)) if turns_rad is None else np.asarray(turns_rad, dtype=float)
    if turns_rad.shape != path_m.shape[:1] or not np.isfinite(turns_rad).all():
        raise InputError(f"turns of shape {turns_rad.shape}: allowed: a finite angle, rad, for each point of the path")
    steps = np.full(count, len(path_m)) if steps is None else np.asarray(steps)
    if steps.shape != (count,) or ((steps < 0) | (steps > len(path_m))).any():
        raise InputError(f"steps {shown(str(steps.tolist()))}: allowed: 0 to {len(path_m)} for each of {count} presses")
    if not max_force_n > 0.0:
        raise InputError(f"max_force_n {max_force_n}: allowed: above 0 N")
    if not np.isfinite(poses).all():
        raise InputError("poses: not finite; allowed: rigid transforms, m")
    return np.column_stack([path_m * MM_PER_M, turns_rad]), steps


def begin(
    scene: Scene,
    shapes: Sequence[RigidShape],
    poses: np.ndarray,
    path: np.ndarray,
    steps: np.ndarray,
    max_force_n: float,
) -> tuple[LoadStepping, list[Press]]:
    """Forget earlier presses of the scene, and queue presses (b,) along a path (d, 4) that `checked_path` returned."""
    distinct = list({id(shape): shape for shape in shapes}.values())
    number = {id(shape): i for i, shape in enumerate(distinct)}
    scene.reset(distinct)
    stepping = LoadStepping(scene, path, max_force_n)
    return stepping, begin_presses(stepping, distinct, [number[id(shape)] for shape in shapes], poses, steps)


def begin_presses(
    stepping: LoadStepping, shapes: Sequence[RigidShape], shape_of: Sequence[int], poses: np.ndarray, steps: np.ndarray
) -> list[Press]:
    """Find first touches and queue presses: shape numbers (b,) in the scene, poses (b, 4, 4) m, steps (b,)."""
    begin, scene = time.perf_counter(), stepping.scene
    poses = np.array(poses, dtype=float)
    poses[:, :3, 3] *= MM_PER_M
    own = [shapes[i] for i in shape_of]
    reach = float(np.linalg.norm(stepping.path.points[:, :3], axis=1).max())
    faces = scene.indenter_contact.host_faces
    travel, status, near = first_touch(scene.nodes, faces, own, poses, scene.device, scene.batch, reach)
    poses[:, :3, 3] += travel[:, None] * poses[:, :3, 1]
    touch = np.where(status == Status.CONVERGED, travel / MM_PER_M, np.nan)
    lateral = [lateral_reach(shape) for shape in shapes]
    race = scene.device != "cpu"  # on a CPU, results must not depend on free environments
    presses = [Press(i, *each, lateral[i], race) for i, *each in zip(shape_of, poses, touch, steps, strict=True)]
    for press, code in zip(presses, status, strict=True):
        press.status = None if code == Status.CONVERGED else int(code)
        press.seconds = (time.perf_counter() - begin) / len(presses)
    # Presses that touch the most faces take the longest. They go first, because a batch ends with its slowest press.
    stepping.add(presses[i] for i in np.argsort(-near, kind="stable"))
    return presses


def result_of(stepping: LoadStepping, press: Press) -> PressResult:
    """Collect the samples of an ended press into arrays over the steps of its path."""
    scene, steps, samples = stepping.scene, len(stepping.path), press.samples
    outputs, lengths = {}, scene.axis_lengths
    for output in scene.outputs:
        shape = (steps, *output.shape_of(lengths))
        if output.is_read_by_sample:
            values = press.large.get(output.name)
            if values is None:
                kind = stepping.sampler.displacement_type if output.name == "displacement" else output.dtype
                values = np.empty(shape, kind)
            values[len(samples) :] = NOT_REACHED if output.is_image else np.nan
        else:
            values = np.full(shape, np.nan)  # of integers, too
            if samples:
                values[: len(samples)] = [sample.value(output.name) for sample in samples]
        outputs[output.name] = values
    if (energy := outputs.get("error_energy")) is not None:
        path_m = stepping.path.points[:, :3] / MM_PER_M
        outputs["force_error_estimate"] = force_error_estimate(energy, outputs["force"], path_m)
    outputs["status"] = np.where(np.isnan(outputs["status"]), press.status, outputs["status"]).astype(np.int8)
    return PressResult(outputs, press.touch, press.seconds)
