"""The base class of networks: how `simgen train` makes one, and how it is read back from disk."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, ClassVar, Self

from torch import Tensor, nn

from simgen.learning.data.registry import NETWORKS, NetworkSpec
from simgen.learning.networks.network_data import NetworkData

Terms = Callable[[Tensor], dict[str, Tensor]]  # row numbers (n,) -> means over these samples; the first is minimised


class Network(nn.Module):
    """A network that `simgen train` can train. Called with inputs (n, ...) it gives outputs (n, ...).

    Inputs and outputs are signals (n, channel), displacements (n, vertex, 3) in m, or latents (n, latent). A network
    whose latents another one uses also has ``encode`` (to means and log-variances of the latents) and ``decode``. One
    that decodes meshes has ``vertices``, their number. One that gives several answers has ``draws`` and ``reach``, as
    `simgen.learning.networks.point_translator.PointTranslator`.

    kind : names the class in ``network.json``
    tf32 : True if a GPU may multiply matrices in TF32: 1 um of rounding in 2 mm
    """

    kind: ClassVar[str]
    tf32: ClassVar[bool] = False

    @classmethod
    def for_training(cls, data: NetworkData) -> tuple[Self, Terms]:
        """Make an untrained network and its loss. Random weights come from torch's own generator, seeded before."""
        raise NotImplementedError

    def finish(self, data: NetworkData) -> None:
        """Set what validation samples decide, after training."""

    def settings(self) -> dict[str, Any]:
        """JSON values from which `empty` makes a network of the same shapes."""
        raise NotImplementedError

    @classmethod
    def empty(cls, settings: Mapping[str, Any]) -> Self:
        """Make a network of these `settings`, whose state is loaded next."""
        return cls(**settings)

    def count_parameters(self) -> int:
        """Count the numbers that are learned: no normalisation, nothing that the mesh alone decides."""
        return sum(parameter.numel() for parameter in self.parameters())


def network_class(spec: NetworkSpec) -> type[Network]:
    """Import the class of a network."""
    module, _, name = spec.network.rpartition(".")
    return getattr(import_module(module), name)


def network_kinds() -> dict[str, type[Network]]:
    """Classes of all networks, by ``kind``."""
    return {kind.kind: kind for kind in map(network_class, NETWORKS.values())}
