"""Keys of a training job, strictly checked.

Defaults are those of the ACROSS paper (ICRA 2025) and of its published configuration files, where these state them.
"""

import hashlib
import json
import math
import os
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, model_validator

from simgen.config.allowed_values import allowed
from simgen.config.job_schema import NAME, NAME_IN_WORDS
from simgen.config.resources import bundled_jobs
from simgen.config.strict_section import StrictSection, find_file, load_section
from simgen.learning.data.registry import NETWORKS
from simgen.sensing.electrodes.model import ElectrodeSettings

Width = Annotated[int, Field(ge=1, le=65536)]
Share = Annotated[float, Field(ge=0.0, lt=1.0)]


# Keys that several sections have: each needs its default alone.
epochs = partial(Field, ge=1, le=100_000, description="Largest number of epochs")
batch = partial(Field, ge=1, le=1_000_000, description="Samples per step; all training samples if there are fewer")
learning_rate = partial(Field, gt=0.0, le=1.0, description="Learning rate of the first epoch")
schedule = partial(
    Field, description="exponential: times `decay` after each epoch. cosine: half a cosine, to 0 after the last epoch"
)
decay = partial(Field, gt=0.0, le=1.0, description="Factor of the exponential schedule")
optimizer = partial(
    Field,
    description="adamw, or muon: the steps of matrices and convolutions are made orthogonal, and AdamW moves all other "
    "numbers",
)
weight_decay = partial(Field, ge=0.0, le=1.0, description="Weight decay; AdamW with 0 is Adam")
warm_up = partial(
    Field, ge=0, le=1_000_000, description="First steps, in which the learning rate grows in proportion to their number"
)
clip = partial(
    Field, ge=0.0, le=1e6, description="Largest Euclidean norm of a step's gradient; a longer one is shortened; 0: any"
)
patience = partial(
    Field, ge=1, le=100_000, description="Training ends after this many epochs without a new lowest validation loss"
)
beta = partial(Field, ge=0.0, le=100.0, description="Weight of the KL divergence, which is a mean over latents")
widths = partial(Field, min_length=1, max_length=20, **allowed("a list of widths, 1 to 65536 each, 20 at most"))
hidden_widths = partial(widths, description="Widths of the hidden layers; a linear layer into the latent space follows")
dropout = partial(
    Field, description="Dropout after each hidden layer", **allowed("a list, one per width, 0 to below 1")
)
block_width = partial(Field, description="Width of the residual blocks")
blocks = partial(Field, ge=0, le=100, description="Number of residual blocks")
noise = partial(
    Field, ge=0.0, le=10.0,
    description="Standard deviation of the noise that training adds to each input, relative to the sample's own size",
)  # fmt: skip
power = partial(
    Field, 0.5, ge=0.0, le=2.0,
    description="The loss divides errors by this power of a sample's distance from rest: 0 for absolute errors, 1 for "
    "relative ones",
)  # fmt: skip


class Fit(StrictSection):
    """Training of a network; the epoch with the least validation loss is kept."""

    epochs: int = epochs(300)
    batch: int = batch(128)
    learning_rate: float = learning_rate(1e-3)
    schedule: Literal["exponential", "cosine"] = schedule("exponential")
    decay: float = decay(1.0)
    weight_decay: float = weight_decay(0.0)
    warm_up: int = warm_up(0)
    clip: float = clip(0.0)
    patience: int = patience(50)

    @property
    def by_muon(self) -> bool:
        """True if Muon moves matrices and convolutions."""
        return False

    def learning_rate_in(self, epoch: int) -> float:
        if self.schedule == "cosine":
            return self.learning_rate * 0.5 * (1.0 + math.cos(math.pi * epoch / self.epochs))
        return self.learning_rate * self.decay**epoch


class FitByMuon(Fit):
    """Training of a network by Muon, if the job wants it."""

    optimizer: Literal["adamw", "muon"] = optimizer("muon")
    learning_rate: float = learning_rate(3e-3)

    @property
    def by_muon(self) -> bool:
        return self.optimizer == "muon"


class MeshVAESettings(Fit):
    """MVB and MVD."""

    decay: float = decay(0.99)
    latent: Width = Field(
        128, description="Length of a latent vector; the linear layers beside it are four times as wide"
    )
    beta: float = beta(0.005)


class SignalVAESettings(Fit):
    """SVB."""

    epochs: int = epochs(1000)
    batch: int = batch(256)
    learning_rate: float = learning_rate(1e-4)
    widths: tuple[Width, ...] = widths(
        (256, 128, 64), description="Widths of the encoder's hidden layers; the decoder has them in reverse order"
    )
    latent: Width = Field(8, description="Length of a latent vector")
    beta: float = beta(0.005)


