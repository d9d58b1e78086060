"""The keys of a job file, strictly checked: each carries its unit (``depths_mm``) and says what it allows."""

import hashlib
import json
import os
import re
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    Field,
    PrivateAttr,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from simgen.config.indenter_path import IndenterPath, press_path, with_legs
from simgen.config.strict_section import StrictSection
from simgen.errors import shown

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".msh", ".vtu", ".mesh", ".tet")
Angle = Annotated[float, Field(ge=-180.0, le=180.0)]
Move = Annotated[float, Field(ge=-10.0, le=10.0)]
FINEST_STEP_M = 1e-7  # of int16 displacements
DEEPEST_INT16_MM = 3.2  # deeper presses would need steps of more than 0.2 um, see `Job.displacement_step_m`
NAME = r"^[A-Za-z][A-Za-z0-9_.-]{0,99}$"
# What else a dataset's folder holds.
NOT_SENSORS = (
    "press", "depth", "path", "refused", "manifest", "zarr.json", "README.md", "presses.csv", "croissant.json"
)  # fmt: skip
FINEST_MM = 1e-6  # depths are whole nanometres
# Outputs of a press that a job may ask for, with what they are.
OUTPUTS = {
    "shear_force": "force on the sensor along x and z of the contact frame",
    "slip_share": "share of the contact area where friction is at its limit, so that the surface slides",
    "stress": "Cauchy stress at surface_vertices, as xx, yy, zz, yz, xz, xy in the sensor's frame",
    "traction": "force of the indenter on the sensor per rest area, at surface_vertices, in the sensor's frame",
}
SURFACE_COMPONENTS = {"stress": 6, "traction": 3}  # outputs with so many numbers at each vertex of the surface
OF_PATHS = ("shear_force", "slip_share")  # stored for every path that is more than a press
Output = Literal[tuple(OUTPUTS)]
MESH_SPACING_MM = 0.2  # of the grid on which an indenter's mesh is sampled


class MaterialChoice(StrictSection):
    """A material preset of the sensor model (``material: solid``); single values may replace its own."""

    text_means = "preset"

    preset: str = Field("solid", description="a preset of the sensor model, e.g. solid")
    youngs_modulus_pa: float | None = Field(
        None, ge=1e3, le=1e9, description="1e3 to 1e9 Pa (539 kPa: 539e3)"
    )
    poisson_ratio: float | None = Field(None, ge=0.01, le=0.49999, description="0.01 to 0.49999")
    friction: float | None = Field(None, ge=0.0, le=2.0, description="a Coulomb coefficient, 0 to 2")

    @model_validator(mode="before")
    @classmethod
    def _preset_alone(cls, value: Any) -> Any:
        return {cls.text_means: value} if isinstance(value, str) else value


class OutputFile(StrictSection):
    """A mesh file whose vertices are stored, in their order, in place of the sensor's own output mesh."""

    file: str = Field(min_length=1, description="a path of a tetrahedral mesh: .msh .vtu .mesh .tet")
    unit: Literal["m", "mm"] = Field(description="m or mm")


class SensorChoice(StrictSection):
    """Which sensor model, on which of its meshes, made of which material, with what in its cavity."""

    model: str = Field(description="a bundled sensor model (digit, biotac) or a path: ./my_sensor")
    mesh: Literal["default", "coarse", "fine"] = Field("default", description="default, coarse or fine")
    material: MaterialChoice = MaterialChoice()
    fluid: Literal["none", "incompressible"] = Field("none", description="none or incompressible, in its cavity")
    output: OutputFile | None = Field(
        None, exclude_if=lambda output: output is None, description="{file, unit}, a tetrahedral mesh"
    )


