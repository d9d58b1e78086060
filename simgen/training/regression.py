"""From signals, or the latents of one mesh, to the latents of another: ours, beside the paper's projections."""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn

SMALLEST = 1e-6  # of a latent error: keeps its root differentiable at none


class Regression(nn.Module):
    """A residual perceptron: standardised inputs, blocks of normalisation, GELU and a linear layer, a linear output.

    Targets are latents of a `simgen.training.reduced_model.ReducedModel`. Those are coefficients of orthonormal modes
    in one common unit, so that the length of an error of latents is the root mean square error of the mesh that they
    decode to, and that is what is minimised: nothing is lost between the loss and the table.
    """

    kind: ClassVar[str] = "regression"

    def __init__(self, inputs: int, outputs: int, width: int, blocks: int, dropout: float):
        super().__init__()
        self.shape = {"inputs": inputs, "outputs": outputs, "width": width, "blocks": blocks, "dropout": dropout}
        self.register_buffer("center", torch.zeros(inputs))
        self.register_buffer("spread", torch.ones(inputs))
        self.first = nn.Linear(inputs, width)
        self.blocks = nn.ModuleList(
            nn.Sequential(nn.LayerNorm(width), nn.GELU(), nn.Linear(width, width), nn.GELU(), nn.Dropout(dropout),
                          nn.Linear(width, width))
            for _ in range(blocks)
        )  # fmt: skip
        self.last = nn.Sequential(nn.LayerNorm(width), nn.GELU(), nn.Linear(width, outputs))

    @classmethod
    def of_samples(cls, inputs: Tensor, outputs: int, width: int, blocks: int, dropout: float) -> Self:
        """A new network for inputs such as those of training, (sample, inputs)."""
        network = cls(inputs.shape[1], outputs, width, blocks, dropout)
        network.center.copy_(inputs.double().mean(0))
        spread = inputs.double().std(0)
        network.spread.copy_(torch.where(spread > 0.0, spread, 1.0))
        return network

    def forward(self, inputs: Tensor) -> Tensor:
        """(n, outputs) of (n, inputs)."""
        x = self.first((inputs - self.center) / self.spread)
        for block in self.blocks:
            x = x + block(x)
        return self.last(x)

    def terms(self, inputs: Tensor, latent: Tensor) -> dict[str, Tensor]:
        """What is minimised: as in the table, the mean over samples of the length of the error, not of its square."""
        square = (self(inputs) - latent).square().sum(dim=1)
        return {"loss": (square + SMALLEST**2).sqrt().mean(), "mse": square.mean()}

    def settings(self) -> dict[str, Any]:
        """What `empty` needs."""
        return dict(self.shape)

    @classmethod
    def empty(cls, settings: Mapping[str, Any]) -> Self:
        """A network of these `settings`, whose state is to be loaded."""
        return cls(**settings)
