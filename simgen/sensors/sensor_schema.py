"""Sections of a ``sensor.yaml``, strictly checked. The name of each key ends in its unit."""

import itertools
import re
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field, field_validator, model_validator

from simgen.config.allowed_values import allowed
from simgen.config.choices import DEFAULT_CAMERA
from simgen.config.strict_section import StrictSection, is_section, load_section
from simgen.errors import InputError, shown
from simgen.sensors.marker_schema import MarkerSettings
from simgen.sensors.material import Material
from simgen.sensors.section_types import Direction, Interval, Number, OwnFile, Positive, Vector

Unit = Literal["m", "mm"]
NAME = r"^[A-Za-z][A-Za-z0-9_.-]*$"  # of sensors and cameras
NAME_IN_WORDS = "letters, digits, _ . -, a letter first"


class OneOf(StrictSection):
    """A group with exactly one of its optional sections."""

    @model_validator(mode="after")
    def _exactly_one(self):
        fields = type(self).model_fields.items()
        choices = [name for name, field in fields if any(map(is_section, get_args(field.annotation)))]
        given = [name for name in choices if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"exactly one of {', '.join(choices)} is needed, found {', '.join(given) or 'none'}")
        return self


class Plane(StrictSection):
    """Points within ``within_mm`` of a plane perpendicular to an axis."""

    axis: Literal["x", "y", "z"]
    at_mm: Number
    within_mm: Positive = 0.01


class Box(StrictSection):
    """Points inside a box, which is bounded along the given axes; at least one is needed."""

    x_mm: Interval | None = None
    y_mm: Interval | None = None
    z_mm: Interval | None = None

    @model_validator(mode="after")
    def _bounded(self):
        if self.x_mm is self.y_mm is self.z_mm is None:
            raise ValueError("at least one of x_mm, y_mm, z_mm is needed, found none")
        return self


class Cylinder(StrictSection):
    """Points inside a cylinder along an axis; ``center_mm`` has the coordinates of the other two axes in order."""

    axis: Literal["x", "y", "z"]
    center_mm: Interval
    radius_mm: Positive
    along_mm: Interval


class MeshFile(StrictSection):
    """A mesh file in the folder of the ``sensor.yaml``, or below it."""

    file: OwnFile
    unit: Unit


class Touching(MeshFile):
    """Points within a distance of the bodies in a mesh file."""

    within_mm: Positive = 0.05


class Selection(OneOf):
    """A region of the gel's surface; triangles are split at its border."""

    plane: Plane | None = None
    box: Box | None = None
    cylinder: Cylinder | None = None
    touching: Touching | None = None


class PolarTable(StrictSection):
    """Radii of a body about a line along x, from its tip to the flat face at the last row."""

    tip_mm: Number  # x of the tip, where the radius is 0
    angles_deg: Annotated[list[Number], Field(min_length=3)]  # 0 (towards -y) to 180 (towards +y)
    rows_mm: Annotated[list[list[Number]], Field(min_length=3)]  # x, then the radius at each angle

    @model_validator(mode="after")
    def _rectangular_and_rising(self):
        if self.angles_deg[0] != 0 or self.angles_deg[-1] != 180 or not _rising(self.angles_deg):
            raise ValueError("angles_deg must rise from 0 to 180")
        if any(len(row) != 1 + len(self.angles_deg) for row in self.rows_mm):
            raise ValueError(f"each row of rows_mm must have x and {len(self.angles_deg)} radii")
        if not _rising([self.tip_mm, *(row[0] for row in self.rows_mm)]):
            raise ValueError("x must rise from tip_mm through the rows of rows_mm")
        if min(min(row[1:]) for row in self.rows_mm) <= 0:
            raise ValueError("radii must be greater than 0")
        return self


class PolarShell(StrictSection):
    """A closed skin between an outer and an inner surface about the line y = ``axis_y_mm``, z = 0."""

    axis_y_mm: Number
    spacing_mm: Positive  # edge length of the triangulation
    outer: PolarTable
    inner: PolarTable


class PolarCore(StrictSection):
    """A rigid body inside a `PolarShell`, at least ``clearance_mm`` away from its inner surface."""

    axis_y_mm: Number
    spacing_mm: Positive
    clearance_mm: Positive
    table: PolarTable


