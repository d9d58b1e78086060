"""From electrode signals, or one sensor's latents, to the latents of a reduced model. Not of the paper: ours.

Latents of `simgen.training.reduced_model` have one unit, so their error is the error of the coarse mesh, and that is
what is minimised. As an input they keep that unit too: divided by deviations of their own, the many small ones, which
say least of where the contact is, would count as much as the large ones, and contacts that training has not seen come
out worse. Noise on inputs that another network predicts makes up for the errors that these will have (Bishop, Neural
Computation 7, 1995, on what it does); on measured ones it only blurs.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

WIDTH = 512
BLOCKS = 2
NOISE = 0.0
LEAST = 1e-5  # of a latent error: the root has a slope there, too
LEAST_FAR = 1e-2  # of how far from rest an input is, likewise


class Translation(nn.Module):
    """A perceptron with residual blocks: (n, inputs) to latents (n, outputs).

    noise : standard deviation of what training adds to each input, in units of their root mean square
    """

    kind: ClassVar[str] = "translation"

    def __init__(
        self, inputs: int, outputs: int, width: int = WIDTH, blocks: int = BLOCKS, noise: float = NOISE,
        power: float = 0.0, relative: bool = False,
    ):  # fmt: skip
        super().__init__()
        self.noise, self.power, self.relative = noise, power, relative
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("deviation", torch.ones(()))
        self.register_buffer("target_rest", torch.zeros(outputs))
        self.register_buffer("target_size", torch.ones(()))
        self.first = nn.Linear(inputs + relative, width)
        self.blocks = nn.ModuleList(Block(width) for _ in range(blocks))
        self.last = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, outputs))

    @classmethod
    def of_samples(
        cls, source: Tensor, target: Tensor, source_rest: Tensor | None = None, target_rest: Tensor | None = None,
        **settings: Any,
    ) -> Self:  # fmt: skip
        """A new network for inputs like ``source`` (sample, inputs), those of training."""
        network = cls(source.shape[1], target.shape[1], **settings).to(source.device)
        if target_rest is not None:
            network.target_rest.copy_(target_rest)
        away = (target - network.target_rest).norm(dim=1)
        network.target_size.copy_(away.square().mean().sqrt())
        if source_rest is None:
            source_rest = source[away <= away.quantile(0.01)].mean(dim=0)
        network.mean.copy_(source_rest if network.relative else source.mean(dim=0))
        deviation = (source - network.mean).square().mean().sqrt()
        network.deviation.copy_(torch.where(deviation > 0.0, deviation, 1.0))
        return network

    def settings(self) -> dict[str, Any]:
        """What `empty` needs."""
        return {
            "inputs": self.first.in_features - self.relative,
            "outputs": self.last[1].out_features,
            "width": self.first.out_features,
            "blocks": len(self.blocks),
            "noise": self.noise,
            "power": self.power,
            "relative": self.relative,
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
        x = (source - self.mean) / self.deviation
        if self.relative:
            far = (x.square().mean(dim=1, keepdim=True) + LEAST_FAR**2).sqrt()
            x = x / far
        if self.training:
            x = x + self.noise * torch.randn_like(x)
        x = self.first(torch.cat([x, far.log()], dim=1) if self.relative else x)
        for block in self.blocks:
            x = block(x)
        return self.target_rest + far * self.last(x) if self.relative else self.last(x)

    def terms(self, source: Tensor, target: Tensor) -> dict[str, Tensor]:
        """What is minimised: the Euclidean norm of a sample's latent error, its mean over samples.

        With latents of a reduced model that is the root mean square error of the coarse mesh, over its amplitude.
        """
        error = ((self(source) - target).square().sum(dim=1) + LEAST**2).sqrt()
        far = (target - self.target_rest).norm(dim=1) / self.target_size
        return {"loss": (error * far.clamp(min=LEAST_FAR) ** -self.power).mean(), "error": error.mean()}


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
