"""MVB and MVD: a convolutional beta-VAE of the displacements of one sensor's mesh.

The network is that of CoMA (Ranjan et al., ECCV 2018) with the widths of ACROSS (Zai El Amri et al., ICRA 2025). Only
its levels differ: CoMA decimates a surface by quadrics, `simgen.learning.networks.hierarchy` coarsens tetrahedra.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from simgen.learning.networks.chebyshev import INITIAL, ChebyshevConvolution, scaled_laplacian
from simgen.learning.networks.hierarchy import Hierarchy, build_hierarchy
from simgen.learning.networks.network import Network, Terms
from simgen.learning.networks.network_data import NetworkData
from simgen.learning.networks.sparse import SparseMatrix, interpolate
from simgen.learning.networks.variational import divergence, sample

ENCODER = (3, 16, 16, 16, 32)  # features before and after each convolution, from level to level
DECODER = (32, 32, 16, 16, 16)  # the same upwards; a last convolution on the finest level gives 3
ORDER = 6
LATENT = 128
HIDDEN = 4  # width of the linear layers between, in latents
# m, ten storage steps. A vertex that moves less is fixed and shows rounding alone. Divided by its own deviation, that
# noise would count as much as the pad's deformation.
LEAST_DEVIATION = 1e-6


class MeshVAE(Network):
    """Displacements (n, vertex, 3), in m, to latents (n, latent) and back.

    The constructor fixes the shapes. `of_mesh`, or a state, sets the mesh.

    sizes : vertices of each level
    edges : entries of the adjacency, for each level but the coarsest
    weights : entries of the interpolation, for each level but the coarsest
    """

    kind: ClassVar[str] = "mesh_vae"
    tf32: ClassVar[bool] = True  # its rounding is far below the noise of drawn latents

    def __init__(self, sizes: Sequence[int], edges: Sequence[int], weights: Sequence[int], latent: int = LATENT):
        super().__init__()
        self.sizes, self.latent, hidden = tuple(sizes), latent, HIDDEN * latent
        steps = list(pairwise(self.sizes))
        self.laplacians = nn.ModuleList(SparseMatrix(size, size, n) for size, n in zip(self.sizes, edges, strict=False))
        self.up = nn.ModuleList(SparseMatrix(a - b, b, n) for (a, b), n in zip(steps, weights, strict=True))
        self.up_transposed = nn.ModuleList(SparseMatrix(b, a - b, n) for (a, b), n in zip(steps, weights, strict=True))
        self.register_buffer("order", torch.arange(self.sizes[0]))
        self.register_buffer("mean", torch.zeros(self.sizes[0], 3))
        self.register_buffer("deviation", torch.ones(self.sizes[0], 3))

        self.down_convolutions = nn.ModuleList(_convolutions(ENCODER))
        self.to_hidden = nn.Linear(self.sizes[-1] * ENCODER[-1], hidden)
        self.to_mean = nn.Linear(hidden, latent)
        self.to_log_variance = nn.Linear(hidden, latent)
        self.from_latent = nn.Linear(latent, hidden)
        self.from_hidden = nn.Linear(hidden, self.sizes[-1] * DECODER[0])
        self.up_convolutions = nn.ModuleList(_convolutions(DECODER))
        self.last = ChebyshevConvolution(DECODER[-1], 3, ORDER, bias=False)
        for linear in (self.to_hidden, self.to_mean, self.to_log_variance, self.from_latent, self.from_hidden):
            nn.init.normal_(linear.weight, 0.0, INITIAL)  # biases keep torch's default

    @classmethod
    def of_mesh(cls, hierarchy: Hierarchy, mean: np.ndarray, deviation: np.ndarray, latent: int = LATENT) -> Self:
        """Make a network. ``mean`` and standard ``deviation`` (vertex, 3), in m, are those of the training samples."""
        edges = [matrix.nnz for matrix in hierarchy.adjacency[:-1]]
        network = cls(hierarchy.sizes, edges, [matrix.nnz for matrix in hierarchy.interpolation], latent)
        for level, matrix in enumerate(hierarchy.interpolation):
            network.laplacians[level].fill(scaled_laplacian(hierarchy.adjacency[level]))
            network.up[level].fill(matrix)
            network.up_transposed[level].fill(matrix.T.tocsr())
        network.order.copy_(torch.from_numpy(hierarchy.order))
        network.mean.copy_(torch.as_tensor(mean))
        network.deviation.copy_(torch.as_tensor(deviation).clamp_min(LEAST_DEVIATION))
        return network

    @classmethod
    def for_training(cls, data: NetworkData) -> tuple[Self, Terms]:
        settings, meshes = data.settings, data.meshes
        hierarchy = build_hierarchy(meshes.rest.double().cpu().numpy(), meshes.tetrahedra)
        network = cls.of_mesh(hierarchy, *meshes.mean_and_deviation(data.train), settings.latent)
        return network, lambda rows: network.terms(data.inputs(rows), settings.beta)

    @property
    def vertices(self) -> int:
        return self.sizes[0]

    def settings(self) -> dict[str, Any]:
        edges = [len(matrix.values) for matrix in self.laplacians]
        weights = [len(matrix.values) for matrix in self.up]
        return {"sizes": list(self.sizes), "edges": edges, "weights": weights, "latent": self.latent}

    def encode(self, displacement: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance of the latents, (n, latent) each, of displacements (n, vertex, 3), m."""
        return self._encode(self._normalised(displacement))

    def decode(self, latent: Tensor) -> Tensor:
        """Displacements (n, vertex, 3), m, of latents (n, latent)."""
        levels_first = self._decode(latent)
        in_order = torch.empty_like(levels_first).index_copy(0, self.order, levels_first)
        return in_order.permute(2, 0, 1) * self.deviation + self.mean

    def forward(self, displacement: Tensor) -> Tensor:
        """Reconstruct displacements (n, vertex, 3), m, from mean latents, or in training from drawn ones."""
        return self.decode(self._latent(*self.encode(displacement)))

    def terms(self, displacement: Tensor, beta: float) -> dict[str, Tensor]:
        """Loss and its parts of displacements (n, vertex, 3), m: loss = mse + beta * kl.

        ``mse`` is a mean over all normalised coordinates. ``kl``, the divergence from N(0, 1), is a mean over latents,
        as in ACROSS, and not their sum.
        """
        x = self._normalised(displacement)
        mean, log_variance = self._encode(x)
        mse = F.mse_loss(self._decode(self._latent(mean, log_variance)), x)
        kl = divergence(mean, log_variance)
        return {"loss": mse + beta * kl, "mse": mse, "kl": kl}

    def _normalised(self, displacement: Tensor) -> Tensor:
        """Normalised values (vertex, 3, n), the coarsest level's vertices first."""
        x = (displacement - self.mean) / self.deviation
        return x.index_select(1, self.order).permute(1, 2, 0).contiguous()

    def _latent(self, mean: Tensor, log_variance: Tensor) -> Tensor:
        return sample(mean, log_variance) if self.training else mean

    def _encode(self, x: Tensor) -> tuple[Tensor, Tensor]:
        for level, convolution in enumerate(self.down_convolutions):
            x = convolution(x, self.laplacians[level], rows=self.sizes[level + 1], relu=True)
        hidden = F.relu(self.to_hidden(x.flatten(0, 1).T))
        return self.to_mean(hidden), self.to_log_variance(hidden)

    def _decode(self, latent: Tensor) -> Tensor:
        hidden = F.relu(self.from_hidden(F.relu(self.from_latent(latent))))
        x = hidden.T.contiguous().view(self.sizes[-1], DECODER[0], -1)
        for level, convolution in zip(reversed(range(len(self.up))), self.up_convolutions, strict=True):
            x = interpolate(x, self.up[level], self.up_transposed[level])
            x = convolution(x, self.laplacians[level], relu=True)
        return self.last(x, self.laplacians[0])


def _convolutions(widths: Sequence[int]) -> list[ChebyshevConvolution]:
    return [ChebyshevConvolution(a, b, ORDER) for a, b in pairwise(widths)]