class Dome(StrictSection):
    """A height field over a D-shaped outline: half circle at the tip, straight sides, rounded corners at the rear."""

    back_y_mm: Number  # the flat back; the dome rises towards -y
    half_width_mm: Positive
    arch_center_x_mm: Number
    end_x_mm: Number
    corner_radius_mm: Positive
    rim_radius_mm: Positive  # fillet between wall and dome
    spacing_mm: Positive  # edge length of the triangulation
    x_mm: Annotated[list[Number], Field(min_length=4)]  # rows of thickness_mm
    z_mm: Annotated[list[Number], Field(min_length=4)]  # columns of thickness_mm, which is even in z
    thickness_mm: list[list[Positive]]  # above the back; extrapolated smoothly to the rim, without its fillet

    @model_validator(mode="after")
    def _rectangular_and_rising(self):
        if not (_rising(self.x_mm) and _rising(self.z_mm)):
            raise ValueError("x_mm and z_mm must rise")
        if [len(row) for row in self.thickness_mm] != [len(self.z_mm)] * len(self.x_mm):
            raise ValueError(f"thickness_mm must have {len(self.x_mm)} rows of {len(self.z_mm)} values")
        return self


class PadFace(StrictSection):
    """The domed face of a `Pad`: a rectangle, and thicknesses at its centre, mid-ends, mid-sides and corners."""

    half_length_mm: Positive  # along x
    half_width_mm: Positive  # along z
    center_mm: Positive
    end_mm: Positive
    side_mm: Positive
    corner_mm: Positive


class Pad(StrictSection):
    """A height field over a rectangle with rounded corners: a domed face in the middle, and a shoulder around it."""

    back_y_mm: Number  # the flat back; the pad rises towards -y
    center_x_mm: Number
    half_length_mm: Positive  # along x
    half_width_mm: Positive  # along z
    corner_radius_mm: Positive  # of the upright edges
    wall_mm: Positive  # height of the upright walls, where the shoulder ends
    face: PadFace
    spacing_mm: Positive  # edge length of the triangulation

    @model_validator(mode="after")
    def _shoulder_falls(self):
        face = self.face
        if self.corner_radius_mm > min(self.half_length_mm, self.half_width_mm):
            raise ValueError("corner_radius_mm must be at most half_length_mm and half_width_mm")
        widths = self.half_length_mm - face.half_length_mm, self.half_width_mm - face.half_width_mm
        heights = [height - self.wall_mm for height in (face.center_mm, face.end_mm, face.side_mm, face.corner_mm)]
        if not 0.0 < max(heights) <= min(widths) or min(heights) <= 0.0:
            raise ValueError("the face must be above wall_mm everywhere, and further from the walls than above it")
        return self


def _rising(values: list[float]) -> bool:
    return all(a < b for a, b in itertools.pairwise(values))


class Gel(OneOf):
    """The deformable body: a mesh file, or a parametric shape (`polar_bodies`, `height_fields`)."""

    mesh: MeshFile | None = None
    polar_shell: PolarShell | None = None
    dome: Dome | None = None
    pad: Pad | None = None


class Core(OneOf):
    """The rigid body inside the gel: the largest closed body of a file, or one inside a polar shell."""

    friction: Annotated[float, Field(ge=0.0, le=2.0)]
    mesh: MeshFile | None = None
    polar_core: PolarCore | None = None


class SupportPlane(Plane):
    """A flat plate in the plane, which ends ``beyond_outline_mm`` beyond the gel's outline there."""

    # Wide enough for a fingertip: the DIGIT's gel bulges by up to 2.2 mm on its plate (docs/physics.md).
    beyond_outline_mm: Annotated[float, Field(ge=0.0, le=20.0, allow_inf_nan=False)] = 3.0


class SupportSettings(OneOf):
    """The rigid body that the gel rests on: a plate, or the largest closed body of a file."""

    friction: Annotated[float, Field(ge=0.0, le=2.0)] | None = None  # None: the material's
    plane: SupportPlane | None = None
    mesh: MeshFile | None = None


class MeshSize(StrictSection):
    """Edge lengths: ``edge_length_mm``, growing to ``held_edge_length_mm`` over ``grading_mm`` towards held regions.

    Along the edges of held regions, where stress is singular, edges are as short as ``bond_edge_length_mm``.
    """

    edge_length_mm: Positive
    held_edge_length_mm: Positive | None = None
    grading_mm: Positive = 4.0
    bond_edge_length_mm: Positive | None = None
    envelope_mm: Positive | None = None  # fTetWild's tolerance; nodes are then projected onto the surface

    @property
    def envelope(self) -> float:
        """Tolerance of fTetWild, mm; by default a tenth of the edge length."""
        return self.envelope_mm or 0.1 * self.edge_length_mm

    @property
    def cell_mm(self) -> float:
        """Spacing of the grid on which fTetWild samples the wanted edge length; finer grids take gigabytes."""
        return max(self.bond_edge_length_mm or self.edge_length_mm, 0.4 * self.edge_length_mm)


