"""The schema of a job file. The name of a key has its unit (``depths_mm``)."""

import hashlib
import json
import os
import re
from collections import Counter
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, field_validator

from simgen.config.allowed_values import allowed
from simgen.config.choices import IndenterChoice, SensorChoice, is_path
from simgen.config.indenter_path import IndenterPath
from simgen.config.outputs import BY_COARSER_MESH, OPTIONAL, OUTPUTS, Output, kept_outputs
from simgen.config.solver_settings import SolverSettings
from simgen.config.strict_section import StrictSection
from simgen.config.trajectories import DEEPEST_INT16_MM, Depths, Trajectories, furthest_in_contact_m, path_of
from simgen.errors import shown
from simgen.units import MM_PER_M

FINEST_STEP_M = 1e-7  # smallest step of int16 displacements
NAME = r"^[A-Za-z][A-Za-z0-9_.-]{0,99}$"
NAME_IN_WORDS = "letters, digits, _ . -, a letter first, 100 at most"
# Names that a dataset's folder uses itself.
RESERVED_NAMES = (
    "press", "depth", "path", "refused", "manifest", "zarr.json", "README.md", "presses.csv", "croissant.json"
)  # fmt: skip


class DatasetSettings(StrictSection):
    """Storage of the samples."""

    displacement: Literal["int16", "float32"] = Field(
        "int16",
        description="Type of stored displacements; int16 rounds to the nearest step",
        **allowed("int16 (steps of 0.1 um, of 0.2 um in presses deeper than 1.6 mm) or float32"),
    )
    presses_per_shard: int = Field(
        9, ge=1, le=4096,
        description="Presses that one task solves and writes. A killed run repeats unfinished tasks. A core solves "
        "three or more presses side by side, which is nearly twice as fast",
    )  # fmt: skip
    leave_out: str | None = Field(
        None,
        description="The only indenter of the test split; training and validation have all others, at other places",
        **allowed("the name of one of the indenters"),
    )
    license: str | None = Field(
        None, pattern=r"^[A-Za-z0-9][ -~]{0,99}$",
        description="Licence of the data, for the dataset's card; use an SPDX name",
        **allowed("a name of at most 100 characters, such as CC-BY-4.0"),
    )  # fmt: skip
    output: str | None = Field(
        None,
        description="Folder of the dataset. `--output` replaces it; the job's hash does not cover it",
        **allowed("a folder; by default <name>.zarr in the current one"),
    )