class Leg(StrictSection):
    """One leg of a path: the indenter moves and turns evenly from where the leg before it ended."""

    move_mm: tuple[Move, Move, Move] = Field(
        (0.0, 0.0, 0.0), description="[x, y, z] in the contact frame, each -10 to 10 mm; +y presses"
    )
    turn_deg: Angle = Field(0.0, description="-180 to 180 degrees about the press axis")
    steps: int = Field(ge=1, le=1000, description="a whole number of steps that are kept, 1 to 1000")

    @model_validator(mode="after")
    def _goes_somewhere(self) -> "Leg":
        if not any(self.move_mm) and not self.turn_deg:
            raise ValueError("a leg that neither moves nor turns; allowed: move_mm or turn_deg other than 0")
        step = max(map(abs, self.move_mm)) / self.steps
        if step < FINEST_MM and not self.turn_deg:
            raise ValueError(f"steps of {step:g} mm; allowed: {FINEST_MM:g} mm or more")
        return self


class IndenterChoice(StrictSection):
    """A bundled indenter, or a closed mesh, which is sampled on a grid. A name or path alone will do."""

    text_means = "file"

    file: str = Field(description="a name, or a path of a closed mesh (.stl .obj .ply)")
    unit: Literal["m", "mm"] = Field("m", description="m or mm")
    spacing_mm: float = Field(MESH_SPACING_MM, ge=0.01, le=1.0, description="0.01 to 1 mm")

    @model_validator(mode="before")
    @classmethod
    def _file_alone(cls, value: Any) -> Any:
        return {cls.text_means: value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _only_a_mesh_has_a_unit(self) -> "IndenterChoice":
        if not is_path(self.file) and not self._is_alone():
            raise ValueError(f"unit and spacing_mm are a mesh file's, and {shown(repr(self.file))} is a name; "
                             "allowed: the name alone, or a path with its suffix")  # fmt: skip
        return self

    @model_serializer(mode="wrap")
    def _plain(self, sections: SerializerFunctionWrapHandler) -> str | dict[str, Any]:
        """The text alone where it says all: the hash of a job does not depend on which way it is written."""
        return self.file if self._is_alone() else sections(self)

    def _is_alone(self) -> bool:
        defaults = type(self).model_fields
        return all(getattr(self, key) == defaults[key].default for key in ("unit", "spacing_mm"))

    @property
    def name(self) -> str:
        """The file's name without its suffix."""
        return Path(self.file).stem if is_path(self.file) else self.file


class Trajectories(StrictSection):
    """The contact poses, how they vary, and the path of the indenters after their press."""

    count: int = Field(ge=1, le=1_000_000, description="a whole number of contact poses, 1 to 1000000")
    max_tilt_deg: float = Field(5.0, ge=0.0, le=45.0, description="0 to 45 degrees")
    roll_range_deg: tuple[Angle, Angle] = Field(
        (-90.0, 90.0), description="[first, last], -180 to 180 degrees"
    )
    max_indentation_ratio: float = Field(0.6, gt=0.0, lt=1.0, description="between 0 and 1")
    min_edge_ratio: float = Field(1.5, ge=0.0, le=10.0, description="0 to 10")
    # Off, a job has the hash that it had before there was this rule.
    least_thickness_left: float = Field(
        0.15, ge=0.0, lt=1.0, exclude_if=lambda share: share == 0.0, description="a share, 0 (off) to below 1"
    )
    too_thin: Literal["redraw", "stop"] = Field(
        "redraw", exclude_if=lambda how: how == "redraw", description="redraw or stop"
    )
    max_force_n: float | None = Field(
        None, gt=0.0, le=1e4, exclude_if=lambda force: force is None, description="above 0, to 10000 N"
    )
    path: tuple[Leg, ...] = Field(
        (), exclude_if=lambda legs: not legs, description="a list of legs {move_mm, turn_deg, steps}"
    )

    @field_validator("too_thin")
    @classmethod
    def _stop_needs_a_share(cls, too_thin: str, info: ValidationInfo) -> str:
        if too_thin == "stop" and info.data.get("least_thickness_left") == 0.0:
            raise ValueError(
                "stop needs a share at which presses stop, and least_thickness_left is 0 (off); "
                "allowed: redraw, or a least_thickness_left above 0"
            )
        return too_thin


class Depths(StrictSection):
    """Depths from true first touch, evenly spaced, both ends included."""

    first: float = Field(gt=0.0, le=10.0, description="above 0, to 10 mm")
    last: float = Field(gt=0.0, le=10.0, description="above 0, to 10 mm")
    count: int = Field(ge=1, le=1000, description="a whole number of depths, 1 to 1000")

    @model_validator(mode="after")
    def _increasing(self) -> "Depths":
        if self.count == 1 and self.first != self.last:
            raise ValueError("one depth: first and last must be equal")
        if self.count > 1 and self.first >= self.last:
            raise ValueError("first must be less than last")
        step = (self.last - self.first) / (self.count - 1) if self.count > 1 else self.first
        if min(self.first, step) < FINEST_MM:
            raise ValueError(f"a depth or a step of {min(self.first, step):g} mm; allowed: {FINEST_MM:g} mm or more")
        return self


class Solver(StrictSection):
    """The finite element, and `simgen.fem.nonlinear.newton.SolverSettings` (which says what each key means)."""

    element: Literal["P2-P1", "P1"] = Field("P2-P1", description="P2-P1, or P1 for comparison only")
    residual_tolerance: float = Field(5e-4, gt=0.0, le=1e-2, description="above 0, to 1e-2")
    contact_tolerance: float = Field(2e-2, gt=0.0, le=1e-1, description="above 0, to 1e-1")
    linear_tolerance: float = Field(0.1, ge=1e-4, lt=1.0, description="1e-4 to below 1")
    volumetric_split: float = Field(1.0, ge=0.0, le=50.0, description="gamma / mu, 0 to 50")
    contact_stiffness: float = Field(20.0, ge=1.0, le=1e3, description="k edge / E, 1 to 1000")
    friction_stiffness: float = Field(20.0, ge=0.1, le=1e3, description="k edge / E, 0.1 to 1000")
    max_newton_iterations: int = Field(25, ge=1, le=1000, description="a whole number, 1 to 1000")
    smallest_substep: float = Field(1 / 64, gt=0.0, le=1.0, description="a share of a depth, above 0, to 1")
    krylov_size: int = Field(40, ge=1, le=1000, description="a whole number, 1 to 1000")


class DatasetSettings(StrictSection):
    """How the samples are stored."""

    displacement: Literal["int16", "float32"] = Field(
        "int16", description="int16 (steps of 0.1 um, of 0.2 um in presses deeper than 1.6 mm) or float32"
    )
    presses_per_shard: int = Field(
        9, ge=1, le=4096, description="a whole number of presses that one task solves and writes, 1 to 4096"
    )
    leave_out: str | None = Field(
        None, description="the name of one of the indenters: it alone is tested, all others train"
    )
    license: str | None = Field(
        None, pattern=r"^[A-Za-z0-9][ -~]{0,99}$", description="a licence of the data for its card, e.g. CC-BY-4.0"
    )
    output: str | None = Field(None, description="a folder; by default <name>.zarr in the current one")


class Job(StrictSection):
    """A checked job. `load_job` makes one from YAML; `resolved` and `hash` say what it decides."""

    name: str = Field(pattern=NAME, description="letters, digits, _ . -, a letter first, 100 at most")
    seed: int = Field(0, ge=0, lt=2**32, description="a whole number, 0 to 4294967295")
    # The first sensor is the reference on which contacts are sampled.
    sensors: dict[str, SensorChoice] = Field(min_length=1, description="name: {model, mesh, material, ...}, ...")
    indenters: tuple[IndenterChoice, ...] = Field(
        min_length=1, description="a list of names, paths of closed meshes in m, or {file, unit, spacing_mm}"
    )
    trajectories: Trajectories
    depths_mm: Depths
    outputs: dict[str, tuple[Output, ...]] = Field(
        {}, exclude_if=lambda outputs: not outputs, description=f"sensor: [{', '.join(OUTPUTS)}], ..."
    )
    solver: Solver = Solver()
    dataset: DatasetSettings = Field(DatasetSettings(), validate_default=True)
    _folder: Path = PrivateAttr(default=Path())  # of the job file: relative paths start there

    @field_validator("sensors")
    @classmethod
    def _sensor_names(cls, sensors: dict[str, SensorChoice]) -> dict[str, SensorChoice]:
        for name in sensors:
            if not re.fullmatch(NAME, name) or name.endswith("\n") or name in NOT_SENSORS:
                allowed = f"letters, digits, _ . -, a letter first, 100 at most, not {', '.join(NOT_SENSORS)}"
                raise ValueError(f"{shown(repr(name))} cannot name a sensor; allowed: {allowed}")
        return sensors

    @field_validator("outputs")
    @classmethod
    def _outputs_of_sensors(
        cls, outputs: dict[str, tuple[Output, ...]], info: ValidationInfo
    ) -> dict[str, tuple[Output, ...]]:
        sensors = info.data.get("sensors", outputs)
        for name in outputs:
            if name not in sensors:
                raise ValueError(f"{shown(repr(name))} is no sensor of the job; allowed: {', '.join(sensors)}")
        # In one order, whichever way they are written: the same outputs are the same job.
        return {name: tuple(filter(outputs[name].__contains__, OUTPUTS)) for name in sensors if outputs.get(name)}

    @field_validator("indenters")
    @classmethod
    def _unique_indenters(cls, indenters: tuple[IndenterChoice, ...]) -> tuple[IndenterChoice, ...]:
        for name, count in Counter(each.name for each in indenters).items():
            if count > 1:
                raise ValueError(f"{shown(repr(name))} is listed twice")
        return indenters

    @field_validator("dataset")
    @classmethod
    def _displacements_fit(cls, dataset: DatasetSettings, info: ValidationInfo) -> DatasetSettings:
        depths, trajectories = info.data.get("depths_mm"), info.data.get("trajectories")
        if not depths or dataset.displacement != "int16":
            return dataset
        if depths.last > DEEPEST_INT16_MM:
            raise ValueError(
                f"displacement int16 is too coarse for depths_mm.last = {depths.last:g}; "
                f"allowed: displacement float32, or depths_mm.last up to {DEEPEST_INT16_MM:g}"
            )
        furthest = 1e3 * _furthest_in_contact_m(_path(depths, trajectories)) if trajectories else 0.0
        if furthest > DEEPEST_INT16_MM:
            raise ValueError(
                f"displacement int16 is too coarse for trajectories.path, which takes the "
                f"indenter {furthest:.4g} mm from first touch; allowed: displacement float32, or a path that stays "
                f"within {DEEPEST_INT16_MM:g} mm"
            )
        return dataset

    @field_validator("dataset")
    @classmethod
    def _left_out_is_listed(cls, dataset: DatasetSettings, info: ValidationInfo) -> DatasetSettings:
        names = [each.name for each in info.data.get("indenters", ())]
        if names and dataset.leave_out is not None and (dataset.leave_out not in names or len(names) == 1):
            listed = shown(", ".join(names), 500)
            allowed = f"one of {listed}" if len(names) > 1 else "nothing, as there is one indenter alone"
            raise ValueError(f"leave_out {shown(repr(dataset.leave_out))} is not allowed; allowed: {allowed}")
        return dataset

    @property
    def indenter_path(self) -> IndenterPath:
        """The path of every indenter: the press to all depths, then the legs of ``trajectories.path``."""
        return _path(self.depths_mm, self.trajectories)

    @property
    def depths_m(self) -> np.ndarray:
        """(step,) float64, m: the depth at each step of the path."""
        return self.indenter_path.depths_m

    @property
    def stops_early(self) -> bool:
        """True if presses end early where they would leave too little gel, and keep their contacts."""
        return self.trajectories.too_thin == "stop"

    @property
    def displacement_step_m(self) -> float:
        """The step of int16 displacements, m: 0.1 um, or a multiple.

        The range is at least twice as far as the indenter goes: gel that is squeezed out moves up to 1.7 times as far.
        """
        range_m = FINEST_STEP_M * np.iinfo(np.int16).max
        return FINEST_STEP_M * max(1, int(np.ceil(2.0 * _furthest_in_contact_m(self.indenter_path) / range_m)))

    @property
    def indenter_names(self) -> tuple[str, ...]:
        return tuple(each.name for each in self.indenters)

    def stored_outputs(self, sensor: str) -> tuple[str, ...]:
        """The optional outputs that are stored for a sensor, in the order of `OUTPUTS`."""
        asked = {*self.outputs.get(sensor, ()), *(() if self.indenter_path.is_a_press else OF_PATHS)}
        return tuple(output for output in OUTPUTS if output in asked)

    def surface_outputs(self, sensor: str) -> tuple[str, ...]:
        """Those with values at the vertices of the sensor's surface."""
        return tuple(output for output in self.stored_outputs(sensor) if output in SURFACE_COMPONENTS)

    @property
    def steps_in_words(self) -> str:
        """The steps of a press in words: their number and their depths."""
        depths, legs = self.depths_mm, self.trajectories.path
        words = f"{depths.count} depths ({depths.first:g} to {depths.last:g} mm)"
        if legs:
            steps, plural = sum(leg.steps for leg in legs), "s" * (len(legs) > 1)
            words = f"({words} + {steps} step{'s' * (steps > 1)} on {len(legs)} leg{plural})"
        return words

    @property
    def presses(self) -> int:
        return self.trajectories.count * len(self.indenters)

    @property
    def shards(self) -> int:
        return -(-self.presses // self.dataset.presses_per_shard)

    @property
    def samples(self) -> int:
        """Presses times steps: each is one sample on every sensor."""
        return self.presses * len(self.indenter_path)

    @property
    def folder(self) -> Path:
        """Where its relative paths start: the folder of the job file."""
        return self._folder

    def locate(self, text: str) -> str | Path:
        """A name stays a name; a path that is relative starts at the folder of the job file."""
        return self._folder / os.path.expanduser(text) if is_path(text) else text

    def resolved(self) -> dict[str, Any]:
        """All that decides the data, defaults filled in, as JSON types; where it is stored is no part."""
        plain = self.model_dump(mode="json")
        del plain["dataset"]["output"]
        return plain

    @property
    def hash(self) -> str:
        """sha256 of the resolved job. Keys are in the order of the schema, sensors in that of the job."""
        return hash_of(self.resolved())

    def __hash__(self) -> int:
        return int(self.hash[:15], 16)

    def output(self) -> Path:
        """Where the dataset goes unless the command line says otherwise."""
        return Path(os.path.expanduser(self.dataset.output or f"{self.name}.zarr"))


def _path(depths: Depths, trajectories: Trajectories) -> IndenterPath:
    """Offsets are rounded to whole nanometres, so that 0.3 mm is 0.3 mm."""
    press = press_path(np.round(np.linspace(depths.first, depths.last, depths.count) * 1e-3, 9))
    legs = trajectories.path
    return with_legs(press, [(np.array(leg.move_mm) * 1e-3, np.radians(leg.turn_deg), leg.steps) for leg in legs])


def _furthest_in_contact_m(path: IndenterPath) -> float:
    """m, the largest distance of the tip from first touch while it is below the rest surface."""
    pressed = path.depths_m > 0.0
    return float(np.linalg.norm(path.offsets_m[pressed], axis=1).max(initial=0.0))


def hash_of(resolved: dict[str, Any]) -> str:
    """sha256 of what a job resolves to, its keys in their order."""
    return hashlib.sha256(json.dumps(resolved).encode()).hexdigest()


def is_path(text: str) -> bool:
    """Whether a sensor model or an indenter is a path (with a slash or a mesh suffix) rather than a name."""
    return "/" in text or "\\" in text or text.lower().endswith(MESH_SUFFIXES)
