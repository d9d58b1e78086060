"""Chains of trained networks: from signals, or the mesh of one sensor, to the mesh of the other."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor, nn

from simgen.learning.data.registry import NETWORKS

Step = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Chain:
    """Steps that values pass through, and the networks that they belong to, each listed once."""

    steps: tuple[Step, ...]
    networks: tuple[nn.Module, ...]

    def __call__(self, values: Tensor) -> Tensor:
        for step in self.steps:
            values = step(values)
        return values

    @property
    def several(self) -> bool:
        """True if the last network gives several answers."""
        return hasattr(self.steps[-1], "draws")

    def draws(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """Give the last network's several answers, see `PointTranslator.draws`."""
        for step in self.steps[:-1]:
            values = step(values)
        return self.steps[-1].draws(values)

    @property
    def parameters(self) -> int:
        return sum(network.count_parameters() for network in self.networks)


def make_chain(names: tuple[str, ...], trained: Callable[[str], nn.Module]) -> Chain:
    """Chain networks, from the inputs of the first (signals, or displacements in m) to the outputs of the last.

    trained : name -> network, on one device
    """
    specs = [NETWORKS[name] for name in names]
    networks = [trained(name) for name in names]
    steps: list[Step] = []
    if specs[0].encoder is not None:
        encoder = trained(specs[0].encoder)
        steps.append(lambda values: encoder.encode(values)[0])
        networks.append(encoder)
    for spec, network, after in zip(specs, tuple(networks), [*specs[1:], None], strict=False):
        steps.append(network)
        if spec.decoder is not None and (after is None or after.encoder is None):
            networks.append(trained(spec.decoder))
            steps.append(networks[-1].decode)
    return Chain(tuple(steps), tuple(networks))
