"""Sections of a job that choose sensors (model, mesh, material, output mesh) and indenters."""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from simgen.config.allowed_values import allowed
from simgen.config.strict_section import StrictSection
from simgen.errors import shown

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".msh", ".vtu", ".mesh", ".tet")
DEFAULT_CAMERA = "default"  # name of the camera that images show unless a job or a command names another
MESH_SPACING_MM = 0.2  # default grid spacing for an indenter's mesh


class MaterialChoice(StrictSection):
    """A material preset of the sensor (``material: solid``). The job may replace single values of it."""

    text_means = "preset"

    preset: str = Field(
        "solid", description="The preset to start from, one of those in the `sensor.yaml`", **allowed("a preset's name")
    )
    youngs_modulus_pa: float | None = Field(
        None, ge=1e3, le=1e9, description="Replaces the preset's modulus at small strains"
    )
    poisson_ratio: float | None = Field(
        None, ge=0.01, le=0.49999, description="Replaces the preset's ratio at small strains"
    )
    friction: float | None = Field(
        None, ge=0.0, le=2.0, description="Replaces the preset's Coulomb friction between sensor and indenter"
    )

    @model_validator(mode="before")
    @classmethod
    def _preset_alone(cls, value: Any) -> Any:
        return {cls.text_means: value} if isinstance(value, str) else value


class OutputFile(StrictSection):
    """A mesh file that replaces the sensor's output mesh. Its vertices are stored in their order."""

    file: str = Field(
        min_length=1,
        description="The mesh, in the sensor's frame. The dataset keeps its vertices and tetrahedra in their order. A "
        "vertex outside the gel (by at most 2 % of its length) moves with the nearest point of the gel's surface",
        **allowed("a path of a tetrahedral mesh: .msh .vtu .mesh .tet"),
    )
    unit: Literal["m", "mm"] = Field(description="The unit of the coordinates in the file")


class SensorChoice(StrictSection):
    """A sensor model, its simulation mesh, its material, and the fluid in its cavity."""

    model: str = Field(
        description="A bundled sensor, or the folder of a `sensor.yaml`",
        **allowed("a bundled sensor model (digit, biotac, gelsight_mini) or a path: ./my_sensor"),
    )
    mesh: Literal["default", "coarse", "fine"] = Field(
        "default", description="The simulation mesh. The stored vertices are the same for all of them"
    )
    material: MaterialChoice = Field(
        MaterialChoice(), description="The material of the gel: a preset's name, or a section"
    )
    fluid: Literal["none", "incompressible"] = Field(
        "none",
        description="Fluid in the cavity between skin and core. It keeps its volume, and its pressure is stored",
    )
    camera: str = Field(
        DEFAULT_CAMERA,
        exclude_if=lambda camera: camera == DEFAULT_CAMERA,
        description="The camera whose images `simgen render` makes",
        **allowed("the name of one of the `cameras` in the `sensor.yaml`; the DIGIT has default and tacto"),
    )
    output: OutputFile | None = Field(
        None,
        exclude_if=lambda output: output is None,
        description="A mesh of your own. Its vertices are stored in place of the sensor's output vertices",
    )


class IndenterChoice(StrictSection):
    """A bundled indenter, or a closed mesh. A name or path may replace the section."""

    text_means = "file"

    file: str = Field(
        description="An indenter of `indenters/indenters.yaml`, or a mesh of your own, which is named after its file",
        **allowed("a name, or a path of a closed mesh (.stl .obj .ply)"),
    )
    unit: Literal["m", "mm"] = Field("m", description="The unit of the mesh's coordinates; simgen does not guess it")
    spacing_mm: float = Field(
        MESH_SPACING_MM, ge=0.01, le=1.0,
        description="Spacing of the grid on which the mesh's signed distance is sampled; it rounds off smaller details",
    )  # fmt: skip

    @model_validator(mode="before")
    @classmethod
    def _file_alone(cls, value: Any) -> Any:
        return {cls.text_means: value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _only_a_mesh_has_a_unit(self) -> "IndenterChoice":
        if not is_path(self.file) and not self._is_alone():
            raise ValueError(f"unit and spacing_mm belong to mesh files, and {shown(repr(self.file))} is a name; "
                             "allowed: the name alone, or a path with its suffix")  # fmt: skip
        return self

    @model_serializer(mode="wrap")
    def _plain(self, sections: SerializerFunctionWrapHandler) -> str | dict[str, Any]:
        """Write the file alone if all else has its default: both ways of writing a job then give the same hash."""
        return self.file if self._is_alone() else sections(self)

    def _is_alone(self) -> bool:
        defaults = type(self).model_fields
        return all(getattr(self, key) == defaults[key].default for key in ("unit", "spacing_mm"))

    @property
    def name(self) -> str:
        """The file's name without its suffix."""
        return Path(self.file).stem if is_path(self.file) else self.file


def is_path(text: str) -> bool:
    """Return True for a path (with a slash or a mesh suffix), False for a bundled name."""
    return "/" in text or "\\" in text or text.lower().endswith(MESH_SUFFIXES)