class MeshSizes(StrictSection):
    """Sizes of the simulation meshes ``default``, ``coarse`` and ``fine``, and of the stored mesh ``output``.

    ``as_given`` takes the user's own tetrahedra. Without ``output``, a tetrahedral file is its own output mesh, and the
    output mesh of a surface file has the default mesh's edge lengths.
    """

    default: MeshSize | Literal["as_given"]
    coarse: MeshSize | Literal["as_given"] | None = None
    fine: MeshSize | Literal["as_given"] | None = None
    output: MeshSize | Literal["as_given"] | None = None


class CameraSettings(StrictSection):
    """A pinhole camera behind the gel, with lights on a circle around its axis."""

    position_mm: Vector
    looks_along: Direction
    up: Direction
    vertical_field_of_view_deg: Annotated[float, Field(gt=0.0, lt=180.0)]
    width_px: Annotated[int, Field(gt=0)]
    height_px: Annotated[int, Field(gt=0)]
    light_circle_radius_mm: Positive
    light_angles_deg: dict[Literal["red", "green", "blue"], Number]

    @model_validator(mode="after")
    def _up_is_across(self):
        if not np.cross(self.looks_along, self.up).any():
            raise ValueError("up must not be parallel to looks_along")
        return self


class Electrodes(StrictSection):
    """Electrode positions in the electrodes' frame; they are snapped to the core's surface."""

    origin_mm: Vector  # of the electrodes' frame, in the sensor's frame; so are the axes
    x_axis: Direction
    z_axis: Direction
    x_mm: list[Number]
    y_mm: list[Number]
    z_mm: list[Number]

    @model_validator(mode="after")
    def _same_length(self):
        if not len(self.x_mm) == len(self.y_mm) == len(self.z_mm):
            raise ValueError(f"x_mm, y_mm, z_mm have {len(self.x_mm)}, {len(self.y_mm)}, {len(self.z_mm)} entries")
        return self


class SensorDescription(StrictSection):
    """A whole ``sensor.yaml``."""

    name: str = Field(pattern=NAME, **allowed(NAME_IN_WORDS))
    gel: Gel
    held: dict[str, Selection] = Field(min_length=1, **allowed("names of regions with their selections, at least one"))
    core: Core | None = None
    support: SupportSettings | None = None
    meshes: MeshSizes
    materials: dict[str, Material] = Field(min_length=1, **allowed("names of presets with their values, at least one"))
    cameras: dict[str, CameraSettings] = Field(
        {}, **allowed(f"names of cameras with their values; {DEFAULT_CAMERA} is the one that images show")
    )
    electrodes: Electrodes | None = None
    markers: MarkerSettings | None = None

    @field_validator("cameras")
    @classmethod
    def _a_default_camera(cls, cameras: dict[str, CameraSettings]) -> dict[str, CameraSettings]:
        if cameras and DEFAULT_CAMERA not in cameras:
            raise ValueError(f"{', '.join(cameras)}; allowed: one of them named {DEFAULT_CAMERA}")
        for name in cameras:  # it becomes part of file names
            if not re.fullmatch(NAME, name):
                raise ValueError(f"{shown(repr(name))} cannot name a camera; allowed: {NAME_IN_WORDS}")
        return cameras

    @model_validator(mode="after")
    def _markers_need_a_camera(self):
        if self.markers is not None and not self.cameras:
            raise ValueError("markers are seen by a camera: cameras are needed")
        return self

    @model_validator(mode="after")
    def _electrodes_need_a_core(self):
        if self.electrodes is not None and self.core is None:
            raise ValueError("electrodes sit on the core: a core is needed")
        if self.core is not None and self.core.polar_core is not None and self.gel.polar_shell is None:
            raise ValueError("core.polar_core needs gel.polar_shell")
        return self


def read_description(path: Path) -> SensorDescription:
    """Read a ``sensor.yaml``. Raises InputError with one line: file, key, value, and what is allowed."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; a sensor is a folder with a sensor.yaml")
    return load_section(SensorDescription, path, str(path))
