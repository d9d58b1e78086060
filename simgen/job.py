"""A job: what to press into which sensor, how far, and how exactly. YAML in, a frozen and checked `Job` out.

Everything that decides the bytes of a dataset is in the job, and nothing else is: no host, date or number
of workers. Keys carry their unit (``depths_mm``, ``youngs_modulus_pa``). A key that is unknown, or a value
that is out of range, is an `InputError` of one line: the file, the key path, the value, what is allowed.
"""

import difflib
import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from simgen.errors import InputError
from simgen.resources import resource

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".msh", ".vtu", ".mesh", ".tet")
Angle = Annotated[float, Field(ge=-180.0, le=180.0)]
# int16 in steps of 0.1 um reaches 3.2767 mm; the gel follows the indenter, and a little beyond it.
DEEPEST_INT16_MM = 3.2
NAME = r"^[A-Za-z][A-Za-z0-9_.-]*$"


class Section(BaseModel):
    """A frozen group of keys that accepts no other keys, no NaN, and no text where a number is due."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class MaterialChoice(Section):
    """A material preset of the sensor model (``material: solid``); single values may replace its own."""

    preset: str = Field("solid", description="a preset of the sensor model, e.g. solid")
    youngs_modulus_pa: float | None = Field(
        None, ge=1e3, le=1e9, description="1e3 to 1e9 Pa (539 kPa: 539e3)"
    )
    poisson_ratio: float | None = Field(None, ge=0.01, le=0.49999, description="0.01 to 0.49999")
    friction: float | None = Field(None, ge=0.0, le=2.0, description="a Coulomb coefficient, 0 to 2")

    @model_validator(mode="before")
    @classmethod
    def _preset_alone(cls, value: Any) -> Any:
        return {"preset": value} if isinstance(value, str) else value


class SensorChoice(Section):
    """Which sensor model, on which of its meshes, made of which material, with what in its cavity."""

    model: str = Field(description="a bundled sensor model (digit, biotac) or a path: ./my_sensor")
    mesh: Literal["default", "coarse", "fine"] = Field("default", description="default, coarse or fine")
    material: MaterialChoice = MaterialChoice()
    fluid: Literal["none", "incompressible"] = Field("none", description="none or incompressible, in its cavity")


class Trajectories(Section):
    """How many contact poses, and `simgen.pairing.ContactSettings` (which says what each key means)."""

    count: int = Field(ge=1, le=1_000_000, description="a whole number of contact poses, 1 to 1000000")
    max_tilt_deg: float = Field(5.0, ge=0.0, le=45.0, description="0 to 45 degrees")
    roll_range_deg: tuple[Angle, Angle] = Field(
        (-90.0, 90.0), description="[first, last], -180 to 180 degrees"
    )
    max_indentation_ratio: float = Field(0.6, gt=0.0, lt=1.0, description="between 0 and 1")
    min_edge_ratio: float = Field(1.5, ge=0.0, le=10.0, description="0 to 10")


class Depths(Section):
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
        return self


class Solver(Section):
    """The finite element, and `simgen.fem.newton.SolverSettings` (which says what each key means)."""

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


class DatasetSettings(Section):
    """How the samples are stored."""

    displacement: Literal["int16", "float32"] = Field(
        "int16", description="int16 (steps of 0.1 um) or float32"
    )
    presses_per_shard: int = Field(
        9, ge=1, le=4096, description="a whole number of presses that one task solves and writes, 1 to 4096"
    )
    output: str | None = Field(None, description="a folder; by default <name>.zarr in the current one")


class Job(Section):
    """A checked job. `load_job` makes one from YAML; `resolved` and `hash` say what it decides."""

    name: str = Field(pattern=NAME, description="letters, digits, _ . -, a letter first")
    seed: int = Field(0, ge=0, lt=2**32, description="a whole number, 0 to 4294967295")
    # The first sensor is the reference on which contacts are sampled.
    sensors: dict[str, SensorChoice] = Field(min_length=1, description="name: {model, mesh, material, fluid}, ...")
    indenters: tuple[str, ...] = Field(min_length=1, description="a list of names, or paths of closed meshes")
    trajectories: Trajectories
    depths_mm: Depths
    solver: Solver = Solver()
    dataset: DatasetSettings = Field(DatasetSettings(), validate_default=True)
    _folder: Path = PrivateAttr(default=Path())  # of the job file: relative paths start there

    @field_validator("sensors")
    @classmethod
    def _sensor_names(cls, sensors: dict[str, SensorChoice]) -> dict[str, SensorChoice]:
        for name in sensors:
            if not re.match(NAME, name) or name in ("press", "depth"):
                raise ValueError(
                    f"{name!r} cannot name a sensor; allowed: letters, digits, _ . -, not press, depth"
                )
        return sensors

    @field_validator("indenters")
    @classmethod
    def _unique_indenters(cls, indenters: tuple[str, ...]) -> tuple[str, ...]:
        names = [indenter_name(text) for text in indenters]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"{name!r} is listed twice")
        return indenters

    @field_validator("dataset")
    @classmethod
    def _displacements_fit(cls, dataset: DatasetSettings, info: ValidationInfo) -> DatasetSettings:
        depths = info.data.get("depths_mm")
        if depths and dataset.displacement == "int16" and depths.last > DEEPEST_INT16_MM:
            raise ValueError(
                f"displacement int16 holds up to 3.2767 mm, too little for depths_mm.last = {depths.last:g}; "
                f"allowed: displacement float32, or depths_mm.last up to {DEEPEST_INT16_MM:g}"
            )
        return dataset

    @property
    def depths_m(self) -> np.ndarray:
        """(depth,) float64, m. Rounded to whole nanometres, so that 0.3 mm is 0.3 mm."""
        spaced = np.linspace(self.depths_mm.first, self.depths_mm.last, self.depths_mm.count)
        return np.round(spaced * 1e-3, 9)

    @property
    def indenter_names(self) -> tuple[str, ...]:
        return tuple(indenter_name(text) for text in self.indenters)

    @property
    def presses(self) -> int:
        return self.trajectories.count * len(self.indenters)

    @property
    def shards(self) -> int:
        return -(-self.presses // self.dataset.presses_per_shard)

    @property
    def samples(self) -> int:
        """Presses times depths: each is one sample on every sensor."""
        return self.presses * self.depths_mm.count

    def locate(self, text: str) -> str | Path:
        """A name stays a name; a path that is relative starts at the folder of the job file."""
        return self._folder / Path(text).expanduser() if is_path(text) else text

    def resolved(self) -> dict[str, Any]:
        """All that decides the data, defaults filled in, as JSON types; where it is stored is no part."""
        plain = self.model_dump(mode="json")
        del plain["dataset"]["output"]
        return plain

    @property
    def hash(self) -> str:
        """sha256 of the resolved job. Keys are in the order of the schema, sensors in that of the job."""
        return hashlib.sha256(json.dumps(self.resolved()).encode()).hexdigest()

    def __hash__(self) -> int:
        return int(self.hash[:15], 16)

    def output(self) -> Path:
        """Where the dataset goes unless the command line says otherwise."""
        return Path(self.dataset.output or f"{self.name}.zarr").expanduser()


def is_path(text: str) -> bool:
    """Whether a sensor model or an indenter is a path (with a slash or a mesh suffix) rather than a name."""
    return "/" in text or "\\" in text or text.lower().endswith(MESH_SUFFIXES)


def indenter_name(text: str) -> str:
    return Path(text).stem if is_path(text) else text


def load_job(path: str | Path, overrides: Iterable[str] = ()) -> Job:
    """Read a job file; `overrides` are ``key.sub=value`` strings, their values read as YAML.

    ``smoke``, ``smoke.yaml`` and ``jobs/smoke.yaml`` that do not exist are looked up among the bundled jobs.
    Raises `InputError` with one line that names the file, the key, the value and what is allowed.
    """
    file = find_job(path)
    data = _read_yaml(file.read_text(encoding="utf-8"), str(path))
    if not isinstance(data, dict):
        raise InputError(f"{path}: a job is a mapping of keys to values; this is a {type(data).__name__}")
    sources = dict.fromkeys(_key_paths(data), str(path))
    for override in overrides:
        key = _apply_override(data, override)
        sources[key] = f"override {override}"
    return job_from_dict(data, str(path), sources, folder=file.parent.resolve())


def find_job(path: str | Path) -> Path:
    """The job file itself, or for ``NAME`` and ``jobs/NAME`` the bundled one of that name.

    Raises `InputError` if there is neither.
    """
    path = Path(path).expanduser()
    bundled = resource("jobs")
    candidates = [path]
    if path.parent in (Path(), Path("jobs")):
        candidates += [bundled / path.name, bundled / f"{path.name}.yaml"]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    names = ", ".join(sorted(file.name for file in bundled.glob("*.yaml")))
    raise InputError(f"{path}: no such job file; bundled jobs: {names}")


def job_from_dict(
    data: Mapping[str, Any],
    source: str = "job",
    sources: Mapping[str, str] | None = None,
    folder: Path = Path(),
) -> Job:
    """Check plain data (as from YAML) and make a `Job` of it. `sources` tells which key came from where."""
    try:
        job = Job.model_validate_json(json.dumps(data, default=str))
    except ValidationError as error:
        raise InputError(_one_line(error, source, sources or {})) from None
    job._folder = folder
    return job


class _Loader(yaml.SafeLoader):
    """YAML as people write it: 1e5 is a number, a key given twice is an error."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\d+\.\d*|\.?\d+)([eE][-+]?\d+)$"),
    list("-+0123456789."),
)


