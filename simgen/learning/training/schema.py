"""The keys of a training job, strictly checked. Defaults are what the paper trained with (ACROSS, ICRA 2025, and the
configuration files of its published code), where it says so.
"""

import hashlib
import json
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, model_validator

from simgen.config.job_schema import NAME
from simgen.config.resources import bundled_jobs
from simgen.config.strict_section import StrictSection, find_file, load_section
from simgen.sensing.electrodes.model import ElectrodeSettings

Width = Annotated[int, Field(ge=1, le=65536)]
Share = Annotated[float, Field(ge=0.0, lt=1.0)]

# What can be trained, each after those that it needs.
NETWORKS = ("svb", "mvb", "mvd", "s2mpn", "m2mpn", "rmb", "rmd", "s2rm", "rm2rm")
SETTINGS = {
    "svb": "signal_vae", "mvb": "mesh_vae", "mvd": "mesh_vae", "s2mpn": "signal_projection", "m2mpn": "mesh_projection",
    "rmb": "reduced_model", "rmd": "reduced_model", "s2rm": "signal_translation", "rm2rm": "mesh_translation",
}  # fmt: skip


class Fit(StrictSection):
    """How a network is trained: by Adam; what is kept is the epoch with the least validation loss."""

    epochs: int = Field(300, ge=1, le=100_000, description="1 to 100000")
    batch: int = Field(128, ge=1, le=1_000_000, description="1 to 1000000")
    learning_rate: float = Field(1e-3, gt=0.0, le=1.0, description="above 0, to 1")
    schedule: Literal["exponential", "cosine"] = Field("exponential", description="exponential or cosine")
    decay: float = Field(1.0, gt=0.0, le=1.0, description="above 0, to 1")
    weight_decay: float = Field(0.0, ge=0.0, le=1.0, description="0 to 1")
    patience: int = Field(50, ge=1, le=100_000, description="1 to 100000")

    def learning_rate_in(self, epoch: int) -> float:
        if self.schedule == "cosine":
            return self.learning_rate * 0.5 * (1.0 + math.cos(math.pi * epoch / self.epochs))
        return self.learning_rate * self.decay**epoch


class MeshVAESettings(Fit):
    """MVB and MVD."""

    decay: float = Field(0.99, gt=0.0, le=1.0, description="above 0, to 1")
    latent: Width = Field(128, description="1 to 65536")
    beta: float = Field(0.005, ge=0.0, le=100.0, description="0 to 100")


class SignalVAESettings(Fit):
    """SVB."""

    epochs: int = Field(1000, ge=1, le=100_000, description="1 to 100000")
    batch: int = Field(256, ge=1, le=1_000_000, description="1 to 1000000")
    learning_rate: float = Field(1e-4, gt=0.0, le=1.0, description="above 0, to 1")
    widths: tuple[Width, ...] = Field(
        (256, 128, 64), min_length=1, max_length=20, description="a list of widths, 1 to 65536 each, 20 at most"
    )
    latent: Width = Field(8, description="1 to 65536")
    beta: float = Field(0.005, ge=0.0, le=100.0, description="0 to 100")


class ProjectionSettings(Fit):
    """M2MPN; S2MPN with other values."""

    epochs: int = Field(1000, ge=1, le=100_000, description="1 to 100000")
    batch: int = Field(1024, ge=1, le=1_000_000, description="1 to 1000000")
    widths: tuple[Width, ...] = Field(
        (512, 1024, 1024, 256), min_length=1, max_length=20, description="a list of widths, 1 to 65536 each, 20 at most"
    )
    dropout: tuple[Share, ...] = Field((0.2, 0.4, 0.0, 0.0), description="a list, one per width, 0 to below 1")

    @model_validator(mode="after")
    def _one_each(self) -> "ProjectionSettings":
        if len(self.dropout) != len(self.widths):
            raise ValueError(f"{len(self.dropout)} dropout, {len(self.widths)} widths; allowed: one dropout per width")
        return self


class SignalProjectionSettings(ProjectionSettings):
    """S2MPN."""

    learning_rate: float = Field(5e-4, gt=0.0, le=1.0, description="above 0, to 1")
    widths: tuple[Width, ...] = Field(
        (512, 128, 256, 256), min_length=1, max_length=20, description="a list of widths, 1 to 65536 each, 20 at most"
    )
    dropout: tuple[Share, ...] = Field((0.4, 0.3, 0.2, 0.5), description="a list, one per width, 0 to below 1")


class ReducedModelSettings(Fit):
    """RMB and RMD, ours."""

    epochs: int = Field(40, ge=1, le=100_000, description="1 to 100000")
    learning_rate: float = Field(3e-3, gt=0.0, le=1.0, description="above 0, to 1")
    schedule: Literal["exponential", "cosine"] = Field("cosine", description="exponential or cosine")
    # With what the convolutions learn, fewer numbers than PCA with 128 components.
    latent: Width = Field(127, description="1 to 65536")
    width: Width = Field(16, description="1 to 65536")


