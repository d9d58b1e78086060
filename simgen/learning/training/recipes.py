"""What each network is made of and what it learns from: the paper's five, and ours."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor, nn

from simgen.dataset.splits import SPLITS
from simgen.learning.training.data import MeshSamples, TrainingData
from simgen.learning.training.fit import Terms
from simgen.learning.training.hierarchy import build_hierarchy
from simgen.learning.training.mesh_vae import MeshVAE
from simgen.learning.training.projection import Projection
from simgen.learning.training.reduced_model import ReducedModel
from simgen.learning.training.schema import Fit, ProjectionSettings, TrainingJob, TranslationSettings
from simgen.learning.training.signal_vae import SignalVAE
from simgen.learning.training.signals import SignalData, read_signals
from simgen.learning.training.translation import Translation

BATCH = 512  # of what is computed once for all samples


@dataclass
class Recipe:
    """A network that is not trained yet, and how it will be.

    terms : of row numbers; what is minimised is the first
    rows : row numbers of training and of validation
    coarse : whether products may be made in TF32: noise far below that of a latent that is drawn, but 1 um of 2 mm
    """

    network: nn.Module
    terms: Terms
    settings: Fit
    rows: tuple[Tensor, Tensor]
    coarse: bool = False


@dataclass
class Inputs:
    """What recipes take from: data on a device, and networks trained before, by name."""

    job: TrainingJob
    data: TrainingData
    trained: Callable[[str], nn.Module]

    @cached_property
    def signals(self) -> SignalData:
        job = self.job
        return read_signals(self.data, job.source, job.signals, job.folder, job.seed)

    def check(self, networks: Collection[str]) -> None:
        """Raises `InputError` if samples are missing that these networks, or their tests, need."""
        for split in SPLITS:
            self.data.rows(split)
            if {"svb", "s2mpn", "s2rm"} & {*networks}:
                self.signals.rows(split)
        if {"s2mpn", "s2rm"} & {*networks}:
            self.signals.with_meshes()

    @property
    def source(self) -> MeshSamples:
        return self.data.meshes[self.job.source]

    @property
    def target(self) -> MeshSamples:
        return self.data.meshes[self.job.target]

    @property
    def rows(self) -> tuple[Tensor, Tensor]:
        return self.data.rows("train"), self.data.rows("validation")

    @property
    def signal_rows(self) -> tuple[Tensor, Tensor]:
        return self.signals.rows("train"), self.signals.rows("validation")


def make_recipe(name: str, inputs: Inputs) -> Recipe:
    """Make the recipe of one of `schema.NETWORKS`; weights come from the job's seed and the name."""
    return RECIPES[name](inputs)


def signal_vae(inputs: Inputs) -> Recipe:
    """SVB."""
    settings, signals = inputs.job.signal_vae, inputs.signals
    network = SignalVAE(*signals.bounds(), settings.widths, settings.latent)

    def terms(rows: Tensor) -> dict[str, Tensor]:
        return network.terms(signals.values[rows], settings.beta)

    return Recipe(network, terms, settings, inputs.signal_rows)


def mesh_vae(inputs: Inputs, meshes: MeshSamples) -> Recipe:
    """MVB, MVD."""
    settings, rows = inputs.job.mesh_vae, inputs.rows
    hierarchy = build_hierarchy(meshes.rest.double().cpu().numpy(), meshes.tetrahedra)
    network = MeshVAE.of_mesh(hierarchy, *mean_and_deviation(meshes, rows[0]), settings.latent)

    def terms(batch: Tensor) -> dict[str, Tensor]:
        loss, mse, kl = network.loss(meshes.displacement(batch), settings.beta)
        return {"loss": loss, "mse": mse, "kl": kl}

    return Recipe(network, terms, settings, rows, coarse=True)


def projection(source: Tensor, target: Tensor, settings: ProjectionSettings, rows: tuple[Tensor, Tensor]) -> Recipe:
    """S2MPN, M2MPN: from latents (sample, inputs) to latents (sample, outputs)."""
    network = Projection(source.shape[1], target.shape[1], settings.widths, settings.dropout)

    def terms(batch: Tensor) -> dict[str, Tensor]:
        return network.terms(source[batch], target[batch])

    return Recipe(network, terms, settings, rows)