def _mapping_without_duplicates(loader: _Loader, node: yaml.MappingNode) -> dict:
    seen = set()
    for key, _ in node.value:
        if key.value in seen:
            raise yaml.constructor.ConstructorError(
                None, None, f"key {key.value!r} is given twice", key.start_mark
            )
        seen.add(key.value)
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping_without_duplicates)


def _read_yaml(text: str, source: str) -> Any:
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}" if mark else ""
        raise InputError(f"{source}:{where} {getattr(error, 'problem', None) or 'not valid YAML'}") from None


def _apply_override(data: dict, override: str) -> str:
    """Set one key in place; return its dotted path."""
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise InputError(f"override {override}: write it as key=value or key.sub=value")
    target = data
    for part in parts[:-1]:
        inner = target.get(part)
        if not isinstance(inner, dict):
            inner = {"preset": inner} if part == "material" and isinstance(inner, str) else {}
            target[part] = inner
        target = inner
    target[parts[-1]] = _read_yaml(text, f"override {override}")
    return ".".join(parts)


def _key_paths(data: Mapping[str, Any], prefix: str = "") -> list[str]:
    paths = []
    for key, value in data.items():
        paths.append(f"{prefix}{key}")
        if isinstance(value, dict):
            paths += _key_paths(value, f"{prefix}{key}.")
    return paths


