"""PT, ours: from one sensor's deformed skin to displacements of any points of another sensor.

Paired contacts lie at the same place, x and arc, of both unrolled skins, with the same normal. There the translation
is one of images. A U-Net takes the source's skin to features. A small perceptron takes the features at a point's
place, and the point's depth, to its displacement (a local implicit function: Chen, Liu and Wang, CVPR 2021). The same
weights serve all places, so that a new place is like a known one.

One skin of the source can belong to several contacts on the target. So the network also takes random numbers, and gives
another answer for each draw of them. Its loss is the energy score (Gneiting and Raftery, JASA 102, 2007, eq. 21), which
is least on average if the answers are distributed as the true meshes are. Learning it from two draws of each sample is
engression (Shen and Meinshausen, JRSS B 87, 2025).

Members learn from different samples of each batch, and all of them answer: a deep ensemble (Lakshminarayanan, Pritzel
and Blundell, NeurIPS 2017). Where training samples leave the answer open, members differ.
"""

from collections.abc import Callable
from typing import Any, ClassVar, Self

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from simgen.dataset.touchable import TouchableSurface
from simgen.learning.data.samples import BATCH, MeshSamples
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.evaluation.doubt import calibrated_reach
from simgen.learning.evaluation.pca import Values
from simgen.learning.networks.mirror import is_symmetric
from simgen.learning.networks.network import Network, Terms
from simgen.learning.networks.network_data import NetworkData
from simgen.learning.networks.skin_grid import PixelGrid, SkinOnGrid, reach_along_arc
from simgen.learning.networks.skin_points import SkinPoints
from simgen.learning.networks.skin_to_points import SkinToPoints
from simgen.units import MM

MOVING = 4  # channels of a sample: displacement over its size, and the logarithm of the size
STILL = 14  # channels of the skins alone: mask, normal and position of each
MARGIN_M = 4e-3  # the grid shows as much of the source's skin beyond the target's
LEAST_SIZE = 1e-2  # least size of a press, relative to its root mean square over training
ROUNDING = 1e-7  # m: keeps the slope of the root finite
NOISE = 8  # random numbers of a draw
DRAWS = 2 * NOISE  # answers of a member for a sample, half of them by its mirror image
SAMPLES_AT_ONCE = 16  # of a prediction: all draws of a member for these take 1 GB
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # multiples of it, without their whole parts, are spread evenly
# Weights in the loss: displacements of the touchable surface, contact of its points, cross entropy of the contact.
SURFACE, CONTACT, ENTROPY = 0.2, 0.1, 0.05
LEAST_CONTACT = 1e-3  # least root mean square difference of contacts: keeps the slope of the root finite


