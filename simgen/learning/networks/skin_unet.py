"""A U-Net on images of a sensor's unrolled skin (Ronneberger, Fischer and Brox, MICCAI 2015)."""

from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

GROUPS = 8  # of channels that a norm takes together (Wu and He, ECCV 2018)
MODULATED = 0.3  # slows the learning of a modulation, so that draws begin close to each other


class SkinUNet(nn.Module):
    """Images (n, inputs, row, column), and noise, to features (n * draw, outputs, row, column).

    Noise (n, draw, noise) makes several answers of one image: it modulates the features on the way up. The way down is
    the same for all draws of an image, and is computed once.

    width : channels of the finest level; each coarser level has twice as many
    levels : number of coarser levels, each with half the rows and columns
    blocks : residual blocks of a level, on the way down and on the way up
    noise : numbers of a draw
    """

    def __init__(self, inputs: int, outputs: int, width: int, levels: int, blocks: int, noise: int):
        super().__init__()
        widths = [width << level for level in range(levels + 1)]
        self.first = nn.Conv2d(inputs, width, 3, padding=1)
        self.down = nn.ModuleList(_blocks(here, here, blocks) for here in widths)
        self.shrink = nn.ModuleList(nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in pairwise(widths))
        self.coarsest = Modulation(widths[-1], noise)
        self.grow = nn.ModuleList(nn.ConvTranspose2d(coarse, fine, 2, stride=2) for fine, coarse in pairwise(widths))
        self.modulation = nn.ModuleList(Modulation(2 * here, noise) for here in widths[:-1])
        self.up = nn.ModuleList(_blocks(2 * here, here, blocks) for here in widths[:-1])
        self.last = nn.Conv2d(width, outputs, 1)

    def forward(self, image: Tensor, noise: Tensor) -> Tensor:
        draws = noise.shape[1]
        x = self.down[0](self.first(image))
        passed = []
        for shrink, down in zip(self.shrink, self.down[1:], strict=True):
            passed.append(x)
            x = down(shrink(x))
        x = self.coarsest(x.repeat_interleave(draws, 0), noise)
        for grow, modulation, up in zip(*map(reversed, (self.grow, self.modulation, self.up)), strict=True):
            x = torch.cat([grow(x), passed.pop().repeat_interleave(draws, 0)], dim=1)
            x = up(modulation(x, noise))
        return self.last(x)


class Modulation(nn.Module):
    """Features (n * draw, channel, row, column) times 1 + a, plus b: a and b are linear in noise (n, draw, noise).

    The same a and b hold for a whole image (FiLM: Perez et al., AAAI 2018).
    """

    def __init__(self, channels: int, noise: int):
        super().__init__()
        self.by = nn.Linear(noise, 2 * channels)

    def forward(self, x: Tensor, noise: Tensor) -> Tensor:
        scale, shift = (MODULATED * self.by(noise).flatten(0, 1).to(x.dtype))[:, :, None, None].chunk(2, dim=1)
        return x * (1.0 + scale) + shift


def _blocks(inputs: int, outputs: int, count: int) -> nn.Sequential:
    return nn.Sequential(*(ConvolutionBlock(outputs if number else inputs, outputs) for number in range(count)))


class ConvolutionBlock(nn.Module):
    """Residual block of two convolutions, whose second starts at zero (He et al., ECCV 2016)."""

    def __init__(self, inputs: int, outputs: int):
        super().__init__()
        self.norms = nn.ModuleList(nn.GroupNorm(GROUPS, width) for width in (inputs, outputs))
        self.first = nn.Conv2d(inputs, outputs, 3, padding=1)
        self.second = nn.Conv2d(outputs, outputs, 3, padding=1)
        self.past = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)
        nn.init.zeros_(self.second.weight)
        nn.init.zeros_(self.second.bias)

    def forward(self, x: Tensor) -> Tensor:
        y = self.first(F.silu(_normalised(self.norms[0], x)))
        return self.past(x) + self.second(F.silu(_normalised(self.norms[1], y)))


def _normalised(norm: nn.GroupNorm, x: Tensor) -> Tensor:
    """Normalise in the type of x: autocast would take float32, which costs twice the memory."""
    with torch.autocast(x.device.type, enabled=False):
        return F.group_norm(x, norm.num_groups, norm.weight.to(x.dtype), norm.bias.to(x.dtype), norm.eps)