def _one_line(error: ValidationError, source: str, sources: Mapping[str, str]) -> str:
    """The first complaint, in the words of the job file."""
    first = error.errors()[0]
    parts = [str(part) for part in first["loc"]]
    section, allowed = _schema_at(parts)
    if first["type"] == "extra_forbidden":
        complaint = f"unknown key; {_allowed_keys(section, parts[-1])}"
    elif first["type"] == "missing":
        complaint = f"missing; allowed: {allowed}"
    elif first["type"] == "value_error":
        complaint = first["msg"].removeprefix("Value error, ")
    else:
        complaint = f"{json.dumps(first['input'])} is not allowed; allowed: {allowed}"
    at = next((sources[path] for path in _upwards(parts) if path in sources), source)
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return f"{at}: {'.'.join(parts)}: {complaint}{more}"


def _upwards(parts: list[str]) -> list[str]:
    return [".".join(parts[:n]) for n in range(len(parts), 0, -1)]


def _schema_at(parts: list[str]) -> tuple[type[Section], str]:
    """The section that holds the last key of a path, and what is allowed at that path."""
    section, allowed = Job, ""
    for above, part in zip(["", *parts], parts, strict=False):
        field = section.model_fields.get(part)
        inner = SensorChoice if above == "sensors" else getattr(field, "annotation", None)
        allowed = getattr(field, "description", None) or allowed
        if isinstance(inner, type) and issubclass(inner, Section):
            section, allowed = inner, f"a mapping with the keys {', '.join(inner.model_fields)}"
    return section, allowed


def _allowed_keys(section: type[Section], wrong: str = "") -> str:
    keys = list(section.model_fields)
    close = difflib.get_close_matches(wrong, keys, n=1, cutoff=0.5)
    hint = f" (did you mean {close[0]}?)" if close else ""
    return f"allowed: {', '.join(keys)}{hint}"