class PointTranslator(Network):
    """Displacements (n, source vertex, 3), m, to displacements (n, target vertex, 3), m.

        u = s f(x / s, log s, z),   s^2 = |x|^2 + 0.01^2

    with displacements x of the source's skin and random numbers z. The norm is a root mean square over the skin, 1 over
    all training.

    If both sensors are mirror images of themselves in z = 0, training shows each sample as it is, or its mirror image,
    and half of the draws are those of the mirror image. A mirror image of the unrolled skin is a flip of its columns.

    rows, columns : pixels of the unrolled skin
    vertices, triangles : numbers of the target's
    width, levels, blocks : see `SkinUNet`
    features, hidden : channels of the U-Net's output, and width of the perceptron
    power : see `terms`
    mirrored : True if both sensors are symmetric
    members : networks that answer; each learns from its share of every batch
    """

    kind: ClassVar[str] = "point_translator"
    tf32: ClassVar[bool] = True

    def __init__(
        self, rows: int, columns: int, vertices: int, triangles: int, width: int, levels: int, blocks: int,
        features: int, hidden: int, power: float, mirrored: bool, members: int = 1,
    ):  # fmt: skip
        super().__init__()
        self._settings = {name: value for name, value in locals().items() if name not in ("self", "__class__")}
        self.shape, self.power, self.mirrored = (rows, columns), power, mirrored
        self.members = nn.ModuleList(
            SkinToPoints(MOVING + STILL, 4, width, levels, blocks, features, hidden, NOISE) for _ in range(members)
        )
        self.register_load_state_dict_pre_hook(_with_members)
        pixels = rows * columns
        self.register_buffer("x", torch.zeros(rows, dtype=torch.float64))  # m, middles of the pixels
        self.register_buffer("arc", torch.zeros(columns, dtype=torch.float64))
        self.register_buffer("corners", torch.zeros(pixels, 3, dtype=torch.int64))  # of the source's mesh
        self.register_buffer("weights", torch.zeros(pixels, 3))
        self.register_buffer("source_frames", torch.zeros(pixels, 3, 3))
        self.register_buffer("still", torch.zeros(STILL, rows, columns))
        self.register_buffer("target_rest", torch.zeros(vertices, 3, dtype=torch.float64))  # m
        self.register_buffer("target_triangles", torch.zeros(triangles, 3, dtype=torch.int64))
        self.points = SkinPoints(vertices, pixels)
        self.register_buffer("share", torch.zeros(vertices))  # of the touchable area
        self.register_buffer("noise", _even_noise())  # the draws of predictions
        # Of sets of contacts, from true source meshes and from predicted ones: see simgen/learning/evaluation/doubt.py.
        self.register_buffer("reach", torch.full((2,), torch.nan, dtype=torch.float64))
        self.register_buffer("source_size", torch.ones(()))  # m, root mean square of the skin's displacements
        self.register_buffer("target_size", torch.ones(()))  # m, root mean square of the target's displacements

    @classmethod
    def for_training(cls, data: NetworkData) -> tuple[Self, Terms]:
        settings, source, target = data.settings, data.sources, data.meshes
        network = cls.of_meshes(
            source, target, data.touchable(source), data.touchable(target), settings.pixel_mm * MM,
            width=settings.width, levels=settings.levels, blocks=settings.blocks, features=settings.features,
            hidden=settings.hidden, power=settings.power, members=settings.members,
        )  # fmt: skip
        network.share.copy_(torch.from_numpy(data.touchable_share(target)))
        network.set_sizes(source, target, data.train)
        touching, predicted = data.touching(), data.predicted_inputs

        def terms(rows: Tensor) -> dict[str, Tensor]:
            inputs = data.inputs(rows)
            if predicted is not None:
                inputs = network.mixed(inputs, predicted(rows), settings.predicted)
            return network.terms(inputs, data.outputs(rows), None if touching is None else touching[rows])

        return network, terms

    @classmethod
    def of_meshes(
        cls, source: MeshSamples, target: MeshSamples, source_touchable: np.ndarray, target_touchable: np.ndarray,
        pixel: float, **settings: Any,
    ) -> Self:  # fmt: skip
        """Make an untrained network. ``pixel``: m; ``touchable`` (vertex,) bool: what the skin consists of."""
        rest = [meshes.rest.double().cpu().numpy() for meshes in (source, target)]
        triangles, touchable = (
            (source.surface_triangles, target.surface_triangles),
            (source_touchable, target_touchable),
        )
        ends = np.concatenate([each[mask, 0] for each, mask in zip(rest, touchable, strict=True)])
        reach = reach_along_arc(rest[1], triangles[1], target_touchable, pixel) + MARGIN_M
        grid = PixelGrid.over(ends.min(), ends.max(), reach, pixel, 1 << settings["levels"])
        skins = [SkinOnGrid(*each, grid) for each in zip(rest, triangles, touchable, strict=True)]
        mirrored = all(is_symmetric(*each) for each in zip(rest, (source.tetrahedra, target.tetrahedra), strict=True))
        network = cls(*grid.shape, len(rest[1]), len(triangles[1]), mirrored=mirrored, **settings)
        for buffer, values in (
            (network.x, grid.x),
            (network.arc, grid.arc),
            (network.corners, skins[0].corners.reshape(-1, 3)),
            (network.weights, skins[0].weights.reshape(-1, 3)),
            (network.source_frames, skins[0].frames.reshape(-1, 3, 3)),
            (network.still, np.concatenate([_still(skin) for skin in skins])),
            (network.target_rest, rest[1]),
            (network.target_triangles, triangles[1]),
        ):
            buffer.copy_(torch.from_numpy(np.ascontiguousarray(values)))
        network.points = network.places(rest[1])
        return network.to(target.rest.device)

    @torch.no_grad()
    def set_sizes(self, source: MeshSamples, target: MeshSamples, rows: Tensor) -> None:
        """Set both root mean squares over training rows."""
        found = torch.zeros(2, dtype=torch.float64, device=self.share.device)
        for some in rows.split(BATCH):
            skin, u = self.skin(source.displacement(some)), target.displacement(some)
            found += torch.stack([self._mean_square(skin).double().sum(), u.double().square().mean(dim=(1, 2)).sum()])
        found = (found / len(rows)).sqrt().clamp_min(ROUNDING)
        self.source_size.copy_(found[0])
        self.target_size.copy_(found[1])

    def finish(self, data: NetworkData) -> None:
        """Set each `reach`. It stays NaN without a touchable surface, and the second one without predicted inputs."""
        if data.gauge is None:
            return

        def reach(inputs: Values) -> float:
            return calibrated_reach(lambda rows: self.draws(inputs(rows)), data.meshes, data.validation, data.gauge)

        self.reach[0] = reach(data.inputs)
        if data.predicted_inputs is not None:
            self.reach[1] = reach(data.predicted_inputs)

    @property
    def vertices(self) -> int:
        return len(self.points)

    @property
    def draw_count(self) -> int:
        """Number of answers for a sample."""
        return DRAWS * len(self.members)

    def settings(self) -> dict[str, Any]:
        return dict(self._settings)

    def forward(self, displacement: Tensor) -> Tensor:
        """Displacements (n, vertex, 3), m, of the target's mesh: the mean over `draws`."""
        return torch.cat([self.draws(some)[0].mean(dim=1) for some in displacement.split(SAMPLES_AT_ONCE)])

    def draws(self, displacement: Tensor, points: SkinPoints | None = None) -> tuple[Tensor, Tensor]:
        """Equally likely answers: displacements (n, draw, point, 3), m, and logits of contact (n, draw, point).

        points : any points of the target, see `places`; None for its vertices
        """
        noise, same = self.noise.expand(len(displacement), -1, -1), displacement.new_ones(())
        parts = [(noise, same)]
        if self.mirrored:
            parts = list(zip(noise.chunk(2, dim=1), (same, -same), strict=True))
        found = [self._drawn(member, displacement, *part, points) for member in self.members for part in parts]
        return tuple(torch.cat(each, dim=1) for each in zip(*found, strict=True))

    def places(self, points: np.ndarray) -> SkinPoints:
        """Find where the target's points (v, 3), m at rest, are: what `draws` takes."""
        grid = PixelGrid(self.x.cpu().numpy(), self.arc.cpu().numpy())
        rest, triangles = self.target_rest.cpu().numpy(), self.target_triangles.cpu().numpy()
        skin = SkinOnGrid(rest, triangles, np.ones(len(rest), bool), grid)
        return SkinPoints.of_places(grid, skin.places(np.asarray(points, np.float64))).to(self.share.device)

    def mixed(self, true: Tensor, predicted: Tensor, share: float) -> Tensor:
        """Replace a share of the true source meshes (n, vertex, 3): by chance in training, else evenly."""
        n, device = len(true), true.device
        chance = torch.rand(n, device=device) if self.training else GOLDEN * torch.arange(n, device=device) % 1.0
        return torch.where((chance < share)[:, None, None], predicted, true)

    def gauge(self) -> ContactGauge:
        """Make the gauge of contacts on the target; its areas are shares of the touchable area."""
        share = self.share.double().cpu().numpy()
        points = np.flatnonzero(share)
        rest, triangles = self.target_rest.cpu().numpy(), self.target_triangles.cpu().numpy()
        return ContactGauge(TouchableSurface(rest, triangles, points, share[points]), self.share.device)

    def terms(self, source: Tensor, target: Tensor, touching: Tensor | None = None) -> dict[str, Tensor]:
        """Loss and root mean square error of single draws, m; both are means over samples.

        Each member answers for its share of the samples. The loss adds energy scores of the displacements of all
        vertices, of those of the touchable surface, and of the contact, and the cross entropy of the contact. It
        divides the first two by the sample's own root mean square to the ``power``: 0 gives the reported unit, 1
        relative errors.

        touching : (n, vertex) bool; None if it is unknown
        """
        n, sign, device = len(source), source.new_ones(len(source)), source.device
        if self.training:
            if self.mirrored:
                sign = 1.0 - 2.0 * (torch.rand(n, device=device) < 0.5)
            noise = torch.randn(n, 2, NOISE, device=device)
        else:
            noise = _noise_of_validation(n).to(device)
        shares = zip(self.members, torch.arange(n, device=device).tensor_split(len(self.members)), strict=True)
        found = [self._drawn(own, source[i], noise[i], sign[i]) for own, i in shares if len(i)]
        found, logits = map(torch.cat, zip(*found, strict=True))
        size = target.square().mean(dim=(1, 2)).sqrt() / self.target_size
        unit = size.clamp_min(LEAST_SIZE) ** -self.power / self.target_size
        score, error = _energy(found, target, lambda x: (x.square().mean(dim=(-1, -2)) + ROUNDING**2).sqrt())
        surface, _ = _energy(found, target, lambda x: (x.square().mean(dim=-1) @ self.share + ROUNDING**2).sqrt())
        loss = (unit * (score + SURFACE * surface)).mean()
        if touching is not None:
            true = touching.to(logits.dtype)
            contact, _ = _energy(logits.sigmoid(), true, lambda x: (x.square() @ self.share + LEAST_CONTACT**2).sqrt())
            entropy = F.binary_cross_entropy_with_logits(logits, true[:, None].expand_as(logits), reduction="none")
            loss = loss + CONTACT * contact.mean() + ENTROPY * (entropy @ self.share).mean()
        return {"loss": loss, "rmse_m": error.mean()}

    def skin(self, displacement: Tensor) -> Tensor:
        """Displacements (n, pixel, 3) of the source's skin in its frames, m; 0 off the skin."""
        at = (displacement[:, self.corners] * self.weights[..., None]).sum(dim=2)
        return torch.einsum("pij,npj->npi", self.source_frames, at)

    def _mean_square(self, skin: Tensor) -> Tensor:
        """Mean square (n,) over coordinates of the skin, m2."""
        known = self.weights.sum(dim=1) > 0.5
        return skin.square().sum(dim=(1, 2)) / (3 * known.sum())

    def _drawn(
        self, member: SkinToPoints, displacement: Tensor, noise: Tensor, sign: Tensor, points: SkinPoints | None = None
    ) -> tuple[Tensor, Tensor]:
        """Answers of a member for noise (n, draw, noise), as `draws` gives them.

        sign : (n,), or one for all: 1 for the sample itself, -1 for its mirror image
        """
        points, draws = self.points if points is None else points, noise.shape[1]
        sign = sign.expand(len(displacement))[:, None, None]  # (n, 1, 1)
        mirrored = sign < 0.0
        skin = self.skin(displacement)
        size = (self._mean_square(skin) / self.source_size**2 + LEAST_SIZE**2).sqrt()[:, None, None]
        turned = torch.cat([torch.ones_like(sign), torch.ones_like(sign), sign], dim=2)  # of vectors in a frame
        image = (skin / (size * self.source_size)).transpose(1, 2).unflatten(2, self.shape)
        image = torch.where(mirrored[..., None], image.flip(3), image) * turned.transpose(1, 2)[..., None]
        same = size.log()[..., None].expand(-1, 1, *self.shape), self.still.expand(len(size), -1, -1, -1)
        mirrored, turned, size = (each.repeat_interleave(draws, 0) for each in (mirrored, turned, size))
        found = member(torch.cat([image, *same], dim=1), noise, mirrored.flatten(), points)
        local = found[..., :3] * turned * size * self.target_size
        moved = torch.einsum("vij,nvi->nvj", points.frames, local)
        return tuple(each.unflatten(0, (-1, draws)) for each in (moved, found[..., 3]))


