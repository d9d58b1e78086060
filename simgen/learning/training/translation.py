"""From electrode signals, or one sensor's latents, to the latents of a reduced model. Not of the paper: ours.

Latents of `training.reduced_model` have one unit, so their error is the error of the coarse mesh, and that is
what is minimised. As an input they keep that unit too: divided by deviations of their own, the many small ones, which
say least of where the contact is, would count as much as the large ones, and contacts that training has not seen come
out worse.

What lies at one place looks much the same at all depths, but for its size: were all linear, a press twice as deep would
be twice the field. So the network is given an input over how far it is from rest, and the logarithm of that; what comes
out is multiplied by it. A shallow press is then seen as sharply as a deep one, as in the reduced models.

Noise on inputs that another network predicts makes up for the errors that these will have (Bishop, Neural Computation
7, 1995, on what it does); on measured ones it only blurs.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

LEAST = 1e-5  # of a latent error: the root has a slope there, too
LEAST_SIZE = 1e-2  # of a sample over that of all, likewise: what is nearer to rest counts as so far


class Translation(nn.Module):
    """A perceptron with residual blocks: (n, inputs) to latents (n, outputs).

        y = y_0 + s f((x - x_0) / s, log s),   s^2 = |x - x_0|^2 + 0.01^2

    with inputs x_0 and latents y_0 at rest. The norm is a root mean square over inputs, in units of that of training.

    noise : standard deviation of what training adds to each input, over that sample's own s
    power : see `terms`
    """

    kind: ClassVar[str] = "translation"

    def __init__(self, inputs: int, outputs: int, width: int, blocks: int, noise: float, power: float):
        super().__init__()
        self.noise, self.power = noise, power
        self.register_buffer("source_rest", torch.zeros(inputs))
        self.register_buffer("source_size", torch.ones(()))  # root mean square of all inputs of training
        self.register_buffer("target_rest", torch.zeros(outputs))
        self.register_buffer("target_size", torch.ones(()))  # likewise of the norms of its latents
        self.first = nn.Linear(inputs + 1, width)
        self.blocks = nn.ModuleList(Block(width) for _ in range(blocks))
        self.last = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, outputs))

    @classmethod
    def of_samples(
        cls, source: Tensor, target: Tensor, source_rest: Tensor, target_rest: Tensor, **settings: Any
    ) -> Self:
        """A new network for the samples of training: source (sample, inputs), target (sample, outputs).

        source_rest, target_rest : (inputs,) and (outputs,), where nothing is deformed
        """
        network = cls(source.shape[1], target.shape[1], **settings).to(source.device)
        network.source_rest.copy_(source_rest)
        network.target_rest.copy_(target_rest)
        for size, found in (
            (network.source_size, (source - source_rest).square().mean().sqrt()),
            (network.target_size, (target - target_rest).square().sum(dim=1).mean().sqrt()),
        ):
            size.copy_(torch.where(found > 0.0, found, 1.0))
        return network

    def settings(self) -> dict[str, Any]:
        """What `empty` needs."""
        return {
            "inputs": len(self.source_rest),
            "outputs": len(self.target_rest),
            "width": self.first.out_features,
            "blocks": len(self.blocks),
            "noise": self.noise,
            "power": self.power,
        }

    @classmethod
    def empty(cls, settings: Mapping[str, Any]) -> Self:
        """A network of these `settings`, whose state is to be loaded."""
        return cls(**settings)

    def count_parameters(self) -> int:
        """Numbers that training changes."""
        return sum(parameter.numel() for parameter in self.parameters())

    def forward(self, source: Tensor) -> Tensor:
        """(n, outputs) of (n, inputs)."""
        x = (source - self.source_rest) / self.source_size
        size = (x.square().mean(dim=1, keepdim=True) + LEAST_SIZE**2).sqrt()
        x = x / size
        if self.training:
            x = x + self.noise * torch.randn_like(x)
        x = self.first(torch.cat([x, size.log()], dim=1))
        for block in self.blocks:
            x = block(x)
        return self.target_rest + size * self.last(x)

    def terms(self, source: Tensor, target: Tensor) -> dict[str, Tensor]:
        """What is minimised, and the error: Euclidean norms of samples' latent errors, means over samples.

        With latents of a reduced model an error is the root mean square error of the coarse mesh, over its amplitude.
        In the loss it is divided by a power of how far the sample is from rest: with 0 the loss is the error, in which
        shallow presses count for little, with 1 it is relative.
        """
        error = ((self(source) - target).square().sum(dim=1) + LEAST**2).sqrt()
        size = (target - self.target_rest).norm(dim=1) / self.target_size
        return {"loss": (error * size.clamp(min=LEAST_SIZE) ** -self.power).mean(), "error": error.mean()}


class Block(nn.Module):
    """x + W f(V norm(x)), which starts at x (He et al., 2016; normalised first, as in Xiong et al., 2020)."""

    def __init__(self, width: int):
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.up = nn.Linear(width, width)
        self.down = nn.Linear(width, width)
        nn.init.zeros_(self.down.weight)
        nn.init.zeros_(self.down.bias)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.down(F.gelu(self.up(self.norm(x))))
