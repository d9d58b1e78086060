"""Chains of trained networks: from signals, or the mesh of one sensor, to the mesh of the other."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from simgen.learning.training.network import Network
from simgen.learning.training.networks import NETWORKS

Step = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Chain:
    """Steps that values pass through, and the networks that they belong to, each listed once."""

    steps: tuple[Step, ...]
    networks: tuple[Network, ...]

    def __call__(self, values: Tensor) -> Tensor:
        for step in self.steps:
            values = step(values)
        return values

    @property
    def parameters(self) -> int:
        return sum(network.count_parameters() for network in self.networks)


def make_chain(names: tuple[str, ...], trained: Callable[[str], Network]) -> Chain:
    """Chain networks, from the inputs of the first (signals, or displacements in m) to the outputs of the last.

    trained : name -> network, on one device
    """
    specs = [NETWORKS[name] for name in names]
    networks = [trained(name) for name in names]
    steps: list[Step] = [*networks]
    if specs[0].encoder is not None:
        encoder = trained(specs[0].encoder)
        steps.insert(0, lambda values: encoder.encode(values)[0])
        networks.append(encoder)
    if specs[-1].decoder is not None:
        networks.append(trained(specs[-1].decoder))
        steps.append(networks[-1].decode)
    return Chain(tuple(steps), tuple(networks))