class ProjectionSettings(Fit):
    """M2MPN. S2MPN has the same keys with other defaults."""

    epochs: int = epochs(1000)
    batch: int = batch(1024)
    widths: tuple[Width, ...] = hidden_widths((512, 1024, 1024, 256))
    dropout: tuple[Share, ...] = dropout((0.2, 0.4, 0.0, 0.0))

    @model_validator(mode="after")
    def _one_each(self) -> "ProjectionSettings":
        if len(self.dropout) != len(self.widths):
            raise ValueError(f"{len(self.dropout)} dropout, {len(self.widths)} widths; allowed: one dropout per width")
        return self


class SignalProjectionSettings(ProjectionSettings):
    """S2MPN."""

    learning_rate: float = learning_rate(5e-4)
    widths: tuple[Width, ...] = hidden_widths((512, 128, 256, 256))
    dropout: tuple[Share, ...] = dropout((0.4, 0.3, 0.2, 0.5))


class ReducedModelSettings(Fit):
    """RMB and RMD, ours."""

    epochs: int = epochs(40)
    learning_rate: float = learning_rate(3e-3)
    schedule: Literal["exponential", "cosine"] = schedule("cosine")
    # With the weights of the convolutions, fewer parameters than PCA with 128 components.
    latent: Width = Field(127, description="Principal components")
    width: Width = Field(16, description="Features of a vertex between the convolutions")


class TranslationSettings(FitByMuon):
    """S2RM, ours."""

    epochs: int = epochs(300)
    batch: int = batch(1024)
    schedule: Literal["exponential", "cosine"] = schedule("cosine")
    weight_decay: float = weight_decay(0.1)
    patience: int = patience(300)
    width: Width = block_width(1024)
    blocks: int = blocks(3)
    noise: float = noise(0.0)
    power: float = power()


class MeshTranslationSettings(TranslationSettings):
    """RM2RM, ours."""

    optimizer: Literal["adamw", "muon"] = optimizer("adamw")
    learning_rate: float = learning_rate(1e-3)
    weight_decay: float = weight_decay(0.01)
    width: Width = block_width(512)
    blocks: int = blocks(4)
    noise: float = noise(0.03)


class PointTranslationSettings(FitByMuon):
    """PT, ours."""

    epochs: int = epochs(30)
    batch: int = batch(256)
    schedule: Literal["exponential", "cosine"] = schedule("cosine")
    weight_decay: float = weight_decay(0.02)
    warm_up: int = warm_up(300)
    clip: float = clip(1.0)
    pixel_mm: float = Field(0.5, ge=0.1, le=10.0, description="Pixel of the unrolled skin")
    width: int = Field(
        32, ge=8, le=1024, multiple_of=8, description="Channels of the U-Net's finest level; each coarser level has "
        "twice as many", **allowed("a multiple of 8, 8 to 1024"),
    )  # fmt: skip
    levels: int = Field(3, ge=0, le=8, description="Coarser levels of the U-Net, each with half the rows and columns")
    blocks: int = Field(1, ge=1, le=100, description="Residual blocks of a level, on the way down and on the way up")
    features: Width = Field(48, description="Channels of the U-Net's output")
    hidden: Width = Field(96, description="Width of the perceptron that takes them to displacements")
    power: float = power()
    members: int = Field(
        2, ge=1, le=16, description="Networks that answer; each learns from its share of every batch. Predictions take "
        "as many times as long", **allowed("1 to 16, at most a batch's samples"),
    )  # fmt: skip
    predicted: Share = Field(
        0.5,
        description="Share of the samples whose mesh of the source is the one that S2RM and RMB predict from the "
        "signals, in place of the true one; 0 for a source without electrodes; for recordings all are true",
    )

    @model_validator(mode="after")
    def _samples_for_all(self) -> "PointTranslationSettings":
        if self.batch < self.members:
            raise ValueError(f"{self.members} members, a batch of {self.batch}; allowed: a sample for each member")
        return self


class RecordingFiles(StrictSection):
    """Electrode files in the published layout, in place of synthetic signals."""

    files: tuple[str, ...] = Field(
        min_length=1,
        description="Files in the [published layout](electrodes.md#recordings); paths start at the folder of the job "
        "file",
        **allowed("a list of HDF5 files"),
    )
    least_force_n: float = Field(
        0.1, ge=0.0, le=100.0, description="Samples with less force count as without contact and are left out"
    )
    remove_drift: bool = Field(
        False, description="Subtract a straight line from each electrode's signal, fitted to samples without contact"
    )


class Signals(StrictSection):
    """Source of the electrodes' signals: the synthetic model, unless there are recordings."""

    synthetic: ElectrodeSettings = Field(
        ElectrodeSettings(), description="Signals of the dataset's samples by the [electrode model](electrodes.md)"
    )
    recordings: RecordingFiles | None = Field(None, description="Recorded signals, which replace the synthetic ones")


