"""The table of the networks that `simgen train` can train, with inputs, outputs and class of each.

A network is one entry here. The entry names its class, a `simgen.learning.networks.network.Network`, which has a file
of its own and may serve several networks. This module does not import PyTorch, so that a job can be read without it.

Names: S, M and RM stand for signals, meshes and reduced models; V for a variational autoencoder; B and D for BioTac and
DIGIT; 2 for "to"; MPN for the paper's projection network; PT for point translator. See docs/training.md.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

# Inputs and outputs of networks: electrode signals, and meshes of the job's sensors `source` and `target`.
SIGNALS, SOURCE, TARGET = "signals", "source", "target"
TASKS = (
    (SIGNALS, SIGNALS), (SOURCE, SOURCE), (TARGET, TARGET), (SIGNALS, SOURCE), (SOURCE, TARGET), (SIGNALS, TARGET),
)  # fmt: skip


@dataclass(frozen=True)
class NetworkSpec:
    """One network.

    name : names the network in jobs, and its folder
    label : names the network in tables of errors
    settings : section of the training job with its settings
    inputs, outputs : its inputs and what it predicts, one of `TASKS`
    network : import path of its class
    encoder : network whose latents it takes in place of ``inputs``
    decoder : network whose latents it predicts in place of ``outputs``
    fed_by : network that stands before it in a chain; it also learns from this network's decoded predictions
    published : mean errors that the ACROSS paper reports for it, by measure of `simgen.learning.evaluation.metrics`
    """

    name: str
    label: str
    settings: str
    inputs: str
    outputs: str
    network: str
    encoder: str | None = None
    decoder: str | None = None
    fed_by: str | None = None
    published: Mapping[str, float] = field(default_factory=dict)

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of the networks whose latents it takes or predicts."""
        return tuple(name for name in (self.encoder, self.decoder) if name)

    @property
    def feeding(self) -> tuple[str, ...]:
        """Names of the networks that predict its inputs."""
        return (self.fed_by, *NETWORKS[self.fed_by].needs) if self.fed_by else ()


# A network stands after those that it needs.
NETWORKS: dict[str, NetworkSpec] = {
    spec.name: spec
    for spec in (
        # ACROSS (Zai El Amri et al., ICRA 2025)
        NetworkSpec("svb", "SVB", "signal_vae", SIGNALS, SIGNALS,
                    "simgen.learning.networks.signal_vae.SignalVAE", published={"rmse": 0.060}),
        NetworkSpec("mvb", "MVB", "mesh_vae", SOURCE, SOURCE,
                    "simgen.learning.networks.mesh_vae.MeshVAE",
                    published={"rmse_um": 12.28, "region_rmse_um": 16.03}),
        NetworkSpec("mvd", "MVD", "mesh_vae", TARGET, TARGET,
                    "simgen.learning.networks.mesh_vae.MeshVAE",
                    published={"rmse_um": 9.28, "region_rmse_um": 12.43}),
        NetworkSpec("s2mpn", "S2MPN", "signal_projection", SIGNALS, SOURCE,
                    "simgen.learning.networks.projection.Projection", encoder="svb", decoder="mvb",
                    published={"rmse_um": 78.21, "region_rmse_um": 94.07}),
        NetworkSpec("m2mpn", "M2MPN", "mesh_projection", SOURCE, TARGET,
                    "simgen.learning.networks.projection.Projection", encoder="mvb", decoder="mvd",
                    published={"rmse_um": 21.57, "region_rmse_um": 27.72}),
        # Ours
        NetworkSpec("rmb", "RMB (ours)", "reduced_model", SOURCE, SOURCE,
                    "simgen.learning.networks.reduced_model.ReducedModel"),
        NetworkSpec("rmd", "RMD (ours)", "reduced_model", TARGET, TARGET,
                    "simgen.learning.networks.reduced_model.ReducedModel"),
        NetworkSpec("s2rm", "S2RM (ours)", "signal_translation", SIGNALS, SOURCE,
                    "simgen.learning.networks.latent_translation.LatentTranslation", decoder="rmb"),
        NetworkSpec("rm2rm", "RM2RM (ours)", "mesh_translation", SOURCE, TARGET,
                    "simgen.learning.networks.latent_translation.LatentTranslation", encoder="rmb", decoder="rmd"),
        NetworkSpec("pt", "PT (ours)", "point_translation", SOURCE, TARGET,
                    "simgen.learning.networks.point_translator.PointTranslator", fed_by="s2rm"),
    )
}  # fmt: skip

# Choices of `simgen translate --way`; the first is the default. Each names two networks: from signals to the source's
# latents, and from these to the target's latents, or from the source's mesh to the target's.
WAYS = {"points": ("s2rm", "pt"), "ours": ("s2rm", "rm2rm"), "paper": ("s2mpn", "m2mpn")}


def chains(inputs: str, outputs: str) -> Iterator[tuple[str, ...]]:
    """Names of networks that lead from inputs to outputs: each that does so alone, then each pair.

    The second network of a pair continues from the latents that the first one predicts. One that is fed by the first
    continues from the decoded mesh.
    """
    alone = [spec for spec in NETWORKS.values() if (spec.inputs, spec.outputs) == (inputs, outputs)]
    yield from ((spec.name,) for spec in alone)
    steps = [spec for spec in NETWORKS.values() if spec.inputs != spec.outputs]
    for first in steps:
        for second in steps:
            joined = first.name == second.fed_by if second.fed_by else second.encoder == first.decoder
            if joined and (first.inputs, first.outputs, second.outputs) == (inputs, second.inputs, outputs):
                yield first.name, second.name


def label_of(names: tuple[str, ...]) -> str:
    """Label of a chain in tables of errors: "S2RM, RM2RM (ours)"."""
    return ", ".join(NETWORKS[name].label for name in names).replace(" (ours),", ",")