class Job(StrictSection):
    """A checked job, made by `load_job`."""

    name: str = Field(
        pattern=NAME, description="Names the dataset, `<name>.zarr`, and its report", **allowed(NAME_IN_WORDS)
    )
    seed: int = Field(
        0, ge=0, lt=2**32, description="Seed of contacts and splits: the same seed gives the same places"
    )
    # The first sensor is the reference on which contacts are sampled.
    sensors: dict[str, SensorChoice] = Field(
        min_length=1,
        description="The sensors, named as you like. Contacts are sampled on the first and mapped to the others",
        **allowed("name: {model, mesh, material, ...}, ..."),
    )
    indenters: tuple[IndenterChoice, ...] = Field(
        min_length=1,
        description="Indenters; each presses at every contact. Names, paths, or sections with the keys below",
        **allowed("a list of names, paths of closed meshes in m, or {file, unit, spacing_mm}"),
    )
    trajectories: Trajectories = Field(description="Number and variation of contacts, and the path after each press")
    depths_mm: Depths = Field(description="The depths that are stored")
    outputs: dict[str, tuple[Literal[OPTIONAL], ...]] = Field(
        {},
        exclude_if=lambda outputs: not outputs,
        description="Outputs to store beside displacement, force and moment; see "
        "[optional outputs](dataset.md#optional-outputs)",
        **allowed(f"sensor: [{', '.join(OPTIONAL)}], ..."),
    )
    solver: SolverSettings = Field(
        SolverSettings(), description="Element, tolerances and constants. Leave it out unless you study the solver"
    )
    dataset: DatasetSettings = Field(
        DatasetSettings(), validate_default=True, description="Storage and splits of the samples"
    )
    _folder: Path = PrivateAttr(default=Path())  # the job file's; relative paths start there

    @field_validator("sensors")
    @classmethod
    def _sensor_names(cls, sensors: dict[str, SensorChoice]) -> dict[str, SensorChoice]:
        for name in sensors:
            if not re.fullmatch(NAME, name) or name.endswith("\n") or name in RESERVED_NAMES:
                words = f"{NAME_IN_WORDS}, not {', '.join(RESERVED_NAMES)}"
                raise ValueError(f"{shown(repr(name))} cannot name a sensor; allowed: {words}")
        return sensors

    @field_validator("outputs")
    @classmethod
    def _outputs_of_sensors(
        cls, outputs: dict[str, tuple[str, ...]], info: ValidationInfo
    ) -> dict[str, tuple[str, ...]]:
        sensors = info.data.get("sensors", outputs)
        for name in outputs:
            if name not in sensors:
                raise ValueError(f"{shown(repr(name))} is no sensor of the job; allowed: {', '.join(sensors)}")
            estimates = sorted(set(outputs[name]) & set(BY_COARSER_MESH))
            if estimates and getattr(sensors[name], "mesh", "") == "coarse":
                raise ValueError(
                    f"{name}: {estimates[0]} compares with a coarser mesh, and sensors.{name}.mesh is 'coarse'; "
                    "allowed: mesh: default or fine, or an output that needs no second mesh"
                )
        # One fixed order: the same outputs are the same job.
        return {name: tuple(filter(outputs[name].__contains__, OPTIONAL)) for name in sensors if outputs.get(name)}

    @field_validator("indenters")
    @classmethod
    def _unique_indenters(cls, indenters: tuple[IndenterChoice, ...]) -> tuple[IndenterChoice, ...]:
        for name, count in Counter(each.name for each in indenters).items():
            if count > 1:
                raise ValueError(f"{shown(repr(name))} is listed twice")
        return indenters

    @field_validator("trajectories")
    @classmethod
    def _has_so_many_indenters(cls, trajectories: Trajectories, info: ValidationInfo) -> Trajectories:
        each, listed = trajectories.indenters_each, len(info.data.get("indenters", ()))
        if listed and each is not None and each > listed:
            raise ValueError(f"indenters_each {each}, but the job has {listed} indenters; allowed: 1 to {listed}")
        return trajectories

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
        furthest = MM_PER_M * furthest_in_contact_m(path_of(depths, trajectories)) if trajectories else 0.0
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
            words = f"one of {listed}" if len(names) > 1 else "nothing, as the job has only one indenter"
            raise ValueError(f"leave_out {shown(repr(dataset.leave_out))} is not allowed; allowed: {words}")
        return dataset

    @property
    def indenter_path(self) -> IndenterPath:
        """The path of every indenter: the press to all depths, then the legs of ``trajectories.path``."""
        return path_of(self.depths_mm, self.trajectories)

    @property
    def depths_m(self) -> np.ndarray:
        """(step,) float64, m, depth at each step of the path."""
        return self.indenter_path.depths_m

    @property
    def stops_early(self) -> bool:
        """True if presses end before they would leave too little gel."""
        return self.trajectories.too_thin == "stop"

    @property
    def displacement_step_m(self) -> float:
        """Step of int16 displacements, m: 0.1 um, or a multiple.

        The range is at least twice the indenter's travel: squeezed gel moves up to 1.7 times as far as the indenter.
        """
        return self._step_m(2.0)

    @property
    def height_step_m(self) -> float:
        """Step of height maps, m: 0.1 um, or a multiple.

        The range is at least 1.6 times the indenter's travel: a camera sees heights along slanted rays.
        """
        return self._step_m(1.6)

    def _step_m(self, travels: float) -> float:
        """Step of int16 values whose range is this many times the indenter's travel."""
        range_m = FINEST_STEP_M * np.iinfo(np.int16).max
        return FINEST_STEP_M * max(1, int(np.ceil(travels * furthest_in_contact_m(self.indenter_path) / range_m)))

    @property
    def indenter_names(self) -> tuple[str, ...]:
        return tuple(each.name for each in self.indenters)

    def kept_outputs(self, sensor: str) -> tuple[Output, ...]:
        """The outputs that the dataset keeps for a sensor, in the order of the table."""
        filled, legs = self.sensors[sensor].fluid != "none", not self.indenter_path.is_a_press
        return tuple(kept_outputs(filled, legs, self.outputs.get(sensor, ())))

    def optional_outputs(self, sensor: str) -> tuple[Output, ...]:
        """The kept outputs that a job may ask for."""
        return tuple(output for output in self.kept_outputs(sensor) if output.is_optional)

    def has_coarser_mesh(self, sensor: str) -> bool:
        """True if the presses of a sensor are solved on a coarser mesh, too."""
        return any(output.needs == "coarser mesh" for output in self.kept_outputs(sensor))

    def slow_outputs(self, sensor: str) -> tuple[str, ...]:
        """Names of the slow outputs that presses must measure: the kept ones, and those that kept estimates need."""
        wanted = {name for output in self.kept_outputs(sensor) for name in (output.name, output.needs)}
        return tuple(output.name for output in OUTPUTS if output.is_slow and output.name in wanted)

    def surface_outputs(self, sensor: str) -> tuple[str, ...]:
        """Names of the kept outputs at surface vertices."""
        return tuple(output.name for output in self.kept_outputs(sensor) if output.at_surface)

    def has_images(self, sensor: str) -> bool:
        """True if presses of a sensor measure what its camera sees."""
        return any(output.is_image for output in self.kept_outputs(sensor))

    @property
    def steps_in_words(self) -> str:
        """The number of steps and their depths, in words."""
        depths, legs = self.depths_mm, self.trajectories.path
        words = f"{depths.count} depths ({depths.first:g} to {depths.last:g} mm)"
        if legs:
            steps, plural = sum(leg.steps for leg in legs), "s" * (len(legs) > 1)
            words = f"({words} + {steps} step{'s' * (steps > 1)} on {len(legs)} leg{plural})"
        return words

    @property
    def indenters_each(self) -> int:
        """Number of indenters that press at each contact."""
        return self.trajectories.indenters_each or len(self.indenters)

    @property
    def indenters_in_words(self) -> str:
        """Number of indenters that press at each contact, in words: `9 indenters`, or `1 of 9 indenters`."""
        each, count = self.indenters_each, len(self.indenters)
        return f"{count} indenters" if each == count else f"{each} of {count} indenters"

    @property
    def presses(self) -> int:
        return self.trajectories.count * self.indenters_each

    @property
    def presses_in_shard(self) -> int:
        """Number of presses in a shard; the last one may have fewer."""
        return min(self.presses, self.dataset.presses_per_shard)

    @property
    def shards(self) -> int:
        return -(-self.presses // self.dataset.presses_per_shard)

    @property
    def samples(self) -> int:
        """Number of samples: presses times steps. A sample covers all sensors."""
        return self.presses * len(self.indenter_path)

    @property
    def folder(self) -> Path:
        """The folder of the job file, where relative paths start."""
        return self._folder

    def locate(self, text: str) -> str | Path:
        """Return a name as it is; let a relative path start at the job's folder."""
        return self._folder / os.path.expanduser(text) if is_path(text) else text

    def resolved(self) -> dict[str, Any]:
        """The settings that decide the data, as JSON types, with defaults filled in; without the output folder."""
        plain = self.model_dump(mode="json")
        del plain["dataset"]["output"]
        return plain

    @property
    def hash(self) -> str:
        """sha256 of the resolved job: keys in the schema's order, sensors in the job's."""
        return hash_of(self.resolved())

    def __hash__(self) -> int:
        return int(self.hash[:15], 16)

    def output(self) -> Path:
        """The dataset's folder, unless the command line replaces it."""
        return Path(os.path.expanduser(self.dataset.output or f"{self.name}.zarr"))


def hash_of(resolved: dict[str, Any]) -> str:
    """sha256 of a resolved job."""
    return hashlib.sha256(json.dumps(resolved).encode()).hexdigest()
