"""Trained networks one after the other: from signals or a mesh of one sensor to a mesh of the other."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor, nn

from simgen.learning.training.checkpoint import count_parameters

Step = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Chain:
    """What goes in passes through ``steps``; the networks that they belong to are counted once each."""

    steps: tuple[Step, ...]
    networks: tuple[nn.Module, ...]

    def __call__(self, values: Tensor) -> Tensor:
        for step in self.steps:
            values = step(values)
        return values

    @property
    def parameters(self) -> int:
        return sum(map(count_parameters, self.networks))


# Projection -> what encodes its input, if something does, and what decodes its output.
ENDS = {"s2mpn": ("svb", "mvb"), "m2mpn": ("mvb", "mvd"), "s2rm": (None, "rmb"), "rm2rm": ("rmb", "rmd")}


def make_chain(names: tuple[str, ...], trained: Callable[[str], nn.Module]) -> Chain:
    """Projections one after the other, from what the first is made for (signals, or displacements of the source, m) to
    displacements, m.

    trained : name -> network, on one device
    """
    encoder, decoder = ENDS[names[0]][0], ENDS[names[-1]][1]
    steps: list[Step] = []
    networks = [trained(name) for name in names]
    if encoder is not None:
        first = trained(encoder)
        steps.append(lambda values: first.encode(values)[0])
        networks.append(first)
    last = trained(decoder)
    return Chain((*steps, *networks[: len(names)], last.decode), (*networks, last))