def signal_projection(inputs: Inputs) -> Recipe:
    """S2MPN. Raises `InputError` for recordings without meshes."""
    signals, svb, mvb = inputs.signals, inputs.trained("svb"), inputs.trained("mvb")
    source = latents(svb, lambda rows: signals.values[rows], len(signals.values))
    target = latents(mvb, signals.with_meshes().displacement, len(signals.values))
    return projection(source, target, inputs.job.signal_projection, inputs.signal_rows)


def mesh_projection(inputs: Inputs) -> Recipe:
    """M2MPN."""
    source = latents(inputs.trained("mvb"), inputs.source.displacement, len(inputs.data))
    target = latents(inputs.trained("mvd"), inputs.target.displacement, len(inputs.data))
    return projection(source, target, inputs.job.mesh_projection, inputs.rows)


def reduced_model(inputs: Inputs, meshes: MeshSamples) -> Recipe:
    """RMB, RMD: ours."""
    settings, rows = inputs.job.reduced_model, inputs.rows
    network = ReducedModel.of_samples(meshes.displacement, rows[0], meshes.rest, meshes.tetrahedra, settings.latent,
                                      settings.width)  # fmt: skip

    def terms(batch: Tensor) -> dict[str, Tensor]:
        return network.terms(meshes.displacement(batch))

    return Recipe(network, terms, settings, rows)


def translation(
    source: Tensor, target: Tensor, at_rest: tuple[Tensor, Tensor], settings: TranslationSettings,
    rows: tuple[Tensor, Tensor],
) -> Recipe:  # fmt: skip
    """S2RM, RM2RM: ours, from inputs (sample, inputs) to latents (sample, outputs), both known at rest."""
    network = Translation.of_samples(
        source[rows[0]], target[rows[0]], *at_rest, width=settings.width, blocks=settings.blocks,
        noise=settings.noise, power=settings.power,
    )  # fmt: skip

    def terms(batch: Tensor) -> dict[str, Tensor]:
        return network.terms(source[batch], target[batch])

    return Recipe(network, terms, settings, rows)


def signal_translation(inputs: Inputs) -> Recipe:
    """S2RM. Raises `InputError` for recordings without meshes."""
    signals, rmb = inputs.signals, inputs.trained("rmb")
    target = latents(rmb, signals.with_meshes().displacement, len(signals.values))
    at_rest = signals.rest, latents_at_rest(rmb)
    return translation(signals.values, target, at_rest, inputs.job.signal_translation, inputs.signal_rows)


def mesh_translation(inputs: Inputs) -> Recipe:
    """RM2RM."""
    source = latents(inputs.trained("rmb"), inputs.source.displacement, len(inputs.data))
    target = latents(inputs.trained("rmd"), inputs.target.displacement, len(inputs.data))
    at_rest = latents_at_rest(inputs.trained("rmb")), latents_at_rest(inputs.trained("rmd"))
    return translation(source, target, at_rest, inputs.job.mesh_translation, inputs.rows)


@torch.no_grad()
def latents_at_rest(model: ReducedModel) -> Tensor:
    """(latent,) of the mesh that is not deformed."""
    return model.encode(torch.zeros_like(model.position)[None])[0][0]


@torch.no_grad()
def latents(network: nn.Module, of: Callable[[Tensor], Tensor], count: int) -> Tensor:
    """(sample, latent) means of all samples, which ``of`` gives by row numbers."""
    device = next(network.parameters()).device
    batches = torch.arange(count, device=device).split(BATCH)
    return torch.cat([network.encode(of(rows))[0] for rows in batches])


@torch.no_grad()
def mean_and_deviation(meshes: MeshSamples, rows: Tensor) -> tuple[Tensor, Tensor]:
    """(vertex, 3) mean and standard deviation of the displacement over samples, m."""
    batches = rows.split(BATCH)
    mean = sum(meshes.displacement(batch).double().sum(0) for batch in batches) / len(rows)
    square = sum(((meshes.displacement(batch) - mean) ** 2).sum(0) for batch in batches) / len(rows)
    return mean.float(), square.sqrt().float()


RECIPES: dict[str, Callable[[Inputs], Recipe]] = {
    "svb": signal_vae,
    "mvb": lambda inputs: mesh_vae(inputs, inputs.source),
    "mvd": lambda inputs: mesh_vae(inputs, inputs.target),
    "s2mpn": signal_projection,
    "m2mpn": mesh_projection,
    "rmb": lambda inputs: reduced_model(inputs, inputs.source),
    "rmd": lambda inputs: reduced_model(inputs, inputs.target),
    "s2rm": signal_translation,
    "rm2rm": mesh_translation,
}