def _with_members(network: nn.Module, state: dict[str, Tensor], prefix: str, *_: Any) -> None:
    """Rename the weights of networks that were made before there were members (cb0a1a2 and earlier)."""
    for name in list(state):
        if name.startswith((f"{prefix}network.", f"{prefix}head.")):
            state[f"{prefix}members.0.{name.removeprefix(prefix)}"] = state.pop(name)


def _even_noise() -> Tensor:
    """Noise (draw, NOISE) of predictions, which stands for a normal distribution: both signs along each axis.

    The cubature rule of third degree (Arasaratnam and Haykin, IEEE Transactions on Automatic Control 54, 2009): means
    of polynomials up to the third degree are exact, while means over random draws scatter. Half of the draws may be for
    mirror images, so each half has both signs of its axes.
    """
    return torch.cat([torch.cat([axes, -axes]) for axes in (NOISE**0.5 * torch.eye(NOISE)).chunk(2)])


def _noise_of_validation(n: int) -> Tensor:
    """Random noise (n, 2, NOISE) for a batch of n samples, the same in all batches and epochs, on all devices.

    The energy score of one pair for all samples is not proper: it is small if just these two draws lie far apart.
    """
    return torch.randn(n, 2, NOISE, generator=torch.Generator().manual_seed(0))


def _energy(found: Tensor, truth: Tensor, norm: Callable[[Tensor], Tensor]) -> tuple[Tensor, Tensor]:
    """Energy scores (n,) of two draws (n, 2, ...) of truth (n, ...), and mean errors (n,) of single draws."""
    error = norm(found - truth[:, None]).mean(dim=1)
    return error - 0.5 * norm(found[:, 0] - found[:, 1]), error


def _still(skin: SkinOnGrid) -> np.ndarray:
    """Channels (7, row, column) of a skin alone: mask, normal, and position in cm."""
    known = skin.known[..., None]
    return np.moveaxis(np.where(known, np.concatenate([known, skin.normals, 100.0 * skin.points], axis=2), 0.0), 2, 0)
