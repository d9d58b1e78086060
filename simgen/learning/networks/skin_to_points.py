"""From images of the unrolled skin to values at points: a U-Net, and a perceptron behind it."""

from collections.abc import Callable
from functools import cached_property

import torch
from torch import Tensor, nn

from simgen.learning.networks.fused import fused, may_fuse
from simgen.learning.networks.skin_points import NUMBERS, SkinPoints
from simgen.learning.networks.skin_unet import SkinUNet


class SkinToPoints(nn.Module):
    """Images (n, inputs, row, column), and noise (n, draw, noise), to values (n * draw, point, outputs) at points.

    features : channels of the U-Net's output
    hidden : width of the perceptron
    width, levels, blocks, noise : see `SkinUNet`
    """

    def __init__(
        self, inputs: int, outputs: int, width: int, levels: int, blocks: int, features: int, hidden: int, noise: int
    ):
        super().__init__()
        self.network = SkinUNet(inputs, features, width, levels, blocks, noise)
        self.head = nn.Sequential(
            nn.Linear(features + NUMBERS, hidden), nn.SiLU(), nn.Linear(hidden, hidden), nn.SiLU(),
            nn.Linear(hidden, outputs),
        )  # fmt: skip

    def forward(self, image: Tensor, noise: Tensor, mirrored: Tensor, points: SkinPoints) -> Tensor:
        """Values at points; ``mirrored`` (n * draw,) is True for the mirror image of a sample."""
        unet, at_points = self._fused if self.training and may_fuse(image) else (self.network, self._at_points)
        # Rounding to 8 bits in training is like noise. Autocast keeps the weights themselves in float32.
        with torch.autocast(image.device.type, torch.bfloat16, enabled=self.training and image.is_cuda):
            features = unet(image, noise)
            features = torch.where(mirrored[:, None, None, None], features.flip(3), features)
            numbers = points.numbers[mirrored.long()].transpose(0, 1)
            return at_points(points.features(features), numbers).transpose(0, 1)

    def _at_points(self, features: Tensor, numbers: Tensor) -> Tensor:
        """Values (point, n, outputs) from features and numbers (point, n, ...)."""
        return self.head(torch.cat([features, numbers], dim=2)).float()

    @cached_property
    def _fused(self) -> tuple[Callable[..., Tensor], Callable[..., Tensor]]:
        return fused(self.network), fused(self._at_points)