class TrainingJob(StrictSection):
    """A checked training job."""

    name: str = Field(
        pattern=NAME, description="Names the folder of the networks, `<name>.networks`", **allowed(NAME_IN_WORDS)
    )
    seed: int = Field(
        0, ge=0, lt=2**32,
        description="Seed of weights, order of samples, dropout, drawn latents, and of the splits of recordings",
    )  # fmt: skip
    dataset: str = Field(
        min_length=1,
        description="The dataset to learn from; a path starts at the current folder",
        **allowed("the folder that `simgen run` wrote"),
    )
    source: str = Field(
        "biotac",
        description="The sensor that is translated from; its electrodes give the signals",
        **allowed("a sensor of the dataset that has electrodes"),
    )
    target: str = Field(
        "digit",
        description="The sensor that is translated to",
        **allowed("another sensor of the dataset"),
    )
    leave_out: str | None = Field(
        None,
        description="An indenter that the networks do not see. The test then has this one alone, at contacts that are "
        "new, too, and training and validation have all others",
        **allowed("the name of one of the dataset's indenters"),
    )
    networks: tuple[Literal[tuple(NETWORKS)], ...] = Field(
        tuple(NETWORKS),
        min_length=1,
        description="The networks to train now. Their order here does not matter. Others may be added later",
        **allowed(f"a list of {', '.join(NETWORKS)}"),
    )
    signals: Signals = Field(Signals(), description="Source of the electrodes' signals")
    mesh_vae: MeshVAESettings = Field(MeshVAESettings(), description="Shape and training of MVB and MVD")
    signal_vae: SignalVAESettings = Field(SignalVAESettings(), description="Shape and training of SVB")
    signal_projection: SignalProjectionSettings = Field(
        SignalProjectionSettings(), description="Shape and training of S2MPN"
    )
    mesh_projection: ProjectionSettings = Field(ProjectionSettings(), description="Shape and training of M2MPN")
    reduced_model: ReducedModelSettings = Field(ReducedModelSettings(), description="Shape and training of RMB and RMD")
    signal_translation: TranslationSettings = Field(TranslationSettings(), description="Shape and training of S2RM")
    mesh_translation: MeshTranslationSettings = Field(
        MeshTranslationSettings(), description="Shape and training of RM2RM"
    )
    point_translation: PointTranslationSettings = Field(
        PointTranslationSettings(), description="Shape and training of PT"
    )
    output: str | None = Field(
        None,
        description="Folder of the networks. `--output` replaces it; the job's hash does not cover it",
        **allowed("a folder; by default <name>.networks in the current one"),
    )
    _folder: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _two_sensors(self) -> "TrainingJob":
        if self.source == self.target:
            raise ValueError(f"source and target are both {self.source!r}; allowed: two sensors of the dataset")
        return self

    @property
    def folder(self) -> Path:
        """Folder of the job file: paths of recordings start there."""
        return self._folder

    def dataset_folder(self) -> Path:
        """Path of the dataset; a relative one starts at the current folder."""
        return Path(os.path.expanduser(self.dataset))

    def in_order(self) -> list[str]:
        """Names of the networks to train, each after those that it needs."""
        return [name for name in NETWORKS if name in self.networks]

    def needs(self, name: str) -> tuple[str, ...]:
        """Names of the networks to train before one."""
        spec = NETWORKS[name]
        return spec.needs + (spec.feeding if self.is_fed(name) else ())

    def is_fed(self, name: str) -> bool:
        """Return True if a network also learns from predicted inputs. Recordings have no meshes of the target."""
        return bool(NETWORKS[name].fed_by and self.fit_of(name).predicted and self.signals.recordings is None)

    def fit_of(self, name: str) -> Fit:
        """Settings of a network."""
        return getattr(self, NETWORKS[name].settings)

    def resolved(self) -> dict[str, Any]:
        """All keys that decide the networks, as JSON types: without ``dataset``, ``networks`` and ``output``."""
        return self.model_dump(mode="json", exclude={"dataset", "networks", "output"})

    @property
    def hash(self) -> str:
        """sha256 of the resolved job."""
        return hashlib.sha256(json.dumps(self.resolved()).encode()).hexdigest()

    def output_folder(self) -> Path:
        """Folder of the networks, unless the command line names another."""
        return Path(os.path.expanduser(self.output or f"{self.name}.networks"))


def load_training_job(path: str | Path, overrides: Iterable[str] = ()) -> TrainingJob:
    """Read a training job. A missing ``training_smoke`` or ``jobs/training_smoke.yaml`` means the bundled job.

    Raises `InputError` with one line that names the file, the key, the value and what is allowed.
    """
    file = find_file(path, bundled_jobs(training=True), "training job")
    job = load_section(TrainingJob, file, str(path), overrides)
    job._folder = file.parent.resolve()
    return job