class TranslationSettings(Fit):
    """S2RM, ours."""

    epochs: int = Field(300, ge=1, le=100_000, description="1 to 100000")
    batch: int = Field(1024, ge=1, le=1_000_000, description="1 to 1000000")
    schedule: Literal["exponential", "cosine"] = Field("cosine", description="exponential or cosine")
    weight_decay: float = Field(0.01, ge=0.0, le=1.0, description="0 to 1")
    patience: int = Field(300, ge=1, le=100_000, description="1 to 100000")
    width: Width = Field(1024, description="1 to 65536")
    blocks: int = Field(3, ge=0, le=100, description="0 to 100")
    noise: float = Field(0.0, ge=0.0, le=10.0, description="0 to 10")
    power: float = Field(0.5, ge=0.0, le=2.0, description="0 to 2")


class MeshTranslationSettings(TranslationSettings):
    """RM2RM, ours."""

    width: Width = Field(512, description="1 to 65536")
    blocks: int = Field(4, ge=0, le=100, description="0 to 100")
    noise: float = Field(0.03, ge=0.0, le=10.0, description="0 to 10")


class RecordingFiles(StrictSection):
    """Electrode files in the published layout, in place of synthetic signals."""

    files: tuple[str, ...] = Field(min_length=1, description="a list of HDF5 files")
    least_force_n: float = Field(0.1, ge=0.0, le=100.0, description="0 to 100 N")
    remove_drift: bool = Field(False, description="true or false")


class Signals(StrictSection):
    """Where the electrodes' signals come from: the synthetic model, unless there are recordings."""

    synthetic: ElectrodeSettings = ElectrodeSettings()
    recordings: RecordingFiles | None = None


class TrainingJob(StrictSection):
    """A checked training job."""

    name: str = Field(pattern=NAME, description="letters, digits, _ . -, a letter first, 100 at most")
    seed: int = Field(0, ge=0, lt=2**32, description="a whole number, 0 to 4294967295")
    dataset: str = Field(min_length=1, description="the folder that `simgen run` wrote")
    source: str = Field("biotac", description="the sensor with electrodes, one of the dataset's")
    target: str = Field("digit", description="the sensor to translate to, one of the dataset's")
    networks: tuple[Literal[NETWORKS], ...] = Field(
        NETWORKS, min_length=1, description=f"a list of {', '.join(NETWORKS)}"
    )
    signals: Signals = Signals()
    mesh_vae: MeshVAESettings = MeshVAESettings()
    signal_vae: SignalVAESettings = SignalVAESettings()
    signal_projection: SignalProjectionSettings = SignalProjectionSettings()
    mesh_projection: ProjectionSettings = ProjectionSettings()
    reduced_model: ReducedModelSettings = ReducedModelSettings()
    signal_translation: TranslationSettings = TranslationSettings()
    mesh_translation: MeshTranslationSettings = MeshTranslationSettings()
    output: str | None = Field(None, description="a folder; by default <name>.networks in the current one")
    _folder: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _two_sensors(self) -> "TrainingJob":
        if self.source == self.target:
            raise ValueError(f"source and target are both {self.source!r}; allowed: two sensors of the dataset")
        return self

    @property
    def folder(self) -> Path:
        """Where paths of recordings start: the folder of the job file."""
        return self._folder

    def dataset_folder(self) -> Path:
        """Relative to the current folder, where `simgen run` has put it."""
        return Path(os.path.expanduser(self.dataset))

    def in_order(self) -> list[str]:
        """The networks to train, each after those that it needs."""
        return [name for name in NETWORKS if name in self.networks]

    def fit_of(self, name: str) -> Fit:
        """How a network is trained."""
        return getattr(self, SETTINGS[name])

    def resolved(self) -> dict[str, Any]:
        """All that decides the networks, as JSON types: not where
        the dataset is, which of them are trained now, nor where they are put."""
        return self.model_dump(mode="json", exclude={"dataset", "networks", "output"})

    @property
    def hash(self) -> str:
        """sha256 of the resolved job."""
        return hashlib.sha256(json.dumps(self.resolved()).encode()).hexdigest()

    def output_folder(self) -> Path:
        """Where the networks go unless the command line says otherwise."""
        return Path(os.path.expanduser(self.output or f"{self.name}.networks"))


def load_training_job(path: str | Path, overrides: Iterable[str] = ()) -> TrainingJob:
    """Read a training job; ``training_smoke`` and ``jobs/training_smoke.yaml`` that do not exist are the bundled one.

    Raises `InputError` with one line that names the file, the key, the value and what is allowed.
    """
    file = find_file(path, bundled_jobs(training=True), "training job")
    job = load_section(TrainingJob, file, str(path), overrides)
    job._folder = file.parent.resolve()
    return job
