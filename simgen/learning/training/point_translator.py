"""PT, ours: from one sensor's deformed skin to displacements of any points of another sensor.

Paired contacts lie at the same place, x and arc, of both unrolled skins, with the same normal. There the translation is
one of images: a U-Net takes the source's skin to features, and a small perceptron takes the features at a point's place,
and the point's depth, to its displacement (local implicit functions: Chen, Liu and Wang, CVPR 2021). The same weights
serve all places, so that a new place is like a known one.
"""

from typing import Any, ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from simgen.learning.training.network import Network
from simgen.learning.training.skin_grid import PixelGrid, Places, SkinOnGrid
from simgen.learning.training.skin_unet import SkinUNet

MM = 1e-3
STATIC = 14  # channels of the skins alone: of each sensor mask, normal and position
MOVING = 4  # channels of a sample: displacement over its size, and the logarithm of the size
WAVES = 4  # sines and cosines of a point's depth, and of its place within a pixel
POINT = 3 + 2 * WAVES + 4  # numbers of a point beside its features
LONGEST_M = 8e-3  # wavelength of the first wave of depth
LEAST_SIZE = 1e-2  # least size, relative to its root mean square over training
ROUNDING = 1e-7  # m: keeps the slope of the root finite


class PointTranslator(Network):
    """Displacements (n, source vertex, 3) to displacements (n, target vertex, 3), m.

        u = s f(x / s, log s),   s^2 = |x|^2 + 0.01^2

    with displacements x of the skin; the norm is a root mean square over its pixels, 1 over all training.
    """

    kind: ClassVar[str] = "point_translator"

    def __init__(
        self, rows: int, columns: int, vertices: int, width: int, levels: int, blocks: int, features: int, hidden: int
    ):
        super().__init__()
        self.shape = rows, columns
        self.network = SkinUNet(MOVING + STATIC, features, width, levels, blocks)
        self.head = nn.Sequential(
            nn.Linear(features + POINT, hidden), nn.SiLU(), nn.Linear(hidden, hidden), nn.SiLU(), nn.Linear(hidden, 4)
        )
        pixels = rows * columns
        self.register_buffer("corners", torch.zeros(pixels, 3, dtype=torch.int64))
        self.register_buffer("weights", torch.zeros(pixels, 3))
        self.register_buffer("source_frames", torch.zeros(pixels, 3, 3))
        self.register_buffer("static", torch.zeros(STATIC, rows, columns))
        self.register_buffer("place", torch.zeros(vertices, 2))  # column and row, -1 to 1
        self.register_buffer("offset", torch.zeros(vertices, 3))  # m
        self.register_buffer("frames", torch.zeros(vertices, 3, 3))
        self.register_buffer("source_size", torch.ones(()))  # m, root mean square of the skin's displacement
        self.register_buffer("target_size", torch.ones(()))  # m, root mean square of displacements to predict
        self.amp = False  # features in bfloat16
        self.relative = True
        self.noise = 0.0

    @classmethod
    def of_skins(cls, grid: PixelGrid, source: SkinOnGrid, target: SkinOnGrid, points: np.ndarray, **shape: int):
        """Make an untrained network for points (v, 3) m of the target."""
        network = cls(*grid.shape, len(points), **shape)
        network.corners.copy_(torch.from_numpy(source.corners.reshape(-1, 3)))
        network.weights.copy_(torch.from_numpy(source.weights.reshape(-1, 3)))
        network.source_frames.copy_(torch.from_numpy(source.frames.reshape(-1, 3, 3)))
        network.static.copy_(torch.from_numpy(np.concatenate([_static(source), _static(target)])))
        place, offset, frames = network.query(grid, target.places(points))
        network.place.copy_(place)
        network.offset.copy_(offset)
        network.frames.copy_(frames)
        return network

    @staticmethod
    def query(grid: PixelGrid, places: Places) -> tuple[Tensor, Tensor, Tensor]:
        """Tensors of points by their places."""
        found = grid.relative(places.x, places.arc), places.offset, places.frames
        return tuple(torch.from_numpy(np.ascontiguousarray(each)).float() for each in found)

    def settings(self) -> dict[str, Any]:
        raise NotImplementedError

    def skin(self, displacement: Tensor) -> Tensor:
        """Displacement (n, pixel, 3) of the source's skin in its own frames, m."""
        at = (displacement[:, self.corners] * self.weights[..., None]).sum(dim=2)
        return torch.einsum("pij,npj->npi", self.source_frames, at)

    def forward(self, displacement: Tensor, mirrored: Tensor | None = None) -> Tensor:
        """Displacements (n, vertex, 3), m, of the target's mesh.

        mirrored : (n,) bool, True for samples that pass the network as their mirror image
        """
        return self.at(displacement, self.place, self.offset, self.frames, mirrored)[0]

    def both_ways(self, displacement: Tensor) -> Tensor:
        """Mean of the displacements found directly and by the mirror image."""
        mirror = torch.ones(len(displacement), dtype=torch.bool, device=displacement.device)
        return 0.5 * (self(displacement) + self(displacement, mirror))

    def at(
        self, displacement: Tensor, place: Tensor, offset: Tensor, frames: Tensor, mirrored: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Displacements (n, point, 3), m, and logits of contact (n, point), of points of the target."""
        skin = self.skin(displacement)
        known = (self.weights.sum(dim=1) > 0.5).float()
        square = skin.square().sum(dim=2) @ known / (3.0 * known.sum())
        size = (square / self.source_size**2 + LEAST_SIZE**2).sqrt()
        scaled = skin / (self.source_size * (size if self.relative else torch.ones_like(size))[:, None, None])
        image = scaled.transpose(1, 2).unflatten(2, self.shape)
        if self.training and self.noise:
            image = image + self.noise * _smooth_noise(image) * known.view(self.shape)
        sign = torch.ones_like(size)
        if mirrored is not None:
            flip = torch.tensor([1.0, 1.0, -1.0], device=image.device)[:, None, None]
            image = torch.where(mirrored[:, None, None, None], image.flip(3) * flip, image)
            sign = torch.where(mirrored, -1.0, 1.0)
        image = torch.cat(
            [image, size.log()[:, None, None, None].expand(-1, 1, *self.shape), self.static.expand(len(size), -1, -1, -1)],
            dim=1,
        )
        with torch.autocast(image.device.type, torch.bfloat16, enabled=self.amp):
            features = self.network(image)
        found = self._decode(features.float(), place, offset, sign)
        local = found[..., :3] * (size if self.relative else torch.ones_like(size))[:, None, None] * self.target_size
        local = torch.cat([local[..., :2], local[..., 2:] * sign[:, None, None]], dim=2)
        return torch.einsum("vij,nvi->nvj", frames, local), found[..., 3]

    def _decode(self, features: Tensor, place: Tensor, offset: Tensor, sign: Tensor) -> Tensor:
        """Outputs (n, point, 4) of features (n, feature, row, column)."""
        turned = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], dim=1)[:, None]
        place = place * torch.stack([sign, torch.ones_like(sign)], dim=1)[:, None]  # (n, point, 2)
        offset = offset * turned
        near = F.grid_sample(features, place[:, None], align_corners=True, padding_mode="border")[:, :, 0]
        pixel = place * place.new_tensor([0.5 * (self.shape[1] - 1), 0.5 * (self.shape[0] - 1)])
        angle = offset[..., :1] * (2.0 * torch.pi / LONGEST_M * 2.0 ** torch.arange(WAVES, device=place.device))
        within = 2.0 * torch.pi * pixel
        about = [offset / MM, angle.sin(), angle.cos(), within.sin(), within.cos()]
        return self.head(torch.cat([near.transpose(1, 2), *about], dim=2))


def _smooth_noise(image: Tensor) -> Tensor:
    """Noise of unit deviation that varies over about four pixels."""
    rows, columns = image.shape[2:]
    coarse = torch.randn(*image.shape[:2], rows // 4, columns // 4, device=image.device)
    return 1.5 * F.interpolate(coarse, size=(rows, columns), mode="bilinear")


def _static(skin: SkinOnGrid) -> np.ndarray:
    """Channels (7, row, column) of a skin alone: mask, normal, and position in cm."""
    known = skin.known[..., None]
    found = np.concatenate([known, skin.normals, 100.0 * skin.points], axis=2)
    return np.moveaxis(np.where(known, found, 0.0), 2, 0)
